"""Compiled loops of the implicit step that go through the cells of points: forces, and products with the Hessian.

Points of one cell have the same nodes, so their forces are summed up there first, in a few lines of fast memory; the
nodes gather the sums of the cells around them, in a fixed order: no two threads write to one place. Each point's
gradients are read once in a product. The notation is that of `mpm.point_kernels`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.fem.kernels import deformation_gradient
from femdeform.jit import njit, prange

# Cells that one thread takes at a time.
CHUNK = 16


@njit
def _add_forces(P: Any, gradients: Any, q: Any, dim: Any, stencil: Any, out: Any) -> None:
    """``out_k += P G_qk`` at the nodes of a point; P (dim^2,), out (n_stencil, dim)."""
    d = len(dim)
    for k in range(len(stencil)):
        for c in range(d):
            s = 0.0
            for b in range(d):
                s += P[d * c + b] * gradients[q, 0, k, b]
            out[k, c] += s


@njit(parallel=True)
def forces(P: Any, gradients: Any, cells: Any, points: Any, dim: Any, stencil: Any, out: Any) -> None:
    """Forces of the points of each cell at its nodes [N]: ``out_ck = sum_q P_q G_qk``.

    Parameters
    ----------
    P : (n_points, dim^2)
        Stresses times volumes [J].
    gradients : (n_points, 1, n_stencil, dim)
        [1/m].
    cells, points
        First point of each cell, (n_cells + 1,), in the list of points, (n_points,).
    dim, stencil : tuple
        Their lengths are the dimension and the number of nodes of a point.
    out : (n_cells, n_stencil, dim)
        Result.
    """
    n = out.shape[0]
    for chunk in prange((n + CHUNK - 1) // CHUNK):
        for cell in range(chunk * CHUNK, min((chunk + 1) * CHUNK, n)):
            out[cell] = 0.0
            for t in range(cells[cell], cells[cell + 1]):
                q = points[t]
                _add_forces(P[q], gradients, q, dim, stencil, out[cell])


@njit(parallel=True)
def products(
    u: Any,
    nodes: Any,
    gradients: Any,
    cells: Any,
    points: Any,
    place: Any,
    tangents: Any,
    alpha: Any,
    beta: Any,
    dim: Any,
    stencil: Any,
    out: Any,
) -> None:
    """``out_ck = sum_q (C_q : D_q) G_qk`` over the points of each cell, with the D that displacements u make.

    Parameters
    ----------
    u : (n_nodes, dim)
        Displacements [m].
    nodes : (n_points, n_stencil)
        Nodes of each point.
    gradients, cells, points, dim, stencil, out
        See `forces`.
    place, tangents, alpha, beta
        Tangents of the points, see `femdeform.mpm.point_kernels.assemble`.
    """
    d, n = len(dim), out.shape[0]
    for chunk in prange((n + CHUNK - 1) // CHUNK):
        D, P = np.empty(d * d), np.empty(d * d)
        for cell in range(chunk * CHUNK, min((chunk + 1) * CHUNK, n)):
            out[cell] = 0.0
            for t in range(cells[cell], cells[cell + 1]):
                q = points[t]
                F = deformation_gradient(u, nodes, gradients, q, 0, dim, stencil)
                for j in range(d * d):
                    D[j] = F[j]
                if place[q] >= 0:
                    C = tangents[place[q]]
                    for i in range(d * d):
                        s = 0.0
                        for j in range(d * d):
                            s += C[i, j] * D[j]
                        P[i] = s
                else:
                    trace = 0.0
                    for c in range(d):
                        trace += D[(d + 1) * c]
                    for c in range(d):
                        for b in range(d):
                            P[d * c + b] = 0.5 * beta[q] * (D[d * c + b] + D[d * b + c])
                        P[(d + 1) * c] += alpha[q] * trace
                _add_forces(P, gradients, q, dim, stencil, out[cell])


@njit(parallel=True)
def gather(at_cells: Any, offsets: Any, entries: Any, out: Any) -> None:
    """Sum at each node what its cells have for it.

    Parameters
    ----------
    at_cells : (n_cells n_stencil, dim)
        What cells have for their nodes.
    offsets, entries
        Rows of `at_cells` of each node.
    out : (n_nodes, dim)
        Result.
    """
    for i in prange(out.shape[0]):
        for c in range(out.shape[1]):
            out[i, c] = 0.0
        for t in range(offsets[i], offsets[i + 1]):
            for c in range(out.shape[1]):
                out[i, c] += at_cells[entries[t], c]
