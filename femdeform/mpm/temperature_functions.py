"""Constants of materials and surfaces as functions of temperature."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from femdeform.types import FloatArray


class TemperatureFunction(Protocol):
    """A quantity that follows from the temperature, piecewise linear."""

    @property
    def corners(self) -> tuple[float, ...]:
        """Temperatures between which it is linear [K]."""

    def __call__(self, temperature: FloatArray) -> FloatArray:
        """Values (n,) at temperatures (n,) [K]."""

    def largest(self, low: FloatArray, high: FloatArray) -> FloatArray:
        """Largest absolute values (n,) between temperatures `low` and `high` (n,) [K]."""


@dataclass(frozen=True)
class Constant:
    """The same value at every temperature.

    Attributes
    ----------
    value : float
    """

    value: float

    @property
    def corners(self) -> tuple[float, ...]:
        """None."""
        return ()

    def __call__(self, temperature: FloatArray) -> FloatArray:
        """Values (n,) at temperatures (n,) [K]."""
        return np.full(temperature.shape, self.value)

    def largest(self, low: FloatArray, high: FloatArray) -> FloatArray:
        """See `TemperatureFunction`."""
        return np.full(low.shape, abs(self.value))


@dataclass(frozen=True)
class Linear:
    """``value + slope (T - reference)``, kept between two limits.

    Attributes
    ----------
    value : float
        At the reference temperature.
    slope : float
        Change a kelvin.
    reference : float
        Reference temperature [K].
    lowest, highest : float
        Limits of the value.
    """

    value: float
    slope: float
    reference: float
    lowest: float = -np.inf
    highest: float = np.inf

    def __post_init__(self) -> None:
        if not self.lowest <= self.highest:
            raise ValueError(f"the lowest value {self.lowest} is above the highest one {self.highest}")

    @property
    def corners(self) -> tuple[float, ...]:
        """Where the limits are reached [K]."""
        limits = [limit for limit in (self.lowest, self.highest) if np.isfinite(limit) and self.slope != 0.0]
        return tuple(self.reference + (limit - self.value) / self.slope for limit in limits)

    def __call__(self, temperature: FloatArray) -> FloatArray:
        """Values (n,) at temperatures (n,) [K]."""
        return np.asarray(np.clip(self.value + self.slope * (temperature - self.reference), self.lowest, self.highest))

    def largest(self, low: FloatArray, high: FloatArray) -> FloatArray:
        """See `TemperatureFunction`."""
        return np.asarray(np.maximum(np.abs(self(low)), np.abs(self(high))))


@dataclass(frozen=True)
class Table:
    """Linear between given temperatures, constant beyond the first and the last one.

    Attributes
    ----------
    temperatures : tuple of float
        Ascending [K].
    values : tuple of float
        One for each.
    """

    temperatures: tuple[float, ...]
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.temperatures) != len(self.values) or not self.temperatures:
            raise ValueError(f"{len(self.temperatures)} temperatures and {len(self.values)} values are no table")
        if not np.all(np.diff(self.temperatures) > 0.0):
            raise ValueError("the temperatures of a table have to ascend")

    @property
    def corners(self) -> tuple[float, ...]:
        """The temperatures of the table [K]."""
        return self.temperatures

    def __call__(self, temperature: FloatArray) -> FloatArray:
        """Values (n,) at temperatures (n,) [K]."""
        return np.asarray(np.interp(temperature, self.temperatures, self.values))

    def largest(self, low: FloatArray, high: FloatArray) -> FloatArray:
        """See `TemperatureFunction`."""
        out = np.maximum(np.abs(self(low)), np.abs(self(high)))
        for temperature, value in zip(self.temperatures, self.values, strict=True):
            out = np.where((low < temperature) & (temperature < high), np.maximum(out, abs(value)), out)
        return np.asarray(out)
