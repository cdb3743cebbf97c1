"""Velocity on the faces of a grid, and its projection onto flow without divergence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from femdeform.flow.advection import advect_component, advect_scalar
from femdeform.flow.inlets import Inlet, surrounded
from femdeform.flow.pressure_system import AIR, SOLID, GridArray, PressureSystem
from femdeform.types import FloatArray


class PressureAnswer(Protocol):
    """What a pressure solver answers."""

    x: GridArray
    iterations: int
    converged: bool
    reason: str
    residuals: list[float]


class PressureSolver(Protocol):
    """What solves A q = b; see `solvers.linear.poisson`."""

    def solve(self, b: GridArray, tolerance: float, max_iterations: int, x: GridArray | None = None) -> PressureAnswer:
        """Solve to |r| <= tolerance |b|."""

    def destroy(self) -> None:
        """Free what Python does not."""


@dataclass
class ProjectionReport:
    """What a projection has done.

    Attributes
    ----------
    iterations : int
        Of the pressure solver.
    converged : bool
        Whether it reached its tolerance.
    reason : str
        Why it stopped.
    divergence_before, divergence_after : float
        Largest divergence of a voxel with an unknown [1/s].
    imbalance : float
        Largest mean divergence of a closed component, which no pressure can take away: that of an inlet without an
        outlet [1/s].
    relative_residual : float
        Residual of the pressure over its right-hand side [-].
    q : (nx + 2, ny + 2, nz + 2) float64
        The pressure as `PressureSystem` has it, dt p / (rho h) [m/s].
    """

    iterations: int
    converged: bool
    reason: str
    divergence_before: float
    divergence_after: float
    imbalance: float
    relative_residual: float
    q: GridArray


class MACGrid:
    """Velocity components on the faces that they cross.

    Parameters
    ----------
    shape : sequence of int
        Voxels along each axis, two or three numbers.
    spacing : float
        Side of a voxel, h [m].
    origin : sequence of float, optional
        Lower corner of the grid [m]; default 0.

    Attributes
    ----------
    velocity : list of 3 arrays
        (nx + 1, ny, nz), (nx, ny + 1, nz), (nx, ny, nz + 1) float64 [m/s]; in two dimensions nz = 1 and the last is
        zero.

    References
    ----------
    F. H. Harlow, J. E. Welch, Numerical calculation of time-dependent viscous incompressible flow of fluid with free
    surface (1965). A. J. Chorin, Numerical solution of the Navier-Stokes equations (1968). J. Stam, Stable fluids
    (1999).

    Limitations
    -----------
    Walls are where voxels end, and hold the fluid beside them as if it stuck half a voxel inside. Advection and
    splitting are of first order, and smear what is finer than a few voxels.
    """

    def __init__(self, shape: Sequence[int], spacing: float, origin: Sequence[float] | None = None) -> None:
        self.dim = len(shape)
        if self.dim not in (2, 3) or min(shape) < 1 or not spacing > 0.0:
            raise ValueError(f"a grid has 2 or 3 numbers of voxels and a spacing, not {tuple(shape)} and {spacing}")
        nx, ny, nz = (*(int(n) for n in shape), 1)[:3]
        self.shape = (nx, ny, nz)
        self.spacing = float(spacing)
        self.origin = np.array([*(origin if origin is not None else [0.0] * self.dim), 0.0][:3], dtype=float)
        self.velocity = [np.zeros((nx + 1, ny, nz)), np.zeros((nx, ny + 1, nz)), np.zeros((nx, ny, nz + 1))]
        self._moved = [component.copy() for component in self.velocity]

    def centres(self) -> FloatArray:
        """Centres of the voxels [m], (nx, ny, nz, dim)."""
        return self._places([0.5, 0.5, 0.5], self.shape)

    def face_centres(self, axis: int) -> FloatArray:
        """Centres of the faces across an axis [m], (..., dim), ordered as that component."""
        offsets = [0.0 if d == axis else 0.5 for d in range(3)]
        return self._places(offsets, self.velocity[axis].shape)

    def _places(self, offsets: Sequence[float], shape: Sequence[int]) -> FloatArray:
        lines = [self.origin[d] + self.spacing * (np.arange(shape[d]) + offsets[d]) for d in range(self.dim)]
        lines += [np.zeros(1)] * (3 - self.dim)
        return np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1)[..., : self.dim]

    def largest_speed(self) -> float:
        """Largest velocity component on a face [m/s]; no number where one of them is none."""
        return float(np.max([np.abs(component).max(initial=0.0) for component in self.velocity]))

    # ----------------------------------------------------------------------------------------- advection

    def advect(self, dt: float, inlets: Sequence[Inlet] = ()) -> None:
        """Carry the velocity along with itself over a step [s]; what comes in through inlets has their velocity."""
        u, v, w = self.velocity
        for axis in range(self.dim):
            around = surrounded(self.velocity[axis], self.dim, axis, inlets)
            advect_component(u, v, w, around, axis, dt / self.spacing, self._moved[axis])
        for axis in range(self.dim):
            self.velocity[axis], self._moved[axis] = self._moved[axis], self.velocity[axis]

    def carry(self, field: FloatArray, solid: NDArray[np.bool_], dt: float, inlets: Sequence[Inlet] = ()) -> FloatArray:
        """Return the smoke (nx, ny, nz), carried along over a step [s], with what has come through inlets; zero in
        solids."""
        u, v, w = self.velocity
        out = np.empty_like(field)
        around = surrounded(field, self.dim, None, inlets)
        advect_scalar(u, v, w, around, surrounded(solid, self.dim), dt / self.spacing, out)
        return out

    # ----------------------------------------------------------------------------------------- projection

    def hold_at_solids(self, system: PressureSystem) -> None:
        """Let the flow rest at faces of solids, walls of the grid included."""
        solid = system.labels == SOLID
        for axis in range(self.dim):
            self.velocity[axis][np.logical_or(*sides(solid, axis))] = 0.0

    def divergence(self, system: PressureSystem) -> GridArray:
        """Net outflow of each voxel that has an unknown, times h / h^dim [m/s]: h times the divergence, padded."""
        out = system.new_field()
        inner = out[1:-1, 1:-1, 1:-1]
        for axis in range(self.dim):
            inner += np.diff(self.velocity[axis], axis=axis)
        out[~system.unknown] = 0.0
        return out

    def project(
        self, system: PressureSystem, solver: PressureSolver, tolerance: float, max_iterations: int
    ) -> ProjectionReport:
        """Take the divergence away by the gradient of a pressure; velocity at solids stays.

        Parameters
        ----------
        system : PressureSystem
            Of the voxels' labels.
        solver : PressureSolver
            For that system.
        tolerance : float
            Residual of the pressure over its right-hand side [-].
        max_iterations : int
            Of the solver.

        Returns
        -------
        ProjectionReport
        """
        b = -self.divergence(system)
        before = float(np.abs(b).max(initial=0.0)) / self.spacing
        compatible = b.copy()
        system.project(compatible)
        imbalance = float(np.abs(compatible - b).max(initial=0.0)) / self.spacing
        answer = solver.solve(compatible, tolerance, max_iterations)
        passable = system.labels != SOLID
        fluid = system.unknown
        for axis in range(self.dim):
            open_low, open_high = sides(passable, axis)
            fluid_low, fluid_high = sides(fluid, axis)
            free = open_low & open_high & (fluid_low | fluid_high)
            low, high = sides(answer.x, axis)
            self.velocity[axis][free] -= (high - low)[free]
        after = float(np.abs(self.divergence(system)).max(initial=0.0)) / self.spacing
        size = system.norm(compatible)
        return ProjectionReport(
            answer.iterations,
            answer.converged,
            answer.reason,
            before,
            after,
            imbalance,
            answer.residuals[-1] / size if size > 0.0 else 0.0,
            answer.x,
        )

    def fill_air(self, system: PressureSystem) -> None:
        """Give faces between two voxels of air the velocity of the nearest face of fluid, for advection from there."""
        from scipy.ndimage import distance_transform_edt

        air, known = system.labels == AIR, system.unknown
        if not air.any() or not known.any():
            return
        for axis in range(self.dim):
            air_low, air_high = sides(air, axis)
            known_low, known_high = sides(known, axis)
            unset = air_low & air_high
            if unset.any():
                near = distance_transform_edt(~(known_low | known_high), return_distances=False, return_indices=True)
                self.velocity[axis][unset] = self.velocity[axis][tuple(index[unset] for index in near)]


def sides(padded: NDArray[Any], axis: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Values of the voxels before and behind each face across an axis, shaped as that velocity component."""
    low: list[slice] = [slice(1, -1)] * 3
    high = low.copy()
    low[axis], high[axis] = slice(0, -1), slice(1, None)
    return padded[tuple(low)], padded[tuple(high)]
