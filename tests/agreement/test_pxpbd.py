"""B-PXPBD and FP-PXPBD against projected Newton where they converge: laws, dimensions, supports, contact, pressure."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenario import block, body, build, material, scene

from femdeform.materials import LAWS
from femdeform.run.setup import Simulation

TOLERANCE = 1e-10
FP = {"method": "fp_pxpbd", "tolerance": TOLERANCE, "max_iterations": 600}
B = {"method": "b_pxpbd", "tolerance": TOLERANCE, "max_iterations": 600}


def solve(data: dict[str, Any], solver: dict[str, Any], steps: int) -> Simulation:
    """Steps of a scene with a solver, all of which have to converge."""
    simulation = build({**data, "solver": solver})
    for _ in range(steps):
        simulation.problem.begin_step(simulation.state, simulation.scene.time.dt)
        result = simulation.solver.step(simulation.problem, simulation.state)
        assert result.converged, result.reason
        simulation.state = simulation.problem.accept(simulation.state, result.x)
    return simulation


def compare(data: dict[str, Any], solver: dict[str, Any], steps: int = 2, moved: float = 0.02) -> None:
    newton = solve(data, {"tolerance": 1e-12}, steps)
    other = solve(data, solver, steps)
    problem = other.problem
    norm = problem.residual_norm(problem.gradient(other.state.x))
    assert norm <= 1.001 * TOLERANCE * problem.force_scale
    distance = np.abs(newton.state.x - newton.discretization.points).max()
    assert distance > moved
    np.testing.assert_allclose(other.state.x, newton.state.x, rtol=0.0, atol=1e-8 * distance)


def thrown_bar(law: str, dim: int, *conditions: dict[str, Any], E: float = 1e5, **more: Any) -> dict[str, Any]:
    """kappa = 0.16: a bar stretched and thrown, its weight on it."""
    return scene(
        {"b": body(block([1.0, 0.5, 0.5][:dim], [4, 2, 2][:dim]), material(law, E=E))},
        {"kind": "initial_velocity", "on": "b", "velocity": [0.5, -2.0, 0.7][:dim]},
        *(conditions or ({"kind": "fixed", "on": "b.left"},)),
        **{"gravity": [0.0, -9.81, 0.0][:dim], **more},
    )


@pytest.mark.parametrize("tangent", ["model", "exact"])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", list(LAWS))
def test_stresses_of_every_law(law: str, dim: int, tangent: str) -> None:
    compare(thrown_bar(law, dim), {**FP, "tangent": tangent})


@pytest.mark.parametrize("local", [1, 5])
def test_any_number_of_local_steps(local: int) -> None:
    compare(thrown_bar("fixed_corotated", 3), {**FP, "local_iterations": local, "line_search": True})


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", ["fixed_corotated", "arap", "neo_hookean"])
def test_blended_constraints(law: str, dim: int) -> None:
    compare(thrown_bar(law, dim), B)


@pytest.mark.parametrize("solver", [FP, B], ids=["fp", "b"])
@pytest.mark.parametrize("dim", [2, 3])
def test_rollers_and_moving_supports(dim: int, solver: dict[str, Any]) -> None:
    """Components held one by one, others carried along: nodes whose mobility has a direction."""
    conditions = [
        {"kind": "fixed", "on": "b.left", "components": ["x"]},
        {"kind": "fixed", "on": "b.bottom", "components": ["y"]},
        {"kind": "translate", "on": "b.right", "velocity": [2.0, 0.5, 0.3][:dim]},
    ]
    compare(thrown_bar("fixed_corotated", dim, *conditions), solver)
    compare(thrown_bar("neo_hookean", dim, *conditions), {**solver, **({"line_search": True} if solver is FP else {})})


@pytest.mark.parametrize("solver", [FP, B], ids=["fp", "b"])
def test_several_laws_and_bodies(solver: dict[str, Any]) -> None:
    bodies = {
        "a": body(block([1.0, 0.4, 0.4], [4, 2, 2]), material("neo_hookean", E=3e4)),
        "c": body(block([1.0, 0.4, 0.4], [3, 2, 2], translate=[0, 0, 1]), material("fixed_corotated", E=2e4)),
    }
    compare(
        scene(
            bodies,
            {"kind": "fixed", "on": "a.left"},
            {"kind": "traction", "on": "c.right", "value": [2000.0, 0, 0]},
            {"kind": "initial_velocity", "on": "a", "velocity": [0.5, -2.0, 0.0]},
            gravity=[0.0, -9.81, 0.0],
        ),
        solver,
    )


@pytest.mark.parametrize("solver", [FP, B], ids=["fp", "b"])
@pytest.mark.parametrize(
    ("dim", "obstacle"),
    [
        (3, {"kind": "plane", "point": [0.0, -0.01, 0.0], "normal": [0.1, 1, 0], "friction": 0.4}),
        (3, {"kind": "box", "min": [0.2, -1.0, 0.1], "max": [0.8, -0.01, 0.4], "friction": 0.3}),
        (2, {"kind": "sphere", "center": [0.5, -0.4], "radius": 0.39, "friction": 0.2}),
    ],
)
def test_obstacles(dim: int, obstacle: dict[str, Any], solver: dict[str, Any]) -> None:
    data = thrown_bar(
        "neo_hookean", dim, {"kind": "initial_velocity", "on": "b", "velocity": [0.5, -2.0, 0.2][:dim]}, E=3e4
    )
    data["conditions"] = data["conditions"][1:]
    compare({**data, "obstacles": [obstacle]}, solver, steps=3)


@pytest.mark.parametrize("solver", [FP, B], ids=["fp", "b"])
def test_pressure_that_follows_the_surface(solver: dict[str, Any]) -> None:
    conditions = [{"kind": "fixed", "on": "b.left"}, {"kind": "pressure", "on": "b.top", "value": 3000.0}]
    compare(thrown_bar("fixed_corotated", 3, *conditions), solver)


@pytest.mark.parametrize("method", ["xpbd", "pbd"])
def test_xpbd_holds_obstacles_and_rollers(method: str) -> None:
    """No convergence to compare with: rollers stay, and the floor carries the bar as far as its penalty says."""
    data = thrown_bar("fixed_corotated", 3, {"kind": "fixed", "on": "b.back", "components": ["z"]}, E=3e4)
    data["obstacles"] = [{"kind": "plane", "point": [0.0, -0.01, 0.0], "normal": [0, 1, 0]}]
    data["solver"] = {"method": method, "iterations": 30}
    simulation = build(data)
    X = simulation.discretization.points
    held = X[:, 2] == 0.0
    lowest = []
    for _ in range(60):
        simulation.problem.begin_step(simulation.state, 0.01)
        result = simulation.solver.step(simulation.problem, simulation.state)
        assert result.accepted, result.reason
        simulation.state = simulation.problem.accept(simulation.state, result.x)
        np.testing.assert_array_equal(simulation.state.x[held, 2], 0.0)
        lowest.append(simulation.state.x[:, 1].min())
    assert min(lowest) > -0.06
    assert max(np.abs(simulation.state.v).max(), 1.0) < 20.0
