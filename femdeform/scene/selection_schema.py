"""What an `on:` may say: a name, or a place."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field, model_validator

from femdeform.scene.scene_model import Direction, Positive, SceneModel, Vector, as_tuple


def check_corners(key: str, low: tuple[float, ...], high: tuple[float, ...]) -> None:
    if len(low) == len(high) and any(a > b for a, b in zip(low, high, strict=True)):
        raise ValueError(f"{key}: the lowest corner comes first, and no component of it may exceed the highest")


class BoxSelection(SceneModel):
    box: Annotated[tuple[Vector, Vector], BeforeValidator(as_tuple)] = Field(
        description="lowest and highest corner of an axis-parallel box [m]"
    )
    body: str | None = Field(default=None, description="restrict to one body")

    @model_validator(mode="after")
    def _ordered(self) -> BoxSelection:
        check_corners("box", *self.box)
        return self


class PlaneRegion(SceneModel):
    point: Vector = Field(description="a point of the plane [m]")
    normal: Direction = Field(description="normal of the plane, of any length [-]")
    tolerance: Positive | None = Field(
        default=None,
        description="half thickness of the slab that counts as on the plane [m]; default 1e-6 of the size",
    )


class PlaneSelection(SceneModel):
    plane: PlaneRegion = Field(description="nodes on a plane")
    body: str | None = Field(default=None, description="restrict to one body")


class SphereRegion(SceneModel):
    center: Vector = Field(description="centre [m]")
    radius: Positive = Field(description="radius [m]")


class SphereSelection(SceneModel):
    sphere: SphereRegion = Field(description="nodes in a ball")
    body: str | None = Field(default=None, description="restrict to one body")


class NodeSelection(SceneModel):
    nodes: list[Annotated[int, Field(ge=0)]] = Field(min_length=1, description="0-based points of the mesh")
    body: str | None = Field(default=None, description="body the numbers refer to; needed with several bodies")


# A name is `body` (all of it) or `body.group`.
Selection = Annotated[str, Field(min_length=1)] | BoxSelection | PlaneSelection | SphereSelection | NodeSelection
