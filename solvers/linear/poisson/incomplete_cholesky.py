"""Incomplete Cholesky factors of the pressure matrix, plain and modified, as a preconditioner."""

from __future__ import annotations

from femdeform.flow.pressure_system import GridArray, PressureSystem
from solvers.linear.poisson.incomplete_kernels import factorize, solve_factors

# The source's and the usual value: a little less than all keeps pivots away from zero.
MODIFIED = 0.97


class IncompleteCholesky:
    """IC(0) or MIC(0): A ~ L L^T with the pattern of A.

    Parameters
    ----------
    system : PressureSystem
    modification : float
        0 for IC(0), `MODIFIED` for MIC(0) [-].

    References
    ----------
    R. Bridson, Fluid Simulation for Computer Graphics (2015), section 5.4.2.

    Limitations
    -----------
    Substitution goes from voxel to voxel on one thread. Iterations grow with the number of voxels along a side.
    """

    def __init__(self, system: PressureSystem, modification: float = 0.0) -> None:
        self._inverse = system.new_field()
        factorize(system.diagonal, modification, self._inverse)

    def apply(self, r: GridArray, z: GridArray) -> None:
        """Solve with the factors; see `Preconditioner`."""
        solve_factors(self._inverse, r, z)
