"""Geometric multigrid for the pressure, as a preconditioner: unsmoothed aggregation of 2 x 2 (x 2) voxels."""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.flow.pressure_system import GridArray, PressureSystem
from solvers.linear.poisson import multigrid_kernels as kernels
from solvers.linear.poisson.multigrid_levels import MeasuredSurface, make_levels

# Constants per aggregate are twice too stiff: smooth errors come back half as large as they should.
OVERCORRECTION = 2.0
COARSEST_SWEEPS = 20


class Multigrid:
    """A symmetric V-cycle: an approximate inverse for conjugate gradients.

    Aggregates of 2^d voxels with constant values, Galerkin's coarse matrices, which keep seven points, corrections
    twice as large, red-black Gauss-Seidel with the colours turned round after the correction.

    Beside air, couplings of coarse levels go by the distances that are there (see `MeasuredSurface`). Factors by level
    alone, as if aggregates ended where air begins, cost one more iteration to 1e-4 where an odd layer of the grid is
    air, and two or three where the surface leaves one layer of fluid in a coarse aggregate. The cycle is symmetric and
    positive definite with any such coarse matrices, which are symmetric and have no negative coupling or sum of a row.

    Parameters
    ----------
    system : PressureSystem
    sweeps : int
        Before and after each correction: V(sweeps, sweeps).
    dtype : type
        Precision of the cycle; float32 is enough for a preconditioner.

    References
    ----------
    D. Braess, Towards algebraic multigrid for elliptic problems of second order (1995), for over-correction.

    Limitations
    -----------
    Coarse voxels do not see walls thinner than they are: porous solids and thin plates cost iterations, 20 to 50 in
    place of 4 at worst. A reaction below 1e-3 in a closed domain costs iterations too, one at 1e-4 and three at 1e-6:
    the coarsest level is not solved, and leaves the mean to conjugate gradients. One process, with threads.
    """

    def __init__(self, system: PressureSystem, sweeps: int = 2, dtype: type[np.floating[Any]] = np.float32) -> None:
        self.system = system
        self.sweeps = sweeps
        self.levels = make_levels(system, MeasuredSurface(system), dtype)

    def apply(self, r: GridArray, z: GridArray) -> None:
        """One V-cycle from zero; see `Preconditioner`."""
        self.levels[0].b[...] = r
        self._cycle(0)
        z[...] = self.levels[0].x

    def _cycle(self, k: int) -> None:
        level = self.levels[k]
        level.x[...] = 0.0
        is_coarsest = k == len(self.levels) - 1
        sweeps = COARSEST_SWEEPS if is_coarsest else self.sweeps
        for _ in range(sweeps):
            level.sweep(0)
        if not is_coarsest:
            coarse = self.levels[k + 1]
            level.restrict(coarse.b)
            self._cycle(k + 1)
            kernels.prolong(coarse.x, level.diagonal, level.x.dtype.type(OVERCORRECTION), level.x)
        for _ in range(sweeps):
            level.sweep(1)
