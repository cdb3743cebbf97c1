"""Comparison: one start, one residual, one budget, and honesty about whoever fails."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from compared import MISBEHAVIOUR, bar, let_misbehave, write_bar
from scenario import block, body, build, material, quasistatic, scene, step, write

from femdeform.errors import InputError, NotConvergedError
from femdeform.fem.incremental_potential import IncrementalPotential
from femdeform.run.compare import Comparison, Variant, compare
from femdeform.run.compare_judge import Judge, mean_edge_length, stiffness_number
from femdeform.run.compare_trial import Trial
from femdeform.scene.load import load_scene
from femdeform.scene.meshing import load_meshes
from femdeform.step_problem import Budget
from femdeform.types import Mesh
from solvers.linear.scipy_direct import SciPyDirect
from solvers.mixed_variational import MixedVariational

EXACT = Variant("exact", ("solver.hessian=exact",))
PROJECTED = Variant("projected", ("solver.hessian=projected",))


def misbehaving(*names: str) -> list[Variant]:
    return [Variant(name, (MISBEHAVIOUR[name],)) for name in names]


def iterations_of(comparison: Comparison, label: str, step: int = 1) -> list[dict[str, Any]]:
    return [row for row in comparison.iterations if row["variant"] == label and row["step"] == step]


# ------------------------------------------------------------------------------------------------- answers


def test_all_hessians_reach_the_reference(tmp_path: Path) -> None:
    comparison = compare(write_bar(tmp_path), [EXACT, PROJECTED], iterations=100)
    assert comparison.labels == ["exact", "projected"]
    for row in comparison.steps:
        assert row["status"] == "converged"
        assert row["distance"] <= row["distance_max"] < 1e-8
        assert row["relative_residual"] < 1e-10
        assert row["elastic_energy"] == pytest.approx(comparison.reference[0]["elastic_energy"], rel=1e-8)
    # It is a real bend that they agree on, seen from the start.
    assert iterations_of(comparison, "exact")[0]["distance_max"] > 0.05
    assert comparison.of("projected")[0]["iterations"] > comparison.of("exact")[0]["iterations"]


def test_the_budget_of_iterations_is_kept_and_the_residual_is_the_true_one(tmp_path: Path) -> None:
    """Judged anew: on another simulation, from the positions that its solver reaches in as many iterations."""
    comparison = compare(write_bar(tmp_path), [PROJECTED], iterations=2)
    (row,) = comparison.steps
    assert (row["status"], row["iterations"]) == ("budget spent", 2)
    rows = iterations_of(comparison, "projected")
    assert [r["iteration"] for r in rows] == [0, 1, 2]

    simulation = build(bar(solver={"hessian": "projected", "tolerance": 1e-12}))
    problem, state = simulation.problem, simulation.state
    problem.begin_step(state, 0.25)
    iterates = [problem.initial_guess(state)]
    simulation.solver.step(problem, state, lambda _, x: iterates.append(x.copy()), Budget(iterations=2))
    reference = build(bar(solver={"tolerance": 1e-13}))
    step(reference)
    other = build(bar()).problem
    other.begin_step(state, 0.25)
    mass = simulation.discretization.lumped_mass
    for r, x in zip(rows, iterates, strict=True):
        residual = other.gradient(x)
        assert r["residual_norm"] == pytest.approx(np.linalg.norm(residual), rel=1e-9)
        assert r["residual_max"] == pytest.approx(np.abs(residual).max(), rel=1e-9)
        assert r["relative_residual"] == pytest.approx(np.linalg.norm(residual) / other.force_scale, rel=1e-9)
        assert r["objective"] == pytest.approx(other.value(x), rel=1e-9)
        gap = x - reference.state.x
        assert r["distance"] == pytest.approx(np.sqrt(np.average((gap**2).sum(axis=1), weights=mass)), rel=1e-6)
        assert r["distance_max"] == pytest.approx(np.linalg.norm(gap, axis=1).max(), rel=1e-6)
    assert row["residual_norm"] == rows[-1]["residual_norm"] == pytest.approx(row["reported_residual"], rel=1e-9)
    np.testing.assert_allclose(
        comparison.states["projected"]["displacement"], iterates[-1] - simulation.discretization.points, atol=1e-15
    )


def test_all_start_alike_with_the_same_scale(tmp_path: Path) -> None:
    comparison = compare(write_bar(tmp_path), [EXACT, PROJECTED, Variant("again")], iterations=1)
    names = ("seconds", "residual_norm", "objective", "distance", "force_scale")
    starts = [[row[name] for name in names] for row in comparison.iterations if row["iteration"] == 0]
    assert starts[0] == starts[1] == starts[2]
    assert starts[0][0] == 0.0


def test_the_common_start_is_a_step_of_the_reference(tmp_path: Path) -> None:
    comparison = compare(write_bar(tmp_path), [EXACT], iterations=50, start_step=2, steps=2)
    assert [row["step"] for row in comparison.steps] == [3, 4]
    assert [row["time"] for row in comparison.steps] == pytest.approx([0.75, 1.0])
    whole = build(bar(solver={"tolerance": 1e-12}))
    for _ in range(4):
        step(whole, 0.25)
    displacement = comparison.states["exact"]["displacement"]
    np.testing.assert_allclose(displacement, whole.state.x - whole.discretization.points, atol=1e-9)
    assert comparison.facts["start_time"] == pytest.approx(0.5)


def test_each_variant_goes_its_own_way(tmp_path: Path) -> None:
    """What one step left unsolved is in the next one's start, and in its scale."""
    path = write_bar(tmp_path, time={"scheme": "backward_euler", "dt": 0.02, "end": 0.2})
    comparison = compare(path, [PROJECTED, EXACT], iterations=1, steps=3)
    rough, exact = comparison.of("projected"), comparison.of("exact")
    assert rough[0]["force_scale"] == exact[0]["force_scale"]
    assert [row["step"] for row in rough] == [1, 2, 3]
    simulation = build(bar(time={"scheme": "backward_euler", "dt": 0.02, "end": 0.2}, solver={"hessian": "projected"}))
    problem, state = simulation.problem, simulation.state
    for row in rough:
        problem.begin_step(state, 0.02)
        assert row["force_scale"] == pytest.approx(problem.force_scale, rel=1e-9)
        state = problem.accept(state, simulation.solver.step(problem, state, None, Budget(iterations=1)).x)
        assert row["kinetic_energy"] == pytest.approx(problem.kinetic_energy(state.v), rel=1e-9)
        total = problem.kinetic_energy(state.v) + problem.elastic_energy(state.x) + problem.load_potential(state.x)
        assert row["total_energy"] == pytest.approx(total, rel=1e-9)
    assert rough[2]["force_scale"] != comparison.reference[2]["force_scale"]


def test_momentum_of_a_flying_body(tmp_path: Path) -> None:
    data = scene(
        {"b": body(block([1.0, 1.0, 1.0], [1, 1, 1]), material(density=50.0))},
        {"kind": "initial_velocity", "on": "b", "velocity": [1.0, 2.0, 3.0], "angular_velocity": [0.0, 0.0, 0.1]},
        solver={"tolerance": 1e-12},
    )
    row = compare(write(data, tmp_path / "s.yaml"), [EXACT], iterations=20).steps[0]
    assert [row[f"linear_momentum_{c}"] for c in "xyz"] == pytest.approx([50.0, 100.0, 150.0], rel=1e-9)
    # x cross m v of the centre, which has moved along the velocity, and a small spin on top.
    assert [row[f"angular_momentum_{c}"] for c in "xy"] == pytest.approx([25.0, -50.0], rel=1e-6)
    assert row["volume_ratio"] == pytest.approx(1.0, abs=1e-3)
    assert row["inverted_cells"] == 0.0


def test_a_body_at_rest_with_a_moving_support_has_a_scale(tmp_path: Path) -> None:
    """Nothing acts at the start; the forces of the reference stand in, whichever solver is judged."""
    pull = {"kind": "translate", "on": "b.right", "velocity": [0.1, 0.0]}
    comparison = compare(write_bar(tmp_path, pull), [EXACT, PROJECTED], iterations=1)
    reference = build(bar(pull, solver={"tolerance": 1e-13}))
    step(reference)
    reactions = np.linalg.norm(reference.problem.full_gradient(reference.state.x))
    for row in comparison.steps:
        assert row["force_scale"] == pytest.approx(reactions, rel=1e-6)
    first = iterations_of(comparison, "exact")
    assert [row["iteration"] for row in first] == [0, 1]
    assert first[0]["relative_residual"] > 1.0  # the whole motion in the cells at the support
    assert first[1]["relative_residual"] < 0.1


# ---------------------------------------------------------------------------------------------------- time


class Clock:
    """A clock that the work itself moves: some time for each linear solve, much more for each judgement."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, judging: float) -> None:
        self.now = 0.0
        self.cost = 1.0
        solve, residual = SciPyDirect.solve, Judge.residual

        def slow_solve(solver: Any, K: Any, b: Any) -> Any:
            self.now += self.cost
            return solve(solver, K, b)

        def slow_residual(judge: Any, x: Any) -> Any:
            self.now += judging
            return residual(judge, x)

        monkeypatch.setattr(SciPyDirect, "solve", slow_solve)
        monkeypatch.setattr(Judge, "residual", slow_residual)

    def __call__(self) -> float:
        return self.now


@pytest.mark.parametrize("judging", [0.0, 1000.0])
def test_a_budget_of_seconds_ends_a_step_and_judging_is_free(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, judging: float
) -> None:
    clock = Clock(monkeypatch, judging)
    comparison = compare(write_bar(tmp_path), [PROJECTED], seconds=2.5, steps=2, clock=clock)
    for row in comparison.steps:
        assert row["status"] == "budget spent"
        assert row["stopped_by"] == "the budget of 2.5 s is spent"
        assert (row["iterations"], row["seconds"]) == (3, 3.0)
    for number in (1, 2):
        assert [row["seconds"] for row in iterations_of(comparison, "projected", number)] == [0.0, 1.0, 2.0, 3.0]


def test_the_run_of_median_length_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Clock(monkeypatch, 0.0)
    costs = iter([5.0, 1.0, 3.0])
    run = Trial.run

    def run_at_its_cost(trial: Trial, remark: str = "") -> Any:
        clock.cost = next(costs)
        return run(trial, remark)

    monkeypatch.setattr(Trial, "run", run_at_its_cost)
    comparison = compare(write_bar(tmp_path), [PROJECTED], iterations=2, repeat=3, clock=clock)
    assert comparison.steps[0]["seconds"] == 6.0
    assert [row["seconds"] for row in comparison.iterations] == [0.0, 3.0, 6.0]
    assert comparison.facts["variants"]["projected"]["seconds_of_each_run"] == [10.0, 2.0, 6.0]


# ------------------------------------------------------------------------------------------------- failure


def test_a_variant_that_diverges_stops_and_the_others_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    let_misbehave(monkeypatch)
    comparison = compare(write_bar(tmp_path), [*misbehaving("nan", "nan at the end"), EXACT], iterations=50, steps=3)
    first, last = comparison.of("nan")
    assert first["status"] == "converged"
    assert last["status"] == "diverged"
    assert (last["step"], last["iterations"], last["stopped_by"]) == (2, 3, "iterate 3 is not finite")
    assert math.isnan(last["residual_norm"])
    assert math.isnan(last["total_energy"])
    assert [row["iteration"] for row in iterations_of(comparison, "nan", 2)] == [0, 1, 2]
    (only,) = comparison.of("nan at the end")
    assert only["status"] == "diverged"
    assert [row["status"] for row in comparison.of("exact")] == ["converged"] * 3
    assert set(comparison.states) == {"reference", "exact"}
    assert not comparison.all_diverged


def test_all_may_diverge(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    let_misbehave(monkeypatch)
    assert compare(write_bar(tmp_path), misbehaving("nan at the end"), iterations=5).all_diverged


def test_a_solver_that_misreports_is_found_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    let_misbehave(monkeypatch)
    comparison = compare(write_bar(tmp_path), [*misbehaving("liar"), PROJECTED], iterations=2)
    liar, honest = comparison.steps
    assert liar["residual_norm"] == honest["residual_norm"]
    assert liar["reported_residual"] == pytest.approx(0.5 * liar["residual_norm"])
    assert liar["status"] == "converged"  # it says so; the residual beside it says more
    (notice,) = comparison.notices
    assert notice == (
        "liar: the solver reports another residual than is measured in 1 of the steps, first in step 1: "
        f"{liar['reported_residual']:.3e} N reported, {liar['residual_norm']:.3e} N measured"
    )


def test_a_solver_that_gives_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    let_misbehave(monkeypatch)
    row = compare(write_bar(tmp_path), misbehaving("stubborn"), iterations=50).steps[0]
    assert (row["status"], row["stopped_by"]) == ("stopped", "the line search failed")
    assert row["distance"] < 1e-8  # where it gave up is what counts


def test_positions_without_forces_are_divergence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Finite, but inside out: the logarithmic law has no forces there."""
    let_misbehave(monkeypatch)
    data = bar(solver={})
    data["bodies"]["b"]["material"] = material("logarithmic_neo_hookean")
    row = compare(write(data, tmp_path / "s.yaml"), misbehaving("inside out"), iterations=50).steps[0]
    assert row["status"] == "diverged"
    assert not math.isfinite(row["residual_norm"])
    assert math.isfinite(row["distance"])
    # Other laws give forces to cells that are inside out, and those are counted.
    row = compare(write_bar(tmp_path), misbehaving("inside out"), iterations=50).steps[0]
    assert row["status"] == "converged"
    assert row["min_jacobian"] < 0.0
    assert row["inverted_cells"] == 24.0


def two_blocks(**more: Any) -> dict[str, Any]:
    """A small block beside a large one that is held, with contact between them."""
    bodies = {
        "small": body(block([0.1, 0.1], [1, 1], translate=[-0.2, 0.0])),
        "large": body(block([0.4, 0.4], [2, 2])),
    }
    held = {"kind": "fixed", "on": "large.bottom"}
    return scene(bodies, held, *more.pop("conditions", ()), contact={"method": "ipc"}, **more)


def test_a_way_that_bends_round_a_body_is_no_divergence() -> None:
    """A straight way to the other side of the large block leads through it: positions are judged, not ways."""
    simulation = build(two_blocks())
    judge = Judge(simulation)
    state = simulation.state
    small = simulation.conditions.local_nodes("small")
    inside, beyond = state.x.copy(), state.x.copy()
    inside[small] += [0.15, 0.1]
    beyond[small] += [0.7, 0.0]
    for target in (state.x, beyond):
        judge.begin_step(state, 0.01, target)
        assert math.isfinite(judge.residual(beyond)["objective"])
        assert math.isfinite(judge.residual(beyond)["relative_residual"])
        for _ in range(2):
            assert not math.isfinite(judge.residual(inside)["objective"])
            assert not math.isfinite(judge.residual(inside)["residual_norm"])
        assert math.isfinite(judge.residual(state.x)["objective"])


def test_a_budget_that_ends_on_the_way_of_the_supports_is_spent(tmp_path: Path) -> None:
    """Contact breaks the motion of the supports into portions, of which one is all that is paid for."""
    push = {"kind": "translate", "on": "small.left", "velocity": [0.14, 0.0]}
    data = two_blocks(conditions=[push], time=quasistatic(1.0))
    (row,) = compare(write(data, tmp_path / "s.yaml"), [EXACT], iterations=1).steps
    assert row["stopped_by"].startswith("only ")
    assert row["stopped_by"].endswith("the budget of 1 iteration is spent")
    assert row["status"] == "budget spent"


def test_a_reference_that_does_not_converge_is_an_error(tmp_path: Path) -> None:
    """The logarithmic law pulled through J = 0 by the supports."""
    crush = {"kind": "translate", "on": "b.right", "velocity": [-1.2, 0.0]}
    held = {"kind": "fixed", "on": "b.left"}
    stuff = material("logarithmic_neo_hookean", E=1e5)
    data = scene({"b": body(block([1.0, 0.4], [4, 2]), stuff)}, held, crush, time=quasistatic())
    with pytest.raises(NotConvergedError, match="the reference does not converge in step 1 to t = 1 s") as caught:
        compare(write(data, tmp_path / "s.yaml"), [EXACT], iterations=3)
    assert caught.value.exit_code == 3


def test_the_reference_does_not_depend_on_the_scene_being_solvable_in_its_iterations(tmp_path: Path) -> None:
    path = write_bar(tmp_path, solver={"max_iterations": 1, "hessian": "projected"})
    comparison = compare(path, [Variant("as it is")], iterations=9)
    assert comparison.reference[0]["relative_residual"] < 1e-10
    row = comparison.steps[0]
    assert (row["status"], row["stopped_by"]) == ("stopped", "no convergence in 1 iterations")


# ----------------------------------------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        ({}, "give a budget of either iterations or seconds"),
        ({"iterations": 1, "seconds": 1.0}, "give a budget of either iterations or seconds"),
        ({"iterations": 0}, "the budget of iterations must be positive, not 0"),
        ({"seconds": 0.0}, "the budget of seconds must be positive, not 0"),
        ({"seconds": math.inf}, "the budget of seconds must be positive, not inf"),
        ({"seconds": math.nan}, "the budget of seconds must be positive, not nan"),
        ({"iterations": 1, "steps": 0}, "steps and repeat must be positive"),
        ({"iterations": 1, "repeat": 0}, "steps and repeat must be positive"),
        ({"iterations": 1, "start_step": -1}, "start_step must not be negative"),
        ({"iterations": 1, "start_step": 3, "steps": 2}, "go beyond the scene's end: it has 4 steps of 0.25 s"),
    ],
)
def test_what_cannot_be_asked(tmp_path: Path, request_: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        compare(write_bar(tmp_path), [EXACT], **request_)


def test_several_ranks_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "2")
    with pytest.raises(InputError, match="compare is serial: run it without mpiexec"):
        compare(write_bar(tmp_path), [EXACT], iterations=1)


@pytest.mark.petsc
def test_options_that_petsc_refuses_name_their_variant(tmp_path: Path) -> None:
    path = write_bar(tmp_path, linear_solver={"method": "ksp"})
    variant = Variant("odd", ("linear_solver.options.ksp_rtoll=1e-3",))
    with pytest.raises(InputError, match=r"--variant odd: linear_solver\.options\.ksp_rtoll"):
        compare(path, [EXACT, variant], iterations=1)


# ------------------------------------------------------------------------------------------------- kappa


def test_mean_edge_length() -> None:
    triangle = Mesh(np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0]]), np.array([[0, 1, 2]]), "triangle")
    assert mean_edge_length(triangle) == pytest.approx(4.0)
    corner = Mesh(np.concatenate([np.zeros((1, 3)), np.eye(3)]), np.array([[0, 1, 2, 3]]), "tetra")
    assert mean_edge_length(corner) == pytest.approx((1.0 + math.sqrt(2.0)) / 2.0)
    rod = Mesh(np.array([[0.0, 0.0], [1.0, 0.0], [4.0, 0.0]]), np.array([[0, 1], [1, 2]]), "line")
    assert mean_edge_length(rod) == pytest.approx(2.0)


def test_the_stiffness_number_is_that_of_the_stiffest_body(tmp_path: Path) -> None:
    rods = {
        "soft": body({"recipe": "rod", "cells": 4}, material(E=1e4, density=100.0), kind="rod", cross_section=0.01),
        "stiff": body({"recipe": "rod", "cells": 2}, material(E=1e6, density=200.0), kind="rod", cross_section=0.01),
    }
    loaded = load_scene(write(scene(rods), tmp_path / "s.yaml"))
    kappa = stiffness_number(loaded.scene, load_meshes(loaded))
    assert kappa == pytest.approx(0.01**2 * 1e6 / (200.0 * 0.5**2), rel=1e-12)
    static = load_scene(write(scene(rods, time=quasistatic()), tmp_path / "q.yaml"))
    assert stiffness_number(static.scene, load_meshes(static)) == math.inf


def test_judging_does_not_touch_the_problem_that_is_solved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every judgement is made on one problem, and no solver ever steps it while it judges."""
    judged: list[IncrementalPotential] = []
    residual = Judge.residual
    monkeypatch.setattr(Judge, "residual", lambda judge, x: (judged.append(judge._problem), residual(judge, x))[1])
    solved: list[IncrementalPotential] = []
    begin = IncrementalPotential.linearize_at
    monkeypatch.setattr(
        IncrementalPotential, "linearize_at", lambda problem, x: (solved.append(problem), begin(problem, x))[1]
    )
    compare(write_bar(tmp_path), [EXACT, PROJECTED], iterations=3)
    assert len({id(problem) for problem in judged}) == 1
    assert len({id(problem) for problem in solved}) == 5  # the reference's, two warm-ups, two runs


# ------------------------------------------------------------------------------------------------- methods


def test_methods_with_a_promise_and_without(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Mixed finite elements beside the reference: to a tolerance, with fixed work, and cut short by the budget."""
    destroyed: list[str] = []
    destroy = MixedVariational.destroy
    monkeypatch.setattr(
        MixedVariational, "destroy", lambda solver: (destroyed.append(solver.options.scheme), destroy(solver))[1]
    )
    few, many = (
        Variant(f"{n} at most", ("solver.scheme=alternating", f"solver.inner_iterations={n}"), "mixed_fem")
        for n in (4, 12)
    )
    path = write_bar(tmp_path, time={"scheme": "backward_euler", "dt": 0.02, "end": 0.2})
    comparison = compare(path, [Variant("newton"), Variant("mixed", (), "mixed_fem"), few, many], iterations=8, steps=2)
    for label in ("newton", "mixed"):
        assert [row["status"] for row in comparison.of(label)] == ["converged"] * 2
        assert max(row["distance_max"] for row in comparison.of(label)) < 1e-7
    for row in comparison.of(few.label):
        assert (row["status"], row["iterations"]) == ("work done", 4)
        assert row["stopped_by"] == "fixed number of iterations"
    for row in comparison.of(many.label):
        assert (row["status"], row["iterations"]) == ("budget spent", 8)
    for variant in (few, many):
        rows = comparison.of(variant.label)
        assert all(row["relative_residual"] > 1e-12 for row in rows)
        start = iterations_of(comparison, variant.label)[0]
        assert rows[0]["distance"] < 0.2 * start["distance"]
    assert comparison.notices == []
    # Once when a solver is set up, once when it is done with: a warm-up and a run for each variant.
    assert destroyed.count("converged") == 4
    assert destroyed.count("alternating") == 8
