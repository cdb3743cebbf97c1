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
        before = -1
        for _ in range(_STEPS):
            f0, f1, f2 = m * (y0 - z0), m * (y1 - z1), m * (y2 - z2)
            a0, a1, a2 = m, m, m
            a3 = a4 = a5 = 0.0 * m
            acting, bit = 0, 1
            for r in range(offsets[i], offsets[i + 1]):
                n0, n1, n2 = normals[r, 0], normals[r, 1], normals[r, 2]
                gap = n0 * z0 + n1 * z1 + n2 * z2 - targets[r]
                if two_sided or gap <= 0.0:
                    k = stiffness[r]
                    f0 -= k * gap * n0
                    f1 -= k * gap * n1
                    f2 -= k * gap * n2
                    a0 += k * n0 * n0
                    a1 += k * n1 * n1
                    a2 += k * n2 * n2
                    a3 += k * n1 * n2
                    a4 += k * n0 * n2
                    a5 += k * n0 * n1
                    acting += bit
                bit *= 2
            if acting == before:
                break
            before = acting
            s = solve_masked((f0, f1, f2, a0, a1, a2, a3, a4, a5), free[i, 0] != 0, free[i, 1] != 0, free[i, 2] != 0)
            z0, z1, z2 = z0 + s[0], z1 + s[1], z2 + s[2]
        reached, wanted = (z0, z1, z2), (y0, y1, y2)
        for k in range(3):
            if free[i, k] != 0:
                force = m * (reached[k] - wanted[k])
                x[p + k] = reached[k]
                if has_base:
                    x[p + 4 + k] += (force - forces[i, k]) / m
                forces[i, k] = force
