"""Loops of the learned multigrid cycle: relaxed sweeps, and transfers with weights of each voxel's own.

A voxel has 2^dim parents on the coarser grid: the voxel it lies in, and beside it along each axis the one that is
nearer. Bit d of a slot's number says that along axis d it is the one beside.
"""

from __future__ import annotations

from typing import Any

from femdeform.jit import njit, prange
from solvers.linear.poisson.multigrid_kernels import residual_at


@njit(parallel=True)
def relaxed_sweep(diagonal: Any, wx: Any, wy: Any, wz: Any, omega: Any, b: Any, x: Any, first: Any) -> None:
    """One red-black sweep, colour `first` and then the other, with a relaxation factor for each voxel."""
    for half in range(2):
        colour = (first + half) % 2
        for plane in prange(x.shape[0] - 2):
            i = plane + 1
            for j in range(1, x.shape[1] - 1):
                for k in range(1 + (i + j + 1 + colour) % 2, x.shape[2] - 1, 2):
                    d = diagonal[i, j, k]
                    if d > 0.0:
                        x[i, j, k] += omega[i, j, k] * residual_at(diagonal, wx, wy, wz, b, x, i, j, k) / d


@njit(parallel=True)
def residual(diagonal: Any, wx: Any, wy: Any, wz: Any, b: Any, x: Any, out: Any) -> None:
    """Write b - A x."""
    for plane in prange(x.shape[0] - 2):
        i = plane + 1
        for j in range(1, x.shape[1] - 1):
            for k in range(1, x.shape[2] - 1):
                if diagonal[i, j, k] > 0.0:
                    out[i, j, k] = residual_at(diagonal, wx, wy, wz, b, x, i, j, k)


@njit(parallel=True)
def restrict(parents: Any, fine: Any, coarse: Any) -> None:
    """Transpose of `prolong`.

    Parameters
    ----------
    parents : (2^dim, nx + 2, ny + 2, nz + 2) float
        Weight of each parent; zero where there is no unknown.
    fine : (nx + 2, ny + 2, nz + 2) float
        A field.
    coarse : (mx + 2, my + 2, mz + 2) float
        Written.
    """
    nx, ny, nz = fine.shape[0] - 1, fine.shape[1] - 1, fine.shape[2] - 1
    for plane in prange(coarse.shape[0] - 2):
        ci = plane + 1
        for cj in range(1, coarse.shape[1] - 1):
            for ck in range(1, coarse.shape[2] - 1):
                total = coarse[0, 0, 0] * 0
                for i in range(max(1, 2 * ci - 2), min(2 * ci + 2, nx)):
                    si = 0 if (i + 1) // 2 == ci else 1
                    for j in range(max(1, 2 * cj - 2), min(2 * cj + 2, ny)):
                        sj = si if (j + 1) // 2 == cj else si + 2
                        for k in range(max(1, 2 * ck - 2), min(2 * ck + 2, nz)):
                            slot = sj if (k + 1) // 2 == ck else sj + 4
                            if slot < parents.shape[0]:
                                total += parents[slot, i, j, k] * fine[i, j, k]
                coarse[ci, cj, ck] = total


@njit(parallel=True)
def prolong(coarse: Any, parents: Any, factor: Any, x: Any) -> None:
    """Add `factor` times the weighted values of each voxel's parents."""
    for plane in prange(x.shape[0] - 2):
        i = plane + 1
        for j in range(1, x.shape[1] - 1):
            for k in range(1, x.shape[2] - 1):
                total = x[0, 0, 0] * 0
                for slot in range(parents.shape[0]):
                    weight = parents[slot, i, j, k]
                    if weight != 0.0:
                        ci = (i + 1) // 2 if slot & 1 == 0 else (i + 1) // 2 - 2 * (i % 2) + 1
                        cj = (j + 1) // 2 if slot & 2 == 0 else (j + 1) // 2 - 2 * (j % 2) + 1
                        ck = (k + 1) // 2 if slot & 4 == 0 else (k + 1) // 2 - 2 * (k % 2) + 1
                        total += weight * coarse[ci, cj, ck]
                x[i, j, k] += factor * total
