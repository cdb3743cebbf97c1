"""One Gauss-Seidel sweep over the nodes of a grid in which bodies are embedded, compiled, colour by colour."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np

from femdeform.counting_sort import sort_by_number
from femdeform.materials import with_precision
from femdeform.step_problem import GatheredCells, LocalStepProblem
from femdeform.types import BoolArray, FloatArray, IntArray
from solvers.coloring import color_cells
from solvers.position_based import gathered_kernels, layout, move_kernels, node_kernels, wall_kernels
from solvers.position_based.gathered_corners import GatheredCorners, StoredVisits
from solvers.position_based.nodal_blocks import is_bounded
from solvers.position_based.node_arrays import NodeArrays
from solvers.position_based.node_sweep import HALVINGS
from solvers.position_based.wall_kernels import WallData, collect_rows


class GridNodeSweep(NodeArrays):
    """A sweep over the nodes of a grid.

    A cell depends on dozens of nodes: its deformation is made from all of them once a sweep and carried along by every
    node that moves, so that it does not drift.

    Parameters
    ----------
    problem : LocalStepProblem
        With gathered cells and the step begun.
    dtype : numpy type
        float64 or float32.
    previous : GridNodeSweep, optional
        Of an earlier step, the colours of which nodes keep where they can.
    """

    def __init__(
        self, problem: LocalStepProblem, dtype: Any = np.float64, previous: GridNodeSweep | None = None
    ) -> None:
        groups = problem.gathered_cells()
        assert groups is not None
        self._points = problem.points
        self.colors = self._colors(problem, groups, previous)
        used = np.zeros(len(problem.points), dtype=bool)
        for group in groups:
            used[group.nodes] = True
        super().__init__(problem, self.colors, used, dtype)
        self._parts = [_GatheredLaw(group, self.numbering, self.dim, self.dtype) for group in groups]
        self._needs_check = any(not part.is_bounded for part in self._parts)
        self._walls: WallData | None = None
        self._wall_cuts = np.empty(0, dtype=np.int64)
        self._wall_steps = np.empty((0, 3))

    @staticmethod
    def _colors(problem: LocalStepProblem, groups: Sequence[GatheredCells], previous: GridNodeSweep | None) -> IntArray:
        """Colours of nodes so that no two that move and share a cell have the same, from those of an earlier step."""
        n_nodes = len(problem.points)
        moves: BoolArray = np.any(problem.free, axis=1)
        cells, first = [np.empty(0, dtype=np.int64)], 0
        for group in groups:
            cells.append(np.repeat(first + np.arange(len(group.volumes)), np.diff(group.offsets)))
            first += len(group.volumes)
        nodes = np.concatenate([np.empty(0, dtype=np.int32), *(group.nodes for group in groups)])
        kept = moves[nodes]
        entries, offsets = sort_by_number(nodes[kept], n_nodes)
        earlier = None if previous is None else previous._colors_at(problem.points)
        return color_cells(offsets.astype(np.int64), np.concatenate(cells)[kept][entries], first, earlier)

    def _colors_at(self, points: FloatArray) -> IntArray:
        """Colours by the places of nodes, which lie on one lattice; -1 where there was none."""
        _, numbers = np.unique(np.concatenate([self._points, points]), axis=0, return_inverse=True)
        numbers = numbers.ravel()
        table = np.full(int(numbers.max(initial=-1)) + 1, -1, dtype=np.int64)
        table[numbers[: len(self._points)]] = self.colors
        return table[numbers[len(self._points) :]]

    def begin_step(self, problem: LocalStepProblem) -> None:
        """Take over what the step begun has frozen: inertia, loads, walls."""
        super().begin_step(problem)
        self._walls = None
        if problem.rows is not None:
            self._walls = collect_rows(problem.rows, self.numbering.place, self._free.reshape(-1, 3), self.dim)
            self._wall_cuts = np.searchsorted(self._walls.nodes, self.numbering.color_offsets)
            self._wall_steps = np.zeros((self._walls.nodes.size, 3))

    def sweep(self, x: FloatArray, relaxation: float = 1.0) -> None:
        """See `NodeArrays`."""
        factor = self.dtype.type(relaxation)
        offsets = self.numbering.color_offsets
        nodal = (self._weights, self._centers, self._loads)
        for part in self._parts:
            part.refresh(x)
        for c in range(self.n_colors):
            first, last = int(offsets[c]), int(offsets[c + 1])
            for part in self._parts:
                part.add(c, x, self._acc)
            walls = slice(0, 0) if self._walls is None else slice(int(self._wall_cuts[c]), int(self._wall_cuts[c + 1]))
            if walls.stop > walls.start:
                self._step_at_walls(walls, x)
            move_kernels.find_steps(first, last, *nodal, self._free, factor, False, x, self._acc, self._steps)
            if self._walls is not None and walls.stop > walls.start:
                # An extrapolated step would end inside the wall.
                self._steps.reshape(-1, 3)[self._walls.nodes[walls]] = self._wall_steps[walls]
            for part in self._parts:
                if not part.is_bounded:
                    part.shorten(c, x, self._steps, self._taken)
            for part in self._parts:
                part.carry(c, self._taken, self._steps)
            move_kernels.take_steps(first, last, self._taken, self._steps, x)

    def _step_at_walls(self, rows: slice, x: FloatArray) -> None:
        data = self._walls
        assert data is not None
        wall_kernels.step_at_walls(
            rows.start,
            rows.stop,
            data.nodes,
            data.offsets,
            data.normals,
            data.targets,
            data.stiffness,
            data.two_sided,
            data.free,
            self._weights,
            self._centers,
            self._loads,
            x,
            self._acc,
            self._wall_steps,
        )


class _GatheredLaw:
    """Cells of one law, their deformations, and the visits of nodes to them."""

    def __init__(self, group: GatheredCells, numbering: layout.Numbering, dim: int, dtype: Any) -> None:
        self.dim = (0,) * dim
        self.is_bounded = is_bounded(group.law)
        self._flat = float(np.finfo(dtype).eps) ** 0.6
        places = numbering.place[group.nodes]
        self._corners = GatheredCorners(group.offsets, (3 * places).astype(np.uint32))
        self._gradients = group.gradients.astype(dtype)
        entries, starts = sort_by_number(places, numbering.order.size)
        # Nodes that never move come last, and so do their visits.
        starts = starts[: int(numbering.color_offsets[-1]) + 1]
        entries = entries[: starts[-1]]
        nodes = np.flatnonzero(np.diff(starts))
        offsets = np.append(starts[nodes], starts[-1]).astype(np.int64)
        cells = np.repeat(np.arange(len(group.volumes), dtype=np.uint32), np.diff(group.offsets))[entries]
        stored = StoredVisits(cells, np.zeros((len(group.volumes), dim * dim), dtype=dtype))
        rows = np.searchsorted(nodes, numbering.color_offsets)
        self._chunks = [layout.split(offsets, int(a), int(b)) for a, b in itertools.pairwise(rows)]
        self._rows = (nodes.astype(np.uint32), offsets)
        self._visits = stored
        self._slopes = np.ascontiguousarray(self._gradients[entries].T)
        volumes = group.volumes.astype(dtype)[cells]
        self._cells = (stored, self._slopes, volumes, with_precision(group.law, dtype), self.dim)

    @property
    def deformations(self) -> FloatArray:
        """F of each cell as the sweep has carried it along (n_cells, dim dim)."""
        return self._visits.deformations

    def refresh(self, x: FloatArray) -> None:
        """Make the deformations anew from the positions."""
        gathered_kernels.deform_cells(self._corners, self._gradients, self.dim, x, self.deformations)

    def add(self, color: int, x: FloatArray, acc: FloatArray) -> None:
        """Add forces and matrices of the nodes of one colour."""
        node_kernels.add_cells(self._chunks[color], *self._rows, *self._cells, x, acc)

    def shorten(self, color: int, x: FloatArray, steps: FloatArray, parts: FloatArray) -> None:
        """Lower the parts of steps that these cells allow."""
        chunks = self._chunks[color]
        node_kernels.shorten_steps(chunks, *self._rows, *self._cells, self._flat, HALVINGS, x, steps, parts)

    def carry(self, color: int, parts: FloatArray, steps: FloatArray) -> None:
        """Take the steps of the nodes of one colour into the deformations."""
        chunks = self._chunks[color]
        gathered_kernels.carry_cells(chunks, *self._rows, self._visits, self._slopes, self.dim, parts, steps)
