"""Constraints of single edges, tethers, hinges and bends: C and its gradients, energies and forces, compiled."""

from __future__ import annotations

import math
from typing import Any

from femdeform.jit import njit

DISTANCE, TETHER, BENDING = 0, 1, 2
# Of a node of a rod between two others: how far it is from the line between them, by components where that is nothing
# at rest, as a distance where the rod is curved at rest.
FLEX_X, FLEX_Y, FLEX_Z, BOW = 3, 4, 5, 6


@njit
def _minus(a: Any, b: Any) -> Any:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@njit
def _dot(a: Any, b: Any) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit
def _cross(a: Any, b: Any) -> Any:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@njit
def _sum(a: Any, s: Any, b: Any, t: Any) -> Any:
    return s * a[0] + t * b[0], s * a[1] + t * b[1], s * a[2] + t * b[2]


@njit
def hinge(a: Any, b: Any, c: Any, d: Any) -> Any:
    """Angle between the triangles (a, b, c) and (b, a, d) at their edge from a to b [rad], and its gradients [1/m].

    Zero where the triangles are flat, positive where they turn towards the side their normals point to; none (zero
    gradients) where a triangle has collapsed.
    """
    e = _minus(b, a)
    n = _cross(e, _minus(c, a))
    m = _cross(_minus(d, a), e)
    length = math.sqrt(_dot(e, e))
    nn, mm = _dot(n, n), _dot(m, m)
    zero = (0.0 * length, 0.0 * length, 0.0 * length)
    if nn == 0.0 or mm == 0.0:
        return 0.0 * length, zero, zero, zero, zero
    angle = math.atan2(_dot(_cross(m, n), e) / length, _dot(n, m))
    gc, gd = length / nn, length / mm
    # What moves the far corners up or down moves the ends of the edge the other way, by their lever arms.
    sc, sd = _dot(_minus(c, a), e) / (length * length), _dot(_minus(d, a), e) / (length * length)
    ga = _sum(n, -gc * (1.0 - sc), m, -gd * (1.0 - sd))
    gb = _sum(n, -gc * sc, m, -gd * sd)
    return angle, ga, gb, _sum(n, gc, m, 0.0), _sum(n, 0.0, m, gd)


@njit
def bow(kind: Any, rest: Any, share: Any, a: Any, b: Any, c: Any) -> Any:
    """Of ``u = (1 - share) a + share c - b`` one component, or the length over that at rest [m], and its gradients [-].

    A component is linear; a length has no gradient where it vanishes.
    """
    u = _minus(_sum(a, 1.0 - share, c, share), b)
    one = rest - rest + 1.0
    zero = 0.0 * one
    if kind == BOW:
        length = math.sqrt(_dot(u, u))
        scale = one / length if length > 0.0 else zero
        n = _sum(u, scale, u, 0.0)
        C = length - rest
    elif kind == FLEX_X:
        C, n = u[0] - zero, (one, zero, zero)
    elif kind == FLEX_Y:
        C, n = u[1] - zero, (zero, one, zero)
    else:
        C, n = u[2] - zero, (zero, zero, one)
    return C, _sum(n, 1.0 - share, n, 0.0), _sum(n, -1.0, n, 0.0), _sum(n, share, n, 0.0)


@njit
def constraint(kind: Any, rest: Any, share: Any, a: Any, b: Any, c: Any, d: Any) -> Any:
    """C and its gradients at up to four nodes: a length [m], or a change of angle in (-pi, pi] [rad].

    That of a tether may be negative, where it has no energy.
    """
    if kind > BENDING:
        C, ga, gb, gc = bow(kind, rest, share, a, b, c)
        return C, ga, gb, gc, _sum(gc, 0.0, gc, 0.0)
    if kind == BENDING:
        angle, ga, gb, gc, gd = hinge(a, b, c, d)
        change = angle - rest
        if change > math.pi:
            change -= 2.0 * math.pi
        elif change <= -math.pi:
            change += 2.0 * math.pi
        return change, ga, gb, gc, gd
    v = _minus(a, b)
    length = math.sqrt(_dot(v, v))
    scale = 1.0 / length if length > 0.0 else 0.0
    zero = (0.0 * rest, 0.0 * rest, 0.0 * rest)
    return length - rest, _sum(v, scale, v, 0.0), _sum(v, -scale, v, 0.0), zero, zero


@njit
def load_point(i: Any, x: Any) -> Any:
    """Row i of positions (n, 3)."""
    return x[i, 0], x[i, 1], x[i, 2]


@njit
def add_scaled(i: Any, s: Any, g: Any, out: Any) -> None:
    """Add s g to row i of an array (n, 3)."""
    out[i, 0] += s * g[0]
    out[i, 1] += s * g[1]
    out[i, 2] += s * g[2]


@njit
def add_weighted(
    kinds: Any, nodes: Any, rests: Any, shares: Any, stiffness: Any, multipliers: Any, x: Any, out: Any
) -> Any:
    """Add ``sum (k C + l) grad C`` at the nodes, and return ``sum k C^2 / 2``.

    Parameters
    ----------
    kinds, rests, shares, stiffness, multipliers : (n,)
        Of each constraint; k = 1 / compliance. A tether with C < 0 counts as C = 0.
    nodes : (n, 4)
        Rows of x; those that a kind does not have are 0.
    x, out : (n_nodes, 3)
        Positions [m], and what is added to.
    """
    energy = 0.0
    for r in range(kinds.size):
        a, b, c, d = nodes[r, 0], nodes[r, 1], nodes[r, 2], nodes[r, 3]
        C, ga, gb, gc, gd = constraint(
            kinds[r], rests[r], shares[r], load_point(a, x), load_point(b, x), load_point(c, x), load_point(d, x)
        )
        if kinds[r] == TETHER:
            C = max(C, 0.0)
        energy += 0.5 * stiffness[r] * C * C
        push = stiffness[r] * C + multipliers[r]
        add_scaled(a, push, ga, out)
        add_scaled(b, push, gb, out)
        if kinds[r] >= BENDING:
            add_scaled(c, push, gc, out)
        if kinds[r] == BENDING:
            add_scaled(d, push, gd, out)
    return energy
