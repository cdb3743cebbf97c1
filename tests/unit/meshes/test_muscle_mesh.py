"""The recipe of a muscle, and vectors of cells in mesh files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError
from scipy.integrate import quad

from femdeform.scene.mesh_schema import MeshSource
from femdeform.types import Mesh
from meshes import build_mesh
from meshes.boundary import boundary_facets, signed_measures
from meshes.quality import cell_quality

SOURCE: TypeAdapter[Any] = TypeAdapter(MeshSource)


def build(folder: Path = Path(), **block: Any) -> Mesh:
    return build_mesh(SOURCE.validate_python(block), folder)


@pytest.mark.parametrize("split", [5, 6])
def test_muscle(split: int, check_solid: Callable[..., None]) -> None:
    mesh = build(recipe="muscle", cells=[24, 6], split=split)
    check_solid(mesh)
    assert np.array_equal(np.sort(mesh.facet_groups["boundary"], axis=1), np.sort(boundary_facets(mesh.cells), axis=1))
    assert cell_quality(mesh.points, mesh.cells).min() > 0.1
    sides = [mesh.facet_groups[name] for name in ("left", "right", "side")]
    assert sum(len(facets) for facets in sides) == len(mesh.facet_groups["boundary"])
    groups = mesh.cell_groups
    parts = [groups[name] for name in ("belly", "tendons", "origin_bone", "insertion_bone")]
    assert np.array_equal(np.sort(np.concatenate(parts)), np.arange(mesh.n_cells))
    assert np.array_equal(np.sort(np.concatenate(parts[:2])), groups["muscle"])
    ends = [groups[name] for name in ("origin_tendon", "insertion_tendon")]
    assert np.array_equal(np.sort(np.concatenate(ends)), groups["tendons"])
    # Muscle and bones share their nodes at the ends of the muscle.
    for bone, x in (("origin_bone", 0.0), ("insertion_bone", 0.2)):
        shared = np.intersect1d(mesh.group_nodes(bone), mesh.group_nodes("muscle"))
        assert len(shared) == 49
        assert mesh.points[shared, 0] == pytest.approx(x)


def test_muscle_volume() -> None:
    """That of a body with the cross-section of a rounded square, to second order."""
    volumes = []
    for n in (1, 2):
        mesh = build(recipe="muscle", cells=[40 * n, 8 * n])
        size = signed_measures(mesh.points, mesh.cells)
        volumes.append(float(size[mesh.cell_groups["muscle"]].sum()))
    # Area of u sqrt(1 - b v^2), v sqrt(1 - b u^2) over the square of side 2: by the boundary integral of y dz.
    b = 0.4
    edge = 4.0 * quad(lambda v: np.sqrt(1.0 - b * v * v) * np.sqrt(1.0 - b), -1.0, 1.0)[0]
    bulge = 4.0 * quad(lambda v: v * np.sqrt(1.0 - b) * b * v / np.sqrt(1.0 - b * v * v), -1.0, 1.0)[0]
    area = 0.5 * (edge + bulge)

    def section(x: float) -> float:
        t = np.clip((x - 0.03) / 0.14, 0.0, 1.0)
        return float((0.01 + 0.015 * np.sin(np.pi * t) ** 2) ** 2)

    exact = area * quad(section, 0.0, 0.2, points=[0.03, 0.17])[0]
    errors = [abs(volume / exact - 1.0) for volume in volumes]
    assert errors[0] < 0.02
    assert errors[1] < 0.35 * errors[0]


def test_muscle_parameters() -> None:
    with pytest.raises(ValidationError, match="tendon_length"):
        SOURCE.validate_python({"recipe": "muscle", "length": 0.1, "tendon_length": 0.05})
    assert "tendons" not in build(recipe="muscle", tendon_length=0.0).cell_groups


POINTS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 1.0]])
TETS = np.array([[0, 1, 2, 3], [1, 2, 3, 4]])
VECTORS = np.array([[1.0, 0.0, 0.0], [0.0, 2.0, 0.5]])


def write_npz(path: Path) -> None:
    np.savez(path, points=POINTS, tets=TETS, fibres=VECTORS, belly=np.array([1]), age=np.array([1.0, 2.0]))


def write_vtu(path: Path) -> None:
    import meshio

    meshio.vtu.write(str(path), meshio.Mesh(POINTS, [("tetra", TETS)], cell_data={"fibres": [VECTORS]}))


def write_vtk(path: Path) -> None:
    import meshio

    content = meshio.Mesh(
        POINTS, [("tetra", TETS[:1]), ("tetra", TETS[1:])], cell_data={"fibres": np.split(VECTORS, 2)}
    )
    meshio.vtk.write(str(path), content)


@pytest.mark.parametrize(("suffix", "write"), [("npz", write_npz), ("vtu", write_vtu), ("vtk", write_vtk)])
def test_vectors_of_cells(suffix: str, write: Callable[[Path], None], tmp_path: Path) -> None:
    write(tmp_path / f"m.{suffix}")
    mesh = build(tmp_path, file=f"m.{suffix}")
    assert list(mesh.cell_data) == ["fibres"]
    assert mesh.cell_data["fibres"] == pytest.approx(VECTORS)
    turned = build(tmp_path, file=f"m.{suffix}", rotate={"axis": [0.0, 0.0, 1.0], "angle": np.pi / 2.0}, scale=2.0)
    assert turned.cell_data["fibres"] == pytest.approx(np.array([[0.0, 1.0, 0.0], [-2.0, 0.0, 0.5]]))
    # The surface has other cells.
    assert not build(tmp_path, file=f"m.{suffix}", cell_type="surface").cell_data


def test_index_arrays_are_cell_groups(tmp_path: Path) -> None:
    write_npz(tmp_path / "m.npz")
    assert build(tmp_path, file="m.npz").cell_groups["belly"].tolist() == [1]
