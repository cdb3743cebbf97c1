"""What a scene may say of contact: the method, and the numbers of each."""

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
        _refuse_equal(self.between)
        return self


def _refuse_equal(between: list[tuple[str, str]] | None) -> None:
    if any(first == second for first, second in between or []):
        raise ValueError("between: names pairs of different bodies; `self_contact` is for a body with itself")


class WeakConstraintMethod(SceneModel):
    method: Literal["weak_constraints"] = Field(
        description="between bodies and of solids with themselves, a spring for each vertex in another surface, found "
        "anew in each step; obstacles by penalty"
    )
    stiffness: Positive | None = Field(
        default=None,
        description="force over penetration: of a vertex [N/m], or of an area [Pa/m]; default: ten times Young's "
        "modulus over the mean edge length, by area",
    )
    per: Literal["node", "area"] = Field(
        default="node",
        description="what the given stiffnesses are for: every vertex, or the area of the surface around it",
    )
    tangential_stiffness: NonNegative = Field(
        default=0.0,
        description="the same across the normal, over the sliding in one step of vertices in contact: a drag "
        "[N/m or Pa/m]",
    )
    thickness: NonNegative = Field(
        default=0.0, description="distance at which vertices begin to be pushed away from surfaces [m]"
    )
    margin: Positive | None = Field(
        default=None,
        description="distance beyond `thickness` up to which contact is looked for [m]; default: half the mean edge "
        "length of the surface, that of the body where it is smallest",
    )
    self_contact: bool = Field(default=True, description="whether bodies may touch themselves")
    between: list[BodyPair] | None = Field(
        default=None, min_length=1, description="pairs of bodies that touch each other; default: all"
    )

    @model_validator(mode="after")
    def _different(self) -> WeakConstraintMethod:
        _refuse_equal(self.between)
        return self


Contact = Annotated[
    Annotated[PenaltyMethod | IPCMethod | WeakConstraintMethod, Field(discriminator="method")],
    BeforeValidator(default_tag("method", "penalty")),
]
