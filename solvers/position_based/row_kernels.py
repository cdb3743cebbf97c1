"""Weak constraints in a sweep over nodes: what the rows of a node add to its force and matrix."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.contact.weak_constraints import WeakConstraints
from femdeform.jit import njit, prange
from femdeform.types import FloatArray, IntArray

# Nodes that one thread takes at a time.
_CHUNK = 128


@dataclass
class RowData:
    """Rows as a sweep reads them; vectors have three components, with zeros across the plane in 2D.

    Attributes
    ----------
    nodes : (n_held,) int64
        Places of the nodes that move and are in rows, ascending.
    node_offsets, node_rows, node_weights
        Rows of each of these nodes and its weights there [-].
    row_offsets, row_places, row_weights
        Three times the places of the nodes of each row, and their weights [-].
    lengths : (n_rows,)
        Lengths without force of springs, 0 for linear rows [m].
    stiffness : (n_rows, 3, 3)
        K [N/m] of the step begun.
    targets : (n_rows, 3)
        Places of C without force at the end of the step [m].
    """

    nodes: IntArray
    node_offsets: IntArray
    node_rows: IntArray
    node_weights: FloatArray
    row_offsets: IntArray
    row_places: IntArray
    row_weights: FloatArray
    lengths: FloatArray
    stiffness: FloatArray
    targets: FloatArray

    def begin_step(self, links: WeakConstraints) -> None:
        """Take over what the step begun has frozen."""
        dim = links.dim
        self.stiffness[:, :dim, :dim] = links.stiffness
        self.targets[:, :dim] = links.target


def lay_out(links: WeakConstraints, place: IntArray, n_moving: int, dtype: Any) -> RowData:
    """Rows by the places of nodes.

    Parameters
    ----------
    links : WeakConstraints
        All rows.
    place : (n_nodes,) int64
        Place of each node in the sweep.
    n_moving : int
        Nodes that move; they have the first places.
    dtype : numpy type
        float64 or float32.
    """
    offsets, constraints, weights = links.by_node(place.size)
    counts = np.diff(offsets)
    held = np.flatnonzero((counts > 0) & (place < n_moving))
    held = held[np.argsort(place[held])]
    starts = np.concatenate([[0], np.cumsum(counts[held])]).astype(np.int64)
    entries = np.repeat(offsets[:-1][held] - starts[:-1], counts[held]) + np.arange(starts[-1])
    rows = links.rows
    return RowData(
        place[held],
        starts,
        constraints[entries],
        weights[entries].astype(dtype),
        rows.offsets,
        3 * place[rows.nodes],
        rows.weights.astype(dtype),
        rows.length.astype(dtype),
        np.zeros((rows.n_rows, 3, 3), dtype=dtype),
        np.zeros((rows.n_rows, 3), dtype=dtype),
    )


@njit(parallel=True)
def add_rows(
    first: Any,
    last: Any,
    nodes: Any,
    node_offsets: Any,
    node_rows: Any,
    node_weights: Any,
    row_offsets: Any,
    row_places: Any,
    row_weights: Any,
    lengths: Any,
    stiffness: Any,
    targets: Any,
    x: Any,
    acc: Any,
) -> None:
    """Add forces ``-w K C`` and matrices ``w^2 K`` of the held nodes from first to last; see `RowData`.

    Springs with a length have the force ``-w k (1 - L/|C|) C`` and the matrix ``w^2 k I``: no less bounds their energy
    for every step, since ``| |C| - L | <= |C - L n|`` for any unit vector n.
    """
    for c in prange((last - first + _CHUNK - 1) // _CHUNK):
        for h in range(first + c * _CHUNK, min(first + (c + 1) * _CHUNK, last)):
            o = 9 * nodes[h]
            for e in range(node_offsets[h], node_offsets[h + 1]):
                r, w = node_rows[e], node_weights[e]
                c0, c1, c2 = -targets[r, 0], -targets[r, 1], -targets[r, 2]
                for k in range(row_offsets[r], row_offsets[r + 1]):
                    p, v = row_places[k], row_weights[k]
                    c0 += v * x[p]
                    c1 += v * x[p + 1]
                    c2 += v * x[p + 2]
                K = stiffness[r]
                pull = w
                if lengths[r] > 0.0:
                    size = math.sqrt(c0 * c0 + c1 * c1 + c2 * c2)
                    pull = w * (1.0 - lengths[r] / size) if size > 0.0 else 0.0 * w
                acc[o] -= pull * (K[0, 0] * c0 + K[0, 1] * c1 + K[0, 2] * c2)
                acc[o + 1] -= pull * (K[1, 0] * c0 + K[1, 1] * c1 + K[1, 2] * c2)
                acc[o + 2] -= pull * (K[2, 0] * c0 + K[2, 1] * c1 + K[2, 2] * c2)
                acc[o + 3] += w * w * K[0, 0]
                acc[o + 4] += w * w * K[1, 1]
                acc[o + 5] += w * w * K[2, 2]
                acc[o + 6] += w * w * K[1, 2]
                acc[o + 7] += w * w * K[0, 2]
                acc[o + 8] += w * w * K[0, 1]
