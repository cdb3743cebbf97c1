"""Gauss-Seidel sweeps over the cells of a step problem and its weak constraints, compiled, colour by colour."""

from __future__ import annotations

import math

import numpy as np

from femdeform.errors import InputError
from femdeform.step_problem import Feature, LocalStepProblem
from femdeform.types import FloatArray, IntArray
from solvers.position_based import link_kernels, piola_kernels, wall_kernels
from solvers.position_based.cell_layout import CellBatch, CellLayout, lay_out_cells
from solvers.position_based.link_sweep import LinkSweep
from solvers.position_based.obstacle_kernels import ObstacleData, collect
from solvers.position_based.thin_sweep import ThinSweep
from solvers.position_based.wall_kernels import WallData, collect_rows

# Sweeps after which base points, sums of many small changes, are made anew.
_REFRESH = 100


class CellSweep:
    """Positions and unknowns of the cells in a step, and the sweep; subclasses say what a visit to cells does.

    Parameters
    ----------
    problem : LocalStepProblem
    rigid : bool
        PBD: infinite stiffness.
    previous : CellSweep, optional
        Of an earlier step of the same problem, whose colours may serve again.

    Attributes
    ----------
    n_colors : int
        Colours of the cells, one threaded loop each.
    h2 : float
        Square of the time step of the sweep [s^2].
    links_first : bool
        Weak constraints before the cells, not after them.
    needs_kappa : bool
        Whether the layout has stiffness numbers of cells.
    has_residual_parts : bool
        Whether `residual_parts` can be had: PBD has no multipliers.
    """

    stride = 4
    blend = 1.0
    link_mode = link_kernels.PLAIN
    knows = frozenset[Feature]({"links"})
    needs_kappa = False

    def __init__(self, problem: LocalStepProblem, rigid: bool = False, previous: CellSweep | None = None) -> None:
        earlier = None if previous is None else previous._layout
        self._layout: CellLayout = lay_out_cells(problem, self.stride, self.knows, earlier, self.needs_kappa)
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
        self.links_first = False
        self.has_residual_parts = not rigid
        self._links: LinkSweep | None = None
        if problem.links is not None:
            place = self._layout.numbering.place
            self._links = LinkSweep(problem.links, place, self._free, self.stride, self.link_mode, rigid)
        self._thin = [
            ThinSweep(thin, self._layout.numbering.place, self._free, self.stride, rigid)
            for thin in problem.constraints
        ]
        self._obstacles: ObstacleData | None = None
        self._touched: IntArray = np.empty(0, dtype=np.int64)
        self._touched_rows: IntArray = np.empty(0, dtype=np.int64)
        self._touched_free = np.empty((0, 3), dtype=np.uint8)
        self._contact_forces = np.empty((0, 3))
        self._walls: WallData | None = None
        self._target = np.zeros((n, self.dim))
        self._follower = np.zeros((n, self.dim))

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
        self._follower[:] = 0.0
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
        if self._links is not None:
            self._links.begin()
        for thin in self._thin:
            thin.begin()
        self._forget()

    def follow(self, forces: FloatArray) -> None:
        """Take forces (n_nodes, dim) [N] into x~ in place of those given before, and move what depends on it."""
        order = self._layout.numbering.order
        fields = self._fields()
        change = self.h2 * fields[:, 3:4] * (forces[order] - self._follower)
        own = np.where(self._free[:, : self.dim] != 0, change, 0.0)
        self._follower[:] = forces[order]
        self._target += own
        fields[:, : self.dim] += own
        if self.stride > 4:
            fields[:, 4 : 4 + self.dim] += own

    def read(self, out: FloatArray) -> None:
        """Write positions to ``out`` (n_nodes, dim)."""
        out[self._layout.numbering.order] = self._fields()[:, : self.dim]

    def advice(self) -> str:
        """What to do where sweeps do not get on, in words; empty if their stiffness number is not to blame."""
        return ""

    def sweep(self, reverse: bool = False) -> None:
        """Visit every cell once, colours in order or in reverse, weak constraints, then the nodes at obstacles."""
        if self._links is not None and self.links_first:
            self._links.sweep(self._x, self.h2, reverse)
        colors = range(self.n_colors)
        for c in reversed(colors) if reverse else colors:
            for k, batch in enumerate(self.batches):
                first, last = int(batch.offsets[c]), int(batch.offsets[c + 1])
                if last > first:
                    self._visit(k, batch, first, last, reverse)
        for thin in self._thin:
            thin.sweep(self._x, self.h2, reverse)
        if self._links is not None and not self.links_first:
            self._links.sweep(self._x, self.h2, reverse)
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

    def residual_parts(self, problem: LocalStepProblem) -> tuple[FloatArray, FloatArray]:
        """What multipliers and positions leave of the equations of motion, and what the multipliers lack.

        The primary residual is ``(m (x - x~) - sum l grad C) / h^2``, the secondary one ``sum (C / alpha + l / h^2)
        grad C``, both with gradients at the present positions; stresses, forces of contact and those of pressure in x~
        take the place of multipliers. They add up to the residual of the problem.

        Parameters
        ----------
        problem : LocalStepProblem
            With the step begun.

        Returns
        -------
        primary, secondary : (n_nodes, dim) float64
            [N], zero where components are prescribed.
        """
        n, dim = self.n_nodes, self.dim
        held, missing = np.zeros((n, dim)), np.zeros((n, dim))
        fields = self._fields()
        points = fields[:, :dim]
        for k, batch in enumerate(self.batches):
            parts = np.empty((2, len(batch.volumes), dim * dim))
            self._measure(k, batch, parts[0], parts[1])
            held += batch.nodal_sums(parts[0], self.stride, n)
            missing += batch.nodal_sums(parts[1], self.stride, n)
            self._measure_further(k, points, held, missing)
        if self._links is not None:
            self._links.defects(points, self.h2, held, missing)
        for thin in self._thin:
            thin.defects(np.ascontiguousarray(points), self.h2, held, missing)
        order = self._layout.numbering.order
        x = np.empty((n, dim))
        x[order] = points
        follower = problem.follower_forces(x)
        if follower is not None:
            missing += self.h2 * (self._follower - follower[order])
        if self._obstacles is not None:
            push = np.zeros((n, dim))
            for contact in problem.node_contacts():
                contact.add_gradient(x, push)
            held[self._touched] += self.h2 * self._contact_forces[:, :dim]
            missing += self.h2 * push[order]
            missing[self._touched] += self.h2 * self._contact_forces[:, :dim]
        if self._walls is not None:
            push = np.zeros((n, dim))
            if problem.rows is not None:
                problem.rows.add_gradient(x, push)
            held[self._walls.nodes] += self.h2 * self._walls.forces[:, :dim]
            missing += self.h2 * push[order]
            missing[self._walls.nodes] += self.h2 * self._walls.forces[:, :dim]
        free = self._free[:, :dim] != 0
        mass = np.divide(1.0, fields[:, 3:4], out=np.zeros((n, 1)), where=fields[:, 3:4] > 0.0)
        primary, secondary = np.zeros((n, dim)), np.zeros((n, dim))
        primary[order] = np.where(free, mass * (points - self._target) - held, 0.0) / self.h2
        secondary[order] = np.where(free, missing, 0.0) / self.h2
        return primary, secondary

    def _measure(self, k: int, batch: CellBatch, held: FloatArray, missing: FloatArray) -> None:
        """Write what the cells of a batch hold and lack, (n_cells, dim dim) [kg m^2]; see `residual_kernels`."""
        raise NotImplementedError

    def _measure_further(self, k: int, points: FloatArray, held: FloatArray, missing: FloatArray) -> None:
        """Add what else the cells of a batch hold and lack at positions (n_nodes, dim) by place, (n_nodes, dim)."""

    def _forget(self) -> None:
        """Set the unknowns of the cells to zero."""
        raise NotImplementedError

    def _visit(self, k: int, batch: CellBatch, first: int, last: int, reverse: bool) -> None:
        """Update the cells of one colour and batch."""
        raise NotImplementedError


class BasedSweep(CellSweep):
    """Sweeps that keep base points: x~ and what the cells do to each node, as they were last visited."""

    stride = 8
    needs_kappa = True  # for the advice
    # Stiffness number below which these sweeps converge in tens, on meshes and on a grid.
    quick_below = (1.0, 0.4)

    def __init__(self, problem: LocalStepProblem, previous: CellSweep | None = None) -> None:
        super().__init__(problem, previous=previous)
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
        """``w_i^-1`` times what each cell of a batch adds to the base points, without gradients (n_cells, d d)."""
        raise NotImplementedError

    def advice(self) -> str:
        """See `CellSweep`."""
        text, worst = "", 1.0
        for batch in self.batches:
            kappa = self.h2 * float(batch.unit_kappa.max(initial=0.0))
            limit = self.quick_below[int(bool(np.any(batch.crowds > 0.0)))]
            if kappa > worst * limit:
                worst = kappa / limit
                longest = math.sqrt(self.h2 / worst)
                # Two digits, rounded down: the number must be below the limit.
                unit = 10.0 ** (math.floor(math.log10(longest)) - 1)
                longest = math.floor(longest / unit) * unit
                text = f"stiffness number {kappa:.3g}, quick below {limit:g}: steps of at most {longest:.2g} s"
        return text

    def _add_further(self, k: int, total: FloatArray) -> None:
        """Add what else the cells of a batch do to the base points, over w_i (n_nodes, dim) by place."""

    def _refresh(self) -> None:
        """Make the base points anew from what the cells hold."""
        dim, n = self.dim, self.n_nodes
        total = np.zeros((n, dim))
        for k, batch in enumerate(self.batches):
            total += batch.nodal_sums(self._push(k), self.stride, n)
            self._add_further(k, total)
        if self._links is not None:
            self._links.add_held(total)
        if self._obstacles is not None:
            total[self._touched] += self.h2 * self._contact_forces[:, :dim]
        if self._walls is not None:
            total[self._walls.nodes] += self.h2 * self._walls.forces[:, :dim]
        fields = self._fields()
        total *= fields[:, 3:4] * (self._free[:, :dim] != 0)
        fields[:, 4 : 4 + dim] = self._target + total
