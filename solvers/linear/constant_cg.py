"""Conjugate gradients on condensed mixed systems, preconditioned by a constant matrix that is factorised once."""

from __future__ import annotations

import numpy as np

from femdeform.fem.assembly import SparseHessian
from femdeform.types import FloatArray
from solvers.linear.constant_matrix import ConstantMatrix
from solvers.linear.interface import LinearResult


class ConstantCG:
    """K dx = b by conjugate gradients with `ConstantMatrix` as preconditioner.

    Parameters
    ----------
    constant : ConstantMatrix
        Whoever steps calls its `begin`.
    tolerance : float
        Residual over the right-hand side [-].
    max_iterations : int

    References
    ----------
    T. Trusty, D. M. Kaufman, D. I. W. Levin, Mixed variational finite elements for implicit simulation of deformables
    (2022), section 4.

    Limitations
    -----------
    What is in K and not in the constant matrix costs iterations. K has to be positive definite; where it is not the
    solver says so.
    """

    name = "constant_cg"

    def __init__(self, constant: ConstantMatrix, tolerance: float, max_iterations: int) -> None:
        self.constant = constant
        self.tolerance = tolerance
        self.max_iterations = max_iterations

    def solve(self, K: SparseHessian, b: FloatArray) -> LinearResult:
        """Solve K x = b; see `LinearSolver`."""
        partition = K.partition
        x = np.zeros_like(b)
        if self.constant.failure:
            return LinearResult(x, 0, False, f"the constant matrix: {self.constant.failure}")
        r = b.copy()
        target, norm = self.tolerance * partition.norm(b), partition.norm(b)
        iteration, p, rz = 0, np.zeros_like(b), 1.0
        while norm > target and iteration < self.max_iterations:
            z = np.zeros_like(r)
            z[: partition.n_owned] = self.constant.solve(r[: partition.n_owned])
            partition.update_ghosts(z)
            rz, previous = partition.dot(r, z), rz
            p = z if iteration == 0 else z + (rz / previous) * p
            Kp = K.times(p)
            curvature = partition.dot(p, Kp)
            if not curvature > 0.0:
                return LinearResult(x, iteration, False, "the matrix is not positive definite, or not finite")
            x += (rz / curvature) * p
            r -= (rz / curvature) * Kp
            norm = partition.norm(r)
            iteration += 1
        converged = norm <= target
        reason = "converged" if converged else f"{iteration} conjugate gradients"
        return LinearResult(x, iteration, converged, reason, not converged)

    def reset(self) -> None:
        """Nothing of its own is held between solves."""

    def destroy(self) -> None:
        """Nothing of its own is held between solves."""
