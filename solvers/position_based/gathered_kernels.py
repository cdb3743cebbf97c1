"""Kernels of a sweep over nodes that share cells with many others: the deformation of cells is kept and carried along.

Nodes of one colour share no cell: each thread changes the deformations of the cells of its own nodes only.
"""

from __future__ import annotations

from typing import Any

from femdeform.jit import njit, prange
from solvers.position_based.cell_algebra import store
from solvers.position_based.cell_corners import deformation

# Cells that one thread takes at a time.
_CHUNK = 64


@njit(parallel=True)
def deform_cells(corners: Any, gradients: Any, dim: Any, x: Any, deformations: Any) -> None:
    """F of all cells from the positions.

    Parameters
    ----------
    corners : GatheredCorners
        Three numbers a node.
    gradients : (n_entries, dim)
        [1/m].
    dim : tuple
        Its length is the dimension.
    x : (3 n_nodes,)
        Positions [m].
    deformations : (n_cells, dim dim)
        Written.
    """
    n = deformations.shape[0]
    for c in prange((n + _CHUNK - 1) // _CHUNK):
        for e in range(c * _CHUNK, min((c + 1) * _CHUNK, n)):
            store(e, deformation(e, 0, corners, gradients, dim, x), deformations)


@njit(parallel=True)
def carry_cells(
    chunks: Any, nodes: Any, offsets: Any, visits: Any, gradients: Any, dim: Any, parts: Any, steps: Any
) -> None:
    """Add to the deformations what the steps of the nodes of one colour change, ``F += t s n^T``.

    Parameters
    ----------
    chunks, nodes, offsets
        See `layout.Visits`.
    visits : StoredVisits
        Its deformations are changed.
    gradients : (dim, n_visits)
        Of the visiting node [1/m].
    dim : tuple
        Its length is the dimension.
    parts, steps : (n_nodes,), (3 n_nodes,)
        Part of each step that is taken, and steps [m].
    """
    d = len(dim)
    F = visits.deformations
    for c in prange(chunks.size - 1):
        for r in range(chunks[c], chunks[c + 1]):
            i = nodes[r]
            for v in range(offsets[r], offsets[r + 1]):
                e = visits.cells[v]
                for a in range(d):
                    s = parts[i] * steps[3 * i + a]
                    for b in range(d):
                        F[e, d * a + b] += s * gradients[b, v]
