"""Colouring of nodes and cells: valid, few colours, mended where sets are added."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from femdeform.scene.mesh_schema import BlockMesh
from femdeform.types import IntArray
from meshes.structured import block
from solvers.coloring import Incidence, color, color_cells, incidence, is_valid, recolor


def box(cells: int, split: int = 5) -> tuple[NDArray[Any], int]:
    """Tetrahedra of a cube of cells^3 grid cells, and the number of nodes."""
    data = {"recipe": "block", "size": [1.0, 1.0, 1.0], "cells": [cells] * 3, "split": split}
    mesh = block(BlockMesh.model_validate(data))
    return mesh.cells, mesh.n_points


def clashes(graph: Incidence, colors: NDArray[np.int64]) -> int:
    """Pairs of items that share a set and a colour, counted one by one."""
    count = 0
    for s in range(graph.set_offsets.size - 1):
        own = colors[graph.set_items[graph.set_offsets[s] : graph.set_offsets[s + 1]]]
        count += own.size - np.unique(own).size
    return count


def test_five_colors_of_nodes_on_the_alternating_block() -> None:
    cells, n = box(15)
    assert (n, len(cells)) == (4096, 16875)
    graph = incidence([cells], n)
    colors = color(graph)
    assert clashes(graph, colors) == 0
    assert colors.max() + 1 == 5


def test_cells_are_coloured_by_the_same_function() -> None:
    cells, n = box(7)
    graph = incidence([cells], n)
    colors = color(graph.transposed())
    assert colors.size == len(cells)
    assert clashes(graph.transposed(), colors) == 0
    most = np.bincount(cells.ravel()).max()
    assert most <= colors.max() + 1 <= 1.4 * most


@pytest.mark.parametrize("seed", [0, 1])
def test_any_sets(seed: int) -> None:
    """Random sets of two and four items: valid, never more colours than neighbours plus one, the same every time."""
    rng = np.random.default_rng(seed)
    n = 300
    parts = [np.stack([rng.choice(n, k, replace=False) for _ in range(m)]) for k, m in ((4, 200), (2, 150))]
    graph = incidence(parts, n)
    colors = color(graph)
    assert clashes(graph, colors) == 0
    assert is_valid(graph, colors)
    neighbours = np.zeros((n, n), dtype=bool)
    for part in parts:
        for row in part:
            neighbours[np.ix_(row, row)] = True
    assert colors.max() <= neighbours.sum(axis=1).max() - 1
    assert not is_valid(graph, np.zeros(n, dtype=np.int64))
    np.testing.assert_array_equal(color(graph), colors)


def test_the_incidence_lists_the_sets_of_each_item() -> None:
    parts = [np.array([[0, 2, 3], [1, 2, 4]]), np.array([[4, 0]])]
    graph = incidence(parts, 6)
    sets = [graph.item_sets[graph.item_offsets[i] : graph.item_offsets[i + 1]].tolist() for i in range(6)]
    assert sets == [[0, 2], [1], [0, 1], [0], [1, 2], []]
    assert incidence([], 3).n_items == 3


def test_new_pairs_recolor_only_what_they_touch() -> None:
    """Nodes of two blocks in contact: a valid colouring again, few nodes changed, no colour wasted."""
    cells, n = box(5)
    both = np.concatenate([cells, cells + n])
    colors = color(incidence([both], 2 * n))
    rng = np.random.default_rng(3)
    pairs = np.stack([rng.choice(n, 40, replace=False), n + rng.choice(n, 40, replace=False)], axis=1)
    graph = incidence([both, pairs], 2 * n)
    touched = np.unique(pairs)
    mended = recolor(graph, colors, touched)
    assert clashes(graph, colors) > 0
    assert clashes(graph, mended) == 0
    changed = np.flatnonzero(mended != colors)
    assert np.isin(changed, touched).all()
    # Of a pair that clashes one node has to change, and not the other.
    assert 0 < changed.size <= len(pairs)
    assert mended.max() + 1 <= color(graph).max() + 2
    np.testing.assert_array_equal(recolor(graph, mended, touched), mended)


def test_new_items_get_a_colour() -> None:
    cells, n = box(3)
    graph = incidence([cells], n)
    colors = color(graph)
    holes = colors.copy()
    holes[[5, 17, 40]] = -1
    mended = recolor(graph, holes, np.array([5, 17, 40]))
    assert clashes(graph, mended) == 0
    assert mended.min() == 0


def test_colours_of_cells_with_many_nodes() -> None:
    """Valid, as few as by the other greedy way, and kept where the nodes have changed little."""
    rng = np.random.default_rng(0)
    n_nodes, sizes = 200, rng.integers(4, 9, 1400)
    offsets = np.concatenate([[0], np.cumsum(sizes)])
    # Each cell in a neighbourhood of its own, so that many share nodes.
    nodes = np.concatenate([rng.choice(40, size, replace=False) + 40 * (e % 5) for e, size in enumerate(sizes)])
    graph = Incidence(offsets, nodes, *_transposed(offsets, nodes, n_nodes)).transposed()
    colors = color_cells(offsets, nodes, n_nodes, None)
    assert is_valid(graph, colors)
    assert colors.max() > 64  # more than one word of bits
    np.testing.assert_array_equal(colors, color(graph))

    moved = nodes.copy()
    first = offsets[:-1][::80]
    moved[first] = (moved[first] + 40) % n_nodes
    mended = color_cells(offsets, moved, n_nodes, colors)
    changed = Incidence(offsets, moved, *_transposed(offsets, moved, n_nodes)).transposed()
    assert is_valid(changed, mended)
    assert 0 < np.count_nonzero(mended != colors) < 60
    np.testing.assert_array_equal(color_cells(offsets, nodes, n_nodes, colors), colors)


def _transposed(offsets: IntArray, nodes: IntArray, n_nodes: int) -> tuple[IntArray, IntArray]:
    cells = np.repeat(np.arange(offsets.size - 1), np.diff(offsets))
    order = np.argsort(nodes, kind="stable")
    return np.concatenate([[0], np.cumsum(np.bincount(nodes, minlength=n_nodes))]), cells[order]
