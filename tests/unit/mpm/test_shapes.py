"""Ellipsoids and closed surfaces: signed distances, normals, bounds."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from femdeform.contact.obstacles import Box, Sphere
from femdeform.mpm.shapes import ClosedSurface, Ellipsoid

Array = NDArray[np.float64]


def around(dim: int, n: int = 400, reach: float = 2.0) -> Array:
    return np.asarray(np.random.default_rng(dim).uniform(-reach, reach, (n, dim)))


@pytest.mark.parametrize("inside", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_an_ellipsoid_of_equal_axes_is_a_sphere(dim: int, inside: bool) -> None:
    center = np.array([0.3, -0.2, 0.1])[:dim]
    x = around(dim)
    found = Ellipsoid(center, np.full(dim, 0.8), inside).distance(x)
    expected = Sphere(center, 0.8, inside).distance(x)
    np.testing.assert_allclose(found[0], expected[0], atol=1e-12)
    np.testing.assert_allclose(found[1], expected[1], atol=1e-10)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_closest_point_of_an_ellipsoid(dim: int) -> None:
    """x - d n lies on the surface, the normal is the surface's there, and no point of a fine net is closer."""
    axes = np.array([0.5, 1.3, 0.9])[:dim]
    shape = Ellipsoid(np.zeros(dim), axes)
    x = np.vstack([around(dim), np.zeros((1, dim)), 0.3 * np.eye(dim)])
    distance, normal = shape.distance(x)
    foot = x - distance[:, None] * normal
    np.testing.assert_allclose(np.sum((foot / axes) ** 2, axis=1), 1.0, atol=1e-9)
    slope = foot / axes**2
    np.testing.assert_allclose(normal, slope / np.linalg.norm(slope, axis=1)[:, None], atol=1e-6)
    np.testing.assert_array_equal(distance < 0.0, np.sum((x / axes) ** 2, axis=1) < 1.0)
    directions = np.random.default_rng(1).standard_normal((20000, dim))
    net = axes * directions / np.linalg.norm(directions, axis=1)[:, None]
    nearest = np.array([np.linalg.norm(net - each, axis=1).min() for each in x])
    assert np.all(np.abs(distance) <= nearest + 1e-9)


@pytest.mark.parametrize("axes", [[1.0, 1.0, 1.0], [2.0, 1e-3, 1.0], [0.3, 0.1], [1e-3, 1.0]])
def test_flat_ellipsoids_and_points_near_their_middle(axes: list[float]) -> None:
    """The foot is on the surface and straight below the point to rounding; no point's answer depends on the others."""
    a, rng = np.array(axes), np.random.default_rng(2)
    scales = np.repeat([2.0, 0.5, 1e-6], 300)[:, None]
    x = rng.uniform(-1.0, 1.0, (900, a.size)) * a * scales
    distance, normal = Ellipsoid(np.zeros(a.size), a).distance(x)
    foot = x - distance[:, None] * normal
    slope = foot / a**2
    np.testing.assert_allclose(np.sum((foot / a) ** 2, axis=1), 1.0, atol=1e-10)
    np.testing.assert_allclose(normal, slope / np.linalg.norm(slope, axis=1)[:, None], atol=1e-8)
    for k in (0, 400, 800):
        alone = Ellipsoid(np.zeros(a.size), a).distance(x[k : k + 1])
        assert alone[0][0] == distance[k]
        np.testing.assert_array_equal(alone[1][0], normal[k])


def surface(dim: int) -> tuple[Array, NDArray[np.int64]]:
    """The surface of the box [0, 1] x [0, 2] (x [0, 3])."""
    corners = np.array(list(np.ndindex(*([2] * dim))), dtype=float) * np.array([1.0, 2.0, 3.0])[:dim]
    if dim == 2:
        return corners, np.array([[0, 1], [1, 3], [3, 2], [2, 0]])
    faces = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]]
    return corners, np.array([t for a, b, c, d in faces for t in ([a, b, c], [a, c, d])])


@pytest.mark.parametrize("inside", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_closed_surface_is_the_box_it_bounds(dim: int, inside: bool) -> None:
    high = np.array([1.0, 2.0, 3.0])[:dim]
    x = around(dim, 2000, 3.5)
    shape = ClosedSurface(*surface(dim), inside)
    distance, normal = shape.distance(x)
    expected = Box(np.zeros(dim), high, inside).distance(x)
    np.testing.assert_allclose(distance, expected[0], atol=1e-12)
    # Inside, several faces may be equally close.
    sure = np.abs(distance) > 1e-9
    np.testing.assert_allclose(normal[sure], expected[1][sure], atol=1e-9)
    for found, wanted in zip(shape.bounds(), (np.zeros(dim), high), strict=True):
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("dim", [2, 3])
def test_on_a_closed_surface_the_normal_is_that_of_the_facet(dim: int) -> None:
    shape = ClosedSurface(*surface(dim))
    x = np.array([[0.3, 0.7, 3.0], [1.0, 0.7, 1.1]])
    if dim == 2:
        x = np.array([[0.3, 2.0], [1.0, 0.7]])
    distance, normal = shape.distance(x)
    np.testing.assert_allclose(distance, 0.0, atol=1e-14)
    np.testing.assert_allclose(normal, np.array([np.eye(dim)[-1], np.eye(dim)[0]]), atol=1e-12)


@pytest.mark.parametrize("n", [1, 7, 40])
def test_inside_of_a_fine_surface(n: int) -> None:
    """A net over a sphere: its points are told from those of the polyhedron by their radius."""
    u, v = np.meshgrid(np.linspace(0, np.pi, n + 3), np.linspace(0, 2 * np.pi, n + 4)[:-1], indexing="ij")
    points = np.stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)], -1).reshape(-1, 3)
    columns = u.shape[1]
    facets = []
    for i in range(u.shape[0] - 1):
        for j in range(columns):
            a, b = i * columns + j, i * columns + (j + 1) % columns
            facets += [[a, b, a + columns], [b, b + columns, a + columns]]
    shape = ClosedSurface(points, np.array(facets))
    # Also rays that meet corners and edges.
    x = np.vstack([around(3, 3000, 1.2), 0.4 * points, 1.01 * points, np.zeros((1, 3))])
    radius = np.linalg.norm(x, axis=1)
    inner = np.cos(np.pi / (n + 2)) * np.cos(np.pi / (n + 3)) * 0.999 if n > 1 else 0.2
    found = shape.contains(x)
    assert found[radius < inner].all()
    assert not found[radius > 1.0].any()
