"""Gauss-Seidel sweeps over the cells of a step problem, compiled, colour by colour: XPBD, B-PXPBD, FP-PXPBD."""

from __future__ import annotations

import numpy as np

from femdeform.errors import InputError
from femdeform.step_problem import LocalStepProblem
from femdeform.types import FloatArray, IntArray
from solvers.position_based import constraint_kernels, piola_kernels, wall_kernels
from solvers.position_based.cell_layout import CellBatch, CellLayout, lay_out_cells
from solvers.position_based.constraints import PAIRED, VANISHING
from solvers.position_based.nodal_blocks import is_bounded
from solvers.position_based.obstacle_kernels import ObstacleData, collect
from solvers.position_based.wall_kernels import WallData, collect_rows

# Sweeps after which base points, sums of many small changes, are made anew.
_REFRESH = 100
# (1 - zeta) kappa that blended sweeps bear for kappa up to 3: half of what the fixed corotated law alone does.
_BLEND = 0.05
# Where a node belongs to hundreds of cells, as on a grid, each of which pulls it to its base point in a sweep: nothing
# changes while the largest kappa is below the first number; beyond it, for the pulls of all cells act together,
# (1 - zeta) kappa of every cell has to be the second one over that of the cells of a node.
_CALM, _CROWDED = 0.4, 0.4


class CellSweep:
    """Positions and unknowns of the cells in a step, and the sweep; subclasses say what a visit to cells does.

    Parameters
    ----------
    problem : LocalStepProblem
    previous : CellSweep, optional
        Of an earlier step of the same problem, whose colours may serve again.

    Attributes
    ----------
    n_colors : int
        Colours of the cells, one threaded loop each.
    h2 : float
        Square of the time step of the sweep [s^2].
    """

    stride = 4
    blend = 1.0

    def __init__(self, problem: LocalStepProblem, previous: CellSweep | None = None) -> None:
        self._layout: CellLayout = lay_out_cells(problem, self.stride, None if previous is None else previous._layout)
        self.n_colors = self._layout.n_colors
        self.n_nodes, self.dim = problem.points.shape
        self._dim = (0,) * self.dim
        n = self.n_nodes
        order = self._layout.numbering.order
        self._x = np.zeros(self.stride * n)
        free = problem.free[order]
        mass = problem.lumped_mass[order]
        moves = free.any(axis=1)
        if np.any(mass[moves] <= 0.0):
            raise InputError("bodies: a sweep over the cells needs a mass at each node")
        self._fields()[:, 3] = np.where(moves, 1.0 / np.where(moves, mass, 1.0), 0.0)
        self._free = np.zeros((n, 3), dtype=np.uint8)
        self._free[:, : self.dim] = free
        self.h2 = 1.0
        self._obstacles: ObstacleData | None = None
        self._touched: IntArray = np.empty(0, dtype=np.int64)
        self._touched_rows: IntArray = np.empty(0, dtype=np.int64)
        self._touched_free = np.empty((0, 3), dtype=np.uint8)
        self._contact_forces = np.empty((0, 3))
        self._walls: WallData | None = None
        self._target = np.zeros((n, self.dim))

    def _fields(self) -> FloatArray:
        return self._x.reshape(self.n_nodes, self.stride)

    @property
    def batches(self) -> list[CellBatch]:
        """Cells by law."""
        return self._layout.batches

    # ----------------------------------------------------------------------------------------- a step

    def begin(self, problem: LocalStepProblem, target: FloatArray, dt: float) -> None:
        """Start from ``x = x~``, with no forces between cells.

        Parameters
        ----------
        problem : LocalStepProblem
            With the step begun.
        target : (n_nodes, dim) float64
            x~ [m], prescribed positions where they are.
        dt : float
            [s].
        """
        self.h2 = dt * dt
        fields = self._fields()
        self._target[:] = target[self._layout.numbering.order]
        fields[:, : self.dim] = self._target
        if self.stride > 4:
            fields[:, 4 : 4 + self.dim] = self._target
        contacts = problem.node_contacts()
        self._obstacles, self._walls = None, None
        if problem.rows is not None:
            self._walls = collect_rows(problem.rows, self._layout.numbering.place, self._free, self.dim)
        if contacts:
            data = collect(contacts, self._layout.numbering.place, self.dim)
            self._obstacles = data
            self._touched = np.flatnonzero(data.rows >= 0)
            self._touched_rows = data.rows[self._touched]
            self._touched_free = self._free[self._touched]
            self._contact_forces = np.zeros((self._touched.size, 3))
        self._forget()

    def shift_target(self, change: FloatArray) -> None:
        """Move x~ by (n_nodes, dim) [m], and what depends on it."""
        order = self._layout.numbering.order
        own = np.where(self._free[:, : self.dim] != 0, change[order], 0.0)
        self._target += own
        fields = self._fields()
        fields[:, : self.dim] += own
        if self.stride > 4:
            fields[:, 4 : 4 + self.dim] += own

    def read(self, out: FloatArray) -> None:
        """Write positions to ``out`` (n_nodes, dim)."""
        out[self._layout.numbering.order] = self._fields()[:, : self.dim]

    def sweep(self, reverse: bool = False) -> None:
        """Visit every cell once, colours in order or in reverse, then the nodes at obstacles."""
        colors = range(self.n_colors)
        for c in reversed(colors) if reverse else colors:
            for k, batch in enumerate(self.batches):
                first, last = int(batch.offsets[c]), int(batch.offsets[c + 1])
                if last > first:
                    self._visit(k, batch, first, last, reverse)
        walls = self._walls
        if walls is not None:
            wall_kernels.touch_walls(
                walls.nodes,
                walls.offsets,
                walls.normals,
                walls.targets,
                walls.stiffness,
                walls.two_sided,
                self.blend,
                self.stride > 4,
                self.h2,
                walls.free,
                self.stride,
                self._x,
                walls.forces,
            )
        data = self._obstacles
        if data is not None:
            piola_kernels.touch_obstacles(
                self._touched,
                self._touched_rows,
                self.blend,
                self.stride > 4,
                self.h2,
                self._touched_free,
                self.stride,
                data.kinds,
                data.shapes,
                data.shifts,
                data.slips,
                data.stiffness,
                data.limits,
                data.starts,
                data.normals,
                self._x,
                self._contact_forces,
            )

    def _forget(self) -> None:
        """Set the unknowns of the cells to zero."""
        raise NotImplementedError

    def _visit(self, k: int, batch: CellBatch, first: int, last: int, reverse: bool) -> None:
        """Update the cells of one colour and batch."""
        raise NotImplementedError


class ConstraintSweep(CellSweep):
    """XPBD and PBD.

    Parameters
    ----------
    problem : LocalStepProblem
    epsilon : float
        See `constraints`.
    rigid : bool
        PBD: infinite stiffness.
    root : bool
        One constraint a cell, the root of the energy, instead of two.

    Raises
    ------
    InputError
        If a law has no such constraints.
    """

    def __init__(
        self,
        problem: LocalStepProblem,
        epsilon: float = 1e-10,
        rigid: bool = False,
        root: bool = False,
        previous: CellSweep | None = None,
    ) -> None:
        super().__init__(problem, previous)
        self.epsilon, self.rigid, self.root = epsilon, rigid, root
        if not root:
            require_pairs(self.batches, VANISHING if rigid else PAIRED)
        self.multipliers = [np.zeros((len(batch.volumes), 2)) for batch in self.batches]

    def _forget(self) -> None:
        for multipliers in self.multipliers:
            multipliers[:] = 0.0

    def _visit(self, k: int, batch: CellBatch, first: int, last: int, reverse: bool) -> None:
        b = batch
        cells = (first, last, b.corners, b.gradients, b.volumes, b.masks, b.law, self._dim, self.h2, self.epsilon)
        if self.root:
            constraint_kernels.project_roots(*cells, self._x, self.multipliers[k])
        else:
            constraint_kernels.project_pairs(*cells, self.rigid, reverse, self._x, self.multipliers[k])


class _BasedSweep(CellSweep):
    """Sweeps that keep base points: x~ and what the cells do to each node, as they were last visited."""

    stride = 8

    def __init__(self, problem: LocalStepProblem, previous: CellSweep | None = None) -> None:
        super().__init__(problem, previous)
        dd = self.dim * self.dim
        self._held = [np.zeros((len(batch.volumes), dd)) for batch in self.batches]
        self._count = 0

    def _forget(self) -> None:
        for held in self._held:
            held[:] = 0.0
        self._count = 0

    def sweep(self, reverse: bool = False) -> None:
        """See `CellSweep`."""
        super().sweep(reverse)
        self._count += 1
        if self._count % _REFRESH == 0:
            self._refresh()

    def _push(self, k: int) -> FloatArray:
        """``w_i^-1`` times what each cell of a batch adds to the base points, without gradients (n_cells, d, d)."""
        raise NotImplementedError

    def _refresh(self) -> None:
        """Make the base points anew from what the cells hold."""
        dim, n = self.dim, self.n_nodes
        total = np.zeros((n, dim))
        for k, batch in enumerate(self.batches):
            total += batch.nodal_sums(self._push(k), self.stride, n)
        if self._obstacles is not None:
            total[self._touched] += self.h2 * self._contact_forces[:, :dim]
        if self._walls is not None:
            total[self._walls.nodes] += self.h2 * self._walls.forces[:, :dim]
        fields = self._fields()
        total *= fields[:, 3:4] * (self._free[:, :dim] != 0)
        fields[:, 4 : 4 + dim] = self._target + total


class BlendedSweep(_BasedSweep):
    """B-PXPBD, and XPBD with the primary residual kept.

    Parameters
    ----------
    problem : LocalStepProblem
    zeta : float, optional
        Part of XPBD, in [0, 1]; from the stiffness number of each cell where it is not given.
    epsilon : float
        See `constraints`.
    keep_residual : bool
        The comparison of eq. 5.11.

    Raises
    ------
    InputError
        If a law has no constraints.
    """

    def __init__(
        self,
        problem: LocalStepProblem,
        zeta: float | None = None,
        epsilon: float = 1e-10,
        keep_residual: bool = False,
        previous: CellSweep | None = None,
    ) -> None:
        super().__init__(problem, previous)
        require_pairs(self.batches, PAIRED)
        self.epsilon, self.keep_residual = epsilon, keep_residual
        self._wanted = 0.0 if keep_residual else zeta
        self.multipliers = [np.zeros((len(batch.volumes), 2)) for batch in self.batches]
        self.zeta = [np.zeros(len(batch.volumes)) for batch in self.batches]

    def _forget(self) -> None:
        super()._forget()
        for multipliers in self.multipliers:
            multipliers[:] = 0.0
        largest = max((float(batch.unit_kappa.max()) for batch in self.batches), default=0.0)
        calm = self.h2 * largest <= _CALM
        for zeta, batch in zip(self.zeta, self.batches, strict=True):
            zeta[:] = self._safe_zeta(batch, calm) if self._wanted is None else self._wanted
        self.blend = max((float(zeta.max()) for zeta in self.zeta if zeta.size), default=0.0)

    def _safe_zeta(self, batch: CellBatch, calm: bool) -> FloatArray:
        """Part of XPBD by the stiffness number of each cell."""
        kappa = self.h2 * batch.unit_kappa
        crowded = (batch.crowds > 0.0) & (not calm)
        bound = np.where(crowded, _CROWDED / np.maximum(batch.crowds, 1.0), _BLEND)
        return np.asarray(np.maximum(1.0 - bound / kappa, 0.0))

    def _push(self, k: int) -> FloatArray:
        return self._held[k].reshape(-1, self.dim, self.dim)

    def _visit(self, k: int, batch: CellBatch, first: int, last: int, reverse: bool) -> None:
        b = batch
        constraint_kernels.project_blended(
            first,
            last,
            b.corners,
            b.gradients,
            b.volumes,
            b.masks,
            b.law,
            self._dim,
            self.h2,
            self.epsilon,
            self.zeta[k],
            self.keep_residual,
            self._x,
            self.multipliers[k],
            self._held[k],
        )


class PiolaSweep(_BasedSweep):
    """FP-PXPBD.

    Parameters
    ----------
    problem : LocalStepProblem
    local : int
        Steps of Newton's method a visit.
    exact : bool
        With the projected tangent instead of its model.
    search : bool, optional
        Whether steps are halved where a cell's energy rises; by law where not given.
    """

    blend = 0.0

    def __init__(
        self,
        problem: LocalStepProblem,
        local: int = 3,
        exact: bool = False,
        search: bool | None = None,
        previous: CellSweep | None = None,
    ) -> None:
        super().__init__(problem, previous)
        self.local, self.exact = local, exact
        self._search = [(exact or not is_bounded(batch.law)) if search is None else search for batch in self.batches]

    @property
    def stresses(self) -> list[FloatArray]:
        """P of the cells of each batch as it is in the base points (n_cells, dim dim) [Pa]."""
        return self._held

    def _push(self, k: int) -> FloatArray:
        P = self._held[k].reshape(-1, self.dim, self.dim)
        return -self.h2 * self.batches[k].volumes[:, None, None] * P

    def _visit(self, k: int, batch: CellBatch, first: int, last: int, reverse: bool) -> None:
        b = batch
        piola_kernels.relax_cells(
            first,
            last,
            b.corners,
            b.gradients,
            b.volumes,
            b.masks,
            b.law,
            self._dim,
            self.h2,
            self.local,
            self.exact,
            self._search[k],
            self._x,
            self._held[k],
        )


def require_pairs(batches: list[CellBatch], known: tuple[type, ...]) -> None:
    """Refuse laws that are not among those known as pairs of constraints.

    Raises
    ------
    InputError
    """
    for batch in batches:
        if not isinstance(batch.law, known):
            names = ", ".join(kind.__name__ for kind in known)
            raise InputError(f"material.law: no constraints of {type(batch.law).__name__}; known are {names}")
