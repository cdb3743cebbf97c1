"""Conditions of walls on single nodes inside compiled sweeps; see `femdeform.mpm.walls`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.jit import njit, prange
from femdeform.step_problem import StepRows
from femdeform.types import FloatArray, IntArray
from solvers.position_based.obstacle_kernels import solve_masked

# Steps of Newton's method; the energy is piecewise quadratic, few nodes are at more than one wall.
_STEPS = 12


@dataclass
class WallData:
    """Rows of a step as arrays, node by node; vectors have three components, with zeros across the plane in 2D.

    Attributes
    ----------
    nodes : (n,) int64
        Places of the nodes at walls, ascending.
    offsets : (n + 1,) int64
        First row of each.
    normals, targets, stiffness : (n_rows, 3), (n_rows,), (n_rows,)
        See `WallRows`.
    two_sided : bool
        Whether rows act on both sides.
    free : (n, 3) uint8
        0 where a component is prescribed.
    forces : (n, 3)
        Force of the walls on each node [N].
    """

    nodes: IntArray
    offsets: IntArray
    normals: FloatArray
    targets: FloatArray
    stiffness: FloatArray
    two_sided: bool
    free: np.ndarray[Any, np.dtype[np.uint8]]
    forces: FloatArray


def collect_rows(rows: StepRows, place: IntArray, free: np.ndarray[Any, np.dtype[np.uint8]], dim: int) -> WallData:
    """Arrays of the rows as the step begun has frozen them; `free` (n_nodes, 3) in the order of the sweep."""
    order = np.argsort(place[rows.nodes], kind="stable")
    nodes, counts = np.unique(place[rows.nodes], return_counts=True)
    normals = np.zeros((order.size, 3))
    normals[:, :dim] = rows.normals[order]
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    return WallData(
        nodes,
        offsets,
        normals,
        rows.targets[order],
        rows.stiffness[order],
        rows.two_sided,
        free[nodes],
        np.zeros((nodes.size, 3)),
    )


@njit
def _with_rows(terms: Any, z: Any, s: Any, first: Any, last: Any, rows: Any, two_sided: Any, every: Any) -> Any:
    """Force and matrix of a quadratic model and of the rows that act, or of every one, after a step s from z."""
    normals, targets, stiffness = rows
    f0, f1, f2, a0, a1, a2, a3, a4, a5 = terms
    f0 -= a0 * s[0] + a5 * s[1] + a4 * s[2]
    f1 -= a5 * s[0] + a1 * s[1] + a3 * s[2]
    f2 -= a4 * s[0] + a3 * s[1] + a2 * s[2]
    acting, bit = 0, 1
    for r in range(first, last):
        n0, n1, n2 = normals[r, 0], normals[r, 1], normals[r, 2]
        gap = n0 * (z[0] + s[0]) + n1 * (z[1] + s[1]) + n2 * (z[2] + s[2]) - targets[r]
        acts = two_sided or gap <= 0.0
        if acts:
            pull = stiffness[r] * gap
            f0 -= pull * n0
            f1 -= pull * n1
            f2 -= pull * n2
            acting += bit
        if acts or every:
            k = stiffness[r]
            a0 += k * n0 * n0
            a1 += k * n1 * n1
            a2 += k * n2 * n2
            a3 += k * n1 * n2
            a4 += k * n0 * n2
            a5 += k * n0 * n1
        bit *= 2
    return (f0, f1, f2, a0, a1, a2, a3, a4, a5), acting


@njit
def settle_at_walls(
    terms: Any,
    z: Any,
    free0: Any,
    free1: Any,
    free2: Any,
    first: Any,
    last: Any,
    normals: Any,
    targets: Any,
    stiffness: Any,
    two_sided: Any,
) -> Any:
    """Step of a node at z that minimises ``-f . s + s . A s / 2`` plus the energy of its walls.

    The function is piecewise quadratic and convex: Newton's method ends where the set of rows that act stays. Where
    it does not, one step with every row in the matrix, which bounds the energy from above, cannot raise it.

    Parameters
    ----------
    terms : tuple
        Nine numbers, f and A; see `node_kernels`.
    z : tuple
        Position [m].
    free0, free1, free2 : bool
        Components that may move.
    first, last : int
        Rows of the node.
    normals, targets, stiffness, two_sided
        See `WallData`.
    """
    rows = (normals, targets, stiffness)
    s = (0.0 * z[0], 0.0 * z[1], 0.0 * z[2])
    before = -1
    for _ in range(_STEPS):
        now, acting = _with_rows(terms, z, s, first, last, rows, two_sided, False)
        if acting == before:
            return s
        before = acting
        d = solve_masked(now, free0, free1, free2)
        s = (s[0] + d[0], s[1] + d[1], s[2] + d[2])
    now, _ = _with_rows(terms, z, (0.0 * z[0], 0.0 * z[1], 0.0 * z[2]), first, last, rows, two_sided, True)
    return solve_masked(now, free0, free1, free2)


@njit(parallel=True)
def step_at_walls(
    first: Any,
    last: Any,
    nodes: Any,
    offsets: Any,
    normals: Any,
    targets: Any,
    stiffness: Any,
    two_sided: Any,
    free: Any,
    weights: Any,
    centers: Any,
    loads: Any,
    x: Any,
    acc: Any,
    steps: Any,
) -> None:
    """Steps of the nodes at walls from the first to the last of them in a sweep over nodes.

    Parameters
    ----------
    first, last : int
        In `nodes`: those of one colour.
    nodes, offsets, normals, targets, stiffness, two_sided, free
        See `WallData`.
    weights, centers, loads, x, acc
        See `move_kernels.find_steps`, which empties the accumulator.
    steps : (n, 3)
        Steps of `nodes` [m].
    """
    for j in prange(last - first):
        i = first + j
        p, o, w = 3 * nodes[i], 9 * nodes[i], weights[nodes[i]]
        z = (x[p], x[p + 1], x[p + 2])
        s = settle_at_walls(
            (
                acc[o] + loads[p] + w * (centers[p] - z[0]),
                acc[o + 1] + loads[p + 1] + w * (centers[p + 1] - z[1]),
                acc[o + 2] + loads[p + 2] + w * (centers[p + 2] - z[2]),
                acc[o + 3] + w,
                acc[o + 4] + w,
                acc[o + 5] + w,
                acc[o + 6],
                acc[o + 7],
                acc[o + 8],
            ),
            z,
            free[i, 0] != 0,
            free[i, 1] != 0,
            free[i, 2] != 0,
            offsets[i],
            offsets[i + 1],
            normals,
            targets,
            stiffness,
            two_sided,
        )
        for k in range(3):
            steps[i, k] = s[k]


@njit(parallel=True)
def touch_walls(
    nodes: Any,
    offsets: Any,
    normals: Any,
    targets: Any,
    stiffness: Any,
    two_sided: Any,
    blend: Any,
    has_base: Any,
    h2: Any,
    free: Any,
    stride: Any,
    x: Any,
    forces: Any,
) -> None:
    """Let nodes at walls find where inertia and walls balance; the parameters are those of `touch_obstacles`.

    As there the force of the walls is the multiplier of the node: without it the node would be at ``x - w h^2 f``, and
    with the base point, which f is part of, at ``b - w h^2 f``; the two are blended. The energy of walls is piecewise
    quadratic and convex: Newton's method ends where the set of rows that act stays.
    """
    for i in prange(nodes.size):
        p = stride * nodes[i]
        w = x[p + 3]
        if w == 0.0:
            continue
        m = 1.0 / (w * h2)
        y0, y1, y2 = x[p] - forces[i, 0] / m, x[p + 1] - forces[i, 1] / m, x[p + 2] - forces[i, 2] / m
        if has_base:
            y0 = blend * y0 + (1.0 - blend) * (x[p + 4] - forces[i, 0] / m)
            y1 = blend * y1 + (1.0 - blend) * (x[p + 5] - forces[i, 1] / m)
            y2 = blend * y2 + (1.0 - blend) * (x[p + 6] - forces[i, 2] / m)
        z0, z1, z2 = x[p], x[p + 1], x[p + 2]
        s = settle_at_walls(
            (m * (y0 - z0), m * (y1 - z1), m * (y2 - z2), m, m, m, 0.0 * m, 0.0 * m, 0.0 * m),
            (z0, z1, z2),
            free[i, 0] != 0,
            free[i, 1] != 0,
            free[i, 2] != 0,
            offsets[i],
            offsets[i + 1],
            normals,
            targets,
            stiffness,
            two_sided,
        )
        reached, wanted = (z0 + s[0], z1 + s[1], z2 + s[2]), (y0, y1, y2)
        for k in range(3):
            if free[i, k] != 0:
                force = m * (reached[k] - wanted[k])
                x[p + k] = reached[k]
                if has_base:
                    x[p + 4 + k] += (force - forces[i, k]) / m
                forces[i, k] = force
