"""One step by sweeps over cells: sweeps, looks at the residual, and when to stop."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.errors import InputError
from femdeform.step_problem import Budget, IterationObserver, LocalStepProblem, StepResult
from solvers.descent import ratio
from solvers.position_based.cell_sweep import CellSweep

# A step has diverged if its residual is this many times what it was first (or the forces), and still grows, or if
# positions are this many times the size of the bodies away from where they began.
_GROWTH = 1e3
_FAR = 1e3
# So has one that was to converge if its residual, above what it was first (or the forces), is this many times the least
# that it has been, and still grows.
_RISE = 10.0


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
    converges : bool
        Whether more sweeps are to leave a smaller residual: one that falls and rises again is then a failure.
    """

    sweeps: int
    tolerance: float | None
    check_every: int
    is_fixed_work: bool
    converges: bool = False


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
        self.norm = self.growth = self.last = self.first = self.least = math.inf
        self.size = float(np.ptp(problem.points, axis=0).max())
        self.x = problem.predictor(state)

    def dynamics(self, stopping: Stopping, reverse: bool = False) -> StepResult:
        """A step of backward Euler.

        Raises
        ------
        InputError
            If the problem has no inertia.
        """
        dt = math.sqrt(time_step_squared(self.problem))
        self._begin()
        self.sweep.begin(self.problem, self.x, dt)
        return self._run(True, stopping, reverse)

    def pushed(self, dt: float, stopping: Stopping, reverse: bool = False) -> StepResult:
        """A static step of PBD: sweeps from where loads push masses at rest in a time dt [s]."""
        self._begin()
        self._push(dt)
        return self._run(False, stopping, reverse)

    def _run(self, follows: bool, stopping: Stopping, reverse: bool) -> StepResult:
        """Sweeps and looks to the end of the step; `follows`: x~ takes over forces that follow the positions."""
        if follows:
            self._follow()
        self._look()
        self.first = max(self.growth, self.problem.force_scale)
        while True:
            done = self._verdict(stopping)
            if done is not None:
                return done
            spent = self.budget.spent(self.iteration)
            if spent is not None:
                return self.result(False, spent)
            end = min(self.iteration + stopping.check_every, stopping.sweeps)
            self._sweeps(end, reverse)
            if follows:
                self._follow()
            self._look()
            self._report()

    def _verdict(self, stopping: Stopping) -> StepResult | None:
        trouble = self.trouble() or (self._rise() if stopping.converges else "")
        if trouble:
            return self.result(False, self._advised(trouble))
        scale = self.problem.force_scale
        below = stopping.tolerance is not None and self.norm <= stopping.tolerance * scale
        if self.iteration < stopping.sweeps:
            early = below and (not stopping.is_fixed_work or self.iteration > 0)
            return self.result(True, "residual below tolerance") if early else None
        if stopping.is_fixed_work:
            return self.result(below, f"{self.iteration} sweeps, as asked for", True)
        return self.result(below, self._advised(f"no convergence in {self.iteration} sweeps"))

    def _advised(self, reason: str) -> str:
        advice = self.sweep.advice()
        return f"{reason}; {advice}" if advice else reason

    # --------------------------------------------------------------------------------------------- parts

    def _begin(self) -> None:
        problem = self.problem
        problem.place_obstacles(1.0)
        problem.linearize_at(self.state.x)
        problem.settle_force_scale(self.x)

    def _push(self, dt: float) -> None:
        """Begin sweeps with x~ where loads push the masses, at rest, in a time dt [s]."""
        problem = self.problem
        push = dt * dt * problem.nodal_terms().loads / problem.lumped_mass[:, None]
        self.sweep.begin(problem, np.where(problem.free, self.x + push, self.x), dt)
        self._follow()

    def _sweeps(self, end: int, reverse: bool) -> None:
        if self.budget.iterations is not None:
            end = min(end, self.budget.iterations)
        while self.iteration < end:
            self.sweep.sweep(reverse)
            self.iteration += 1
            if self.budget.seconds is not None and self.budget.spent(self.iteration) is not None:
                break

    def _follow(self) -> None:
        self.sweep.read(self.x)
        forces = self.problem.follower_forces(self.x)
        if forces is not None:
            self.sweep.follow(forces)

    def _look(self) -> None:
        """Residual where the sweeps are [N]."""
        self.sweep.read(self.x)
        self._judge()

    def _judge(self) -> None:
        """Residual at x [N], and what tells whether it grows."""
        gradient = self.problem.gradient(self.x)
        self.last = self.growth
        self.norm = self.growth = self.problem.residual_norm(gradient)
        if self.problem.links is not None:
            # Stiff links that are not yet met have any force; that is no divergence.
            links = np.zeros_like(gradient)
            self.problem.links.add_gradient(self.x, links)
            self.growth = self.problem.residual_norm(gradient - np.where(self.problem.free, links, 0.0))

    def trouble(self) -> str:
        """How the step has diverged, or empty."""
        if not math.isfinite(self.norm):
            return "the residual is not finite"
        if np.abs(self.x - self.state.x).max(initial=0.0) > _FAR * self.size:
            return f"diverged: nodes have left by more than {_FAR:g} times the size of the bodies"
        if self.growth > _GROWTH * self.first and self.growth > self.last:
            return f"diverged: the residual has grown to {self.growth / self.first:.3g} times the forces it began with"
        return ""

    def _rise(self) -> str:
        """How the residual has fallen and risen again, or empty; where sweeps begin it may be anything."""
        if self.iteration > 0:
            self.least = min(self.least, self.growth)
        if self.growth > max(self.first, self.last, _RISE * self.least):
            times = ratio(self.growth, self.least)
            return f"diverged: the residual has risen again to {times:.3g} times the least it was"
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
        if self.sweep.has_residual_parts:
            with self.budget.paused():
                primary, secondary = self.sweep.residual_parts(self.problem)
            row["primary_residual"] = self.problem.residual_norm(primary)
            row["secondary_residual"] = self.problem.residual_norm(secondary)
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
        self._judge()
        self.first = max(self.growth, problem.force_scale)
        for _ in range(steps):
            spent = self.budget.spent(self.iteration)
            if spent is not None:
                return self.result(False, spent)
            before = self.x.copy()
            self._push(dt)
            self._sweeps(self.iteration + sweeps, reverse)
            self._look()
            self._report()
            trouble = self.trouble()
            if trouble:
                return self.result(False, trouble)
            if self.norm <= tolerance * problem.force_scale:
                return self.result(True, "residual below tolerance")
            if np.abs(self.x - before).max(initial=0.0) <= at_rest * self.size:
                return self.result(False, "at rest in pseudo-time, as asked for", True)
        return self.result(False, f"not at rest after {steps} pseudo-time steps", True)


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
