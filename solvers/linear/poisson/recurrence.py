"""Solves that update their residual from iteration to iteration, and replace it by the true one where they stop."""

from __future__ import annotations

import math
from collections.abc import Callable

from femdeform.flow.pressure_system import GridArray, PressureSystem
from solvers.linear.poisson.interface import PoissonResult, set_residual, starting_point

# The residual of the recurrence leaves the true one by rounding; it is replaced as often as this before giving up.
_REPLACEMENTS = 3

Watch = Callable[[int, float], str]
"""Called with iteration and residual norm; a text stops the solver and says why."""


class Progress:
    """How far a solve has come.

    Parameters
    ----------
    system : PressureSystem
    r : (nx + 2, ny + 2, nz + 2) float64
        Residual at the start.
    target : float
        Norm of the residual to reach [m/s].
    most : int
        Iterations.
    watch : Watch or None
        May stop the solve.
    """

    def __init__(
        self, system: PressureSystem, r: GridArray, target: float, most: int, watch: Watch | None = None
    ) -> None:
        self._system, self._most, self._watch = system, most, watch
        self.target = target
        self.norms = [system.norm(r)]
        """Of the residual, at the start and after each iteration [m/s]."""

    @property
    def iterations(self) -> int:
        """Done so far."""
        return len(self.norms) - 1

    @property
    def goes_on(self) -> bool:
        """Whether there is more to do, and an iteration to do it with."""
        return self.norms[-1] > self.target and self.iterations < self._most

    def add(self, r: GridArray) -> str:
        """Count an iteration with its residual; empty, or why the solve has to stop."""
        self.norms.append(self._system.norm(r))
        if not math.isfinite(self.norms[-1]):
            return "the residual is not finite"
        return "" if self._watch is None else self._watch(self.iterations, self.norms[-1])


Iterate = Callable[[GridArray, GridArray, Progress], str]
"""Updates residual and solution in place while the progress goes on; empty, or what stopped it before."""


def solve_by(
    iterate: Iterate,
    system: PressureSystem,
    b: GridArray,
    tolerance: float,
    max_iterations: int,
    x: GridArray | None,
    watch: Watch | None,
    rounding: float = 0.0,
) -> PoissonResult:
    """Iterate, and again from the true residual where that has not met the tolerance.

    Parameters
    ----------
    iterate : Iterate
        The method.
    system : PressureSystem
        A.
    b : (nx + 2, ny + 2, nz + 2) float64
        Right-hand side.
    tolerance : float
        Of the residual, over the norm of `b` [-].
    max_iterations : int
        All together.
    x : (nx + 2, ny + 2, nz + 2) float64 or None
        Where to start, if not at zero.
    watch : Watch or None
        May stop the solve.
    rounding : float
        A true residual below this part of the norm of the solution ends the solve: it is what rounding leaves of A x,
        and a recurrence that needs its directions to stay conjugate goes on with numbers that mean nothing [-].
    """
    at, r = starting_point(system, b, x)
    progress = Progress(system, r, tolerance * system.norm(b), max_iterations, watch)
    norms, target = progress.norms, progress.target
    replacements, reason = 0, ""
    while not reason and progress.goes_on:
        reason = iterate(r, at, progress)
        set_residual(system, b, at, r)
        norms[-1] = system.norm(r)
        replacements += 1
        is_rounding = target < norms[-1] <= rounding * system.norm(at)
        if is_rounding or (not reason and replacements > _REPLACEMENTS):
            reason = "the residual has reached rounding"
    converged = norms[-1] <= target
    if converged:
        reason = "residual below tolerance"
    elif not math.isfinite(norms[-1]):
        reason = "the residual is not finite"
    system.project(at)
    return PoissonResult(at, progress.iterations, converged, reason or f"{progress.iterations} iterations", norms)
