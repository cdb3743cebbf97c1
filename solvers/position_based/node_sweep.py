"""One Gauss-Seidel sweep over the nodes of a step problem, compiled, colour by colour."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from femdeform.contact.weak_constraints import WeakConstraints
from femdeform.materials.arap import ARAP
from femdeform.materials.fixed_corotated import FixedCorotated
from femdeform.materials.neo_hookean import NeoHookean
from femdeform.step_problem import LocalCells, LocalStepProblem
from femdeform.types import BoolArray, FloatArray, IntArray
from solvers.coloring import color, incidence, recolor
from solvers.position_based import fast_kernels, layout, move_kernels, node_kernels, row_kernels
from solvers.position_based.nodal_blocks import is_bounded
from solvers.position_based.node_arrays import NodeArrays
from solvers.position_based.node_fibres import NodeFibres
from solvers.position_based.obstacle_kernels import ObstacleData, collect
from solvers.position_based.stiff_block import StiffBlock, stiff_nodes

_CellData = tuple[layout.Indices, FloatArray, FloatArray, Any, tuple[int, ...]]

# Halvings of a step after which a node waits for its neighbours.
HALVINGS = 30


class NodeSweep(NodeArrays):
    """A sweep over the nodes of meshes.

    Parameters
    ----------
    problem : LocalStepProblem
    dtype : numpy type
        float64 or float32.

    Attributes
    ----------
    numbering : layout.Numbering
        Order of the nodes; positions given to `sweep` are flat, in this order, three components a node. Nodes that
        stiff weak constraints couple are the last colour; they move as one block.
    block : StiffBlock or None
        The block of the step begun: these nodes, and those of contact rows. The latter keep colour and place; their
        own colour passes them by as long as they are in contact, so no other node is coloured or laid out anew.
    """

    def __init__(self, problem: LocalStepProblem, dtype: Any = np.float64) -> None:
        self._groups = groups = list(problem.local_cells(("links", "weak_contact", "fibres")))
        n_nodes = len(problem.points)
        links: WeakConstraints | None = problem.links
        stiff = np.zeros(n_nodes, dtype=bool)
        if links is not None:
            stiff = stiff_nodes(groups, links, n_nodes)
        # A node without cells has no stiffness to divide by.
        used = np.zeros(n_nodes, dtype=bool)
        for group in groups:
            used[group.cells] = True
        super().__init__(problem, _colors(groups, links, stiff), used, dtype)
        self._parts = [_law_cells(group, self.numbering, self.dtype) for group in groups]
        self._fibres = [
            NodeFibres(group, fibres, self.numbering, self.dtype) for group in groups for fibres in group.fibres
        ]
        offsets, place = self.numbering.color_offsets, self.numbering.place
        self._links = links
        self._rows: row_kernels.RowData | None = None
        if links is not None:
            self._rows = row_kernels.lay_out(links, place, int(offsets[-1]), self.dtype)
            self._row_cuts = np.searchsorted(self._rows.nodes, offsets)
        self._stiff = np.flatnonzero(stiff & (place < offsets[-1]))
        self.block: StiffBlock | None = None
        self._own_free = self._free.copy()
        self._obstacles: ObstacleData | None = None
        self._needs_check = bool(self._fibres) or any(not part.is_bounded for part in self._parts)

    def begin_step(self, problem: LocalStepProblem) -> None:
        """Take over what the step begun has frozen: inertia, loads, obstacles, weak constraints."""
        super().begin_step(problem)
        contacts = problem.node_contacts()
        self._obstacles = collect(contacts, self.numbering.place, self.dim) if contacts else None
        if self._links is not None and self._rows is not None:
            self._rows.begin_step(self._links)
        self._gather_block(problem)

    def _gather_block(self, problem: LocalStepProblem) -> None:
        """Make the block of the nodes of stiff rows and of contact rows; keep the last one where they are the same."""
        nodes = self._stiff
        if problem.weak_contact is not None:
            nodes = np.union1d(nodes, problem.weak_contact.nodes())
        # In the order of the sweep; without what never moves.
        places = np.sort(self.numbering.place[nodes])
        nodes = self.numbering.order[places[places < self.numbering.color_offsets[-1]]]
        if self.block is None or not np.array_equal(nodes, self.block.nodes):
            place = self.numbering.place
            self.block = StiffBlock(problem, self._groups, place, nodes) if nodes.size else None
            self._free[:] = self._own_free
            self._free.reshape(-1, 3)[place[nodes]] = 0
        if self.block is not None:
            self.block.begin_step(problem)

    def update_loads(self, problem: LocalStepProblem, x: FloatArray) -> None:
        """Evaluate forces that follow the positions x (n_nodes, dim), where there are any; renew what lags behind."""
        super().update_loads(problem, x)
        if self.block is not None:
            self.block.renew()

    def sweep(self, x: FloatArray, relaxation: float = 1.0) -> None:
        """Move every node once.

        Parameters
        ----------
        x : (3 n_nodes,)
            Flat positions [m], see `flat`; changed.
        relaxation : float
            Factor of the step of every node that touches no obstacle, in (0, 2).
        """
        factor = self.dtype.type(relaxation)
        offsets = self.numbering.color_offsets
        at_once = self._obstacles is None and not self._needs_check
        for c in range(self.n_colors - bool(self._stiff.size)):
            first, last = int(offsets[c]), int(offsets[c + 1])
            for part in self._parts:
                part.add(c, x, self._acc)
            for fibres in self._fibres:
                fibres.add(c, x, self._acc)
            if self._rows is not None:
                self._add_rows(c, x)
            self._find_steps(first, last, factor, at_once, x)
            if at_once:
                continue
            for part in self._parts:
                if not part.is_bounded:
                    part.shorten(c, x, self._steps, self._taken)
            for fibres in self._fibres:
                fibres.shorten(c, x, self._steps, self._taken)
            move_kernels.take_steps(first, last, self._taken, self._steps, x)
        if self.block is not None:
            self.block.move(x, self._loads)

    def _add_rows(self, color: int, x: FloatArray) -> None:
        rows = self._rows
        assert rows is not None
        row_kernels.add_rows(
            int(self._row_cuts[color]),
            int(self._row_cuts[color + 1]),
            rows.nodes,
            rows.node_offsets,
            rows.node_rows,
            rows.node_weights,
            rows.row_offsets,
            rows.row_places,
            rows.row_weights,
            rows.lengths,
            rows.stiffness,
            rows.targets,
            x,
            self._acc,
        )

    def _find_steps(self, first: int, last: int, factor: Any, at_once: bool, x: FloatArray) -> None:
        nodal = (self._weights, self._centers, self._loads, self._free, factor)
        data = self._obstacles
        if data is None:
            move_kernels.find_steps(first, last, *nodal, at_once, x, self._acc, self._steps)
            return
        move_kernels.find_steps_in_contact(
            first,
            last,
            *nodal,
            data.rows,
            data.kinds,
            data.shapes,
            data.shifts,
            data.slips,
            data.stiffness,
            data.limits,
            data.starts,
            data.normals,
            x,
            self._acc,
            self._steps,
        )


def _colors(groups: Sequence[LocalCells], links: WeakConstraints | None, stiff: BoolArray) -> IntArray:
    """Colours of nodes by cells, mended where rows couple further ones; nodes of stiff rows are a colour of their own.

    Returns
    -------
    (n_nodes,) int64
    """
    n = stiff.size
    cells = [group.cells for group in groups]
    colors = color(incidence(cells, n))
    if links is None:
        return colors
    coupled = [term.cells for term in links.terms]
    # What moves as a block moves at no other time.
    lonely = [part[~stiff[part].all(axis=1)] for part in coupled]
    touched = np.unique(np.concatenate([np.empty(0, np.int64), *(part.ravel() for part in lonely)]))
    colors = recolor(incidence([*cells, *lonely], n), colors, touched)
    colors[stiff] = int(colors.max()) + 1
    return colors


class _LawCells:
    """Cells of one law, by the kernel for any law."""

    needs_gradients = True

    def __init__(self, cells: LocalCells, numbering: layout.Numbering, dtype: Any) -> None:
        self.visits = layout.list_visits(cells, numbering, dtype, self.needs_gradients)
        self.dim = (0,) * (cells.cells.shape[1] - 1)
        self.is_bounded = is_bounded(cells.law)
        self._flat = float(np.finfo(dtype).eps) ** 0.6

    def _arguments(self, color: int) -> tuple[IntArray, layout.Indices, IntArray, _CellData]:
        v = self.visits
        return v.chunks[color], v.nodes, v.offsets, (v.others, v.gradients, v.volumes, v.law, self.dim)

    def add(self, color: int, x: FloatArray, acc: FloatArray) -> None:
        """Add forces and matrices of the nodes of one colour."""
        chunks, nodes, offsets, cells = self._arguments(color)
        node_kernels.add_cells(chunks, nodes, offsets, *cells, x, acc)

    def shorten(self, color: int, x: FloatArray, steps: FloatArray, parts: FloatArray) -> None:
        """Lower the parts of steps that these cells allow."""
        chunks, nodes, offsets, cells = self._arguments(color)
        node_kernels.shorten_steps(chunks, nodes, offsets, *cells, self._flat, HALVINGS, x, steps, parts)


class _NeoHookeanCells(_LawCells):
    """Tetrahedra of the neo-Hookean law."""

    needs_gradients = False

    def __init__(self, cells: LocalCells, numbering: layout.Numbering, dtype: Any) -> None:
        super().__init__(cells, numbering, dtype)
        v = self.visits
        self._scales = (1.0 / (6.0 * v.volumes.astype(np.float64))).astype(dtype)
        self._stencil = layout.laplacian(cells, numbering, v.nodes, dtype)

    def add(self, color: int, x: FloatArray, acc: FloatArray) -> None:
        v, s = self.visits, self._stencil
        fast_kernels.add_neo_hookean(
            v.chunks[color],
            v.nodes,
            v.offsets,
            v.others,
            self._scales,
            s.offsets,
            s.neighbours,
            s.weights,
            s.diagonal,
            v.law,
            x,
            acc,
        )


class _RotatedCells(_LawCells):
    """Tetrahedra of the fixed corotated law and of ARAP."""

    def __init__(self, cells: LocalCells, numbering: layout.Numbering, dtype: Any) -> None:
        super().__init__(cells, numbering, dtype)
        v = self.visits
        volumes = v.volumes.astype(np.float64)
        self._scales = (1.0 / (6.0 * volumes)).astype(dtype)
        squares = volumes * np.sum(v.gradients[:3].astype(np.float64) ** 2, axis=0)
        self._diagonal = np.add.reduceat(squares, v.offsets[:-1]).astype(dtype) if squares.size else squares
        # The corrections are cubic in the last one: its square at rounding to the power of two thirds.
        self._tolerance = 0.4 * float(np.finfo(dtype).eps) ** (2.0 / 3.0)

    def add(self, color: int, x: FloatArray, acc: FloatArray) -> None:
        v = self.visits
        fast_kernels.add_rotated(
            v.chunks[color],
            v.nodes,
            v.offsets,
            v.others,
            v.gradients,
            v.volumes,
            self._scales,
            self._diagonal,
            v.law,
            self._tolerance,
            self.dim,
            x,
            acc,
        )


def _law_cells(cells: LocalCells, numbering: layout.Numbering, dtype: Any) -> _LawCells:
    if cells.cells.shape[1] == 4:
        if isinstance(cells.law, NeoHookean):
            return _NeoHookeanCells(cells, numbering, dtype)
        if isinstance(cells.law, (FixedCorotated, ARAP)):
            return _RotatedCells(cells, numbering, dtype)
    return _LawCells(cells, numbering, dtype)
