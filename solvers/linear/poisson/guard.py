"""Watching a solver that may fail, and another one that goes on where it stopped."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from femdeform.flow.pressure_system import GridArray, PressureSystem
from solvers.linear.poisson.interface import PoissonResult, PoissonSolver, starting_point
from solvers.linear.poisson.recurrence import Watch

# Iterations are counted for this reduction of the residual; smaller tolerances get more in proportion to digits.
_REFERENCE_TOLERANCE = 1e-4
# The residual that a solver tells and the one that the guard computes differ by rounding.
_ROUNDING = 1e-6
# A learned solver has to be faster by a tenth, or it is not worth its doubts.
_MARGIN = 0.9
# Solves between two comparisons of times.
_EVERY = 50


@dataclass(frozen=True)
class Limits:
    """When a solver is stopped.

    Attributes
    ----------
    factor : float
        Largest mean factor of the residual over the last iterations [-].
    iterations : int
        Most iterations to a ten-thousandth.
    window : int
        Over how many iterations the mean is taken.
    """

    factor: float
    iterations: int
    window: int = 3


LMG_LIMITS = Limits(0.5, 12)
# Line searches lower the energy of the error. Its residual often stays where it is for the first few of them, under air
# above all, in solves that take a dozen iterations: over three the rule stopped half of those on 64^2 voxels, over ten
# none.
DCDM_LIMITS = Limits(0.8, 30, 10)
MULTIGRID_LIMITS = Limits(math.inf, 60)


class Watchdog:
    """Stops a solver that is slow; see `Watch`.

    Parameters
    ----------
    limits : Limits
    start, target : float
        Norms of the residual: at the start, and where it is to go.
    tolerance : float
        Of the solve.
    """

    def __init__(self, limits: Limits, start: float, target: float, tolerance: float) -> None:
        self._factor, self._window = limits.factor, limits.window
        digits = max(1.0, math.log(tolerance) / math.log(_REFERENCE_TOLERANCE))
        self._most = round(limits.iterations * digits)
        self._target = target
        self._norms = [start]

    def __call__(self, iteration: int, norm: float) -> str:
        """Empty, or what is wrong."""
        self._norms = [*self._norms[-self._window :], norm]
        if norm <= self._target:
            return ""
        if iteration >= self._most:
            return f"no answer after {iteration} iterations"
        if len(self._norms) > self._window:
            mean = (norm / self._norms[0]) ** (1.0 / self._window)
            if mean > self._factor:
                return f"the residual falls by {mean:.2f} an iteration"
        return ""


class WatchedSolver(PoissonSolver, Protocol):
    """A solver that can be stopped."""

    system: PressureSystem

    def solve(
        self,
        b: GridArray,
        tolerance: float,
        max_iterations: int,
        x: GridArray | None = None,
        watch: Watch | None = None,
    ) -> PoissonResult:
        """As `PoissonSolver.solve`; `watch` may stop it."""


class Guarded:
    """A solver, and another one that goes on from where the first one had to stop.

    The first one may be anything that iterates on fields of a grid, learned or not. What it says of its answer is not
    believed: the guard computes the residual itself, with one product.

    Parameters
    ----------
    solver : WatchedSolver
    limits : Limits
        Of `solver`.
    make_next : callable
        Makes what goes on; called once, when it is needed.
    events : list of str
        Gets a line each time.

    References
    ----------
    None: rules of thumb, measured by `femdeform bench dcdm`.

    Limitations
    -----------
    What the first solver did until it was stopped is lost time. Its limits are fixed numbers, whatever the domain.
    """

    def __init__(
        self, solver: WatchedSolver, limits: Limits, make_next: Callable[[], PoissonSolver], events: list[str]
    ) -> None:
        self._solver, self._limits, self._make_next, self._events = solver, limits, make_next, events
        self._next: PoissonSolver | None = None

    @property
    def name(self) -> str:
        """Of the first solver."""
        return self._solver.name

    def destroy(self) -> None:
        """Free what either holds."""
        self._solver.destroy()
        if self._next is not None:
            self._next.destroy()
            self._next = None

    def solve(self, b: GridArray, tolerance: float, max_iterations: int, x: GridArray | None = None) -> PoissonResult:
        """Solve A x = b; see `PoissonSolver`."""
        norm = float(np.linalg.norm(b))
        watchdog = Watchdog(self._limits, norm, tolerance * norm, tolerance)
        first = self._solver.solve(b, tolerance, max_iterations, x, watchdog)
        reached = self._solver.system.norm(starting_point(self._solver.system, b, first.x)[1])
        is_answer = first.converged and reached <= (1.0 + _ROUNDING) * tolerance * norm
        left = max_iterations - first.iterations
        if is_answer or (left <= 0 and not first.converged):
            return first
        if self._next is None:
            self._next = self._make_next()
        reason = f"its residual is {reached / norm:.2g}" if first.converged else first.reason
        self._events.append(f"{self.name} stopped ({reason}); {self._next.name} went on")
        # What has become worse than the start, or is no number, is no start.
        is_better = reached <= first.residuals[0]
        second = self._next.solve(b, tolerance, left, first.x if is_better else x)
        return PoissonResult(
            second.x,
            first.iterations + second.iterations,
            second.converged,
            f"{self._events[-1]}: {second.reason}",
            first.residuals[:-1] + second.residuals if is_better else first.residuals + second.residuals[1:],
        )


@dataclass
class SpeedRule:
    """Which of two solvers is used: the learned one only where it has been the faster one.

    Every 50 solves both solve the same system, set-up included, and the rule remembers who won.

    Attributes
    ----------
    events : list of str
        Gets a line when the choice changes.

    References
    ----------
    None: a stopwatch.

    Limitations
    -----------
    Times depend on what else the machine does, so the choice, and with it the last digits of a run, cannot be repeated;
    a resumed run chooses anew.
    """

    events: list[str] = field(default_factory=list)
    solves: int = 0
    is_learned: bool = True

    def is_due(self) -> bool:
        """Whether this solve compares; counts it."""
        self.solves += 1
        return self.solves % _EVERY == 1

    def take(self, learned: float, classical: float, has_converged: bool) -> None:
        """Remember times [s]."""
        was = self.is_learned
        self.is_learned = has_converged and learned <= _MARGIN * classical
        if self.is_learned != was:
            chosen = "the learned solver" if self.is_learned else "multigrid"
            self.events.append(f"learned {learned:.3g} s, multigrid {classical:.3g} s: {chosen} from here")


class FasterOf:
    """The learned solver or multigrid, as a `SpeedRule` has it; see `PoissonSolver`.

    Parameters
    ----------
    make_learned, make_classical : callable
        Make the solvers; called when they are needed, and for each comparison, which counts their set-up.
    rule : SpeedRule
        Lives longer than one system.

    References
    ----------
    None: see `SpeedRule`.

    Limitations
    -----------
    A comparison costs a solve and the set-up of both; the first one costs two of each. As those of `SpeedRule`.
    """

    def __init__(
        self, make_learned: Callable[[], PoissonSolver], make_classical: Callable[[], PoissonSolver], rule: SpeedRule
    ) -> None:
        self._makers = {True: make_learned, False: make_classical}
        self._rule = rule
        self._made: dict[bool, PoissonSolver] = {}

    @property
    def name(self) -> str:
        """Of the solver in use."""
        return self._solver(self._rule.is_learned).name

    def destroy(self) -> None:
        """Free what either holds."""
        for solver in self._made.values():
            solver.destroy()
        self._made.clear()

    def _solver(self, learned: bool) -> PoissonSolver:
        if learned not in self._made:
            self._made[learned] = self._makers[learned]()
        return self._made[learned]

    def solve(self, b: GridArray, tolerance: float, max_iterations: int, x: GridArray | None = None) -> PoissonResult:
        """Solve A x = b; see `PoissonSolver`."""
        if not self._rule.is_due():
            return self._solver(self._rule.is_learned).solve(b, tolerance, max_iterations, x)
        answers, seconds = {}, {}
        is_first = self._rule.solves == 1
        for learned in (True, False):
            if is_first:
                # Kernels compile when they are first used; that is no part of the comparison.
                self._solver(learned).solve(b, tolerance, max_iterations, x)
            self.destroy()
            start = time.perf_counter()
            answers[learned] = self._solver(learned).solve(b, tolerance, max_iterations, x)
            seconds[learned] = time.perf_counter() - start
            if learned:
                kept = self._made.pop(True)
        self._made[True] = kept
        self._rule.take(seconds[True], seconds[False], answers[True].converged)
        return answers[self._rule.is_learned]


@dataclass
class SlowNotice:
    """Measures once whether multigrid is the faster one, and says so; who answers does not change.

    Attributes
    ----------
    notices : list of str
        Gets a line if the learned solver took longer.
    solves : int
        Solves so far; the second one is measured, as the first one compiles kernels.
    """

    notices: list[str] = field(default_factory=list)
    solves: int = 0

    def is_due(self) -> bool:
        """Whether this solve is measured; counts it."""
        self.solves += 1
        return self.solves == 2

    def take(self, name: str, learned: float, classical: float) -> None:
        """Say what the times [s] of a solve mean."""
        if learned > classical:
            self.notices.append(
                f"{name} took {learned:.2g} s for a pressure, multigrid {classical:.2g} s (measured once): method "
                "mg_pcg is the faster one here, and compare_times: true would put the slower one aside"
            )


class Noticed:
    """A learned solver beside which multigrid is measured once, without set-up; see `SlowNotice` and `PoissonSolver`.

    Parameters
    ----------
    solver : PoissonSolver
    make_classical : callable
        Makes multigrid for the same system, when it is measured.
    rule : SlowNotice
        Lives longer than one system.

    References
    ----------
    None: a stopwatch.

    Limitations
    -----------
    One solve says little about the next ones, and less on a machine that does other things.
    """

    def __init__(self, solver: PoissonSolver, make_classical: Callable[[], PoissonSolver], rule: SlowNotice) -> None:
        self._solver, self._make_classical, self._rule = solver, make_classical, rule

    @property
    def name(self) -> str:
        """Of the learned solver."""
        return self._solver.name

    def destroy(self) -> None:
        """Free what the learned solver holds."""
        self._solver.destroy()

    def solve(self, b: GridArray, tolerance: float, max_iterations: int, x: GridArray | None = None) -> PoissonResult:
        """Solve A x = b; see `PoissonSolver`."""
        start = time.perf_counter()
        answer = self._solver.solve(b, tolerance, max_iterations, x)
        learned = time.perf_counter() - start
        if self._rule.is_due():
            classical = self._make_classical()
            classical.solve(b, tolerance, max_iterations, x)  # compiles kernels
            start = time.perf_counter()
            is_answer = classical.solve(b, tolerance, max_iterations, x).converged
            seconds = time.perf_counter() - start
            classical.destroy()
            self._rule.take(self.name, learned, seconds if is_answer else math.inf)
        return answer
