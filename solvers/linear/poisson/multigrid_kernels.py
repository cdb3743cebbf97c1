"""Loops of the multigrid cycle over padded grids.

Level 0 knows its matrix by the diagonal alone: couplings are -1 wherever there are two unknowns, and fields are zero
elsewhere. Coarser levels store the coupling of a voxel to its next one along each axis.

Sweeps are red-black Gauss-Seidel: a voxel's colour is the parity of i + j + k, voxels of a colour do not touch, so
threads take planes and the result does not depend on their number.
"""

from __future__ import annotations

from typing import Any

from femdeform.jit import njit, prange


@njit(parallel=True)
def sweep_finest(diagonal: Any, b: Any, x: Any, first: Any) -> None:
    """One sweep on level 0, colour `first` (0 or 1) and then the other."""
    for half in range(2):
        colour = (first + half) % 2
        for plane in prange(x.shape[0] - 2):
            i = plane + 1
            for j in range(1, x.shape[1] - 1):
                for k in range(1 + (i + j + 1 + colour) % 2, x.shape[2] - 1, 2):
                    d = diagonal[i, j, k]
                    if d > 0:
                        around = (
                            x[i - 1, j, k]
                            + x[i + 1, j, k]
                            + x[i, j - 1, k]
                            + x[i, j + 1, k]
                            + x[i, j, k - 1]
                            + x[i, j, k + 1]
                        )
                        x[i, j, k] = (b[i, j, k] + around) / d


@njit(parallel=True)
def sweep(diagonal: Any, wx: Any, wy: Any, wz: Any, b: Any, x: Any, first: Any) -> None:
    """One sweep on a coarser level."""
    for half in range(2):
        colour = (first + half) % 2
        for plane in prange(x.shape[0] - 2):
            i = plane + 1
            for j in range(1, x.shape[1] - 1):
                for k in range(1 + (i + j + 1 + colour) % 2, x.shape[2] - 1, 2):
                    d = diagonal[i, j, k]
                    if d > 0.0:
                        around = (
                            wx[i - 1, j, k] * x[i - 1, j, k]
                            + wx[i, j, k] * x[i + 1, j, k]
                            + wy[i, j - 1, k] * x[i, j - 1, k]
                            + wy[i, j, k] * x[i, j + 1, k]
                            + wz[i, j, k - 1] * x[i, j, k - 1]
                            + wz[i, j, k] * x[i, j, k + 1]
                        )
                        x[i, j, k] = (b[i, j, k] + around) / d


@njit
def _residual_finest(diagonal: Any, b: Any, x: Any, i: Any, j: Any, k: Any) -> Any:
    d = diagonal[i, j, k]
    if d == 0:
        return x[i, j, k] * 0
    around = x[i - 1, j, k] + x[i + 1, j, k] + x[i, j - 1, k] + x[i, j + 1, k] + x[i, j, k - 1] + x[i, j, k + 1]
    return b[i, j, k] - d * x[i, j, k] + around


@njit
def residual_at(diagonal: Any, wx: Any, wy: Any, wz: Any, b: Any, x: Any, i: Any, j: Any, k: Any) -> Any:
    around = (
        wx[i - 1, j, k] * x[i - 1, j, k]
        + wx[i, j, k] * x[i + 1, j, k]
        + wy[i, j - 1, k] * x[i, j - 1, k]
        + wy[i, j, k] * x[i, j + 1, k]
        + wz[i, j, k - 1] * x[i, j, k - 1]
        + wz[i, j, k] * x[i, j, k + 1]
    )
    return b[i, j, k] - diagonal[i, j, k] * x[i, j, k] + around


@njit(parallel=True)
def restrict_finest(diagonal: Any, b: Any, x: Any, coarse: Any) -> None:
    """Sum the residual of level 0 over the voxels of each coarse one."""
    nx, ny, nz = x.shape[0] - 1, x.shape[1] - 1, x.shape[2] - 1
    for plane in prange(coarse.shape[0] - 2):
        ci = plane + 1
        for cj in range(1, coarse.shape[1] - 1):
            for ck in range(1, coarse.shape[2] - 1):
                total = coarse[0, 0, 0] * 0
                for i in range(2 * ci - 1, min(2 * ci + 1, nx)):
                    for j in range(2 * cj - 1, min(2 * cj + 1, ny)):
                        for k in range(2 * ck - 1, min(2 * ck + 1, nz)):
                            total += _residual_finest(diagonal, b, x, i, j, k)
                coarse[ci, cj, ck] = total


@njit(parallel=True)
def restrict(diagonal: Any, wx: Any, wy: Any, wz: Any, b: Any, x: Any, coarse: Any) -> None:
    """Sum the residual of a coarser level over the voxels of each voxel of the next."""
    nx, ny, nz = x.shape[0] - 1, x.shape[1] - 1, x.shape[2] - 1
    for plane in prange(coarse.shape[0] - 2):
        ci = plane + 1
        for cj in range(1, coarse.shape[1] - 1):
            for ck in range(1, coarse.shape[2] - 1):
                total = coarse[0, 0, 0] * 0
                for i in range(2 * ci - 1, min(2 * ci + 1, nx)):
                    for j in range(2 * cj - 1, min(2 * cj + 1, ny)):
                        for k in range(2 * ck - 1, min(2 * ck + 1, nz)):
                            total += residual_at(diagonal, wx, wy, wz, b, x, i, j, k)
                coarse[ci, cj, ck] = total


@njit(parallel=True)
def prolong(coarse: Any, diagonal: Any, factor: Any, x: Any) -> None:
    """Add `factor` times the coarse value of each voxel that has an unknown."""
    for plane in prange(x.shape[0] - 2):
        i = plane + 1
        for j in range(1, x.shape[1] - 1):
            for k in range(1, x.shape[2] - 1):
                if diagonal[i, j, k] > 0:
                    x[i, j, k] += factor * coarse[(i + 1) // 2, (j + 1) // 2, (k + 1) // 2]
