"""What scenes of material points measure at surfaces, and what they expect of a quantity over a stretch of time."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from femdeform.scene.quantity_schema import ExpectedValue
from femdeform.scene.scene_model import Finite, Name, NonNegative, SceneModel


class ContactAngleQuantity(SceneModel):
    kind: Literal["contact_angle"] = Field(
        description="angle through the liquid between a flat wall and a circle, in 3D a sphere, fitted to the samples "
        "more than one and a half cells off the wall [degrees]"
    )
    wall: int = Field(default=0, ge=0, description="number of the wall, a plane")
    body: Name | None = Field(default=None, description="restrict to one body")


class ExpectedOverTime(ExpectedValue):
    """A number made of the values that a quantity has had in a stretch of time."""

    quantity: Name = Field(description="a quantity of `measure`")
    statistic: Literal["mean", "peak_time", "decay_rate", "largest_change", "time_below"] = Field(
        description="mean: over time; peak_time: when it is largest [s]; decay_rate: of the exponential fitted to its "
        "distance from `toward` [1/s]; largest_change: from its value at the start of the run; time_below: how long it "
        "is below `level` [s]"
    )
    after: NonNegative = Field(default=0.0, description="begin of the stretch [s]")
    before: Finite | None = Field(default=None, description="its end; default that of the run [s]")
    toward: Finite = Field(default=0.0, description="what a decay ends at, in the unit of the quantity")
    level: Finite | None = Field(default=None, description="level of `time_below`, in the unit of the quantity")

    @property
    def name(self) -> str:
        """What its number is called in a result."""
        return f"{self.statistic} of {self.quantity}"

    @model_validator(mode="after")
    def _has_a_stretch(self) -> ExpectedOverTime:
        if self.before is not None and self.before <= self.after:
            raise ValueError(f"before: must be later than after, {self.after:g} [s], not {self.before:g}")
        if (self.level is None) == (self.statistic == "time_below"):
            raise ValueError("level: belongs to time_below, which needs it")
        return self
