"""Newton: order of convergence, robustness, and honesty about failure."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from scenario import block, body, build, material, quasistatic, random_state, scene, step

from femdeform.fem.fields import jacobians
from femdeform.fem.incremental_potential import IncrementalPotential
from femdeform.run.setup import Simulation
from femdeform.step_problem import Budget, StepResult


def bent_bar(law: str = "neo_hookean", **solver: Any) -> Simulation:
    """A clamped bar bent by an end load to some 40 degrees in one static step."""
    return build(
        scene(
            {"b": body(block([1.0, 0.2, 0.2], [6, 2, 1]), material(law, E=1e5, nu=0.3))},
            {"kind": "fixed", "on": "b.left"},
            {"kind": "traction", "on": "b.right", "value": [0.0, -1500.0, 0.0]},
            time=quasistatic(),
            solver={"tolerance": 1e-12, **solver},
        )
    )


def solve(
    simulation: Simulation, start: Any = None, budget: Budget | None = None
) -> tuple[StepResult, list[dict[str, Any]]]:
    """One step without asking for convergence; the rows of its iterations come along."""
    rows: list[dict[str, Any]] = []
    state = simulation.state
    if start is not None:
        state = state.copy()
        state.x[:] = start
    simulation.problem.begin_step(state, simulation.scene.time.dt)
    result = simulation.solver.step(simulation.problem, state, lambda row, x: rows.append(dict(row)), budget)
    return result, rows


@pytest.mark.parametrize("hessian", ["adaptive", "exact"])
def test_convergence_is_quadratic_near_the_solution(hessian: str) -> None:
    start = None
    if hessian == "exact":  # it does not get there from rest: begin at nine tenths of the way
        X = bent_bar().discretization.points
        start = X + 0.9 * (solve(bent_bar())[0].x - X)
    result, rows = solve(bent_bar(hessian=hessian), start)
    assert result.converged, result.reason
    norms = [row["relative_residual"] for row in rows]
    inside = [(a, b) for a, b in itertools.pairwise(norms) if a < 2.5e-3]
    assert any(b > 1e-11 for _, b in inside)  # something above rounding to judge by
    for a, b in inside:
        assert b < max(2.0 * a**2, 1e-11)
    assert rows[-1]["projected"] == 0
    assert rows[-1]["step_length"] == 1.0
    assert len(rows) < 16


@pytest.mark.parametrize("hessian", ["adaptive", "projected"])
def test_all_hessians_find_the_same_equilibrium(hessian: str) -> None:
    reference, _ = solve(bent_bar())
    result, rows = solve(bent_bar(hessian=hessian))
    assert result.converged
    np.testing.assert_allclose(result.x, reference.x, atol=1e-9)
    assert np.abs(result.x - bent_bar().discretization.points).max() > 0.3
    if hessian == "projected":
        assert all(row["projected"] == 1 for row in rows)


def test_phi_decreases_in_every_iteration() -> None:
    simulation = bent_bar()
    result, rows = solve(simulation)
    values = [row["objective"] for row in rows] + [simulation.problem.value(result.x)]
    assert np.all(np.diff(values) <= 1e-12 * abs(values[-1]))
    assert result.iterations == len(rows)
    assert [row["iteration"] for row in rows] == list(range(1, len(rows) + 1))
    assert result.linear_iterations >= result.iterations


def test_the_state_is_not_changed() -> None:
    simulation = bent_bar()
    before = simulation.state.copy()
    solve(simulation)
    np.testing.assert_array_equal(simulation.state.x, before.x)
    np.testing.assert_array_equal(simulation.state.v, before.v)


# ------------------------------------------------------------------------------------------- robustness


def twisted(law: str, turn: float, stretch: float) -> Simulation:
    return build(
        scene(
            {"b": body(block([1.0, 0.4, 0.4], [5, 2, 2]), material(law, E=1e5, nu=0.4))},
            {"kind": "fixed", "on": "b.left"},
            {"kind": "twist", "on": "b.right", "axis": [1, 0, 0], "rate": turn, "elongation_rate": stretch},
            time=quasistatic(),
        )
    )


@pytest.mark.parametrize("law", ["neo_hookean", "fixed_corotated"])
def test_large_twist_and_stretch_in_one_step(law: str) -> None:
    simulation = twisted(law, turn=2.5, stretch=1.0)
    result, _ = solve(simulation)
    assert result.converged, result.reason
    (group,) = simulation.discretization.groups
    assert jacobians(group, result.x).min() > 0.0


@pytest.mark.parametrize("law", ["neo_hookean", "fixed_corotated"])
def test_recovery_from_an_inverted_start(law: str) -> None:
    """Nodes thrown about at random: many cells inside out, and still the body finds its rest shape."""
    simulation = twisted(law, turn=0.0, stretch=0.0)
    problem, X = simulation.problem, simulation.discretization.points
    start = np.where(problem.free, random_state(X, 0.25, seed=3), X)
    (group,) = simulation.discretization.groups
    inverted = np.count_nonzero(jacobians(group, start) < 0.0)
    assert inverted > 0.2 * group.n_cells
    result, _ = solve(simulation, start)
    assert result.converged, result.reason
    assert jacobians(group, result.x).min() > 0.0
    np.testing.assert_allclose(result.x, X, atol=1e-6)


def test_recovery_from_a_point() -> None:
    """All free nodes in one point: F is singular in most cells."""
    simulation = twisted("neo_hookean", turn=0.0, stretch=0.0)
    problem, X = simulation.problem, simulation.discretization.points
    result, _ = solve(simulation, np.where(problem.free, [0.5, 0.2, 0.2], X))
    assert result.converged, result.reason
    np.testing.assert_allclose(result.x, X, atol=1e-6)


def test_the_logarithmic_law_is_never_accepted_inverted(monkeypatch: pytest.MonkeyPatch) -> None:
    simulation = build(
        scene(
            {"b": body(block([1.0, 0.4, 0.4], [4, 2, 2]), material("logarithmic_neo_hookean", E=1e5, nu=0.3))},
            {"kind": "fixed", "on": "b.left"},
            {"kind": "traction", "on": "b.right", "value": [0.0, -3e4, 0.0]},
            time=quasistatic(),
        )
    )
    problem: IncrementalPotential = simulation.problem
    (group,) = simulation.discretization.groups
    tried, evaluated = [], []
    value, gradient = problem.value, problem.gradient
    monkeypatch.setattr(problem, "value", lambda x: (tried.append(jacobians(group, x).min()), value(x))[1])
    monkeypatch.setattr(problem, "gradient", lambda x: (evaluated.append(jacobians(group, x).min()), gradient(x))[1])
    result, _ = solve(simulation)
    assert result.converged, result.reason
    assert min(tried) <= 0.0  # the load is large enough for the line search to have had to refuse something
    assert min(evaluated) > 0.0


def test_the_logarithmic_law_refuses_a_motion_that_crushes_cells() -> None:
    """Half of the bar's length at once: the step fails and says so, smaller steps succeed."""
    data = scene(
        {"b": body(block([1.0, 0.4, 0.4], [4, 2, 2]), material("logarithmic_neo_hookean", E=1e5, nu=0.3))},
        {"kind": "fixed", "on": "b.left"},
        {"kind": "translate", "on": "b.right", "velocity": [-1.2, 0.0, 0.0]},
        time=quasistatic(),
    )
    result, _ = solve(build(data))
    assert not result.converged
    assert "not finite" in result.reason
    simulation = build(data)
    for _ in range(8):
        step(simulation, 0.05)
    (group,) = simulation.discretization.groups
    assert 0.0 < jacobians(group, simulation.state.x).min() < 0.8


# ------------------------------------------------------------------------------------------- honesty


def test_too_few_iterations_are_not_convergence() -> None:
    result, rows = solve(bent_bar(max_iterations=1))
    assert not result.converged
    assert result.iterations == 1 == len(rows)
    assert "no convergence in 1 iterations" in result.reason
    assert result.relative_residual > 1e-12


@pytest.mark.parametrize("law", ["neo_hookean"])
def test_iterations_that_spread_a_prescribed_motion_count(law: str) -> None:
    simulation = twisted(law, turn=2.5, stretch=1.0)
    simulation.solver.options = simulation.solver.options.model_copy(update={"max_iterations": 1})  # type: ignore[attr-defined]
    result, rows = solve(simulation)
    assert not result.converged
    assert [row["iteration"] for row in rows] == [1]
    assert rows[0]["residual_norm"] == result.residual_norm
    assert rows[0]["step_length"] == 1.0


HELD = [
    pytest.param([], id="free"),
    pytest.param([{"kind": "fixed", "on": "b.left", "components": ["x"]}], id="on rollers"),
]


@pytest.mark.parametrize("supports", HELD)
def test_a_body_without_enough_supports_is_named_as_the_reason(supports: list[dict[str, Any]]) -> None:
    data = scene({"b": body(block([1, 1, 1], [2, 2, 2]))}, *supports, gravity=[0, -9.81, 0], time=quasistatic())
    result, _ = solve(build(data))
    assert not result.converged
    assert "is every body held, or has it inertia?" in result.reason


def test_a_flat_cloth_cannot_carry_its_weight_in_the_first_iteration() -> None:
    """Without inertia or tension a membrane has no stiffness out of its plane."""
    cloth = body({"recipe": "cloth", "cells": [3, 3]}, kind="membrane", thickness=0.01)
    data = scene({"c": cloth}, {"kind": "fixed", "on": "c.left"}, gravity=[0, -9.81, 0], time=quasistatic())
    result, _ = solve(build(data))
    assert not result.converged
    assert "singular" in result.reason


def test_too_few_linear_iterations_are_named_as_a_reason() -> None:
    data = scene({"b": body(block([1, 1, 1], [3, 3, 3]))}, {"kind": "fixed", "on": "b.left"}, gravity=[0, -9.81, 0])
    options = {"method": "ksp", "preset": "newton-icc", "options": {"ksp_max_it": 1}}
    result, _ = solve(build({**data, "linear_solver": options}))
    assert not result.converged
    assert "it needs more iterations (ksp_max_it) or another preset, or the system may be singular" in result.reason


def test_a_body_held_everywhere() -> None:
    data = scene(
        {"b": body(block([1, 1, 1], [1, 1, 1]))},
        {"kind": "rotate", "on": "b", "axis": [0, 1, 0], "rate": 1.0},
        time=quasistatic(),
    )
    simulation = build(data)
    assert not simulation.problem.free.any()
    step(simulation)
    assert simulation.problem.elastic_energy(simulation.state.x) < 1e-10


def test_nothing_to_do() -> None:
    data = scene({"b": body(block([1, 1, 1], [1, 1, 1]))}, {"kind": "fixed", "on": "b.left"}, time=quasistatic())
    result, rows = solve(build(data))
    assert result.converged
    assert rows == []
    assert result.relative_residual == 0.0


@pytest.mark.parametrize("static", [False, True])
@pytest.mark.parametrize("far", [0.0, 1e4])
def test_a_body_at_rest_stays_at_rest(static: bool, far: float) -> None:
    """Turned and far away, its forces are rounding and nothing else; that must not pass for a failure."""
    mesh = block([1, 1, 1], [2, 2, 2], rotate={"axis": [1, 2, 3], "angle": 0.7}, translate=[far, far, 0.0])
    data = scene(
        {"b": body(mesh)},
        *([{"kind": "fixed", "on": "b.left"}] if static else []),
        **({"time": quasistatic(dt=0.1)} if static else {}),
    )
    simulation = build(data)
    for _ in range(5):
        assert step(simulation).iterations <= 2
    np.testing.assert_allclose(simulation.state.x, simulation.discretization.points, atol=1e-14 * max(far, 1.0))


def test_rounding_ends_the_iteration() -> None:
    result, rows = solve(bent_bar(tolerance=1e-30, max_iterations=40))
    assert result.converged
    assert "rounding" in result.reason
    assert result.relative_residual < 1e-12
    assert len(rows) < 20


def test_supports_without_stiffness_across_them() -> None:
    """Nodes of a rod held across it: their own diagonal is zero, which must not make the system singular."""
    rod = body({"recipe": "rod", "cells": 4}, material(E=1e6, nu=0.0), kind="rod", cross_section=0.01)
    data = scene(
        {"r": rod},
        {"kind": "fixed", "on": "r", "components": ["y", "z"]},
        {"kind": "fixed", "on": "r.start"},
        {"kind": "point_load", "on": "r.end", "force": [1.0, 0.0, 0.0]},
        time=quasistatic(),
    )
    simulation = build(data)
    step(simulation)
    # E A = 1e4 N: a strain of 1e-4, up to the law's curvature.
    assert simulation.state.x[:, 0].max() - 1.0 == pytest.approx(1e-4, rel=1e-3)


def test_a_body_that_runs_away_is_no_solution() -> None:
    """Held along x only and pushed across, it leaves: rounding at its distance is no excuse for what is left over."""
    simulation = build(
        scene(
            {"b": body(block([1.0, 0.2], [6, 2]))},
            {"kind": "fixed", "on": "b.left", "components": ["x"]},
            {"kind": "point_load", "on": "b.right", "force": [0.0, 1.0]},
            time=quasistatic(),
        )
    )
    result, _ = solve(simulation)
    assert not result.converged, (result.reason, result.relative_residual)
