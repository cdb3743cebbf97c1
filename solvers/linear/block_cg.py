"""Conjugate gradients with the blocks of single nodes as preconditioner: no matrix is needed."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from femdeform.parallel import Partition
from femdeform.types import FloatArray
from solvers.linear.interface import LinearResult


class Operator(Protocol):
    """A symmetric matrix known by its products: `SparseHessian`, `femdeform.mpm.point_hessian.PointHessian`."""

    @property
    def partition(self) -> Partition:
        """Ownership of the nodes."""

    def times(self, field: FloatArray) -> FloatArray:
        """Product with a (n_local, dim) field."""

    def diagonal_blocks(self) -> FloatArray:
        """Blocks of single nodes, (n_local, dim, dim)."""


class BlockCG:
    """K dx = b by conjugate gradients, preconditioned by the inverse blocks of the nodes.

    Where masses differ by many orders the blocks do too; the residual is therefore measured as the preconditioner does,
    by ``sqrt(r . B^-1 r)``, in which the nodes of little mass count like others.

    Parameters
    ----------
    tolerance : float
        Residual over the right-hand side in that measure [-].
    max_iterations : int
        Most iterations of a solve.

    References
    ----------
    R. Barrett et al., Templates for the Solution of Linear Systems (1994), sections 2.3 and 3.2.

    Limitations
    -----------
    Iterations grow with the stiffness: for material points with the Courant number of sound c h / dx, see
    docs/methods/implicit-points.md. K has to be positive definite; where it is not the solver says so.
    """

    name = "block_cg"

    def __init__(self, tolerance: float = 1e-6, max_iterations: int = 5000) -> None:
        self.tolerance = tolerance
        self.max_iterations = max_iterations

    def solve(self, K: Operator, b: FloatArray) -> LinearResult:
        """Solve K x = b; see `LinearSolver`."""
        dot = K.partition.dot
        x = np.zeros_like(b)
        blocks = K.diagonal_blocks()
        if not np.isfinite(blocks).all():
            return LinearResult(x, 0, False, "matrix is not finite")
        try:
            inverse = np.linalg.inv(blocks)
        except np.linalg.LinAlgError:
            return LinearResult(x, 0, False, "the block of a node is singular")
        r = b.copy()
        z = np.einsum("iab,ib->ia", inverse, r)
        rz = dot(r, z)
        if rz < 0.0:
            return LinearResult(x, 0, False, "the matrix is not positive definite")
        target = self.tolerance**2 * rz
        p, iteration = z, 0
        while rz > target and iteration < self.max_iterations:
            Kp = K.times(p)
            curvature = dot(p, Kp)
            if not curvature > 0.0:
                return LinearResult(x, iteration, False, "the matrix is not positive definite, or not finite")
            length = rz / curvature
            x += length * p
            r -= length * Kp
            z = np.einsum("iab,ib->ia", inverse, r)
            rz, previous = dot(r, z), rz
            p = z + (rz / previous) * p
            iteration += 1
        converged = rz <= target
        reason = "converged" if converged else f"{iteration} conjugate gradients"
        return LinearResult(x, iteration, converged, reason, not converged)

    def reset(self) -> None:
        """Nothing is held between solves."""

    def destroy(self) -> None:
        """Nothing is held between solves."""
