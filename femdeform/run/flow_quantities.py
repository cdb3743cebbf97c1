"""What a scene of smoke measures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates

from femdeform.flow.mac_grid import MACGrid
from femdeform.run.components import component_of
from femdeform.scene.flow_schema import FlowPointQuantity, FlowScene, SmokeCentroid
from femdeform.types import FloatArray


@dataclass(frozen=True)
class FlowState:
    """A moment of a flow.

    Attributes
    ----------
    velocity : tuple of 3 arrays
        On the faces, as in `MACGrid` [m/s].
    density : (nx, ny, nz) float64
        Of smoke [-].
    pressure : (nx, ny, nz) float64
        That took the divergence away last; in each closed part without mean [Pa].
    time : float
        Time [s].
    step : int
        Accepted steps.
    divergence, imbalance : float
        Largest divergence after the last projection, and what of the divergence no pressure could take away [1/s].
    """

    velocity: tuple[FloatArray, FloatArray, FloatArray]
    density: FloatArray
    pressure: FloatArray
    time: float = 0.0
    step: int = 0
    divergence: float = 0.0
    imbalance: float = 0.0


def at_centres(velocity: tuple[FloatArray, ...]) -> FloatArray:
    """Velocities at the centres of the voxels, (nx, ny, nz, 3) [m/s]."""
    means = []
    for axis, component in enumerate(velocity):
        along = np.moveaxis(component, axis, 0)
        means.append(np.moveaxis(0.5 * (along[1:] + along[:-1]), 0, axis))
    return np.stack(means, axis=-1)


def kinetic_energy(grid: MACGrid, velocity: tuple[FloatArray, ...], density: float) -> float:
    """Kinetic energy of the velocities at the centres, solids included where they move [J]."""
    return float(0.5 * density * grid.spacing**grid.dim * (at_centres(velocity) ** 2).sum())


def smoke(grid: MACGrid, density: FloatArray) -> float:
    """Integral of the density of smoke [m^dim]."""
    return float(density.sum() * grid.spacing**grid.dim)


class FlowMeter:
    """Evaluates the quantities of a scene's `measure` block.

    Parameters
    ----------
    scene : FlowScene
    grid : MACGrid
    """

    def __init__(self, scene: FlowScene, grid: MACGrid) -> None:
        self._grid = grid
        self._density = scene.density
        self._functions: dict[str, Callable[[FlowState], float]] = {
            name: self._function(quantity) for name, quantity in scene.measure.items()
        }

    def evaluate(self, state: FlowState) -> dict[str, float]:
        """Values by name."""
        return {name: function(state) for name, function in self._functions.items()}

    def standard(self, state: FlowState) -> dict[str, float]:
        """What every result states."""
        names = ("smoke", "kinetic_energy", "max_speed", "divergence")
        return {name: self._simple(name)(state) for name in names}

    def _function(self, quantity: Any) -> Callable[[FlowState], float]:
        if isinstance(quantity, SmokeCentroid):
            return lambda state: component_of(self._centroid(state), quantity.component)
        if isinstance(quantity, FlowPointQuantity):
            return lambda state: self._at_point(state, quantity)
        return self._simple(quantity.kind)

    def _simple(self, kind: str) -> Callable[[FlowState], float]:
        grid = self._grid
        known: dict[str, Callable[[FlowState], float]] = {
            "smoke": lambda state: smoke(grid, state.density),
            "kinetic_energy": lambda state: kinetic_energy(grid, state.velocity, self._density),
            "max_speed": lambda state: max(float(np.abs(u).max(initial=0.0)) for u in state.velocity),
            "divergence": lambda state: state.divergence,
            "imbalance": lambda state: state.imbalance,
        }
        return known[kind]

    def _centroid(self, state: FlowState) -> FloatArray:
        total = state.density.sum()
        if total == 0.0:
            return np.full(self._grid.dim, np.nan)
        weighted = (self._grid.centres() * state.density[..., None]).reshape(-1, self._grid.dim)
        return np.asarray(weighted.sum(axis=0) / total)

    def _at_point(self, state: FlowState, quantity: FlowPointQuantity) -> float:
        grid = self._grid
        place = (np.array(quantity.at) - grid.origin[: grid.dim]) / grid.spacing - 0.5
        place = np.append(place, np.zeros(3 - grid.dim))

        def value(field: FloatArray) -> float:
            return float(map_coordinates(field, place[:, None], order=1, mode="nearest")[0])

        if quantity.kind == "density":
            return value(state.density)
        centres = at_centres(state.velocity)
        return component_of(np.array([value(centres[..., axis]) for axis in range(grid.dim)]), quantity.component)
