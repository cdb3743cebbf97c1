"""Melting and freezing of material points, with latent heat if there is any.

References
----------
J. Chen, dissertation (2024), section 3.1.5: the change at one temperature, without latent heat.
V. R. Voller, C. R. Swaminathan, General source-based method for solidification phase change (1991), for enthalpy as a
function of temperature; what is done after a step of conduction here is the recovery of temperatures from it.

Limitations
-----------
Temperatures follow from enthalpies after the conduction, which does not know of latent heat: the front is first order
in the time step. Volumes at rest stay, so a point snaps to its volume at rest when it changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femdeform.mpm.particles import LIQUID, SOLID, Particles
from femdeform.types import BoolArray, FloatArray


@dataclass(frozen=True)
class Melting:
    """Where a material melts and freezes, and what that takes.

    Attributes
    ----------
    solidus, liquidus : float
        A liquid becomes solid below the former, a solid liquid above the latter [K]. Between them points stay what
        they are: the band keeps those at the melting point from changing in every step.
    latent_heat : float
        Taken up from solidus to liquidus, in proportion to the temperature [J/kg].
    solid_capacity, liquid_capacity : float
        Specific heats [J/(kg K)]; only used with latent heat, their mean in the band.
    """

    solidus: float
    liquidus: float
    latent_heat: float = 0.0
    solid_capacity: float = 1.0
    liquid_capacity: float = 1.0

    def __post_init__(self) -> None:
        if not self.solidus <= self.liquidus:
            raise ValueError(f"the solidus {self.solidus} K is above the liquidus {self.liquidus} K")
        if self.latent_heat < 0.0:
            raise ValueError(f"a latent heat of {self.latent_heat} J/kg is negative")
        if not (self.solid_capacity > 0.0 and self.liquid_capacity > 0.0):
            raise ValueError("a specific heat is not positive")
        if self.latent_heat > 0.0 and self.solidus == self.liquidus:
            raise ValueError("latent heat needs a liquidus above the solidus: enthalpy has to follow from temperature")

    @property
    def _in_band(self) -> float:
        return 0.5 * (self.solid_capacity + self.liquid_capacity)

    def capacity(self, temperature: FloatArray) -> FloatArray:
        """Specific heats (n,) [J/(kg K)] without latent heat."""
        warm = np.where(temperature > self.liquidus, self.liquid_capacity, self._in_band)
        return np.where(temperature < self.solidus, self.solid_capacity, warm)

    def liquid_fraction(self, temperature: FloatArray) -> FloatArray:
        """Part (n,) of the latent heat that is taken up [-]."""
        if self.solidus == self.liquidus:
            return np.where(temperature > self.liquidus, 1.0, 0.0)
        return np.asarray(np.clip((temperature - self.solidus) / (self.liquidus - self.solidus), 0.0, 1.0))

    def enthalpy(self, temperature: FloatArray) -> FloatArray:
        """Specific enthalpies (n,) [J/kg], zero for the solid at the solidus."""
        below = np.minimum(temperature - self.solidus, 0.0)
        above = np.maximum(temperature - self.liquidus, 0.0)
        between = np.clip(temperature, self.solidus, self.liquidus) - self.solidus
        sensible = self.solid_capacity * below + self._in_band * between + self.liquid_capacity * above
        return np.asarray(sensible + self.latent_heat * self.liquid_fraction(temperature))

    def temperature(self, enthalpy: FloatArray) -> FloatArray:
        """Temperatures (n,) [K] of specific enthalpies [J/kg], the inverse of `enthalpy`."""
        width = self.liquidus - self.solidus
        whole = self.latent_heat + self._in_band * width
        part = np.clip(enthalpy, 0.0, whole) / whole if whole > 0.0 else np.zeros_like(enthalpy)
        below, above = np.minimum(enthalpy, 0.0), np.maximum(enthalpy - whole, 0.0)
        return np.asarray(self.solidus + width * part + below / self.solid_capacity + above / self.liquid_capacity)


def recover_temperature(melting: Melting, before: FloatArray, after: FloatArray, capacity: FloatArray) -> FloatArray:
    """Temperatures (n,) [K] with the heat of a step of conduction, latent heat included.

    The enthalpy at a temperature before the step plus ``capacity (after - before)``: what conduction brought, and no
    more, so the sum of mass times enthalpy changes by what goes through the surface and comes from sources.

    Parameters
    ----------
    melting : Melting
        The material.
    before, after : (n,) float64
        Temperatures before and after the conduction [K].
    capacity : (n,) float64
        Specific heats of the conduction [J/(kg K)], best `Melting.capacity` of `before`.
    """
    return melting.temperature(melting.enthalpy(before) + capacity * (after - before))


def change_phase(particles: Particles, melting: Melting, members: BoolArray | None = None) -> tuple[int, int]:
    """Melt solid points above the liquidus and freeze liquid ones below the solidus.

    A melted point has J = 1, a frozen one F = I; velocities, temperatures and masses stay.

    Parameters
    ----------
    particles : Particles
        Their phases, J and F are changed.
    melting : Melting
        The material.
    members : (n,) bool, optional
        Points of this material; default all.

    Returns
    -------
    int, int
        How many melted, and how many froze.
    """
    above, below = particles.temperature > melting.liquidus, particles.temperature < melting.solidus
    mine = np.ones(particles.n, dtype=bool) if members is None else members
    melts = mine & (particles.phase == SOLID) & above
    freezes = mine & (particles.phase == LIQUID) & below
    particles.phase[melts] = LIQUID
    particles.J[melts] = 1.0
    particles.phase[freezes] = SOLID
    particles.F[freezes] = np.eye(particles.dim)
    return int(melts.sum()), int(freezes.sum())
