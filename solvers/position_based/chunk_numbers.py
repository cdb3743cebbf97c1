"""Numbers of the cells of a chunk, side by side, so that compilers turn loops over its cells into vectors.

A chunk is `CHUNK` cells that one thread takes at a time. Its scratch holds number k of cell j at ``k CHUNK + j``; a
matrix or a mobility (see `cell_algebra`) takes as many rows as it has numbers. The distances are constants of the
compiled code: that is what lets a compiler see that no cell writes where another one reads.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.jit import njit, types
from solvers.position_based.inlining import inlined, inlined_overload

CHUNK = 64
# Rows of a matrix and of a mobility, in the plane some are left over.
MATRIX, MOBILITY = 9, 18

_COMPILED_ONLY = "compiled code only"


@njit
def make_scratch(rows: Any) -> Any:
    """Scratch of so many rows; filled, so that what is not used is a number."""
    return np.zeros(rows * CHUNK)


def put(row: Any, j: Any, A: Any, scratch: Any) -> None:
    """Write a tuple of numbers, or of tuples, of cell j to the rows from `row` on."""
    raise NotImplementedError(_COMPILED_ONLY)


@inlined_overload(put)
def _put(row: Any, j: Any, A: Any, scratch: Any) -> Any:
    def nine(row: Any, j: Any, A: Any, scratch: Any) -> None:
        p = row * CHUNK + j
        scratch[p] = A[0]
        scratch[p + CHUNK] = A[1]
        scratch[p + 2 * CHUNK] = A[2]
        scratch[p + 3 * CHUNK] = A[3]
        scratch[p + 4 * CHUNK] = A[4]
        scratch[p + 5 * CHUNK] = A[5]
        scratch[p + 6 * CHUNK] = A[6]
        scratch[p + 7 * CHUNK] = A[7]
        scratch[p + 8 * CHUNK] = A[8]

    def six(row: Any, j: Any, A: Any, scratch: Any) -> None:
        p = row * CHUNK + j
        scratch[p] = A[0]
        scratch[p + CHUNK] = A[1]
        scratch[p + 2 * CHUNK] = A[2]
        scratch[p + 3 * CHUNK] = A[3]
        scratch[p + 4 * CHUNK] = A[4]
        scratch[p + 5 * CHUNK] = A[5]

    def four(row: Any, j: Any, A: Any, scratch: Any) -> None:
        p = row * CHUNK + j
        scratch[p] = A[0]
        scratch[p + CHUNK] = A[1]
        scratch[p + 2 * CHUNK] = A[2]
        scratch[p + 3 * CHUNK] = A[3]

    def three(row: Any, j: Any, A: Any, scratch: Any) -> None:
        p = row * CHUNK + j
        scratch[p] = A[0]
        scratch[p + CHUNK] = A[1]
        scratch[p + 2 * CHUNK] = A[2]

    def three_sixes(row: Any, j: Any, A: Any, scratch: Any) -> None:
        put(row, j, A[0], scratch)
        put(row + 6, j, A[1], scratch)
        put(row + 12, j, A[2], scratch)

    def two_threes(row: Any, j: Any, A: Any, scratch: Any) -> None:
        put(row, j, A[0], scratch)
        put(row + 3, j, A[1], scratch)

    if isinstance(A[0], types.BaseTuple):
        return three_sixes if len(A) == 3 else two_threes
    return {9: nine, 6: six, 4: four, 3: three}[len(A)]


@inlined
def _nine(row: Any, j: Any, scratch: Any) -> Any:
    p = row * CHUNK + j
    return (
        scratch[p],
        scratch[p + CHUNK],
        scratch[p + 2 * CHUNK],
        scratch[p + 3 * CHUNK],
        scratch[p + 4 * CHUNK],
        scratch[p + 5 * CHUNK],
        scratch[p + 6 * CHUNK],
        scratch[p + 7 * CHUNK],
        scratch[p + 8 * CHUNK],
    )


@inlined
def _six(row: Any, j: Any, scratch: Any) -> Any:
    p = row * CHUNK + j
    return (
        scratch[p],
        scratch[p + CHUNK],
        scratch[p + 2 * CHUNK],
        scratch[p + 3 * CHUNK],
        scratch[p + 4 * CHUNK],
        scratch[p + 5 * CHUNK],
    )


@inlined
def _four(row: Any, j: Any, scratch: Any) -> Any:
    p = row * CHUNK + j
    return (scratch[p], scratch[p + CHUNK], scratch[p + 2 * CHUNK], scratch[p + 3 * CHUNK])


@inlined
def _three(row: Any, j: Any, scratch: Any) -> Any:
    p = row * CHUNK + j
    return (scratch[p], scratch[p + CHUNK], scratch[p + 2 * CHUNK])


def get_matrix(row: Any, j: Any, scratch: Any, dim: Any) -> Any:
    """The matrix of cell j in the rows from `row` on."""
    raise NotImplementedError(_COMPILED_ONLY)


@inlined_overload(get_matrix)
def _get_matrix(row: Any, j: Any, scratch: Any, dim: Any) -> Any:
    kernel = _nine if len(dim) == 3 else _four

    def implementation(row: Any, j: Any, scratch: Any, dim: Any) -> Any:
        return kernel(row, j, scratch)

    return implementation


def get_mobility(row: Any, j: Any, scratch: Any, masks: Any, dim: Any) -> Any:
    """The mobility of cell j in the rows from `row` on, of the kind that `masks` makes it."""
    raise NotImplementedError(_COMPILED_ONLY)


@inlined_overload(get_mobility)
def _get_mobility(row: Any, j: Any, scratch: Any, masks: Any, dim: Any) -> Any:
    kernel = _six if len(dim) == 3 else _three

    def one(row: Any, j: Any, scratch: Any, masks: Any, dim: Any) -> Any:
        return kernel(row, j, scratch)

    def three(row: Any, j: Any, scratch: Any, masks: Any, dim: Any) -> Any:
        return kernel(row, j, scratch), kernel(row + 6, j, scratch), kernel(row + 12, j, scratch)

    def two(row: Any, j: Any, scratch: Any, masks: Any, dim: Any) -> Any:
        return kernel(row, j, scratch), kernel(row + 3, j, scratch)

    if isinstance(masks, types.BaseTuple):
        return one
    return three if len(dim) == 3 else two
