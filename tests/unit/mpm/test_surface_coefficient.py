"""Surface tension of samples by temperature, region and wall; Young's relation."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from femdeform.contact.obstacles import Plane, Sphere
from femdeform.mpm.particles import LIQUID, Particles
from femdeform.mpm.surface_coefficient import (
    SurfaceTension,
    contact_angle,
    sample_temperatures,
    solid_liquid_coefficient,
    surface_coefficients,
    wall_distance,
)
from femdeform.mpm.surface_samples import SurfaceSamples
from femdeform.mpm.surface_sampling import SurfaceSampler
from femdeform.mpm.temperature_functions import Constant, Linear
from femdeform.mpm.walls import Wall

Array = NDArray[np.float64]


def drop(n: int = 200) -> tuple[Particles, SurfaceSamples]:
    """Liquid points in a box of two bodies, temperatures linear in place."""
    x = np.random.default_rng(0).uniform(-0.3, 0.3, (n, 2))
    particles = Particles.at(x, np.ones(n), np.ones(n))
    particles.phase[:] = LIQUID
    particles.body[x[:, 0] > 0.0] = 1
    particles.temperature = 300.0 + 40.0 * x[:, 1]
    particles.temperature_gradient[:, 1] = 40.0
    return particles, SurfaceSampler(0.1).sample(x, 0)


def test_temperature_at_a_sample_follows_the_gradient() -> None:
    particles, samples = drop()
    np.testing.assert_allclose(sample_temperatures(samples, particles), 300.0 + 40.0 * samples.points[:, 1])


def test_body_temperature_and_region_choose_the_coefficient() -> None:
    particles, samples = drop()
    y = samples.points[:, 1]
    regions = ((lambda p: p[:, 1] > 0.2, Constant(0.0)), (lambda p: p[:, 1] > 0.1, Constant(7.0)))
    tensions = [SurfaceTension(Linear(1.0, 0.01, 300.0)), SurfaceTension(Constant(0.5), regions=regions)]
    found = surface_coefficients(samples, particles, tensions)
    second = particles.body[samples.owner] == 1
    assert second.any()
    assert not second.all()
    np.testing.assert_allclose(found.k[~second], 1.0 + 0.4 * y[~second])
    expected = np.where(y > 0.2, 0.0, np.where(y > 0.1, 7.0, 0.5))
    np.testing.assert_array_equal(found.k[second], expected[second])
    assert not found.is_on_wall.any()
    alone = surface_coefficients(samples, particles, [None, tensions[1]])
    np.testing.assert_array_equal(alone.k, np.where(second, found.k, 0.0))
    with pytest.raises(ValueError, match="a body has number 1"):
        surface_coefficients(samples, particles, tensions[:1])


def test_samples_below_a_wall_are_between_solid_and_liquid() -> None:
    particles, samples = drop()
    walls = [
        Wall(Plane(np.array([0.0, -0.2]), np.array([0.0, 1.0])), np.zeros(2), 0.0),
        Wall(Sphere(np.array([0.4, 1.0]), 0.2, inside=False), np.array([0.0, -0.5]), 0.0),
    ]
    distance = wall_distance(walls, samples.points, 1.6)
    moved = np.linalg.norm(samples.points - [0.4, 0.2], axis=1) - 0.2
    np.testing.assert_allclose(distance, np.minimum(samples.points[:, 1] + 0.2, moved))
    tension = SurfaceTension(Constant(2.0), solid_liquid=Constant(-1.0))
    found = surface_coefficients(samples, particles, [tension, tension], distance)
    assert 0 < found.is_on_wall.sum() < samples.n
    np.testing.assert_array_equal(found.is_on_wall, distance < 0.0)
    np.testing.assert_array_equal(found.k, np.where(distance < 0.0, -1.0, 2.0))
    # Without a coefficient of its own a wet wall is as the free surface; without walls there is no wet wall.
    same = surface_coefficients(samples, particles, [SurfaceTension(Constant(2.0))] * 2, distance)
    np.testing.assert_array_equal(same.k, 2.0)
    assert np.all(np.isinf(wall_distance([], samples.points, 0.0)))


def test_solid_points_have_no_tension_unless_asked() -> None:
    particles, samples = drop()
    particles.phase[particles.x[:, 1] < 0.0] = 0
    solid = particles.phase[samples.owner] == 0
    none, all_of_it = (
        surface_coefficients(samples, particles, [SurfaceTension(Constant(2.0), on_solid=flag)] * 2)
        for flag in (False, True)
    )
    np.testing.assert_array_equal(none.k, np.where(solid, 0.0, 2.0))
    np.testing.assert_array_equal(all_of_it.k, 2.0)


def test_tension_without_a_lower_bound_of_energy_is_refused() -> None:
    particles, samples = drop()
    with pytest.raises(ValueError, match=r"k_LG = -0\.1 N/m"):
        surface_coefficients(samples, particles, [SurfaceTension(Constant(-0.1))] * 2)
    wet = np.full(samples.n, -1.0)
    film = SurfaceTension(Constant(1.0), solid_liquid=Constant(-1.5))
    with pytest.raises(ValueError, match="film on the wall"):
        surface_coefficients(samples, particles, [film] * 2, wet)
    # Off the wall it does not matter.
    assert surface_coefficients(samples, particles, [film] * 2, -wet).k.min() == 1.0


@pytest.mark.parametrize("degrees", [0.0, 45.0, 90.0, 135.0, 180.0])
def test_young_angles(degrees: float) -> None:
    k_sl = solid_liquid_coefficient(np.radians(degrees), 2.0)
    assert np.degrees(contact_angle(k_sl, 2.0)) == pytest.approx(degrees, abs=1e-5)


def test_young_minimises_the_energy_of_a_cap() -> None:
    """The drop of given area with the least k_LG times its arc plus k_SL times its base."""
    angles = np.linspace(0.2, np.pi - 0.2, 20001)
    radius = 1.0 / np.sqrt(angles - np.sin(angles) * np.cos(angles))
    for k_sl in (-1.2, 0.3, 1.5):
        energy = 2.0 * 2.0 * radius * angles + k_sl * 2.0 * radius * np.sin(angles)
        assert angles[np.argmin(energy)] == pytest.approx(contact_angle(k_sl, 2.0), abs=5e-4)


def cap_points(angle: float, spacing: float, shift: Array) -> Array:
    """Points (n, 3), two a cell and axis, of a cap on the plane y = 0 with the volume of half a unit ball."""
    cos, gap = np.cos(angle), 0.5 * spacing
    radius = (2.0 / (2.0 - 3.0 * cos + cos**3)) ** (1.0 / 3.0)
    across, up = np.arange(-2.0, 2.0, gap), np.arange(0.5 * gap, 2.5, gap)
    x = np.stack(np.meshgrid(across + shift[0] * gap, up, across + shift[1] * gap, indexing="ij"), -1).reshape(-1, 3)
    x = x[((x + np.array([0.0, radius * cos, 0.0])) ** 2).sum(axis=1) < radius**2]
    return np.asarray(x * (2.0 * np.pi / 3.0 / (len(x) * gap**3)) ** (1.0 / 3.0))


@pytest.mark.parametrize("degrees", [45.0, 90.0, 135.0])
def test_sampled_energy_of_a_cap_is_least_at_youngs_angle(degrees: float) -> None:
    """In space, radii of eight cells: the contour's sides below the wall, which have k_SL too, cost three degrees."""
    spacing = 1.0 / 8.0
    wall = Wall(Plane(np.zeros(3), np.array([0.0, 1.0, 0.0])), np.zeros(3), 0.0)
    tension = SurfaceTension(Constant(2.0), solid_liquid=Constant(solid_liquid_coefficient(np.radians(degrees), 2.0)))
    angles = degrees + np.linspace(-15.0, 15.0, 7)
    shifts = np.random.default_rng(0).uniform(-0.5, 0.5, (angles.size, 3, 2))
    energy = np.zeros(angles.size)
    for number, angle in enumerate(angles):
        for seed, shift in enumerate(shifts[number]):
            x = cap_points(np.radians(angle), spacing, shift)
            particles = Particles.at(x, np.ones(len(x)), np.ones(len(x)))
            particles.phase[:] = LIQUID
            samples = SurfaceSampler(spacing, seed=seed).sample(x, 0)
            found = surface_coefficients(samples, particles, [tension], wall_distance([wall], samples.points, 0.0))
            energy[number] += found.k @ samples.measure
    curve = np.polynomial.Polynomial.fit(angles, energy, 2).deriv()
    assert curve.deriv()(degrees) > 0.0
    assert curve.roots()[0] == pytest.approx(degrees, abs=3.5)


def test_young_limits() -> None:
    assert contact_angle(5.0, 2.0) == pytest.approx(np.pi)
    with pytest.raises(ValueError, match="film"):
        contact_angle(-2.1, 2.0)
    with pytest.raises(ValueError, match="not positive"):
        contact_angle(0.0, 0.0)
