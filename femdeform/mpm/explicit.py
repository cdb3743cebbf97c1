"""The explicit step of material points: transfers, forces and walls on a grid of blocks, symplectic Euler.

One step: points bring mass, momentum and the impulse of their stress to the nodes,
``m_i v_i = sum N m_p (v_p + A_p (x_i - x_p)) - dt sum V0 P F^T grad N + dt m_i g``; walls act on the nodes; the points
take velocities, deformations ``F <- (I + dt sum v_i grad N^T) F`` and positions ``x += dt sum N v_i`` from them. With
FLIP, or viscosity, which needs the gradient of the velocity before the forces, there are two passes to the nodes.

References
----------
C. Jiang, C. Schroeder, A. Selle, J. Teran, A. Stomakhin, The affine particle-in-cell method (2015). D. Sulsky, Z. Chen,
H. Schreyer, A particle method for history-dependent materials (1994). M. Gao, X. Wang, K. Wu, A. Pradhana, E. Sifakis,
C. Yuksel, C. Jiang, GPU optimization of material point methods (2018), for blocks.

Limitations
-----------
No surface tension and no heat: those take the stored stencils of `mpm.groups`. Bodies that share nodes stick together
while they touch. The step has to resolve sound, see `mpm.time_step`. With float32 positions are relative to the origin
of the axes: 2^-24 of the largest coordinate is what can be told apart.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from femdeform.errors import InputError
from femdeform.mpm.block_grid import BlockGrid, PointSet
from femdeform.mpm.block_kernels_2d import advance_2d, look_2d, scatter_2d
from femdeform.mpm.block_kernels_3d import advance_3d, look_3d, scatter_3d
from femdeform.mpm.explicit_laws import is_viscous, material_sets
from femdeform.mpm.particles import Particles
from femdeform.mpm.rigid_walls import RigidWall, constrain_blocks
from femdeform.types import FloatArray

Transfer = Literal["pic", "flip", "apic"]
_SCATTER: Mapping[int, Callable[..., None]] = {2: scatter_2d, 3: scatter_3d}
_LOOK: Mapping[int, Callable[..., None]] = {2: look_2d, 3: look_3d}
_ADVANCE: Mapping[int, Callable[..., None]] = {2: advance_2d, 3: advance_3d}


class ExplicitPoints:
    """Material points that are advanced by explicit steps.

    Parameters
    ----------
    particles : Particles
        The points; copied.
    laws : mapping of (int, int) to NamedTuple
        Material of each body and phase that occurs, by ``(body, phase)``: a law of `femdeform.materials` for solids,
        `Liquid` for liquids.
    spacing : float
        Distance of the grid nodes [m]; node i lies at ``i spacing``.
    low, high : (dim,) array
        The domain [m]; points have to stay in it.
    transfer : str
        ``pic``, ``flip`` or ``apic``.
    flip : float
        Part of FLIP in a blend with PIC, for ``flip`` [-].
    gravity : (dim,) array, optional
        [m/s^2].
    walls : sequence of RigidWall
    dtype : type
        float64 or float32, of points and nodes.

    Attributes
    ----------
    time : float
        [s].
    n_steps : int
    fastest_node : float
        Largest speed of a node after the last step's walls [m/s].
    n_bounded : int
        How often, in all steps, the J of a liquid point was kept in [0.1, 10].
    grid : BlockGrid
        Its fields are those of the last step.
    sets : list of PointSet

    Raises
    ------
    InputError
        If a material is missing, or a number is out of range.
    """

    def __init__(
        self,
        particles: Particles,
        laws: Mapping[tuple[int, int], Any],
        spacing: float,
        low: FloatArray,
        high: FloatArray,
        *,
        transfer: Transfer = "apic",
        flip: float = 0.95,
        gravity: FloatArray | None = None,
        walls: Sequence[RigidWall] = (),
        dtype: Any = np.float64,
    ) -> None:
        if transfer not in ("pic", "flip", "apic"):
            raise InputError(f"transfer: expected `pic`, `flip` or `apic`, got {transfer!r}")
        if not 0.0 <= flip <= 1.0:
            raise InputError(f"flip: expected a number in [0, 1], got {flip:g}")
        self.dim = particles.dim
        self.grid = BlockGrid(spacing, low, high, dtype)
        self.transfer, self._flip = transfer, flip if transfer == "flip" else 0.0
        self.gravity = np.zeros(self.dim) if gravity is None else np.array(gravity, dtype=float)
        self.walls = list(walls)
        self.time, self.n_steps, self.fastest_node, self.n_bounded = 0.0, 0, 0.0, 0
        self._laws = dict(laws)
        self.sets: list[PointSet] = []
        self.replace(particles)

    def replace(self, particles: Particles) -> None:
        """Go on with other points: after a change of phase, say. They are copied, and sorted in the next step.

        Raises
        ------
        InputError
            If a body has no material for a phase of its points.
        """
        materials = material_sets(particles, self._laws)
        self._template = particles
        self._largest_mass = float(particles.mass.max(initial=0.0))
        self.sets = [PointSet.of(particles, rows, law, self.grid.dtype) for rows, law in materials]
        if self.transfer != "apic":
            for points in self.sets:
                points.affine[:] = 0.0

    @property
    def n(self) -> int:
        """Number of points."""
        return sum(points.n for points in self.sets)

    def particles(self) -> Particles:
        """The points as they are, in the order in which they came; temperatures are those they came with."""
        template = self._template
        out = replace(
            template,
            x=np.empty_like(template.x),
            v=np.empty_like(template.v),
            affine=np.empty_like(template.affine),
            J=template.J.copy(),
            F=template.F.copy(),
        )
        for points in self.sets:
            rows = points.numbers
            out.x[rows], out.v[rows], out.affine[rows] = points.x, points.v, points.affine
            (out.J if points.state.ndim == 1 else out.F)[rows] = points.state
        return out

    def fastest_point(self) -> float:
        """Largest speed of a point [m/s]."""
        speeds = [float(np.max(np.einsum("pc,pc->p", points.v, points.v), initial=0.0)) for points in self.sets]
        return float(np.sqrt(max(speeds, default=0.0)))

    # ---------------------------------------------------------------------------------------------- the step

    def step(self, dt: float) -> None:
        """Advance by one step [s].

        Raises
        ------
        PointsOutsideError
            If points are outside of the domain, or no longer numbers; nothing has changed then.
        """
        self.sort()
        self.to_grid(dt)
        constrain_blocks(self.walls, self.grid, self.time + dt)
        self.to_points(dt)
        self.fastest_node = self.grid.fastest()
        self.time += dt
        self.n_steps += 1

    def sort(self) -> None:
        """Sort the points and lay the blocks around them; see `step`."""
        self.grid.activate(self.sets)

    def to_grid(self, dt: float) -> None:
        """Bring mass, momentum, forces and gravity to the nodes."""
        grid, push = self.grid, dt * self.gravity
        looks = self._flip != 0.0 or any(is_viscous(points.law) for points in self.sets)
        none = np.empty((0, self.dim, self.dim), grid.dtype)
        if not looks:
            for number, points in enumerate(self.sets):
                self._scatter(points, none, 1.0, dt, number == 0)
            grid.collect(push, False, self._largest_mass)
            return
        for number, points in enumerate(self.sets):
            self._scatter(points, none, 1.0, 0.0, number == 0)
        grid.collect(np.zeros(self.dim), False, self._largest_mass)
        self._excess = [np.empty_like(points.v if self._flip != 0.0 else points.v[:0]) for points in self.sets]
        for number, points in enumerate(self.sets):
            gradient = np.empty_like(points.affine) if is_viscous(points.law) else none
            _LOOK[self.dim](
                points.x,
                points.v,
                grid.spacing,
                points.order,
                points.starts,
                grid.corners,
                grid.near,
                grid.sources,
                grid.velocity,
                self._excess[number],
                gradient,
            )
            self._scatter(points, gradient, 0.0, dt, number == 0)
        grid.collect(push, True, self._largest_mass)

    def _scatter(self, points: PointSet, gradient: FloatArray, carried: float, dt: float, clears: bool) -> None:
        grid = self.grid
        _SCATTER[self.dim](
            points.x,
            points.v,
            points.affine,
            points.state,
            points.mass,
            points.volume,
            gradient,
            points.law,
            carried,
            dt,
            grid.spacing,
            points.order,
            points.starts,
            grid.corners,
            clears,
            grid.arena,
        )

    def to_points(self, dt: float) -> None:
        """Take velocities, deformations and positions from the nodes."""
        grid = self.grid
        for number, points in enumerate(self.sets):
            n_bounded = np.zeros(grid.blocks.size, np.int64)
            _ADVANCE[self.dim](
                points.x,
                points.v,
                points.affine,
                points.state,
                self._excess[number] if self._flip != 0.0 else points.v[:0],
                self._flip,
                self.transfer == "apic",
                points.law,
                dt,
                grid.spacing,
                points.order,
                points.starts,
                grid.corners,
                grid.near,
                grid.sources,
                grid.velocity,
                n_bounded,
            )
            self.n_bounded += int(n_bounded.sum())
