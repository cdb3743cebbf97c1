"""Meshes that cannot be computed on: exit 2, one line with the scene's line, the file, and the place in it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import meshio
import numpy as np
import pytest
from running import Said, rolling
from scenario import write

from femdeform.scene.mesh_schema import BlockMesh
from femdeform.types import Mesh
from meshes import build_mesh
from meshes.gmsh_session import gmsh_session

Say = Callable[..., Said]
ROW = 5  # the point that is spoiled, (1.0, 0.5, 0.0)


def block() -> Mesh:
    return build_mesh(BlockMesh(recipe="block", size=(1.0, 0.5, 0.5), cells=(2, 1, 1)), Path())


def write_npz(path: Path, points: Any, mesh: Mesh) -> None:
    np.savez(path, points=points, tets=mesh.cells)


def write_meshio(path: Path, points: Any, mesh: Mesh) -> None:
    cells = [("tetra", mesh.cells)]
    if path.suffix in (".ply", ".stl"):
        cells = [("triangle", mesh.facet_groups["boundary"].astype(np.int32))]
    with np.errstate(invalid="ignore"):  # normals of the spoiled triangles
        getattr(meshio, path.suffix[1:]).write(str(path), meshio.Mesh(points, cells))


def write_medit(path: Path, points: Any, mesh: Mesh) -> None:
    lines = ["MeshVersionFormatted 1", "Dimension 3", "# a comment", "Vertices", str(len(points))]
    lines += [" ".join(map(str, [*row, 0])) for row in points]
    lines += ["Tetrahedra", str(mesh.n_cells), *(" ".join(map(str, [*row, 1])) for row in mesh.cells + 1), "End"]
    path.write_text("\n".join(lines) + "\n")


def write_obj(path: Path, points: Any, mesh: Mesh) -> None:
    lines = ["# a comment", "g part \\", " one"]
    lines += [f"v {' '.join(map(str, row))}" for row in points]
    lines += [f"f {' '.join(map(str, row))}" for row in mesh.facet_groups["boundary"] + 1]
    path.write_text("\n".join(lines) + "\n")


def write_msh(path: Path, points: Any, mesh: Mesh) -> None:
    with gmsh_session("spoiled") as gmsh:
        entity = gmsh.model.addDiscreteEntity(3)
        gmsh.model.mesh.addNodes(3, entity, np.arange(1, len(points) + 1), mesh.points.ravel())
        gmsh.model.mesh.addElementsByType(entity, 4, [], (mesh.cells + 1).ravel())
        gmsh.write(str(path))
    lines = path.read_text().splitlines()
    at = lines.index(" ".join(f"{value:g}" for value in mesh.points[ROW]))
    lines[at] = " ".join(map(str, points[ROW]))
    path.write_text("\n".join(lines) + "\n")


WRITERS = {
    ".npz": write_npz,
    ".vtu": write_meshio,
    ".vtk": write_meshio,
    ".ply": write_meshio,
    ".stl": write_meshio,
    ".mesh": write_medit,
    ".obj": write_obj,
    ".msh": write_msh,
}


def refused(tmp_path: Path, say: Say, **mesh: Any) -> str:
    """What is said about the mesh, once, by every command that reads it; nothing is left behind."""
    data = rolling(steps=2)
    data["bodies"]["b"]["mesh"] = mesh
    scene = write(data, tmp_path / "s.yaml")
    said = say("run", scene, "--out", tmp_path / "out")
    assert (said.code, said.out) == (2, "")
    assert said.err.count("\n") == 1
    assert not (tmp_path / "out").exists()
    assert say("check", scene).err == said.err
    lines = scene.read_text().splitlines()
    place, key, message = said.err.rstrip("\n").removeprefix(f"{scene}:").split(": ", 2)
    assert lines[int(place) - 1].strip().startswith('"file"')
    assert key == "bodies.b.mesh.file"
    return message


@pytest.mark.parametrize("value", [np.nan, np.inf], ids=str)
@pytest.mark.parametrize("suffix", WRITERS)
def test_not_finite(suffix: str, value: float, tmp_path: Path, say: Say) -> None:
    mesh = block()
    points = mesh.points.copy()
    points[ROW, 1] = value
    path = tmp_path / f"part{suffix}"
    WRITERS[suffix](path, points, mesh)
    fill = {"fill": True} if suffix in (".ply", ".stl", ".obj") else {}
    message = refused(tmp_path, say, file=path.name, **fill)
    assert message.startswith(f"part{suffix}: ")
    if suffix in (".mesh", ".obj"):
        lines = path.read_text().splitlines()
        line = next(number for number, text in enumerate(lines, 1) if str(value) in text.split())
        assert message == f"part{suffix}: line {line}: `{value}` is not a finite number"
    elif suffix == ".stl":
        # Here every triangle has its own points.
        assert " points (counted from 0) that are not finite: " in message
        assert f"(at 1.0 {value} 0.0)" in message
    else:
        expected = f"1 points (counted from 0) that are not finite: {ROW} (at 1.0 {value} 0.0)"
        assert message == f"part{suffix}: {expected}"


@pytest.mark.parametrize("size", [1e-320, 1e-200, 1e103, 1e200, 1e307])
def test_coordinates_whose_products_are_out_of_range(size: float, tmp_path: Path, say: Say) -> None:
    mesh = block()
    write_npz(tmp_path / "part.npz", size * mesh.points, mesh)
    message = refused(tmp_path, say, file="part.npz")
    assert ("zero-volume" if size < 1.0 else "farther away than 1e+30 m: 1 (at ") in message


TEXTS = {
    "a.mesh": ("Vertices\n2\n0 0 0 0\n1 zero 0 0\n", "a.mesh: line 4: `zero` is not a finite number"),
    "b.mesh": (
        "Vertices\n4\n0 0 0 0 1 0 0 0\n0 1 0 0\n0 0 1 0\nTetrahedra 1\n1 2 3\n4.5 1\n",
        "b.mesh: line 8: `4.5` is not a whole number",
    ),
    "c.mesh": ("Vertices 1\n0 0 1e999 0\n", "c.mesh: line 2: `1e999` is not a finite number"),
    "d.obj": ("v 0 0 0\nv 1 0\nl 1 2\n", "d.obj: line 2: a vertex needs three coordinates, this one has 2"),
    "e.obj": ("v 0 0 0\n# two\nv 1 0 x0\nl 1 2\n", "e.obj: line 3: `x0` is not a finite number"),
    "f.obj": ("g a \\\nb\nv 0 0 0\nv 1 \\\n-inf 0\nl 1 2\n", "f.obj: line 4: `-inf` is not a finite number"),
}


@pytest.mark.parametrize("file", TEXTS)
def test_words_that_are_no_numbers(file: str, tmp_path: Path, say: Say) -> None:
    text, message = TEXTS[file]
    (tmp_path / file).write_text(text)
    assert refused(tmp_path, say, file=file) == message


def test_flat_and_repeated_cells(tmp_path: Path, say: Say) -> None:
    mesh = block()
    points = np.concatenate([mesh.points, [[3.0, 0, 0], [4, 0, 0], [3, 1, 0], [4, 1, 0]]])
    flat = np.concatenate([mesh.cells, [[12, 13, 14, 15]]])
    np.savez(tmp_path / "flat.npz", points=points, tets=flat)
    message = refused(tmp_path, say, file="flat.npz")
    assert message == f"flat.npz: 1 zero-volume tetrahedra: {mesh.n_cells} (nodes 12 13 14 15)"
    np.savez(tmp_path / "twice.npz", points=mesh.points, tets=np.concatenate([mesh.cells, mesh.cells[[3]]]))
    message = refused(tmp_path, say, file="twice.npz")
    nodes = " ".join(map(str, mesh.cells[3]))
    assert message == (
        f"twice.npz: 1 duplicate tetrahedra (same nodes as an earlier one): {mesh.n_cells} (nodes {nodes})"
    )


def test_a_file_that_breaks_off(tmp_path: Path, say: Say) -> None:
    (tmp_path / "cut.mesh").write_text("MeshVersionFormatted 1\nDimension 3\nVertices\n4\n0 0 0 0\n1 0")
    assert refused(tmp_path, say, file="cut.mesh") == "cut.mesh: breaks off in section Vertices (1 of 4 rows)"
    (tmp_path / "cut.vtu").write_text("<VTKFile")
    assert refused(tmp_path, say, file="cut.vtu").startswith("cut.vtu: cannot be read as .vtu file: ")
