"""Mesh checks: what is repaired with a notice, what is an error, and how its first offenders are named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from femdeform.errors import MeshError
from femdeform.scene.mesh_schema import BlockMesh
from femdeform.types import IntArray, Mesh
from meshes import build_mesh, check_mesh
from meshes.boundary import signed_measures
from meshes.quality import cell_quality, edge_statistics, quality_histogram

TETRA = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def block(*cells: int) -> Mesh:
    return build_mesh(BlockMesh(recipe="block", size=(1.0,) * len(cells), cells=cells), Path())


def faults(mesh: Mesh) -> list[str]:
    with pytest.raises(MeshError) as caught:
        check_mesh(mesh, "body")
    assert all(fault.file == "body" for fault in caught.value.faults)
    return [fault.message for fault in caught.value.faults]


def with_cells(mesh: Mesh, cells: IntArray) -> Mesh:
    return replace(mesh, cells=cells, facet_groups={}, cell_groups={}, node_groups={})


def test_sound_mesh_is_returned_as_it_is() -> None:
    for mesh in (block(2, 2, 2), block(3, 2), block(4)):
        checked, notices = check_mesh(mesh, "body")
        assert checked is mesh
        assert notices == []


@pytest.mark.parametrize(("cells", "word"), [((2, 2, 2), "tetrahedra"), ((3, 2), "triangles")])
def test_inverted_cells_are_reoriented(cells: tuple[int, ...], word: str) -> None:
    mesh = block(*cells)
    wrong = mesh.cells.copy()
    wrong[::4] = wrong[::4][:, [1, 0, *range(2, wrong.shape[1])]]
    fixed, notices = check_mesh(replace(mesh, cells=wrong), "body")
    count = len(range(0, mesh.n_cells, 4))
    assert notices == [f"{count} of {mesh.n_cells} {word} were inverted and have been reoriented"]
    assert signed_measures(fixed.points, fixed.cells).min() > 0.0
    assert np.array_equal(np.sort(fixed.cells, axis=1), np.sort(mesh.cells, axis=1))
    assert fixed.facet_groups is mesh.facet_groups


def test_triangles_in_3d_have_no_orientation() -> None:
    flat = build_mesh(BlockMesh(recipe="block", size=(1.0, 1.0), cells=(2, 2), dim=3), Path())
    turned = with_cells(flat, flat.cells[:, ::-1])
    assert check_mesh(turned, "body") == (turned, [])


def test_zero_volume_cells_are_named() -> None:
    mesh = block(2, 2, 2)
    points = mesh.points.copy()
    # The top corner of the first cells, pressed into the plane of the others.
    wrong = np.array([[0, 1, 3, 4], [1, 2, 4, 5]])
    assert signed_measures(points, wrong).tolist() == [0.0, 0.0]
    (message,) = faults(with_cells(mesh, np.concatenate([mesh.cells, wrong])))
    assert message == "2 zero-volume tetrahedra: 40 (nodes 0 1 3 4), 41 (nodes 1 2 4 5)"


def test_only_five_offenders_are_shown() -> None:
    mesh = block(3, 3, 3)
    points = mesh.points.copy()
    points[:, 2] = 0.0
    (message,) = faults(replace(mesh, points=points))
    assert message.startswith(f"{mesh.n_cells} zero-volume tetrahedra: 0 (nodes ")
    assert message.count("nodes") == 5
    assert message.endswith(", ...")


@pytest.mark.parametrize("offset", [0.0, 1e3, -1e6])
def test_flatness_is_judged_by_shape_not_by_size(offset: float) -> None:
    for size in (1e-6, 1.0, 1e6):
        flat = TETRA * size
        flat[3] = size * np.array([0.3, 0.3, 0.0])
        generator = np.random.default_rng(5)
        rotation = np.linalg.qr(generator.normal(size=(3, 3)))[0]
        moved = flat @ rotation.T + offset * size
        assert "zero-volume" in faults(Mesh(moved, np.array([[0, 1, 2, 3]]), "tetra"))[0]
    sliver = TETRA.copy()
    sliver[3] = [0.3, 0.3, 1e-7]
    _, (notice,) = check_mesh(Mesh(sliver, np.array([[0, 1, 2, 3]]), "tetra"), "body")
    assert notice.startswith("1 of 1 tetrahedra are slivers of quality below 0.01 (smallest ")
    assert "tetra 0" in notice


def test_zero_area_and_zero_length() -> None:
    line = np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]])
    assert faults(Mesh(line, np.array([[0, 1, 2]]), "triangle")) == ["1 zero-area triangles: 0 (nodes 0 1 2)"]
    same = np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 0]])
    assert faults(Mesh(same, np.array([[0, 1], [1, 2]]), "line")) == ["1 zero-length lines: 1 (nodes 1 2)"]


def test_duplicates_repeats_and_overlaps() -> None:
    mesh = block(1, 1, 1)
    again = mesh.cells[[2]][:, [3, 1, 0, 2]]
    (message,) = faults(with_cells(mesh, np.concatenate([mesh.cells, again])))
    assert message.startswith("1 duplicate tetrahedra (same nodes as an earlier one): 5 (nodes ")
    twice = mesh.cells.copy()
    twice[1, 3] = twice[1, 0]
    assert faults(with_cells(mesh, twice))[0].startswith("1 tetrahedra that use a node twice: 1 (nodes ")
    third = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]])
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, -1.0], [1.0, 1.0]])
    assert faults(Mesh(points, third, "triangle")) == [
        "1 facets belong to more than two cells, which overlap: nodes 0 1"
    ]


def test_points_not_finite_and_unreferenced_are_reported_together() -> None:
    mesh = block(1, 1, 1)
    points = np.concatenate([mesh.points, [[2.0, 2, 2], [3, 3, 3]]])
    points[4, 1] = np.inf
    points[6, 0] = np.nan
    messages = faults(replace(mesh, points=points))
    assert messages[0] == "2 points (counted from 0) that are not finite: 4 (at 0.0 inf 1.0), 6 (at nan 1.0 1.0)"
    assert messages[1].startswith("2 unreferenced points (no cell uses them): 8, 9; `drop_unreferenced: ")
    assert len(messages) == 2


def test_nodes_out_of_range() -> None:
    mesh = Mesh(TETRA, np.array([[0, 1, 2, 3], [0, 1, 2, 7], [-1, 0, 1, 2]]), "tetra")
    assert faults(mesh) == ["2 tetrahedra with nodes outside 0..3: 1 (nodes 0 1 2 7), 2 (nodes -1 0 1 2)"]


def test_groups_that_are_empty_or_out_of_range() -> None:
    none = np.empty(0, dtype=np.int64)
    mesh = Mesh(
        TETRA,
        np.array([[0, 1, 2, 3]]),
        "tetra",
        {"face": np.array([[0, 1, 9]])},
        {"part": np.array([1])},
        {"corner": none},
    )
    assert faults(mesh) == [
        "facet group `face` has members outside 0..3",
        "cell group `part` has members outside 0..0",
        "node group `corner` is empty",
    ]


def test_no_cells() -> None:
    assert faults(Mesh(TETRA, np.empty((0, 4), dtype=np.int64), "tetra")) == ["no cells in it"]


def test_coinciding_points_are_noticed() -> None:
    two = np.concatenate([TETRA, TETRA * [1, 1, -1]])
    mesh = Mesh(two, np.array([[0, 1, 2, 3], [4, 6, 5, 7]]), "tetra")
    notices = check_mesh(mesh, "body")[1]
    assert notices == ["3 points coincide with another one: the cells there are not connected"]


def test_quality_of_known_cells() -> None:
    regular = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]])
    assert cell_quality(regular, np.array([[0, 1, 2, 3]]))[0] == pytest.approx(1.0)
    assert cell_quality(regular, np.array([[1, 0, 2, 3]]))[0] == pytest.approx(1.0)
    assert cell_quality(regular, np.array([[0, 1, 2]]))[0] == pytest.approx(1.0)
    # Corner of a cube: volume 1/6, squared edges 3 * 1 + 3 * 2.
    assert cell_quality(TETRA, np.array([[0, 1, 2, 3]]))[0] == pytest.approx(12.0 * 0.5 ** (2 / 3) / 9.0)
    # Right triangle: area 1/2, squared edges 1 + 1 + 2.
    assert cell_quality(TETRA, np.array([[0, 1, 2]]))[0] == pytest.approx(4.0 * np.sqrt(3.0) * 0.5 / 4.0)
    assert cell_quality(np.zeros((4, 3)), np.array([[0, 1, 2, 3]]))[0] == 0.0


def test_histogram_and_edges() -> None:
    counts, edges = quality_histogram(np.array([0.0, 0.05, 0.5, 0.95, 1.0]))
    assert counts.tolist() == [2, 0, 0, 0, 0, 1, 0, 0, 0, 2]
    assert edges.tolist() == pytest.approx(np.linspace(0.0, 1.0, 11).tolist())
    statistics = edge_statistics(block(2, 2))
    assert (statistics.shortest, statistics.longest) == (0.5, pytest.approx(0.5**0.5))
    # 12 sides of 0.5 and 4 diagonals.
    assert statistics.mean == pytest.approx((12 * 0.5 + 4 * 0.5**0.5) / 16)
