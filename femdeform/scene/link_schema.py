"""What a scene may say of links: springs between points, ties between bodies, attachments to space and obstacles."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from femdeform.scene.scene_model import Direction, Name, NonNegative, Positive, SceneModel, Vector
from femdeform.scene.selection_schema import Selection


class LinkEnd(SceneModel):
    """A point of a body, or with `fixed` or `obstacle` a point of space."""

    at: Vector = Field(description="place in the reference state; that of a body lies in one of its cells [m]")
    body: Name | None = Field(
        default=None, description="body that the point belongs to; needed where several bodies hold it"
    )
    fixed: bool = Field(default=False, description="true: a point of space that stays where it is")
    obstacle: Annotated[int, Field(ge=0)] | None = Field(
        default=None, description="place in `obstacles`, from 0, of the obstacle that the point moves with"
    )

    @property
    def is_in_space(self) -> bool:
        """Whether the point belongs to no body."""
        return self.fixed or self.obstacle is not None

    @model_validator(mode="after")
    def _one_owner(self) -> LinkEnd:
        if (self.body is not None) + self.fixed + (self.obstacle is not None) > 1:
            raise ValueError("a point belongs to one of `body`, `fixed` and `obstacle`")
        return self


def _check_ends(ends: list[LinkEnd]) -> None:
    if len(ends) != 2:
        raise ValueError(f"ends: needs two points, not {len(ends)}")
    if all(end.is_in_space for end in ends):
        raise ValueError("ends: one of them has to be a point of a body")


class _Directed(SceneModel):
    """Stiffness that may differ along a direction and across it."""

    stiffness: NonNegative = Field(description="force per displacement of each link [N/m]")
    tangential_stiffness: NonNegative | None = Field(
        default=None, description="the same across `direction`, in the same unit [N/m or Pa/m]; default: as along it"
    )
    direction: Direction | None = Field(
        default=None, description="direction along which `stiffness` acts, fixed in space, of any length [-]"
    )

    @model_validator(mode="after")
    def _holds(self) -> _Directed:
        if self.stiffness == 0.0 and not self.tangential_stiffness:
            raise ValueError("stiffness: links without any stiffness hold nothing")
        if self.direction is not None and self.tangential_stiffness is None:
            raise ValueError(
                "direction: needs `tangential_stiffness`; without it the link is as stiff in every direction"
            )
        return self


class _Points(_Directed):
    @model_validator(mode="after")
    def _has_direction(self) -> _Points:
        if self.tangential_stiffness is not None and self.direction is None:
            raise ValueError("tangential_stiffness: needs `direction`; there is no surface here whose normal is meant")
        return self


class PairLink(_Points):
    kind: Literal["pair"] = Field(description="two points held together")
    ends: list[LinkEnd] = Field(description="the two points")
    gap: Literal["closed", "kept"] = Field(
        default="closed",
        description="closed: the points are pulled onto one another; kept: the vector between them at time 0 is kept",
    )
    offset: Vector | None = Field(
        default=None, description="vector from the second point to the first that is without force, fixed in space [m]"
    )

    @model_validator(mode="after")
    def _consistent(self) -> PairLink:
        _check_ends(self.ends)
        if self.offset is not None and self.gap == "kept":
            raise ValueError("offset: cannot be combined with gap `kept`")
        return self


class SpringLink(SceneModel):
    kind: Literal["spring"] = Field(description="spring between two points, which pulls along the line through them")
    ends: list[LinkEnd] = Field(description="the two points")
    stiffness: Positive = Field(description="force per elongation [N/m]")
    length: NonNegative | None = Field(
        default=None, description="length without force [m]; default: the distance at time 0"
    )

    @model_validator(mode="after")
    def _consistent(self) -> SpringLink:
        _check_ends(self.ends)
        return self


class AttachmentLink(_Points):
    kind: Literal["attachment"] = Field(description="nodes held to points of space, which may move")
    on: Selection = Field(description="`body`, `body.group`, or a box, plane, sphere or list of nodes")
    stiffness: NonNegative = Field(description="force per displacement, of each node [N/m], or per area [Pa/m]")
    per: Literal["node", "area"] = Field(
        default="node", description="node: every node has the whole stiffness; area: that of its share of the surface"
    )
    to: Vector | None = Field(
        default=None, description="point that all nodes are pulled to [m]; default: each one's own place at time 0"
    )
    velocity: Vector | None = Field(default=None, description="velocity of the points of space [m/s]")
    obstacle: Annotated[int, Field(ge=0)] | None = Field(
        default=None, description="place in `obstacles`, from 0, of the obstacle that the points move with"
    )

    @model_validator(mode="after")
    def _one_motion(self) -> AttachmentLink:
        if self.velocity is not None and self.obstacle is not None:
            raise ValueError("velocity: cannot be combined with `obstacle`, which has its own")
        return self


class _Surfaces(_Directed):
    """Nodes of one surface held to another."""

    on: Selection = Field(description="nodes that are held: `body`, `body.group`, or a place")
    to: Selection = Field(description="surface that holds them: `body` for all of it, `body.group`, or a place")
    gap: Literal["closed", "kept"] = Field(
        default="kept",
        description="kept: where the surfaces do not meet, the gap between them is without force; closed: every node "
        "is pulled to the closest point of the surface",
    )
    direction: Direction | None = Field(
        default=None,
        description="direction along which `stiffness` acts, fixed in space, of any length [-]; default: the normal of "
        "the surface `to`, as it is at the start of each step",
    )


class TieLink(_Surfaces):
    kind: Literal["tie"] = Field(description="a surface held to the closest points of another one")
    stiffness: NonNegative = Field(description="force per displacement, of each node [N/m], or per area [Pa/m]")
    per: Literal["node", "area"] = Field(
        default="node",
        description="node: every node is held, with the whole stiffness; area: the quadrature points of every facet "
        "are held, each with the stiffness of its share of the surface",
    )
    max_distance: Positive | None = Field(
        default=None,
        description="distance from the surface beyond which a node is an error [m]; default: a tenth of the mean edge "
        "length of the surface",
    )

    @property
    def points_in_words(self) -> str:
        """What is held."""
        return "nodes" if self.per == "node" else "points"


class BindingLink(_Surfaces):
    kind: Literal["binding"] = Field(
        description="tissue between surfaces that run side by side: whatever is near is held, by stiffness per area"
    )
    stiffness: NonNegative = Field(description="force per displacement and per reference area of `on` [Pa/m]")
    within: Positive = Field(description="distance from the surface up to which nodes are held [m]")


Link = Annotated[
    PairLink | SpringLink | AttachmentLink | TieLink | BindingLink,
    Field(discriminator="kind"),
]
