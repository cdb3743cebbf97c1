"""Stepping through time with a failure policy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from femdeform.fem.incremental_potential import IncrementalPotential, State
from femdeform.step_problem import IterationObserver, StepResult, StepSolver

# A remainder of the last step smaller than this part of dt is rounding, not a step.
_REMAINDER = 1e-9


@dataclass
class StepControl:
    """The step size and what happens when a step fails.

    Attributes
    ----------
    dt : float
        Step asked for [s].
    end : float
        End time [s].
    min_dt : float
        Smallest step before the run stops [s].
    halve : bool
        Halve the step on failure; otherwise stop.
    current : float
        Step in use [s]: `dt`, or less after a failure. It doubles after each accepted step until it is `dt` again.
    """

    dt: float
    end: float
    min_dt: float
    halve: bool
    current: float = 0.0

    def __post_init__(self) -> None:
        if self.current <= 0.0:
            self.current = self.dt

    def is_done(self, time: float) -> bool:
        """Whether the end is reached, up to rounding."""
        return self.end - time <= _REMAINDER * self.dt

    def next_step(self, time: float) -> float:
        """Step to take at a time: the current one, or what is left."""
        left = self.end - time
        return left if left <= self.current * (1.0 + _REMAINDER) else self.current

    def accepted(self) -> None:
        """Return towards the step asked for."""
        self.current = min(self.dt, 2.0 * self.current)

    def failed(self, dt: float) -> bool:
        """Halve the step that failed; False if the run has to stop instead."""
        # The last step may be shorter than the current one: half of what was tried is what makes a difference.
        if not self.halve or 0.5 * dt < self.min_dt:
            return False
        self.current = 0.5 * dt
        return True


@dataclass(frozen=True)
class LoopOutcome:
    """How a loop ended.

    Attributes
    ----------
    state : State
        Last accepted state.
    finished : bool
        Whether the end time was reached.
    reason : str
        Why not, in words; empty if finished.
    """

    state: State
    finished: bool
    reason: str


def run_time_loop(
    problem: IncrementalPotential,
    solver: StepSolver,
    control: StepControl,
    state: State,
    *,
    on_accept: Callable[[State, StepResult, float], None],
    on_failure: Callable[[State, StepResult, float, bool], None],
    observe: Callable[[int], IterationObserver | None],
) -> LoopOutcome:
    """Step from a state to the end of the control's time.

    Parameters
    ----------
    problem : IncrementalPotential
        What to solve.
    solver : StepSolver
        How to solve a step.
    control : StepControl
        Changed on the way.
    state : State
        Where to start.
    on_accept : callable
        Called with the new state, the solver's result and the step size after every accepted step.
    on_failure : callable
        Called with the last accepted state, the result, the step size and whether the step will be retried.
    observe : callable
        Gives the observer of the iterations of a step number.

    Returns
    -------
    LoopOutcome
    """
    while not control.is_done(state.time):
        dt = control.next_step(state.time)
        problem.begin_step(state, dt)
        result = solver.step(problem, state, observe(state.step + 1))
        if result.accepted:
            state = problem.accept(state, result.x)
            control.accepted()
            on_accept(state, result, dt)
            continue
        retry = control.failed(dt)
        on_failure(state, result, dt, retry)
        if not retry:
            return LoopOutcome(state, False, _failure_text(state, dt, result, control))
    return LoopOutcome(state, True, "")


def _failure_text(state: State, dt: float, result: StepResult, control: StepControl) -> str:
    text = (
        f"step {state.step + 1} to t = {state.time + dt:.6g} s failed with dt = {dt:.3g} s: {result.reason} "
        f"(relative residual {result.relative_residual:.2e})"
    )
    if control.halve:
        text += f"; dt cannot be halved below min_dt = {control.min_dt:.3g} s"
    return text


def default_min_dt(dt: float, min_dt: float | None) -> float:
    """Smallest step of a scene that gives none: six halvings."""
    return dt / 64.0 if min_dt is None else min_dt


