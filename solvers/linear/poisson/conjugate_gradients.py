"""Conjugate gradients for the pressure, with any preconditioner."""

from __future__ import annotations

import numpy as np

from femdeform.flow import grid_kernels
from femdeform.flow.pressure_system import GridArray, PressureSystem
from solvers.linear.poisson.interface import PoissonResult, Preconditioner
from solvers.linear.poisson.recurrence import Progress, Watch, solve_by

# Rows of A have numbers of sum 12.
_ROUNDING = 12.0 * float(np.finfo(float).eps)


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
        return solve_by(self._iterate, self.system, b, tolerance, max_iterations, x, watch, _ROUNDING)

    def _iterate(self, r: GridArray, x: GridArray, progress: Progress) -> str:
        system, p, Ap = self.system, self._p, self._Ap
        rz = 0.0
        while progress.goes_on:
            z = self._precondition(r)
            previous, rz = rz, system.dot(r, z)
            if not rz > 0.0:
                return "the preconditioner is not positive definite"
            if previous == 0.0:
                p[...] = z
            else:
                grid_kernels.scale_and_add(rz / previous, z, p)
            system.apply(p, Ap)
            curvature = system.dot(p, Ap)
            if not curvature > 0.0:
                return "the matrix is not positive definite"
            step = rz / curvature
            grid_kernels.axpy(step, p, x)
            grid_kernels.axpy(-step, Ap, r)
            reason = progress.add(r)
            if reason:
                return reason
        return ""

    def _precondition(self, r: GridArray) -> GridArray:
        if self.preconditioner is None:
            return r
        self.preconditioner.apply(r, self._z)
        self.system.project(self._z)
        return self._z
