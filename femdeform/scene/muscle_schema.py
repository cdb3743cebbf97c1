"""What a scene may say of muscles: fibres, their strength, and how active they are."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from femdeform.scene.amplitude_schema import Amplitude
from femdeform.scene.scene_model import Direction, Positive, SceneModel
from femdeform.scene.selection_schema import Selection


class ConstantFibres(SceneModel):
    kind: Literal["constant"] = Field(description="parallel fibres")
    direction: Direction = Field(description="direction in the reference state, of any length [-]")


class CellDataFibres(SceneModel):
    kind: Literal["cell_data"] = Field(description="directions from the mesh file (.vtu, .vtk, .npz)")
    name: str = Field(min_length=1, description="name of the file's cell data: a vector of any length for each cell")


class HarmonicFibres(SceneModel):
    kind: Literal["harmonic"] = Field(
        description="along the gradient of the harmonic function that is 0 at the origin and 1 at the insertion, with "
        "no flux through the rest of the muscle's surface"
    )
    origin: Selection = Field(description="where fibres begin; those of its nodes that belong to the muscle")
    insertion: Selection = Field(description="where they end; those of its nodes that belong to the muscle")


Fibres = Annotated[ConstantFibres | CellDataFibres | HarmonicFibres, Field(discriminator="kind")]


class Muscle(SceneModel):
    """Fibres beside the material of a solid, with passive and active tension."""

    fibres: Fibres = Field(description="the direction of the fibres in each cell")
    max_isometric_stress: Positive = Field(
        description="true stress along fully active fibres of optimal length [Pa]; skeletal muscle about 3e5"
    )
    optimal_stretch: Positive = Field(
        default=1.4, description="stretch from the reference state at which active fibres pull hardest [-]"
    )
    activation: Annotated[float, Field(ge=0.0, le=1.0)] | Amplitude = Field(
        description="activation from 0 to 1: a number, or a table over time, linear between its entries [-]"
    )

    @model_validator(mode="after")
    def _in_range(self) -> Muscle:
        if isinstance(self.activation, Amplitude) and not all(0.0 <= value <= 1.0 for value in self.activation.values):
            raise ValueError("activation: every value has to lie between 0 and 1")
        return self
