"""Facets, edges and measures of small meshes whose answers are known."""

from __future__ import annotations

import numpy as np

from meshes.boundary import (
    area_vectors,
    boundary_facets,
    connected_parts,
    facet_counts,
    find_rows,
    measures,
    row_keys,
    signed_measures,
    unique_edges,
)

POINTS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
# Two tetrahedra glued along nodes 1 2 3; the second positively oriented.
TETS = np.array([[0, 1, 2, 3], [4, 2, 1, 3]])


def test_two_tetrahedra_share_one_facet() -> None:
    facets = boundary_facets(TETS)
    assert len(facets) == 6
    assert find_rows(facets, np.array([[3, 1, 2]]))[0] == -1
    assert facet_counts(TETS, np.array([[3, 1, 2], [0, 1, 2], [0, 1, 4]])).tolist() == [2, 1, 0]


def test_facets_face_outward_and_close_the_surface() -> None:
    facets = boundary_facets(TETS)
    normals = area_vectors(POINTS, facets)
    np.testing.assert_allclose(normals.sum(axis=0), 0.0, atol=1e-15)
    outward = POINTS[facets].mean(axis=1) - POINTS[np.unique(TETS)].mean(axis=0)
    assert np.all(np.einsum("ni,ni->n", normals, outward) > 0.0)


def test_facets_of_an_inverted_cell_face_outward_with_points() -> None:
    inverted = TETS.copy()
    inverted[1] = inverted[1, [0, 1, 3, 2]]
    facets = boundary_facets(inverted, POINTS)
    np.testing.assert_allclose(area_vectors(POINTS, facets).sum(axis=0), 0.0, atol=1e-15)
    assert np.abs(area_vectors(POINTS, boundary_facets(inverted)).sum(axis=0)).max() > 0.1


def test_edges_of_two_tetrahedra() -> None:
    edges = [f"{a}{b}" for a, b in unique_edges(TETS)]
    assert edges == ["01", "02", "03", "12", "13", "14", "23", "24", "34"]


def test_boundary_of_a_path_is_its_ends() -> None:
    assert boundary_facets(np.array([[3, 1], [1, 0], [0, 2]])).ravel().tolist() == [3, 2]


def test_measures() -> None:
    np.testing.assert_allclose(signed_measures(POINTS, TETS), [1.0 / 6.0, 1.0 / 3.0])
    np.testing.assert_allclose(measures(POINTS, np.array([[1, 2, 3]])), [np.sqrt(3.0) / 2.0])
    np.testing.assert_allclose(measures(POINTS, np.array([[0, 4]])), [np.sqrt(3.0)])
    flat = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    np.testing.assert_allclose(signed_measures(flat, np.array([[0, 1, 2], [0, 2, 1]])), [0.5, -0.5])


def test_keys_stay_exact_beyond_64_bits() -> None:
    # Four nodes of a mesh of 10^7 points do not fit one 64 bit number any more.
    generator = np.random.default_rng(3)
    rows = generator.integers(0, 10_000_000, size=(2000, 4))
    shuffled = generator.permuted(rows, axis=1)
    ours, theirs = row_keys(rows, shuffled)
    assert np.array_equal(ours, theirs)
    assert len(np.unique(ours)) == len(np.unique(np.sort(rows, axis=1), axis=0))
    assert np.array_equal(find_rows(rows, shuffled[::-1]), np.arange(2000)[::-1])


def test_parts_that_share_no_node() -> None:
    count, part = connected_parts(np.array([[0, 1], [3, 4], [1, 2]]), 6)
    assert count == 2
    assert part[0] == part[2] != part[1]
