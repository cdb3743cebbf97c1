"""What learned weights were trained and tried on, and which grids lie outside of that."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from femdeform.flow.pressure_system import AIR, PressureSystem

KEY = "range"
# Grids may be as many times larger than the largest that was tried.
_LARGER = 2
# Parts are compared as texts show them.
_ROUNDING = 5e-3


@dataclass(frozen=True)
class TrainedRange:
    """Grids that weights are for.

    Attributes
    ----------
    cells : int
        Voxels along the longest edge of the largest grid that they were tried on.
    air : bool
        Whether there was air.
    least_fluid, most_fluid : float
        Part of the voxels that are fluid [-].
    """

    cells: int
    air: bool
    least_fluid: float
    most_fluid: float = 1.0

    @classmethod
    def of(cls, meta: Mapping[str, Any]) -> TrainedRange | None:
        """From what a file of weights says; None if it says nothing."""
        return cls(**meta[KEY]) if KEY in meta else None

    def as_meta(self) -> dict[str, Any]:
        """For a file of weights."""
        return {KEY: asdict(self)}

    def refusal(self, system: PressureSystem) -> str:
        """What of the system the weights do not know; an empty text if they know it."""
        if max(system.shape) > _LARGER * self.cells:
            return f"{max(system.shape)} voxels along an edge, tried on {self.cells}"
        if not self.air and bool(np.any(system.labels == AIR)):
            return "there is air, trained without"
        part = system.n_unknowns / float(np.prod(system.shape))
        if not self.least_fluid - _ROUNDING <= part <= self.most_fluid + _ROUNDING:
            return f"{part:.2f} of the voxels are fluid, trained on {self.least_fluid:.2f} to {self.most_fluid:.2f}"
        return ""
