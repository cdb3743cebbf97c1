"""What a scene of material points measures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.mpm.heat import current_volumes
from femdeform.mpm.particles import LIQUID, Particles
from femdeform.mpm.transfers import spin
from femdeform.run.point_setup import Materials
from femdeform.scene.point_schema import PointScene, PointVectorQuantity, SecondMomentQuantity
from femdeform.types import BoolArray, FloatArray

_AXES = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True)
class PointState:
    """A moment of a run of material points.

    Attributes
    ----------
    particles : Particles
    time : float
        Time [s].
    step : int
        Accepted steps.
    surface_area, surface_energy : float
        Of the surface as it was sampled for the last step [m^2], [J].
    """

    particles: Particles
    time: float = 0.0
    step: int = 0
    surface_area: float = 0.0
    surface_energy: float = 0.0


def kinetic_energy(points: Particles) -> float:
    """Kinetic energy of the points' velocities [J]."""
    return float(0.5 * points.mass @ (points.v**2).sum(axis=1))


def angular_momentum(points: Particles, spacing: float) -> FloatArray:
    """Angular momentum about the origin (3,), that of the affine velocities included [kg m^2/s]."""
    x, v = (np.zeros((points.n, 3)) for _ in range(2))
    x[:, : points.dim], v[:, : points.dim] = points.x, points.v
    own = spin(spacing, 2, points.x, points.mass, points.affine).sum(axis=0)
    return np.asarray(points.mass @ np.cross(x, v) + own)


def pressures(points: Particles, materials: Materials) -> FloatArray:
    """Pressure of liquid points, 0 in solid ones (n,) [Pa]."""
    constants = materials.at(points)
    return np.where(points.phase == LIQUID, -constants.bulk_modulus * (points.J - 1.0), 0.0)


def volume_ratios(points: Particles) -> FloatArray:
    """J of liquid points, det F of solid ones (n,) [-]."""
    return np.asarray(current_volumes(points) / points.volume)


class PointMeter:
    """Evaluates the quantities of a scene's `measure` block.

    Parameters
    ----------
    scene : PointScene
    materials : Materials
    """

    def __init__(self, scene: PointScene, materials: Materials) -> None:
        self._spacing = scene.grid.cell_size
        self._materials = materials
        self._numbers = {name: number for number, name in enumerate(scene.bodies)}
        self._functions = {name: self._function(quantity) for name, quantity in scene.measure.items()}

    def evaluate(self, state: PointState) -> dict[str, float]:
        """Values by name."""
        return {name: function(state) for name, function in self._functions.items()}

    def standard(self, state: PointState) -> dict[str, float]:
        """What every result states."""
        names = ("mass", "volume", "kinetic_energy", "max_speed", "min_jacobian")
        return {name: self._sum(name, state, state.particles) for name in names}

    def _function(self, quantity: Any) -> Callable[[PointState], float]:
        def evaluate(state: PointState) -> float:
            points = state.particles
            if quantity.body is not None:
                mine: BoolArray = points.body == self._numbers[quantity.body]
                points = points.take(np.flatnonzero(mine))
            if isinstance(quantity, PointVectorQuantity):
                vector = self._vector(quantity.kind, points)
                if quantity.component == "norm":
                    return float(np.linalg.norm(vector))
                return float(vector[_AXES[quantity.component]])
            if isinstance(quantity, SecondMomentQuantity):
                x = points.x - points.mass @ points.x / points.mass.sum()
                return float(points.mass @ (x[:, 0] ** 2 - x[:, 1] ** 2) / points.mass.sum())
            return self._sum(quantity.kind, state, points)

        return evaluate

    def _vector(self, kind: str, points: Particles) -> FloatArray:
        if kind == "centroid":
            return np.asarray(points.mass @ points.x / points.mass.sum())
        if kind == "linear_momentum":
            return np.asarray(points.mass @ points.v)
        if kind == "angular_momentum":
            return angular_momentum(points, self._spacing)
        if kind == "extent":
            return np.asarray(np.ptp(points.x, axis=0))
        return np.asarray(points.x.max(axis=0) if kind == "highest" else points.x.min(axis=0))

    def _sum(self, kind: str, state: PointState, points: Particles) -> float:
        mass, T = points.mass, points.temperature
        if kind == "surface_area":
            return state.surface_area
        if kind == "surface_energy":
            return state.surface_energy
        known: dict[str, Callable[[], Any]] = {
            "mass": mass.sum,
            "volume": lambda: current_volumes(points).sum(),
            "kinetic_energy": lambda: kinetic_energy(points),
            "max_speed": lambda: np.sqrt((points.v**2).sum(axis=1).max(initial=0.0)),
            "heat": lambda: self._heat(points),
            "mean_temperature": lambda: mass @ T / mass.sum(),
            "min_temperature": T.min,
            "max_temperature": T.max,
            "liquid_fraction": lambda: mass[points.phase == LIQUID].sum() / mass.sum(),
            "mean_pressure": lambda: self._mean_pressure(points),
            "min_jacobian": lambda: volume_ratios(points).min(),
        }
        return float(known[kind]())

    def _heat(self, points: Particles) -> float:
        capacity = self._materials.capacity
        return float("nan") if capacity is None else float((points.mass * capacity[points.body]) @ points.temperature)

    def _mean_pressure(self, points: Particles) -> float:
        volumes = np.where(points.phase == LIQUID, current_volumes(points), 0.0)
        return float(volumes @ pressures(points, self._materials) / volumes.sum()) if volumes.any() else float("nan")
