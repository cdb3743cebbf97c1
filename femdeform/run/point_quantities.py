"""What a scene of material points measures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.mpm.level_set import visible_volume
from femdeform.mpm.particles import LIQUID, Particles, current_volumes
from femdeform.mpm.surface_sampling import SurfaceSampler
from femdeform.mpm.transfers import spin
from femdeform.run.components import component_of
from femdeform.run.point_setup import Materials
from femdeform.scene.point_quantity_schema import ContactAngleQuantity
from femdeform.scene.point_schema import PointScene, PointVectorQuantity, Region, SecondMomentQuantity
from femdeform.types import BoolArray, FloatArray


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


def apparent_angle(distance: FloatArray, samples: FloatArray, wall_normal: FloatArray, spacing: float) -> float:
    """Contact angle through the liquid of the circle, in 3D the sphere, that fits a free surface best [degrees].

    Samples within one and a half cells of the wall are left out; the circle is that of least squares of
    ``|x|^2 - 2 c . x + (|c|^2 - R^2)``, less half a cell, by which the contour lies outside of the liquid.

    Parameters
    ----------
    distance : (n,) float64
        Of the samples from the wall [m].
    samples : (n, dim) float64
        Samples of the whole surface [m].
    wall_normal : (dim,) float64
        Unit normal towards the liquid.
    spacing : float
        Cell size [m].

    Returns
    -------
    float
        In [0, 180]; 180 also where the circle does not reach the wall; nan with too few samples.
    """
    far = distance > 1.5 * spacing
    x = samples[far]
    if len(x) < 2 * (x.shape[1] + 1):
        return float("nan")
    origin = x.mean(axis=0)
    y = x - origin
    system = np.column_stack([2.0 * y, np.ones(len(y))])
    solution = np.linalg.lstsq(system, (y**2).sum(axis=1), rcond=None)[0]
    center = solution[:-1]
    radius = float(np.sqrt(solution[-1] + center @ center)) - 0.5 * spacing
    height = float(distance[far].mean() + center @ wall_normal)
    return float(np.rad2deg(np.arccos(np.clip(-height / radius, -1.0, 1.0))))


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
        surface = scene.surface
        self._sampler = SurfaceSampler(self._spacing, surface.density, surface.radius, surface.seed)
        self._radius = surface.radius
        self._walls = scene.walls
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
            region = getattr(quantity, "within", None)
            if region is not None:
                points = points.take(np.flatnonzero(_inside(region, points.x)))
            if isinstance(quantity, ContactAngleQuantity):
                return self._contact_angle(quantity, points, state)
            if isinstance(quantity, PointVectorQuantity):
                return component_of(self._vector(quantity.kind, points), quantity.component)
            if isinstance(quantity, SecondMomentQuantity):
                x = points.x - points.mass @ points.x / points.mass.sum()
                return float(points.mass @ (x[:, 0] ** 2 - x[:, 1] ** 2) / points.mass.sum())
            return self._sum(quantity.kind, state, points)

        return evaluate

    def _contact_angle(self, quantity: ContactAngleQuantity, points: Particles, state: PointState) -> float:
        if not points.n:
            return float("nan")
        wall = self._walls[quantity.wall]
        assert wall.shape.kind == "plane"
        normal = np.array(wall.shape.normal) / np.linalg.norm(wall.shape.normal)
        moved = np.array(wall.shape.point) + (0.0 if wall.velocity is None else np.array(wall.velocity) * state.time)
        samples = self._sampler.sample(points.x, state.step).points
        return apparent_angle((samples - moved) @ normal, samples, normal, self._spacing)

    def _vector(self, kind: str, points: Particles) -> FloatArray:
        if not points.n:
            return np.full(3, np.nan)
        if kind == "mean_velocity":
            return np.asarray(points.mass @ points.v / points.mass.sum())
        if kind == "thermal_moment":
            away = points.x - points.mass @ points.x / points.mass.sum()
            return np.asarray((points.mass * points.temperature) @ away / points.mass.sum())
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
        if kind == "virial":
            return self._virial(state, points)
        mass, T = points.mass, points.temperature
        if not points.n and kind not in ("mass", "volume", "kinetic_energy", "max_speed", "heat"):
            return float("nan")
        if kind == "surface_area":
            return state.surface_area
        if kind == "surface_energy":
            return state.surface_energy
        known: dict[str, Callable[[], Any]] = {
            "mass": mass.sum,
            "volume": lambda: current_volumes(points).sum(),
            "visible_volume": lambda: visible_volume(points.x, points.volume, self._spacing, self._radius),
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

    def _virial(self, state: PointState, points: Particles) -> float:
        if state.surface_energy == 0.0:
            return float("nan")
        part = current_volumes(points) @ pressures(points, self._materials)
        return float(points.dim * part / ((points.dim - 1) * state.surface_energy) - 1.0)

    def _heat(self, points: Particles) -> float:
        materials = self._materials
        return float("nan") if materials.heat is None else float(points.mass @ materials.enthalpies(points))

    def _mean_pressure(self, points: Particles) -> float:
        volumes = np.where(points.phase == LIQUID, current_volumes(points), 0.0)
        return float(volumes @ pressures(points, self._materials) / volumes.sum()) if volumes.any() else float("nan")


def _inside(region: Region, x: FloatArray) -> BoolArray:
    if region.kind == "box":
        return np.asarray(((x >= np.array(region.min)) & (x <= np.array(region.max))).all(axis=1))
    return np.asarray(((x - np.array(region.center)) ** 2).sum(axis=1) <= region.radius**2)
