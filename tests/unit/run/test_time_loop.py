"""Stepping with a failure policy: which steps are tried, accepted, halved; when it stops."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from femdeform.fem.incremental_potential import State
from femdeform.run.time_loop import LoopOutcome, SolverStepper, StepControl, default_min_dt, run_time_loop
from femdeform.step_problem import StepResult


@dataclass
class Fake:
    """A problem and a solver in one, whose steps fail where `fails(time, dt)` says."""

    fails: Callable[[float, float], bool]
    tried: list[tuple[float, float]] = field(default_factory=list)
    accepted: list[float] = field(default_factory=list)
    failures: list[tuple[float, bool]] = field(default_factory=list)
    dt: float = 0.0
    limit: Callable[[float], float] = lambda time: np.inf
    refuses: Callable[[float], str] = lambda dt: ""
    limited: list[tuple[float, float]] = field(default_factory=list)

    def solver_state(self, state: State) -> State:
        return state

    def step_limit(self, state: State) -> float:
        return self.limit(state.time)

    def refusal(self, x: Any) -> str:
        return self.refuses(self.dt)

    def begin_step(self, state: State, dt: float) -> None:
        self.dt = dt

    def step(self, problem: Any, state: State, observe: Any = None) -> StepResult:
        self.tried.append((state.time, self.dt))
        bad = self.fails(state.time, self.dt)
        return StepResult(state.x + self.dt, not bad, "too hard" if bad else "fine", 3, 3, 1.0, 0.5)

    def accept(self, state: State, x: Any) -> State:
        return State(x, state.v, state.time + self.dt, state.step + 1)

    def run(self, control: StepControl, time: float = 0.0) -> LoopOutcome[State]:
        state = State(np.zeros((1, 2)), np.zeros((1, 2)), time)
        return run_time_loop(
            SolverStepper(self, self),  # type: ignore[arg-type]
            control,
            state,
            on_accept=lambda state, result, dt: self.accepted.append(dt),
            on_failure=lambda state, result, dt, retry: self.failures.append((dt, retry)),
            observe=lambda step: None,
            on_limit=lambda state, dt, limit: self.limited.append((dt, limit)),
        )


def never(time: float, dt: float) -> bool:
    return False


def control(dt: float = 0.1, end: float = 1.0, min_dt: float = 0.01, halve: bool = True) -> StepControl:
    return StepControl(dt, end, min_dt, halve)


def moments(fake: Fake, steps: StepControl) -> list[tuple[float, float, int]]:
    """Time, step size and streak after each accepted step of a whole run."""
    found: list[tuple[float, float, int]] = []
    run_time_loop(
        SolverStepper(fake, fake),  # type: ignore[arg-type]
        steps,
        State(np.zeros((1, 2)), np.zeros((1, 2))),
        on_accept=lambda state, result, dt: found.append((state.time, steps.current, steps.streak)),
        on_failure=lambda state, result, dt, retry: None,
        observe=lambda step: None,
    )
    return found


def test_equal_steps_to_the_end() -> None:
    fake = Fake(never)
    outcome = fake.run(control())
    assert outcome.finished
    assert outcome.reason == ""
    assert outcome.state.step == 10
    assert outcome.state.time == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(fake.accepted, 0.1)


@pytest.mark.parametrize(("dt", "end", "steps"), [(0.3, 1.0, 4), (0.1, 0.7, 7), (1.0, 1.0, 1), (1.0 / 3.0, 1.0, 3)])
def test_the_last_step_ends_at_the_end(dt: float, end: float, steps: int) -> None:
    """What is left is a step of its own, unless it is rounding."""
    fake = Fake(never)
    outcome = fake.run(control(dt=dt, end=end, min_dt=dt / 64))
    assert outcome.state.step == steps
    assert outcome.state.time == pytest.approx(end, rel=1e-12)
    assert max(fake.accepted) <= dt * (1.0 + 1e-9)


def test_halving_and_return_to_the_step_asked_for() -> None:
    """From t = 0.22 to 0.35 only steps of at most 0.03 succeed."""
    fake = Fake(lambda time, dt: time + dt > 0.22 and time < 0.35 and dt > 0.03)
    outcome = fake.run(control())
    assert outcome.finished
    assert fake.failures[:2] == [(0.1, True), (0.05, True)]
    assert min(fake.accepted[:-1]) == 0.025
    sizes = [(size, len(list(equal))) for size, equal in itertools.groupby(fake.accepted)]
    for (before, count), (after, _) in itertools.pairwise(sizes):
        assert after <= 2.0 * before * (1.0 + 1e-12)  # no jump back
        assert before == 0.1 or count >= 3  # nor at the first success
    assert fake.accepted.count(0.1) >= 6
    assert sum(fake.accepted) == pytest.approx(1.0, abs=1e-12)
    # A retry starts from the state of the failed attempt.
    (first, second, third) = fake.tried[2:5]
    assert first[0] == second[0] == third[0]
    assert (first[1], second[1], third[1]) == (0.1, 0.05, 0.025)


def test_it_stops_at_the_smallest_step() -> None:
    fake = Fake(lambda time, dt: time > 0.45)
    outcome = fake.run(control(min_dt=0.02))
    assert not outcome.finished
    assert outcome.state.step == 5
    assert outcome.state.time == pytest.approx(0.5)
    assert fake.failures == [(0.1, True), (0.05, True), (0.025, False)]
    for part in ("step 6", "too hard", "min_dt = 0.02 s", "5.00e-01"):
        assert part in outcome.reason


def test_stop_means_no_second_attempt() -> None:
    fake = Fake(lambda time, dt: time > 0.45)
    outcome = fake.run(control(halve=False))
    assert not outcome.finished
    assert fake.failures == [(0.1, False)]
    assert "min_dt" not in outcome.reason


def test_a_failed_last_step_is_halved_itself() -> None:
    """A remainder shorter than half of dt: halving dt alone would try the very same step again."""
    fake = Fake(lambda time, dt: time > 0.95 and dt > 0.015)
    outcome = fake.run(control(dt=0.32, end=1.0, min_dt=0.001))
    assert outcome.finished
    assert len(set(fake.tried)) == len(fake.tried)


def test_going_on_with_a_small_step() -> None:
    fake = Fake(never)
    outcome = fake.run(StepControl(0.1, 1.0, 0.01, True, current=0.025), time=0.5)
    assert outcome.finished
    np.testing.assert_allclose(fake.accepted[:7], [0.025] * 3 + [0.05] * 3 + [0.1])


def test_a_step_size_that_keeps_failing_is_not_tried_after_every_success() -> None:
    fake = Fake(lambda time, dt: dt > 0.5)
    outcome = fake.run(control(dt=1.0, end=30.0))
    assert outcome.finished
    assert fake.accepted == [0.5] * 60
    assert len(fake.failures) == 20


def test_going_on_in_the_midst_of_small_steps() -> None:
    """Whatever step a run is broken at, time, size and streak are all that the rest depends on."""
    hard = Fake(lambda time, dt: 0.3 < time + dt < 0.5 and dt > 0.03)
    left = moments(hard, control())
    assert {streak for _, _, streak in left} == {0, 1, 2}
    for time, current, streak in left:
        rest = Fake(hard.fails)
        rest.run(StepControl(0.1, 1.0, 0.01, True, current, streak), time)
        assert rest.tried == hard.tried[len(hard.tried) - len(rest.tried) :]
        assert time == 1.0 or rest.tried[0][0] == time


def test_nothing_left_to_do() -> None:
    fake = Fake(never)
    outcome = fake.run(control(), time=1.0)
    assert outcome.finished
    assert fake.tried == []


def test_default_smallest_step() -> None:
    assert default_min_dt(0.64, None) == 0.01
    assert default_min_dt(0.64, 0.3) == 0.3


def test_a_limit_of_the_problem_halves_the_step_for_as_long_as_it_holds() -> None:
    fake = Fake(never, limit=lambda time: 0.03 if time < 0.19 else np.inf)
    outcome = fake.run(control(end=0.4))
    assert outcome.finished
    np.testing.assert_allclose(fake.accepted, [0.025] * 8 + [0.1, 0.1])
    assert fake.limited == [(0.025, 0.03)] * 8
    assert fake.failures == []


def test_a_limit_below_the_smallest_step_ends_the_run() -> None:
    fake = Fake(never, limit=lambda time: 0.001 if time > 0.15 else 1.0)
    outcome = fake.run(control(min_dt=0.01))
    assert not outcome.finished
    assert "step 3 from t = 0.2 s may not be longer than 0.001 s" in outcome.reason
    assert outcome.state.step == 2


def test_a_solved_step_that_the_problem_refuses_is_halved() -> None:
    fake = Fake(never, refuses=lambda dt: "too far" if dt > 0.06 else "")
    outcome = fake.run(control(end=0.2))
    assert outcome.finished
    np.testing.assert_allclose(fake.accepted[0], 0.05)
    assert fake.failures[0] == (0.1, True)
    stuck = Fake(never, refuses=lambda dt: "too far")
    outcome = stuck.run(control(halve=False))
    assert not outcome.finished
    assert "too far" in outcome.reason


def growing(current: float = 0.0, end: float = 1.0) -> StepControl:
    return StepControl(0.1, end, 0.01, True, current, growth=1.2)


def test_steps_that_grow_are_as_long_as_the_limit_allows() -> None:
    fake = Fake(never, limit=lambda time: 0.03 if time < 0.19 else np.inf)
    outcome = fake.run(growing())
    assert outcome.finished
    assert fake.accepted[:7] == [0.03] * 7
    np.testing.assert_allclose(fake.accepted[6:14], np.minimum(0.1, 0.03 * 1.2 ** np.arange(8)))
    assert max(fake.accepted) == 0.1
    assert fake.limited == [(0.03, 0.03)] * 7
    assert sum(fake.accepted) == pytest.approx(1.0, abs=1e-12)


def test_steps_that_grow_are_halved_where_they_fail() -> None:
    fake = Fake(lambda time, dt: 0.15 < time < 0.25 and dt > 0.03)
    assert fake.run(growing()).finished
    assert fake.accepted[:4] == [0.1, 0.1, 0.025, pytest.approx(0.03)]
    ratios = np.array(fake.accepted[1:-1]) / np.array(fake.accepted[:-2])
    assert ratios.max() <= 1.2 * (1.0 + 1e-12)
    assert fake.accepted[-2] == 0.1
    below = Fake(never, limit=lambda time: 0.009)
    assert not below.run(growing()).finished
    assert below.tried == []


def test_going_on_while_steps_grow() -> None:
    """Time and the longest next step are all that the rest depends on."""
    hard = Fake(lambda time, dt: 0.3 < time < 0.4 and dt > 0.03, limit=lambda time: 0.07 * (1.0 + time))
    left = moments(hard, growing())
    assert len(left) > 12
    for time, current, streak in left:
        rest = Fake(hard.fails, limit=hard.limit)
        rest.run(StepControl(0.1, 1.0, 0.01, True, current, streak, growth=1.2), time)
        assert rest.tried == hard.tried[len(hard.tried) - len(rest.tried) :]
        assert time == 1.0 or rest.tried[0][0] == time
