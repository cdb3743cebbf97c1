"""Ritz vectors of the empty box and right-hand sides made of them: the source's training data."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.flow.pressure_system import PressureSystem

# Vectors at the lower end get nine times as large coefficients: 5,500 of the source's 10,000.
_LOWER_PART = 0.55
_LOWER_WEIGHT = 9.0
_NULL = 1e-9


def ritz_pairs(
    system: PressureSystem, steps: int, rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Ritz values, ascending, and vectors (n_unknowns, m) of a Lanczos run with full reorthogonalisation.

    It starts from A times noise, so constants are not in it; of a repeated eigenvalue it sees one vector.
    """
    A = system.matrix()
    n = system.n_unknowns
    steps = min(steps, n - system.n_closed)
    basis = np.zeros((steps, n))
    alpha, beta = np.zeros(steps), np.zeros(steps)
    q = A @ rng.standard_normal(n)
    q /= np.linalg.norm(q)
    for k in range(steps):
        basis[k] = q
        w = A @ q
        alpha[k] = q @ w
        # Twice is enough.
        for _ in range(2):
            w -= basis[: k + 1].T @ (basis[: k + 1] @ w)
        beta[k] = np.linalg.norm(w)
        if beta[k] < _NULL:
            steps = k + 1
            break
        q = w / beta[k]
    from scipy.linalg import eigh_tridiagonal

    values, small = eigh_tridiagonal(alpha[:steps], beta[: steps - 1])
    kept = values > _NULL
    return values[kept], (basis[:steps].T @ small[:, kept]).astype(np.float32)


def ritz_right_sides(vectors: NDArray[Any], n: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """Random sums of unit length, (n, n_unknowns): amplitudes nine times as large for the lower 55 of 100 vectors."""
    m = vectors.shape[1]
    weights = np.where(np.arange(m) < round(_LOWER_PART * m), _LOWER_WEIGHT, 1.0)
    out = np.empty((n, vectors.shape[0]), dtype=np.float32)
    for begin in range(0, n, 256):
        part = out[begin : begin + 256]
        part[...] = (rng.standard_normal((len(part), m)) * weights).astype(np.float32) @ vectors.T
        part /= np.linalg.norm(part, axis=1, keepdims=True)
    return out
