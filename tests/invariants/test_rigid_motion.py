"""Turning and shifting a scene turns and shifts its answer."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenario import Array, block, body, build, material, quasistatic, random_state, rotation, run, scene, step

SOFT = material(E=100.0, nu=0.35, density=10.0)


def bodies(dim: int) -> dict[str, Any]:
    if dim == 2:
        return {
            "p1": body(block([1, 1], [2, 1]), SOFT),
            "p2": body(block([1, 1], [2, 1], translate=[2, 0]), SOFT, element_order=2),
        }
    return {
        "p1": body(block([1, 1, 1], [1, 1, 1]), SOFT),
        "p2": body(block([1, 1, 1], [1, 1, 1], translate=[2, 0, 0]), SOFT, element_order=2),
        "cloth": body({"recipe": "cloth", "size": [1.0, 1.0], "cells": [1, 1]}, SOFT, kind="membrane", thickness=0.1),
        "rod": body({"recipe": "rod", "cells": 2}, SOFT, kind="rod", cross_section=0.1),
    }


@pytest.mark.parametrize("dim", [2, 3])
def test_energy_stays_and_forces_turn(dim: int) -> None:
    simulation = build(scene(bodies(dim)))
    problem = simulation.problem
    x = random_state(simulation.discretization.points, 0.15, seed=dim)
    R, c = rotation(dim, seed=7), np.array([0.7, -2.0, 1.1])[:dim]
    turned = x @ R.T + c
    energy = problem.elastic_energy(x)
    assert energy > 1.0
    assert problem.elastic_energy(turned) == pytest.approx(energy, rel=1e-11)
    force = problem.internal_forces(x)
    np.testing.assert_allclose(problem.internal_forces(turned), force @ R.T, atol=1e-11 * np.abs(force).max())
    # The reference turned as a whole costs nothing and pulls nowhere.
    rigid = simulation.discretization.points @ R.T + c
    assert problem.elastic_energy(rigid) < 1e-15 * energy
    assert np.abs(problem.internal_forces(rigid)).max() < 1e-12 * np.abs(force).max()


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("order", [1, 2])
def test_internal_forces_are_in_balance(dim: int, order: int) -> None:
    simulation = build(scene(bodies(dim)))
    x = random_state(simulation.discretization.points, 0.15, seed=order)
    place = simulation.discretization.bodies[f"p{order}"]
    own = slice(place.first, place.first + place.n_nodes)
    force, at = simulation.problem.internal_forces(x)[own], x[own]
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-12)
    moment = np.einsum("ia,ib->ab", at, force)
    np.testing.assert_allclose(moment, moment.T, atol=1e-12)


def hanging(dim: int, turn: Array | None) -> dict[str, Any]:
    """A cantilever under gravity and end load; or the same, turned."""
    size, cells = [1.0, 0.2, 0.2][:dim], [6, 2, 1][:dim]
    mesh = block(size, cells)
    gravity, load = np.array([0.0, -9.81, 1.0])[:dim], np.array([2.0, 0.0, 3.0])[:dim]
    if turn is not None:
        axis_angle = {"angle": 0.9} if dim == 2 else {"axis": [1.0, 2.0, -0.5], "angle": 0.9}
        mesh |= {"rotate": axis_angle, "translate": [0.3, -1.0, 2.0][:dim]}
        gravity, load = turn @ gravity, turn @ load
    return scene(
        {"b": body(mesh, material(E=5e4, nu=0.4))},
        {"kind": "fixed", "on": "b.left"},
        {"kind": "point_load", "on": "b.right", "force": load.tolist()},
        gravity=gravity.tolist(),
        time={"scheme": "backward_euler", "dt": 0.05, "end": 0.2},
        solver={"tolerance": 1e-11},
    )


@pytest.mark.parametrize("dim", [2, 3])
def test_a_turned_scene_gives_a_turned_answer(dim: int) -> None:
    if dim == 2:
        turn = np.array([[np.cos(0.9), -np.sin(0.9)], [np.sin(0.9), np.cos(0.9)]])
    else:
        axis = np.array([1.0, 2.0, -0.5]) / np.linalg.norm([1.0, 2.0, -0.5])
        cross = np.cross(np.eye(3), axis)
        turn = np.eye(3) + np.sin(0.9) * cross + (1.0 - np.cos(0.9)) * cross @ cross
    straight, turned = run(hanging(dim, None)), run(hanging(dim, turn))
    u = straight.state.x - straight.discretization.points
    np.testing.assert_allclose(turned.state.x - turned.discretization.points, u @ turn.T, atol=1e-9 * np.abs(u).max())


@pytest.mark.parametrize(("dim", "order"), [(2, 1), (2, 2), (3, 1), (3, 2)])
def test_the_inside_follows_a_turned_boundary(dim: int, order: int) -> None:
    """Two radians in a single static step: the answer is the turned reference, without strain."""
    turning = {"kind": "rotate", "on": "b.boundary", "rate": 2.0, "center": [0.2, 0.1, 0.0][:dim]}
    if dim == 3:
        turning["axis"] = [0.3, 1.0, -0.2]
    data = scene({"b": body(block([1.0] * dim, [3] * dim), element_order=order)}, turning, time=quasistatic())
    simulation = build(data)
    assert simulation.problem.free.any()
    step(simulation)
    (motion,) = simulation.conditions.motions
    whole = simulation.discretization.points
    expected = type(motion)(np.arange(len(whole)), motion.components, whole, motion.condition, motion.center)
    np.testing.assert_allclose(simulation.state.x, expected.positions(1.0), atol=1e-7)
    assert simulation.problem.elastic_energy(simulation.state.x) < 1e-9 * 1e5
