"""Surface tension of each sample: by temperature, region, and what lies beyond the surface; Young's relation.

A coefficient belongs to the material at the sample and is frozen during a solve: its gradient along the surface then
drives flow to where it is larger (Marangoni). As a field of space it would not (its tangential part cancels).

References
----------
J. Chen, dissertation (2024), sections 3.1.1 and 3.1.6: the surface of the solid against the gas has no energy.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from femdeform.mpm.particles import LIQUID, Particles
from femdeform.mpm.surface_samples import SurfaceSamples
from femdeform.mpm.temperature_functions import TemperatureFunction
from femdeform.types import BoolArray, FloatArray

# Positions (n, dim) to whether they are inside.
Region = Callable[[FloatArray], BoolArray]


class SignedDistance(Protocol):
    """A rigid shape; positive distances are free space."""

    def distance(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Signed distance (n,) [m] of positions (n, dim) and its unit gradient (n, dim)."""


class MovingWall(Protocol):
    """A shape that moves without turning."""

    @property
    def shape(self) -> SignedDistance:
        """At time zero."""

    @property
    def velocity(self) -> FloatArray:
        """(dim,) [m/s]."""


@dataclass(frozen=True)
class SurfaceTension:
    """Surface tension of a body.

    Attributes
    ----------
    liquid_gas : TemperatureFunction
        k_LG [N/m].
    solid_liquid : TemperatureFunction, optional
        k_SL of samples below a wall [N/m], of either sign; default that of the free surface.
    regions : tuple of (Region, TemperatureFunction)
        Other k_LG for samples in a region; the first region that has a sample counts.
    on_solid : bool
        Whether samples of solid material points have a tension too.
    """

    liquid_gas: TemperatureFunction
    solid_liquid: TemperatureFunction | None = None
    regions: tuple[tuple[Region, TemperatureFunction], ...] = ()
    on_solid: bool = False


@dataclass(frozen=True)
class SurfaceCoefficients:
    """Surface tension of samples.

    Attributes
    ----------
    k : (n_samples,) float64
        [N/m].
    is_on_wall : (n_samples,) bool
        Whether the sample is between liquid and wall.
    """

    k: FloatArray
    is_on_wall: BoolArray


def sample_temperatures(samples: SurfaceSamples, particles: Particles) -> FloatArray:
    """Temperatures (n_samples,) [K] at the samples, by the temperature of their owners and its gradient."""
    apart = samples.points - particles.x[samples.owner]
    slope = particles.temperature_gradient[samples.owner]
    return np.asarray(particles.temperature[samples.owner] + np.einsum("ra,ra->r", slope, apart))


def wall_distance(walls: Sequence[MovingWall], points: FloatArray, time: float) -> FloatArray:
    """Distances (n,) [m] of positions (n, dim) from the closest wall at a time [s], negative inside; inf without."""
    out = np.full(len(points), np.inf)
    for wall in walls:
        out = np.minimum(out, wall.shape.distance(points - wall.velocity * time)[0])
    return out


def surface_coefficients(
    samples: SurfaceSamples,
    particles: Particles,
    tensions: Sequence[SurfaceTension | None],
    distance: FloatArray | None = None,
) -> SurfaceCoefficients:
    """Coefficients of all samples.

    Parameters
    ----------
    samples : SurfaceSamples
        Samples of the surface.
    particles : Particles
        Their owners.
    tensions : sequence of SurfaceTension or None
        One for each body; None for one without tension.
    distance : (n_samples,) float64, optional
        Of the samples from the walls (`wall_distance`); those below zero lie on a wall. Default: there is none.

    Raises
    ------
    ValueError
        If liquid would gain energy by growing its surface without bounds: k_LG < 0, or k_LG + k_SL < 0, with which a
        film on a wall grows. If a body has no entry.
    """
    if particles.n and int(particles.body.max()) >= len(tensions):
        raise ValueError(f"there are {len(tensions)} tensions, and a body has number {int(particles.body.max())}")
    temperature = sample_temperatures(samples, particles)
    body, is_liquid = particles.body[samples.owner], particles.phase[samples.owner] == LIQUID
    below = np.zeros(samples.n, dtype=bool) if distance is None else distance < 0.0
    k = np.zeros(samples.n)
    on_wall = np.zeros(samples.n, dtype=bool)
    for number, tension in enumerate(tensions):
        if tension is None:
            continue
        mine = np.flatnonzero((body == number) & (is_liquid | tension.on_solid))
        points, T = samples.points[mine], temperature[mine]
        free = np.asarray(tension.liquid_gas(T), dtype=np.float64).copy()
        left = np.ones(mine.size, dtype=bool)
        for contains, function in tension.regions:
            here = left & contains(points)
            free[here] = function(T[here])
            left &= ~here
        _require(free >= 0.0, "k_LG", free, "a surface of negative tension grows without bounds")
        k[mine] = free
        if tension.solid_liquid is not None:
            wet = below[mine]
            solid_liquid = tension.solid_liquid(T[wet])
            total = solid_liquid + free[wet]
            _require(total >= 0.0, "k_SL + k_LG", total, "a film on the wall grows without bounds")
            k[mine[wet]] = solid_liquid
            on_wall[mine[wet]] = True
    return SurfaceCoefficients(k, on_wall)


def _require(holds: Any, name: str, values: FloatArray, why: str) -> None:
    """Raise unless a condition holds for all values."""
    if not np.all(holds):
        raise ValueError(f"{name} = {float(np.min(values)):g} N/m: {why}")


def contact_angle(solid_liquid: float, liquid_gas: float) -> float:
    """Young's angle through the liquid [rad]: ``cos(theta) = -k_SL / k_LG``; pi where the liquid does not wet.

    Raises
    ------
    ValueError
        If k_LG is not positive or k_SL < -k_LG, for which there is no rest.
    """
    if not liquid_gas > 0.0:
        raise ValueError(f"k_LG = {liquid_gas:g} N/m is not positive")
    if solid_liquid < -liquid_gas:
        raise ValueError(f"k_SL = {solid_liquid:g} N/m is below -k_LG: a film on the wall grows without bounds")
    return float(np.arccos(-min(solid_liquid / liquid_gas, 1.0)))


def solid_liquid_coefficient(angle: float, liquid_gas: float) -> float:
    """k_SL [N/m] for a contact angle [rad] and k_LG [N/m]: ``-k_LG cos(theta)``."""
    return float(-liquid_gas * np.cos(angle))
