"""Walls that keep their temperature: exact profiles, the budget, the matrix, bodies that do not touch."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from femdeform.contact.obstacles import Plane, Sphere
from femdeform.mpm.grid import Grid
from femdeform.mpm.heat import HeatBoundary, HeatConduction
from femdeform.mpm.heat_walls import hold_temperatures
from femdeform.mpm.particle_sampling import sample_particles
from femdeform.mpm.particles import LIQUID, Particles
from femdeform.mpm.rigid_walls import RigidWall
from femdeform.mpm.surface_sampling import SurfaceSampler

Array = NDArray[np.float64]
DX = 1.0 / 32
HOT, COLD = 350.0, 290.0


def wall(point: Array, normal: Array, temperature: float | None) -> RigidWall:
    return RigidWall(Plane(point, normal), "stick", np.zeros(point.size), 0.0, temperature)


def slab(dim: int, shift: float, angle: float = 0.0) -> tuple[Particles, list[RigidWall], Array, float]:
    """A slab between two walls that lie anywhere between the nodes: points, walls, its direction, its thickness."""
    normal = np.array([np.cos(angle), np.sin(angle), 0.0][:dim])
    thickness, start = 0.25, 0.25 + shift * DX
    lattice = np.stack(np.meshgrid(*[np.arange(-3 * 16, 3 * 64) * DX / 3 + DX / 6] * dim, indexing="ij"), -1)
    x = lattice.reshape(-1, dim)
    if not angle:
        x = x + (start - 0.25) * normal
    along = x @ normal - start
    side = np.abs(x @ np.array([-normal[1], normal[0]]) - 0.2) if angle else np.abs(x[:, 1:] - 0.4).max(axis=1)
    kept = (along > 0.0) & (along < thickness) & (side < (0.2 if angle else 0.1))
    x = x[kept]
    volume = (DX / 3) ** dim
    points = Particles.at(x, np.full(len(x), volume), np.full(len(x), volume))
    points.phase[:] = LIQUID
    points.temperature[:] = COLD
    walls = [wall(start * normal, normal, HOT), wall((start + thickness) * normal, -normal, COLD)]
    return points, walls, normal, thickness


@pytest.mark.parametrize("shift", [0.0, 0.2, 0.5, 0.9])
@pytest.mark.parametrize("dim", [2, 3])
def test_profile_of_a_slab(dim: int, shift: float) -> None:
    """At rest the temperature is linear between the walls, and the same power enters and leaves."""
    points, walls, normal, thickness = slab(dim, shift)
    conduction = HeatConduction(Grid(DX, "quadratic"))
    for _ in range(4):
        report = conduction.step(points, None, 1e3, 0.0, 1.0, 2.0, walls=walls)
        assert report.converged
    along = points.x @ normal - (0.25 + shift * DX)
    exact = HOT + (COLD - HOT) * along / thickness
    assert np.abs(points.temperature - exact).max() < 0.01 * (HOT - COLD)
    assert points.temperature_gradient @ normal == pytest.approx((COLD - HOT) / thickness, rel=0.02)
    assert abs(report.wall_power) < 1e-6 * 2.0 * (HOT - COLD) / thickness * 0.2 ** (dim - 1)


def test_a_slab_across_the_grid() -> None:
    points, walls, normal, thickness = slab(2, 0.3, 0.5)
    conduction = HeatConduction(Grid(DX, "quadratic"))
    for _ in range(4):
        assert conduction.step(points, None, 1e3, 0.0, 1.0, 2.0, walls=walls).converged
    along = points.x @ normal - (0.25 + 0.3 * DX)
    exact = HOT + (COLD - HOT) * along / thickness
    # Less exact than along the grid, and where a wall, an insulated end and the grid meet.
    assert np.sqrt(np.mean((points.temperature - exact) ** 2)) < 0.005 * (HOT - COLD)
    assert np.abs(points.temperature - exact).max() < 0.025 * (HOT - COLD)


def test_a_slab_heats_up() -> None:
    """One wall is hot from time zero, the other insulates: the mean follows the series."""
    points, walls, _, thickness = slab(2, 0.4)
    walls[1] = wall(np.zeros(2), np.array([1.0, 0.0]), None)
    conduction, dt = HeatConduction(Grid(DX, "quadratic")), 0.5 * thickness**2 / 100
    for _ in range(100):
        report = conduction.step(points, None, dt, 0.0, 1.0, 1.0, walls=walls)
    zeta = (np.arange(40) + 0.5) * np.pi
    # Backward Euler has decayed by (1 + a dt)^-n.
    decay = (1.0 + zeta**2 / thickness**2 * dt) ** -100.0
    exact = HOT + (COLD - HOT) * float((2.0 / zeta**2 * decay).sum())
    assert points.temperature.mean() == pytest.approx(exact, abs=0.01 * (HOT - COLD))
    assert report.wall_power > 0.0


@pytest.mark.parametrize("tolerance", [1e-10, 1e-3])
def test_budget(tolerance: float) -> None:
    """What walls, surface and sources bring is what is stored, however inexact the solve."""
    rng = np.random.default_rng(0)
    x = rng.uniform(0.2, 0.6, (400, 2))
    points = Particles.at(x, 1.0 + rng.random(400), DX**2 * (0.1 + rng.random(400)))
    points.temperature = 300.0 + 20.0 * rng.standard_normal(400)
    walls = [
        RigidWall(Sphere(np.array([0.2, 0.2]), 0.15, False), "stick", np.zeros(2), 0.0, 400.0),
        wall(np.array([0.55, 0.0]), np.array([-1.0, 0.1]), 200.0),
    ]
    samples = SurfaceSampler(DX).sample(x, 0)
    capacity = points.mass * 3.0
    for _ in range(3):
        before = float(capacity @ points.temperature)
        report = HeatConduction(Grid(DX, "quadratic"), tolerance=tolerance).step(
            points, samples, 0.1, 0.0, 3.0, 0.5, HeatBoundary(2.0, 290.0, 5.0), 7.0, walls=walls
        )
        assert report.converged
        brought = 0.1 * (report.boundary_power + report.source_power + report.wall_power)
        assert report.stored == pytest.approx(brought, rel=1e-9)
        assert float(capacity @ points.temperature) - before == pytest.approx(report.stored, rel=1e-9)
    assert abs(report.wall_power) > 1.0


def test_at_the_temperature_of_the_walls_nothing_happens() -> None:
    points, walls, _, _ = slab(2, 0.3)
    walls = [wall(np.asarray(each.shape.point), np.asarray(each.shape.normal), COLD) for each in walls]
    report = HeatConduction(Grid(DX, "quadratic")).step(points, None, 1.0, 0.0, 1.0, 1.0, walls=walls)
    np.testing.assert_allclose(points.temperature, COLD, rtol=1e-12)
    assert abs(report.wall_power) < 1e-9


def test_a_body_that_does_not_reach_the_wall_is_insulated() -> None:
    points = sample_particles(Sphere(np.array([0.5, 0.5]), 0.1, False), DX, 3, 1.0)
    points.temperature[:] = COLD
    far = [wall(np.array([0.0, 0.3]), np.array([0.0, 1.0]), HOT)]
    report = HeatConduction(Grid(DX, "quadratic")).step(points, None, 1.0, 0.0, 1.0, 1.0, walls=far)
    np.testing.assert_allclose(points.temperature, COLD, rtol=1e-12)
    assert report.wall_power == 0.0


def test_linear_temperatures_are_continued() -> None:
    """At held nodes too, whatever the direction of the wall; where nothing is free, they take that of the wall."""
    index = np.stack(np.meshgrid(np.arange(12), np.arange(12), indexing="ij"), -1).reshape(-1, 2)
    positions = index * DX
    there = wall(np.array([4.3 * DX, 4.1 * DX]), np.array([0.8, 0.6]), 300.0)
    phi = there.distance(positions, 0.0)[0]
    held = hold_temperatures([there], positions, DX, np.ones(len(positions), dtype=bool), 0.0)
    assert held is not None
    np.testing.assert_array_equal(held.nodes, np.flatnonzero(phi <= 0.4 * DX))
    T = 300.0 + 40.0 * phi
    found = held.constant + held.slope @ T
    near = phi[held.nodes] > -1.5 * DX
    assert near.sum() > 10
    np.testing.assert_allclose(found[near], T[held.nodes][near], rtol=1e-12)
    alone = hold_temperatures([there], positions, DX, phi <= 0.0, 0.0)
    assert alone is not None
    np.testing.assert_array_equal(alone.constant, 300.0)
    assert alone.slope.nnz == 0


def test_walls_through_nodes_hold_them() -> None:
    """Whatever rounding says of a plane at a multiple of the cell size."""
    for k in range(1, 48):
        positions = np.array([[k * (1.0 / 48), 0.0]])
        for normal in (1.0, -1.0):
            plane = RigidWall(Plane(np.array([k / 48.0 + 1e-16, 0.0]), np.array([normal, 0.0])), "stick", np.zeros(2))
            assert plane.node_distance(positions, 0.0, 1.0 / 48)[0][0] == 0.0
    apart = RigidWall(Plane(np.array([0.5 - 1e-5, 0.0]), np.array([1.0, 0.0])), "stick", np.zeros(2))
    assert apart.node_distance(np.array([[0.5, 0.0]]), 0.0, 0.1)[0][0] > 0.0
