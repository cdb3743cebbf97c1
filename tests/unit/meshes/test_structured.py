"""Structured recipes: counts, volumes, names, matching neighbours."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter

from femdeform.scene.mesh_schema import MeshSource
from femdeform.types import Mesh
from meshes import build_mesh, check_mesh
from meshes.boundary import (
    area_vectors,
    boundary_facets,
    edge_lengths_squared,
    facet_counts,
    measures,
    signed_measures,
    unique_edges,
)

HERE = Path()
SOURCE: TypeAdapter[Any] = TypeAdapter(MeshSource)


def build(**block: Any) -> Mesh:
    return build_mesh(SOURCE.validate_python(block), HERE)


@pytest.mark.parametrize(("cells", "n_points", "n_cells"), [(31, 32_768, 148_955), (32, 35_937, 163_840)])
def test_benchmark_blocks(cells: int, n_points: int, n_cells: int) -> None:
    start = time.perf_counter()
    mesh = build(recipe="block", cells=[cells] * 3)
    assert time.perf_counter() - start < 2.0
    assert (mesh.n_points, mesh.n_cells) == (n_points, n_cells)
    assert signed_measures(mesh.points, mesh.cells).sum() == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("cells", [[3, 4, 5], [1, 1, 1], [4, 3], [2]])
def test_block_boundary_is_that_of_its_cells(cells: list[int]) -> None:
    mesh = build(recipe="block", size=[1.0] * len(cells), cells=cells)
    assert np.array_equal(mesh.facet_groups["boundary"], boundary_facets(mesh.cells))


@pytest.mark.parametrize(("split", "per_cell"), [(5, 5), (6, 6)])
def test_block_in_3d(split: int, per_cell: int, check_solid: Callable[..., None]) -> None:
    mesh = build(recipe="block", size=[1.0, 0.5, 0.25], cells=[4, 3, 5], split=split)
    assert mesh.n_cells == 60 * per_cell
    assert mesh.n_points == 5 * 4 * 6
    check_solid(mesh)
    assert signed_measures(mesh.points, mesh.cells).sum() == pytest.approx(0.125)
    names = ("left", "right", "bottom", "top", "back", "front")
    assert set(mesh.facet_groups) == {*names, "boundary"}
    for index, name in enumerate(names):
        axis, sign = index // 2, (-1) ** (index + 1)
        normal = area_vectors(mesh.points, mesh.facet_groups[name]).sum(axis=0)
        expected = np.zeros(3)
        expected[axis] = sign * 0.125 / (1.0, 0.5, 0.25)[axis]
        np.testing.assert_allclose(normal, expected, atol=1e-14)
    # Every inner facet has exactly two cells: the diagonals of neighbouring cells match.
    locals_of_facets = ([1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2])
    faces = np.concatenate([mesh.cells[:, local] for local in locals_of_facets])
    assert set(np.unique(facet_counts(mesh.cells, faces))) == {1, 2}


def test_block_corners_are_named() -> None:
    mesh = build(recipe="block", size=[1.0, 2.0, 3.0], cells=[1, 2, 3])
    assert len(mesh.node_groups) == 8
    np.testing.assert_array_equal(mesh.points[mesh.node_groups["right_bottom_front"]], [[1.0, 0.0, 3.0]])
    np.testing.assert_array_equal(mesh.points[mesh.node_groups["left_top_back"]], [[0.0, 2.0, 0.0]])


@pytest.mark.parametrize("diagonals", ["alternating", "right", "left"])
def test_block_in_2d(diagonals: str, check_solid: Callable[..., None]) -> None:
    mesh = build(recipe="block", size=[2.0, 1.0], cells=[5, 4], diagonals=diagonals)
    assert (mesh.dim, mesh.cell_type, mesh.n_cells) == (2, "triangle", 40)
    check_solid(mesh)
    edges = mesh.points[unique_edges(mesh.cells)]
    direction = edges[:, 1] - edges[:, 0]
    slopes = np.sign(direction[:, 0] * direction[:, 1])
    expected = {"alternating": (10, 10), "right": (20, 0), "left": (0, 20)}[diagonals]
    assert (int((slopes > 0).sum()), int((slopes < 0).sum())) == expected


def test_block_as_surface_and_as_line() -> None:
    surface = build(recipe="block", size=[2.0, 1.0], cells=[2, 2], dim=3)
    assert surface.dim == 3
    assert measures(surface.points, surface.cells).sum() == pytest.approx(2.0)
    for dim in (2, 3):
        line = build(recipe="block", size=[2.0], cells=[4], dim=dim)
        assert (line.dim, line.cell_type, line.n_cells) == (dim, "line", 4)
        np.testing.assert_array_equal(line.points[line.facet_groups["right"][0, 0], 0], 2.0)
        np.testing.assert_array_equal(line.points[line.facet_groups["left"][0, 0], 0], 0.0)


@pytest.mark.parametrize(("plane", "normal", "edges"), [("xz", 1, ("back", "front")), ("xy", 2, ("bottom", "top"))])
def test_cloth(plane: str, normal: int, edges: tuple[str, str]) -> None:
    mesh = build(recipe="cloth", size=[2.0, 1.0], cells=[4, 6], plane=plane)
    areas = area_vectors(mesh.points, mesh.cells)
    expected = np.zeros(3)
    expected[normal] = 2.0
    np.testing.assert_allclose(areas.sum(axis=0), expected, atol=1e-14)
    np.testing.assert_allclose(mesh.points.mean(axis=0), 0.0, atol=1e-15)
    assert set(mesh.facet_groups) == {"left", "right", *edges, "boundary"}
    other = "xyz".index(plane[1])
    on_edge = mesh.points[mesh.facet_groups[edges[1]]]
    np.testing.assert_allclose(on_edge[:, :, other], 0.5)
    assert set(mesh.node_groups) == {f"{x}_{y}" for x in ("left", "right") for y in edges}
    # The boundary keeps running with its triangles on the left, seen from where the normals point to.
    boundary = mesh.facet_groups["boundary"]
    tangent = mesh.points[boundary[:, 1]] - mesh.points[boundary[:, 0]]
    inward = -mesh.points[boundary].mean(axis=1)
    assert np.all(np.cross(tangent, inward)[:, normal] > 0.0)


def test_cook_panel(check_solid: Callable[..., None]) -> None:
    mesh = build(recipe="cook", cells=[8, 6])
    check_solid(mesh)
    assert signed_measures(mesh.points, mesh.cells).sum() == pytest.approx(0.5 * (44.0 + 16.0) * 48.0)
    np.testing.assert_allclose(mesh.points[mesh.node_groups["right_top"]], [[48.0, 60.0]])
    np.testing.assert_allclose(mesh.points[mesh.node_groups["right_bottom"]], [[48.0, 44.0]])
    assert measures(mesh.points, mesh.facet_groups["right"]).sum() == pytest.approx(16.0)
    solid = build(recipe="cook", cells=[4, 3, 2], thickness=2.0)
    check_solid(solid)
    assert signed_measures(solid.points, solid.cells).sum() == pytest.approx(2.0 * 1440.0)


def test_flag_fits_the_cylinder(check_solid: Callable[..., None]) -> None:
    mesh = build(recipe="flag")
    check_solid(mesh)
    curved = mesh.points[mesh.group_nodes("left")]
    np.testing.assert_allclose(np.hypot(*(curved - 0.2).T), 0.05, rtol=1e-12)
    np.testing.assert_allclose(mesh.points[mesh.node_groups["tip"]], [[0.6, 0.2]], rtol=1e-12)
    np.testing.assert_allclose(mesh.points[mesh.group_nodes("right")][:, 0], 0.6, rtol=1e-12)


@pytest.mark.parametrize("thickness", [None, 0.3])
def test_ring(thickness: float | None, check_solid: Callable[..., None]) -> None:
    more = {} if thickness is None else {"thickness": thickness}
    cells = [3, 40] if thickness is None else [3, 40, 2]
    mesh = build(recipe="ring", inner_radius=1.0, outer_radius=2.0, angle=2.5, cells=cells, **more)
    check_solid(mesh)
    for name, radius in (("inner", 1.0), ("outer", 2.0)):
        side = mesh.points[mesh.group_nodes(name), :2]
        np.testing.assert_allclose(np.hypot(*side.T), radius, rtol=1e-12)
    for name, angle in (("start", 0.0), ("end", 2.5)):
        cut = mesh.points[mesh.group_nodes(name)]
        np.testing.assert_allclose(np.arctan2(cut[:, 1], cut[:, 0]), angle, atol=1e-12)
    # Chords in place of arcs: every sector of angle d has the area of its two triangles, r^2 sin(d) / 2.
    area = 40 * 0.5 * (2.0**2 - 1.0**2) * np.sin(2.5 / 40)
    assert signed_measures(mesh.points, mesh.cells).sum() == pytest.approx(area * (thickness or 1.0))


def test_ring_with_too_few_cells_is_refused() -> None:
    with pytest.raises(ValueError, match="too few around"):
        build(recipe="ring", angle=3.2, cells=[2, 2])
    assert build(recipe="ring", cells=[1, 1]).n_cells == 2


def test_rod() -> None:
    mesh = build(recipe="rod", start=[1.0, 0.0, 0.0], end=[1.0, 3.0, 4.0], cells=10)
    np.testing.assert_allclose(measures(mesh.points, mesh.cells), 0.5)
    np.testing.assert_array_equal(mesh.points[mesh.facet_groups["end"]], [[[1.0, 3.0, 4.0]]])
    np.testing.assert_array_equal(mesh.points[mesh.facet_groups["start"]], [[[1.0, 0.0, 0.0]]])


def test_rod_net() -> None:
    mesh = build(recipe="rod_net", size=[2.0, 1.0], meshes=[4, 3], segments=2)
    # 5 rods of length 1 and 4 rods of length 2; (4 + 1)(3 + 1) crossings and one node between each two.
    assert measures(mesh.points, mesh.cells).sum() == pytest.approx(5.0 * 1.0 + 4.0 * 2.0)
    n_rods = 4 * 4 + 5 * 3
    assert mesh.n_points == 20 + n_rods
    assert mesh.n_cells == 2 * n_rods
    assert len(mesh.node_groups["crossings"]) == 20
    assert len(mesh.node_groups["left"]) == 2 * 3 + 1
    np.testing.assert_allclose(mesh.points[mesh.node_groups["right_front"]], [[1.0, 0.0, 0.5]])
    assert not len(boundary_facets(mesh.cells))
    assert check_mesh(mesh, "net")[1] == []


def test_sphere_surface_is_closed_even_and_outward() -> None:
    mesh = build(recipe="sphere_surface", radius=2.0, element_size=0.2)
    assert mesh.n_cells == 2 * mesh.n_points - 4  # Euler's formula
    assert not len(boundary_facets(mesh.cells))
    np.testing.assert_allclose(np.linalg.norm(mesh.points, axis=1), 2.0, rtol=1e-14)
    normals = area_vectors(mesh.points, mesh.cells)
    assert np.all(np.einsum("ni,ni->n", normals, mesh.points[mesh.cells[:, 0]]) > 0.0)
    assert measures(mesh.points, mesh.cells).sum() == pytest.approx(16.0 * np.pi, rel=0.005)
    lengths = np.sqrt(edge_lengths_squared(mesh.points, unique_edges(mesh.cells)))
    assert lengths.mean() == pytest.approx(0.2, rel=0.05)
    assert lengths.max() < 1.5 * lengths.min()
    np.testing.assert_allclose(mesh.points[mesh.node_groups["top"]], [[0.0, 2.0, 0.0]], atol=1e-15)
    # Edges of the icosahedron are shared, not doubled.
    assert check_mesh(mesh, "sphere")[1] == []


def test_refined_sphere_converges_to_the_sphere() -> None:
    errors = []
    for size in (0.4, 0.2):
        mesh = build(recipe="sphere_surface", radius=1.0, element_size=size)
        errors.append(4.0 * np.pi - measures(mesh.points, mesh.cells).sum())
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.35)
