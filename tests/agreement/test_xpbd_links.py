"""Weak constraints in sweeps over cells: projected Newton's answers where a method converges, XPBD's own where not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenario import block, body, build, material, quasistatic, scene

from femdeform.jit import set_threads
from femdeform.run.setup import Simulation
from solvers.position_based.constraint_sweeps import ConstraintSweep

FP = {"method": "fp_pxpbd", "tolerance": 1e-10, "max_iterations": 2000}
B = {"method": "b_pxpbd", "tolerance": 1e-10, "max_iterations": 2000}


def solve(data: dict[str, Any], solver: dict[str, Any], steps: int) -> Simulation:
    """Steps of a scene, all of which have to be accepted."""
    simulation = build({**data, "solver": solver})
    for _ in range(steps):
        simulation.problem.begin_step(simulation.state, simulation.scene.time.dt)
        result = simulation.solver.step(simulation.problem, simulation.state)
        assert result.accepted, result.reason
        simulation.state = simulation.problem.accept(simulation.state, result.x)
    return simulation


def compare(data: dict[str, Any], solver: dict[str, Any], steps: int = 2) -> Simulation:
    newton = solve(data, {"tolerance": 1e-12}, steps)
    other = solve(data, solver, steps)
    problem = other.problem
    assert problem.residual_norm(problem.gradient(other.state.x)) <= 1.001e-10 * problem.force_scale
    distance = np.abs(newton.state.x - newton.discretization.points).max()
    assert distance > 0.02
    np.testing.assert_allclose(other.state.x, newton.state.x, rtol=0.0, atol=1e-7 * distance)
    return other


def end(at: list[float], **more: Any) -> dict[str, Any]:
    return {"at": at, **more}


SPRING = {"kind": "spring", "ends": [end([1.0, 0.4], body="a"), end([1.2, 0.4], body="b")]}
KINDS: dict[str, dict[str, Any]] = {
    "stretched spring": {**SPRING, "stiffness": 4e4, "length": 0.05},
    "compressed spring": {**SPRING, "stiffness": 4e4, "length": 0.35},
    "stiff spring": {**SPRING, "stiffness": 1e7, "length": 0.25},
    "pendulum": {
        "kind": "spring",
        "ends": [end([1.2, 0.4], body="b"), end([1.2, 0.9], fixed=True)],
        "stiffness": 1e6,
        "length": 0.5,
    },
    "pair": {"kind": "pair", "ends": [end([0.9, 0.13], body="a"), end([1.33, 0.2], body="b")], "stiffness": 6e4},
    "direction": {
        "kind": "pair",
        "ends": [end([0.9, 0.13], body="a"), end([1.33, 0.2], body="b")],
        "stiffness": 1e6,
        "direction": [1.0, 0.5],
        "tangential_stiffness": 5e3,
    },
    "attachment": {"kind": "attachment", "on": "b.right", "stiffness": 8e4, "velocity": [0.5, 1.0]},
    "stiff attachment": {"kind": "attachment", "on": "b.right", "stiffness": 1e6, "velocity": [0.5, 1.0]},
    "binding": {"kind": "binding", "on": "b.left", "to": "a.right", "stiffness": 1e6, "within": 0.3},
    "sliding tie": {
        "kind": "tie",
        "on": "b.left",
        "to": "a.right",
        "stiffness": 1e6,
        "tangential_stiffness": 2e3,
        "per": "area",
        "max_distance": 0.3,
    },
}


def two_bars(link: dict[str, Any], dim: int, *conditions: dict[str, Any], E: float = 1e5) -> dict[str, Any]:
    """Two bars with a gap of 0.2 m, the second one thrown and free but for its link; kappa = 0.16."""
    if dim == 3:
        more = {key: [*link[key], 0.1] for key in ("velocity", "direction") if key in link}
        if "ends" in link:
            more["ends"] = [{**place, "at": [*place["at"], 0.2]} for place in link["ends"]]
        link = {**link, **more}
    stuff = material("fixed_corotated", E=E)
    size = [1.0, 0.4, 0.4][:dim]
    return scene(
        {
            "a": body(block(size, [3, 2, 2][:dim]), stuff),
            "b": body(block(size, [3, 3, 3][:dim], translate=[1.2, 0, 0][:dim]), stuff),
        },
        {"kind": "fixed", "on": "a.left"},
        {"kind": "initial_velocity", "on": "b", "velocity": [1.5, -2.0, 1.0][:dim]},
        *conditions,
        links={"l": link},
        gravity=[0.0, -9.81, 0.0][:dim],
    )


@pytest.mark.parametrize("solver", [FP, B], ids=["fp", "b"])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", list(KINDS))
def test_every_kind(name: str, dim: int, solver: dict[str, Any]) -> None:
    found = compare(two_bars(KINDS[name], dim), solver)
    assert found.problem.links.energy(found.state.x) > 1e-4
