"""Random samples of the surface of points."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from femdeform.jit import set_threads
from femdeform.mpm.level_set import Facets, union_of_spheres
from femdeform.mpm.surface_sampling import SurfaceSampler, sample_facets

Array = NDArray[np.float64]
SPACING = 0.1


def cloud(dim: int, seed: int = 0, n: int = 250) -> Array:
    """Points in a box around the origin."""
    return np.asarray(np.random.default_rng(seed).uniform(-0.3, 0.3, (n, dim)))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("density", [None, 0.2, 20.0])
def test_areas_are_those_of_the_contour_and_close(dim: int, density: float | None) -> None:
    x = cloud(dim)
    samples = SurfaceSampler(SPACING, density).sample(x, 7)
    (level,) = union_of_spheres(x, SPACING)
    facets = level.facets()
    assert samples.n >= facets.n
    assert samples.measure.sum() == pytest.approx(facets.measure.sum(), rel=1e-13)
    total = (samples.normals * samples.measure[:, None]).sum(axis=0)
    assert np.abs(total).max() < 1e-13 * samples.measure.sum()
    assert np.all(samples.measure > 0.0)


@pytest.mark.parametrize("dim", [2, 3])
def test_owners_are_the_closest_points_in_order(dim: int) -> None:
    x = cloud(dim)
    samples = SurfaceSampler(SPACING).sample(x, 0)
    assert np.all(np.diff(samples.owner) >= 0)
    away = np.linalg.norm(samples.points - x[samples.owner], axis=1)
    np.testing.assert_allclose(away, cKDTree(x).query(samples.points)[0], rtol=1e-12)
    assert away.max() < 2.0 * SPACING


def test_number_of_samples_follows_the_density() -> None:
    x = cloud(2, n=3000)
    for density in (5.0, 40.0):
        numbers = [SurfaceSampler(SPACING, density).sample(x, step) for step in range(20)]
        mean = np.mean([samples.n for samples in numbers])
        (level,) = union_of_spheres(x, SPACING)
        expected = density * level.facets().measure / SPACING
        # E max(1, Poisson) = lambda + exp(-lambda).
        assert mean == pytest.approx((expected + np.exp(-expected)).sum(), rel=0.03)


def test_samples_are_uniform_on_a_triangle() -> None:
    corners = np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
    facets = Facets(corners, np.array([[0.0, 0.0, 1.0]]), np.array([0.5]))
    _, points = sample_facets(facets, 800_000.0, np.random.default_rng(0))
    np.testing.assert_allclose(points.mean(axis=0), [1 / 3, 1 / 3, 0.0], atol=2e-3)
    # Barycentric coordinates drawn at random and normalised, which crowd in the middle, have 0.032.
    np.testing.assert_allclose(np.var(points[:, :2], axis=0), 1 / 18, atol=5e-4)
    corner_part = np.mean(points[:, 0] + points[:, 1] < 0.1)
    assert corner_part == pytest.approx(0.01, rel=0.1)


def test_integrals_over_the_surface_have_no_bias() -> None:
    """The mean over many draws is the integral over the facets, also where each has one sample only."""
    x = cloud(3, n=30)
    (level,) = union_of_spheres(x, SPACING)
    facets = level.facets()
    integral = (facets.corners[:, :, 0].mean(axis=1) * facets.measure).sum()
    draws = []
    for step in range(400):
        samples = SurfaceSampler(SPACING, 1.0).sample(x, step)
        draws.append((samples.points[:, 0] * samples.measure).sum())
    error = np.std(draws) / np.sqrt(len(draws))
    assert abs(np.mean(draws) - integral) < 4.0 * error
    assert error < 1e-3 * SPACING * facets.measure.sum()


@pytest.mark.parametrize("dim", [2, 3])
def test_samples_depend_on_seed_and_step_only(dim: int) -> None:
    x = cloud(dim)
    sampler = SurfaceSampler(SPACING, seed=5)
    before = [sampler.sample(x, step) for step in range(3)]
    again = SurfaceSampler(SPACING, seed=5).sample(x, 2)
    for name in ("points", "normals", "measure", "owner"):
        np.testing.assert_array_equal(getattr(before[2], name), getattr(again, name))
    others = [before[1], SurfaceSampler(SPACING, seed=6).sample(x, 2)]
    assert all(other.n != again.n or not np.allclose(other.points, again.points) for other in others)


@pytest.mark.parametrize("dim", [2, 3])
def test_number_of_threads_changes_nothing(dim: int) -> None:
    x = cloud(dim, n=2000)
    one, two = [], []
    try:
        for threads, out in ((1, one), (2, two)):
            set_threads(threads)
            out.append(SurfaceSampler(SPACING).sample(x, 1))
    finally:
        set_threads(None)
    np.testing.assert_array_equal(one[0].points, two[0].points)
    np.testing.assert_array_equal(one[0].owner, two[0].owner)


@pytest.mark.parametrize("dim", [2, 3])
def test_point_alone_has_samples(dim: int) -> None:
    for step, x in enumerate(np.random.default_rng(5).uniform(-0.2, 0.2, (50, 1, dim))):
        samples = SurfaceSampler(SPACING, density=0.01).sample(x, step)
        assert samples.n >= 2**dim // 2
        assert np.all(samples.owner == 0)


def test_bad_input() -> None:
    with pytest.raises(ValueError, match="spacing"):
        SurfaceSampler(0.0)
    with pytest.raises(ValueError, match="density"):
        SurfaceSampler(SPACING, density=0.0)
    with pytest.raises(ValueError, match="no points"):
        SurfaceSampler(SPACING).sample(np.empty((0, 3)), 0)
