"""Melting and freezing of material points."""

from __future__ import annotations

import numpy as np
import pytest

from femdeform.mpm.particles import LIQUID, SOLID, Particles
from femdeform.mpm.phase_change import Melting, change_phase


def points(temperatures: list[float], phase: int) -> Particles:
    """Deformed points with a velocity field."""
    n = len(temperatures)
    particles = Particles.at(np.zeros((n, 2)), np.ones(n), np.full(n, 0.5))
    particles.temperature = np.array(temperatures)
    particles.phase[:] = phase
    particles.J[:] = 0.9
    particles.F[:] = [[1.2, 0.1], [0.0, 0.8]]
    particles.v[:] = 3.0
    particles.affine[:] = 2.0
    return particles


def test_points_change_beyond_the_band_only() -> None:
    melting = Melting(302.0, 304.0)
    warm = points([301.0, 303.0, 303.9, 304.1, 310.0], SOLID)
    assert change_phase(warm, melting) == (2, 0)
    np.testing.assert_array_equal(warm.phase, [SOLID, SOLID, SOLID, LIQUID, LIQUID])
    np.testing.assert_array_equal(warm.J, [0.9, 0.9, 0.9, 1.0, 1.0])
    cold = points([301.0, 301.9, 302.1, 303.0, 310.0], LIQUID)
    assert change_phase(cold, melting) == (0, 2)
    np.testing.assert_array_equal(cold.phase, [SOLID, SOLID, LIQUID, LIQUID, LIQUID])
    np.testing.assert_array_equal(cold.F[:2], np.tile(np.eye(2), (2, 1, 1)))
    np.testing.assert_array_equal(cold.F[2:], np.tile([[1.2, 0.1], [0.0, 0.8]], (3, 1, 1)))
    for particles in (warm, cold):
        np.testing.assert_array_equal(particles.v, 3.0)
        np.testing.assert_array_equal(particles.affine, 2.0)
        np.testing.assert_array_equal(particles.volume, 0.5)


def test_temperature_that_wavers_in_the_band_changes_nothing() -> None:
    melting, particles = Melting(302.0, 304.0), points([305.0], SOLID)
    changes = []
    for temperature in (305.0, 303.5, 302.5, 303.9, 302.1, 301.0, 303.9, 302.1, 304.1):
        particles.temperature[:] = temperature
        changes.append(change_phase(particles, melting))
    assert changes == [(1, 0), (0, 0), (0, 0), (0, 0), (0, 0), (0, 1), (0, 0), (0, 0), (1, 0)]


def test_one_melting_point_and_members() -> None:
    particles = points([302.0, 303.0, 304.0, 304.0], SOLID)
    assert change_phase(particles, Melting(303.0, 303.0), np.array([True, True, True, False])) == (1, 0)
    np.testing.assert_array_equal(particles.phase, [SOLID, SOLID, LIQUID, SOLID])


def test_bad_input() -> None:
    with pytest.raises(ValueError, match="solidus"):
        Melting(303.0, 302.0)
    with pytest.raises(ValueError, match="latent heat of"):
        Melting(302.0, 303.0, -1.0)
    with pytest.raises(ValueError, match="above the solidus"):
        Melting(303.0, 303.0, 1.0)
