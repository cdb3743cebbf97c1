"""Union of spheres on the grid, and its contour."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree

from femdeform.mpm import level_set
from femdeform.mpm.level_set import RADII, Facets, LevelSet, marching_squares, union_of_spheres, visible_volume

Array = NDArray[np.float64]
SPACING = 0.1


def cloud(dim: int, seed: int) -> Array:
    """Points of any number, as dense as they come, on both sides of the origin."""
    rng = np.random.default_rng(seed)
    return np.asarray(rng.random((int(rng.integers(1, 300)), dim)) * rng.uniform(0.05, 1.2) - 0.3)


def ball(dim: int, radius: float, per_cell: int = 3) -> Array:
    """Points on a lattice in a disc or ball around the origin, `per_cell` an axis in each cell."""
    q = (np.arange(-40, 40) + 0.5) * SPACING / per_cell
    x = np.stack(np.meshgrid(*[q] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    return np.asarray(x[np.linalg.norm(x, axis=1) < radius])


def closure(facets: Facets) -> float:
    """Size of sum n dA over that of the surface."""
    return float(np.abs((facets.normals * facets.measure[:, None]).sum(axis=0)).max() / facets.measure.sum())


def volume(facets: Facets) -> float:
    """Content of a closed surface by the divergence theorem, negative with normals inward."""
    middle = facets.corners.mean(axis=1)
    return float((np.einsum("ia,ia->i", middle, facets.normals) * facets.measure).sum() / middle.shape[1])


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("seed", range(8))
def test_values_are_distances_to_the_closest_point(dim: int, seed: int) -> None:
    x = cloud(dim, seed)
    (level,) = union_of_spheres(x, SPACING)
    axes = [np.arange(n) + low for n, low in zip(level.values.shape, level.low, strict=True)]
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, dim)
    far = cKDTree(x / SPACING).query(nodes)[0].reshape(level.values.shape)
    np.testing.assert_allclose(level.values[far < 2.0], far[far < 2.0] - RADII[dim], atol=1e-6 if dim == 3 else 1e-13)
    assert np.all(level.values[far >= 2.0] > 0.0)
    for axis in range(dim):
        assert np.all(np.take(level.values, [0, -1], axis=axis) > 0.0)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("seed", range(8))
def test_contour_is_closed_and_looks_outward(dim: int, seed: int) -> None:
    x = cloud(dim, seed)
    (level,) = union_of_spheres(x, SPACING)
    facets = level.facets()
    assert closure(facets) < 1e-13
    assert volume(facets) > 0.0
    assert np.all(facets.measure > 0.0)
    np.testing.assert_allclose(np.linalg.norm(facets.normals, axis=1), 1.0, atol=1e-13)
    # The level set grows along the normals. (Values across a cell are not linear: not on every last facet.)
    middle = facets.corners.mean(axis=1)
    beside = [middle + sign * 0.02 * SPACING * facets.normals for sign in (-1.0, 1.0)]
    below, above = (map_coordinates(level.values, (y / SPACING - level.low).T, order=1) for y in beside)
    assert facets.measure[above <= below].sum() < 1e-2 * facets.measure.sum()


@pytest.mark.parametrize("dim", [2, 3])
def test_point_alone_always_has_a_surface(dim: int) -> None:
    for x in np.random.default_rng(5).uniform(-0.2, 0.2, (200, 1, dim)):
        (level,) = union_of_spheres(x, SPACING)
        facets = level.facets()
        assert facets.n >= 2**dim // 2
        assert closure(facets) < 1e-13
        assert 0.0 < volume(facets) < 5.0 * SPACING**dim


@pytest.mark.parametrize(("dim", "low", "high"), [(2, 0.52, 0.61), (3, 0.67, 0.77)])
def test_contour_of_a_ball_lies_a_radius_less_half_a_gap_outside(dim: int, low: float, high: float) -> None:
    """r - 1/6 of a cell, with three points a cell: 0.56 cells in 2D, 0.70 in 3D."""
    radius = 0.83
    (level,) = union_of_spheres(ball(dim, radius), SPACING)
    content = volume(level.facets())
    outer = np.sqrt(content / np.pi) if dim == 2 else (3.0 * content / (4.0 * np.pi)) ** (1.0 / 3.0)
    assert low < (outer - radius) / SPACING < high
    area = 2.0 * np.pi * outer if dim == 2 else 4.0 * np.pi * outer**2
    assert level.facets().measure.sum() == pytest.approx(area, rel=0.02 if dim == 2 else 0.05)


def test_hollow_body_has_an_inner_surface_that_looks_into_the_hole() -> None:
    x = ball(3, 0.8)
    x = x[np.linalg.norm(x, axis=1) > 0.4]
    (level,) = union_of_spheres(x, SPACING)
    facets = level.facets()
    middle = facets.corners.mean(axis=1)
    outward = np.einsum("ia,ia->i", middle, facets.normals)
    inner = np.linalg.norm(middle, axis=1) < 0.6
    assert np.all(outward[inner] < 0.0)
    assert np.all(outward[~inner] > 0.0)
    assert facets.measure[inner].sum() == pytest.approx(4.0 * np.pi * 0.34**2, rel=0.15)


@pytest.mark.parametrize(("value", "n_pieces"), [(-0.4, 2), (-2.0, 1)])
@pytest.mark.parametrize("flip", [False, True])
def test_saddles_follow_the_mean(value: float, n_pieces: int, flip: bool) -> None:
    """Two negative corners of a square are one piece if the mean is negative, two otherwise."""
    values = np.ones((4, 4))
    values[1, 1] = values[2, 2] = value
    values = values[::-1] if flip else values
    segments = marching_squares(values)
    starts = {tuple(p): i for i, p in enumerate(segments[:, 0])}
    # Every segment ends where exactly one begins.
    after = np.array([starts[tuple(p)] for p in segments[:, 1]])
    assert len(starts) == len(segments)
    pieces, seen = 0, np.zeros(len(segments), dtype=bool)
    for i in range(len(segments)):
        pieces += not seen[i]
        while not seen[i]:
            seen[i] = True
            i = after[i]
    assert pieces == n_pieces
    area = 0.5 * np.sum(segments[:, 0, 0] * segments[:, 1, 1] - segments[:, 1, 0] * segments[:, 0, 1])
    assert area > 0.0


def test_marching_squares_agree_with_scikit_image() -> None:
    from skimage.measure import find_contours

    rng = np.random.default_rng(1)
    a, b = np.meshgrid(np.linspace(0, 3, 40), np.linspace(0, 2, 30), indexing="ij")
    values = sum(
        rng.standard_normal() * np.cos(k * a + rng.random()) * np.cos(m * b) for k in range(3) for m in range(3)
    )
    edge = np.ones((42, 32))
    edge[1:-1, 1:-1] = values
    corners = [edge[i : i + 41, j : j + 31] < 0.0 for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))]
    assert not np.any((corners[0] == corners[2]) & (corners[1] == corners[3]) & (corners[0] != corners[1]))
    segments = marching_squares(edge)
    ours = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum()
    theirs = sum(np.linalg.norm(np.diff(line, axis=0), axis=1).sum() for line in find_contours(edge, 0.0))
    assert ours == pytest.approx(theirs, rel=1e-12)


def test_nodes_of_value_zero_leave_the_contour_closed() -> None:
    values = np.ones((5, 5))
    values[2, 2] = -1.0
    values[2, 3] = values[1, 1] = 0.0
    segments = marching_squares(values)
    np.testing.assert_allclose((segments[:, 1] - segments[:, 0]).sum(axis=0), 0.0, atol=1e-15)


@pytest.mark.parametrize("dim", [2, 3])
def test_sets_far_apart_get_boxes_of_their_own(dim: int, monkeypatch: pytest.MonkeyPatch) -> None:
    shift = np.zeros(dim)
    shift[0], shift[-1] = 40.0, -13.0
    parts = [cloud(dim, 1), cloud(dim, 2) + shift, cloud(dim, 3) - shift]
    x = np.concatenate(parts)[np.random.default_rng(0).permutation(sum(len(part) for part in parts))]
    monkeypatch.setattr(level_set, "_SMALL_BOX", 10)
    levels = union_of_spheres(x, SPACING)
    assert len(levels) >= 3
    n_nodes = sum(level.values.size for level in levels)
    assert n_nodes < 3 * 20**dim
    for part in parts:
        (alone,) = [LevelSet(part, np.arange(len(part)), SPACING, RADII[dim])]
        mine = [level for level in levels if np.all(np.abs(level.low * SPACING - part.mean(axis=0)) < 2.0)]
        assert sum(level.facets().n for level in mine) == alone.facets().n
        total = sum(level.facets().measure.sum() for level in mine)
        assert total == pytest.approx(alone.facets().measure.sum(), rel=1e-5)


@pytest.mark.parametrize("dim", [2, 3])
def test_closest_points_are_those_of_a_tree(dim: int) -> None:
    x = cloud(dim, 4)
    (level,) = union_of_spheres(x, SPACING)
    samples = level.facets().corners[:, 0]
    owner = level.closest(samples)
    np.testing.assert_allclose(np.linalg.norm(samples - x[owner], axis=1), cKDTree(x).query(samples)[0], rtol=1e-12)
    # Of two points at one place the first is taken.
    twice = np.concatenate([x, x])
    (level,) = union_of_spheres(twice, SPACING)
    np.testing.assert_array_equal(level.closest(samples), owner)
    with pytest.raises(ValueError, match="not near any point"):
        level.closest(np.full((1, dim), 30.0))


@pytest.mark.parametrize(
    ("points", "radius", "message"),
    [
        (np.empty((0, 2)), None, "no points"),
        (np.array([[0.0, np.nan]]), None, "not finite"),
        (np.zeros((1, 2)), 0.7, "radius"),
        (np.zeros((1, 3)), 1.0, "radius"),
        (np.array([[0.0, 0.0, 0.0], [1e17, 1e17, 1e17]]), None, "too far apart"),
    ],
)
def test_bad_input(points: Any, radius: float | None, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        union_of_spheres(points, SPACING, radius)


@pytest.mark.parametrize("dim", [2, 3])
def test_visible_volume(dim: int) -> None:
    """That of a ball, anywhere; and the room that is left to points which have come together."""
    x = ball(dim, 0.8)
    at_rest = np.full(len(x), (SPACING / 3) ** dim)
    exact = {2: np.pi * 0.8**2, 3: 4.0 / 3.0 * np.pi * 0.8**3}[dim]
    assert at_rest.sum() == pytest.approx(exact, rel=0.01)
    seen = visible_volume(x, at_rest, SPACING)
    assert seen == pytest.approx(exact, rel=0.04)
    closer = visible_volume(0.9 * x, at_rest, SPACING)
    assert closer / seen == pytest.approx(0.9**dim, rel=0.02)
    assert visible_volume(x + 3.0, at_rest, SPACING) == pytest.approx(seen, rel=1e-3)
