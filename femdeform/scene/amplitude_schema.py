"""Factors over time."""

from __future__ import annotations

import itertools

from pydantic import Field, model_validator

from femdeform.scene.scene_model import Finite, SceneModel


def check_increasing(times: list[float]) -> None:
    """Raise a ValueError unless times increase."""
    if any(b <= a for a, b in itertools.pairwise(times)):
        raise ValueError("times: must increase from entry to entry")


class Amplitude(SceneModel):
    """A factor over time, piecewise linear, constant outside its range."""

    times: list[Finite] = Field(min_length=2, description="increasing times [s]")
    values: list[Finite] = Field(min_length=2, description="factor at each time [-]")

    @model_validator(mode="after")
    def _consistent(self) -> Amplitude:
        if len(self.times) != len(self.values):
            raise ValueError(f"values: {len(self.values)} values for {len(self.times)} times")
        check_increasing(self.times)
        return self
