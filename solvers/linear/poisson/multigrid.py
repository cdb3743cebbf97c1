"""Geometric multigrid for the pressure, as a preconditioner: unsmoothed aggregation of 2 x 2 (x 2) voxels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.flow.pressure_system import GridArray, PressureSystem, shifted
from solvers.linear.poisson import multigrid_kernels as kernels

# Constants per aggregate are twice too stiff: smooth errors come back half as large as they should.
OVERCORRECTION = 2.0
COARSEST_SWEEPS = 20
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


class Multigrid:
    """A symmetric V-cycle: an approximate inverse for conjugate gradients.

    Aggregates of 2^d voxels with constant values, Galerkin's coarse matrices, which keep seven points, corrections
    twice as large, red-black Gauss-Seidel with the colours turned round after the correction. The part of a coarse
    diagonal that belongs to air is multiplied by (2^k + 2)/(2^k + 1) from level k - 1 to level k: air begins half a
    fine voxel beyond the last fluid voxel however coarse the level is, and constants alone would put it half a coarse
    one away.

    Parameters
    ----------
    system : PressureSystem
    sweeps : int
        Before and after each correction: V(sweeps, sweeps).
    dtype : type
        Precision of the cycle; float32 is enough for a preconditioner.

    References
    ----------
    D. Braess, Towards algebraic multigrid for elliptic problems of second order (1995), for over-correction.

    Limitations
    -----------
    Coarse voxels do not see walls thinner than they are: porous solids and thin plates cost iterations, 20 to 50 in
    place of 4 at worst. One process, with threads.
    """

    def __init__(self, system: PressureSystem, sweeps: int = 2, dtype: type[np.floating[Any]] = np.float32) -> None:
        self.system = system
        self.sweeps = sweeps
        self.levels = [Level(system.diagonal, (), system.new_field(dtype), system.new_field(dtype))]
        unknown = system.unknown
        weights = [(unknown & shifted(unknown, axis, 1)).astype(float) for axis in range(3)]
        air = (system.diagonal - _row_sums(weights)) * unknown
        shape: tuple[int, ...] = system.shape
        while max(shape) > _COARSEST_SIZE:
            shape = tuple((n + 1) // 2 for n in shape)
            k = len(self.levels)
            air = _summed(air, shape) * ((2**k + 2) / (2**k + 1))
            weights = [_summed(_faces(w, axis), shape) for axis, w in enumerate(weights)]
            diagonal = (_row_sums(weights) + air).astype(dtype)
            stored = tuple(w.astype(dtype) for w in weights)
            self.levels.append(Level(diagonal, stored, np.zeros_like(diagonal), np.zeros_like(diagonal)))

    def apply(self, r: GridArray, z: GridArray) -> None:
        """One V-cycle from zero; see `Preconditioner`."""
        self.levels[0].b[...] = r
        self._cycle(0)
        z[...] = self.levels[0].x

    def _cycle(self, k: int) -> None:
        level = self.levels[k]
        level.x[...] = 0.0
        is_coarsest = k == len(self.levels) - 1
        sweeps = COARSEST_SWEEPS if is_coarsest else self.sweeps
        for _ in range(sweeps):
            level.sweep(0)
        if not is_coarsest:
            coarse = self.levels[k + 1]
            level.restrict(coarse.b)
            self._cycle(k + 1)
            kernels.prolong(coarse.x, level.diagonal, level.x.dtype.type(OVERCORRECTION), level.x)
        for _ in range(sweeps):
            level.sweep(1)


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


def _summed(values: Any, shape: tuple[int, ...]) -> Any:
    """Sum over aggregates: a padded field on a coarse grid of that shape."""
    inner = values[1:-1, 1:-1, 1:-1]
    even = np.pad(inner, [(0, 2 * n - m) for n, m in zip(shape, inner.shape, strict=True)])
    blocks = even.reshape(shape[0], 2, shape[1], 2, shape[2], 2)
    return np.pad(blocks.sum(axis=(1, 3, 5)), 1)
