"""Nodes that stiff weak constraints or contact couple, moved together by one step of Newton's method.

One of them alone cannot move: its row pulls it back. So all nodes of stiff rows are one block of the sweep, whatever
the kind of their rows is. The block's matrix is the projected Hessian of the cells, rows, obstacles and inertia around
its nodes; its step is halved until their energy falls enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from femdeform.contact.weak_constraints import WeakConstraints
from femdeform.contact.weak_contact import WeakContact
from femdeform.fem.discretization import ElementGroup
from femdeform.fem.energies import CellTerm, ElasticEnergy
from femdeform.step_problem import LocalCells, LocalStepProblem
from femdeform.types import BoolArray, FloatArray, IntArray
from solvers.position_based.active_rows import ActiveRows

# A row is stiff where its nodes' rows are stiffer than their cells by this factor. Measured: at 1 tied bars need as
# many sweeps as one bar whatever the stiffness is, at 4 up to twice as many, at 10 three times.
_STIFF = 1.0
# Part of the first-order decrease of energy that a step has to reach, and halvings after which the block waits.
_ENOUGH = 1e-4
_HALVINGS = 30
# Factorisations in one step of the block for contact rows that come and go.
_FACTORISATIONS = 3
# Differences of energies below this part of them are rounding.
_FLAT = 1e-11
# What is added to the diagonal, relative to the stiffness of a node's cells: a block that nothing else holds is
# singular.
_SHIFT = 1e-9


def stiff_nodes(groups: Sequence[LocalCells], links: WeakConstraints, n_nodes: int) -> BoolArray:
    """Which nodes belong to rows that single nodes cannot solve.

    Those are rows of which two nodes or more have rows stiffer than their cells: moving together costs little, but
    none of them can by itself. A stiff spring with a length needs only one, since it lets its end swing. Inertia is
    left out: it may change from step to step.

    Parameters
    ----------
    groups : sequence of LocalCells
        All cells.
    links : WeakConstraints
        All rows.
    n_nodes : int
        Number of nodes.

    Returns
    -------
    (n_nodes,) bool
    """
    own = np.zeros(n_nodes)
    for group in groups:
        modulus = 2.0 * float(group.law.mu) + float(group.law.lmbda)
        size = modulus * group.volumes[:, None] * np.sum(group.gradients**2, axis=2)
        own += np.bincount(group.cells.ravel(), size.ravel(), minlength=n_nodes)
    rows = links.rows
    row = np.repeat(np.arange(rows.n_rows), np.diff(rows.offsets))
    pull = np.maximum(rows.normal, rows.tangential)[row] * rows.weights**2
    held = np.bincount(rows.nodes, pull, minlength=n_nodes) > _STIFF * own
    # A node that other rows hold and that hardly weighs in this one does not make it stiff.
    counts = np.bincount(row, held[rows.nodes] & (pull > 1e-3 * _STIFF * own[rows.nodes]), minlength=rows.n_rows)
    is_stiff = (counts >= 2) | ((counts >= 1) & (rows.length > 0.0))
    chosen = np.zeros(n_nodes, dtype=bool)
    chosen[rows.nodes[is_stiff[row]]] = True
    return chosen


class StiffBlock:
    """The nodes of stiff rows and what is around them.

    Parameters
    ----------
    problem : LocalStepProblem
        Its contact by weak constraints is taken in: rows may change from step to step, as long as their nodes that move
        are among `nodes`.
    groups : sequence of LocalCells
        All cells.
    place : (n_nodes,) int64
        Place of each node in the sweep.
    nodes : (n_block,) int64
        Nodes of the block.

    Limitations
    -----------
    The matrix is factorised by one thread; its size is that of the surfaces that stiff rows hold together.
    """

    def __init__(
        self, problem: LocalStepProblem, groups: Sequence[LocalCells], place: IntArray, nodes: IntArray
    ) -> None:
        n_nodes, self.dim = problem.points.shape
        self.nodes = nodes
        self._places = place[nodes]
        self._place = place
        self._is_mine = np.zeros(n_nodes, dtype=bool)
        self._is_mine[nodes] = True
        self._free = problem.free[nodes]
        dofs = np.full((n_nodes, self.dim), -1, dtype=np.int64)
        dofs[nodes] = np.where(self._free, np.cumsum(self._free).reshape(self._free.shape) - 1, -1)
        self._size = int(np.count_nonzero(self._free))
        self._dofs = dofs
        cells = [ElasticEnergy(_around(group, self._is_mine)) for group in groups]
        self._cells = [term for term in cells if len(term.cells)]
        self._held: list[CellTerm] = [] if problem.links is None else problem.links.terms
        self._entries = [_Entries(term.cells, dofs) for term in (*self._cells, *self._held)]
        self._terms: list[CellTerm] = []
        self._contact: WeakContact | None = None
        self._contact_entries: list[_Entries] = []
        self._active_rows: ActiveRows | None = None
        self._obstacles: list[Any] = []
        self._x = problem.points.copy()
        self._near = nodes
        self._slots = np.empty((0, self.dim))
        self._order = self._starts = np.empty(0, dtype=np.int64)
        self._factor: Any = None
        self._touching = np.empty(0)
        self._pushing: BoolArray | None = None
        self._weights = np.empty(0)
        self._centers = np.empty((0, self.dim))

    def begin_step(self, problem: LocalStepProblem) -> None:
        """Take over inertia, obstacles and contact rows of the step begun."""
        inertia = problem.nodal_terms()
        self._weights, self._centers = inertia.weights[self.nodes], inertia.centers[self.nodes]
        self._obstacles = [contact for contact in problem.node_contacts() if self._is_mine[contact.nodes].any()]
        self._terms = [*self._cells, *self._held]
        self._contact, self._contact_entries, self._active_rows = None, [], None
        if problem.weak_contact is not None and len(problem.weak_contact.cells):
            self._contact = problem.weak_contact
            self._terms.append(self._contact)
            self._contact_entries = [_Entries(self._contact.cells, self._dofs)]
            self._active_rows = ActiveRows(self._contact, self._dofs, self._size)
            self._pushing = None
        # Where the forces of terms on the nodes of the block are, node by node.
        every = np.concatenate([term.cells.ravel() for term in self._terms])
        self._slots = np.empty((every.size, self.dim))
        mine = np.flatnonzero(self._is_mine[every])
        rank = np.full(len(self._x), -1, dtype=np.int64)
        rank[self.nodes] = np.arange(len(self.nodes))
        self._order = mine[np.argsort(rank[every[mine]], kind="stable")]
        counts = np.bincount(rank[every[mine]], minlength=len(self.nodes))
        self._starts = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64)
        near = np.zeros(len(self._x), dtype=bool)
        near[every] = True
        for contact in self._obstacles:
            near[contact.nodes] = True
        self._near = np.flatnonzero(near)
        self.renew()

    def renew(self) -> None:
        """Let the matrix be made anew at the next move."""
        self._factor = None

    def move(self, flat: FloatArray, all_loads: FloatArray) -> None:
        """Move the block.

        Parameters
        ----------
        flat : (3 n_nodes,)
            Positions by place [m]; changed.
        all_loads : (3 n_nodes,)
            Dead loads and pressure by place [N].
        """
        x, place = self._x, self._place
        table = flat.reshape(-1, 3)
        loads = all_loads.reshape(-1, 3)[self._places, : self.dim].astype(np.float64)
        x[self._near] = table[place[self._near], : self.dim]
        here = x[self.nodes]
        slope = loads + self._weights[:, None] * (self._centers - here) - self._gradient(x)
        touching = np.zeros((len(self.nodes), self.dim**2))
        if self._obstacles:
            push, blocks = np.zeros_like(x), np.zeros((len(x), self.dim**2))
            for contact in self._obstacles:
                contact.add_gradient(x, push)
                contact.add_hessian(x, True, blocks)
            slope -= push[self.nodes]
            touching = blocks[self.nodes]
        if self._contact is not None and self._pushing is None:
            self._pushing = self._contact.pushing(x)
        if self._factor is None or not np.allclose(touching, self._touching, rtol=0.1, atol=0.0):
            self._factor, self._touching = self._factorised(touching), touching
        slope = slope[self._free]
        if self._factor is None or not np.isfinite(slope).all():
            return
        direction = self._direction(x, slope)
        step = np.zeros_like(here)
        step[self._free] = direction
        work = float(np.dot(slope, direction))
        if not work > 0.0:
            self.renew()
            return
        before, size = self._energy(x)
        part = 1.0
        for _ in range(_HALVINGS):
            x[self.nodes] = here + part * step
            after, _ = self._energy(x)
            nodal = self._nodal_difference(here, part * step, loads)
            if after - before + nodal <= -_ENOUGH * part * work:
                break
            # Decreases that drown in rounding: the matrix bounds steps so small by itself.
            if part * work <= _FLAT * size and after - before + nodal <= _FLAT * size:
                break
            part *= 0.5
        else:
            self.renew()
            return
        if part < 1.0:
            self.renew()
        table[self._places, : self.dim] = x[self.nodes]

    # --------------------------------------------------------------------------------------------- parts

    def _direction(self, x: FloatArray, slope: FloatArray) -> FloatArray:
        """The step to the minimum of the model, contact rows one-sided in it."""
        rows = self._active_rows
        if self._contact is None or rows is None:
            return np.asarray(self._factor.solve(slope))
        gaps = self._contact.gaps(x)
        step, active = rows.minimise(slope, gaps, gaps <= 0.0)
        for _ in range(_FACTORISATIONS):
            if step is not None:
                break
            self._pushing = active
            self._factor = self._factorised(self._touching)
            if self._factor is None:
                return np.zeros_like(slope)
            step, active = rows.minimise(slope, gaps, active)
        self._pushing = active
        # Too many rows come and go: the step of those that push now, which always descends.
        if step is None:
            self._pushing = gaps <= 0.0
            self._factor = self._factorised(self._touching)
            return np.zeros_like(slope) if self._factor is None else np.asarray(self._factor.solve(slope))
        return step

    def _gradient(self, x: FloatArray) -> FloatArray:
        """Gradient of the energies of cells, rows and contact at the nodes of the block (n_block, dim) [N]."""
        first = 0
        for term in self._terms:
            term.gradient(x, self._slots, first)
            first += term.cells.size
        return np.asarray(np.add.reduceat(self._slots[self._order], self._starts, axis=0))

    def _energy(self, x: FloatArray) -> tuple[float, float]:
        """Energy of cells, rows and obstacles around the block, and the sum of the sizes of its parts [J]."""
        parts = [term.value(x) for term in (*self._terms, *self._obstacles)]
        return sum(parts), sum(abs(part) for part in parts)

    def _nodal_difference(self, here: FloatArray, step: FloatArray, loads: FloatArray) -> float:
        """What a step changes in the energies of inertia and loads [J]."""
        pull = self._weights[:, None] * (here + 0.5 * step - self._centers) - loads
        return float(np.sum(pull * step))

    def _factorised(self, touching: FloatArray) -> Any:
        """Factors of the matrix at the present positions; None where it has none: a law may not be defined there."""
        n, d = len(self.nodes), self.dim
        own = np.zeros(self._size)
        matrix = scipy.sparse.csc_matrix((self._size, self._size))
        entries_of = (*self._entries, *self._contact_entries)
        for k, (term, entries) in enumerate(zip(self._terms, entries_of, strict=True)):
            blocks = np.empty((entries.n_blocks, d * d))
            if self._contact is not None and term is self._contact:
                self._contact.hessian(self._x, True, blocks, 0, self._pushing)
            else:
                term.hessian(self._x, True, blocks, 0)
            part = entries.matrix(blocks, self._size)
            matrix = matrix + part
            if k < len(self._cells):
                own += part.diagonal()
        local = np.broadcast_to(np.eye(d), (n, d, d)) * self._weights[:, None, None] + touching.reshape(n, d, d)
        dofs = self._dofs[self.nodes]
        rows = np.broadcast_to(dofs[:, :, None], local.shape).ravel()
        columns = np.broadcast_to(dofs[:, None, :], local.shape).ravel()
        kept = (rows >= 0) & (columns >= 0)
        shape = (self._size, self._size)
        matrix = matrix + scipy.sparse.csc_matrix((local.ravel()[kept], (rows[kept], columns[kept])), shape=shape)
        shift = _SHIFT * np.maximum(own, own.mean())
        matrix = (matrix + scipy.sparse.diags(shift)).tocsc()
        if not np.isfinite(matrix.data).all():
            return None
        # Symmetric and definite: the order that keeps it sparse may be kept, pivots are not needed.
        try:
            factor = scipy.sparse.linalg.splu(
                matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
            )
        except RuntimeError:  # singular: the block waits for what is around it
            return None
        if self._active_rows is not None and self._pushing is not None:
            self._active_rows.attach(factor, self._pushing)
        return factor


class _Entries:
    """Where the blocks of a term's cells go in the matrix of the block."""

    def __init__(self, cells: np.ndarray[Any, Any], dofs: IntArray) -> None:
        a, b = np.triu_indices(cells.shape[1])
        self.n_blocks = len(cells) * a.size
        first, second = dofs[cells[:, a]].reshape(self.n_blocks, -1), dofs[cells[:, b]].reshape(self.n_blocks, -1)
        d = dofs.shape[1]
        rows = np.broadcast_to(first[:, :, None], (self.n_blocks, d, d)).reshape(self.n_blocks, -1)
        columns = np.broadcast_to(second[:, None, :], (self.n_blocks, d, d)).reshape(self.n_blocks, -1)
        self._kept = (rows >= 0) & (columns >= 0)
        twice = np.broadcast_to(np.tile(a != b, len(cells))[:, None], rows.shape)
        self._rows, self._columns = rows[self._kept], columns[self._kept]
        self._off = twice[self._kept]

    def matrix(self, blocks: FloatArray, size: int) -> Any:
        """The sum of the blocks (n_blocks, dim^2) and, off the diagonal, of their transposes."""
        values = blocks[self._kept]
        rows = np.concatenate([self._rows, self._columns[self._off]])
        columns = np.concatenate([self._columns, self._rows[self._off]])
        return scipy.sparse.csc_matrix(
            (np.concatenate([values, values[self._off]]), (rows, columns)), shape=(size, size)
        )


def _around(group: LocalCells, is_mine: BoolArray) -> ElementGroup:
    """The cells of a law that have a node of the block."""
    chosen = np.flatnonzero(is_mine[group.cells].any(axis=1))
    return ElementGroup(
        "",
        "solid",
        group.law,
        np.ascontiguousarray(group.cells[chosen]),
        np.ascontiguousarray(group.gradients[chosen][:, None]),
        np.ascontiguousarray(group.volumes[chosen][:, None]),
        chosen,
        tuple(fibres.taken(chosen, len(group.cells)) for fibres in group.fibres),
    )
