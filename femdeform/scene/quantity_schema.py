"""What a scene may measure in every step (`measure:`) and what it expects at its end (`expect:`)."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from femdeform.scene.scene_model import Direction, Finite, Name, NonNegative, SceneModel, Vector
from femdeform.scene.selection_schema import Selection

Component = Literal["x", "y", "z", "norm"]


class Place(SceneModel):
    """Nodes, or a point inside a body; base of what is measured there."""

    on: Selection | None = Field(default=None, description="nodes whose mean is meant")
    at: Vector | None = Field(default=None, description="point of the reference state, inside a cell [m]")

    @model_validator(mode="after")
    def _has_place(self) -> Place:
        if (self.on is None) == (self.at is None):
            raise ValueError("needs one of `on` (nodes) and `at` (a point)")
        return self


# ------------------------------------------------------------------------------------------------ quantities


class MotionQuantity(Place):
    kind: Literal["displacement", "velocity"] = Field(
        description="mean displacement [m] or velocity [m/s] of nodes, or that of a point"
    )
    component: Component = Field(description="component, or the norm of the mean")


class ReactionQuantity(SceneModel):
    kind: Literal["reaction"] = Field(description="force that supports and motions exert on nodes, summed [N]")
    on: Selection = Field(description="nodes; those that no condition holds do not count")
    component: Component = Field(description="component, or the norm of the sum")


class MomentQuantity(SceneModel):
    kind: Literal["moment"] = Field(description="moment of the reaction about an axis, in the deformed state [N m]")
    on: Selection = Field(description="nodes; those that no condition holds do not count")
    axis: Direction | None = Field(
        default=None, description="axis, of any length [-]; needed in 3D, not allowed in 2D, where it is z"
    )
    center: Vector | None = Field(
        default=None, description="a point of the axis [m]; default: centroid of the reference positions of the nodes"
    )


class CellQuantity(SceneModel):
    kind: Literal["volume_ratio", "elastic_energy", "min_jacobian", "max_von_mises", "inverted_cells"] = Field(
        description="deformed over reference volume [-], elastic energy [J], smallest det F [-], largest von Mises "
        "stress of a cell of a solid [Pa], number of cells with a point where det F <= 0 [-]"
    )
    body: Name | None = Field(default=None, description="restrict to one body")


class SystemQuantity(SceneModel):
    kind: Literal["kinetic_energy", "load_potential", "contact_energy", "total_energy", "max_displacement"] = Field(
        description="kinetic energy [J], potential of gravity and dead loads [J], energy of penetration or of barriers "
        "in contact [J], their sum with the elastic energy and that of links [J], largest nodal displacement [m]"
    )


class ContactQuantity(SceneModel):
    kind: Literal["penetration", "contacts"] = Field(
        description="with contact.method weak_constraints, where the last step ended: largest depth of a vertex in "
        "another surface [m], number of vertices that are pushed out of one [-]"
    )


class MomentumQuantity(SceneModel):
    kind: Literal["linear_momentum", "angular_momentum"] = Field(
        description="linear momentum [kg m/s], or angular momentum about the origin [kg m^2/s]"
    )
    component: Component = Field(description="component or norm; in 2D angular momentum has z only")


class LinkQuantity(SceneModel):
    kind: Literal["link_gap", "link_energy"] = Field(
        description="largest distance of the points of a link from where it has no force, a spring's elongation [m]; "
        "energy of the link [J]"
    )
    link: Name | None = Field(default=None, description="one of `links`; default: all of them")


class LinkForceQuantity(SceneModel):
    kind: Literal["link_force"] = Field(
        description="force of a link on its first points (`on`, or the first of `ends`), summed [N]"
    )
    link: Name = Field(description="one of `links`")
    component: Component = Field(description="component, or the norm of the sum")


Quantity = Annotated[
    MotionQuantity
    | ReactionQuantity
    | MomentQuantity
    | CellQuantity
    | SystemQuantity
    | ContactQuantity
    | MomentumQuantity
    | LinkQuantity
    | LinkForceQuantity,
    Field(discriminator="kind"),
]


# ---------------------------------------------------------------------------------------------- expectations


class ExpectedValue(SceneModel):
    value: Finite | None = Field(default=None, description="expected value, with `rtol` or `atol`")
    rtol: NonNegative = Field(default=0.0, description="relative tolerance [-]")
    atol: NonNegative = Field(default=0.0, description="absolute tolerance, in the unit of the value")
    at_least: Finite | None = Field(default=None, description="lower bound, in place of a value")
    at_most: Finite | None = Field(default=None, description="upper bound, in place of a value")

    @model_validator(mode="after")
    def _consistent(self) -> ExpectedValue:
        low, high = self.at_least, self.at_most
        if self.value is None:
            if low is None and high is None:
                raise ValueError("needs `value`, `at_least` or `at_most`")
            if self.rtol or self.atol:
                raise ValueError("rtol and atol belong to `value`; a bound is taken as it is")
            if low is not None and high is not None and low > high:
                raise ValueError(f"at_most: must not be below at_least, {low:g}, not {high:g}")
            return self
        if low is not None or high is not None:
            raise ValueError("value: cannot be combined with at_least or at_most")
        if self.rtol == 0.0 and self.atol == 0.0:
            raise ValueError("give rtol or atol: no computed number equals another exactly")
        return self


class ExpectedDisplacement(ExpectedValue, Place):
    value: Finite | None = Field(default=None, description="expected displacement [m]")
    atol: NonNegative = Field(default=0.0, description="absolute tolerance [m]")
    component: Component = Field(description="component, or the norm of the mean")


class ExpectedReaction(ExpectedValue):
    value: Finite | None = Field(default=None, description="expected force of the supports on the nodes [N]")
    atol: NonNegative = Field(default=0.0, description="absolute tolerance [N]")
    on: Selection = Field(description="nodes; those that no condition holds do not count")
    component: Component = Field(description="component, or the norm of the sum")


class ExpectedTime(ExpectedValue):
    value: Finite | None = Field(default=None, description="expected simulated time [s]")
    atol: NonNegative = Field(default=0.0, description="absolute tolerance [s]")
    quantity: Name = Field(description="a quantity of `measure`")
    level: Finite = Field(description="level that the quantity crosses for the first time, in its unit")


class Expect(SceneModel):
    """Values at the end of the run; one outside its tolerance makes the exit code 1."""

    volume_ratio: ExpectedValue | None = Field(default=None, description="deformed over reference volume [-]")
    elastic_energy: ExpectedValue | None = Field(default=None, description="elastic energy [J]")
    kinetic_energy: ExpectedValue | None = Field(default=None, description="kinetic energy [J]")
    total_energy: ExpectedValue | None = Field(
        default=None,
        description="kinetic and elastic energy, that of contact and of links, potential of gravity and dead loads [J]",
    )
    max_displacement: ExpectedValue | None = Field(default=None, description="largest nodal displacement [m]")
    min_jacobian: ExpectedValue | None = Field(default=None, description="smallest det F [-]")
    residual: ExpectedValue | None = Field(default=None, description="largest relative residual of any step [-]")
    displacement: list[ExpectedDisplacement] = Field(default_factory=list, description="displacements [m]")
    reaction: list[ExpectedReaction] = Field(default_factory=list, description="reaction forces [N]")
    measured: dict[Name, ExpectedValue] = Field(
        default_factory=dict, description="quantities of `measure`, by name, at the end"
    )
    time_to_reach: list[ExpectedTime] = Field(
        default_factory=list, description="simulated times at which quantities of `measure` reach a level [s]"
    )
