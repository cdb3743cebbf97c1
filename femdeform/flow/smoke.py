"""Smoke that rises in air: the step of an incompressible flow with buoyancy, sources and moving solids."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from femdeform.errors import NotConvergedError
from femdeform.flow.inlets import Inlet
from femdeform.flow.mac_grid import MACGrid, PressureSolver, ProjectionReport, sides
from femdeform.flow.pressure_system import AIR, SOLID, PressureSystem
from femdeform.types import FloatArray

# Voxels that what is advected may cross in a step: beyond, trajectories of one midpoint step mean little.
LARGEST_COURANT = 3.0
# Parts that a step may be divided into: a speed that asks for more is a fault of the scene, or the flow has burst.
MOST_PARTS = 100


@dataclass(frozen=True)
class Source:
    """A region that gives off smoke.

    Attributes
    ----------
    voxels : (nx, ny, nz) bool
    density : float
        Density of the smoke there [-].
    velocity : tuple of float, optional
        Velocity that the region is given before each projection [m/s]: it stirs, nothing enters through it. None leaves
        it to the flow.
    end : float
        Time at which it stops [s].
    """

    voxels: NDArray[np.bool_]
    density: float = 1.0
    velocity: tuple[float, ...] | None = None
    end: float = math.inf


@dataclass(frozen=True)
class MovingSolid:
    """A solid that turns and moves as one.

    Attributes
    ----------
    voxels : callable
        Time [s] to (nx, ny, nz) bool.
    velocity : callable
        Time [s] and points (..., dim) [m] to velocities of the same shape [m/s].
    """

    voxels: Callable[[float], NDArray[np.bool_]]
    velocity: Callable[[float, FloatArray], FloatArray]


@dataclass
class SmokeFlow:
    """Smoke carried by an incompressible flow without viscosity.

    A step: velocity and smoke are carried along, buoyancy lifts the smoke, solids and inlets push, a pressure takes the
    divergence away. Steps in which something would cross more than `LARGEST_COURANT` voxels are divided, see
    `n_substeps`.

    Attributes
    ----------
    grid : MACGrid
    solid : (nx, ny, nz) bool
        Voxels that are solid and stay.
    air : (nx, ny, nz) bool
        Voxels of air at constant pressure, through which fluid comes and goes.
    make_solver : callable
        `PressureSystem` to a solver; called when the voxels' labels change.
    buoyancy : float
        Acceleration of smoke of density 1 upwards, along y [m/s^2].
    sources : sequence of Source
    moving : sequence of MovingSolid
    inlets : sequence of Inlet
        Their faces keep their velocity where no solid covers them.
    tolerance : float
        Of the pressure: residual over its right-hand side [-].
    max_iterations : int

    References
    ----------
    J. Stam, Stable fluids (1999). R. Fedkiw, J. Stam, H. W. Jensen, Visual simulation of smoke (2001), for buoyancy.

    Limitations
    -----------
    As those of `MACGrid`. Smoke that a moving solid runs over is lost. Parts of a step are counted at its beginning.
    """

    grid: MACGrid
    solid: NDArray[np.bool_]
    air: NDArray[np.bool_]
    make_solver: Callable[[PressureSystem], PressureSolver]
    buoyancy: float = 2.0
    sources: Sequence[Source] = ()
    moving: Sequence[MovingSolid] = ()
    inlets: Sequence[Inlet] = ()
    tolerance: float = 1e-4
    max_iterations: int = 1000
    time: float = 0.0
    density: FloatArray = field(init=False)
    system: PressureSystem = field(init=False)

    def __post_init__(self) -> None:
        self.density = np.zeros(self.grid.shape)
        self._solver: PressureSolver | None = None
        self._labels: NDArray[np.uint8] | None = None
        self._take_labels()

    def _take_labels(self) -> None:
        """Make the pressure system of this moment; nothing if no voxel has changed."""
        labels = np.where(self.air, AIR, 0).astype(np.uint8)
        labels[self.solid] = SOLID
        for solid in self.moving:
            labels[solid.voxels(self.time)] = SOLID
        if self._labels is not None and np.array_equal(labels, self._labels):
            return
        self._labels = labels
        self.system = PressureSystem(labels)
        self.destroy()
        self._solver = self.make_solver(self.system)

    def destroy(self) -> None:
        """Free what the solver holds."""
        if self._solver is not None:
            self._solver.destroy()
            self._solver = None

    def put(self, velocity: Sequence[FloatArray], density: FloatArray, time: float) -> None:
        """Go to a state: velocities of the faces [m/s], density of smoke (nx, ny, nz) [-] and time [s], as copies."""
        for component, values in zip(self.grid.velocity, velocity, strict=True):
            component[...] = values
        self.density = density.copy()
        self.time = time
        self._take_labels()

    @property
    def is_solid(self) -> NDArray[np.bool_]:
        """Voxels that are solid now, (nx, ny, nz)."""
        return np.asarray(self.system.labels[1:-1, 1:-1, 1:-1] == SOLID)

    def largest_speed(self) -> tuple[float, str]:
        """Largest velocity component of flow, sources, inlets and moving solids now [m/s], and which of them has it."""
        centres = self.grid.centres()
        given = [("the flow", self.grid.largest_speed())]
        given += [
            ("a source", max(map(abs, source.velocity), default=0.0))
            for source in self.sources
            if source.velocity is not None and self._gives_off(source, self.time) and source.voxels.any()
        ]
        given += [("an inlet", max(map(abs, inlet.velocity))) for inlet in self.inlets if inlet.faces.any()]
        for solid in self.moving:
            velocity = solid.velocity(self.time, centres)[solid.voxels(self.time)]
            given.append(("a solid", float(np.abs(velocity).max(initial=0.0))))
        # What is no number is larger than all.
        what, speed = max(given, key=lambda pair: pair[1] if math.isfinite(pair[1]) else math.inf)
        return speed, what

    def n_substeps(self, dt: float) -> int:
        """Number of parts that a step has to be taken in.

        Raises
        ------
        NotConvergedError
            If there are more than `MOST_PARTS`.
        """
        speed, what = self.largest_speed()
        parts = dt * speed / (LARGEST_COURANT * self.grid.spacing)
        if not parts <= MOST_PARTS:
            raise NotConvergedError(
                f"{what} moves with {speed:.3g} m/s, across {dt * speed / self.grid.spacing:.3g} voxels in a step of "
                f"{dt:.3g} s; {LARGEST_COURANT * MOST_PARTS:g} is the most, in {MOST_PARTS} parts"
            )
        return max(1, math.ceil(parts))

    def step(self, dt: float) -> list[ProjectionReport]:
        """Advance by a step [s], in parts where speed asks for it; what each projection has done.

        Raises
        ------
        NotConvergedError
            As `n_substeps`.
        """
        n = self.n_substeps(dt)
        return [self._advance(dt / n) for _ in range(n)]

    def _advance(self, dt: float) -> ProjectionReport:
        grid = self.grid
        is_solid = self.is_solid
        inlets = self._open_inlets(is_solid)
        density = grid.carry(self.density, is_solid, dt, inlets)
        grid.advect(dt, inlets)
        start = self.time
        self.time += dt
        self._take_labels()
        is_solid = self.is_solid
        density[is_solid] = 0.0
        # Beside an inlet without smoke, rounding of the interpolation may fall below.
        self.density = np.maximum(density, 0.0, out=density)
        for source in self.sources:
            if self._gives_off(source, start):
                self._apply(source, is_solid)
        self._lift(dt)
        self.hold_solids()
        for inlet in self._open_inlets(is_solid):
            inlet.hold(grid.velocity)
        assert self._solver is not None
        report = grid.project(self.system, self._solver, self.tolerance, self.max_iterations)
        grid.fill_air(self.system)
        return report

    def _open_inlets(self, is_solid: NDArray[np.bool_]) -> list[Inlet]:
        return [inlet.beside(is_solid) for inlet in self.inlets]

    @staticmethod
    def _gives_off(source: Source, start: float) -> bool:
        """Whether a step belongs to a source: it does if it begins before the source's end."""
        return start < source.end * (1.0 - 1e-12)

    def _apply(self, source: Source, is_solid: NDArray[np.bool_]) -> None:
        voxels = source.voxels & ~is_solid
        self.density[voxels] = source.density
        if source.velocity is not None:
            padded = np.pad(voxels, 1)
            for axis, value in enumerate(source.velocity):
                self.grid.velocity[axis][np.logical_or(*sides(padded, axis))] = value

    def _lift(self, dt: float) -> None:
        """Buoyancy along y, on faces from the mean of the voxels beside them."""
        self.grid.velocity[1][:, 1:-1] += 0.5 * dt * self.buoyancy * (self.density[:, 1:] + self.density[:, :-1])

    def hold_solids(self) -> None:
        """Give faces of solids the solids' velocity."""
        grid = self.grid
        grid.hold_at_solids(self.system)
        resting = np.pad(self.solid, 1, constant_values=True)
        for solid in self.moving:
            moving = np.pad(solid.voxels(self.time) & ~self.solid, 1)
            for axis in range(grid.dim):
                # Where a resting solid, or a wall, is beside the moving one, the resting one holds.
                held = np.logical_or(*sides(moving, axis)) & ~np.logical_or(*sides(resting, axis))
                velocity = solid.velocity(self.time, grid.face_centres(axis))
                grid.velocity[axis][held] = velocity[..., axis][held]
