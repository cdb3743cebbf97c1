"""Compiled loops of the explicit step with stored stencils: stresses, their forces at the nodes, deformations.

As in `mpm.kernels` nodes read their points through a fixed list: no two threads write to one place.
"""

from __future__ import annotations

from typing import Any

from femdeform.jit import njit, prange
from femdeform.mpm.explicit_laws import deform_2d, deform_3d, stress_2d, stress_3d


@njit(parallel=True)
def stresses_3d(state: Any, volume: Any, gradient: Any, law: Any, rows: Any, out: Any) -> None:
    """``V0 P F^T`` [J] of the points `rows` into `out` (n, 6): xx, yy, zz, yz, xz, xy."""
    for t in prange(rows.size):
        p = rows[t]
        tau = stress_3d(state, p, gradient, law)
        for c in range(6):
            out[p, c] = volume[p] * tau[c]


@njit(parallel=True)
def stresses_2d(state: Any, volume: Any, gradient: Any, law: Any, rows: Any, out: Any) -> None:
    """``V0 P F^T`` [J] of the points `rows` into `out` (n, 3): xx, yy, xy."""
    for t in prange(rows.size):
        p = rows[t]
        tau = stress_2d(state, p, gradient, law)
        for c in range(3):
            out[p, c] = volume[p] * tau[c]


@njit(parallel=True)
def stress_forces_3d(stress: Any, point: Any, gradients: Any, offsets: Any, entries: Any, out: Any) -> None:
    """Forces at the nodes [N]: ``f_i = -sum_p V0 P F^T grad N_i(x_p)``.

    Parameters
    ----------
    stress : (n_points, 6)
        See `stresses_3d`.
    point : (n_members,) int64
        Point whose place each member of the groups has, -1 for the members at samples.
    gradients : (n_members, n_stencil, 3)
        [1/m].
    offsets, entries
        Members of each node, see `Stencils`.
    out : (n_nodes, 3)
        Result.
    """
    size = gradients.shape[1]
    for i in prange(out.shape[0]):
        f0 = f1 = f2 = 0.0
        for t in range(offsets[i], offsets[i + 1]):
            k = entries[t] // size
            p = point[k]
            if p < 0:
                continue
            j = entries[t] - k * size
            g0, g1, g2 = gradients[k, j, 0], gradients[k, j, 1], gradients[k, j, 2]
            f0 -= stress[p, 0] * g0 + stress[p, 5] * g1 + stress[p, 4] * g2
            f1 -= stress[p, 5] * g0 + stress[p, 1] * g1 + stress[p, 3] * g2
            f2 -= stress[p, 4] * g0 + stress[p, 3] * g1 + stress[p, 2] * g2
        out[i, 0], out[i, 1], out[i, 2] = f0, f1, f2


@njit(parallel=True)
def stress_forces_2d(stress: Any, point: Any, gradients: Any, offsets: Any, entries: Any, out: Any) -> None:
    """Forces at the nodes; see `stress_forces_3d`."""
    size = gradients.shape[1]
    for i in prange(out.shape[0]):
        f0 = f1 = 0.0
        for t in range(offsets[i], offsets[i + 1]):
            k = entries[t] // size
            p = point[k]
            if p < 0:
                continue
            j = entries[t] - k * size
            g0, g1 = gradients[k, j, 0], gradients[k, j, 1]
            f0 -= stress[p, 0] * g0 + stress[p, 2] * g1
            f1 -= stress[p, 2] * g0 + stress[p, 1] * g1
        out[i, 0], out[i, 1] = f0, f1


@njit(parallel=True)
def velocity_gradients(velocity: Any, nodes: Any, gradients: Any, members: Any, out: Any) -> None:
    """``sum_i v_i grad N_i^T`` at some members, (n, dim, dim) [1/s]."""
    dim = velocity.shape[1]
    for p in prange(members.size):
        k = members[p]
        for a in range(dim):
            for b in range(dim):
                s = 0.0
                for j in range(nodes.shape[1]):
                    s += velocity[nodes[k, j], a] * gradients[k, j, b]
                out[p, a, b] = s


@njit(parallel=True)
def deform_points_3d(state: Any, gradient: Any, dt: Any, law: Any, rows: Any, bounded: Any) -> None:
    """Deform the points `rows` by gradients of velocity (n, 3, 3); `bounded` (rows,) gets 1 where J met its bounds."""
    for t in prange(rows.size):
        p = rows[t]
        L = (
            gradient[p, 0, 0],
            gradient[p, 0, 1],
            gradient[p, 0, 2],
            gradient[p, 1, 0],
            gradient[p, 1, 1],
            gradient[p, 1, 2],
            gradient[p, 2, 0],
            gradient[p, 2, 1],
            gradient[p, 2, 2],
        )
        bounded[t] = deform_3d(state, p, L, dt, law)


@njit(parallel=True)
def deform_points_2d(state: Any, gradient: Any, dt: Any, law: Any, rows: Any, bounded: Any) -> None:
    """Deform the points `rows`; see `deform_points_3d`."""
    for t in prange(rows.size):
        p = rows[t]
        L = (gradient[p, 0, 0], gradient[p, 0, 1], gradient[p, 1, 0], gradient[p, 1, 1])
        bounded[t] = deform_2d(state, p, L, dt, law)
