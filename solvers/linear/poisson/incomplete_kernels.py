"""Loops of the incomplete Cholesky factorisation of the pressure matrix."""

from __future__ import annotations

import math
from typing import Any

from femdeform.jit import njit

# A pivot that falls below this part of the diagonal is replaced by the diagonal: the matrix may be singular.
_SAFETY = 0.25


@njit
def factorize(diagonal: Any, modification: Any, inverse: Any) -> None:
    """Write 1/L_ii of A = L L^T with the off-diagonal pattern of A.

    `modification` = 0 drops what falls outside of the pattern, 1 moves it to the diagonal, so that constants keep their
    row sums; values between do a part of it. Couplings are -1 wherever two voxels have an unknown.
    """
    for i in range(1, diagonal.shape[0] - 1):
        for j in range(1, diagonal.shape[1] - 1):
            for k in range(1, diagonal.shape[2] - 1):
                d = diagonal[i, j, k]
                if d == 0:
                    inverse[i, j, k] = 0.0
                    continue
                # A voxel before that has no unknown has an inverse of zero, and drops out.
                a, b, c = inverse[i - 1, j, k], inverse[i, j - 1, k], inverse[i, j, k - 1]
                pivot = d - a * a - b * b - c * c
                if modification > 0.0:
                    onward = a * a * ((diagonal[i - 1, j + 1, k] > 0) + (diagonal[i - 1, j, k + 1] > 0))
                    onward += b * b * ((diagonal[i + 1, j - 1, k] > 0) + (diagonal[i, j - 1, k + 1] > 0))
                    onward += c * c * ((diagonal[i + 1, j, k - 1] > 0) + (diagonal[i, j + 1, k - 1] > 0))
                    pivot -= modification * onward
                if pivot < _SAFETY * d:
                    pivot = float(d)
                inverse[i, j, k] = 1.0 / math.sqrt(pivot)


@njit
def solve_factors(inverse: Any, r: Any, z: Any) -> None:
    """Write (L L^T)^-1 r to z."""
    nx, ny, nz = r.shape[0] - 1, r.shape[1] - 1, r.shape[2] - 1
    for i in range(1, nx):
        for j in range(1, ny):
            for k in range(1, nz):
                e = inverse[i, j, k]
                if e > 0.0:
                    total = (
                        inverse[i - 1, j, k] * z[i - 1, j, k]
                        + inverse[i, j - 1, k] * z[i, j - 1, k]
                        + inverse[i, j, k - 1] * z[i, j, k - 1]
                    )
                    z[i, j, k] = (r[i, j, k] + total) * e
                else:
                    z[i, j, k] = 0.0
    for i in range(nx - 1, 0, -1):
        for j in range(ny - 1, 0, -1):
            for k in range(nz - 1, 0, -1):
                e = inverse[i, j, k]
                if e > 0.0:
                    total = z[i + 1, j, k] + z[i, j + 1, k] + z[i, j, k + 1]
                    z[i, j, k] = (z[i, j, k] + e * total) * e
