"""Compiled loops of the implicit step: deformation of points, and the Hessian as a matrix.

The displacement of the nodes in a step is u; a point q deforms by ``F_q = B_q + sum_i u_i G_qi^T``, with B = I and G
the gradients of the weights, or for solids B = F^n and ``G = F^nT grad w``. Everything that a law says of a point is
its stress ``P_q`` and tangent ``C_q``, with respect to ``D_q = F_q - B_q`` and times its volume. Tangents of liquids
are two numbers, ``C = alpha I x I + beta Sym``; those of other points are matrices.

A node reads its points through a fixed list, as in `mpm.kernels`: no two threads write to one place.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.fem.kernels import deformation_gradient
from femdeform.jit import njit, prange

# Rows that one thread takes at a time where it needs scratch of its own.
CHUNK = 64


@njit(parallel=True)
def deformations(u: Any, nodes: Any, gradients: Any, dim: Any, stencil: Any, out: Any) -> None:
    """``D_q = sum_k u[nodes[q, k]] gradients[q, 0, k]^T`` of all points, (n_points, dim^2), row-major.

    Parameters
    ----------
    u : (n_nodes, dim)
        Displacements [m].
    nodes : (n_points, n_stencil)
        Nodes of each point.
    gradients : (n_points, 1, n_stencil, dim)
        [1/m].
    dim, stencil : tuple
        Their lengths are the dimension and the number of nodes of a point.
    out : (n_points, dim^2)
        Result [-].
    """
    for q in prange(nodes.shape[0]):
        D = deformation_gradient(u, nodes, gradients, q, 0, dim, stencil)
        for c in range(out.shape[1]):
            out[q, c] = D[c]


@njit
def _contract(C: Any, gradients: Any, q: Any, k: Any, d: Any, M: Any) -> None:
    """M[c, d m + e] = sum_b C[d c + b, d m + e] G_k[b]."""
    for c in range(d):
        for j in range(d * d):
            s = 0.0
            for b in range(d):
                s += C[d * c + b, j] * gradients[q, 0, k, b]
            M[c, j] = s


@njit
def _add_block(M: Any, gradients: Any, q: Any, k: Any, d: Any, out: Any) -> None:
    """out[c, m] += sum_e M[c, d m + e] G_k[e]."""
    for c in range(d):
        for m in range(d):
            s = 0.0
            for e in range(d):
                s += M[c, d * m + e] * gradients[q, 0, k, e]
            out[c, m] += s


@njit
def _add_liquid_block(alpha: Any, beta: Any, gradients: Any, q: Any, k: Any, n: Any, d: Any, out: Any) -> None:
    """out += alpha G_k G_n^T + beta/2 (G_k . G_n I + G_n G_k^T)."""
    product = 0.0
    for c in range(d):
        product += gradients[q, 0, k, c] * gradients[q, 0, n, c]
    for c in range(d):
        for m in range(d):
            out[c, m] += alpha * gradients[q, 0, k, c] * gradients[q, 0, n, m]
            out[c, m] += 0.5 * beta * gradients[q, 0, n, c] * gradients[q, 0, k, m]
        out[c, c] += 0.5 * beta * product


@njit(parallel=True)
def diagonal_blocks(
    gradients: Any,
    offsets: Any,
    entries: Any,
    place: Any,
    tangents: Any,
    alpha: Any,
    beta: Any,
    weights: Any,
    dim: Any,
    stencil: Any,
    out: Any,
) -> None:
    """Blocks of single nodes of the Hessian [N/m], (n_nodes, dim, dim); see `assemble` for the arguments."""
    d, size = len(dim), len(stencil)
    n_nodes = out.shape[0]
    for chunk in prange((n_nodes + CHUNK - 1) // CHUNK):
        M = np.empty((d, d * d))
        for i in range(chunk * CHUNK, min((chunk + 1) * CHUNK, n_nodes)):
            for c in range(d):
                for m in range(d):
                    out[i, c, m] = weights[i] if c == m else 0.0
            for t in range(offsets[i], offsets[i + 1]):
                q = entries[t] // size
                k = entries[t] - q * size
                if place[q] >= 0:
                    _contract(tangents[place[q]], gradients, q, k, d, M)
                    _add_block(M, gradients, q, k, d, out[i])
                else:
                    _add_liquid_block(alpha[q], beta[q], gradients, q, k, k, d, out[i])


@njit(parallel=True)
def assemble(
    gradients: Any,
    offsets: Any,
    entries: Any,
    place: Any,
    tangents: Any,
    alpha: Any,
    beta: Any,
    weights: Any,
    relative: Any,
    neighbours: Any,
    row_offsets: Any,
    frames: Any,
    turned: Any,
    free: Any,
    dim: Any,
    stencil: Any,
    values: Any,
) -> None:
    """Values of the Hessian as a CSR matrix over the unknowns: ``Q^T (diag(weights) + sum_q G_q C_q G_q^T) Q``.

    Nodes of a stencil come in the order of their numbers. Blocks below the diagonal are left to `mirror`.

    Parameters
    ----------
    gradients : (n_points, 1, n_stencil, dim)
        [1/m].
    offsets, entries
        Points of each node.
    place : (n_points,) int
        Row of `tangents` of each point; -1 for liquids.
    tangents : (n, dim^2, dim^2)
        C_q [J].
    alpha, beta : (n_points,)
        Two numbers that are a liquid's tangent [J].
    weights : (n_nodes,)
        m_i / h^2 [N/m].
    relative : (n_stencil, n_stencil) int
        Number, among the nodes around one, of the place of the second node of a stencil as seen from the first.
    neighbours : (n_nodes, width^dim) int32
        Nodes around each, -1 where there is none; see `find_neighbours`. The first half of them come before it.
    row_offsets : (n_nodes + 1,)
        First block of each node's row.
    frames : (n_nodes, dim, dim)
        Q, whose columns are the axes of the unknowns of each node.
    turned : (n_nodes,) uint8
        0 where Q = I.
    free : (n_nodes, dim) uint8
        0 where an unknown is prescribed: of its row and column the entry on the diagonal is left.
    dim, stencil : tuple
        Their lengths are the dimension and the number of nodes of a point.
    values : (dim^2 n_blocks,)
        Result.
    """
    d, size = len(dim), len(stencil)
    n_nodes, n_around = neighbours.shape
    for chunk in prange((n_nodes + CHUNK - 1) // CHUNK):
        M = np.empty((d, d * d))
        blocks = np.empty((n_around, d, d))
        half = np.empty((d, d))
        for i in range(chunk * CHUNK, min((chunk + 1) * CHUNK, n_nodes)):
            blocks[:] = 0.0
            for c in range(d):
                blocks[n_around // 2, c, c] = weights[i]
            for t in range(offsets[i], offsets[i + 1]):
                q = entries[t] // size
                k = entries[t] - q * size
                if place[q] >= 0:
                    _contract(tangents[place[q]], gradients, q, k, d, M)
                    for n in range(k, size):
                        _add_block(M, gradients, q, n, d, blocks[relative[k, n]])
                else:
                    for n in range(k, size):
                        _add_liquid_block(alpha[q], beta[q], gradients, q, k, n, d, blocks[relative[k, n]])
            n_row = row_offsets[i + 1] - row_offsets[i]
            at = d * d * row_offsets[i]
            for r in range(n_around):
                j = neighbours[i, r]
                if j < 0:
                    continue
                if r < n_around // 2:
                    at += d
                    continue
                if turned[i] or turned[j]:
                    for c in range(d):
                        for m in range(d):
                            s = 0.0
                            for e in range(d):
                                s += frames[i, e, c] * blocks[r, e, m]
                            half[c, m] = s
                    for c in range(d):
                        for m in range(d):
                            s = 0.0
                            for e in range(d):
                                s += half[c, e] * frames[j, e, m]
                            blocks[r, c, m] = s
                for c in range(d):
                    for m in range(d):
                        value = blocks[r, c, m]
                        if free[i, c] == 0 or free[j, m] == 0:
                            value = abs(value) if i == j and c == m else 0.0
                        values[at + c * d * n_row + m] = value
                at += d


@njit(parallel=True)
def mirror(row_offsets: Any, neighbours: Any, ranks: Any, dim: Any, values: Any) -> None:
    """Blocks below the diagonal of a symmetric CSR matrix from those above it; see `assemble`.

    Parameters
    ----------
    row_offsets, neighbours, dim, values
        As for `assemble`.
    ranks : (n_nodes, width^dim) uint8
        Number of each of the `neighbours` among those of its node that exist.
    """
    d = len(dim)
    n_around = neighbours.shape[1]
    for i in prange(row_offsets.shape[0] - 1):
        n_row = row_offsets[i + 1] - row_offsets[i]
        for r in range(n_around // 2):
            j = neighbours[i, r]
            if j < 0:
                continue
            # Seen from there, this node lies on the opposite side.
            n_other = row_offsets[j + 1] - row_offsets[j]
            there = d * d * row_offsets[j] + d * ranks[j, n_around - 1 - r]
            here = d * d * row_offsets[i] + d * ranks[i, r]
            for c in range(d):
                for m in range(d):
                    values[here + c * d * n_row + m] = values[there + m * d * n_other + c]


@njit(parallel=True)
def find_neighbours(keys: Any, strides: Any, width: Any, out: Any) -> None:
    """Active nodes around each node of a lattice.

    Parameters
    ----------
    keys : (n_nodes,) int64
        ``sum_a index_a strides_a`` of each node, ascending. Strides leave room for `width` further nodes an axis.
    strides : (dim,) int64
        That of the last axis is 1.
    width : int
        Nodes an axis around a node, itself in the middle.
    out : (n_nodes, width^dim) int32
        Their numbers, in lexicographic order of their places; -1 where there is none.
    """
    dim = strides.shape[0]
    reach = width // 2
    lines = out.shape[1] // width
    n = keys.shape[0]
    for i in prange(n):
        for line in range(lines):
            rest, key = line, keys[i] - reach
            for a in range(dim - 2, -1, -1):
                key += (rest % width - reach) * strides[a]
                rest //= width
            low, high = 0, n
            while low < high:
                middle = (low + high) // 2
                if keys[middle] < key:
                    low = middle + 1
                else:
                    high = middle
            for r in range(width):
                found = low < n and keys[low] == key + r
                out[i, line * width + r] = low if found else -1
                if found:
                    low += 1


@njit
def _determinant(A: Any) -> Any:
    if A.shape[0] == 2:
        return A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
    return (
        A[0, 0] * (A[1, 1] * A[2, 2] - A[1, 2] * A[2, 1])
        + A[0, 1] * (A[1, 2] * A[2, 0] - A[1, 0] * A[2, 2])
        + A[0, 2] * (A[1, 0] * A[2, 1] - A[1, 1] * A[2, 0])
    )


@njit
def _mixed(A: Any, S: Any) -> Any:
    """cof A : S."""
    total = 0.0
    if A.shape[0] == 2:
        total = A[1, 1] * S[0, 0] - A[1, 0] * S[0, 1] - A[0, 1] * S[1, 0] + A[0, 0] * S[1, 1]
    else:
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            for e in range(3):
                m, n = (e + 1) % 3, (e + 2) % 3
                total += (A[b, m] * A[c, n] - A[b, n] * A[c, m]) * S[a, e]
    return total


@njit
def _cubic(c0: Any, c1: Any, c2: Any, c3: Any, t: Any) -> Any:
    return c0 + t * (c1 + t * (c2 + t * c3))


@njit
def first_root(c0: Any, c1: Any, c2: Any, c3: Any) -> Any:
    """Smallest root in (0, 1] of a cubic that is positive at 0; inf if there is none, 0 if it is not positive there."""
    if not c0 > 0.0:
        return 0.0
    # Places where the cubic turns split [0, 1] into stretches with one root at most.
    turns = np.array([1.0, 1.0, 1.0])
    if c3 == 0.0:
        if c2 != 0.0:
            turns[0] = -0.5 * c1 / c2
    else:
        under = c2 * c2 - 3.0 * c3 * c1
        if under > 0.0:
            s = -(c2 + np.copysign(np.sqrt(under), c2))
            turns[0] = s / (3.0 * c3)
            if s != 0.0:
                turns[1] = c1 / s
    if turns[1] < turns[0]:
        turns[0], turns[1] = turns[1], turns[0]
    left = 0.0
    for k in range(3):
        right = turns[k]
        if not (right > left and right <= 1.0):
            continue
        if _cubic(c0, c1, c2, c3, right) <= 0.0:
            for _ in range(60):
                middle = 0.5 * (left + right)
                if _cubic(c0, c1, c2, c3, middle) <= 0.0:
                    right = middle
                else:
                    left = middle
            return left
        left = right
    return np.inf


@njit(parallel=True)
def longest_steps(D: Any, S: Any, base: Any, symmetric: Any, bound: Any, dim: Any, out: Any) -> None:
    """Part of a step at which ``det(B + D + t S) / det B`` of each point comes down to a bound; inf if it never does.

    Parameters
    ----------
    D, S : (n_points, dim^2)
        Deformation and its change along the whole step [-].
    base : (n_points, dim^2)
        B [-].
    symmetric : (n_points,) uint8
        1 where the symmetric parts of D and S count.
    bound : float
        [-].
    dim : tuple
        Its length is the dimension.
    out : (n_points,)
        Result.
    """
    d = len(dim)
    for chunk in prange((D.shape[0] + CHUNK - 1) // CHUNK):
        A, T, B = np.empty((d, d)), np.empty((d, d)), np.empty((d, d))
        for q in range(chunk * CHUNK, min((chunk + 1) * CHUNK, D.shape[0])):
            for a in range(d):
                for b in range(d):
                    B[a, b] = base[q, d * a + b]
                    if symmetric[q]:
                        A[a, b] = B[a, b] + 0.5 * (D[q, d * a + b] + D[q, d * b + a])
                        T[a, b] = 0.5 * (S[q, d * a + b] + S[q, d * b + a])
                    else:
                        A[a, b] = B[a, b] + D[q, d * a + b]
                        T[a, b] = S[q, d * a + b]
            before = _determinant(B)
            if before == 0.0:
                out[q] = np.inf
                continue
            c0, c1 = _determinant(A) / before - bound, _mixed(A, T) / before
            if d == 2:
                out[q] = first_root(c0, c1, _determinant(T) / before, 0.0)
            else:
                out[q] = first_root(c0, c1, _mixed(T, A) / before, _determinant(T) / before)
