"""Gravity, tractions, pressures and point loads: how large they are in sum, where, and when."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenario import block, body, build, displacement, material, quasistatic, run, scene, step
from scipy.optimize import brentq

from femdeform.run.setup import Simulation

ELEMENTS = pytest.mark.parametrize(("dim", "order"), [(2, 1), (2, 2), (3, 1), (3, 2)])
SIZE = [2.0, 1.0, 0.5]


def loaded(dim: int, order: int, *conditions: dict[str, Any], **more: Any) -> Simulation:
    mesh = block(SIZE[:dim], [3, 2, 2][:dim])
    return build(scene({"b": body(mesh, element_order=order)}, *conditions, **more))


@ELEMENTS
def test_traction_is_value_times_area(dim: int, order: int) -> None:
    t = np.array([3.0, -2.0, 0.7])[:dim]
    simulation = loaded(dim, order, {"kind": "traction", "on": "b.right", "value": t.tolist()})
    simulation.problem.set_loads(0.5)
    load, X = simulation.problem.load, simulation.discretization.points
    area = 1.0 if dim == 2 else 0.5
    np.testing.assert_allclose(load.sum(axis=0), t * area, rtol=1e-12)
    assert np.all(load[X[:, 0] < 2.0] == 0.0)
    # A constant load works on a linear field as on its value in the middle of the face, and so does its moment.
    height = X[:, 1] - 0.5
    np.testing.assert_allclose((height[:, None] * load).sum(axis=0), 0.0, atol=1e-13)
    if order == 2:
        # On a quadratic field too: the mean of height^2 is 1/12.
        np.testing.assert_allclose((height[:, None] ** 2 * load).sum(axis=0), t * area / 12.0, rtol=1e-12)


def test_tractions_add_up() -> None:
    simulation = loaded(
        3,
        1,
        {"kind": "traction", "on": "b.right", "value": [1.0, 0.0, 0.0]},
        {"kind": "traction", "on": "b.top", "value": [0.0, 2.0, 0.0]},
        {"kind": "point_load", "on": "b.left", "force": [0.0, 0.0, 4.0]},
    )
    simulation.problem.set_loads(0.0)
    np.testing.assert_allclose(simulation.problem.load.sum(axis=0), [0.5, 2.0, 4.0], rtol=1e-12)


def test_traction_on_selected_facets() -> None:
    """A plane selects the boundary facets all of whose nodes lie on it, and no facet beside it."""
    plane = {"plane": {"point": [0.0, 1.0, 0.0], "normal": [0.0, 1.0, 0.0]}}
    simulation = loaded(3, 2, {"kind": "traction", "on": plane, "value": [0.0, -5.0, 0.0]})
    simulation.problem.set_loads(0.0)
    np.testing.assert_allclose(simulation.problem.load.sum(axis=0), [0.0, -5.0, 0.0], atol=1e-13)
    half = {"box": [[0.0, 1.0, 0.0], [1.34, 1.0, 0.5]]}  # two of three columns of cells
    simulation = loaded(3, 1, {"kind": "traction", "on": half, "value": [0.0, -5.0, 0.0]})
    simulation.problem.set_loads(0.0)
    np.testing.assert_allclose(simulation.problem.load.sum(axis=0), [0.0, -10.0 / 3.0, 0.0], atol=1e-13)


@ELEMENTS
def test_point_load_is_shared_equally(dim: int, order: int) -> None:
    force = np.array([4.0, -1.0, 2.0])[:dim]
    simulation = loaded(dim, order, {"kind": "point_load", "on": "b.right", "force": force.tolist()})
    simulation.problem.set_loads(0.3)
    nodes = simulation.conditions.local_nodes("b.right")
    expected = np.zeros_like(simulation.problem.load)
    expected[nodes] = force / nodes.size
    np.testing.assert_allclose(simulation.problem.load, expected, rtol=1e-14)


@ELEMENTS
@pytest.mark.parametrize("mass", ["lumped", "consistent"])
@pytest.mark.parametrize("static", [False, True])
def test_gravity_is_the_weight(dim: int, order: int, mass: str, static: bool) -> None:
    g = np.array([0.5, -9.81, 1.0])[:dim]
    data = scene(
        {"b": body(block(SIZE[:dim], [3, 2, 2][:dim]), element_order=order, mass=mass)},
        gravity=g.tolist(),
        **({"time": quasistatic()} if static else {}),
    )
    problem = build(data).problem
    problem.set_loads(1.0)
    np.testing.assert_allclose(problem.load.sum(axis=0), 1000.0 * np.prod(SIZE[:dim]) * g, rtol=1e-12)


def test_amplitudes() -> None:
    curve = {"times": [1.0, 2.0, 4.0], "values": [0.0, 3.0, -1.0]}
    simulation = loaded(
        3,
        1,
        {"kind": "point_load", "on": "b.right", "force": [1.0, 0.0, 0.0], "amplitude": curve},
        {"kind": "traction", "on": "b.right", "value": [0.0, 2.0, 0.0]},
        gravity=[0.0, 0.0, -1.0],
        gravity_amplitude={"times": [0.0, 10.0], "values": [1.0, 0.0]},
    )
    for time, factor in ((0.0, 0.0), (1.5, 1.5), (3.0, 1.0), (4.0, -1.0), (8.0, -1.0)):
        simulation.problem.set_loads(time)
        np.testing.assert_allclose(
            simulation.problem.load.sum(axis=0), [factor, 1.0, -1000.0 * (1.0 - time / 10.0)], atol=1e-10
        )


def test_quasistatic_loads_ramp_up_over_the_run() -> None:
    amplitude = {"times": [0.0, 4.0], "values": [2.0, 2.0]}
    simulation = loaded(
        2,
        1,
        {"kind": "traction", "on": "b.right", "value": [8.0, 0.0]},
        {"kind": "point_load", "on": "b.left", "force": [0.0, 1.0], "amplitude": amplitude},
        {"kind": "pressure", "on": "b.top", "value": 4.0},
        gravity=[0.0, -1.0],
        time=quasistatic(dt=1.0, end=4.0),
    )
    for time in (0.0, 1.0, 3.0, 4.0):
        simulation.problem.set_loads(time)
        load = simulation.problem.load.sum(axis=0)
        np.testing.assert_allclose(load, [8.0 * time / 4.0, 2.0 - 2000.0 * time / 4.0], atol=1e-10)
        assert simulation.problem.pressures[0].pressure == pytest.approx(time, abs=1e-14)


def test_a_load_that_meets_a_support_only_adds_to_its_reaction() -> None:
    simulation = loaded(
        3,
        1,
        {"kind": "fixed", "on": "b.left"},
        {"kind": "traction", "on": "b.left", "value": [100.0, 0.0, 0.0]},
        time=quasistatic(),
    )
    step(simulation)
    assert np.abs(displacement(simulation)).max() < 1e-12


# ------------------------------------------------------------------------------------------- in equilibrium


@ELEMENTS
def test_reactions_balance_the_loads(dim: int, order: int) -> None:
    """Newton's third law at the support: what the support gives is what gravity, traction and pressure ask for."""
    t, g, p = np.array([400.0, -300.0, 100.0])[:dim], np.array([0.0, -0.5, 0.2])[:dim], 150.0
    simulation = loaded(
        dim,
        order,
        {"kind": "fixed", "on": "b.left"},
        {"kind": "traction", "on": "b.right", "value": t.tolist()},
        {"kind": "pressure", "on": "b.right", "value": p},
        gravity=g.tolist(),
        time=quasistatic(dt=0.5),
        solver={"tolerance": 1e-12},
    )
    step(simulation)
    step(simulation)
    problem, x = simulation.problem, simulation.state.x
    held = ~problem.free
    reaction = np.where(held, problem.full_gradient(x), 0.0).sum(axis=0)
    area = 1.0 if dim == 2 else 0.5
    follower = -np.sum(pressure_forces(simulation), axis=0)
    np.testing.assert_allclose(reaction, -(t * area + 1000.0 * np.prod(SIZE[:dim]) * g + follower), rtol=1e-6)
    assert np.linalg.norm(follower) == pytest.approx(p * area, rel=0.3)


def pressure_forces(simulation: Simulation) -> list[Any]:
    """Resultants of minus the pressures."""
    result = []
    for term in simulation.problem.pressures:
        n, k = term.cells.shape
        slots = np.empty((n * k, simulation.discretization.dim))
        term.gradient(simulation.state.x, slots, 0)
        result.append(slots.sum(axis=0))
    return result


@ELEMENTS
def test_uniform_pressure_shrinks_a_block_evenly(dim: int, order: int) -> None:
    """All-round pressure on a small strain gives the bulk modulus: a check of sign, area and law together."""
    E, nu, p = 1e5, 0.3, 10.0
    rollers = [
        {"kind": "fixed", "on": f"b.{group}", "components": [axis]}
        for group, axis in (("left", "x"), ("bottom", "y"), ("back", "z"))[:dim]
    ]
    simulation = build(
        scene(
            {"b": body(block(SIZE[:dim], [2, 2, 1][:dim]), material(E=E, nu=nu), element_order=order)},
            *rollers,
            {"kind": "pressure", "on": "b.boundary", "value": p},
            time=quasistatic(),
            solver={"tolerance": 1e-12},
        )
    )
    step(simulation)
    mu, lmbda = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))
    strain = -p / (2 * mu + dim * lmbda)
    u, X = displacement(simulation), simulation.discretization.points
    np.testing.assert_allclose(u, strain * X, atol=2e-3 * abs(strain))


def test_hanging_bar_stretches_as_it_should() -> None:
    """Own weight on a long bar, small strain, no Poisson effect: u = rho g L^2 / 2E at the tip; exact with P2."""
    data = scene(
        {"b": body(block([1.0, 0.1, 0.1], [4, 1, 1]), material("linear", E=1e6, nu=0.0), element_order=2)},
        {"kind": "fixed", "on": "b.left"},
        gravity=[9.81, 0.0, 0.0],
        time=quasistatic(),
    )
    simulation = run(data)
    tip = simulation.conditions.local_nodes("b.right")
    np.testing.assert_allclose(displacement(simulation)[tip, 0], 1000.0 * 9.81 / 2e6, rtol=1e-9)


# ------------------------------------------------------------------------------------------- membranes


def cloth(*conditions: dict[str, Any]) -> Simulation:
    mesh = {"recipe": "cloth", "size": [2.0, 1.0], "cells": [3, 2]}
    return build(scene({"b": body(mesh, kind="membrane", thickness=1e-2)}, *conditions))


def test_traction_on_a_membrane_is_value_times_area() -> None:
    t = np.array([3.0, -2.0, 0.7])
    simulation = cloth({"kind": "traction", "on": "b", "value": t.tolist()})
    simulation.problem.set_loads(0.5)
    np.testing.assert_allclose(simulation.problem.load.sum(axis=0), 2.0 * t, rtol=1e-12)


def test_pressure_on_a_membrane_follows_it() -> None:
    """Against the normal of its triangles, times the area they have now."""
    simulation = cloth({"kind": "pressure", "on": "b", "value": 7.0})
    problem, X = simulation.problem, simulation.discretization.points
    problem.begin_step(simulation.state, 0.01)
    (pressure,) = problem.pressures
    normal = np.cross(*(X[pressure.cells[:, k]] - X[pressure.cells[:, 0]] for k in (1, 2)))[0]
    up = np.array([0.0, np.sign(normal[1]), 0.0])
    turn = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    for x, area, side in ((X, 2.0, up), (X * [1.5, 1.0, 2.0], 6.0, up), (X @ turn, 2.0, up @ turn)):
        slots = np.empty((pressure.cells.size, 3))
        pressure.gradient(x, slots, 0)
        np.testing.assert_allclose(-slots.sum(axis=0), -7.0 * area * side, atol=1e-9)


@pytest.mark.parametrize("method", ["projected_newton", "mixed_fem"])
def test_a_balloon(method: str) -> None:
    """A thin sphere of radius R stretched by s holds the pressure t psi'(s) / (R s^2), with psi(s) = psi(s, s, 1)."""
    E, nu, R, t, p = 1.0e6, 0.45, 0.1, 1.0e-3, 4000.0
    mesh = {"recipe": "sphere_surface", "radius": R, "element_size": 0.015}
    data = scene(
        {"b": body(mesh, material("corotated", E=E, nu=nu), kind="membrane", thickness=t)},
        {"kind": "fixed", "on": "b.bottom"},
        {"kind": "fixed", "on": "b.top", "components": ["x", "z"]},
        # It may not turn about its axis.
        {"kind": "fixed", "on": {"box": [[0.0, -1e-3, -1.0], [1e-3, 1e-3, 1.0]]}, "components": ["x"]},
        {"kind": "pressure", "on": "b", "value": -p},
        time=quasistatic(0.25),
        solver={"method": method},
    )
    simulation = run(data)
    x = simulation.state.x
    middle = 0.5 * (x[:, 1].max() + x[:, 1].min())
    found = np.linalg.norm(x - [0.0, middle, 0.0], axis=1).mean() / R
    mu, lam = E / (2.0 * (1.0 + nu)), E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))
    # psi = mu sum (s_i - 1)^2 + lambda / 2 (sum (s_i - 1))^2
    exact = brentq(lambda s: (4.0 * mu * (s - 1.0) + 4.0 * lam * (s - 1.0)) * t / (R * s**2) - p, 1.0, 1.9)
    assert exact > 1.02
    assert found - 1.0 == pytest.approx(exact - 1.0, rel=0.03)
