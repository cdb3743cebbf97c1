"""Compiled loops of the alternating mixed scheme: the local model of the stretch, rotations, multipliers.

Every quadrature point holds, as flat row-major arrays of d*d numbers, its stretch S (symmetric), rotation R and
multiplier L, a stress density conjugate to F; `solvers.mixed.local_points` says how the model of psi is kept. Membranes
and rods use the three-dimensional form with the projector N on the directions across the cell: R (S - N) = F
(docs/methods/finite-elements.md).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from femdeform.fem.kernels import CHUNK, add_forces, deformation_gradient
from femdeform.fem.mixed_kernels import write_compliance, write_rows
from femdeform.fem.mode_blocks import add_mode_blocks, complete_blocks, through_modes
from femdeform.jit import njit, prange
from solvers.mixed.local_points import (
    completed_root,
    compliant,
    entries,
    freeze_point,
    has_energy,
    nearest_rotation,
    principal,
    product,
    stiffness_modes,
    store,
    transposed,
    write_full_compliance,
)


@njit(parallel=True)
def stretches_at(
    x: Any, cells: Any, gradients: Any, weights: Any, across: Any, k: Any, dim: Any, nodes: Any, S: Any
) -> None:
    """Stretch of the polar decomposition of F, with ones across membranes and rods, into S (n_cells, n_q, d*d)."""
    d = len(dim)
    for e in prange(cells.shape[0]):
        for q in range(weights.shape[1]):
            F = deformation_gradient(x, cells, gradients, e, q, dim, nodes)
            if k == d:
                T = product(transposed(nearest_rotation(F, k)), F)
            else:
                T = completed_root(product(transposed(F), F), across[e])
            for i in range(d):
                for j in range(d):
                    S[e, q, d * i + j] = 0.5 * (T[d * i + j] + T[d * j + i])


@njit(parallel=True)
def freeze(S: Any, law: Any, floor: Any, dim: Any, V: Any, inverse: Any, flips: Any, psi: Any) -> None:
    """Quadratic model of psi at S: frame (.., d*d), inverse Hessian (.., 6 or 3) and (.., 3 or 1), gradient (.., d)."""
    for e in prange(S.shape[0]):
        for q in range(S.shape[1]):
            freeze_point(entries(S[e, q], dim), law, floor, V[e, q], inverse[e, q], flips[e, q], psi[e, q])


@njit(parallel=True)
def count_undefined(S: Any, law: Any, dim: Any, counts: Any) -> None:
    """Points of each cell whose stretch has no finite energy, into `counts` (n_cells,)."""
    for e in prange(S.shape[0]):
        n = 0
        for q in range(S.shape[1]):
            if not has_energy(entries(S[e, q], dim), law):
                n += 1
        counts[e] = n


@njit(parallel=True)
def rotate(
    x: Any,
    cells: Any,
    gradients: Any,
    weights: Any,
    S: Any,
    L: Any,
    alpha: Any,
    rounding: Any,
    across: Any,
    k: Any,
    dim: Any,
    nodes: Any,
    R: Any,
) -> None:
    """Rotations by equation (7) of the paper: the nearest to (L / beta + F) (S - N), beta = alpha |L|.

    Only the direction of L counts, so a multiplier that is nothing but rounding, at most `rounding` [Pa], must not: in
    membranes and rods it would turn the cell by up to 1 / alpha.
    """
    d = len(dim)
    for e in prange(cells.shape[0]):
        for q in range(weights.shape[1]):
            F = deformation_gradient(x, cells, gradients, e, q, dim, nodes)
            size = 0.0
            for i in range(d * d):
                size += L[e, q, i] ** 2
            scale = 1.0 / (alpha * math.sqrt(size)) if size > rounding**2 else 0.0
            for i in range(d * d):
                R[e, q, i] = S[e, q, i] - across[e, i]
            T = entries(R[e, q], dim)
            for i in range(d * d):
                R[e, q, i] = F[i] + scale * L[e, q, i]
            store(nearest_rotation(product(entries(R[e, q], dim), T), k), R[e, q])


@njit(parallel=True)
def constraint_sides(
    x: Any,
    cells: Any,
    gradients: Any,
    weights: Any,
    S: Any,
    R: Any,
    V: Any,
    inverse: Any,
    flips: Any,
    psi: Any,
    across: Any,
    eps: Any,
    L: Any,
    proximal: Any,
    dim: Any,
    nodes: Any,
    out: Any,
) -> None:
    """Right-hand side of the constraint row: R (S - N) - F - R H^-1 g, less eps L if proximal; (n_cells, n_q, d*d)."""
    d = len(dim)
    for e in prange(cells.shape[0]):
        for q in range(weights.shape[1]):
            F = deformation_gradient(x, cells, gradients, e, q, dim, nodes)
            v = entries(V[e, q], dim)
            X = compliant(principal(v, psi[e, q]), v, inverse[e, q], flips[e, q])
            for i in range(d * d):
                out[e, q, i] = S[e, q, i] - across[e, i] - X[i]
            T = product(entries(R[e, q], dim), entries(out[e, q], dim))
            for i in range(d * d):
                out[e, q, i] = T[i] - F[i] - (eps[e, q] * L[e, q, i] if proximal else 0.0)


@njit(parallel=True)
def condensed_blocks(
    cells: Any,
    gradients: Any,
    weights: Any,
    R: Any,
    V: Any,
    inverse: Any,
    flips: Any,
    eps: Any,
    sides: Any,
    dim: Any,
    nodes: Any,
    blocks: Any,
    first_block: Any,
    slots: Any,
    first_slot: Any,
) -> None:
    """Blocks of J^T V D J into `blocks`, forces J^T V D r into `slots`, with D = (W H^-1 W^T + eps)^-1."""
    d = len(dim)
    n_pairs = (len(nodes) * (len(nodes) + 1)) // 2
    n_chunks = (cells.shape[0] + CHUNK - 1) // CHUNK
    for chunk in prange(n_chunks):
        H, M = np.empty((d * d, d * d)), np.empty((d * d, d))
        for e in range(chunk * CHUNK, min((chunk + 1) * CHUNK, cells.shape[0])):
            row, slot = first_block + e * n_pairs, first_slot + e * len(nodes)
            for r in range(row, row + n_pairs):
                for i in range(d * d):
                    blocks[r, i] = 0.0
            for a in range(len(nodes)):
                for c in range(d):
                    slots[slot + a, c] = 0.0
            for q in range(weights.shape[1]):
                v = entries(V[e, q], dim)
                U = product(entries(R[e, q], dim), v)
                A, twist, flip = stiffness_modes(inverse[e, q], flips[e, q], eps[e, q], dim)
                add_mode_blocks(U, v, A, twist, flip, weights[e, q], gradients, e, q, dim, nodes, H, M, blocks, row)
                P = through_modes(entries(sides[e, q], dim), U, v, A, twist, flip)
                add_forces(P, weights[e, q], gradients, e, q, nodes, slots, slot)
            complete_blocks(dim, nodes, blocks, row)


@njit(parallel=True)
def condensed_multipliers(
    step: Any,
    cells: Any,
    gradients: Any,
    weights: Any,
    R: Any,
    V: Any,
    inverse: Any,
    flips: Any,
    eps: Any,
    sides: Any,
    dim: Any,
    nodes: Any,
    L: Any,
) -> None:
    """Multipliers L = D (J dq - r) after the condensed solve."""
    for e in prange(cells.shape[0]):
        for q in range(weights.shape[1]):
            change = deformation_gradient(step, cells, gradients, e, q, dim, nodes)
            v = entries(V[e, q], dim)
            U = product(entries(R[e, q], dim), v)
            A, twist, flip = stiffness_modes(inverse[e, q], flips[e, q], eps[e, q], dim)
            for i in range(len(change)):
                L[e, q, i] = change[i] - sides[e, q, i]
            store(through_modes(entries(L[e, q], dim), U, v, A, twist, flip), L[e, q])


@njit(parallel=True)
def full_compliances(weights: Any, R: Any, V: Any, inverse: Any, flips: Any, eps: Any, dim: Any, C: Any) -> None:
    """V (W H^-1 W^T + eps) for nine multipliers a point (four in 2D), into C (n_cells, n_q, d*d, d*d)."""
    d = len(dim)
    for e in prange(weights.shape[0]):
        for q in range(weights.shape[1]):
            v = entries(V[e, q], dim)
            U = product(entries(R[e, q], dim), v)
            write_full_compliance(U, v, inverse[e, q], flips[e, q], C[e, q])
            for i in range(d * d):
                C[e, q, i, i] += eps[e, q]
                for j in range(d * d):
                    C[e, q, i, j] *= weights[e, q]


@njit(parallel=True)
def symmetric_rows(
    cells: Any,
    gradients: Any,
    weights: Any,
    R: Any,
    V: Any,
    inverse: Any,
    flips: Any,
    sides: Any,
    dim: Any,
    nodes: Any,
    B: Any,
    C: Any,
    b: Any,
) -> None:
    """Rows, compliances and right-hand side for six multipliers a point (three in 2D): those of R^T L symmetric."""
    d = len(dim)
    for e in prange(cells.shape[0]):
        for q in range(weights.shape[1]):
            v = entries(V[e, q], dim)
            U = product(entries(R[e, q], dim), v)
            write_rows(U, v, weights[e, q], gradients, e, q, nodes, B[e, q])
            write_compliance(inverse[e, q], flips[e, q], weights[e, q], dim, C[e, q])
            T = product(transposed(U), product(entries(sides[e, q], dim), v))
            for i in range(d):
                b[e, q, i] = weights[e, q] * T[d * i + i]
            for p in range(d * (d - 1) // 2):
                i, j = ((p + 1) % 3, (p + 2) % 3) if d == 3 else (0, 1)
                b[e, q, d + p] = weights[e, q] * math.sqrt(0.5) * (T[d * i + j] + T[d * j + i])


@njit(parallel=True)
def symmetric_multipliers(y: Any, R: Any, V: Any, dim: Any, L: Any) -> None:
    """L = R Y from the components of the symmetric Y in the frame of the modes."""
    d = len(dim)
    for e in prange(y.shape[0]):
        for q in range(y.shape[1]):
            for i in range(d):
                L[e, q, d * i + i] = y[e, q, i]
            for p in range(d * (d - 1) // 2):
                i, j = ((p + 1) % 3, (p + 2) % 3) if d == 3 else (0, 1)
                L[e, q, d * i + j] = L[e, q, d * j + i] = math.sqrt(0.5) * y[e, q, d + p]
            v = entries(V[e, q], dim)
            U = product(entries(R[e, q], dim), v)
            store(product(U, product(entries(L[e, q], dim), transposed(v))), L[e, q])


@njit(parallel=True)
def update_stretches(S: Any, R: Any, L: Any, V: Any, inverse: Any, flips: Any, psi: Any, dim: Any, out: Any) -> None:
    """S + H^-1 (sym(R^T L) - g) into `out` (n_cells, n_q, d*d)."""
    d = len(dim)
    for e in prange(S.shape[0]):
        for q in range(S.shape[1]):
            v = entries(V[e, q], dim)
            Y = product(transposed(entries(R[e, q], dim)), entries(L[e, q], dim))
            T = principal(v, psi[e, q])
            for i in range(d * d):
                out[e, q, i] = Y[i] - T[i]
            change = compliant(entries(out[e, q], dim), v, inverse[e, q], flips[e, q])
            for i in range(d * d):
                out[e, q, i] = S[e, q, i] + change[i]
