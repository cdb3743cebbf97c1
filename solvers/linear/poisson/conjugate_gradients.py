"""Conjugate gradients for the pressure, with any preconditioner."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from femdeform.flow import grid_kernels
from femdeform.flow.pressure_system import GridArray, PressureSystem
from solvers.linear.poisson.interface import PoissonResult, Preconditioner, starting_point

# The residual of the recurrence leaves the true one by rounding; it is replaced as often as this before giving up.
_REPLACEMENTS = 3
# Rows of A have numbers of sum 12.
_ROUNDING = 12.0 * float(np.finfo(float).eps)

Watch = Callable[[int, float], str]
"""Called with iteration and residual norm; a text stops the solver and says why."""


class ConjugateGradients:
    """Preconditioned conjugate gradients on the fields of a grid.

    Parameters
    ----------
    system : PressureSystem
    preconditioner : Preconditioner, optional
        None for plain conjugate gradients.
    name : str
        For tables and logs.

    References
    ----------
    M. R. Hestenes, E. Stiefel, Methods of conjugate gradients for solving linear systems (1952).

    Limitations
    -----------
    One process, with threads. The residual cannot fall below rounding of A x; the answer says so.
    """

    def __init__(self, system: PressureSystem, preconditioner: Preconditioner | None = None, name: str = "cg") -> None:
        self.system = system
        self.preconditioner = preconditioner
        self.name = name
        self._z, self._p, self._Ap = (system.new_field() for _ in range(3))

    def destroy(self) -> None:
        """Nothing to free."""

    def solve(
        self,
        b: GridArray,
        tolerance: float,
        max_iterations: int,
        x: GridArray | None = None,
        watch: Watch | None = None,
    ) -> PoissonResult:
        """Solve A x = b; see `PoissonSolver`. `watch` may stop it."""
        system = self.system
        at, r = starting_point(system, b, x)
        target = tolerance * system.norm(b)
        residuals = [system.norm(r)]
        iteration, replacements = 0, 0
        reason = ""
        while not reason and residuals[-1] > target and iteration < max_iterations:
            reason, iteration = self._run(r, at, target, iteration, max_iterations, residuals, watch)
            system.apply(at, self._Ap)
            r[...] = b - self._Ap
            r[~system.unknown] = 0.0
            system.project(r)
            residuals[-1] = system.norm(r)
            replacements += 1
            # Below what rounding leaves of A x the recurrence goes on with numbers that mean nothing.
            if target < residuals[-1] <= _ROUNDING * system.norm(at) or (not reason and replacements > _REPLACEMENTS):
                reason = "the residual has reached rounding"
        converged = residuals[-1] <= target
        if converged:
            reason = "residual below tolerance"
        elif not math.isfinite(residuals[-1]):
            reason = "the residual is not finite"
        system.project(at)
        return PoissonResult(at, iteration, converged, reason or f"{iteration} iterations", residuals)

    def _run(
        self,
        r: GridArray,
        x: GridArray,
        target: float,
        iteration: int,
        max_iterations: int,
        residuals: list[float],
        watch: Watch | None,
    ) -> tuple[str, int]:
        """Iterate until the recurrence meets the target: what stopped it before, and how far it came."""
        system, p, Ap = self.system, self._p, self._Ap
        rz = 0.0
        while residuals[-1] > target and iteration < max_iterations:
            z = self._precondition(r)
            previous, rz = rz, system.dot(r, z)
            if not rz > 0.0:
                return "the preconditioner is not positive definite", iteration
            if previous == 0.0:
                p[...] = z
            else:
                grid_kernels.scale_and_add(rz / previous, z, p)
            system.apply(p, Ap)
            curvature = system.dot(p, Ap)
            if not curvature > 0.0:
                return "the matrix is not positive definite", iteration
            step = rz / curvature
            grid_kernels.axpy(step, p, x)
            grid_kernels.axpy(-step, Ap, r)
            iteration += 1
            residuals.append(system.norm(r))
            if not math.isfinite(residuals[-1]):
                return "the residual is not finite", iteration
            if watch is not None:
                told = watch(iteration, residuals[-1])
                if told:
                    return told, iteration
        return "", iteration

    def _precondition(self, r: GridArray) -> GridArray:
        if self.preconditioner is None:
            return r
        self.preconditioner.apply(r, self._z)
        self.system.project(self._z)
        return self._z
