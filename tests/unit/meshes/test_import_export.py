"""Reading and writing files: groups that survive, real meshes, CAD solids, and messages for what is wrong."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from femdeform.errors import MeshError
from femdeform.scene.mesh_schema import BlockMesh, FileMesh, RodMesh, RodNetMesh, RubberMountMesh
from femdeform.types import Mesh
from meshes import build_mesh, check_mesh
from meshes.boundary import boundary_facets, find_rows, measures, unique_edges
from meshes.gmsh_session import gmsh_session
from meshes.import_export import write_mesh

TETRA = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def load(file: Path | str, folder: Path | None = None, **options: Any) -> Mesh:
    return build_mesh(FileMesh(file=str(file), **options), folder or Path())


def mount() -> Mesh:
    return build_mesh(RubberMountMesh(recipe="rubber_mount", element_size=0.012), Path())


def block(*cells: int) -> Mesh:
    size = (1.0, 0.5, 1.0 / 3.0)[: len(cells)]
    mesh = build_mesh(BlockMesh(recipe="block", size=size, cells=cells), Path())
    middle = np.flatnonzero(mesh.points[mesh.cells].mean(axis=1)[:, 0] < 0.5)
    return replace(mesh, cell_groups={"left_half": middle, "first": np.array([0])})


def assert_same_groups(ours: dict[str, Any], theirs: dict[str, Any]) -> None:
    assert set(ours) == set(theirs)
    for name, members in ours.items():
        a, b = (np.sort(np.asarray(rows).reshape(len(rows), -1), axis=1) for rows in (members, theirs[name]))
        assert np.array_equal(np.unique(a, axis=0), np.unique(b, axis=0)), name


@pytest.mark.parametrize("suffix", [".msh", ".vtu"])
@pytest.mark.parametrize("cells", [(), (4, 3, 2), (4, 3)], ids=["mount", "3d", "2d"])
def test_round_trip_keeps_everything(suffix: str, cells: tuple[int, ...], tmp_path: Path) -> None:
    mesh = block(*cells) if cells else mount()
    assert write_mesh(mesh, tmp_path / f"a{suffix}") == []
    again = load(tmp_path / f"a{suffix}", dim=mesh.dim)
    assert np.array_equal(again.points, mesh.points)
    assert np.array_equal(again.cells, mesh.cells)
    assert_same_groups(mesh.facet_groups, again.facet_groups)
    assert_same_groups(mesh.cell_groups, again.cell_groups)
    assert_same_groups(mesh.node_groups, again.node_groups)
    for name, facets in mesh.facet_groups.items():
        # Orientation survives as well: the same normal for every facet.
        assert _oriented(facets) == _oriented(again.facet_groups[name])


def _oriented(facets: Any) -> set[tuple[int, ...]]:
    """Facets up to cyclic order of their nodes."""
    firsts = [(row, row.index(min(row))) for row in facets.tolist()]
    return {tuple(row[first:] + row[:first]) for row, first in firsts}


@pytest.mark.parametrize("suffix", [".msh", ".vtu"])
def test_round_trip_of_rods(suffix: str, tmp_path: Path) -> None:
    rod = build_mesh(RodMesh(recipe="rod", cells=5), Path())
    net = build_mesh(RodNetMesh(recipe="rod_net", meshes=(3, 2), segments=2), Path())
    for mesh in (rod, net):
        write_mesh(mesh, tmp_path / f"a{suffix}")
        again = load(tmp_path / f"a{suffix}")
        assert np.array_equal(again.points, mesh.points)
        assert np.array_equal(again.cells, mesh.cells)
        assert_same_groups(mesh.facet_groups, again.facet_groups)
        assert_same_groups(mesh.node_groups, again.node_groups)


def test_medit_round_trip_numbers_the_groups(tmp_path: Path) -> None:
    mesh = block(4, 3, 2)
    mesh = replace(mesh, cell_groups={"left_half": mesh.cell_groups["left_half"]})
    notices = write_mesh(mesh, tmp_path / "a.mesh")
    again = load(tmp_path / "a.mesh")
    assert np.array_equal(again.points, mesh.points)
    assert np.array_equal(again.cells, mesh.cells)
    assert_same_groups({"region_1": mesh.cell_groups["left_half"]}, again.cell_groups)
    names = [name for name in mesh.facet_groups if name != "boundary"]
    expected = {f"surface_{number}": mesh.facet_groups[name] for number, name in enumerate(names, start=1)}
    assert_same_groups({**expected, "boundary": mesh.facet_groups["boundary"]}, again.facet_groups)
    assert "group `left` written as number 1" in notices
    flat = block(4, 3)
    write_mesh(flat, tmp_path / "flat.mesh")
    again = load(tmp_path / "flat.mesh")
    assert again.dim == 2
    assert np.array_equal(again.points, flat.points)
    assert {f"curve_{number}" for number in (1, 2, 3, 4)} <= set(again.facet_groups)


@pytest.mark.parametrize("suffix", [".obj", ".stl"])
def test_surface_of_a_solid(suffix: str, tmp_path: Path) -> None:
    mesh = block(4, 3, 2)
    notices = write_mesh(mesh, tmp_path / f"a{suffix}")
    assert any("only the surface" in notice for notice in notices)
    assert any("left_half" in notice for notice in notices)
    surface = load(tmp_path / f"a{suffix}")
    assert surface.cell_type == "triangle"
    assert surface.dim == 3
    assert surface.n_cells == len(mesh.facet_groups["boundary"])
    # Corners shared by triangles are one point again, and the surface has no edge.
    assert surface.n_points == len(np.unique(mesh.facet_groups["boundary"]))
    assert surface.facet_groups == {}
    assert measures(surface.points, surface.cells).sum() == pytest.approx(2 * (0.5 + 1 / 3 + 1 / 6), rel=1e-6)
    filled = load(tmp_path / f"a{suffix}", fill=True)
    assert measures(filled.points, filled.cells).sum() == pytest.approx(1 / 6, rel=1e-6)


def test_obj_lines_round_trip(tmp_path: Path) -> None:
    net = build_mesh(RodNetMesh(recipe="rod_net", meshes=(3, 2)), Path())
    write_mesh(net, tmp_path / "net.obj")
    again = load(tmp_path / "net.obj")
    assert again.cell_type == "line"
    assert np.array_equal(again.points, net.points)
    assert np.array_equal(again.cells, net.cells)


def test_obj_details(tmp_path: Path) -> None:
    text = """# comment
    mtllib none.mtl
    v 0 0 0
    v 1 0 0 0.5 0.5 0.5
    v 1 1 0
    v 0 1 0
    vn 0 0 1
    g quad
    f 1//1 2//1 3//1 4//1
    v 2 0 0
    v 2 1 0
    g two words
    f -2/3 -1/2 3
    f 2/1/1 5/2/1 3/3/1
    l 1 2 5
    """
    (tmp_path / "a.obj").write_text(text)
    notices: list[str] = []
    mesh = build_mesh(FileMesh(file="a.obj"), tmp_path, notices)
    assert mesh.cells.tolist() == [[0, 1, 2], [0, 2, 3], [4, 5, 2], [1, 4, 2]]
    assert_same_groups(mesh.cell_groups, {"quad": np.array([0, 1]), "two_words": np.array([2, 3])})
    assert notices == ["1 polygons cut into triangles"]
    lines = load("a.obj", tmp_path, cell_type="line")
    assert lines.cells.tolist() == [[0, 1], [1, 2]]
    assert lines.points[2].tolist() == [2.0, 0.0, 0.0]


@pytest.mark.parametrize(("version", "binary"), [(1.0, 0), (2.2, 0), (2.2, 1), (4.0, 0), (4.1, 0), (4.1, 1)])
def test_msh_versions_and_overlapping_groups(version: float, binary: int, tmp_path: Path) -> None:
    path = tmp_path / "a.msh"
    with gmsh_session("box") as gmsh:
        gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
        gmsh.model.occ.synchronize()
        gmsh.model.addPhysicalGroup(3, [1], name="all")
        gmsh.model.addPhysicalGroup(3, [1], name="again")
        gmsh.model.addPhysicalGroup(2, [1], name="left")
        gmsh.model.addPhysicalGroup(2, [1, 2], name="sides")
        gmsh.model.addPhysicalGroup(1, [1], name="edge")
        gmsh.model.addPhysicalGroup(0, [1])
        gmsh.model.mesh.generate(3)
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        gmsh.option.setNumber("Mesh.Binary", binary)
        gmsh.write(str(path))
    mesh, notices = check_mesh(load(path), "box")
    assert notices == []
    assert measures(mesh.points, mesh.cells).sum() == pytest.approx(1.0)
    # Version 1 of the format has no names, only numbers.
    names = ["volume_1", "volume_2", "surface_3", "surface_4", "curve_5", "point_6"]
    if version > 1.0:
        names = ["all", "again", "left", "sides", "edge", "point_6"]
    assert set(mesh.cell_groups) == set(names[:2])
    assert set(mesh.facet_groups) == {*names[2:4], "boundary"}
    assert set(mesh.node_groups) == set(names[4:])
    assert len(mesh.cell_groups[names[0]]) == len(mesh.cell_groups[names[1]]) == mesh.n_cells
    left, sides = (measures(mesh.points, mesh.facet_groups[name]).sum() for name in names[2:4])
    assert (left, sides) == (pytest.approx(1.0), pytest.approx(2.0))


def test_msh_with_other_cells_is_refused(tmp_path: Path) -> None:
    with gmsh_session("box") as gmsh:
        gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
        gmsh.model.occ.synchronize()
        gmsh.model.mesh.generate(3)
        gmsh.model.mesh.setOrder(2)
        gmsh.write(str(tmp_path / "a.msh"))
    with pytest.raises(MeshError, match=r"a\.msh: \d+ cells of type `Line 3`: only lines, triangles"):
        load("a.msh", tmp_path)


def test_facets_inside_become_nodes(tmp_path: Path) -> None:
    mesh = mount()
    write_mesh(mesh, tmp_path / "a.msh")
    with gmsh_session("edit") as gmsh:
        gmsh.merge(str(tmp_path / "a.msh"))
        # A group of the bottom and of a surface between two parts.
        between = gmsh.model.addDiscreteEntity(2)
        rubber, plate = (mesh.cells[mesh.cell_groups[name]] for name in ("rubber", "bottom_plate"))
        facets = boundary_facets(rubber)
        facets = facets[find_rows(boundary_facets(plate), facets) >= 0]
        gmsh.model.mesh.addElementsByType(between, 2, [], (facets + 1).ravel())
        bottom = gmsh.model.getEntitiesForPhysicalName("bottom")
        gmsh.model.addPhysicalGroup(2, [between, *(tag for _, tag in bottom)], name="mixed")
        gmsh.option.setNumber("Mesh.SaveAll", 1)
        gmsh.write(str(tmp_path / "b.msh"))
    again = load("b.msh", tmp_path)
    assert np.array_equal(np.unique(again.facet_groups["mixed"]), mesh.group_nodes("bottom"))
    assert np.array_equal(again.node_groups["mixed_interior"], np.unique(facets))
    assert np.array_equal(again.node_groups["mixed_interior"], mesh.node_groups["bottom_bond"])


def test_facet_group_off_the_mesh_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.mesh").write_text(
        "MeshVersionFormatted 1\nDimension 3\nVertices 5\n0 0 0 0\n1 0 0 0\n0 1 0 0\n0 0 1 0\n2 2 2 0\n"
        "Triangles 2\n1 2 3 7\n3 4 5 7\nTetrahedra 1\n1 2 3 4 1\nEnd\n"
    )
    with pytest.raises(MeshError, match="group `surface_7`: 1 of its 2 facets belong to no cell"):
        load("a.mesh", tmp_path)


@pytest.mark.parametrize("suffix", [".vtk", ".vtu", ".ply"])
def test_other_programs_files(suffix: str, tmp_path: Path) -> None:
    import meshio

    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0]])
    cells = [("triangle", np.array([[1, 4, 2]])), ("quad", np.array([[0, 1, 2, 3]]))]
    data = {"material": [np.array([2]), np.array([5])], "noise": [np.ones(1), np.ones(1)]}
    content = meshio.Mesh(points, cells, cell_data={} if suffix == ".ply" else data)
    getattr(meshio, suffix[1:]).write(str(tmp_path / f"a{suffix}"), content)
    notices: list[str] = []
    mesh = build_mesh(FileMesh(file=f"a{suffix}", dim=2), tmp_path, notices)
    assert mesh.dim == 2
    assert measures(mesh.points, mesh.cells).sum() == pytest.approx(1.5)
    assert notices == ["1 quadrilaterals cut into two triangles each"]
    if suffix == ".ply":
        assert mesh.cell_groups == {}
    else:
        assert_same_groups(mesh.cell_groups, {"surface_2": np.array([0]), "surface_5": np.array([1, 2])})


def test_vtk_polydata_lines(tmp_path: Path) -> None:
    (tmp_path / "a.vtk").write_text(
        "# vtk DataFile Version 3.0\nnet\nASCII\nDATASET POLYDATA\nPOINTS 5 double\n"
        "0 0 0  1 0 0  2 0 0  0 1 0  1 1 0\nLINES 2 7\n3 0 1 2\n2 3 4\n"
    )
    mesh = load("a.vtk", tmp_path)
    assert mesh.cell_type == "line"
    assert mesh.cells.tolist() == [[0, 1], [1, 2], [3, 4]]
    assert mesh.facet_groups["boundary"].ravel().tolist() == [0, 2, 3, 4]


def test_npz_groups(tmp_path: Path) -> None:
    mesh = block(2, 2, 2)
    bone = np.array([3, 1], dtype=np.int32)
    np.savez(tmp_path / "a.npz", points=mesh.points, tets=mesh.cells.astype(np.int32), bone=bone)
    again = load("a.npz", tmp_path, scale=2.0)
    assert np.array_equal(again.points, 2.0 * mesh.points)
    assert again.cell_groups["bone"].tolist() == [1, 3]
    np.savez(tmp_path / "b.npz", points=mesh.points, tets=mesh.cells, bone=np.array([99]))
    with pytest.raises(MeshError, match=r"array `bone` has indices outside 0\.\.39"):
        load("b.npz", tmp_path)
    np.savez(tmp_path / "c.npz", tets=mesh.cells)
    with pytest.raises(MeshError, match="no array `points`"):
        load("c.npz", tmp_path)


def test_biceps(data_dir: Path) -> None:
    mesh, notices = check_mesh(load(data_dir / "biceps" / "biceps.npz", scale=0.01), "biceps")
    assert notices == []
    parts = ["biceps_muscle_indices", "humerus_bone_indices", "forearm_bone_indices", "scapula_bone_indices"]
    assert set(mesh.cell_groups) == set(parts)
    together = np.sort(np.concatenate([mesh.cell_groups[name] for name in parts]))
    assert np.array_equal(together, np.arange(mesh.n_cells))


@pytest.mark.parametrize(
    ("file", "n_points", "n_cells", "volume"),
    [
        ("coarse_bunny.mesh", 699, 2274, 837_151.0),
        ("spot.mesh", 4079, 15_555, 0.71735),
        ("octopus.mesh", 11_772, 39_083, 0.0119668),
        ("cube_6k.mesh", 6000, 29_142, 8.0),
        ("beam.mesh", 751, 2998, 40.0),
    ],
)
def test_real_solids(
    file: str, n_points: int, n_cells: int, volume: float, data_dir: Path, check_solid: Callable[..., None]
) -> None:
    mesh, notices = check_mesh(load(file, data_dir / "meshes"), file)
    assert (mesh.n_points, mesh.n_cells) == (n_points, n_cells)
    assert measures(mesh.points, mesh.cells).sum() == pytest.approx(volume, rel=1e-4)
    assert set(mesh.facet_groups) == {"boundary"}
    assert notices == []
    check_solid(mesh, covered=False)


def test_bunny_with_slivers_loads_in_double_precision(data_dir: Path) -> None:
    mesh, (notice,) = check_mesh(load("bunny.mesh", data_dir / "meshes", scale=10.0), "bunny")
    assert (mesh.n_points, mesh.n_cells) == (5433, 34_055)
    assert "slivers" in notice
    assert mesh.points[0].tolist() == [-0.0260146 * 10.0, 0.112578 * 10.0, 0.0363871 * 10.0]


@pytest.mark.parametrize(
    ("file", "n_points", "n_triangles", "n_edges"),
    [("armadillo_low.obj", 675, 1346, 2019), ("square_cloth3.obj", 5929, 11_552, 17_480)],
)
def test_real_surfaces_and_their_edges(
    file: str, n_points: int, n_triangles: int, n_edges: int, data_dir: Path
) -> None:
    folder = data_dir / "meshes"
    surface = check_mesh(load(file, folder), file)[0]
    assert (surface.n_points, surface.n_cells) == (n_points, n_triangles)
    rods = check_mesh(load(file, folder, cell_type="edges"), file)[0]
    assert (rods.cell_type, rods.n_points, rods.n_cells) == ("line", n_points, n_edges)


def test_parts_of_a_solid(data_dir: Path) -> None:
    folder = data_dir / "meshes"
    rods = load("coarser_bunny.mesh", folder, cell_type="edges")
    assert (rods.n_points, rods.n_cells) == (500, 2434)
    solid = load("coarser_bunny.mesh", folder)
    surface = load("coarser_bunny.mesh", folder, cell_type="surface")
    assert surface.n_cells == len(solid.facet_groups["boundary"])
    assert surface.n_points < solid.n_points
    assert np.array_equal(rods.cells, unique_edges(solid.cells))
    assert check_mesh(surface, "bunny")[1] == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"cell_type": "line"}, "no line cells in it, only tetra cells; all edges of its cells are"),
        ({"cell_type": "triangle"}, "the surface of its tetrahedra is `cell_type: surface`"),
        ({"fill": True}, "fill: no triangles in it"),
        ({"dim": 2}, "dim: 2 needs a flat mesh, but z ranges over 2 m"),
    ],
)
def test_cells_that_are_not_there(options: dict[str, Any], message: str, data_dir: Path) -> None:
    with pytest.raises(MeshError) as caught:
        load("beam.mesh", data_dir / "meshes", **options)
    assert message in str(caught.value)
    assert str(caught.value).startswith("beam.mesh: ")


BROKEN = {
    "a.msh": b"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Nodes\n1 2",
    "b.mesh": b"MeshVersionFormatted 1\nDimension 3\nVertices\n4\n0 0 0 0\n1 0",
    "c.mesh": b"MeshVersionFormatted 1\nDimension 3\nVertices\n1\n0 0 zero 0",
    "d.vtu": b"<VTKFile",
    "e.vtk": b"no such thing",
    "f.stl": b"solid a\nfacet",
    "g.ply": b"ply\nformat ascii 1.0\nelement vertex x",
    "h.npz": b"PK nothing",
    "i.obj": b"v 1 2 3\nf 1 2",
    "j.obj": b"f 1 2 3",
    "k.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9",
    "l.step": b"ISO-10303-21;",
    "m.mesh": b"MeshVersionFormatted 1\nDimension 3\nVertices 0\nHexahedra\n1\n1 2 3 4 5 6 7 8 0",
    "n.msh": b"",
    "o.xyz": b"",
    "p.vtk": b"# vtk DataFile Version 3.0\nx\nASCII\nDATASET POLYDATA\nPOINTS two",
}


@pytest.mark.parametrize("file", BROKEN)
def test_broken_files_give_one_line(file: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    (tmp_path / file).write_bytes(BROKEN[file])
    with pytest.raises(MeshError) as caught:
        load(file, tmp_path)
    message = str(caught.value)
    assert message.startswith(f"{file}: ")
    assert "\n" not in message
    assert len(message) > len(file) + 12
    assert capfd.readouterr().out == ""


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match=r"^none\.msh: no such file$"):
        load("none.msh", tmp_path)
    with pytest.raises(MeshError, match=r"^none\.step: no such file$"):
        load("none.step", tmp_path)
    (tmp_path / "folder.msh").mkdir()
    with pytest.raises(MeshError, match="is a directory"):
        load("folder.msh", tmp_path)


def test_unreferenced_points(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", points=np.concatenate([[[9.0, 9, 9]], TETRA]), tets=np.array([[1, 2, 3, 4]]))
    with pytest.raises(MeshError, match=r"1 unreferenced points .*: 0; `drop_unreferenced: true`"):
        check_mesh(load("a.npz", tmp_path), "a")
    mesh, notices = check_mesh(load("a.npz", tmp_path, drop_unreferenced=True), "a")
    assert notices == []
    assert np.array_equal(mesh.points, TETRA)
    assert mesh.cells.tolist() == [[0, 1, 2, 3]]


def test_inverted_cells_in_a_file_keep_outward_facets(tmp_path: Path) -> None:
    mesh = block(2, 2, 2)
    cells = mesh.cells.copy()
    cells[::3] = cells[::3][:, [0, 2, 1, 3]]
    np.savez(tmp_path / "a.npz", points=mesh.points, tets=cells)
    read = load("a.npz", tmp_path)
    fixed, (notice,) = check_mesh(read, "a")
    assert notice == "14 of 40 tetrahedra were inverted and have been reoriented"
    assert _oriented(fixed.facet_groups["boundary"]) == _oriented(mesh.facet_groups["boundary"])


def _write_step(path: Path, draw: Callable[[Any], None], capfd: pytest.CaptureFixture[str]) -> None:
    with gmsh_session("step") as gmsh:
        draw(gmsh.model.occ)
        gmsh.model.occ.synchronize()
        gmsh.write(str(path))
    capfd.readouterr()  # the geometry kernel reports what it writes


def test_step_solid(tmp_path: Path, check_solid: Callable[..., None], capfd: pytest.CaptureFixture[str]) -> None:
    def draw(occ: Any) -> None:
        block = occ.addBox(0, 0, 0, 40.0, 20.0, 10.0)
        hole = occ.addCylinder(20.0, 10.0, 0, 0, 0, 10.0, 4.0)
        occ.cut([(3, block)], [(3, hole)])

    _write_step(tmp_path / "part.step", draw, capfd)
    mesh = load("part.step", tmp_path, element_size=0.003)
    assert capfd.readouterr().out == ""
    check_solid(mesh)
    # The file is in millimetres.
    volume = (40.0 * 20.0 * 10.0 - np.pi * 16.0 * 10.0) * 1e-9
    assert measures(mesh.points, mesh.cells).sum() == pytest.approx(volume, rel=5e-3)
    assert set(mesh.facet_groups) == {f"surface_{number}" for number in range(1, 8)} | {"boundary"}
    assert mesh.cell_groups["volume_1"].tolist() == list(range(mesh.n_cells))
    coarse = load("part.step", tmp_path)
    assert coarse.n_cells != mesh.n_cells
    scaled = load("part.step", tmp_path, element_size=3.0, scale=1000.0)
    np.testing.assert_allclose(scaled.points, 1000.0 * mesh.points, rtol=1e-12)


def test_step_solids_that_touch_share_nodes(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    def draw(occ: Any) -> None:
        occ.addBox(0, 0, 0, 10.0, 10.0, 10.0)
        occ.addBox(10.0, 2.0, 2.0, 10.0, 5.0, 5.0)

    _write_step(tmp_path / "two.stp", draw, capfd)
    mesh, notices = check_mesh(load("two.stp", tmp_path), "two")
    assert notices == []
    shared = np.intersect1d(mesh.group_nodes("volume_1"), mesh.group_nodes("volume_2"))
    assert len(shared) > 4
    np.testing.assert_allclose(mesh.points[shared][:, 0], 0.01, rtol=1e-9)
    # The surface between them is no boundary: its nodes are named instead.
    (bond,) = [name for name in mesh.node_groups if name.startswith("surface_")]
    assert np.array_equal(mesh.node_groups[bond], shared)


def test_step_without_a_solid(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    _write_step(tmp_path / "flat.step", lambda occ: occ.addRectangle(0, 0, 0, 1.0, 1.0), capfd)
    with pytest.raises(MeshError, match="no solids in it"):
        load("flat.step", tmp_path)


def test_unknown_format_for_writing(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match=r"cannot be written as `\.xyz`; known: \.mesh \.msh \.obj"):
        write_mesh(block(1, 1, 1), tmp_path / "a.xyz")
    rod = build_mesh(RodMesh(recipe="rod"), Path())
    with pytest.raises(MeshError, match="surfaces, not lines"):
        write_mesh(rod, tmp_path / "a.stl")
