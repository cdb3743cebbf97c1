"""Stepping through time with a failure policy."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, Protocol, TypeVar

from femdeform.fem.incremental_potential import IncrementalPotential, State
from femdeform.mpm.embedded_potential import EmbeddedPotential
from femdeform.step_problem import IterationObserver, StepResult, StepSolver

# A remainder of the last step smaller than this part of dt is rounding, not a step.
_REMAINDER = 1e-9
# Accepted steps of one size before the next larger one is tried. A step that was too hard is seldom followed by one
# that is easy, and a failed attempt costs as much as many accepted steps.
_PATIENCE = 3


# What a deformable run steps: bodies by the nodes of their meshes, or by those of a grid.
Problem = IncrementalPotential | EmbeddedPotential


class Moment(Protocol):
    """A state of any simulation, as far as a time loop looks into it."""

    @property
    def time(self) -> float:
        """Time [s]."""

    @property
    def step(self) -> int:
        """Accepted steps that led to it."""


class StepReport(Protocol):
    """What became of an attempt at a step, as far as a time loop and its messages look into it."""

    @property
    def accepted(self) -> bool:
        """Whether the loop goes on from the new state."""

    @property
    def reason(self) -> str:
        """Why the attempt ended, in words."""

    @property
    def iterations(self) -> int:
        """Iterations it took, of the kind that the simulation counts."""

    @property
    def relative_residual(self) -> float:
        """What is left of the equations over what there was [-]."""


M = TypeVar("M", bound=Moment)
R = TypeVar("R", bound=StepReport)
R_co = TypeVar("R_co", bound=StepReport, covariant=True)


class Stepper(Protocol[M, R_co]):
    """What a time loop steps."""

    limited_by: str  # what keeps steps below `step_limit`, in words
    growth: float | None  # see `StepControl`

    def step_limit(self, state: M) -> float:
        """Longest step that may be taken from a state [s]."""

    def attempt(self, state: M, dt: float, observe: IterationObserver | None) -> tuple[M, R_co]:
        """Try a step; the state it leads to, which counts only if the report says so. The one given stays as it is."""


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
        Longest step that may be taken next [s]: `dt`, or less after a failure or, with a `growth`, after a limit.
    streak : int
        Accepted steps of the size in use, while that is less than `dt`; 0 with a `growth`.
    growth : float or None
        Steps are as long as a limit allows, and at most this many times as long as the one before [-]. With None
        they are `dt` halved until a limit allows them; after a failure they double every few accepted steps.
    """

    dt: float
    end: float
    min_dt: float
    halve: bool
    current: float = 0.0
    streak: int = 0
    growth: float | None = None

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

    def bounded_step(self, time: float, limit: float) -> float | None:
        """The step to take where none longer than a limit may be; None if that is below `min_dt`."""
        dt = self.next_step(time)
        while dt > limit:
            dt = limit if self.growth is not None else 0.5 * dt
            if dt < self.min_dt:
                return None
        return dt

    def accepted(self, dt: float) -> None:
        """Return towards the step asked for, once a few steps of the present size, or one, were accepted."""
        if self.growth is not None:
            self.current = min(self.dt, self.growth * dt)
            return
        if self.current >= self.dt:
            return
        self.streak += 1
        if self.streak >= _PATIENCE:
            self.current, self.streak = min(self.dt, 2.0 * self.current), 0

    def failed(self, dt: float) -> bool:
        """Halve the step that failed; False if the run has to stop instead."""
        # The last step may be shorter than the current one: half of what was tried is what makes a difference.
        if not self.halve or 0.5 * dt < self.min_dt:
            return False
        self.current, self.streak = 0.5 * dt, 0
        return True


@dataclass(frozen=True)
class LoopOutcome(Generic[M]):
    """How a loop ended.

    Attributes
    ----------
    state : Moment
        Last accepted state.
    finished : bool
        Whether the end time was reached.
    reason : str
        Why not, in words; empty if finished.
    """

    state: M
    finished: bool
    reason: str


def run_time_loop(
    stepper: Stepper[M, R],
    control: StepControl,
    state: M,
    *,
    on_accept: Callable[[M, R, float], None],
    on_failure: Callable[[M, R, float, bool], None],
    observe: Callable[[int], IterationObserver | None],
    on_limit: Callable[[M, float, float], None] | None = None,
) -> LoopOutcome[M]:
    """Step from a state to the end of the control's time.

    Parameters
    ----------
    stepper : Stepper
        Takes a step.
    control : StepControl
        Changed on the way.
    state : Moment
        Where to start.
    on_accept : callable
        Called with the new state, the report of the step and its size after every accepted step.
    on_failure : callable
        Called with the last accepted state, the report, the step size and whether the step will be retried.
    observe : callable
        Gives the observer of the iterations of a step number.
    on_limit : callable, optional
        Called with the last accepted state, the step size and the limit before a step that the stepper makes shorter.

    Returns
    -------
    LoopOutcome
    """
    while not control.is_done(state.time):
        limit = stepper.step_limit(state)
        dt = control.bounded_step(state.time, limit)
        if dt is None:
            return LoopOutcome(state, False, _limit_text(state, limit, control, stepper.limited_by))
        if on_limit is not None and dt < control.next_step(state.time):
            on_limit(state, dt, limit)
        new, report = stepper.attempt(state, dt, observe(state.step + 1))
        if report.accepted:
            state = new
            control.accepted(dt)
            on_accept(state, report, dt)
            continue
        retry = control.failed(dt)
        on_failure(state, report, dt, retry)
        if not retry:
            return LoopOutcome(state, False, _failure_text(state, dt, report, control))
    return LoopOutcome(state, True, "")


class SolverStepper:
    """Steps a problem of deformable bodies with a solver.

    Parameters
    ----------
    problem : IncrementalPotential or EmbeddedPotential
        What to solve.
    solver : StepSolver
        How to solve a step.
    """

    limited_by = "grid.cfl: bodies move too fast for the cells"
    growth: float | None = None

    def __init__(self, problem: Problem, solver: StepSolver) -> None:
        self._problem = problem
        self._solver = solver

    def step_limit(self, state: State) -> float:
        """Longest step that may be taken from a state [s]."""
        return self._problem.step_limit(state)

    def attempt(self, state: State, dt: float, observe: IterationObserver | None) -> tuple[State, StepResult]:
        """Try a step; see `Stepper`."""
        result = take_step(self._problem, self._solver, state, dt, observe)
        return (self._problem.accept(state, result.x) if result.accepted else state), result


def take_step(
    problem: Problem, solver: StepSolver, state: State, dt: float, observe: IterationObserver | None = None
) -> StepResult:
    """Begin a step and solve it; one that the problem refuses in the end has not converged.

    The positions of the result are the problem's unknowns.
    """
    problem.begin_step(state, dt)
    result = solver.step(problem, problem.solver_state(state), observe)
    refusal = problem.refusal(result.x) if result.accepted else ""
    return replace(result, converged=False, is_fixed_work=False, reason=refusal) if refusal else result


def _limit_text(state: Moment, limit: float, control: StepControl, why: str) -> str:
    return (
        f"step {state.step + 1} from t = {state.time:.6g} s may not be longer than {limit:.3g} s ({why}); dt does not "
        f"go below min_dt = {control.min_dt:.3g} s"
    )


def _failure_text(state: Moment, dt: float, report: StepReport, control: StepControl) -> str:
    text = (
        f"step {state.step + 1} to t = {state.time + dt:.6g} s failed with dt = {dt:.3g} s: {report.reason} "
        f"(relative residual {report.relative_residual:.2e})"
    )
    if control.halve:
        text += f"; dt cannot be halved below min_dt = {control.min_dt:.3g} s"
    return text


def default_min_dt(dt: float, min_dt: float | None) -> float:
    """Smallest step of a scene that gives none: six halvings."""
    return dt / 64.0 if min_dt is None else min_dt
