"""The budget of a step: what counts, what does not, and that the reference solver keeps to it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenario import block, body, build, material, quasistatic, scene

from femdeform.run.setup import Simulation
from femdeform.step_problem import Budget, StepResult


class Clock:
    """A clock that moves when it is told to."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_time_counts_from_the_start() -> None:
    clock = Clock()
    budget = Budget(seconds=2.0, clock=clock)
    clock.now += 5.0
    budget.start()
    assert budget.elapsed() == 0.0
    clock.now += 1.5
    assert budget.elapsed() == 1.5
    assert budget.spent(1000) is None
    clock.now += 0.5
    assert budget.spent(0) == "the budget of 2 s is spent"


def test_paused_time_does_not_count() -> None:
    clock = Clock()
    budget = Budget(seconds=2.0, clock=clock)
    clock.now += 1.0
    with budget.paused():
        clock.now += 10.0
        assert budget.elapsed() == 1.0
        with budget.paused():
            clock.now += 10.0
        clock.now += 10.0
        assert budget.elapsed() == 1.0
    assert budget.elapsed() == 1.0
    clock.now += 0.5
    assert budget.elapsed() == 1.5
    budget.start()
    assert budget.elapsed() == 0.0


def fail_in_a_pause(budget: Budget, clock: Clock) -> None:
    with budget.paused():
        clock.now += 3.0
        raise ZeroDivisionError


def test_the_clock_goes_on_after_an_error_inside_a_pause() -> None:
    clock = Clock()
    budget = Budget(clock=clock)
    with pytest.raises(ZeroDivisionError):
        fail_in_a_pause(budget, clock)
    clock.now += 1.0
    assert budget.elapsed() == 1.0


def test_iterations() -> None:
    budget = Budget(iterations=3)
    assert budget.spent(2) is None
    assert budget.spent(3) == "the budget of 3 iterations is spent"
    assert Budget(iterations=1).spent(1) == "the budget of 1 iteration is spent"
    assert Budget().spent(10**9) is None


@pytest.mark.parametrize("limits", [{"iterations": 0}, {"seconds": 0.0}, {"seconds": -1.0}, {"seconds": float("nan")}])
def test_a_budget_of_nothing_is_refused(limits: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="positive"):
        Budget(**limits)


# ------------------------------------------------------------------------------------------ projected Newton


def bent(*more: dict[str, Any]) -> Simulation:
    simulation = build(
        scene(
            {"b": body(block([1.0, 0.2, 0.2], [6, 2, 1]), material(E=1e5))},
            {"kind": "fixed", "on": "b.left"},
            {"kind": "traction", "on": "b.right", "value": [0.0, -1500.0, 0.0]},
            *more,
            time=quasistatic(),
        )
    )
    simulation.problem.begin_step(simulation.state, 1.0)
    return simulation


def solve(simulation: Simulation, budget: Budget, clock: Clock | None = None) -> tuple[StepResult, list[Any]]:
    """One step on a clock that moves by a second an iteration, and by ten more in a pause."""
    seen: list[Any] = []

    def observe(row: Any, x: Any) -> None:
        seen.append((dict(row), x.copy()))
        if clock is not None:
            clock.now += 1.0
            with budget.paused():
                clock.now += 10.0

    return simulation.solver.step(simulation.problem, simulation.state, observe, budget), seen


def test_newton_stops_after_its_iterations_at_the_last_iterate() -> None:
    simulation = bent()
    result, seen = solve(simulation, Budget(iterations=2))
    assert not result.converged
    assert result.reason == "the budget of 2 iterations is spent"
    assert result.iterations == 2 == len(seen)
    np.testing.assert_array_equal(result.x, seen[-1][1])
    norm = np.linalg.norm(simulation.problem.gradient(result.x))
    assert result.residual_norm == pytest.approx(norm, rel=1e-12)
    assert norm > 1e-3 * simulation.problem.force_scale


def test_newton_counts_seconds_by_the_clock_of_the_budget() -> None:
    clock = Clock()
    result, seen = solve(bent(), Budget(seconds=3.0, clock=clock), clock)
    assert [row["seconds"] for row, _ in seen] == [0.0, 1.0, 2.0]
    assert result.iterations == 3
    assert result.reason == "the budget of 3 s is spent"


def test_a_step_that_converges_within_its_budget_has_converged() -> None:
    free, _ = solve(bent(), Budget())
    assert free.converged
    result, _ = solve(bent(), Budget(iterations=free.iterations))
    assert result.converged
    np.testing.assert_array_equal(result.x, free.x)


def test_the_first_iteration_may_spend_the_budget() -> None:
    """A moving support is spread by an iteration of its own; it is reported and it counts."""
    pull = {"kind": "translate", "on": "b.back", "velocity": [0.0, 0.0, 0.02]}
    simulation = bent(pull)
    result, seen = solve(simulation, Budget(iterations=1))
    assert result.reason == "the budget of 1 iteration is spent"
    ((row, x),) = seen
    assert row["iteration"] == 1
    start = simulation.problem.initial_guess(simulation.state)
    simulation.problem.linearize_at(simulation.state.x)
    assert row["objective"] == pytest.approx(simulation.problem.value(start), rel=1e-12)
    assert simulation.problem.value(x) < row["objective"]
