"""Bodies in a grid: each method against projected Newton, and what XPBD does not reach."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scenario

from femdeform.materials import LAWS
from femdeform.run.setup import Simulation
from femdeform.run.time_loop import take_step
from femdeform.step_problem import StepResult

NEWTON = {"method": "projected_newton", "tolerance": 1e-12}
CASES = [("linear", 2), ("quadratic", 2), ("linear", 3), ("quadratic", 3)]


def build(solver: dict[str, Any], kernel: str, dim: int, law: str, walls: str, E: float = 1e3) -> Simulation:
    """Two blocks that fall on each other and on an oblique plane; one is held at single components, one is pressed."""
    size, cells = [0.9, 0.6, 0.6][:dim], [4, 3, 3][:dim]
    stuff = scenario.material(law, E=E, nu=0.3, density=10.0)
    bodies = {
        "low": scenario.body(scenario.block(size, cells, translate=[0.02, 0.2, 0.03][:dim]), stuff),
        "high": scenario.body(scenario.block(size, cells, translate=[0.17, 0.82, 0.1][:dim]), stuff),
    }
    spin = [0.0, 3.0, -0.5] if dim == 3 else -1.0
    conditions = [
        {"kind": "initial_velocity", "on": "high", "velocity": [0.0, -5.0, 1.0][:dim], "angular_velocity": spin},
        {"kind": "translate", "on": "low.left", "velocity": [0.1, 0.0, 0.0][:dim], "components": ["x"]},
        {"kind": "pressure", "on": "high.top", "value": 20.0},
    ]
    # A block on an oblique plane and against a box, so that nodes are at two walls.
    obstacles = [
        {"kind": "plane", "point": [0.0, 0.12, 0.0][:dim], "normal": [0.1, 1.0, 0.0][:dim]},
        {"kind": "box", "min": [-0.1, -9.0, -9.0][:dim], "max": [0.95, 9.0, 9.0][:dim], "inside": True},
    ]
    return scenario.build(
        scenario.scene(
            bodies,
            *conditions,
            obstacles=obstacles,
            gravity=[0.0, -9.8, 0.0][:dim],
            grid={"cell_size": 0.2, "kernel": kernel, "cfl": 1.0, "obstacles": walls},
            solver=solver,
        )
    )


def steps(simulation: Simulation, count: int) -> StepResult:
    """That many steps of the scene's size."""
    for _ in range(count):
        result = take_step(simulation.problem, simulation.solver, simulation.state, 0.01)
        assert result.accepted, result.reason
        simulation.state = simulation.problem.accept(simulation.state, result.x)
    return result


@pytest.mark.parametrize(("kernel", "dim"), CASES)
@pytest.mark.parametrize("walls", ["separating", "slip", "sticky"])
def test_sweeps_converge_to_the_solution_of_newton(kernel: str, dim: int, walls: str) -> None:
    law = "neo_hookean" if walls == "slip" else "fixed_corotated"
    exact = build(NEWTON, kernel, dim, law, walls)
    assert steps(exact, 3).relative_residual < 1e-11
    assert exact.problem.rows is None if walls == "sticky" else exact.problem.rows is not None
    moved = np.abs(exact.state.x - exact.discretization.points).max()
    for method in ("b_pxpbd", "fp_pxpbd", "pbng"):
        options = {"method": method, "tolerance": 1e-10, "max_iterations": 400}
        found = build(options, kernel, dim, law, walls)
        result = steps(found, 3)
        assert result.converged
        assert result.relative_residual <= 1e-10
        assert np.abs(found.state.x - exact.state.x).max() < 1e-8 * moved
        assert np.abs(found.state.v - exact.state.v).max() < 1e-8 * np.abs(exact.state.v).max()


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", list(LAWS))
def test_sweeps_over_grid_nodes_for_every_law_of_stiff_bodies(law: str, dim: int) -> None:
    """kappa is 25 here, far beyond what sweeps over cells bear."""
    exact = build(NEWTON, "quadratic", dim, law, "separating", E=1e4)
    found = build({"method": "pbng", "tolerance": 1e-10}, "quadratic", dim, law, "separating", E=1e4)
    for simulation in (exact, found):
        result = steps(simulation, 2)
    assert result.converged
    assert result.relative_residual <= 1e-10
    moved = np.abs(exact.state.x - exact.discretization.points).max()
    assert np.abs(found.state.x - exact.state.x).max() < 1e-7 * moved


@pytest.mark.parametrize("more", [{"acceleration": "chebyshev"}, {"finish": "newton_krylov", "acceleration": "none"}])
def test_accelerations_and_the_finish_go_with_a_grid(more: dict[str, Any]) -> None:
    exact = build(NEWTON, "quadratic", 2, "neo_hookean", "separating", E=1e4)
    found = build({"method": "pbng", "tolerance": 1e-10, **more}, "quadratic", 2, "neo_hookean", "separating", E=1e4)
    steps(exact, 2)
    result = steps(found, 2)
    assert result.converged
    assert (result.linear_iterations > 0) == ("finish" in more)
    assert np.abs(found.state.x - exact.state.x).max() < 1e-8


def test_pbd_is_the_limit_of_stiff_xpbd() -> None:
    """The same sweeps with next to no compliance and with none; without walls, whose penalty grows with E."""
    found = []
    for solver, E in (({"method": "pbd"}, 1e3), ({"method": "xpbd", "epsilon": 0.0}, 1e15)):
        simulation = build({**solver, "iterations": 5}, "quadratic", 2, "fixed_corotated", "sticky", E)
        steps(simulation, 2)
        found.append(simulation.state.x)
    rest = simulation.discretization.points
    assert np.abs(found[0] - rest).max() > 0.01
    assert np.abs(found[0] - found[1]).max() < 1e-9


@pytest.mark.parametrize("kernel", ["linear", "quadratic"])
def test_xpbd_stalls_where_its_convergent_form_does_not(kernel: str) -> None:
    """A held bar on a coarse grid under a spin: kappa is 0.04 there."""

    def residuals(solver: dict[str, Any]) -> list[float]:
        bar = scenario.block([0.9, 0.3, 0.3], [3, 1, 1], translate=[0.2] * 3)
        stuff = scenario.material("fixed_corotated", E=1e3, nu=0.3, density=10.0)
        spin = {"kind": "initial_velocity", "on": "bar", "angular_velocity": [0, 0, -5.0], "center": [0, 0, 0]}
        held = {"kind": "fixed", "on": "bar.left"}
        grid = {"cell_size": 0.3, "kernel": kernel}
        simulation = scenario.build(
            scenario.scene({"bar": scenario.body(bar, stuff)}, held, spin, grid=grid, solver=solver)
        )
        problem, rows = simulation.problem, []
        problem.begin_step(simulation.state, 0.01)
        begin = problem.solver_state(simulation.state)
        start = problem.residual_norm(problem.gradient(problem.predictor(begin)))
        simulation.solver.step(problem, begin, lambda row, x: rows.append(float(row["residual_norm"]) / start))
        return rows

    stalled = residuals({"method": "xpbd", "iterations": 100})
    assert stalled[-1] > 1e-3
    assert stalled[-1] == pytest.approx(stalled[2], rel=0.01)
    blended = residuals({"method": "b_pxpbd", "iterations": 100, "zeta": 0.9})
    assert blended[-1] < 2e-12


def test_blend_by_the_rule_does_not_diverge_where_nodes_have_hundreds_of_cells() -> None:
    for E in (1e3, 1e4, 1e5):
        simulation = build({"method": "b_pxpbd", "iterations": 60}, "quadratic", 3, "fixed_corotated", "separating", E)
        rows: list[float] = []
        problem = simulation.problem
        problem.begin_step(simulation.state, 0.01)
        begin = problem.solver_state(simulation.state)
        simulation.solver.step(problem, begin, lambda row, x, to=rows: to.append(float(row["relative_residual"])))
        assert rows[-1] < rows[0] or rows[-1] < 1e-11


def test_a_prescribed_motion_is_that_of_the_nodes() -> None:
    mesh = scenario.block([1.0, 0.3, 0.3], [6, 2, 2], translate=[0.03, 0.02, 0.01])
    turn = {"kind": "twist", "on": "bar.right", "axis": [1.0, 0.0, 0.0], "rate": 4.0, "elongation_rate": 0.5}
    fixed = {"kind": "fixed", "on": "bar.left"}
    grid = {"cell_size": 0.15}
    simulation = scenario.build(scenario.scene({"bar": scenario.body(mesh)}, turn, fixed, grid=grid))
    scenario.advance(simulation, 10)
    conditions = simulation.conditions
    for motion in conditions.motions:
        np.testing.assert_allclose(simulation.state.x[motion.nodes], motion.positions(0.1), atol=1e-12)


def test_motions_that_differ_may_not_share_grid_nodes() -> None:
    mesh = scenario.block([0.2, 0.2], [4, 4])
    push = {"kind": "translate", "on": "a.right", "velocity": [1.0, 0.0]}
    fixed = {"kind": "fixed", "on": "a.left"}
    simulation = scenario.build(scenario.scene({"a": scenario.body(mesh)}, push, fixed, grid={"cell_size": 0.2}))
    with pytest.raises(Exception, match="two motions that differ hold the same grid nodes"):
        scenario.step(simulation)
