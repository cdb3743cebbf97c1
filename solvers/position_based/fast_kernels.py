"""Kernels for the two laws that matter most, written so that compilers turn the loop over a node's cells into vectors.

Positions are all they read that changes: a cell's deformation is made anew from its corners, which lie in the cache,
rather than kept and updated, which would move three times as many bytes and drift.

With q the vector area (times two) of the face opposite to the node, w = 1/(6 V) and d = q.(x - x_base):
``J = w d`` and ``cof(F) n = w q``.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.jit import njit, prange
from solvers.position_based.node_kernels import add_terms, node_terms


@njit(parallel=True)
def add_neo_hookean(
    chunks: Any,
    nodes: Any,
    offsets: Any,
    others: Any,
    scales: Any,
    stencil_offsets: Any,
    neighbours: Any,
    weights: Any,
    diagonal: Any,
    law: Any,
    x: Any,
    acc: Any,
) -> None:
    """Add forces and matrices of the nodes of one colour from tetrahedra of the neo-Hookean law.

    The part mu/2 |F|^2 is a constant graph Laplacian; what is left depends on volumes alone: ``g = lambda^ (J - 1) -
    mu``, f = -V g cof(F) n = -g q / 6.

    Parameters
    ----------
    chunks, nodes, offsets, others, x, acc
        See `node_kernels.add_cells`.
    scales : (n_visits,)
        w = 1 / (6 V) [1/m^3].
    stencil_offsets, neighbours, weights, diagonal
        See `layout.Stencil`.
    law : NeoHookean
        In the precision of the arrays.
    """
    one, half, six = x.dtype.type(1.0), x.dtype.type(0.5), x.dtype.type(6.0)
    mu, stiff = law.mu, max(law.lmbda, half * law.lmbda_hat) / six
    rise, rest = law.lmbda_hat / six, law.mu / six
    for c in prange(chunks.size - 1):
        for r in range(chunks[c], chunks[c + 1]):
            i = nodes[r]
            p = 3 * i
            x0, x1, x2 = x[p], x[p + 1], x[p + 2]
            f0 = f1 = f2 = x0 - x0
            a0 = a1 = a2 = a3 = a4 = a5 = x0 - x0
            for v in range(stencil_offsets[r], stencil_offsets[r + 1]):
                b = neighbours[v]
                weight = mu * weights[v]
                f0 += weight * (x[b] - x0)
                f1 += weight * (x[b + 1] - x1)
                f2 += weight * (x[b + 2] - x2)
            for v in range(offsets[r], offsets[r + 1]):
                j, k, base = others[0, v], others[1, v], others[2, v]
                w = scales[v]
                b0, b1, b2 = x[base], x[base + 1], x[base + 2]
                e0, e1, e2 = x[j] - b0, x[j + 1] - b1, x[j + 2] - b2
                h0, h1, h2 = x[k] - b0, x[k + 1] - b1, x[k + 2] - b2
                q0, q1, q2 = e1 * h2 - e2 * h1, e2 * h0 - e0 * h2, e0 * h1 - e1 * h0
                d = q0 * (x0 - b0) + q1 * (x1 - b1) + q2 * (x2 - b2)
                g = rise * (d * w - one) - rest
                f0 -= g * q0
                f1 -= g * q1
                f2 -= g * q2
                s = stiff * w
                t0, t1, t2 = s * q0, s * q1, s * q2
                a0 += t0 * q0
                a1 += t1 * q1
                a2 += t2 * q2
                a3 += t1 * q2
                a4 += t0 * q2
                a5 += t0 * q1
            m = (mu + mu) * diagonal[r]
            add_terms((f0, f1, f2, a0 + m, a1 + m, a2 + m, a3, a4, a5), acc, 9 * i)


@njit(parallel=True)
def add_rotated(
    chunks: Any,
    nodes: Any,
    offsets: Any,
    others: Any,
    gradients: Any,
    volumes: Any,
    scales: Any,
    diagonal: Any,
    law: Any,
    tolerance: Any,
    dim: Any,
    x: Any,
    acc: Any,
) -> None:
    """Add forces and matrices of one colour from tetrahedra with ``P = 2 mu (F - R) + lambda (J - 1) cof F``.

    The trace t of S = R^T F is the largest root of ``t^4 - 2 |F|^2 t^2 - 8 J t + 2 |F^T F|^2 - |F|^4``, also of an
    inverted F; R is its derivative with respect to F: ``R = ((t^2 + |F|^2) F + 2 t cof F - 2 F F^T F) / (t^3 - |F|^2 t
    - 2 J)``. Three steps of Halley's rule from the bound sqrt(3) |F| find it to rounding unless a cell is strained
    beyond about one half; then, and where R is about to jump, the node's cells are done again one by one with a
    singular value decomposition.

    Parameters
    ----------
    chunks, nodes, offsets, others, gradients, volumes, dim, x, acc
        See `node_kernels.add_cells`.
    scales : (n_visits,)
        w = 1 / (6 V) [1/m^3].
    diagonal : (n_rows,)
        Sum of V |n|^2 over the node's cells [m].
    law : FixedCorotated or ARAP
        In the precision of the arrays.
    tolerance : float
        Bound of the sum of squares of the last relative corrections of t.
    """
    number = x.dtype.type
    one, two, three, four, six, eight = number(1.0), number(2.0), number(3.0), number(4.0), number(6.0), number(8.0)
    twelve, doubt = number(12.0), number(1e-16)
    mu2, push, stiff = two * law.mu, law.lmbda / six, law.lmbda / six
    for c in prange(chunks.size - 1):
        for r in range(chunks[c], chunks[c + 1]):
            i = nodes[r]
            p = 3 * i
            x0, x1, x2 = x[p], x[p + 1], x[p + 2]
            f0 = f1 = f2 = x0 - x0
            a0 = a1 = a2 = a3 = a4 = a5 = x0 - x0
            error = x0 - x0
            for v in range(offsets[r], offsets[r + 1]):
                j, k, base = others[0, v], others[1, v], others[2, v]
                w = scales[v]
                b0, b1, b2 = x[base], x[base + 1], x[base + 2]
                d0, d1, d2 = x0 - b0, x1 - b1, x2 - b2
                e0, e1, e2 = x[j] - b0, x[j + 1] - b1, x[j + 2] - b2
                h0, h1, h2 = x[k] - b0, x[k + 1] - b1, x[k + 2] - b2
                n0, n1, n2 = gradients[0, v], gradients[1, v], gradients[2, v]
                m0, m1, m2 = gradients[3, v], gradients[4, v], gradients[5, v]
                o0, o1, o2 = gradients[6, v], gradients[7, v], gradients[8, v]
                F0, F1, F2 = d0 * n0 + e0 * m0 + h0 * o0, d0 * n1 + e0 * m1 + h0 * o1, d0 * n2 + e0 * m2 + h0 * o2
                F3, F4, F5 = d1 * n0 + e1 * m0 + h1 * o0, d1 * n1 + e1 * m1 + h1 * o1, d1 * n2 + e1 * m2 + h1 * o2
                F6, F7, F8 = d2 * n0 + e2 * m0 + h2 * o0, d2 * n1 + e2 * m1 + h2 * o1, d2 * n2 + e2 * m2 + h2 * o2
                q0, q1, q2 = e1 * h2 - e2 * h1, e2 * h0 - e0 * h2, e0 * h1 - e1 * h0
                J = (q0 * d0 + q1 * d1 + q2 * d2) * w
                C0 = F0 * F0 + F3 * F3 + F6 * F6
                C1 = F1 * F1 + F4 * F4 + F7 * F7
                C2 = F2 * F2 + F5 * F5 + F8 * F8
                C3 = F1 * F2 + F4 * F5 + F7 * F8
                C4 = F0 * F2 + F3 * F5 + F6 * F8
                C5 = F0 * F1 + F3 * F4 + F6 * F7
                square = C0 + C1 + C2
                constant = two * (C0 * C0 + C1 * C1 + C2 * C2) + four * (C3 * C3 + C4 * C4 + C5 * C5) - square * square
                twice, J8 = two * square, eight * J
                t = np.sqrt(three * square)
                correction = t
                for _ in range(3):
                    tt = t * t
                    value = (tt - twice) * tt - J8 * t + constant
                    slope = four * (tt - square) * t - J8
                    bend = twelve * tt - two * twice
                    correction = two * value * slope / (two * slope * slope - value * bend)
                    t -= correction
                inverse = one / ((t * t - square) * t - two * J)
                # How far from a jump of R, and how large the last correction: both enter by their squares.
                jump = t * t * t * inverse
                correction /= t
                error += correction * correction + doubt * jump * jump
                u0, u1, u2 = F0 * n0 + F1 * n1 + F2 * n2, F3 * n0 + F4 * n1 + F5 * n2, F6 * n0 + F7 * n1 + F8 * n2
                z0, z1, z2 = C0 * n0 + C5 * n1 + C4 * n2, C5 * n0 + C1 * n1 + C3 * n2, C4 * n0 + C3 * n1 + C2 * n2
                y0, y1, y2 = F0 * z0 + F1 * z1 + F2 * z2, F3 * z0 + F4 * z1 + F5 * z2, F6 * z0 + F7 * z1 + F8 * z2
                V = mu2 * volumes[v]
                along_u = V * (one - (t * t + square) * inverse)
                along_q = push * (J - one) - V * two * t * w * inverse
                along_y = V * two * inverse
                f0 -= along_u * u0 + along_q * q0 + along_y * y0
                f1 -= along_u * u1 + along_q * q1 + along_y * y1
                f2 -= along_u * u2 + along_q * q2 + along_y * y2
                s = stiff * w
                t0, t1, t2 = s * q0, s * q1, s * q2
                a0 += t0 * q0
                a1 += t1 * q1
                a2 += t2 * q2
                a3 += t1 * q2
                a4 += t0 * q2
                a5 += t0 * q1
            m = mu2 * diagonal[r]
            if error <= tolerance:
                add_terms((f0, f1, f2, a0 + m, a1 + m, a2 + m, a3, a4, a5), acc, 9 * i)
            else:
                terms = node_terms(x, p, offsets[r], offsets[r + 1], others, gradients, volumes, law, dim)
                add_terms(terms, acc, 9 * i)
