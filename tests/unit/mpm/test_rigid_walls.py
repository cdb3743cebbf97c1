"""Walls on grid nodes in explicit steps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from femdeform.contact.obstacles import Box, Plane, Sphere
from femdeform.materials.neo_hookean import NeoHookean
from femdeform.mpm.explicit import ExplicitPoints
from femdeform.mpm.explicit_laws import Liquid
from femdeform.mpm.particle_sampling import sample_particles
from femdeform.mpm.particles import LIQUID
from femdeform.mpm.rigid_walls import RigidWall, constrain

STILL = np.zeros(2)
FLOOR = Plane(np.zeros(2), np.array([0.0, 1.0]))
BELOW = np.array([[0.3, -0.1]])


def after(wall: RigidWall, velocity: list[float], position: Any = BELOW) -> np.ndarray:
    return constrain([wall], np.asarray(position), np.array([velocity]), 0.0, 0.1)[0]


def test_stick_takes_the_velocity_of_the_wall() -> None:
    np.testing.assert_array_equal(after(RigidWall(FLOOR, "stick", np.array([1.0, 2.0])), [3.0, -4.0]), [1.0, 2.0])


def test_slip_takes_the_normal_part_of_either_sign() -> None:
    wall = RigidWall(FLOOR, "slip", np.array([5.0, 2.0]))
    np.testing.assert_allclose(after(wall, [3.0, -4.0]), [3.0, 2.0])
    np.testing.assert_allclose(after(wall, [3.0, 4.0]), [3.0, 2.0])


def test_separate_lets_go() -> None:
    wall = RigidWall(FLOOR, "separate", STILL)
    np.testing.assert_allclose(after(wall, [3.0, -4.0]), [3.0, 0.0])
    np.testing.assert_allclose(after(wall, [3.0, 4.0]), [3.0, 4.0])


def test_nodes_outside_are_free() -> None:
    np.testing.assert_array_equal(after(RigidWall(FLOOR, "stick", STILL), [3.0, -4.0], [[0.0, 0.1]]), [3.0, -4.0])


@pytest.mark.parametrize("kind", ["slip", "separate"])
def test_friction_takes_at_most_the_tangential_velocity(kind: Any) -> None:
    wall = RigidWall(FLOOR, kind, np.array([1.0, 0.0]), 0.5)
    np.testing.assert_allclose(after(wall, [4.0, -2.0]), [3.0, 0.0])
    np.testing.assert_allclose(after(wall, [-2.0, -2.0]), [-1.0, 0.0])
    np.testing.assert_allclose(after(wall, [1.5, -2.0]), [1.0, 0.0])
    # Nothing presses, nothing rubs.
    assert after(wall, [4.0, 2.0])[0] == 4.0


def test_a_wall_moves_with_time() -> None:
    wall = RigidWall(FLOOR, "stick", np.array([0.0, 1.0]))
    x, v = np.array([[0.0, 0.5]]), np.array([[2.0, 0.0]])
    np.testing.assert_array_equal(constrain([wall], x, v, 0.4, 0.1), v)
    np.testing.assert_array_equal(constrain([wall], x, v, 0.6, 0.1), [[0.0, 1.0]])


def test_a_bowl_and_a_container_are_free_inside() -> None:
    bowl = RigidWall(Sphere(np.zeros(2), 1.0, True), "slip", STILL)
    np.testing.assert_array_equal(after(bowl, [1.0, 1.0], [[0.0, 0.9]]), [1.0, 1.0])
    np.testing.assert_allclose(after(bowl, [1.0, 1.0], [[0.0, 1.1]]), [1.0, 0.0])
    box = RigidWall(Box(np.zeros(2), np.ones(2), True), "separate", STILL)
    np.testing.assert_allclose(after(box, [1.0, 1.0], [[0.5, 1.1]]), [1.0, 0.0])


def test_a_corner_of_walls_that_are_not_at_right_angles() -> None:
    normal = np.array([1.0, 1.0])
    walls = [RigidWall(FLOOR, "slip", STILL), RigidWall(Plane(np.zeros(2), normal), "slip", STILL)]
    v = constrain(walls, np.array([[-1.0, -1.0]]), np.array([[1.0, -1.0]]), 0.0, 0.1)
    assert np.abs(v).max() < 1e-5
    sticking = [*walls, RigidWall(FLOOR, "stick", np.array([7.0, 0.0]))]
    np.testing.assert_array_equal(constrain(sticking, np.array([[-1.0, -1.0]]), v, 0.0, 0.1), [[7.0, 0.0]])


@pytest.mark.parametrize("dim", [2, 3])
def test_a_container_carries_a_liquid(dim: int) -> None:
    """It swings about equilibrium: the mean pressure at half height, over five periods, is that of the column above."""
    dx, depth, density, bulk = 0.05, 0.4, 1000.0, 4e5
    up = np.eye(dim)[-1]
    body = Box(np.zeros(dim), np.array([0.2, 0.2, depth][3 - dim :]), False)
    particles = sample_particles(body, dx, 2, density)
    particles.phase[:] = LIQUID
    box = [RigidWall(Plane(np.zeros(dim), normal), "slip", np.zeros(dim)) for normal in np.eye(dim)]
    box += [RigidWall(Plane(np.full(dim, 0.2), -normal), "slip", np.zeros(dim)) for normal in np.eye(dim)[:-1]]
    explicit = ExplicitPoints(
        particles,
        {(0, LIQUID): Liquid(bulk, 20.0)},
        dx,
        np.full(dim, -0.1),
        np.full(dim, 1.0),
        gravity=-9.81 * up,
        walls=box,
    )
    middle = np.abs(particles.x[:, -1] - 0.5 * depth) < 0.05
    pressures = []
    for _ in range(400):
        explicit.step(1e-3)
        pressures.append(bulk * (1.0 - explicit.particles().J[middle]).mean())
    assert np.mean(pressures) == pytest.approx(density * 9.81 * (depth - particles.x[middle, -1].mean()), rel=0.05)
    now = explicit.particles().x
    assert np.abs(now - particles.x).max() < 0.5 * dx


def test_a_block_slides_down_a_ramp_as_coulomb_has_it() -> None:
    """On a slope of 30 degrees with mu = 0.3 it accelerates by g (sin - mu cos); with mu = 0.7 it stays."""
    dx, slope, g = 0.05, np.radians(30.0), 9.81
    gravity = g * np.array([np.sin(slope), -np.cos(slope)])
    moved = {}
    for friction in (0.3, 0.7):
        # The ramp is level here and gravity is turned; it lies half a cell below the block, as contact on a grid does.
        particles = sample_particles(Box(np.array([0.2, 0.025]), np.array([0.6, 0.225]), False), dx, 2, 1000.0)
        explicit = ExplicitPoints(
            particles,
            {(0, 0): NeoHookean.from_lame(2e5, 2e5, 2)},
            dx,
            np.array([0.0, -0.1]),
            np.array([3.0, 1.0]),
            gravity=gravity,
            walls=[RigidWall(FLOOR, "separate", STILL, friction)],
            # It shall not bounce for long.
            transfer="pic",
        )
        n, dt = 500, 5e-4
        for _ in range(n):
            explicit.step(dt)
        moved[friction] = (explicit.particles().x - particles.x)[:, 0].mean() / (0.5 * (n * dt) ** 2)
    assert moved[0.3] == pytest.approx(g * (np.sin(slope) - 0.3 * np.cos(slope)), rel=0.05)
    assert abs(moved[0.7]) < 0.02 * g
