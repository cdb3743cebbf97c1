"""Particles on lattices inside of shapes."""

from __future__ import annotations

import numpy as np
import pytest

from femdeform.contact.obstacles import Box, Sphere
from femdeform.errors import InputError
from femdeform.mpm.particle_sampling import sample_particles
from femdeform.mpm.shapes import ClosedSurface, Ellipsoid

DX = 0.1


@pytest.mark.parametrize("dim", [2, 3])
def test_a_box_is_filled_exactly(dim: int) -> None:
    low, high = np.full(dim, 0.13), np.full(dim, 0.13) + np.array([0.52, 0.31, 0.4])[:dim]
    particles = sample_particles(Box(low, high, False), DX, 2, 1000.0)
    counts = [10, 6, 8][:dim]
    assert particles.n == np.prod(counts)
    assert particles.volume.sum() == pytest.approx(np.prod(high - low), rel=1e-13)
    assert particles.mass.sum() == pytest.approx(1000.0 * np.prod(high - low), rel=1e-13)
    np.testing.assert_allclose(particles.x.mean(axis=0), 0.5 * (low + high), atol=1e-14)
    half = 0.5 * (high - low) / np.array(counts)
    np.testing.assert_allclose(particles.x.min(axis=0), low + half, atol=1e-14)


@pytest.mark.parametrize("dim", [2, 3])
def test_round_bodies(dim: int) -> None:
    center, axes = np.array([0.5, 0.45, 0.6])[:dim], np.array([0.3, 0.2, 0.25])[:dim]
    content = {2: np.pi, 3: 4.0 / 3.0 * np.pi}[dim]
    ball = sample_particles(Sphere(center, 0.3, True), DX, 3, 10.0)
    assert np.linalg.norm(ball.x - center, axis=1).max() < 0.3
    assert ball.volume.sum() == pytest.approx(content * 0.3**dim, rel=0.02)
    egg = sample_particles(Ellipsoid(center, axes), DX, 3, 10.0)
    assert np.sum(((egg.x - center) / axes) ** 2, axis=1).max() < 1.0
    assert egg.volume.sum() == pytest.approx(content * np.prod(axes), rel=0.03)
    # The lattice is that of the grid.
    np.testing.assert_allclose((ball.x * 3 / DX) % 1.0, 0.5, atol=1e-9)


def test_a_closed_surface() -> None:
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.5, 0.4], [0.0, 1.0]])
    edges = np.column_stack([np.arange(5), np.roll(np.arange(5), -1)])
    particles = sample_particles(ClosedSurface(points, edges), 0.05, 2, 2.0)
    assert particles.volume.sum() == pytest.approx(0.7, rel=0.02)
    assert not np.any((np.abs(particles.x[:, 0] - 0.5) < 0.05) & (particles.x[:, 1] > 0.6))


@pytest.mark.parametrize("dim", [2, 3])
def test_jitter(dim: int) -> None:
    box = Box(np.zeros(dim), np.full(dim, 0.5), False)
    plain = sample_particles(box, DX, 2, 1.0)
    first, again, other = (sample_particles(box, DX, 2, 1.0, 1.0, seed) for seed in (4, 4, 5))
    np.testing.assert_array_equal(first.x, again.x)
    assert np.abs(first.x - other.x).max() > 0.01
    assert 0.015 < np.abs(first.x - plain.x).max() <= 0.25 * DX
    assert np.all((first.x > 0.0) & (first.x < 0.5))
    small = sample_particles(box, DX, 2, 1.0, 0.2, 4)
    assert np.abs(small.x - plain.x).max() <= 0.05 * DX


def test_bad_input() -> None:
    ball = Sphere(np.full(2, 0.5), 0.3, False)
    for numbers in ((0, 1.0, 0.0), (2, 0.0, 0.0), (2, 1.0, 1.5)):
        with pytest.raises(InputError, match="expected per_axis >= 1"):
            sample_particles(ball, DX, *numbers)
    with pytest.raises(InputError, match="no point of the lattice"):
        sample_particles(Sphere(np.full(2, 0.5), 1e-3, False), DX, 1, 1.0)
