"""One step by sweeps over cells: sweeps, looks at the residual, and when to stop."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.errors import InputError
from femdeform.step_problem import Budget, IterationObserver, LocalStepProblem, StepResult
from femdeform.types import FloatArray
from solvers.descent import ratio
from solvers.position_based.cell_sweep import CellSweep

# A step has diverged if its residual is this many times what it was first (or the forces), and still grows, or if
# positions are this many times the size of the bodies away from where they began.
_GROWTH = 1e3
_FAR = 1e3


@dataclass(frozen=True)
class Stopping:
    """When to stop.

    Attributes
    ----------
    sweeps : int
        Most sweeps.
    tolerance : float, optional
        Residual over the forces that ends the step.
    check_every : int
        Sweeps between two looks.
    is_fixed_work : bool
        Whether the step is taken as it is after so many sweeps.
    """

    sweeps: int
    tolerance: float | None
    check_every: int
    is_fixed_work: bool


class ConstraintStep:
    """The residual of a step, and what is said of it; sweeps in between.

    Parameters
    ----------
    sweep : CellSweep
    problem : LocalStepProblem
        With the step begun.
    state : State
        Last accepted state.
    observe : callable, optional
    budget : Budget
    """

    def __init__(
        self,
        sweep: CellSweep,
        problem: LocalStepProblem,
        state: Any,
        observe: IterationObserver | None,
        budget: Budget,
    ) -> None:
        self.sweep, self.problem, self.state = sweep, problem, state
        self.observe, self.budget = observe, budget
        self.iteration = 0
        self.norm = self.last = self.first = math.inf
        self.size = float(np.ptp(problem.points, axis=0).max())
        self.x = problem.predictor(state)
        self._follower: FloatArray | None = None

    def dynamics(self, stopping: Stopping, reverse: bool = False) -> StepResult:
        """A step of backward Euler.

        Raises
        ------
        InputError
            If the problem has no inertia.
        """
        problem = self.problem
        dt = math.sqrt(time_step_squared(problem))
        self._begin()
        self.sweep.begin(problem, self.x, dt)
        self._follow(dt)
        self._look()
        self.first = max(self.norm, problem.force_scale)
        while True:
            done = self._verdict(stopping)
            if done is not None:
                return done
            spent = self.budget.spent(self.iteration)
            if spent is not None:
                return self.result(False, spent)
            end = min(self.iteration + stopping.check_every, stopping.sweeps)
            self._sweeps(end, reverse)
            self._follow(dt)
            self._look()
            self._report()

    def _verdict(self, stopping: Stopping) -> StepResult | None:
        trouble = self.trouble()
        if trouble:
            return self.result(False, trouble)
        scale = self.problem.force_scale
        below = stopping.tolerance is not None and self.norm <= stopping.tolerance * scale
        if self.iteration < stopping.sweeps:
            early = below and (not stopping.is_fixed_work or self.iteration > 0)
            return self.result(True, "residual below tolerance") if early else None
        if stopping.is_fixed_work:
            return self.result(below, f"{self.iteration} sweeps, as asked for", True)
        return self.result(below, f"no convergence in {self.iteration} sweeps")

    # --------------------------------------------------------------------------------------------- parts

    def _begin(self) -> None:
        problem = self.problem
        problem.place_obstacles(1.0)
        problem.linearize_at(self.state.x)
        problem.settle_force_scale(self.x)

    def _sweeps(self, end: int, reverse: bool) -> None:
        if self.budget.iterations is not None:
            end = min(end, self.budget.iterations)
        while self.iteration < end:
            self.sweep.sweep(reverse)
            self.iteration += 1
            if self.budget.seconds is not None and self.budget.spent(self.iteration) is not None:
                break

    def _follow(self, dt: float) -> None:
        """Take over forces that follow the positions into x~."""
        self.sweep.read(self.x)
        follower = self.problem.follower_forces(self.x)
        if follower is not None:
            change = follower if self._follower is None else follower - self._follower
            self._follower = follower
            self.sweep.shift_target(dt * dt * change / self.problem.lumped_mass[:, None])

    def _look(self) -> None:
        """Residual at the present positions [N]."""
        self.sweep.read(self.x)
        self.last = self.norm
        self.norm = self.problem.residual_norm(self.problem.gradient(self.x))

    def trouble(self) -> str:
        """How the step has diverged, or empty."""
        if not math.isfinite(self.norm):
            return "the residual is not finite"
        if np.abs(self.x - self.state.x).max(initial=0.0) > _FAR * self.size:
            return f"diverged: nodes have left by more than {_FAR:g} times the size of the bodies"
        if self.norm > _GROWTH * self.first and self.norm > self.last:
            return f"diverged: the residual has grown to {self.norm / self.first:.3g} times the forces it began with"
        return ""

    def _report(self) -> None:
        if self.observe is None:
            return
        with self.budget.paused():  # the method itself never asks for it
            objective = self.problem.value(self.x)
        row: dict[str, float | int | str] = {
            "iteration": self.iteration,
            "residual_norm": self.norm,
            "relative_residual": ratio(self.norm, self.problem.force_scale),
            "objective": objective,
            "linear_iterations": 0,
            "seconds": self.budget.elapsed(),
        }
        self.observe(row, self.x)

    def result(self, converged: bool, reason: str, is_fixed_work: bool = False) -> StepResult:
        """What came of the step."""
        relative = ratio(self.norm, self.problem.force_scale)
        return StepResult(self.x, converged, reason, self.iteration, 0, self.norm, relative, is_fixed_work)


class PseudoTimeStep(ConstraintStep):
    """A static step by pseudo-time steps ``x~ = x + h^2 M^-1 f`` from rest, each with new multipliers."""

    def statics(
        self, dt: float, sweeps: int, steps: int, at_rest: float, tolerance: float, reverse: bool
    ) -> StepResult:
        """Step until nothing moves.

        Parameters
        ----------
        dt : float
            Pseudo-time step [s].
        sweeps, steps : int
            Sweeps a pseudo-time step, and most pseudo-time steps.
        at_rest : float
            Largest motion over the size of the bodies that counts as none.
        tolerance : float
            Residual over the forces that counts as converged.
        reverse : bool
            See `CellSweep.sweep`.

        Raises
        ------
        InputError
            If the problem has inertia.
        """
        problem = self.problem
        terms = problem.nodal_terms()
        if np.any(terms.weights > 0.0):
            raise InputError("solver.method: xpbd_qs is for statics (time.scheme: quasistatic)")
        self._begin()
        self._look_at(self.x)
        self.first = max(self.norm, problem.force_scale)
        for _ in range(steps):
            spent = self.budget.spent(self.iteration)
            if spent is not None:
                return self.result(False, spent)
            before = self.x.copy()
            follower = problem.follower_forces(before)
            forces = terms.loads if follower is None else terms.loads + follower
            target = np.where(problem.free, before + dt * dt * forces / problem.lumped_mass[:, None], before)
            self.sweep.begin(problem, target, dt)
            self._sweeps(self.iteration + sweeps, reverse)
            self.sweep.read(self.x)
            self._look_at(self.x)
            self._report()
            trouble = self.trouble()
            if trouble:
                return self.result(False, trouble)
            if self.norm <= tolerance * problem.force_scale:
                return self.result(True, "residual below tolerance")
            if np.abs(self.x - before).max(initial=0.0) <= at_rest * self.size:
                return self.result(False, "at rest in pseudo-time, as asked for", True)
        return self.result(False, f"not at rest after {steps} pseudo-time steps", True)

    def _look_at(self, x: FloatArray) -> None:
        self.last = self.norm
        self.norm = self.problem.residual_norm(self.problem.gradient(x))


def time_step_squared(problem: LocalStepProblem) -> float:
    """h^2 of a step with inertia [s^2].

    Raises
    ------
    InputError
        If the problem is static.
    """
    weights = problem.nodal_terms().weights
    heavy = weights > 0.0
    if not heavy.any():
        raise InputError("solver.method: this method needs inertia (time.scheme: backward_euler); for statics xpbd_qs")
    return float(np.median(problem.lumped_mass[heavy] / weights[heavy]))
