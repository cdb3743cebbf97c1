"""Compiled loops that number the nodes of stencils and list the points of each node.

Lists are made by counting in a fixed number of parts of the points: each part counts its entries at every node, places
follow from sums in the order of the parts, each part then fills its own. No two threads write to one place, and lists
are in ascending order, whatever the number of threads.
"""

from __future__ import annotations

from typing import Any

from femdeform.jit import njit, prange


@njit(parallel=True)
def node_numbers(cell_nodes: Any, cell_of_point: Any, weights: Any, out: Any) -> None:
    """Numbers of the nodes of each point, by the cell it lies in; 0 where the weight is.

    Parameters
    ----------
    cell_nodes : (n_cells, n_stencil) int32
        Numbers of the nodes around each occupied cell.
    cell_of_point : (n_points,) int32
        Number of each point's cell.
    weights : (n_points, n_stencil)
        Weights.
    out : (n_points, n_stencil) int32
        Result.
    """
    for p in prange(out.shape[0]):
        cell = cell_of_point[p]
        for k in range(out.shape[1]):
            out[p, k] = cell_nodes[cell, k] if weights[p, k] > 0.0 else 0


@njit(parallel=True)
def renumber(numbers: Any, weights: Any, nodes: Any) -> None:
    """Replace the nodes of points (n_points, n_stencil) by their new numbers; 0 where the weight is."""
    for p in prange(nodes.shape[0]):
        for k in range(nodes.shape[1]):
            nodes[p, k] = numbers[nodes[p, k]] if weights[p, k] > 0.0 else 0


@njit(parallel=True)
def count_entries(nodes: Any, weights: Any, counts: Any) -> None:
    """Number of entries with a weight of each part of the points at each node: counts (n_parts, n_nodes)."""
    n, n_parts = nodes.shape[0], counts.shape[0]
    for part in prange(n_parts):
        counts[part, :] = 0
        for p in range(part * n // n_parts, (part + 1) * n // n_parts):
            for k in range(nodes.shape[1]):
                if weights[p, k] > 0.0:
                    counts[part, nodes[p, k]] += 1


@njit(parallel=True)
def first_entries(offsets: Any, counts: Any) -> None:
    """Turn counts (n_parts, n_nodes) into the place of each part's first entry, after the `offsets` of the nodes."""
    for i in prange(counts.shape[1]):
        at = offsets[i]
        for part in range(counts.shape[0]):
            n = counts[part, i]
            counts[part, i] = at
            at += n


@njit(parallel=True)
def fill_entries(nodes: Any, weights: Any, places: Any, entries: Any) -> None:
    """Write entries ``point n_stencil + place`` from the first places (n_parts, n_nodes) on, which are moved along."""
    n, size, n_parts = nodes.shape[0], nodes.shape[1], places.shape[0]
    for part in prange(n_parts):
        for p in range(part * n // n_parts, (part + 1) * n // n_parts):
            for k in range(size):
                if weights[p, k] > 0.0:
                    i = nodes[p, k]
                    entries[places[part, i]] = p * size + k
                    places[part, i] += 1


@njit(parallel=True)
def count_below(offsets: Any, entries: Any, bound: Any, out: Any) -> None:
    """Number of entries of each node below a bound, of lists that ascend."""
    for i in prange(out.shape[0]):
        low, high = offsets[i], offsets[i + 1]
        while low < high:
            middle = (low + high) // 2
            if entries[middle] < bound:
                low = middle + 1
            else:
                high = middle
        out[i] = low - offsets[i]


@njit(parallel=True)
def copy_entries(kept: Any, offsets: Any, entries: Any, new_offsets: Any, out: Any) -> None:
    """Copy the first entries of the nodes `kept`, as many as the new offsets have room for."""
    for i in prange(kept.shape[0]):
        at = offsets[kept[i]]
        for t in range(new_offsets[i], new_offsets[i + 1]):
            out[t] = entries[at + t - new_offsets[i]]
