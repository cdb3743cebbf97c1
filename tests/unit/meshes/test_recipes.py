"""Recipes meshed by gmsh: volumes against closed forms, names, orientation, quality, repeatability."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter

from femdeform.errors import InputError, MeshError
from femdeform.scene.mesh_schema import MeshSource
from femdeform.types import Mesh
from meshes import build_mesh, check_mesh
from meshes.boundary import connected_parts, measures
from meshes.quality import cell_quality

SOURCE: TypeAdapter[Any] = TypeAdapter(MeshSource)
PI = np.pi
REPOSITORY = Path(__file__).resolve().parents[3]


def build(**block: Any) -> Mesh:
    return build_mesh(SOURCE.validate_python(block), Path())


CASES: list[tuple[dict[str, Any], float, float, set[str]]] = [
    (
        {"recipe": "beam", "size": [1.0, 0.3, 0.2], "element_size": 0.1},
        0.06,
        1e-12,
        {"left", "right", "bottom", "top", "back", "front"},
    ),
    ({"recipe": "cylinder", "element_size": 0.12}, PI / 4, 0.02, {"bottom", "top", "side"}),
    (
        {"recipe": "cylinder", "hole_radius": 0.2, "axis": "x", "element_size": 0.1},
        PI * (0.25 - 0.04),
        0.02,
        {"left", "right", "side", "hole"},
    ),
    ({"recipe": "cylinder", "axis": "z", "element_size": 0.12}, PI / 4, 0.02, {"back", "front", "side"}),
    ({"recipe": "sphere", "element_size": 0.1}, PI / 6, 0.02, {"surface"}),
    (
        {"recipe": "ellipsoid", "semi_axes": [0.8, 0.5, 0.4], "element_size": 0.1},
        4 / 3 * PI * 0.16,
        0.02,
        {"surface"},
    ),
    ({"recipe": "torus", "element_size": 0.08}, 2 * PI**2 * 0.5 * 0.04, 0.04, {"surface"}),
    ({"recipe": "spherical_shell"}, 4 / 3 * PI * (0.125 - 0.064), 0.02, {"inner", "outer"}),
    (
        {"recipe": "spherical_shell", "part": "half"},
        2 / 3 * PI * (0.125 - 0.064),
        0.02,
        {"inner", "outer", "bottom"},
    ),
    (
        {"recipe": "spherical_shell", "part": "eighth", "element_size": 0.05},
        PI / 6 * (0.125 - 0.064),
        0.02,
        {"inner", "outer", "left", "bottom", "back"},
    ),
    ({"recipe": "plate_with_hole"}, 4.0 - PI / 16, 2e-3, {"left", "right", "bottom", "top", "hole"}),
    (
        {"recipe": "plate_with_hole", "quarter": True},
        1.0 - PI / 64,
        2e-3,
        {"left", "right", "bottom", "top", "hole"},
    ),
    (
        {"recipe": "plate_with_hole", "quarter": True, "thickness": 0.2, "element_size": 0.15},
        0.2 * (1.0 - PI / 64),
        2e-3,
        {"left", "right", "bottom", "top", "hole", "back", "front"},
    ),
]


@pytest.mark.parametrize(("block", "measure", "rtol", "names"), CASES)
def test_volume_names_and_orientation(
    block: dict[str, Any], measure: float, rtol: float, names: set[str], check_solid: Callable[..., None]
) -> None:
    mesh = build(**block)
    check_solid(mesh)
    assert measures(mesh.points, mesh.cells).sum() == pytest.approx(measure, rel=rtol)
    assert set(mesh.facet_groups) == names | {"boundary"}
    assert cell_quality(mesh.points, mesh.cells).min() > 0.1
    assert connected_parts(mesh.cells, mesh.n_points)[0] == 1
    checked, notices = check_mesh(mesh, "body")
    assert checked is mesh
    assert notices == []


def test_sides_lie_where_their_names_say() -> None:
    beam = build(recipe="beam", size=[1.0, 0.3, 0.2], element_size=0.1)
    for axis, (low, high) in enumerate((("left", "right"), ("bottom", "top"), ("back", "front"))):
        np.testing.assert_allclose(beam.points[beam.group_nodes(low)][:, axis], 0.0, atol=1e-12)
        np.testing.assert_allclose(beam.points[beam.group_nodes(high)][:, axis], (1.0, 0.3, 0.2)[axis])
    np.testing.assert_allclose(beam.points[beam.node_groups["right_top_back"]], [[1.0, 0.3, 0.0]], atol=1e-12)
    tube = build(recipe="cylinder", hole_radius=0.2, axis="x", element_size=0.1)
    for name, radius in (("hole", 0.2), ("side", 0.5)):
        nodes = tube.points[tube.group_nodes(name)]
        np.testing.assert_allclose(np.hypot(nodes[:, 1], nodes[:, 2]), radius, rtol=1e-9)
    plate = build(recipe="plate_with_hole", quarter=True)
    np.testing.assert_allclose(np.hypot(*plate.points[plate.group_nodes("hole")].T), 0.25, rtol=1e-9)
    np.testing.assert_allclose(plate.points[plate.group_nodes("left")][:, 0], 0.0, atol=1e-12)
    shell = build(recipe="spherical_shell", part="half")
    radii = np.linalg.norm(shell.points[shell.group_nodes("inner")], axis=1)
    np.testing.assert_allclose(radii, 0.4, rtol=1e-9)
    np.testing.assert_allclose(shell.points[shell.group_nodes("bottom")][:, 1], 0.0, atol=1e-12)
    ring = build(recipe="torus")
    assert np.abs(ring.points[:, 1]).max() == pytest.approx(0.2, rel=0.05)


def test_hole_is_finer_than_the_plate() -> None:
    plate = build(recipe="plate_with_hole", element_size=0.2, hole_element_size=0.03)
    assert len(plate.facet_groups["hole"]) == pytest.approx(2 * PI * 0.25 / 0.03, rel=0.1)
    assert len(plate.facet_groups["left"]) == 10


def test_rubber_mount(check_solid: Callable[..., None]) -> None:
    mesh = build(recipe="rubber_mount")
    check_solid(mesh)
    assert 5_000 <= mesh.n_cells <= 12_000
    assert cell_quality(mesh.points, mesh.cells).min() > 0.15
    assert connected_parts(mesh.cells, mesh.n_points)[0] == 1
    assert check_mesh(mesh, "mount")[1] == []
    # The three parts together are the whole mesh, without overlap.
    parts = [mesh.cell_groups[name] for name in ("rubber", "bottom_plate", "top_plate")]
    assert np.array_equal(np.sort(np.concatenate(parts)), np.arange(mesh.n_cells))
    # Each plate: a square less the bore and four bolt holes.
    plate = 0.006 * (0.09**2 - PI * 0.008**2 - 4 * PI * 0.0045**2)
    for name in ("bottom_plate", "top_plate"):
        volume = measures(mesh.points, mesh.cells[mesh.cell_groups[name]]).sum()
        assert volume == pytest.approx(plate, rel=0.02)
    np.testing.assert_allclose(mesh.points[mesh.group_nodes("bottom")][:, 1], 0.0, atol=1e-12)
    np.testing.assert_allclose(mesh.points[mesh.group_nodes("top")][:, 1], 0.062, rtol=1e-9)
    # Bonded: the parts share exactly the nodes of the bonds.
    rubber = mesh.group_nodes("rubber")
    for name, height in (("bottom", 0.006), ("top", 0.056)):
        shared = np.intersect1d(rubber, mesh.group_nodes(f"{name}_plate"))
        assert np.array_equal(shared, np.sort(mesh.node_groups[f"{name}_bond"]))
        np.testing.assert_allclose(mesh.points[shared][:, 1], height, rtol=1e-9)
    side = mesh.points[mesh.group_nodes("rubber_side")]
    radii = np.hypot(side[:, 0], side[:, 2])
    assert radii.min() == pytest.approx(0.026, rel=0.01)
    assert radii.max() == pytest.approx(0.035, rel=1e-6)
    bore = mesh.points[mesh.group_nodes("bore")]
    np.testing.assert_allclose(np.hypot(bore[:, 0], bore[:, 2]), 0.008, rtol=1e-6)


@pytest.mark.parametrize(
    "change",
    [
        {"bore_radius": 0.0, "bolt_hole_radius": 0.0, "waist_radius": 0.04},
        {"bottom_radius": 0.03, "waist_radius": 0.03},
        {"bottom_radius": 0.035, "top_radius": 0.025, "waist_radius": 0.03},
    ],
    ids=["bulged and massive", "cylindrical", "conical"],
)
def test_other_rubber_mounts(change: dict[str, float], check_solid: Callable[..., None]) -> None:
    mesh = build(recipe="rubber_mount", element_size=0.008, **change)
    check_solid(mesh)
    side = mesh.points[mesh.group_nodes("rubber_side")]
    middle = np.abs(side[:, 1] - 0.031) < 0.003
    waist = float(np.hypot(side[middle, 0], side[middle, 2]).mean())
    assert waist == pytest.approx(change["waist_radius"], rel=0.03)


@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_size_does_not_matter(factor: float) -> None:
    lengths = {"radius": 0.5, "length": 1.0, "hole_radius": 0.1, "element_size": 0.2}
    tube = build(recipe="cylinder", **{key: value * factor for key, value in lengths.items()})
    volume = PI * (0.25 - 0.01) * factor**3
    assert measures(tube.points, tube.cells).sum() == pytest.approx(volume, rel=0.06)
    assert set(tube.facet_groups) == {"bottom", "top", "side", "hole", "boundary"}


_PRINT_HASH = """
import hashlib, pathlib
from femdeform.scene.mesh_schema import RubberMountMesh
from meshes import build_mesh
mesh = build_mesh(RubberMountMesh(recipe="rubber_mount", element_size=0.009), pathlib.Path())
print(hashlib.sha256(mesh.points.tobytes() + mesh.cells.tobytes()).hexdigest())
"""


def test_same_mesh_again_and_in_another_process() -> None:
    mesh, again = (build(recipe="rubber_mount", element_size=0.009) for _ in range(2))
    assert np.array_equal(mesh.points, again.points)
    assert np.array_equal(mesh.cells, again.cells)
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    run = [sys.executable, "-c", _PRINT_HASH]
    other = subprocess.run(run, env=environment, check=True, capture_output=True, text=True).stdout
    assert other.strip() == hashlib.sha256(mesh.points.tobytes() + mesh.cells.tobytes()).hexdigest()


@pytest.mark.parametrize(
    "block",
    [
        {"recipe": "sphere", "element_size": 1e-4},
        {"recipe": "sphere", "element_size": 1e-250, "radius": 1e-200},
        {"recipe": "cylinder", "radius": 0.01, "length": 1e4},
        {"recipe": "beam", "size": [1e4, 1e4, 1e-2], "element_size": 0.1},
        {"recipe": "beam", "size": [1e7, 100.0, 100.0], "element_size": 0.1},
        {"recipe": "rubber_mount", "plate_element_size": 1e-5},
    ],
)
def test_too_fine_is_refused_at_once(block: dict[str, Any]) -> None:
    with pytest.raises(MeshError, match=r"recipe \w+: element_size \S+ m would give about \S+ cells"):
        build(**block)


@pytest.mark.parametrize(
    "block",
    [
        {"recipe": "cylinder", "hole_radius": 0.01},
        {"recipe": "cylinder", "radius": 0.01},
        {"recipe": "ellipsoid", "semi_axes": [1.0, 1.0, 0.13]},
        {"recipe": "spherical_shell", "thickness": 0.004},
        {"recipe": "beam", "size": [1.0, 1.0, 0.0025]},
        {"recipe": "plate_with_hole", "radius": 0.005},
        {"recipe": "rubber_mount", "waist_radius": 0.2},
    ],
)
def test_thin_features_are_meshed(block: dict[str, Any]) -> None:
    mesh, notices = check_mesh(build(**block), "body")
    assert mesh.n_cells < 50_000
    assert notices == []


@pytest.mark.parametrize(
    ("semi_axes", "element_size"),
    # Each of these fails for at least one direction of the sphere's poles.
    [
        ([1.63, 0.22, 0.57], 0.15),
        ([0.99, 1.46, 0.28], 0.28),
        ([1.13, 0.34, 1.52], 0.21),
        ([1.45, 0.4, 0.29], 0.3),
        ([0.145, 1.894, 1.641], 0.15),
    ],
)
def test_ellipsoids_of_all_proportions(
    semi_axes: list[float], element_size: float, check_solid: Callable[..., None]
) -> None:
    mesh = build(recipe="ellipsoid", semi_axes=semi_axes, element_size=element_size)
    check_solid(mesh)
    volume = float(4 / 3 * PI * np.prod(semi_axes))
    assert measures(mesh.points, mesh.cells).sum() == pytest.approx(volume, rel=0.15)
    assert mesh.n_cells < 300 + 2.0 * volume / (0.118 * element_size**3)
    surface = mesh.points[mesh.group_nodes("surface")]
    np.testing.assert_allclose(np.linalg.norm(surface / semi_axes, axis=1), 1.0, rtol=1e-6)
    np.testing.assert_allclose(np.abs(mesh.points).max(axis=0), semi_axes, rtol=0.1)


def test_body_that_gmsh_cannot_mesh() -> None:
    with pytest.raises(MeshError, match="recipe rubber_mount: gmsh failed: Invalid boundary mesh"):
        build(recipe="rubber_mount", waist_radius=0.00801)


def test_threads_take_turns() -> None:
    found: dict[int, int] = {}

    def work(index: int) -> None:
        found[index] = build(recipe="sphere", element_size=0.2).n_cells

    threads = [threading.Thread(target=work, args=(index,)) for index in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 4
    assert len(set(found.values())) == 1


_SIGNALLED = """
import os, signal
from meshes.gmsh_session import gmsh_session

numbers = (signal.SIGTERM, signal.SIGINT)
for number in numbers:
    signal.signal(number, lambda number, frame: print(number))
with gmsh_session("ball") as gmsh:
    gmsh.model.occ.addSphere(0, 0, 0, 1)
    for number in numbers:
        os.kill(os.getpid(), number)
for number in numbers:
    os.kill(os.getpid(), number)
"""


def test_signals_are_heard_during_meshing_and_after_it() -> None:
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    done = subprocess.run([sys.executable, "-c", _SIGNALLED], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["15", "2", "15", "2"]


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGPIPE], ids=lambda number: number.name)
def test_ignored_signals_stay_ignored(number: signal.Signals) -> None:
    """A program under nohup outlives its terminal, and a broken pipe is an error that can be told."""
    lines = [
        "import os, signal",
        "from meshes.gmsh_session import gmsh_session",
        f"signal.signal({int(number)}, signal.SIG_IGN)",
        "with gmsh_session('ball') as gmsh:",
        "    gmsh.model.occ.addSphere(0, 0, 0, 1)",
        f"    os.kill(os.getpid(), {int(number)})",
        f"os.kill(os.getpid(), {int(number)})",
    ]
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    done = subprocess.run([sys.executable, "-c", "\n".join(lines)], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_foreign_gmsh_session_is_left_as_it_was() -> None:
    gmsh = pytest.importorskip("gmsh")
    reference = build(recipe="sphere", element_size=0.2)
    assert not gmsh.isInitialized()
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.123)
        gmsh.model.add("mine")
        gmsh.model.occ.addBox(0, 0, 0, 1, 1, 1)
        gmsh.model.occ.synchronize()
        mesh = build(recipe="sphere", element_size=0.2)
        assert gmsh.model.getCurrent() == "mine"
        assert "femdeform" not in gmsh.model.list()
        assert gmsh.option.getNumber("Mesh.MeshSizeMax") == 0.123
        assert len(gmsh.model.getEntities(3)) == 1
    finally:
        gmsh.finalize()
    assert np.array_equal(mesh.points, reference.points)


def test_placement() -> None:
    plain = build(recipe="beam", element_size=0.2)
    block = {"recipe": "beam", "element_size": 0.2, "rotate": {"axis": [0, 0, 2], "angle": PI / 2}}
    moved = build(**block, translate=[1.0, 2.0, 3.0])
    x, y, z = plain.points.T
    np.testing.assert_allclose(moved.points, np.stack([1.0 - y, 2.0 + x, 3.0 + z], axis=1), atol=1e-14)
    assert np.array_equal(moved.facet_groups["left"], plain.facet_groups["left"])
    flat = build(recipe="block", size=[1.0, 1.0], cells=[1, 1], rotate={"angle": PI / 2})
    np.testing.assert_allclose(flat.points[1], [0.0, 1.0], atol=1e-15)


def test_placement_that_does_not_fit_the_dimension() -> None:
    with pytest.raises(InputError, match="3 components for a mesh in 2 dimensions"):
        build(recipe="cook", translate=[0.0, 0.0, 1.0])
    with pytest.raises(InputError, match="the axis can only be z"):
        build(recipe="cook", rotate={"axis": [1, 0, 0], "angle": 1.0})
