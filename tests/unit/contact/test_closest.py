"""Closest points of surfaces against what a fine sampling of them finds."""

from __future__ import annotations

import numpy as np
import pytest

from femdeform.contact.closest import closest_points


def sampled(corners: np.ndarray, n: int = 60) -> np.ndarray:
    """Points on every facet, (n_facets, n_samples, dim)."""
    grid = np.linspace(0.0, 1.0, n)
    if corners.shape[1] == 2:
        weights = np.stack([1.0 - grid, grid], axis=1)
    else:
        u, v = (g.ravel() for g in np.meshgrid(grid, grid))
        inside = u + v <= 1.0 + 1e-12
        weights = np.stack([1.0 - u - v, u, v], axis=1)[inside]
    return np.einsum("sk,nkc->nsc", weights, corners)


@pytest.mark.parametrize(("k", "dim"), [(2, 2), (2, 3), (3, 3)])
def test_no_sample_is_closer(k: int, dim: int) -> None:
    rng = np.random.default_rng(k + dim)
    # Facets of very different size, so that the closest one need not be the one with the closest centre.
    corners = rng.uniform(-1.0, 1.0, (40, 1, dim)) + rng.standard_normal((40, k, dim)) * rng.uniform(
        0.02, 1, (40, 1, 1)
    )
    points = rng.uniform(-2.0, 2.0, (200, dim))
    facets, weights, distance = closest_points(points, corners)
    assert weights.min() >= 0.0
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-14)
    at = np.einsum("nk,nkc->nc", weights, corners[facets])
    np.testing.assert_allclose(np.linalg.norm(at - points, axis=1), distance, atol=1e-14)
    everything = sampled(corners).reshape(-1, dim)
    best = np.linalg.norm(points[:, None] - everything[None], axis=2).min(axis=1)
    assert (distance <= best + 1e-12).all()
    # Samples are no more than a grid cell from the true closest point.
    assert (distance >= best - 0.1).all()


def test_facets_without_area_and_points_on_facets() -> None:
    corners = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]], [[5.0, 0, 0], [5.0, 0, 0], [5.0, 0, 0]]])
    facets, weights, distance = closest_points(np.array([[1.5, 1.0, 0.0], [5.0, 2.0, 0.0]]), corners)
    np.testing.assert_array_equal(facets, [0, 1])
    np.testing.assert_allclose(distance, [1.0, 2.0], rtol=1e-14)
    assert np.isfinite(weights).all()
    square = np.array([[[0.0, 0, 0], [1.0, 0, 0], [0.0, 1, 0]], [[1.0, 1, 0], [0.0, 1, 0], [1.0, 0, 0]]])
    facets, weights, distance = closest_points(np.array([[0.5, 0.5, 0.0], [0.0, 0.0, 0.0]]), square)
    # On the edge that two share, the lower number.
    np.testing.assert_array_equal(facets, [0, 0])
    np.testing.assert_allclose(distance, 0.0, atol=1e-16)
    np.testing.assert_allclose(weights, [[0, 0.5, 0.5], [1, 0, 0]], atol=1e-15)
