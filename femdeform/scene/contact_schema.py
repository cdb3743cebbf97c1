"""What a scene may say of contact: the method, and the numbers of incremental potential contact."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from femdeform.scene.scene_model import Name, NonNegative, Positive, SceneModel, as_tuple, default_tag


class PenaltyMethod(SceneModel):
    method: Literal["penalty"] = Field(
        default="penalty", description="penalty on penetration, with obstacles only: bodies pass through one another"
    )


BodyPair = Annotated[tuple[Name, Name], BeforeValidator(as_tuple)]


class IPCMethod(SceneModel):
    method: Literal["ipc"] = Field(
        description="incremental potential contact: a barrier that nothing passes, with obstacles, between bodies and "
        "of bodies with themselves"
    )
    distance: Positive | None = Field(
        default=None,
        description="gap at which the barrier starts to act [m]; default: a tenth of the mean edge length of the "
        "surface, that of the body where it is smallest",
    )
    stiffness: Positive | Literal["auto"] = Field(
        default="auto", description="stiffness of the barrier [Pa]; auto: from stiffness and inertia of each body"
    )
    friction: NonNegative = Field(
        default=0.0, description="Coulomb's coefficient between bodies [-]; obstacles have their own"
    )
    friction_velocity: Positive | None = Field(
        default=None,
        description="slip velocity up to which friction sticks [m/s]; default: 1e-3 of the largest body per second",
    )
    self_contact: bool = Field(default=True, description="whether bodies may touch themselves")
    between: list[BodyPair] | None = Field(
        default=None, min_length=1, description="pairs of bodies that touch each other; default: all"
    )

    @model_validator(mode="after")
    def _different(self) -> IPCMethod:
        if any(first == second for first, second in self.between or []):
            raise ValueError("between: names pairs of different bodies; `self_contact` is for a body with itself")
        return self


Contact = Annotated[
    Annotated[PenaltyMethod | IPCMethod, Field(discriminator="method")],
    BeforeValidator(default_tag("method", "penalty")),
]
