"""The loops of `femdeform.fem.mixed_kernels` for membranes and rods.

The stretch of a cell lives in its tangent plane or along its edge: three symmetric modes, or one. Variations out of the
plane turn the cell; they meet only the geometric stiffness psi_i / s_i, which belongs to the part that is not
eliminated (multipliers of the normal directions would be the reaction of the frozen thickness and
would stiffen the step by 2 mu across for nothing).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.fem.codimensional import frame, stretches
from femdeform.fem.kernels import CHUNK, add_blocks
from femdeform.fem.mixed_kernels import above, above_2d, inverse_symmetric_2d
from femdeform.jit import njit, prange
from femdeform.materials.dispatch import stretch_derivatives

# Values of the rotation's modes at a point: psi_0 / s_0 and psi_1 / s_1 across the cell, then the twist in its plane.


@njit(parallel=True)
def cell_twists(
    x: Any,
    cells: Any,
    gradients: Any,
    weights: Any,
    law: Any,
    stress: Any,
    given: Any,
    dim: Any,
    nodes: Any,
    out: Any,
) -> None:
    """Values of the modes that turn the cell into `out` (n_cells, 1, 3) [Pa]; see `mixed_kernels.cell_twists`."""
    n_chunks = (cells.shape[0] + CHUNK - 1) // CHUNK
    for chunk in prange(n_chunks):
        F, basis, f = np.empty((3, 3)), np.empty((2, 3)), np.empty((3, 2))
        u, w, v = np.empty((3, 3)), np.empty((2, 2)), np.empty((2, 3))
        for e in range(chunk * CHUNK, min((chunk + 1) * CHUNK, cells.shape[0])):
            k = frame(x, cells, gradients, e, F, basis, f)
            s0, s1 = stretches(f, k, u, w)
            psi, _, twist, _ = stretch_derivatives((s0, s1, 1.0), law)
            y0, y1, t = psi[0], psi[1], twist[2]
            if given:
                turn(k, w, basis, v)
                y0 = _along(stress[e, 0], v, 0)
                y1 = _along(stress[e, 0], v, 1) if k == 2 else 0.0
                t = (y0 + y1) / (s0 + s1)
            out[e, 0, 0] = y0 / s0
            out[e, 0, 1] = y1 / s1 if k == 2 else 0.0
            out[e, 0, 2] = t if k == 2 else 0.0


@njit
def _along(Y: Any, v: Any, m: Any) -> Any:
    """v_m . Y v_m for row m of v; Y holds the 9 entries of a symmetric matrix."""
    s = 0.0
    for i in range(3):
        for j in range(3):
            s += v[m, i] * Y[3 * i + j] * v[m, j]
    return s


@njit(parallel=True)
def cell_stresses(
    x: Any,
    step: Any,
    cells: Any,
    gradients: Any,
    weights: Any,
    law: Any,
    floor: Any,
    dim: Any,
    nodes: Any,
    out: Any,
) -> None:
    """Stress at x + step by the model that is linear at x, into `out` (n_cells, 1, 9) [Pa]: the multipliers."""
    n_chunks = (cells.shape[0] + CHUNK - 1) // CHUNK
    for chunk in prange(n_chunks):
        F, basis, f = np.empty((3, 3)), np.empty((2, 3)), np.empty((3, 2))
        u, w, v, D = np.empty((3, 3)), np.empty((2, 2)), np.empty((2, 3)), np.empty((2, 2))
        for e in range(chunk * CHUNK, min((chunk + 1) * CHUNK, cells.shape[0])):
            k = frame(x, cells, gradients, e, F, basis, f)
            s0, s1 = stretches(f, k, u, w)
            turn(k, w, basis, v)
            psi, A, _, flip = stretch_derivatives((s0, s1, 1.0), law)
            bound = floor * law.mu
            B = _scaling(A, k, bound)
            frame(step, cells, gradients, e, F, basis, f)
            for i in range(k):
                for j in range(k):
                    D[i, j] = 0.0
                    for c in range(3):
                        for m in range(3):
                            D[i, j] += u[i, c] * F[c, m] * v[j, m]
            d1 = D[1, 1] if k == 2 else 0.0
            y0 = psi[0] + B[0] * D[0, 0] + B[2] * d1
            y1 = psi[1] + B[2] * D[0, 0] + B[1] * d1
            y01 = 0.5 * above(flip[2], bound) * (D[0, 1] + D[1, 0]) if k == 2 else 0.0
            for i in range(3):
                for j in range(3):
                    s = y0 * v[0, i] * v[0, j]
                    if k == 2:
                        s += y1 * v[1, i] * v[1, j] + y01 * (v[0, i] * v[1, j] + v[1, i] * v[0, j])
                    out[e, 0, 3 * i + j] = s


@njit
def _scaling(A: Any, k: Any, bound: Any) -> Any:
    """Scaling block over the tangential directions, (A00, A11, A01), raised to at least the bound."""
    if k == 1:
        return (above(A[0], bound), bound, 0.0)
    return above_2d((A[0], A[1], A[5]), bound)


@njit
def _add_outer(H: Any, value: Any, p: Any, q: Any, r: Any, s: Any) -> None:
    """Add value (vec(p q^T) vec(r s^T)^T + its transpose) / 2 to H (9, 9)."""
    for i in range(9):
        for j in range(9):
            H[i, j] += (
                0.5
                * value
                * (p[i // 3] * q[i % 3] * r[j // 3] * s[j % 3] + r[i // 3] * s[i % 3] * p[j // 3] * q[j % 3])
            )


@njit
def _tangent(
    s0: Any, s1: Any, k: Any, u: Any, v: Any, law: Any, twists: Any, floor: Any, exact: Any, split: Any, H: Any
) -> None:
    """Tangent over variations of F in the tangential directions; see `mixed_kernels.cell_hessians`."""
    _, A, _, flip = stretch_derivatives((s0, s1, 1.0), law)
    bound = floor * law.mu
    B, g = _scaling(A, k, bound), above(flip[2], bound)
    C, t, c = (A[0], A[1], A[5]), twists[2], flip[2]
    if not exact:
        C, t, c = B, above(t, 0.0), g
    if split:
        C, c = (C[0] - B[0], C[1] - B[1], C[2] - B[2]), c - g
    H[:, :] = 0.0
    _add_outer(H, C[0], u[0], v[0], u[0], v[0])
    if k == 2:
        _add_outer(H, C[1], u[1], v[1], u[1], v[1])
        _add_outer(H, 2.0 * C[2], u[0], v[0], u[1], v[1])
        # Twist and flip: u_0 v_1^T and u_1 v_0^T, each to itself by the mean, to one another by half the difference.
        _add_outer(H, 0.5 * (c + t), u[0], v[1], u[0], v[1])
        _add_outer(H, 0.5 * (c + t), u[1], v[0], u[1], v[0])
        _add_outer(H, c - t, u[0], v[1], u[1], v[0])
    for m in range(k):
        across = twists[m]
        if exact or across > 0.0:
            for i in range(9):
                for j in range(9):
                    p = 1.0 if i // 3 == j // 3 else 0.0
                    for n in range(k):
                        p -= u[n, i // 3] * u[n, j // 3]
                    H[i, j] += across * p * v[m, i % 3] * v[m, j % 3]


@njit(parallel=True)
def cell_hessians(
    x: Any,
    cells: Any,
    gradients: Any,
    weights: Any,
    law: Any,
    twists: Any,
    floor: Any,
    exact: Any,
    split: Any,
    dim: Any,
    nodes: Any,
    out: Any,
    first: Any,
) -> None:
    """Upper block triangle of each cell's mixed Hessian [N/m]; see `mixed_kernels.cell_hessians`."""
    n_pairs = (len(nodes) * (len(nodes) + 1)) // 2
    n_chunks = (cells.shape[0] + CHUNK - 1) // CHUNK
    for chunk in prange(n_chunks):
        F, basis, f = np.empty((3, 3)), np.empty((2, 3)), np.empty((3, 2))
        u, w, v = np.empty((3, 3)), np.empty((2, 2)), np.empty((2, 3))
        H, M = np.empty((9, 9)), np.empty((9, 3))
        for e in range(chunk * CHUNK, min((chunk + 1) * CHUNK, cells.shape[0])):
            k = frame(x, cells, gradients, e, F, basis, f)
            s0, s1 = stretches(f, k, u, w)
            turn(k, w, basis, v)
            _tangent(s0, s1, k, u, v, law, twists[e, 0], floor, exact, split, H)
            slot = first + e * n_pairs
            for row in range(slot, slot + n_pairs):
                for i in range(9):
                    out[row, i] = 0.0
            add_blocks(H, weights[e, 0], gradients, e, 0, dim, nodes, M, out, slot)


@njit
def turn(k: Any, w: Any, basis: Any, v: Any) -> None:
    """Principal directions in space, rows of v (k, 3), from their components in the cell's basis."""
    for m in range(k):
        for j in range(3):
            v[m, j] = 0.0
            for p in range(k):
                v[m, j] += w[m, p] * basis[p, j]


@njit(parallel=True)
def cell_rows(
    x: Any, cells: Any, gradients: Any, weights: Any, law: Any, floor: Any, dim: Any, nodes: Any, B: Any, C: Any
) -> None:
    """Constraint rows and compliances of the tangential modes; see `mixed_kernels.cell_rows`."""
    n_chunks = (cells.shape[0] + CHUNK - 1) // CHUNK
    for chunk in prange(n_chunks):
        F, basis, f = np.empty((3, 3)), np.empty((2, 3)), np.empty((3, 2))
        u, w, v = np.empty((3, 3)), np.empty((2, 2)), np.empty((2, 3))
        for e in range(chunk * CHUNK, min((chunk + 1) * CHUNK, cells.shape[0])):
            k = frame(x, cells, gradients, e, F, basis, f)
            s0, s1 = stretches(f, k, u, w)
            turn(k, w, basis, v)
            _, A, _, flip = stretch_derivatives((s0, s1, 1.0), law)
            bound, V = floor * law.mu, weights[e, 0]
            inverse = inverse_symmetric_2d(_scaling(A, k, bound))
            for a in range(len(nodes)):
                g0, g1 = 0.0, 0.0
                for j in range(3):
                    g0 += v[0, j] * gradients[e, 0, a, j]
                    if k == 2:
                        g1 += v[1, j] * gradients[e, 0, a, j]
                for c in range(3):
                    B[e, 0, 0, 3 * a + c] = V * g0 * u[0, c]
                    if k == 2:
                        B[e, 0, 1, 3 * a + c] = V * g1 * u[1, c]
                        B[e, 0, 2, 3 * a + c] = V * np.sqrt(0.5) * (g1 * u[0, c] + g0 * u[1, c])
            C[e, 0, 0, 0] = V * inverse[0]
            if k == 2:
                C[e, 0, 0, 2] = C[e, 0, 2, 0] = C[e, 0, 1, 2] = C[e, 0, 2, 1] = 0.0
                C[e, 0, 1, 1] = V * inverse[1]
                C[e, 0, 0, 1] = C[e, 0, 1, 0] = V * inverse[2]
                C[e, 0, 2, 2] = V / above(flip[2], bound)
