"""Compiled loops over triangles and edges in 3D: membranes and rods made of a three-dimensional law.

The deformation gradient F = sum_a x_a (x) grad N_a has rank two (membrane) or one (rod). Its stretches, completed by
ones, enter the law: psi(s1, s2, 1) and psi(s, 1, 1): the thickness is frozen, so this is not plane
stress. Energies and forces follow from the stretches alone; normals need not be known.

Eigensystem of the Hessian over the tangential directions, with psi_i = dpsi/ds_i: in the plane the scaling, twist and
flip modes of the law; out of the plane psi_i / s_i along u_perp (x) v_i, the geometric stiffness, negative when
compressed.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.fem.kernels import CHUNK, add_blocks
from femdeform.jit import njit, prange
from femdeform.materials.dispatch import energy_from_stretches, stretch_derivatives

# Stretches below this are treated as this: a line or a point has no direction to resist in.
_SMALLEST = 1e-8


@njit
def frame(x: Any, cells: Any, gradients: Any, e: Any, F: Any, basis: Any, f: Any) -> Any:
    """Fill F (3, 3), an orthonormal basis (k, 3) of the reference cell's span, and f = F basis^T (3, k).

    Returns the number k of tangential directions.
    """
    n = cells.shape[1]
    k = n - 1
    for i in range(3):
        for j in range(3):
            s = 0.0
            for a in range(n):
                s += x[cells[e, a], i] * gradients[e, 0, a, j]
            F[i, j] = s
    # Gram-Schmidt on the gradients of the nodes 1..k, which span the reference cell.
    for m in range(k):
        for j in range(3):
            basis[m, j] = gradients[e, 0, m + 1, j]
        for p in range(m):
            d = 0.0
            for j in range(3):
                d += basis[m, j] * basis[p, j]
            for j in range(3):
                basis[m, j] -= d * basis[p, j]
        length = np.sqrt(basis[m, 0] ** 2 + basis[m, 1] ** 2 + basis[m, 2] ** 2)
        for j in range(3):
            basis[m, j] /= length
    for i in range(3):
        for m in range(k):
            f[i, m] = F[i, 0] * basis[m, 0] + F[i, 1] * basis[m, 1] + F[i, 2] * basis[m, 2]
    return k


@njit
def stretches(f: Any, k: Any, u: Any, w: Any) -> Any:
    """Singular values of f (3, k); left vectors into rows of u (3, 3), right ones into rows of w (k, k)."""
    if k == 1:
        s = np.sqrt(f[0, 0] ** 2 + f[1, 0] ** 2 + f[2, 0] ** 2)
        w[0, 0] = 1.0
        s0, s1 = max(s, _SMALLEST), 1.0
        for i in range(3):
            u[0, i] = f[i, 0] / s0
    else:
        a = f[0, 0] ** 2 + f[1, 0] ** 2 + f[2, 0] ** 2
        b = f[0, 0] * f[0, 1] + f[1, 0] * f[1, 1] + f[2, 0] * f[2, 1]
        c = f[0, 1] ** 2 + f[1, 1] ** 2 + f[2, 1] ** 2
        angle = 0.5 * np.arctan2(2.0 * b, a - c)
        w[0, 0], w[0, 1] = np.cos(angle), np.sin(angle)
        w[1, 0], w[1, 1] = -w[0, 1], w[0, 0]
        for m in range(2):
            for i in range(3):
                u[m, i] = f[i, 0] * w[m, 0] + f[i, 1] * w[m, 1]
        s0 = max(np.sqrt(u[0, 0] ** 2 + u[0, 1] ** 2 + u[0, 2] ** 2), _SMALLEST)
        s1 = max(np.sqrt(u[1, 0] ** 2 + u[1, 1] ** 2 + u[1, 2] ** 2), _SMALLEST)
        for i in range(3):
            u[0, i] /= s0
            u[1, i] /= s1
        u[2, 0] = u[0, 1] * u[1, 2] - u[0, 2] * u[1, 1]
        u[2, 1] = u[0, 2] * u[1, 0] - u[0, 0] * u[1, 2]
        u[2, 2] = u[0, 0] * u[1, 1] - u[0, 1] * u[1, 0]
    return s0, s1


@njit(parallel=True)
def cell_energies(x: Any, cells: Any, gradients: Any, weights: Any, law: Any, dim: Any, nodes: Any, out: Any) -> None:
    """Elastic energy of each cell [J] into `out` (n_cells,)."""
    n_chunks = (cells.shape[0] + CHUNK - 1) // CHUNK
    for chunk in prange(n_chunks):
        F, basis, f = np.empty((3, 3)), np.empty((2, 3)), np.empty((3, 2))
        u, w = np.empty((3, 3)), np.empty((2, 2))
        for e in range(chunk * CHUNK, min((chunk + 1) * CHUNK, cells.shape[0])):
            k = frame(x, cells, gradients, e, F, basis, f)
            s0, s1 = stretches(f, k, u, w)
            out[e] = weights[e, 0] * energy_from_stretches((s0, s1, 1.0), law)


@njit(parallel=True)
def cell_forces(
    x: Any, cells: Any, gradients: Any, weights: Any, law: Any, dim: Any, nodes: Any, out: Any, first: Any
) -> None:
    """Energy gradient of each cell at its nodes [N] into rows first + e n_nodes + a of `out`."""
    n_nodes = len(nodes)
    n_chunks = (cells.shape[0] + CHUNK - 1) // CHUNK
    for chunk in prange(n_chunks):
        F, basis, f = np.empty((3, 3)), np.empty((2, 3)), np.empty((3, 2))
        u, w = np.empty((3, 3)), np.empty((2, 2))
        for e in range(chunk * CHUNK, min((chunk + 1) * CHUNK, cells.shape[0])):
            k = frame(x, cells, gradients, e, F, basis, f)
            s0, s1 = stretches(f, k, u, w)
            psi, _, _, _ = stretch_derivatives((s0, s1, 1.0), law)
            for a in range(n_nodes):
                for i in range(3):
                    out[first + e * n_nodes + a, i] = 0.0
                for m in range(k):
                    # P grad N_a = sum_m psi_m u_m (v_m . grad N_a), v_m = sum_p w[m, p] basis[p].
                    g = 0.0
                    for p in range(k):
                        for j in range(3):
                            g += w[m, p] * basis[p, j] * gradients[e, 0, a, j]
                    for i in range(3):
                        out[first + e * n_nodes + a, i] += weights[e, 0] * psi[m] * u[m, i] * g


@njit
def _add_mode(H: Any, value: Any, project: Any, Q: Any) -> None:
    """Add value vec(Q) vec(Q)^T to H (9, 9)."""
    if project and value < 0.0:
        return
    for i in range(9):
        for j in range(9):
            H[i, j] += value * Q[i // 3, i % 3] * Q[j // 3, j % 3]


@njit
def _tangent(s0: Any, s1: Any, k: Any, u: Any, v: Any, law: Any, project: Any, Q: Any, H: Any) -> None:
    """Hessian of the energy density with respect to F, over variations of F in the tangential directions."""
    psi, A, twist, flip = stretch_derivatives((s0, s1, 1.0), law)
    for i in range(9):
        for j in range(9):
            H[i, j] = 0.0
    if k == 1:
        for i in range(3):
            for j in range(3):
                Q[i, j] = u[0, i] * v[0, j]
        _add_mode(H, A[0], project, Q)
        # Across the rod: psi_0 / s_0 (I - u u^T) (x) v v^T.
        across = psi[0] / s0
        if not project or across > 0.0:
            for i in range(9):
                for j in range(9):
                    same = 1.0 if i // 3 == j // 3 else 0.0
                    H[i, j] += across * (same - u[0, i // 3] * u[0, j // 3]) * v[0, i % 3] * v[0, j % 3]
        return
    # Scaling: eigenvectors of the 2 x 2 block (A00, A01; A01, A11).
    half, mean = 0.5 * (A[0] - A[1]), 0.5 * (A[0] + A[1])
    radius = np.sqrt(half * half + A[5] * A[5])
    angle = 0.5 * np.arctan2(A[5], half)
    c, s = np.cos(angle), np.sin(angle)
    for i in range(3):
        for j in range(3):
            Q[i, j] = c * u[0, i] * v[0, j] + s * u[1, i] * v[1, j]
    _add_mode(H, mean + radius, project, Q)
    for i in range(3):
        for j in range(3):
            Q[i, j] = -s * u[0, i] * v[0, j] + c * u[1, i] * v[1, j]
    _add_mode(H, mean - radius, project, Q)
    r = np.sqrt(0.5)
    for i in range(3):
        for j in range(3):
            Q[i, j] = r * (u[1, i] * v[0, j] - u[0, i] * v[1, j])
    _add_mode(H, twist[2], project, Q)
    for i in range(3):
        for j in range(3):
            Q[i, j] = r * (u[1, i] * v[0, j] + u[0, i] * v[1, j])
    _add_mode(H, flip[2], project, Q)
    for m in range(2):
        for i in range(3):
            for j in range(3):
                Q[i, j] = u[2, i] * v[m, j]
        _add_mode(H, psi[m] / (s0 if m == 0 else s1), project, Q)


@njit(parallel=True)
def cell_hessians(
    x: Any,
    cells: Any,
    gradients: Any,
    weights: Any,
    law: Any,
    project: Any,
    dim: Any,
    nodes: Any,
    out: Any,
    first: Any,
) -> None:
    """Upper block triangle of each cell's Hessian [N/m] into rows of `out` (n_slots, 9)."""
    n_pairs = (len(nodes) * (len(nodes) + 1)) // 2
    n_chunks = (cells.shape[0] + CHUNK - 1) // CHUNK
    for chunk in prange(n_chunks):
        F, basis, f = np.empty((3, 3)), np.empty((2, 3)), np.empty((3, 2))
        u, w, v = np.empty((3, 3)), np.empty((2, 2)), np.empty((2, 3))
        Q, H, M = np.empty((3, 3)), np.empty((9, 9)), np.empty((9, 3))
        for e in range(chunk * CHUNK, min((chunk + 1) * CHUNK, cells.shape[0])):
            k = frame(x, cells, gradients, e, F, basis, f)
            s0, s1 = stretches(f, k, u, w)
            for m in range(k):
                for j in range(3):
                    v[m, j] = 0.0
                    for p in range(k):
                        v[m, j] += w[m, p] * basis[p, j]
            _tangent(s0, s1, k, u, v, law, project, Q, H)
            slot = first + e * n_pairs
            for row in range(slot, slot + n_pairs):
                for i in range(9):
                    out[row, i] = 0.0
            add_blocks(H, weights[e, 0], gradients, e, 0, dim, nodes, M, out, slot)
