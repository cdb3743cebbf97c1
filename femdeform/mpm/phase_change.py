"""Melting and freezing of material points.

References
----------
J. Chen, dissertation (2024), section 3.1.5: the change at one temperature, without latent heat, which is beyond it.

Limitations
-----------
Volumes at rest stay, so a point snaps to its volume at rest when it changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femdeform.mpm.particles import LIQUID, SOLID, Particles
from femdeform.types import BoolArray


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
    """

    solidus: float
    liquidus: float
    latent_heat: float = 0.0

    def __post_init__(self) -> None:
        if not self.solidus <= self.liquidus:
            raise ValueError(f"the solidus {self.solidus} K is above the liquidus {self.liquidus} K")
        if self.latent_heat < 0.0:
            raise ValueError(f"a latent heat of {self.latent_heat} J/kg is negative")
        if self.latent_heat > 0.0 and self.solidus == self.liquidus:
            raise ValueError("latent heat needs a liquidus above the solidus: enthalpy has to follow from temperature")


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
