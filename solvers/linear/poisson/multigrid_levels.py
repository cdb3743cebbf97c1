"""Matrices of the levels of multigrid on voxels: Galerkin's for constants, and what they make of air."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from femdeform.flow.pressure_system import AIR, GridArray, PressureSystem, shifted
from solvers.linear.poisson import multigrid_kernels as kernels

_COARSEST_SIZE = 4


@dataclass
class Level:
    """Matrix, right-hand side and solution of a level; no `weights` where all couplings are -1."""

    diagonal: Any
    weights: Any
    b: GridArray
    x: GridArray

    def sweep(self, first: int) -> None:
        if self.weights:
            wx, wy, wz = self.weights
            kernels.sweep(self.diagonal, wx, wy, wz, self.b, self.x, first)
        else:
            kernels.sweep_finest(self.diagonal, self.b, self.x, first)

    def restrict(self, coarse: GridArray) -> None:
        if self.weights:
            wx, wy, wz = self.weights
            kernels.restrict(self.diagonal, wx, wy, wz, self.b, self.x, coarse)
        else:
            kernels.restrict_finest(self.diagonal, self.b, self.x, coarse)


class Surface(Protocol):
    """What coarse levels make of air."""

    def coarsen(self, weights: list[Any]) -> tuple[list[Any], Any]:
        """Go on to the next level.

        Parameters
        ----------
        weights : list of three (nx + 2, ny + 2, nz + 2) float64
            Galerkin's couplings there, of each aggregate to its next one along each axis.

        Returns
        -------
        tuple
            The couplings to use, and what air adds to the diagonal.
        """


def make_levels(system: PressureSystem, surface: Surface, dtype: type[np.floating[Any]]) -> list[Level]:
    """The finest level and those of aggregates of 2^d voxels, until at most four are left along an edge.

    Galerkin's couplings of constants are twice too stiff on each level, which doubled corrections make good. A reaction
    is summed exactly, so it is doubled on each level to keep its part of the matrix.

    Parameters
    ----------
    system : PressureSystem
        Of the finest level.
    surface : Surface
        `MeasuredSurface` or `EvenSurface`.
    dtype : type
        Of matrices of aggregates, and of fields.
    """
    levels = [Level(system.diagonal, (), system.new_field(dtype), system.new_field(dtype))]
    unknown = system.unknown
    weights = [(unknown & shifted(unknown, axis, 1)).astype(float) for axis in range(3)]
    reaction = system.reaction * unknown if system.reaction else None
    while max(weights[0].shape) - 2 > _COARSEST_SIZE:
        weights = [_summed(_faces(w, axis)) for axis, w in enumerate(weights)]
        used, air = surface.coarsen(weights)
        row_sums = _row_sums(used) + air
        if reaction is not None:
            reaction = 2.0 * _summed(reaction)
            row_sums += reaction
        diagonal = row_sums.astype(dtype)
        stored = tuple(w.astype(dtype) for w in used)
        levels.append(Level(diagonal, stored, np.zeros_like(diagonal), np.zeros_like(diagonal)))
    return levels


class MeasuredSurface:
    """Couplings to air, and between aggregates beside it, by the distances that they really have.

    Galerkin's couplings of constants count faces. With doubled corrections a coupling of level k stands for its faces
    over a distance of 2^k voxels, which is that of whole aggregates. Those that a surface cuts are thinner, by as much
    as the place of the surface in the grid will have it, and air has its pressure at the centres of its voxels on any
    level. So beside air a coupling is multiplied by 2^k over the distance along its axis between the centres of the
    fluid in both aggregates, and each face to air adds 2^k over the distance from there to its voxel of air, at least
    one voxel. Away from air, aggregates that walls cut keep their couplings: no pressure is given there, and with
    distances boxes of odd sizes, plates and rooms take as many iterations or more.

    Parameters
    ----------
    system : PressureSystem
    """

    def __init__(self, system: PressureSystem) -> None:
        unknown, is_air = system.unknown, system.labels == AIR
        self._spacing = 1.0
        # Faces by axis and side: in which aggregate (3, n), and where along the axis its air is (n,).
        self._faces: list[tuple[int, int, Any, Any]] = []
        for axis in range(3):
            for side in (-1, 1):
                found = np.flatnonzero(unknown & shifted(is_air, axis, side))
                cells = np.stack(np.unravel_index(found, unknown.shape))
                if cells.size:
                    self._faces.append((axis, side, cells, cells[axis] + side))
        if self._faces:
            self._volume = unknown.astype(float)
            self._moments = [self._volume * i for i in np.ogrid[tuple(slice(n) for n in unknown.shape)]]

    def coarsen(self, weights: list[Any]) -> tuple[list[Any], Any]:
        """See `Surface`."""
        if not self._faces:
            return weights, 0.0
        self._spacing *= 2.0
        self._volume = _summed(self._volume)
        self._moments = [_summed(moment) for moment in self._moments]
        centres = [moment / np.maximum(self._volume, 1.0) for moment in self._moments]
        air = np.zeros_like(self._volume)
        for axis, side, cells, places in self._faces:
            cells += 1
            cells //= 2
            at = tuple(cells)
            distances = side * (places - centres[axis][at])
            np.add.at(air, at, self._spacing / np.maximum(distances, 1.0))
        return [self._stretched(w, centres[axis], air > 0.0, axis) for axis, w in enumerate(weights)], air

    def _stretched(self, weights: Any, centres: Any, beside_air: Any, axis: int) -> Any:
        chosen = (weights > 0.0) & (beside_air | shifted(beside_air, axis, 1))
        out = weights.copy()
        out[chosen] *= self._spacing / (shifted(centres, axis, 1) - centres)[chosen]
        return out


class EvenSurface:
    """Air that begins where aggregates of all levels end: factors by level, not by distance.

    Its pressure is given half a voxel beyond the last face of fluid, at level k (2^k + 1)/2 from an aggregate's centre,
    so that what it adds to the diagonal grows by (2^k + 2)/(2^k + 1). The weights of `spd_lmg` were trained with this.

    Parameters
    ----------
    system : PressureSystem
    """

    def __init__(self, system: PressureSystem) -> None:
        unknown = system.unknown
        weights = [(unknown & shifted(unknown, axis, 1)).astype(float) for axis in range(3)]
        self._air = (system.diagonal - system.reaction - _row_sums(weights)) * unknown
        self._spacing = 1

    def coarsen(self, weights: list[Any]) -> tuple[list[Any], Any]:
        """See `Surface`."""
        self._spacing *= 2
        self._air = _summed(self._air) * ((self._spacing + 2) / (self._spacing + 1))
        return weights, self._air


def _row_sums(weights: list[Any]) -> Any:
    """Sum of the couplings of each voxel to both sides."""
    return sum(w + shifted(w, axis, -1) for axis, w in enumerate(weights))


def _faces(weights: Any, axis: int) -> Any:
    """Couplings that leave an aggregate along an axis: those of every second voxel."""
    out = weights.copy()
    inner: list[slice] = [slice(None)] * 3
    inner[axis] = slice(1, None, 2)  # first voxels of aggregates: their next one is in the same aggregate
    out[tuple(inner)] = 0.0
    return out


def _summed(values: Any) -> Any:
    """Sum over aggregates: a padded field on the coarse grid."""
    sums = values[1:-1, 1:-1, 1:-1]
    for axis in range(3):
        first, second, whole = ([slice(None)] * 3 for _ in range(3))
        first[axis], second[axis] = slice(0, None, 2), slice(1, None, 2)
        whole[axis] = slice(sums.shape[axis] // 2)  # where there are both
        pairs = sums[tuple(first)].copy()
        pairs[tuple(whole)] += sums[tuple(second)]
        sums = pairs
    return np.pad(sums, 1)
