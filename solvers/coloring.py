"""Colours for Gauss-Seidel sweeps: items that share a set differ, so that those of one colour can move at once.

The items are nodes and the sets cells (a node moves with its cells read), or the other way round (a constraint on a
cell moves its nodes); pairs and other couplings are further sets. Colours are chosen greedily, the smallest free one
in the given order: the same colours on every machine and for any number of threads.

References
----------
J. Chen, dissertation (2024), sections 5.2.4 and 6.7, with the correction that an item's own colour is taken out of its
sets before it is coloured anew.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.counting_sort import sort_by_number
from femdeform.jit import njit
from femdeform.types import BoolArray, IntArray


@dataclass(frozen=True)
class Incidence:
    """Which items are in which sets, both ways.

    Attributes
    ----------
    set_offsets, set_items : (n_sets + 1,), (n,) int64
        Items of each set.
    item_offsets, item_sets : (n_items + 1,), (n,) int64
        Sets of each item, ascending.
    """

    set_offsets: IntArray
    set_items: IntArray
    item_offsets: IntArray
    item_sets: IntArray

    @property
    def n_items(self) -> int:
        """Number of items."""
        return self.item_offsets.size - 1

    def transposed(self) -> Incidence:
        """The same with items and sets exchanged: from the colouring of nodes to that of cells."""
        return Incidence(self.item_offsets, self.item_sets, self.set_offsets, self.set_items)


def incidence(parts: list[np.ndarray[Any, Any]], n_items: int) -> Incidence:
    """Sets given as rows of items.

    Parameters
    ----------
    parts : list of (n_sets_k, size_k) integer arrays
        Cells of several kinds, pairs of nodes, ...; sets are numbered through the parts.
    n_items : int
        Number of items.
    """
    starts = [np.zeros(1, dtype=np.int64)]
    items: list[np.ndarray[Any, Any]] = [np.empty(0, dtype=np.int64)]
    total = 0
    for part in parts:
        starts.append(total + part.shape[1] * np.arange(1, len(part) + 1, dtype=np.int64))
        items.append(part.ravel())
        total += part.size
    set_offsets, set_items = np.concatenate(starts), np.concatenate(items).astype(np.int64, copy=False)
    entries, item_offsets = sort_by_number(set_items, n_items)
    item_sets = np.repeat(np.arange(set_offsets.size - 1), np.diff(set_offsets))[entries]
    return Incidence(set_offsets, set_items, item_offsets.astype(np.int64), item_sets)


def moving_sets(parts: list[np.ndarray[Any, Any]], moves: BoolArray) -> Incidence:
    """As `incidence`, but what never moves is in no two sets: it is read at the same time.

    Parameters
    ----------
    parts : list of (n_sets_k, size_k) integer arrays
        See `incidence`.
    moves : (n_items,) bool
        Items that move.
    """
    fresh = moves.size
    own = []
    for part in parts:
        rows = part.astype(np.int64)
        still = ~moves[rows]
        count = int(np.count_nonzero(still))
        rows[still] = fresh + np.arange(count)
        fresh += count
        own.append(rows)
    return incidence(own, fresh)


def color(graph: Incidence) -> IntArray:
    """Colour all items in the order of their numbers.

    Parameters
    ----------
    graph : Incidence
        Items and their sets.

    Returns
    -------
    (n_items,) int64
        Colours from 0; no two items of one set have the same.
    """
    colors = np.full(graph.n_items, -1, dtype=np.int64)
    _assign(np.arange(graph.n_items), graph.set_offsets, graph.set_items, graph.item_offsets, graph.item_sets, colors)
    return colors


def recolor(graph: Incidence, colors: IntArray, touched: IntArray) -> IntArray:
    """Mend a colouring after sets were added: only touched items may change (section 6.7.1).

    Parameters
    ----------
    graph : Incidence
        With the new sets.
    colors : (n_items,) int64
        Colours that are valid without them; -1 where an item has none yet.
    touched : (n,) int64
        Items of the new sets, each once. They are looked at in this order: one keeps its colour where no other item of
        its sets has it, and takes the smallest free one else.

    Returns
    -------
    (n_items,) int64
        A valid colouring.
    """
    mended = colors.copy()
    _assign(touched, graph.set_offsets, graph.set_items, graph.item_offsets, graph.item_sets, mended)
    return mended


@njit
def _assign(items: Any, set_offsets: Any, set_items: Any, item_offsets: Any, item_sets: Any, colors: Any) -> None:
    """Give each of the items its colour, or the smallest that no other item of its sets has."""
    most = 0
    for i in range(item_offsets.size - 1):
        count = 0
        for s in range(item_offsets[i], item_offsets[i + 1]):
            count += set_offsets[item_sets[s] + 1] - set_offsets[item_sets[s]] - 1
        most = max(most, count)
    # An item with `most` neighbours finds a free colour among most + 1; colours of an earlier colouring may be higher.
    taken = np.full(max(most + 1, colors.max() + 1 if colors.size else 0) + 1, -1, dtype=np.int64)
    for n in range(items.size):
        i = items[n]
        for s in range(item_offsets[i], item_offsets[i + 1]):
            for k in range(set_offsets[item_sets[s]], set_offsets[item_sets[s] + 1]):
                other = set_items[k]
                if other != i and colors[other] >= 0:
                    taken[colors[other]] = i
        if colors[i] >= 0 and taken[colors[i]] != i:
            continue
        c = 0
        while taken[c] == i:
            c += 1
        colors[i] = c


def color_cells(offsets: IntArray, nodes: np.ndarray[Any, Any], n_nodes: int, previous: IntArray | None) -> IntArray:
    """Colour cells so that no two of one colour share a node, from the colours of an earlier step (appendix C).

    For cells of many nodes each: what colours are taken is kept per node, as bits. Cells whose earlier colour is free
    keep it, in the order of their numbers; then the others take the smallest free one.

    Parameters
    ----------
    offsets, nodes : (n_cells + 1,), (n,) integer arrays
        Nodes of each cell.
    n_nodes : int
        Number of nodes.
    previous : (n_cells,) int64, optional
        Earlier colours, of the same cells at other nodes.

    Returns
    -------
    (n_cells,) int64
        Colours from 0.
    """
    n_cells = offsets.size - 1
    colors = np.full(n_cells, -1, dtype=np.int64)
    words = 1
    if previous is not None and n_cells:
        words += int(previous.max()) // 64
    while True:
        taken = np.zeros((n_nodes, words), dtype=np.uint64)
        start = colors.copy() if previous is None else previous.copy()
        if _color_with_bits(offsets, nodes, start, taken):
            return start
        words *= 2


@njit
def _color_with_bits(offsets: Any, nodes: Any, colors: Any, taken: Any) -> bool:
    """Replace colours that collide, and -1; False if there are more colours than bits."""
    words = taken.shape[1]
    one, full = np.uint64(1), np.uint64(0xFFFFFFFFFFFFFFFF)
    for e in range(colors.size):
        c = colors[e]
        if c < 0:
            continue
        word, bit = c // 64, one << np.uint64(c % 64)
        is_free = True
        for t in range(offsets[e], offsets[e + 1]):
            if taken[nodes[t], word] & bit:
                is_free = False
                break
        if not is_free:
            colors[e] = -1
            continue
        for t in range(offsets[e], offsets[e + 1]):
            taken[nodes[t], word] |= bit
    for e in range(colors.size):
        if colors[e] >= 0:
            continue
        found = False
        for word in range(words):
            union = np.uint64(0)
            for t in range(offsets[e], offsets[e + 1]):
                union |= taken[nodes[t], word]
            if union == full:
                continue
            k = 0
            while union & (one << np.uint64(k)):
                k += 1
            bit = one << np.uint64(k)
            for t in range(offsets[e], offsets[e + 1]):
                taken[nodes[t], word] |= bit
            colors[e] = 64 * word + k
            found = True
            break
        if not found:
            return False
    return True


def is_valid(graph: Incidence, colors: IntArray) -> bool:
    """Whether no two items of a set share a colour."""
    sets = np.repeat(np.arange(graph.set_offsets.size - 1), np.diff(graph.set_offsets))
    pairs = np.stack([sets, colors[graph.set_items]], axis=1)
    return bool(np.all(colors >= 0)) and len(np.unique(pairs, axis=0)) == len(pairs)
