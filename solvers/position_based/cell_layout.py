"""Data of a cell-wise sweep, laid out in the order in which it is read.

Nodes are renumbered along a space-filling curve, cells by colour and then along the same curve: cells of one colour
share no node and are visited at the same time.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.fem.fibres import FibreCells
from femdeform.step_problem import Feature, LocalCells, LocalStepProblem
from femdeform.types import BoolArray, FloatArray, IntArray
from solvers.coloring import color, incidence
from solvers.position_based import layout


@dataclass(frozen=True)
class CellBatch:
    """Cells of one law, sorted by colour.

    Attributes
    ----------
    law : NamedTuple
    corners : (n_cells, dim + 1) uint32
        Where each corner's numbers begin.
    gradients : (n_cells, dim dim) float64
        Gradients of the shape functions of all corners but the first, row by row [1/m].
    volumes : (n_cells,) float64
        [m^3].
    masks : (n_cells, (dim + 1) dim) float64 or ()
        0 where a component of a corner is prescribed; () where all corners are wholly free or wholly prescribed.
    offsets : (n_colors + 1,) int64
        First cell of each colour.
    cells : (n_cells, dim + 1) int64
        Nodes of the problem.
    fibres : tuple of FibreCells
        Cells that carry muscle fibres.
    """

    law: Any
    corners: layout.Indices
    gradients: FloatArray
    volumes: FloatArray
    masks: FloatArray | tuple[()]
    offsets: IntArray
    cells: IntArray
    fibres: tuple[FibreCells, ...]


@dataclass(frozen=True)
class CellLayout:
    """The order of nodes and cells of a sweep.

    Attributes
    ----------
    numbering : layout.Numbering
        Order of the nodes, as if they had one colour.
    n_colors : int
        Colours of the cells.
    batches : list of CellBatch
    """

    numbering: layout.Numbering
    n_colors: int
    batches: list[CellBatch]


def lay_out_cells(problem: LocalStepProblem, stride: int, knows: Collection[Feature] = ()) -> CellLayout:
    """Colour and sort the cells of a problem; cells without anything to move are left out.

    Parameters
    ----------
    problem : LocalStepProblem
        With linear triangles or tetrahedra.
    stride : int
        Numbers a node.
    knows : collection of str
        What the sweep takes in besides cells, see `LocalStepProblem.local_cells`.
    """
    groups = list(problem.local_cells(knows))
    moves: BoolArray = np.any(problem.free, axis=1)
    n_nodes = len(problem.points)
    parts = [_moving(group, moves) for group in groups]
    colors = color(incidence([part.cells for part in parts], n_nodes).transposed())
    used = np.zeros(n_nodes, dtype=bool)
    for part in parts:
        used[part.cells] = True
    for thin in problem.constraints:
        used[thin.nodes] = True
    numbering = layout.number_nodes(problem.points, np.zeros(n_nodes, dtype=np.int64), moves & used)
    n_colors = int(colors.max()) + 1 if colors.size else 0
    # Nodes some of whose components are prescribed make their cells a batch of their own, with masks.
    split: BoolArray = moves & ~np.all(problem.free, axis=1)
    batches = []
    first = 0
    for part in parts:
        own = colors[first : first + len(part.cells)]
        first += len(part.cells)
        mixed = split[part.cells].any(axis=1)
        for chosen, masked in ((~mixed, False), (mixed, True)):
            if chosen.any():
                rows = np.flatnonzero(chosen)
                batches.append(_batch(problem, part, rows, own[rows], numbering, n_colors, stride, masked))
    return CellLayout(numbering, n_colors, batches)


def _moving(group: LocalCells, moves: BoolArray) -> LocalCells:
    rows = np.flatnonzero(moves[group.cells].any(axis=1))
    fibres = tuple(part.taken(rows, len(group.cells)) for part in group.fibres)
    return LocalCells(group.law, group.cells[rows], group.gradients[rows], group.volumes[rows], fibres)


def _batch(
    problem: LocalStepProblem,
    group: LocalCells,
    rows: IntArray,
    colors: IntArray,
    numbering: layout.Numbering,
    n_colors: int,
    stride: int,
    masked: bool,
) -> CellBatch:
    centres = problem.points[group.cells[rows]].mean(axis=1)
    order = np.lexsort((layout.morton_keys(centres), colors))
    rows, colors = rows[order], colors[order]
    cells = group.cells[rows].astype(np.int64)
    n, dim = len(cells), problem.points.shape[1]
    masks: FloatArray | tuple[()] = problem.free[cells].reshape(n, -1).astype(np.float64) if masked else ()
    return CellBatch(
        group.law,
        np.ascontiguousarray((stride * numbering.place[cells]).astype(np.uint32)),
        np.ascontiguousarray(group.gradients[rows, 1:].reshape(n, dim * dim)),
        np.ascontiguousarray(group.volumes[rows]),
        masks,
        np.searchsorted(colors, np.arange(n_colors + 1)).astype(np.int64),
        cells,
        tuple(part.taken(rows, len(group.cells)) for part in group.fibres),
    )
