"""The heat that a material holds, where its specific heat follows the temperature and where it melts.

References
----------
V. R. Voller, C. R. Swaminathan, General source-based method for solidification phase change (1991), for enthalpy as a
function of temperature; what is done after a step of conduction here is the recovery of temperatures from it.

Limitations
-----------
Conduction takes specific heats at the temperatures before its step and does not know of latent heat: what a body
holds is exact, how it spreads is first order in the time step.
"""

from __future__ import annotations

import numpy as np

from femdeform.mpm.phase_change import Melting
from femdeform.mpm.temperature_functions import TemperatureFunction
from femdeform.types import FloatArray


class HeatContent:
    """Specific enthalpy over temperature, and its inverse, for piecewise linear specific heats.

    Between two corners a specific heat c + m s of the temperature T + s adds ``c s + m s^2 / 2``, whose inverse is the
    root of a quadratic. Latent heat counts as a specific heat of its own between solidus and liquidus.

    Parameters
    ----------
    solid : TemperatureFunction
        Specific heat below the solidus, or everywhere [J/(kg K)].
    liquid : TemperatureFunction, optional
        That above the liquidus; default the same. In between it is their mean.
    melting : Melting, optional
        Where and with what latent heat the material melts.

    Raises
    ------
    ValueError
        If a specific heat is not positive at every temperature.
    """

    def __init__(
        self, solid: TemperatureFunction, liquid: TemperatureFunction | None = None, melting: Melting | None = None
    ) -> None:
        liquid = solid if liquid is None else liquid
        corners = {*solid.corners, *liquid.corners}
        if melting is not None:
            corners |= {melting.solidus, melting.liquidus}
        self._corners = np.array(sorted(corners or {0.0}))
        # Pieces: before the first corner, then one after each. Those at the ends have no end, hence three kelvin.
        low = np.concatenate((self._corners[:1] - 3.0, self._corners))
        high = np.concatenate((self._corners, self._corners[-1:] + 3.0))
        one, two = (2.0 * low + high) / 3.0, (low + 2.0 * high) / 3.0
        first, second = (_sensible(solid, liquid, melting, at) for at in (one, two))
        self._slope = (second - first) / (two - one)
        self._origin = np.concatenate((self._corners[:1], self._corners))
        self._capacity = first - self._slope * (one - self._origin)
        at_ends = self._capacity[1:-1] + self._slope[1:-1] * np.diff(self._corners)
        lowest = min(self._capacity.min(), at_ends.min(initial=np.inf))
        if not lowest > 0.0 or self._slope[0] > 0.0 or self._slope[-1] < 0.0:
            raise ValueError("a specific heat is not positive at every temperature")
        self._total = self._capacity.copy()
        if melting is not None and melting.latent_heat > 0.0:
            inside = (one > melting.solidus) & (one < melting.liquidus)
            self._total[inside] += melting.latent_heat / (melting.liquidus - melting.solidus)
        width = np.diff(self._corners)
        steps = width * (self._total[1:-1] + 0.5 * self._slope[1:-1] * width)
        self._reached = np.concatenate(([0.0], np.cumsum(steps)))  # enthalpies at the corners
        self._base = np.concatenate((self._reached[:1], self._reached))
        at_zero = float(self.enthalpy(np.zeros(1))[0])
        self._reached -= at_zero
        self._base -= at_zero

    @property
    def is_proportional(self) -> bool:
        """Whether the enthalpy is a constant times the temperature."""
        return bool(np.all(self._slope == 0.0) and np.all(self._total == self._total[0]))

    def capacity(self, temperature: FloatArray) -> FloatArray:
        """Specific heats (n,) [J/(kg K)] at temperatures [K], without latent heat."""
        piece = np.searchsorted(self._corners, temperature, side="right")
        return np.asarray(self._capacity[piece] + self._slope[piece] * (temperature - self._origin[piece]))

    def enthalpy(self, temperature: FloatArray) -> FloatArray:
        """Specific enthalpies (n,) [J/kg] at temperatures [K], zero at 0 K."""
        piece = np.searchsorted(self._corners, temperature, side="right")
        s = temperature - self._origin[piece]
        return np.asarray(self._base[piece] + s * (self._total[piece] + 0.5 * self._slope[piece] * s))

    def temperature(self, enthalpy: FloatArray) -> FloatArray:
        """Temperatures (n,) [K] of specific enthalpies [J/kg], the inverse of `enthalpy`."""
        piece = np.searchsorted(self._reached, enthalpy, side="right")
        more, capacity = enthalpy - self._base[piece], self._total[piece]
        # The root that stays finite as the slope vanishes.
        root = np.sqrt(np.maximum(capacity * capacity + 2.0 * self._slope[piece] * more, 0.0))
        return np.asarray(self._origin[piece] + 2.0 * more / (capacity + root))

    def recovered(self, before: FloatArray, after: FloatArray, capacity: FloatArray) -> FloatArray:
        """Temperatures (n,) [K] with the heat of a step of conduction, latent heat included.

        The enthalpy at a temperature before the step plus ``capacity (after - before)``: what conduction brought, and
        no more, so the sum of mass times enthalpy changes by what goes through the surface and comes from sources.

        Parameters
        ----------
        before, after : (n,) float64
            Temperatures before and after the conduction [K].
        capacity : (n,) float64
            Specific heats of the conduction [J/(kg K)], best `capacity` of `before`.
        """
        return self.temperature(self.enthalpy(before) + capacity * (after - before))


def _sensible(
    solid: TemperatureFunction, liquid: TemperatureFunction, melting: Melting | None, temperature: FloatArray
) -> FloatArray:
    """Specific heats (n,) without latent heat."""
    cold = solid(temperature)
    if melting is None:
        return cold
    hot = liquid(temperature)
    warm = np.where(temperature > melting.liquidus, hot, 0.5 * (cold + hot))
    return np.where(temperature < melting.solidus, cold, warm)
