"""Kernels of weak constraints in sweeps over cells: one visit to every row of a colour.

A linear row is up to three scalar constraints ``C_a = d_a . C`` along orthonormal directions d_a, in each of which it
has one stiffness k_a [N/m]; their gradients ``w_j d_a`` do not change. A spring is one, ``|C| - L`` along C. With s =
h^2 k [kg] the step of a multiplier l [kg m] is that of XPBD with the compliance alpha = 1 / k,

    dl = -(s C + l) / (s W + 1),    W = sum_j w_j^2 d . (m_j^-1 d),

which is ``-(C + a l) / (W + a)`` with a = alpha / h^2, also for k = 0. PBD is the limit of infinite stiffness.
Rows of a colour share no node: the result does not depend on the number of threads. Positions lie as in
`constraint_kernels`.
"""

from __future__ import annotations

import math
from typing import Any

from femdeform.jit import njit, prange

# Rows that one thread takes at a time.
_CHUNK = 64
# How a row treats the primary residual of its nodes: as XPBD, which leaves it out; the same with base points kept,
# which hold what the row does; or solving for its force from the base points, as FP-PXPBD does for stresses.
PLAIN, BASED, SOLVED = 0, 1, 2


@njit
def _offset(r: Any, shift: Any, offsets: Any, places: Any, weights: Any, targets: Any, x: Any) -> Any:
    """C of a row [m], of the vectors that begin `shift` after each node's place."""
    c0, c1, c2 = -targets[r, 0], -targets[r, 1], -targets[r, 2]
    for k in range(offsets[r], offsets[r + 1]):
        p, w = places[k] + shift, weights[k]
        c0 += w * x[p]
        c1 += w * x[p + 1]
        c2 += w * x[p + 2]
    return c0, c1, c2


@njit
def _mobility(r: Any, offsets: Any, places: Any, weights: Any, stride: Any, free: Any, x: Any) -> Any:
    """``sum_j w_j^2 / m_j`` over the nodes that are free to move along each axis [1/kg]."""
    m0 = m1 = m2 = 0.0
    for k in range(offsets[r], offsets[r + 1]):
        p = places[k]
        i = p // stride
        m = weights[k] * weights[k] * x[p + 3]
        m0 += m * free[i, 0]
        m1 += m * free[i, 1]
        m2 += m * free[i, 2]
    return m0, m1, m2


@njit
def step_length(C: Any, W: Any, s: Any, multiplier: Any, rigid: Any) -> Any:
    """Change of a multiplier [kg m]."""
    if rigid:
        return -C / W if W > 0.0 and s > 0.0 else 0.0 * C
    return -(s * C + multiplier) / (s * W + 1.0)


@njit
def _spring(c: Any, pull: Any, m: Any, length: Any, s: Any, rigid: Any) -> Any:
    """XPBD's step of a spring: the change of its pull [kg m], and its direction; none where it has none."""
    size = math.sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2])
    if size == 0.0:
        return 0.0 * size, c
    d0, d1, d2 = c[0] / size, c[1] / size, c[2] / size
    W = m[0] * d0 * d0 + m[1] * d1 * d1 + m[2] * d2 * d2
    return step_length(size - length, W, s, pull, rigid), (d0, d1, d2)


@njit
def _without_own(y: Any, o: Any, m: Any) -> Any:
    """C where the base points without the row's own part are, and its size [m]."""
    z = (y[0] - m[0] * o[0], y[1] - m[1] * o[1], y[2] - m[2] * o[2])
    return z, math.sqrt(z[0] * z[0] + z[1] * z[1] + z[2] * z[2])


@njit(parallel=True)
def project_rows(
    first: Any,
    last: Any,
    offsets: Any,
    places: Any,
    weights: Any,
    lengths: Any,
    frames: Any,
    stiffness: Any,
    targets: Any,
    stride: Any,
    free: Any,
    h2: Any,
    rigid: Any,
    mode: Any,
    x: Any,
    held: Any,
    pulls: Any,
) -> None:
    """Update the rows from first to last, each by itself.

    Parameters
    ----------
    first, last : int
        Rows of one colour.
    offsets, places, weights : (n_rows + 1,), (n_entries,), (n_entries,)
        Where the numbers of each row's nodes begin in x, and their weights [-].
    lengths : (n_rows,)
        Lengths without force of springs, 0 for linear rows [m].
    frames : (n_rows, 3, 3)
        Directions d_a of linear rows, row by row.
    stiffness : (n_rows, 3)
        Along each of them [N/m]; the first one is that of a spring.
    targets : (n_rows, 3)
        Places of C without force [m].
    stride : int
        Numbers a node.
    free : (n_nodes, 3) uint8
        0 where a component is prescribed, or missing in the plane; by place.
    h2 : float
        Square of the time step [s^2].
    rigid : bool
        PBD: infinite stiffness.
    mode : int
        `PLAIN`, `BASED` or `SOLVED`.
    x : (n_nodes stride,)
        See `constraint_kernels`.
    held : (n_rows, 3)
        ``sum_a l_a d_a`` of each row as it was last visited, which the base points hold [kg m].
    pulls : (n_rows,)
        Multipliers of springs [kg m].
    """
    for c in prange((last - first + _CHUNK - 1) // _CHUNK):
        for r in range(first + c * _CHUNK, min(first + (c + 1) * _CHUNK, last)):
            m = _mobility(r, offsets, places, weights, stride, free, x)
            o = (held[r, 0], held[r, 1], held[r, 2])
            y = _offset(r, 0, offsets, places, weights, targets, x)
            solved = mode == SOLVED
            if solved:
                base = _offset(r, 4, offsets, places, weights, targets, x)
                if lengths[r] > 0.0:
                    # A spring in tension is in balance along where the base points are without it. One that is
                    # compressed may balance elsewhere as well, and one whose nodes move less along an axis turns.
                    z, size = _without_own(base, o, m)
                    solved = size >= lengths[r] and m[0] == m[1] and (m[1] == m[2] or z[2] == 0.0)
                else:
                    y = base
            # `v` moves the nodes, `n` is what is held afterwards.
            if lengths[r] > 0.0:
                s = h2 * stiffness[r, 0]
                if solved:
                    pull = -s * (size - lengths[r]) / (1.0 + s * m[0])
                    n = (pull * z[0] / size, pull * z[1] / size, pull * z[2] / size)
                    v = (n[0] - o[0], n[1] - o[1], n[2] - o[2])
                else:
                    step, d = _spring(y, pulls[r], m, lengths[r], s, rigid)
                    pull = pulls[r] + step
                    n = (pull * d[0], pull * d[1], pull * d[2])
                    v = (step * d[0], step * d[1], step * d[2])
                pulls[r] = pull
            else:
                y0, y1, y2 = y
                v0 = v1 = v2 = 0.0 * h2
                for a in range(3):
                    d0, d1, d2 = frames[r, a, 0], frames[r, a, 1], frames[r, a, 2]
                    W = m[0] * d0 * d0 + m[1] * d1 * d1 + m[2] * d2 * d2
                    C = d0 * y0 + d1 * y1 + d2 * y2
                    step = step_length(C, W, h2 * stiffness[r, a], d0 * o[0] + d1 * o[1] + d2 * o[2], rigid)
                    v0, v1, v2 = v0 + step * d0, v1 + step * d1, v2 + step * d2
                    y0, y1, y2 = y0 + m[0] * d0 * step, y1 + m[1] * d1 * step, y2 + m[2] * d2 * step
                v = (v0, v1, v2)
                n = (o[0] + v0, o[1] + v1, o[2] + v2)
            for k in range(offsets[r], offsets[r + 1]):
                p = places[k]
                w = weights[k] * x[p + 3]
                for a in range(3):
                    if free[p // stride, a] != 0:
                        x[p + a] = (x[p + 4 + a] if solved else x[p + a]) + w * v[a]
                        if mode != PLAIN:
                            x[p + 4 + a] += w * (n[a] - o[a])
            held[r, 0], held[r, 1], held[r, 2] = n[0], n[1], n[2]
