"""Linear systems by SciPy's sparse LU: the fallback where PETSc is not installed; serial only."""

from __future__ import annotations

import numpy as np

from femdeform.errors import InputError
from femdeform.fem.assembly import SparseHessian
from femdeform.types import FloatArray
from solvers.linear.interface import LinearResult


class SciPyDirect:
    """SuperLU with a symmetric ordering.

    References
    ----------
    X. S. Li, An overview of SuperLU (2005).

    Limitations
    -----------
    One thread, no symmetry in the factors: several times slower and larger than MUMPS in 3D.
    """

    name = "scipy_direct"

    def solve(self, K: SparseHessian, b: FloatArray) -> LinearResult:
        """Solve K x = b; see `LinearSolver`."""
        import scipy.sparse
        import scipy.sparse.linalg

        if K.partition.comm is not None:
            raise InputError("scipy_direct is serial: run on one rank, or install petsc4py")
        n = b.size
        # K is symmetric: its rows are the columns SuperLU wants.
        matrix = scipy.sparse.csc_matrix((K.values, K.columns, K.row_offsets), shape=(n, n))
        if not np.isfinite(K.values).all():
            return LinearResult(np.zeros_like(b), 0, False, "matrix is not finite")
        try:
            factors = scipy.sparse.linalg.splu(
                matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
            )
        except RuntimeError as error:
            return LinearResult(np.zeros_like(b), 1, False, str(error))
        x = factors.solve(b.ravel()).reshape(b.shape)
        finite = bool(np.isfinite(x).all())
        return LinearResult(x, 1, finite, "direct" if finite else "singular matrix")

    def reset(self) -> None:
        """Nothing is held between solves."""

    def destroy(self) -> None:
        """Nothing is held between solves."""
