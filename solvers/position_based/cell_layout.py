"""Data of a cell-wise sweep, laid out in the order in which it is read.

Nodes are renumbered along a space-filling curve, cells by colour and then along the same curve: cells of one colour
share no node and are visited at the same time.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.fem.fibres import FibreCells
from femdeform.step_problem import Feature, GatheredCells, LocalCells, LocalStepProblem
from femdeform.types import BoolArray, FloatArray, IntArray
from solvers.coloring import color, color_cells, incidence
from solvers.position_based import layout
from solvers.position_based.gathered_corners import GatheredCorners


@dataclass(frozen=True)
class CellBatch:
    """Cells of one law, sorted by colour.

    Attributes
    ----------
    law : NamedTuple
    corners : (n_cells, dim + 1) uint32 or GatheredCorners
        Where each corner's numbers begin.
    gradients : (n_cells, dim dim) float64
        Gradients of the shape functions of all corners but the first, row by row [1/m]; of gathered corners those of
        all, (n_entries, dim).
    volumes : (n_cells,) float64
        [m^3].
    masks : (n_cells, (dim + 1) dim) or (n_entries, dim) float64 or ()
        0 where a component of a corner is prescribed; () where all corners are wholly free or wholly prescribed.
    offsets : (n_colors + 1,) int64
        First cell of each colour.
    cells : (n_cells, dim + 1) int64
        Nodes of the problem; empty for gathered corners.
    fibres : tuple of FibreCells
        Cells that carry muscle fibres.
    unit_kappa : (n_cells,) float64
        Stiffness number of each cell for a step of one second [1/s^2]; empty where it is not wanted.
    crowds : (n_cells,) float64
        Of gathered corners, the most cells that share a node of each cell; else zeros. Empty as `unit_kappa` is.
    """

    law: Any
    corners: layout.Indices | GatheredCorners
    gradients: FloatArray
    volumes: FloatArray
    masks: FloatArray | tuple[()]
    offsets: IntArray
    cells: IntArray
    fibres: tuple[FibreCells, ...]
    unit_kappa: FloatArray
    crowds: FloatArray

    def nodal_sums(self, push: FloatArray, stride: int, n_nodes: int) -> FloatArray:
        """``sum_e A_e g_i`` at the nodes in the order of the sweep (n_nodes, dim), A being push (n_cells, dim dim)."""
        dim = round(push.shape[1] ** 0.5)
        push = push.reshape(-1, dim, dim)
        corners = self.corners
        if isinstance(corners, GatheredCorners):
            of_entry = np.repeat(push, np.diff(corners.offsets), axis=0)
            parts = np.einsum("tab,tb->ta", of_entry, self.gradients)
            places = (corners.places // stride).astype(np.int64)
        else:
            gradients = self.gradients.reshape(-1, dim, dim)
            gradients = np.concatenate([-gradients.sum(axis=1, keepdims=True), gradients], axis=1)
            parts = np.einsum("eab,eib->eia", push, gradients).reshape(-1, dim)
            places = (corners // stride).astype(np.int64).ravel()
        columns = [np.bincount(places, parts[:, a], minlength=n_nodes) for a in range(dim)]
        return np.stack(columns, axis=1)


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
    colors : (n_cells,) int64
        Of all cells as the problem lists them, where they are coloured anew from step to step; else empty.
    """

    numbering: layout.Numbering
    n_colors: int
    batches: list[CellBatch]
    colors: IntArray


def lay_out_cells(
    problem: LocalStepProblem,
    stride: int,
    knows: Collection[Feature] = (),
    previous: CellLayout | None = None,
    with_kappa: bool = False,
) -> CellLayout:
    """Colour and sort the cells of a problem; cells without anything to move are left out.

    Parameters
    ----------
    problem : LocalStepProblem
        With linear triangles or tetrahedra.
    stride : int
        Numbers a node.
    knows : collection of str
        What the sweep takes in besides cells, see `LocalStepProblem.local_cells`.
    previous : CellLayout, optional
        Of an earlier step of the same problem.
    with_kappa : bool
        Whether stiffness numbers are wanted, which take a fifth of the time.
    """
    gathered = problem.gathered_cells()
    if gathered is not None:
        return _lay_out_gathered(problem, gathered, stride, None if previous is None else previous.colors, with_kappa)
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
    share = _nodal_volumes(problem, groups) if with_kappa else None
    batches = []
    first = 0
    for part in parts:
        own = colors[first : first + len(part.cells)]
        first += len(part.cells)
        mixed = split[part.cells].any(axis=1)
        for chosen, masked in ((~mixed, False), (mixed, True)):
            if chosen.any():
                rows = np.flatnonzero(chosen)
                batches.append(_batch(problem, part, rows, own[rows], numbering, n_colors, stride, masked, share))
    return CellLayout(numbering, n_colors, batches, np.empty(0, dtype=np.int64))


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
    share: FloatArray | None,
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
        np.empty(0) if share is None else _unit_kappa(problem, group.law, cells, share),
        np.zeros(0 if share is None else n),
    )


def _nodal_volumes(problem: LocalStepProblem, groups: Sequence[LocalCells]) -> FloatArray:
    """Share of each node in the volumes of its cells (n_nodes,) [m^3]."""
    share = np.zeros(len(problem.points))
    for group in groups:
        n = group.cells.shape[1]
        share += np.bincount(group.cells.ravel(), np.repeat(group.volumes / n, n), minlength=share.size)
    return share


def _unit_kappa(problem: LocalStepProblem, law: Any, cells: IntArray, share: FloatArray) -> FloatArray:
    """E / (rho dx^2) of each cell [1/s^2], dx being its shortest edge; E = 3 mu, that of an incompressible material."""
    points = problem.points
    n = cells.shape[1]
    shortest = np.full(len(cells), np.inf)
    for i in range(n):
        for j in range(i):
            edges = points[cells[:, i]] - points[cells[:, j]]
            shortest = np.minimum(shortest, np.einsum("ea,ea->e", edges, edges))
    density = (problem.lumped_mass[cells] / share[cells]).mean(axis=1)
    return np.asarray(3.0 * law.mu / (density * shortest))


# ---------------------------------------------------------------------------------------- gathered cells


def _lay_out_gathered(
    problem: LocalStepProblem,
    groups: Sequence[GatheredCells],
    stride: int,
    previous: IntArray | None,
    with_kappa: bool,
) -> CellLayout:
    """As `lay_out_cells`, for cells of any number of nodes, with colours from earlier ones."""
    ends = np.cumsum([group.offsets[-1] for group in groups])
    offsets = np.concatenate([groups[0].offsets, *(g.offsets[1:] + e for g, e in zip(groups[1:], ends, strict=False))])
    nodes = np.concatenate([group.nodes for group in groups])
    n_nodes = len(problem.points)
    colors = color_cells(offsets, nodes, n_nodes, previous)
    n_colors = int(colors.max()) + 1
    moves: BoolArray = np.any(problem.free, axis=1)
    numbering = layout.number_nodes(problem.points, np.zeros(n_nodes, dtype=np.int64), moves)
    split: BoolArray = moves & ~np.all(problem.free, axis=1)
    kappa = _nodal_kappa(problem, groups) if with_kappa else None
    crowd = np.bincount(nodes, minlength=n_nodes).astype(np.float64)
    batches = []
    first = 0
    for group in groups:
        own = colors[first : first + len(group.volumes)]
        first += len(group.volumes)
        starts = group.offsets[:-1]
        some = np.maximum.reduceat(moves[group.nodes], starts)
        mixed = np.maximum.reduceat(split[group.nodes], starts)
        largest = crowds = np.empty(0)
        if kappa is not None:
            largest = np.maximum.reduceat(kappa[group.nodes], starts)
            crowds = np.maximum.reduceat(crowd[group.nodes], starts)
        sums = np.add.reduceat(problem.points[group.nodes], starts, axis=0)
        centres = sums / np.diff(group.offsets)[:, None]
        for chosen, masked in ((some & ~mixed, False), (mixed, True)):
            rows = np.flatnonzero(chosen)
            if rows.size == 0:
                continue
            rows = rows[np.lexsort((layout.morton_keys(centres[rows]), own[rows]))]
            lengths = np.diff(group.offsets)[rows]
            begin = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
            entries = np.repeat(starts[rows] - begin[:-1], lengths) + np.arange(begin[-1])
            at = group.nodes[entries]
            masks: FloatArray | tuple[()] = problem.free[at].astype(np.float64) if masked else ()
            batches.append(
                CellBatch(
                    group.law,
                    GatheredCorners(begin, (stride * numbering.place[at]).astype(np.uint32)),
                    np.ascontiguousarray(group.gradients[entries]),
                    np.ascontiguousarray(group.volumes[rows]),
                    masks,
                    np.searchsorted(own[rows], np.arange(n_colors + 1)).astype(np.int64),
                    np.empty((0, problem.points.shape[1] + 1), dtype=np.int64),
                    (),
                    largest[rows] if with_kappa else largest,
                    crowds[rows] if with_kappa else crowds,
                )
            )
    return CellLayout(numbering, n_colors, batches, colors)


def _nodal_kappa(problem: LocalStepProblem, groups: Sequence[GatheredCells]) -> FloatArray:
    """Stiffness number of each node for a step of one second [1/s^2], ``sum_e 3 mu V |g|^2 / (6 m)``.

    At a node inside a regular mesh, where the sum of V |g|^2 is about 6 dx and the mass rho dx^3, it is E / (rho dx^2).
    """
    total = np.zeros(len(problem.points))
    for group in groups:
        volumes = np.repeat(group.volumes, np.diff(group.offsets))
        squares = volumes * np.einsum("tc,tc->t", group.gradients, group.gradients)
        total += np.bincount(group.nodes, 0.5 * group.law.mu * squares, minlength=len(total))
    return np.asarray(total / problem.lumped_mass)
