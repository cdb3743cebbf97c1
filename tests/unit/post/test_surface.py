"""What is seen of a mesh: boundary faces, their orientation, sharp edges, and thinning."""

from __future__ import annotations

import numpy as np
import pytest
from made_results import block, quadratic

from femdeform.post.surface import Part, coarsen, extract_surface, vertex_normals


def areas(points: np.ndarray, part: Part) -> np.ndarray:
    a, b, c = (points[part.nodes[part.cells[:, k]]] for k in range(3))
    return 0.5 * np.cross(b - a, c - a)


def enclosed_volume(points: np.ndarray, part: Part) -> float:
    middle = points[part.nodes[part.cells]].mean(axis=1)
    return float(np.sum(middle * areas(points, part)) / 3.0)


def test_boundary_of_a_block() -> None:
    points, cells = block((3, 2, 2), (3.0, 2.0, 2.0))
    surface = extract_surface(points, [("tetra", cells)])
    assert surface.n_faces == 2 * 2 * (3 * 2 + 3 * 2 + 2 * 2)
    # The divergence theorem gives the volume only if every face is there once and points outward.
    assert enclosed_volume(points, surface.faces) == pytest.approx(12.0)
    assert np.linalg.norm(areas(points, surface.faces), axis=1).sum() == pytest.approx(32.0)
    inner = np.all((points > 0) & (points < [3, 2, 2]), axis=1)
    assert set(surface.nodes) == set(np.flatnonzero(~inner))
    # Each face belongs to the cell that was said: all its nodes are nodes of that cell.
    faces = surface.faces.nodes[surface.faces.cells]
    assert np.all((faces[:, :, None] == cells[surface.face_cells][:, None, :]).any(axis=2))


def test_edges_of_a_box_are_sharp() -> None:
    points, cells = block((2, 2, 2), (1.0, 1.0, 1.0))
    surface = extract_surface(points, [("tetra", cells)])
    assert len(surface.outline.cells) == 12 * 2
    ends = points[surface.outline.nodes[surface.outline.cells]]
    on_edge = (np.isin(ends, [0.0, 1.0]).all(axis=1)).sum(axis=1)
    assert np.all(on_edge >= 2)
    # Nine nodes on each of the six sides, none shared: normals are those of the sides.
    assert len(surface.faces.nodes) == 6 * 9
    normals = vertex_normals(points[surface.faces.nodes], surface.faces.cells)
    np.testing.assert_allclose(np.sort(np.abs(normals), axis=1), np.tile([0.0, 0, 1], (54, 1)), atol=1e-12)


def test_a_round_body_has_no_sharp_edges() -> None:
    points, cells = block((6, 6, 6), (2.0, 2.0, 2.0))
    q = points - 1.0
    length = np.linalg.norm(q, axis=1, keepdims=True)
    ball = q * np.abs(q).max(axis=1, keepdims=True) / np.where(length > 0, length, 1.0)
    p2, c2 = quadratic(ball, cells)
    for name, p, c in (("tetra", ball, cells), ("tetra10", p2, c2)):
        surface = extract_surface(p, [(name, c)])
        assert len(surface.outline.cells) < 0.1 * surface.n_faces
        normals = vertex_normals(p[surface.faces.nodes], surface.faces.cells)
        outward = p[surface.faces.nodes] / np.linalg.norm(p[surface.faces.nodes], axis=1, keepdims=True)
        assert np.einsum("ij,ij->i", normals, outward).min() > 0.9


def test_quadratic_faces_become_four_triangles() -> None:
    points, cells = quadratic(*block((2, 1, 1), (2.0, 1.0, 1.0)))
    surface = extract_surface(points, [("tetra10", cells)])
    assert surface.n_faces == 4 * 2 * (2 + 2 + 1) * 2
    assert enclosed_volume(points, surface.faces) == pytest.approx(2.0)
    # A node on the middle of an edge, moved out, moves the surface.
    moved = points * [1.0, 1.0, 1.0]
    moved[np.argmin(np.linalg.norm(points - [0.5, 0.5, 1.0], axis=1))] += [0, 0, 0.5]
    assert enclosed_volume(moved, surface.faces) > 2.01
    # Edges are those of the elements, in two halves each, not those of the small triangles.
    _, straight = block((2, 1, 1), (2.0, 1.0, 1.0))
    linear = extract_surface(points, [("tetra", straight)])
    assert len(surface.edges.cells) == 2 * len(linear.edges.cells)


def test_mixed_blocks_count_cells_over_all_of_them() -> None:
    points, cells = block((1, 1, 1), (1.0, 1.0, 1.0))
    points = np.concatenate([points, [[2.0, 0, 0], [3, 0, 0], [3, 1, 0], [2, 1, 0]]])
    blocks = [
        ("line", np.array([[8, 9]])),
        ("tetra", cells),
        ("triangle", np.array([[8, 9, 10], [8, 10, 11]])),
        ("line", np.array([[10, 11], [11, 8]])),
    ]
    surface = extract_surface(points, blocks)
    assert surface.line_cells.tolist() == [0, 9, 10]
    assert points[surface.lines.nodes[surface.lines.cells[0]]].tolist() == [[2, 0, 0], [3, 0, 0]]
    assert set(surface.face_cells) == set(range(1, 9))
    assert surface.n_faces == 12 + 2


def test_tetrahedra_of_two_blocks_that_share_nodes_have_no_face_between() -> None:
    points, cells = block((2, 1, 1), (2.0, 1.0, 1.0))
    left = points[cells].mean(axis=1)[:, 0] < 1.0
    whole = extract_surface(points, [("tetra", cells)])
    parts = extract_surface(points, [("tetra", cells[left]), ("tetra", cells[~left])])
    assert parts.n_faces == whole.n_faces
    assert enclosed_volume(points, parts.faces) == pytest.approx(2.0)


def test_the_outline_of_a_membrane_is_its_border_however_it_is_oriented() -> None:
    n = np.arange(5.0)
    points = np.stack([*np.meshgrid(n, n, indexing="ij"), np.zeros((5, 5))], axis=-1).reshape(-1, 3)
    number = np.arange(25).reshape(5, 5)
    a, b, c, d = (number[i : 4 + i, j : 4 + j].ravel() for i, j in ((0, 0), (1, 0), (1, 1), (0, 1)))
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    for flipped in (0, 7):
        triangles[:flipped] = triangles[:flipped, ::-1]
        surface = extract_surface(points, [("triangle", triangles)])
        ends = points[surface.outline.nodes[surface.outline.cells]]
        assert len(ends) == 16
        assert np.all(((ends[:, 0] == ends[:, 1]) & np.isin(ends[:, 0], [0.0, 4.0])).any(axis=1))
        normals = vertex_normals(points[surface.faces.nodes], surface.faces.cells)
        np.testing.assert_allclose(np.abs(normals[:, 2]), 1.0)


def test_nothing_to_see() -> None:
    surface = extract_surface(np.zeros((3, 3)), [])
    assert surface.n_faces == 0
    assert len(surface.nodes) == 0
    assert len(surface.outline.cells) == 0


def test_point_numbers_beyond_packing() -> None:
    # Three numbers of this size no longer fit into one 64-bit key.
    points, cells = block((2, 1, 1), (2.0, 1.0, 1.0))
    far = np.zeros((3_000_000, 3))
    far[-len(points) :] = points
    surface = extract_surface(far, [("tetra", cells + len(far) - len(points))])
    assert enclosed_volume(far, surface.faces) == pytest.approx(2.0)


@pytest.mark.parametrize("limit", [50, 400, 1500])
def test_thinning_keeps_the_shape_and_the_bound(limit: int) -> None:
    points, cells = block((14, 14, 14), (1.0, 1.0, 1.0))
    surface = extract_surface(points, [("tetra", cells)])
    assert surface.n_faces == 2352
    coarse, kept = coarsen(points, surface.faces, limit)
    assert 0.15 * limit < len(coarse.cells) <= limit
    assert len(kept) == len(coarse.cells)
    assert set(coarse.nodes) <= set(surface.faces.nodes)
    shape = points[coarse.nodes]
    assert np.all(shape.min(axis=0) <= 0.3)
    assert np.all(shape.max(axis=0) >= 0.7)
    sides = coarse.cells
    assert np.all((sides[:, 0] != sides[:, 1]) & (sides[:, 1] != sides[:, 2]) & (sides[:, 2] != sides[:, 0]))


def test_thinning_leaves_a_small_surface_alone() -> None:
    points, cells = block((2, 2, 2), (1.0, 1.0, 1.0))
    faces = extract_surface(points, [("tetra", cells)]).faces
    assert coarsen(points, faces, 48)[0] is faces
