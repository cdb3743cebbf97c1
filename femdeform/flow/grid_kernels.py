"""Loops over the voxels of a padded grid: the pressure operator, sums that do not depend on the number of threads.

Arrays have one layer of voxels around the grid, so no loop asks whether a neighbour exists. Threads take planes of the
first index; a sum adds up what each plane has found, in order.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.jit import njit, prange


@njit(parallel=True)
def apply_operator(diagonal: Any, x: Any, out: Any) -> None:
    """A x for x that is zero where there is no unknown.

    Parameters
    ----------
    diagonal : (nx + 2, ny + 2, nz + 2) uint8
        Number of neighbours that are no solid; 0 where there is no unknown.
    x : (nx + 2, ny + 2, nz + 2) float
        Zero where there is no unknown.
    out : (nx + 2, ny + 2, nz + 2) float
        A x.
    """
    for plane in prange(x.shape[0] - 2):
        i = plane + 1
        for j in range(1, x.shape[1] - 1):
            for k in range(1, x.shape[2] - 1):
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
                    out[i, j, k] = d * x[i, j, k] - around
                else:
                    out[i, j, k] = 0.0


@njit(parallel=True)
def dot(x: Any, y: Any, sums: Any) -> Any:
    """x.y in double precision; `sums` is a float64 buffer of one number a plane."""
    for i in prange(x.shape[0]):
        total = 0.0
        for j in range(x.shape[1]):
            for k in range(x.shape[2]):
                total += np.float64(x[i, j, k]) * np.float64(y[i, j, k])
        sums[i] = total
    result = 0.0
    for i in range(x.shape[0]):
        result += sums[i]
    return result


@njit(parallel=True)
def axpy(a: Any, x: Any, y: Any) -> None:
    """Y <- y + a x."""
    for i in prange(x.shape[0]):
        for j in range(x.shape[1]):
            for k in range(x.shape[2]):
                y[i, j, k] += a * x[i, j, k]


@njit(parallel=True)
def scale_and_add(a: Any, x: Any, y: Any) -> None:
    """Y <- a y + x."""
    for i in prange(x.shape[0]):
        for j in range(x.shape[1]):
            for k in range(x.shape[2]):
                y[i, j, k] = a * y[i, j, k] + x[i, j, k]


@njit(parallel=True)
def subtract_means(component: Any, counts: Any, sums: Any, x: Any) -> None:
    """Subtract from each component its mean.

    Parameters
    ----------
    component : (nx + 2, ny + 2, nz + 2) int32
        Number of a voxel's component, -1 where it has none.
    counts : (n_components,) int64
        Voxels of each.
    sums : (n_blocks, n_components) float64
        Buffer; planes are taken in as many blocks.
    x : (nx + 2, ny + 2, nz + 2) float
        Changed in place.
    """
    n_blocks = sums.shape[0]
    n = x.shape[0]
    for block in prange(n_blocks):
        for c in range(sums.shape[1]):
            sums[block, c] = 0.0
        for i in range(block * n // n_blocks, (block + 1) * n // n_blocks):
            for j in range(x.shape[1]):
                for k in range(x.shape[2]):
                    c = component[i, j, k]
                    if c >= 0:
                        sums[block, c] += x[i, j, k]
    for c in range(sums.shape[1]):
        total = 0.0
        for block in range(n_blocks):
            total += sums[block, c]
        sums[0, c] = total / counts[c]
    for i in prange(n):
        for j in range(x.shape[1]):
            for k in range(x.shape[2]):
                c = component[i, j, k]
                if c >= 0:
                    x[i, j, k] -= sums[0, c]
