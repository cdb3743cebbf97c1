"""The minimum of a quadratic model with one-sided rows, from the factors of its matrix for one set of active rows.

``1/2 d.K d - r.d + 1/2 sum_k k min(0, g_k + D_k.d)^2``: rows switch on and off between the iterations of a semi-smooth
Newton's method, and often only some of them. So the matrix is factorised once for a set of active rows; others enter
and leave it by the formula of Sherman, Morrison and Woodbury.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse

from femdeform.contact.weak_contact import WeakContact
from femdeform.types import BoolArray, FloatArray, IntArray

# Iterations, and rows that may differ from the factorised set: beyond, making factors anew is cheaper.
_ITERATIONS, _DIFFERENT = 12, 48


class ActiveRows:
    """One-sided rows of a block of degrees of freedom.

    Parameters
    ----------
    contact : WeakContact
        With the step begun.
    dofs : (n_nodes, dim) int64
        Number of each degree of freedom in the block, -1 outside of it.
    size : int
        Degrees of freedom of the block.

    References
    ----------
    M. Hintermueller, K. Ito, K. Kunisch, The primal-dual active set strategy as a semismooth Newton method (2003).
    """

    def __init__(self, contact: WeakContact, dofs: IntArray, size: int) -> None:
        n = len(contact.cells)
        values = contact.weights[:, :, None] * contact.normals[:, None, :]
        rows = dofs[contact.cells]
        columns = np.broadcast_to(np.arange(n)[:, None, None], rows.shape)
        kept = rows >= 0
        self._D = scipy.sparse.csc_matrix((values[kept], (rows[kept], columns[kept])), shape=(size, n))
        self._k = contact.normal_stiffness
        self._factor: Any = None
        self._base = np.zeros(n, dtype=bool)
        self._known: dict[int, int] = {}
        self._solved = np.empty((size, 0))

    def attach(self, factor: Any, base: BoolArray) -> None:
        """Take factors of the matrix with the rows `base` active."""
        self._factor, self._base = factor, base.copy()
        self._known, self._solved = {}, np.empty((self._D.shape[0], 0))

    def minimise(self, slope: FloatArray, gaps: FloatArray, start: BoolArray) -> tuple[FloatArray | None, BoolArray]:
        """The step to the minimum.

        Parameters
        ----------
        slope : (size,) float64
            Minus the gradient of everything, pushing rows included [N].
        gaps : (n_rows,) float64
            g [m]
        start : (n_rows,) bool
            First guess of the rows that will push.

        Returns
        -------
        step : (size,) float64 or None
            [m]; None if too many rows differ from the factorised ones.
        active : (n_rows,) bool
            Rows that push at the end of it, as far as is known.
        """
        rest = slope + self._D @ (self._k * np.minimum(gaps, 0.0))
        active, step = start, np.empty(0)
        for _ in range(_ITERATIONS):
            changed = np.flatnonzero(active != self._base)
            if changed.size > _DIFFERENT:
                return None, active
            step = self._solve(rest - self._D @ np.where(active, self._k * gaps, 0.0), changed)
            ahead = gaps + self._D.T @ step <= 0.0
            if np.array_equal(ahead, active):
                break
            active = ahead
        return step, active

    def _solve(self, right: FloatArray, changed: IntArray) -> FloatArray:
        """Solve with the factorised matrix after some rows have changed sides."""
        plain = np.asarray(self._factor.solve(right))
        if not changed.size:
            return plain
        new = [int(row) for row in changed if int(row) not in self._known]
        if new:
            columns = self._D[:, new].toarray() * np.sqrt(self._k[new])
            self._known.update({row: self._solved.shape[1] + i for i, row in enumerate(new)})
            self._solved = np.concatenate([self._solved, self._factor.solve(columns)], axis=1)
        Z = self._solved[:, [self._known[int(row)] for row in changed]]
        U = (self._D[:, changed] @ scipy.sparse.diags(np.sqrt(self._k[changed]))).T.tocsr()
        middle = np.diag(np.where(self._base[changed], -1.0, 1.0)) + U @ Z
        return np.asarray(plain - Z @ scipy.linalg.solve(middle, U @ plain, assume_a="sym", check_finite=False))
