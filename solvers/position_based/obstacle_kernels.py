"""Penalty contact of one node inside compiled sweeps: the energy of `femdeform.contact.penalty`, one node at a time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.contact.obstacles import Box, Plane, Sphere
from femdeform.contact.penalty import PenaltyContact
from femdeform.jit import njit
from femdeform.types import FloatArray, IntArray

PLANE, SPHERE, BOX = 0, 1, 2
# Halvings of a step that does not lower the energy of contact and model, and steps of Newton's method.
_HALVINGS = 12
_STEPS = 8


@dataclass
class ObstacleData:
    """Contacts of a step as arrays; vectors have three components, with zeros across the plane in 2D.

    Attributes
    ----------
    kinds : (n_contacts,) int64
        `PLANE`, `SPHERE` or `BOX`.
    shapes : (n_contacts, 7)
        Sign of the free side, a point, and the normal, the radius or the half widths.
    shifts : (n_contacts, 3)
        Motion of each obstacle up to the end of the step [m].
    slips : (n_contacts,)
        Slip up to which friction sticks [m].
    rows : (n_nodes,) int64
        Row of each node in the arrays below by place in the sweep, -1 where it touches nothing.
    stiffness, limits : (n_contacts, n_rows)
        Penalty [N/m] and limit of friction [N].
    starts, normals : (n_contacts, n_rows, 3)
        Where a node would be if it stuck [m], and the normal across which it slips.
    """

    kinds: IntArray
    shapes: FloatArray
    shifts: FloatArray
    slips: FloatArray
    rows: IntArray
    stiffness: FloatArray
    limits: FloatArray
    starts: FloatArray
    normals: FloatArray


def collect(contacts: Sequence[PenaltyContact], place: IntArray, dim: int) -> ObstacleData:
    """Arrays of the contacts as the step begun has frozen them.

    Parameters
    ----------
    contacts : sequence of PenaltyContact
        With the step begun.
    place : (n_nodes,) int64
        Place of each node in the sweep.
    dim : int
        2 or 3.
    """
    touched = np.unique(np.concatenate([np.empty(0, np.int64), *(contact.nodes for contact in contacts)]))
    rows = np.full(place.size, -1, dtype=np.int64)
    rows[place[touched]] = np.arange(touched.size)
    n, m = len(contacts), touched.size
    data = ObstacleData(
        np.zeros(n, dtype=np.int64),
        np.zeros((n, 7)),
        np.zeros((n, 3)),
        np.ones(n),
        rows,
        np.zeros((n, m)),
        np.zeros((n, m)),
        np.zeros((n, m, 3)),
        np.zeros((n, m, 3)),
    )
    for c, contact in enumerate(contacts):
        shape = contact.shape
        point, extent = data.shapes[c, 1:4], data.shapes[c, 4:7]
        if isinstance(shape, Plane):
            data.kinds[c], data.shapes[c, 0] = PLANE, 1.0
            point[:dim], extent[:dim] = shape.point, shape.normal
        elif isinstance(shape, Sphere):
            data.kinds[c], data.shapes[c, 0] = SPHERE, shape.sign
            point[:dim], extent[0] = shape.center, shape.radius
        elif isinstance(shape, Box):
            data.kinds[c], data.shapes[c, 0] = BOX, shape.sign
            extent[:] = math.inf
            point[:dim], extent[:dim] = shape.center, shape.half
        else:
            raise TypeError(f"no compiled form of the obstacle {type(shape).__name__}")
        shift, slip, start, normal, limit = contact.frozen
        own = rows[place[contact.nodes]]
        data.shifts[c, :dim], data.slips[c] = shift, slip
        data.stiffness[c, own], data.limits[c, own] = contact.stiffness, limit
        data.starts[c, own, :dim], data.normals[c, own, :dim] = start, normal
    return data


@njit
def signed_distance(kind: Any, shape: Any, y: Any) -> Any:
    """Distance [m], its gradient, and the size of its curvature across a direction: see `obstacles.Shape`.

    Returns
    -------
    tuple
        distance, (n0, n1, n2), bend, (b0, b1, b2): the second derivative is bend (diag(b) - n n^T), b being 1 in the
        directions in which the nearest point is fixed.
    """
    sign = shape[0]
    r0, r1, r2 = y[0] - shape[1], y[1] - shape[2], y[2] - shape[3]
    if kind == PLANE:
        n = (shape[4], shape[5], shape[6])
        return r0 * n[0] + r1 * n[1] + r2 * n[2], n, 0.0, (0.0, 0.0, 0.0)
    if kind == SPHERE:
        length = math.sqrt(r0 * r0 + r1 * r1 + r2 * r2)
        safe = max(length, 1e-12 * shape[4])
        n = (sign * r0 / safe, sign * r1 / safe, sign * r2 / safe)
        return sign * (length - shape[4]), n, sign / safe, (1.0, 1.0, 1.0)
    s0, s1, s2 = -1.0 if r0 < 0.0 else 1.0, -1.0 if r1 < 0.0 else 1.0, -1.0 if r2 < 0.0 else 1.0
    e0, e1, e2 = abs(r0) - shape[4], abs(r1) - shape[5], abs(r2) - shape[6]
    o0, o1, o2 = max(e0, 0.0), max(e1, 0.0), max(e2, 0.0)
    length = math.sqrt(o0 * o0 + o1 * o1 + o2 * o2)
    if length > 0.0:
        n = (sign * s0 * o0 / length, sign * s1 * o1 / length, sign * s2 * o2 / length)
        beyond = (1.0 if e0 > 0.0 else 0.0, 1.0 if e1 > 0.0 else 0.0, 1.0 if e2 > 0.0 else 0.0)
        return sign * length, n, sign / length, beyond
    if e0 >= e1 and e0 >= e2:
        return sign * e0, (sign * s0, 0.0, 0.0), 0.0, (0.0, 0.0, 0.0)
    if e1 >= e2:
        return sign * e1, (0.0, sign * s1, 0.0), 0.0, (0.0, 0.0, 0.0)
    return sign * e2, (0.0, 0.0, sign * s2), 0.0, (0.0, 0.0, 0.0)


@njit
def contact_energy(
    y: Any,
    row: Any,
    kinds: Any,
    shapes: Any,
    shifts: Any,
    slips: Any,
    stiffness: Any,
    limits: Any,
    starts: Any,
    normals: Any,
) -> Any:
    """Energy of all contacts of one node at y [J]."""
    energy = 0.0
    for c in range(kinds.size):
        where = (y[0] - shifts[c, 0], y[1] - shifts[c, 1], y[2] - shifts[c, 2])
        d, _, _, _ = signed_distance(kinds[c], shapes[c], where)
        d = min(d, 0.0)
        energy += 0.5 * stiffness[c, row] * d * d
        if limits[c, row] > 0.0:
            m0, m1, m2 = y[0] - starts[c, row, 0], y[1] - starts[c, row, 1], y[2] - starts[c, row, 2]
            n0, n1, n2 = normals[c, row, 0], normals[c, row, 1], normals[c, row, 2]
            along = m0 * n0 + m1 * n1 + m2 * n2
            u0, u1, u2 = m0 - along * n0, m1 - along * n1, m2 - along * n2
            length = math.sqrt(u0 * u0 + u1 * u1 + u2 * u2)
            h = slips[c]
            energy += limits[c, row] * (0.5 * length * length / h if length < h else length - 0.5 * h)
    return energy


@njit
def contact_terms(
    y: Any,
    row: Any,
    kinds: Any,
    shapes: Any,
    shifts: Any,
    slips: Any,
    stiffness: Any,
    limits: Any,
    starts: Any,
    normals: Any,
) -> Any:
    """Force [N] and positive semi-definite matrix [N/m] of all contacts of one node at y, nine numbers."""
    f0 = f1 = f2 = a0 = a1 = a2 = a3 = a4 = a5 = 0.0
    for c in range(kinds.size):
        k = stiffness[c, row]
        where = (y[0] - shifts[c, 0], y[1] - shifts[c, 1], y[2] - shifts[c, 2])
        d, n, bend, b = signed_distance(kinds[c], shapes[c], where)
        if d <= 0.0 and k > 0.0:
            f0 -= k * d * n[0]
            f1 -= k * d * n[1]
            f2 -= k * d * n[2]
            curved = max(k * d * bend, 0.0)
            k -= curved
            a0 += k * n[0] * n[0] + curved * b[0]
            a1 += k * n[1] * n[1] + curved * b[1]
            a2 += k * n[2] * n[2] + curved * b[2]
            a3 += k * n[1] * n[2]
            a4 += k * n[0] * n[2]
            a5 += k * n[0] * n[1]
        if limits[c, row] > 0.0:
            m0, m1, m2 = y[0] - starts[c, row, 0], y[1] - starts[c, row, 1], y[2] - starts[c, row, 2]
            n0, n1, n2 = normals[c, row, 0], normals[c, row, 1], normals[c, row, 2]
            along = m0 * n0 + m1 * n1 + m2 * n2
            u0, u1, u2 = m0 - along * n0, m1 - along * n1, m2 - along * n2
            length = math.sqrt(u0 * u0 + u1 * u1 + u2 * u2)
            # Beyond sticking the exact matrix is singular along the slip; this one bounds the energy.
            s = limits[c, row] / max(length, slips[c])
            f0 -= s * u0
            f1 -= s * u1
            f2 -= s * u2
            a0 += s * (1.0 - n0 * n0)
            a1 += s * (1.0 - n1 * n1)
            a2 += s * (1.0 - n2 * n2)
            a3 -= s * n1 * n2
            a4 -= s * n0 * n2
            a5 -= s * n0 * n1
    return f0, f1, f2, a0, a1, a2, a3, a4, a5


@njit
def solve_masked(g: Any, free0: Any, free1: Any, free2: Any) -> Any:
    """Solve A s = f for nine numbers (f, A) over the free components, zero in the others."""
    f0, f1, f2, a0, a1, a2, a3, a4, a5 = g
    if not free0:
        f0, a0, a4, a5 = 0.0 * f0, 0.0 * a0 + 1.0, 0.0 * a4, 0.0 * a5
    if not free1:
        f1, a1, a3, a5 = 0.0 * f1, 0.0 * a1 + 1.0, 0.0 * a3, 0.0 * a5
    if not free2:
        f2, a2, a3, a4 = 0.0 * f2, 0.0 * a2 + 1.0, 0.0 * a3, 0.0 * a4
    c0, c1, c2 = a1 * a2 - a3 * a3, a4 * a3 - a5 * a2, a5 * a3 - a4 * a1
    inverse = 1.0 / (a0 * c0 + a5 * c1 + a4 * c2)
    c3, c4, c5 = a0 * a2 - a4 * a4, a4 * a5 - a0 * a3, a0 * a1 - a5 * a5
    return (
        inverse * (c0 * f0 + c1 * f1 + c2 * f2),
        inverse * (c1 * f0 + c3 * f1 + c4 * f2),
        inverse * (c2 * f0 + c4 * f1 + c5 * f2),
    )


@njit
def step_in_contact(
    terms: Any,
    y: Any,
    free0: Any,
    free1: Any,
    free2: Any,
    row: Any,
    kinds: Any,
    shapes: Any,
    shifts: Any,
    slips: Any,
    stiffness: Any,
    limits: Any,
    starts: Any,
    normals: Any,
) -> Any:
    """Minimise ``-f.s + s.A s / 2`` plus the exact energy of contact over the free components of a node's step s.

    A node about to touch feels the obstacle before it is inside. Newton's method with halving: the energy of model and
    contact never rises, and the model bounds what the node's cells do.
    """
    f0, f1, f2, a0, a1, a2, a3, a4, a5 = terms
    s0 = s1 = s2 = 0.0
    value = contact_energy(y, row, kinds, shapes, shifts, slips, stiffness, limits, starts, normals)
    for _ in range(_STEPS):
        where = (y[0] + s0, y[1] + s1, y[2] + s2)
        g = contact_terms(where, row, kinds, shapes, shifts, slips, stiffness, limits, starts, normals)
        d = solve_masked(
            (
                g[0] + f0 - (a0 * s0 + a5 * s1 + a4 * s2),
                g[1] + f1 - (a5 * s0 + a1 * s1 + a3 * s2),
                g[2] + f2 - (a4 * s0 + a3 * s1 + a2 * s2),
                g[3] + a0,
                g[4] + a1,
                g[5] + a2,
                g[6] + a3,
                g[7] + a4,
                g[8] + a5,
            ),
            free0,
            free1,
            free2,
        )
        t, lower = 1.0, False
        for _ in range(_HALVINGS):
            u0, u1, u2 = s0 + t * d[0], s1 + t * d[1], s2 + t * d[2]
            model = 0.5 * (a0 * u0 * u0 + a1 * u1 * u1 + a2 * u2 * u2) + a3 * u1 * u2 + a4 * u0 * u2 + a5 * u0 * u1
            model -= f0 * u0 + f1 * u1 + f2 * u2
            there = (y[0] + u0, y[1] + u1, y[2] + u2)
            model += contact_energy(there, row, kinds, shapes, shifts, slips, stiffness, limits, starts, normals)
            if model < value:
                lower = True
                break
            t *= 0.5
        if not lower:
            # At the level of rounding the energy says no more; a single full step is what is left.
            if s0 == 0.0 and s1 == 0.0 and s2 == 0.0:
                s0, s1, s2 = d[0], d[1], d[2]
            break
        s0, s1, s2, value = u0, u1, u2, model
        if abs(t * d[0]) + abs(t * d[1]) + abs(t * d[2]) <= 1e-12 * (abs(s0) + abs(s1) + abs(s2)):
            break
    return s0, s1, s2
