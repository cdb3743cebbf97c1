"""Data of a node-wise sweep, laid out in the order in which it is read.

Nodes are renumbered by colour and, inside a colour, along a space-filling curve: a thread walks through space and
finds the neighbours of its nodes, of all colours, where it has just been. What a visit of a node to one of its cells
needs (the other nodes, gradients, volume) is stored once per visit, in the order of the visits, so that the sweep
streams it.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.counting_sort import sort_by_number
from femdeform.step_problem import LocalCells
from femdeform.types import BoolArray, FloatArray, IntArray

# Visits of a piece of work that one thread takes at a time.
_CHUNK_VISITS = 2048
# Visits, or cells, that are laid out at a time.
_BATCH = 1 << 20

Indices = np.ndarray[Any, np.dtype[np.uint32]]


def morton_keys(points: FloatArray) -> np.ndarray[Any, np.dtype[np.uint64]]:
    """Position of each point (n, dim) along the Z-order curve through a grid of 2^20 (3D) or 2^31 (2D) cells a side."""
    dim = points.shape[1]
    bits = 20 if dim == 3 else 31
    low = points.min(axis=0)
    size = float((points.max(axis=0) - low).max()) or 1.0
    place = ((points - low) / size * (2**bits - 1)).astype(np.uint64)
    keys = np.zeros(len(points), dtype=np.uint64)
    for bit in range(bits):
        for axis in range(dim):
            keys |= ((place[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(dim * bit + axis)
    return keys


@dataclass(frozen=True)
class Numbering:
    """The order in which nodes are swept.

    Attributes
    ----------
    order : (n_nodes,) int64
        Node of the problem at each place; nodes that never move come last.
    place : (n_nodes,) int64
        Place of each node of the problem.
    color_offsets : (n_colors + 1,) int64
        First place of each colour; the last entry is the number of nodes that move.
    """

    order: IntArray
    place: IntArray
    color_offsets: IntArray

    @property
    def n_colors(self) -> int:
        """Number of colours."""
        return self.color_offsets.size - 1


def number_nodes(points: FloatArray, colors: IntArray, moves: BoolArray) -> Numbering:
    """Order nodes by colour, then along a Z-order curve.

    Parameters
    ----------
    points : (n_nodes, dim) float64
        Reference positions [m].
    colors : (n_nodes,) int64
        Colours from 0.
    moves : (n_nodes,) bool
        Nodes with a free component.
    """
    n_colors = int(colors.max()) + 1 if colors.size else 0
    sort_color = np.where(moves, colors, n_colors)
    order = np.lexsort((morton_keys(points), sort_color))
    place = np.empty_like(order)
    place[order] = np.arange(order.size)
    counts = np.bincount(sort_color, minlength=n_colors + 1)[:n_colors]
    counts = counts[counts > 0]
    return Numbering(order, place, np.concatenate([[0], np.cumsum(counts)]).astype(np.int64))


@dataclass(frozen=True)
class Visits:
    """Visits of moving nodes to the cells of one law, node by node in the order of the sweep.

    Attributes
    ----------
    law : NamedTuple
        The law, in the precision of the arrays.
    nodes : (n_rows,) uint32
        Places of the nodes that have such cells, ascending.
    offsets : (n_rows + 1,) int64
        First visit of each of these nodes.
    chunks : list of (n_chunks + 1,) int64
        For each colour the rows at which pieces of work begin, of about equal numbers of visits, whatever the number of
        threads.
    others : (dim, n_visits) uint32
        Three times the places of the other nodes of the cell, ordered so that their volume is positive.
    gradients : (dim * n_components, n_visits)
        grad N of the node and of the others but the last, row by row [1/m]; (dim * n_components, 0) where they are not
        wanted.
    volumes : (n_visits,)
        Rest volume of the cell [m^3].
    """

    law: Any
    nodes: Indices
    offsets: IntArray
    chunks: list[IntArray]
    others: Indices
    gradients: FloatArray
    volumes: FloatArray


# The other nodes of a simplex for each of its nodes, in an order that keeps the orientation.
_OTHERS = {3: np.array([[1, 2], [2, 0], [0, 1]]), 4: np.array([[1, 3, 2], [0, 2, 3], [0, 3, 1], [0, 1, 2]])}


def list_visits(cells: LocalCells, numbering: Numbering, dtype: Any, with_gradients: bool = True) -> Visits:
    """Lay out the visits to the cells of one law in one precision, the gradients left empty if not wanted.

    Gradients may have any number of components.
    """
    from femdeform.materials import with_precision

    n_corners = cells.cells.shape[1]
    dim = n_corners - 1
    corners = numbering.place.astype(np.uint32)[cells.cells]
    entries, starts = sort_by_number(corners.ravel(), numbering.order.size)
    # Nodes that never move come last, and so do their visits.
    starts = starts[: int(numbering.color_offsets[-1]) + 1]
    visits = entries[: starts[-1]]
    nodes = np.flatnonzero(np.diff(starts))
    offsets = np.append(starts[nodes], starts[-1]).astype(np.int64)
    others = np.empty((dim, visits.size), dtype=np.uint32)
    n_components = cells.gradients.shape[2]
    gradients = np.empty((dim * n_components, visits.size if with_gradients else 0), dtype=dtype)
    volumes = np.empty(visits.size, dtype=dtype)
    for first in range(0, visits.size, _BATCH):
        part = slice(first, min(first + _BATCH, visits.size))
        cell, corner = visits[part] // n_corners, visits[part] % n_corners
        other = _OTHERS[n_corners][corner]
        others[:, part] = 3 * corners[cell[:, None], other].T
        volumes[part] = cells.volumes[cell]
        if with_gradients:
            kept = np.concatenate([corner[:, None], other[:, :-1]], axis=1)
            gradients[:, part] = cells.gradients[cell[:, None], kept].reshape(-1, dim * n_components).T
    rows = np.searchsorted(nodes, numbering.color_offsets)
    return Visits(
        with_precision(cells.law, dtype),
        nodes.astype(np.uint32),
        offsets,
        [split(offsets, int(a), int(b)) for a, b in itertools.pairwise(rows)],
        others,
        gradients,
        volumes,
    )


def split(offsets: IntArray, first: int, last: int) -> IntArray:
    """Rows at which pieces of about `_CHUNK_VISITS` visits begin, with the end."""
    visits = int(offsets[last] - offsets[first])
    pieces = max(1, -(-visits // _CHUNK_VISITS))
    wanted = offsets[first] + visits * np.arange(pieces + 1) / pieces
    cuts = first + np.searchsorted(offsets[first : last + 1], wanted, side="left")
    cuts[0], cuts[-1] = first, last
    return np.unique(cuts)


@dataclass(frozen=True)
class Stencil:
    """The graph Laplacian of the cells of one law at the nodes that move, `sum_e V grad N_a . grad N_b`.

    Attributes
    ----------
    offsets : (n_rows + 1,) int64
        First neighbour of each row of `Visits.nodes`.
    neighbours : (n,) uint32
        Three times the places of the neighbours.
    weights : (n,)
        Off-diagonal entries with the sign turned [m].
    diagonal : (n_rows,)
        Diagonal entries [m].
    """

    offsets: IntArray
    neighbours: Indices
    weights: FloatArray
    diagonal: FloatArray


def laplacian(cells: LocalCells, numbering: Numbering, nodes: Indices, dtype: Any) -> Stencil:
    """Sum the Laplacian of a law's cells; `nodes` are the rows of its `Visits`."""
    import scipy.sparse

    place = numbering.place.astype(np.int32)
    n = numbering.order.size
    matrix = scipy.sparse.csr_matrix((n, n))
    for first in range(0, len(cells.cells), _BATCH):
        part = slice(first, first + _BATCH)
        blocks = np.einsum("e,eai,ebi->eab", cells.volumes[part], cells.gradients[part], cells.gradients[part])
        corners = place[cells.cells[part]]
        rows = np.broadcast_to(corners[:, :, None], blocks.shape).ravel()
        columns = np.broadcast_to(corners[:, None, :], blocks.shape).ravel()
        some = scipy.sparse.csr_matrix((blocks.ravel(), (rows, columns)), shape=(n, n))
        matrix = some if first == 0 else matrix + some
    diagonal = matrix.diagonal()[nodes]
    matrix.setdiag(0.0)
    matrix.sum_duplicates()
    matrix = matrix[nodes]
    matrix.eliminate_zeros()
    matrix.sort_indices()
    return Stencil(
        matrix.indptr.astype(np.int64),
        (3 * matrix.indices.astype(np.int64)).astype(np.uint32),
        (-matrix.data).astype(dtype),
        diagonal.astype(dtype),
    )
