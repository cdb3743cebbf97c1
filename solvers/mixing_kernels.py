"""Sums over long vectors for Anderson's mixing, in pieces of fixed length: the same for any number of threads."""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.jit import njit, prange

PIECE = 4096


@njit(parallel=True)
def take_differences(before: Any, swept: Any, residual: Any, image: Any, residuals: Any, images: Any) -> Any:
    """Put ``r = swept - before`` and its image in the place of the last ones, and what changed in a row each.

    Parameters
    ----------
    before, swept : (n,)
        Iterate and its image.
    residual, image : (n,)
        Those of the last call; overwritten.
    residuals, images : (n,)
        The differences.

    Returns
    -------
    float
        The squared norm of r.
    """
    n = swept.size
    pieces = (n + PIECE - 1) // PIECE
    parts = np.zeros(pieces)
    for p in prange(pieces):
        total = 0.0
        for i in range(p * PIECE, min((p + 1) * PIECE, n)):
            r = swept[i] - before[i]
            residuals[i] = r - residual[i]
            images[i] = swept[i] - image[i]
            residual[i] = r
            image[i] = swept[i]
            total += r * r
        parts[p] = total
    norm = 0.0
    for p in range(pieces):
        norm += parts[p]
    return norm


@njit(parallel=True)
def inner_products(rows: Any, used: Any, row: Any, vector: Any, out: Any) -> None:
    """Products of the first `used` rows with one of them, and with a vector, into out (used, 2)."""
    n = vector.size
    pieces = (n + PIECE - 1) // PIECE
    parts = np.zeros((pieces, used, 2))
    for p in prange(pieces):
        for k in range(used):
            first = second = 0.0
            for i in range(p * PIECE, min((p + 1) * PIECE, n)):
                first += rows[k, i] * rows[row, i]
                second += rows[k, i] * vector[i]
            parts[p, k, 0] = first
            parts[p, k, 1] = second
    for k in range(used):
        out[k, 0] = out[k, 1] = 0.0
        for p in range(pieces):
            out[k, 0] += parts[p, k, 0]
            out[k, 1] += parts[p, k, 1]


@njit(parallel=True)
def subtract_rows(weights: Any, rows: Any, vector: Any) -> None:
    """Subtract the sum of weights times rows, as many as there are weights."""
    n = vector.size
    for p in prange((n + PIECE - 1) // PIECE):
        for k in range(weights.size):
            for i in range(p * PIECE, min((p + 1) * PIECE, n)):
                vector[i] -= weights[k] * rows[k, i]
