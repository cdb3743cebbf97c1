"""The mixed solver: its options, its saddle systems, honesty, and what it remembers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenario import block, body, build, material, quasistatic, random_state, scene, step, write

from femdeform.errors import InputError
from femdeform.fem.mixed_cells import MixedCells
from femdeform.run.checkpoint import read_checkpoint
from femdeform.run.result import Result
from femdeform.run.runner import run_scene
from femdeform.run.setup import Simulation
from femdeform.run.table import read_table
from femdeform.step_problem import Budget
from solvers.linear.constant_cg import ConstantCG
from solvers.linear.constant_matrix import ConstantMatrix
from solvers.linear.kkt import SaddleSolver
from solvers.linear.kkt_system import SaddleSystem
from solvers.mixed.converged import MixedRule

PETSC = {"method": "ksp"}
TIKHONOV = {"per": "compliance", "value": 0.1}


def mixed(**options: Any) -> dict[str, Any]:
    return {"method": "mixed_fem", **options}


def alternating(**options: Any) -> dict[str, Any]:
    return mixed(scheme="alternating", **options)


def bar(solver: dict[str, Any], law: str = "neo_hookean", **more: Any) -> dict[str, Any]:
    return scene(
        {"b": body(block([1.0, 0.4, 0.4], [3, 1, 1]), material(law, E=1e5, nu=0.4))},
        {"kind": "fixed", "on": "b.left"},
        {"kind": "initial_velocity", "on": "b.right", "velocity": [0.0, 3.0, -2.0]},
        **{
            "gravity": [0.0, -9.81, 0.0],
            "time": {"scheme": "backward_euler", "dt": 0.02, "end": 0.2},
            "solver": solver,
            **more,
        },
    )


def one_step(data: dict[str, Any], budget: Budget | None = None) -> tuple[Simulation, Any, list[dict[str, Any]]]:
    simulation = build(data)
    rows: list[dict[str, Any]] = []
    simulation.problem.begin_step(simulation.state, simulation.scene.time.dt)
    result = simulation.solver.step(
        simulation.problem, simulation.state, lambda row, x: rows.append({**row, "x": x.copy()}), budget
    )
    return simulation, result, rows


# ------------------------------------------------------------------------------------------- options


def test_the_linear_law_is_refused() -> None:
    with pytest.raises(InputError, match="principal stretches") as caught:
        build(bar(mixed(), law="linear"))
    assert caught.value.faults[0].key == "bodies.b.material.law"


@pytest.mark.parametrize(
    ("solver", "more", "words"),
    [
        (mixed(global_solve="kkt_cg"), {}, "solver.global_solve"),
        (alternating(global_solve="kkt_cg"), {}, "solver.global_solve"),
        (mixed(tikhonov=TIKHONOV), {}, "solver.tikhonov"),
        (alternating(global_solve="kkt_cg", tikhonov=TIKHONOV), {"time": quasistatic()}, "needs inertia"),
        (mixed(twist="sometimes"), {}, "twist"),
        (mixed(hessian="exact"), {}, "hessian"),
    ],
)
def test_options_that_do_not_fit_together(solver: dict[str, Any], more: dict[str, Any], words: str) -> None:
    data = bar(solver, **more)
    if "time" in more:
        del data["conditions"][1]
    with pytest.raises(InputError, match=words):
        build(data)


def test_projected_newton_is_still_the_default() -> None:
    assert build(bar({"max_iterations": 7})).scene.solver.method == "projected_newton"


# ------------------------------------------------------------------------------------------- saddle systems


def first_directions(method: str | None, matrix: str, static: bool, linear_solver: dict[str, Any]) -> Any:
    """Direction of the converged scheme at a deformed state, and the rows of its residual."""
    bodies = {
        "b": body(block([1.0, 0.5, 0.5], [3, 1, 1]), material(E=1e6, nu=0.4)),
        "c": body({"recipe": "cloth", "cells": [3, 3], "translate": [0, 0, 2]}, kind="membrane", thickness=0.01),
    }
    data = scene(
        bodies,
        {"kind": "fixed", "on": "b.left"},
        {"kind": "fixed", "on": "c.left"},
        {"kind": "fixed", "on": "c.right"},
        obstacles=[{"kind": "plane", "point": [0.0, -0.05, 0.0], "normal": [0, 1, 0], "stiffness": 1e5}],
        gravity=[0.0, -9.81, 0.0],
        linear_solver=linear_solver,
        **({"time": quasistatic()} if static else {}),
        solver=mixed(**({} if method is None else {"global_solve": method, "kkt_tolerance": 1e-11})),
    )
    simulation = build(data)
    problem, state = simulation.problem, simulation.state
    problem.begin_step(state, 0.01)
    solver: Any = simulation.solver
    solver._set_up(problem)
    if solver._constant is not None:
        solver._constant.begin(problem)
    rule: MixedRule = solver._rule
    X = simulation.discretization.points
    # The cloth is under tension, or statics would have a free motion out of its plane.
    x = np.where(problem.free, random_state(1.1 * X, 0.05, seed=1), X)
    rule.begin(problem, X)
    b = -problem.gradient(x)
    answer = rule.solve(problem, x, b, matrix)  # type: ignore[arg-type]
    columns = dict(rule.columns())
    simulation.solver.destroy()
    simulation.linear_solver.destroy()
    assert answer.converged, answer.reason
    return answer.x, columns


@pytest.mark.parametrize("static", [False, True], ids=["dynamic", "static"])
@pytest.mark.parametrize("matrix", ["definite", "exact", "spread"])
@pytest.mark.parametrize(
    ("method", "linear_solver"),
    [
        ("kkt_direct", {"method": "scipy_direct"}),
        ("kkt_minres", {"method": "scipy_direct"}),
        pytest.param("kkt_direct", PETSC, marks=pytest.mark.petsc),
        pytest.param("kkt_minres", PETSC, marks=pytest.mark.petsc),
    ],
    ids=["direct-scipy", "minres-scipy", "direct-petsc", "minres-petsc"],
)
def test_condensed_and_saddle_steps_agree(method: str, linear_solver: Any, matrix: str, static: bool) -> None:
    condensed, _ = first_directions(None, matrix, static, {"method": "scipy_direct"})
    saddle, rows = first_directions(method, matrix, static, linear_solver)
    atol = (1e-10 if method == "kkt_direct" else 1e-7) * np.abs(condensed).max()
    np.testing.assert_allclose(saddle, condensed, rtol=0.0, atol=atol)
    assert 0.0 <= rows["kkt_momentum_residual"] <= 1e-11
    assert 0.0 <= rows["kkt_constraint_residual"] <= 1e-11


@pytest.mark.parametrize("matrix", ["definite", "spread"])
@pytest.mark.parametrize("static", [False, True], ids=["dynamic", "static"])
def test_the_constant_preconditioner_gives_the_condensed_step(static: bool, matrix: str) -> None:
    """Solids and membranes in one system, contact in K and not in the preconditioner."""
    expected, _ = first_directions(None, matrix, static, {"method": "scipy_direct"})
    found, _ = first_directions("condensed_cg", matrix, static, {"method": "scipy_direct"})
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-7 * np.abs(expected).max())


def constant_solver(**more: Any) -> tuple[ConstantCG, Any]:
    """The solver with the constant preconditioner at the start of a step of a bar, and that bar's problem."""
    problem = build(bar(mixed(), **more)).problem
    return ConstantCG(ConstantMatrix([term.group for term in problem.elastic]), 1e-10, 200), problem


def test_spectrum_with_the_constant_preconditioner() -> None:
    """At rest P^-1 K has its eigenvalues in (0, (2 mu + 3 lambda) / (2 mu)]; components are pinned one by one."""
    data = scene(
        {"b": body(block([1.0, 0.5, 0.5], [4, 2, 2]), material("corotated", E=1e8, nu=0.45))},
        {"kind": "fixed", "on": "b.left", "components": ["x", "y"]},
        {"kind": "fixed", "on": "b.right", "components": ["z"]},
    )
    simulation = build(data)
    problem, x = simulation.problem, simulation.state.x
    problem.begin_step(simulation.state, 0.01)
    (group,) = [term.group for term in problem.elastic]
    constant = ConstantMatrix([group])
    constant.begin(problem)
    assert len(constant._parts) == 2
    cells = MixedCells(group, 0.1)
    cells.twists[:] = 0.0
    K = problem.hessian(x, project=True, elastic=lambda k, blocks, first: cells.hessian(x, False, False, blocks, first))
    import scipy.sparse

    n = x.size
    matrix = scipy.sparse.csr_matrix((K.values, K.columns, K.row_offsets), shape=(n, n)).toarray()
    inverse = np.stack([constant.solve(e.reshape(x.shape)).ravel() for e in np.eye(n)], axis=1)
    np.testing.assert_allclose(inverse, inverse.T, atol=1e-12 * np.abs(inverse).max())
    free = problem.free.ravel()
    values = np.linalg.eigvals(inverse[np.ix_(free, free)] @ matrix[np.ix_(free, free)]).real
    mu, lmbda = group.law.mu, group.law.lmbda
    assert values.min() > 0.0
    assert values.max() < (2.0 * mu + 3.0 * lmbda) / (2.0 * mu)
    assert values.max() > 0.3 * (2.0 * mu + 3.0 * lmbda) / (2.0 * mu)
    constant.destroy()


def test_the_constant_preconditioner_follows_the_time_step_and_reports_failure() -> None:
    solver, problem = constant_solver()
    constant = solver.constant
    constant.begin(problem)
    first = constant._parts[0][1]
    constant.begin(problem)
    assert constant._parts[0][1] is first
    problem.dt = 0.01
    constant.begin(problem)
    assert constant._parts[0][1] is not first
    K = problem.hessian(problem.discretization.points, project=True)
    b = np.where(problem.free, 1.0, 0.0)
    solver.max_iterations = 1
    early = solver.solve(K, b)
    assert not early.converged
    assert early.iterations == 1
    K.values[:] *= -1.0
    negative = solver.solve(K, b)
    assert not negative.converged
    assert "definite" in negative.reason
    constant.destroy()


@pytest.mark.parametrize("linear_solver", [{"method": "scipy_direct"}, pytest.param(PETSC, marks=pytest.mark.petsc)])
@pytest.mark.parametrize("tikhonov", [None, TIKHONOV])
def test_all_global_solves_of_the_alternating_scheme_agree(linear_solver: Any, tikhonov: Any) -> None:
    methods = ["condensed", "condensed_cg", "kkt_direct", "kkt_minres"] + (["kkt_cg"] if tikhonov else [])
    answers = {}
    for method in methods:
        solver = alternating(global_solve=method, tikhonov=tikhonov, kkt_tolerance=1e-10)
        data = bar(solver, linear_solver=linear_solver)
        simulation, result, rows = one_step(data)
        assert result.accepted, result.reason
        assert len(rows) == 5
        if method.startswith("kkt"):
            for row in rows:
                assert 0.0 <= row["kkt_momentum_residual"] <= 1e-10
                assert 0.0 <= row["kkt_constraint_residual"] <= 1e-10
        else:
            assert all(0.0 <= row["kkt_momentum_residual"] <= 1e-9 for row in rows)
        simulation.solver.destroy()
        simulation.linear_solver.destroy()
        answers[method] = result.x
    for method in methods[1:]:
        np.testing.assert_allclose(answers[method], answers["condensed"], rtol=0.0, atol=1e-8)


def dense_system(seed: int) -> tuple[SaddleSystem, Any, Any, ConstantMatrix]:
    """The system of one state of a bar with two multipliers a cell made up, and its dense matrix."""
    simulation = build(bar(mixed()))
    problem = simulation.problem
    problem.begin_step(simulation.state, 0.02)
    rng = np.random.default_rng(seed)
    (term,) = problem.elastic
    cells = term.group.cells
    A = problem.hessian(simulation.discretization.points, True)
    B = rng.standard_normal((len(cells), 1, 2, 12))
    C = np.broadcast_to(np.array([[2.0, 0.5], [0.5, 1.0]]), (len(cells), 1, 2, 2)).copy() * 1e-6
    n, m = A.free.size, 2 * len(cells)
    import scipy.sparse

    K = np.zeros((n + m, n + m))
    K[:n, :n] = scipy.sparse.csr_matrix((A.values, A.columns, A.row_offsets), shape=(n, n)).toarray()
    dofs = (3 * cells[:, :, None] + np.arange(3)).reshape(len(cells), 12)
    free = A.free.ravel()
    for e in range(len(cells)):
        rows = n + 2 * e + np.arange(2)
        K[np.ix_(rows, dofs[e])] += B[e, 0] * free[dofs[e]]
        K[np.ix_(dofs[e], rows)] += (B[e, 0] * free[dofs[e]]).T
        K[np.ix_(rows, rows)] -= C[e, 0]
    constant = ConstantMatrix([term.group])
    constant.begin(problem)
    return SaddleSystem(A, [cells], [B], [C]), K, rng, constant


@pytest.mark.parametrize("method", ["kkt_direct", "kkt_minres", "kkt_cg"])
@pytest.mark.parametrize("use_petsc", [False, pytest.param(True, marks=pytest.mark.petsc)])
def test_saddle_solvers_against_a_dense_solve(method: str, use_petsc: bool) -> None:
    system, K, rng, constant = dense_system(0)
    n = system.A.free.size
    solver = SaddleSolver(method, 1e-12, 500, use_petsc, constant)
    for _ in range(2):
        b = rng.standard_normal(len(K))
        b[:n] *= system.A.free.ravel()
        expected = np.linalg.solve(K, b)
        answer = solver.solve(system, b[:n].reshape(-1, 3), [b[n:].reshape(system.B[0].shape[:3])], system.C)
        assert answer.converged, answer.reason
        np.testing.assert_allclose(answer.x.ravel(), expected[:n], atol=1e-9 * np.abs(expected[:n]).max())
        np.testing.assert_allclose(answer.y[0].ravel(), expected[n:], atol=1e-9 * np.abs(expected[n:]).max())
    solver.destroy()


@pytest.mark.parametrize("method", ["kkt_minres", "kkt_cg"])
def test_a_saddle_solver_that_stops_early_says_so(method: str) -> None:
    system, K, rng, constant = dense_system(1)
    n = system.A.free.size
    b = rng.standard_normal(len(K))
    b[:n] *= system.A.free.ravel()
    solver = SaddleSolver(method, 1e-12, 1, False, constant)
    C0 = [np.broadcast_to(np.eye(2), system.C[0].shape) * 1e-3]
    answer = solver.solve(system, b[:n].reshape(-1, 3), [b[n:].reshape(system.B[0].shape[:3])], C0)
    assert not answer.converged
    assert max(answer.momentum_residual, answer.constraint_residual) > 1e-12


def test_a_matrix_that_is_not_finite_is_refused() -> None:
    system, _, _, _ = dense_system(2)
    system.B[0][0, 0, 0, 0] = np.nan
    solver = SaddleSolver("kkt_direct", 1e-8, 10, False)
    n = system.A.free.size
    answer = solver.solve(system, np.ones((n // 3, 3)), [np.ones(system.B[0].shape[:3])])
    assert not answer.converged
    assert "finite" in answer.reason


# ------------------------------------------------------------------------------------------- honesty


def test_a_fixed_number_of_iterations_is_not_convergence() -> None:
    _, result, rows = one_step(bar(alternating(inner_iterations=3)))
    assert not result.converged
    assert result.is_fixed_work
    assert result.accepted
    assert result.reason == "fixed number of iterations"
    assert result.iterations == 3 == len(rows)
    assert result.relative_residual > 1e-8


def test_the_alternating_scheme_says_when_it_has_converged() -> None:
    _, result, _ = one_step(bar(alternating(outer_iterations=20, inner_iterations=1)))
    assert result.converged
    assert not result.is_fixed_work
    assert result.relative_residual <= 1e-8
    assert result.iterations < 20


def test_too_few_iterations_of_the_converged_scheme() -> None:
    _, result, rows = one_step(bar(mixed(max_iterations=1)))
    assert not result.accepted
    assert "no convergence in 1 iterations" in result.reason
    assert len(rows) == 1


@pytest.mark.parametrize("solver", [mixed(), alternating(inner_iterations=8)])
def test_budgets_are_kept(solver: dict[str, Any]) -> None:
    _, result, rows = one_step(bar(solver), Budget(iterations=2))
    assert not result.accepted
    assert "budget of 2 iterations" in result.reason
    assert [row["iteration"] for row in rows] == [1, 2]
    np.testing.assert_array_equal(rows[-1]["x"], result.x)
    assert rows[-1]["residual_norm"] == result.residual_norm


@pytest.mark.parametrize("solver", [mixed(), alternating()])
def test_the_state_is_not_changed(solver: dict[str, Any]) -> None:
    simulation = build(bar(solver))
    before = simulation.state.copy()
    simulation.problem.begin_step(simulation.state, 0.02)
    simulation.solver.step(simulation.problem, simulation.state)
    np.testing.assert_array_equal(simulation.state.x, before.x)
    np.testing.assert_array_equal(simulation.state.v, before.v)


def test_twisted_cells_are_logged() -> None:
    _, result, rows = one_step(bar(mixed()))
    assert result.converged
    n_cells = 3 * 5
    assert all(0 <= row["twisted_cells"] <= n_cells for row in rows)
    assert any(row["twisted_cells"] > 0 for row in rows)


@pytest.mark.parametrize(("speed", "backtracks", "succeeds"), [(30.0, 30, True), (60.0, 30, True), (60.0, 1, False)])
def test_the_logarithmic_law_stays_where_it_is_defined(speed: float, backtracks: int, succeeds: bool) -> None:
    """Thrown so hard that the predictor turns cells inside out: the step recovers, or says that it cannot."""
    solver = alternating(inner_iterations=4, line_search={"max_backtracks": backtracks})
    data = bar(solver, law="logarithmic_neo_hookean")
    data["conditions"][1]["velocity"] = [-speed, 5.0, 0.0]
    simulation, result, _ = one_step(data)
    problem = simulation.problem
    assert not np.isfinite(problem.elastic_energy(problem.predictor(simulation.state)))
    assert result.accepted == succeeds
    if succeeds:
        assert problem.value(result.x) < problem.value(simulation.state.x)
    else:
        assert "line search failed" in result.reason or "not finite" in result.reason


@pytest.mark.parametrize("solver", [mixed(), alternating()])
def test_a_free_body_in_statics_is_an_error_in_words(solver: dict[str, Any]) -> None:
    data = scene({"b": body(block([1, 1, 1], [2, 2, 2]))}, gravity=[0, -9.81, 0], time=quasistatic(), solver=solver)
    _, result, _ = one_step(data)
    assert not result.converged
    assert result.reason


# ------------------------------------------------------------------------------------------- memory


def test_stretches_travel_from_step_to_step() -> None:
    """The second step starts from the stretch of the first, not from that of its positions; after a reset it does."""
    simulation = build(bar(alternating(inner_iterations=1)))
    problem, solver = simulation.problem, simulation.solver
    state = simulation.state
    problem.begin_step(state, 0.02)
    first = solver.step(problem, state)
    state = problem.accept(state, first.x)

    def second() -> Any:
        problem.begin_step(state, 0.02)
        return solver.step(problem, state).x

    carried, again = second(), second()
    np.testing.assert_array_equal(again, carried)  # a retried step finds its stretch again
    solver.reset()
    anew = second()
    assert np.abs(anew - carried).max() > 1e-9
    fresh = build(bar(alternating(inner_iterations=1)))
    fresh.problem.begin_step(state, 0.02)
    np.testing.assert_array_equal(fresh.solver.step(fresh.problem, state).x, anew)


@pytest.mark.parametrize("solver", [mixed(), alternating(inner_iterations=2)], ids=["converged", "alternating"])
def test_a_resumed_run_repeats_an_unbroken_one(solver: dict[str, Any], tmp_path: Path) -> None:
    data = bar(solver, output={"checkpoint_every": 4}, on_failure={"action": "stop"})
    assert run_scene(write(data, tmp_path / "s.yaml"), out=tmp_path / "whole", trace=True) == 0
    # The checkpoint of step 8, as a killed run leaves it.
    short = {**data, "time": {**data["time"], "end": 0.16}}
    assert run_scene(write(short, tmp_path / "t.yaml"), out=tmp_path / "short") == 0
    whole, short_run = read_checkpoint(tmp_path / "whole"), read_checkpoint(tmp_path / "short")
    assert short_run.step == 8
    simulation = build(data)
    simulation.state.x[:], simulation.state.v[:] = short_run.fields["x"], short_run.fields["v"]
    simulation.state.time, simulation.state.step = short_run.time, short_run.step
    for _ in range(2):
        simulation.problem.begin_step(simulation.state, 0.02)
        result = simulation.solver.step(simulation.problem, simulation.state)
        assert result.accepted
        simulation.state = simulation.problem.accept(simulation.state, result.x)
    np.testing.assert_allclose(simulation.state.x, whole.fields["x"], rtol=0.0, atol=1e-13)
    history = read_table(tmp_path / "whole" / "history.csv")
    facts = Result.open(tmp_path / "whole").facts
    assert facts["method"] == "mixed_fem"
    if solver.get("scheme") == "alternating":
        assert set(history["stopped_by"]) == {"fixed number of iterations"}
        assert facts["residual_tolerance"].startswith("none")
    else:
        assert set(history["stopped_by"]) == {"residual below tolerance"}
        iterations = read_table(tmp_path / "whole" / "iterations.csv")
        assert "twisted_cells" in iterations


def test_quasistatic_with_moving_pins() -> None:
    data = scene(
        {"b": body(block([1.0, 0.4, 0.4], [3, 1, 1]), material("corotated", E=1e5))},
        {"kind": "fixed", "on": "b.left"},
        {"kind": "translate", "on": "b.right", "velocity": [0.2, 0.1, 0.0]},
        time=quasistatic(0.5),
    )
    reference = build(data)
    step(reference)
    for solver in (mixed(), alternating(outer_iterations=30, inner_iterations=1)):
        simulation = build({**data, "solver": solver})
        simulation.problem.begin_step(simulation.state, 0.5)
        result = simulation.solver.step(simulation.problem, simulation.state)
        assert result.converged, result.reason
        np.testing.assert_allclose(result.x, reference.state.x, atol=1e-7)


# ------------------------------------------------------------------------------------------- hard cases


@pytest.mark.parametrize("global_solve", ["kkt_minres", "condensed_cg"])
def test_linear_iterations_do_not_grow_with_the_stiffness(global_solve: str) -> None:
    counts = []
    for E in (1e5, 1e7, 1e9):
        data = scene(
            {"b": body(block([1.0, 0.5, 0.5], [4, 2, 2]), material("corotated", E=E, nu=0.45))},
            {"kind": "fixed", "on": "b.left"},
            {"kind": "initial_velocity", "on": "b", "velocity": [0.0, 2.0, -3.0], "angular_velocity": [4.0, 0.0, 3.0]},
            gravity=[0.0, -9.81, 0.0],
            time={"scheme": "backward_euler", "dt": 1.0 / 60.0, "end": 1.0},
            solver=alternating(global_solve=global_solve, inner_iterations=3),
        )
        simulation, result, rows = one_step(data)
        assert result.accepted, result.reason
        counts.append(max(row["linear_iterations"] for row in rows))
        simulation.solver.destroy()
    assert counts[2] <= 3 * counts[0]
    assert counts[2] <= 1.5 * counts[1]


def test_a_predictor_outside_the_law_is_walked_towards_not_taken() -> None:
    """A soft bar that folds: free flight turns cells inside out, where a logarithmic law has no energy."""
    data = scene(
        {"b": body(block([1.0, 0.5, 0.5], [4, 2, 2]), material("logarithmic_neo_hookean", E=1e4, nu=0.45))},
        {"kind": "fixed", "on": "b.left"},
        {"kind": "initial_velocity", "on": "b.right", "velocity": [0.0, 2.0, -3.0]},
        gravity=[0.0, -9.81, 0.0],
        time={"scheme": "backward_euler", "dt": 1.0 / 30.0, "end": 2.0},
        solver=alternating(tikhonov={"per": "compliance", "value": 1.0, "proximal": True}),
    )
    simulation = build(data)
    problem, outside = simulation.problem, 0
    for _ in range(32):
        problem.begin_step(simulation.state, 1.0 / 30.0)
        outside += not np.isfinite(problem.value(problem.predictor(simulation.state)))
        result = simulation.solver.step(problem, simulation.state)
        assert result.accepted, result.reason
        assert np.isfinite(problem.value(result.x))
        simulation.state = problem.accept(simulation.state, result.x)
    assert outside > 0


@pytest.mark.petsc
def test_the_momentum_row_of_a_sloppy_condensed_solve_is_reported() -> None:
    """The residual of the first row over its own terms, as the saddle solvers report it."""
    found = []
    for rtol in (1e-1, 1e-3, 1e-9):
        linear = {"method": "ksp", "preset": "newton-ssor", "options": {"ksp_rtol": rtol}}
        _, result, rows = one_step(bar(alternating(inner_iterations=1), linear_solver=linear))
        assert result.accepted
        found.append(rows[0]["kkt_momentum_residual"])
    assert found[0] > 10.0 * found[1] > 1e4 * found[2] > 0.0


@pytest.mark.petsc
def test_multigrid_on_the_condensed_system() -> None:
    """GAMG gets the six rigid-body modes; its iterations grow slowly and its answer is the factorisation's."""
    counts = []
    for cells in ([10, 5, 5], [16, 8, 8]):
        answers = {}
        for preset in ("newton-gamg", "newton-mumps"):
            data = scene(
                {"b": body(block([2.0, 1.0, 1.0], cells), material(E=1e6, nu=0.45))},
                {"kind": "fixed", "on": "b.left"},
                gravity=[0.0, -9.81, 0.0],
                time=quasistatic(),
                solver=mixed(),
                linear_solver={"method": "ksp", "preset": preset},
            )
            simulation, result, rows = one_step(data)
            assert result.converged
            answers[preset] = result.x
            if preset == "newton-gamg":
                counts.append(rows[0]["linear_iterations"])
                assert len(simulation.linear_solver._matrix.getNearNullSpace().getVecs()) == 6
            simulation.solver.destroy()
            simulation.linear_solver.destroy()
        moved = np.abs(answers["newton-mumps"] - simulation.discretization.points).max()
        np.testing.assert_allclose(answers["newton-gamg"], answers["newton-mumps"], rtol=0.0, atol=1e-6 * moved)
    assert counts[1] <= 1.4 * counts[0], counts
