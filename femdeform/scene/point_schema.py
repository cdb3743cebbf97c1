"""Scenes of `simulation: material_points`: solids and liquids, their surfaces, heat, melting."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from femdeform.scene.key_path import KeyPath
from femdeform.scene.mesh_schema import MeshSource
from femdeform.scene.point_body_schema import BoxShape, PointBody, PointWall, SphereShape
from femdeform.scene.point_quantity_schema import ContactAngleQuantity, ExpectedOverTime
from femdeform.scene.quantity_schema import Component, ExpectedTime, ExpectedValue
from femdeform.scene.scene_model import Name, Positive, SceneModel, Vector, default_tag, distinct
from femdeform.scene.schema import (
    KSPLinearSolver,
    OnFailure,
    ProjectedNewtonSolver,
    SciPyDirectLinearSolver,
    TimeStepping,
)


class PointGrid(SceneModel):
    """The background grid of a step: cubes of one size, of which only those near points exist."""

    cell_size: Positive = Field(description="distance of the grid nodes [m]")
    low: Vector = Field(description="lowest corner of the domain, which points may not leave [m]")
    high: Vector = Field(description="highest corner of the domain [m]")

    @model_validator(mode="after")
    def _ordered(self) -> PointGrid:
        if len(self.low) != len(self.high):
            raise ValueError(f"high: has {len(self.high)} entries but low has {len(self.low)}")
        if any(a >= b for a, b in zip(self.low, self.high, strict=True)):
            raise ValueError("high: every component must exceed that of low")
        return self


class Transfer(SceneModel):
    """How velocities go from points to the grid and back."""

    scheme: Literal["apic", "pic", "flip", "group_apic"] = Field(
        default="apic",
        description="apic: affine velocities; pic: none; flip: changes of velocity; group_apic: affine velocities that "
        "are exact also where the surface is sampled",
    )
    flip: float = Field(default=0.95, ge=0.0, le=1.0, description="part of FLIP in its blend with PIC [-]")


class SurfaceSampling(SceneModel):
    """Samples of the surface, new ones in each step."""

    density: Positive | None = Field(
        default=None, description="samples a cell's side in 2D, a cell's face in 3D; default 3 and 8 [-]"
    )
    radius: Positive | None = Field(
        default=None,
        description="radius of the spheres around points, over the cell size; default 0.73, 0.867 in 3D [-]",
    )
    seed: int = Field(default=0, ge=0, description="seed of the random places")
    motion: Literal["field", "group"] = Field(
        default="group",
        description="how points at the surface move: field: with the grid where they are, as their deformation sees "
        "it; group: with the mean over all places where their mass is, as published, which loses volume",
    )
    crowding: float = Field(
        default=0.0,
        ge=0.0,
        le=1.0,
        description="part of the excess by which J of liquid points that are closer together than their J says is "
        "lowered in each step, so that their pressure parts them; has an effect with motion: field [-]",
    )
    symmetric: bool = Field(
        default=False,
        description="surface energy of the symmetric part of the deformation, in implicit steps: drops "
        "keep their angular momentum",
    )
    comparison: Literal["massless_samples"] | None = Field(
        default=None,
        description="a published scheme, to compare with: massless_samples take no mass from their points, and forces "
        "on nodes that only they reach are lost, so that neither momentum nor the centre of mass is kept",
    )


class HeatOptions(SceneModel):
    """How heat is conducted."""

    quadrature: Literal["owner", "literal", "shifted"] = Field(
        default="owner",
        description="where the surface exchanges heat: at the points that own its samples; at the samples, as "
        "published, which insulates bodies; at samples moved inwards",
    )
    area_scale: Positive | None = Field(
        default=None,
        description="factor on the sampled area [-]; default: of each body, the area of its shape over that of the "
        "sampled contour at the start, 1 for bodies with a part cut out and where bodies touch",
    )
    tolerance: float = Field(default=1e-10, gt=0.0, lt=1.0, description="reduction of the residual by a solve [-]")


class PointTime(TimeStepping):
    """Time steps of material points; `dt` is the longest one."""

    scheme: Literal["explicit", "backward_euler"] = Field(
        default="backward_euler", description="symplectic Euler, with steps that resolve sound; or implicit"
    )
    cfl: float = Field(
        default=0.6,
        gt=0.0,
        lt=1.0,
        description="part of a cell that points and walls may cross in a step, by their speeds before it [-]",
    )
    growth: float = Field(
        default=1.2, gt=1.0, le=10.0, description="how many times as long a step may be as the one before it [-]"
    )


class PointNewtonSolver(ProjectedNewtonSolver):
    """Newton over the grid nodes of a step."""

    tolerance: float = Field(default=1e-6, gt=0.0, lt=1.0, description="residual over the forces of the problem [-]")


class BlockCGLinearSolver(SceneModel):
    method: Literal["block_cg"] = Field(
        description="conjugate gradients without a matrix, preconditioned by the blocks of nodes"
    )
    tolerance: float = Field(default=1e-6, gt=0.0, lt=1.0, description="reduction of the residual [-]")
    max_iterations: int = Field(default=5000, ge=1, description="iterations before the solve has failed")


PointLinearSolver = Annotated[
    Annotated[
        KSPLinearSolver | SciPyDirectLinearSolver | BlockCGLinearSolver,
        Field(discriminator="method"),
    ],
    BeforeValidator(default_tag("method", "ksp")),
]

PointField = Literal["velocity", "speed", "J", "pressure", "temperature", "phase", "body"]


class PointOutput(SceneModel):
    fields: Annotated[list[PointField], AfterValidator(distinct)] = Field(
        default=["velocity", "J", "phase", "body"], description="what a frame holds beside positions"
    )
    every: int = Field(default=1, ge=1, description="steps between frames")
    checkpoint_every: int = Field(default=100, ge=1, description="steps between checkpoints")


# ---------------------------------------------------------------------------------------------- quantities


Region = Annotated[BoxShape | SphereShape, Field(discriminator="kind")]


class PointSumQuantity(SceneModel):
    kind: Literal[
        "mass",
        "volume",
        "visible_volume",
        "kinetic_energy",
        "max_speed",
        "surface_area",
        "surface_energy",
        "heat",
        "mean_temperature",
        "min_temperature",
        "max_temperature",
        "liquid_fraction",
        "mean_pressure",
        "min_jacobian",
        "virial",
    ] = Field(
        description="mass [kg], volume by the J of the points [m^3], visible volume: inside the contour of the points "
        "[m^3], kinetic energy [J], largest speed of a point [m/s], area of the sampled "
        "surface [m^2] and its energy [J], sum of m c T [J], temperatures weighed by mass [K], part of the mass that "
        "is liquid [-], mean pressure of liquid points by volume [Pa], smallest volume ratio [-]; virial: "
        "d int p dV / ((d - 1) int k dA) - 1 of liquid in d dimensions, whose mean over time is zero at rest [-]"
    )
    body: Name | None = Field(default=None, description="restrict to one body")
    within: Region | None = Field(default=None, description="restrict to points that are inside at the time")

    @model_validator(mode="after")
    def _is_of_points(self) -> PointSumQuantity:
        if self.within is not None and self.kind in ("surface_area", "surface_energy", "virial"):
            raise ValueError(f"within: is for sums over points, {self.kind} is that of the whole surface")
        return self


class PointVectorQuantity(SceneModel):
    kind: Literal[
        "centroid",
        "linear_momentum",
        "angular_momentum",
        "highest",
        "lowest",
        "extent",
        "mean_velocity",
        "thermal_moment",
    ] = Field(
        description="centre of mass [m], linear momentum [kg m/s], angular momentum about the origin [kg m^2/s], "
        "highest and lowest coordinate of a point and the distance of the two [m], velocity of the centre of mass "
        "[m/s], mean by mass of the temperature times the distance from the centre of mass [K m]"
    )
    component: Component = Field(description="component, or the norm; in 2D angular momentum has z only")
    body: Name | None = Field(default=None, description="restrict to one body")
    within: Region | None = Field(default=None, description="restrict to points that are inside at the time")


class SecondMomentQuantity(SceneModel):
    kind: Literal["second_moment"] = Field(
        description="integral of x^2 - y^2 about the centre of mass over the mass [m^2]: how far a drop is from round"
    )
    body: Name | None = Field(default=None, description="restrict to one body")


PointQuantity = Annotated[
    PointSumQuantity | PointVectorQuantity | SecondMomentQuantity | ContactAngleQuantity, Field(discriminator="kind")
]


class PointExpect(SceneModel):
    """Values at the end of the run; one outside its tolerance makes the exit code 1."""

    residual: ExpectedValue | None = Field(default=None, description="largest relative residual of any step [-]")
    measured: dict[Name, ExpectedValue] = Field(
        default_factory=dict, description="quantities of `measure`, by name, at the end"
    )
    time_to_reach: list[ExpectedTime] = Field(
        default_factory=list, description="simulated times at which quantities of `measure` reach a level [s]"
    )
    over_time: list[ExpectedOverTime] = Field(
        default_factory=list, description="means, rates and times of quantities of `measure` over a stretch of time"
    )


class PointScene(SceneModel):
    """A scene of material points."""

    schema_version: Literal[1] = Field(default=1, description="version of this schema")
    title: str = Field(default="", description="one line for pictures and reports")
    simulation: Literal["material_points"] = Field(description="what is simulated: material points")
    grid: PointGrid = Field(description="the background grid and the domain")
    bodies: dict[Name, PointBody] = Field(min_length=1, description="bodies by name")
    walls: list[PointWall] = Field(default_factory=list, description="rigid walls")
    gravity: Vector | None = Field(default=None, description="acceleration of gravity [m/s^2]")
    transfer: Transfer = Field(default=Transfer(), description="transfers between points and grid")
    surface: SurfaceSampling = Field(default=SurfaceSampling(), description="how surfaces are sampled")
    heat: HeatOptions = Field(default=HeatOptions(), description="how heat is conducted, where bodies have `heat`")
    time: PointTime = Field(description="time scheme, longest step and end")
    solver: PointNewtonSolver = Field(
        default=PointNewtonSolver(), description="what solves the equations of an implicit step"
    )
    linear_solver: PointLinearSolver = Field(
        default=KSPLinearSolver(), description="what solves the linear systems of an implicit step"
    )
    on_failure: OnFailure = Field(default=OnFailure(), description="what happens when a step does not converge")
    output: PointOutput = Field(default=PointOutput(), description="what is written, and how often")
    measure: dict[Name, PointQuantity] = Field(
        default_factory=dict,
        description="quantities by name: a column `measure.NAME` each in history.csv, final values in result.json",
    )
    expect: PointExpect = Field(
        default=PointExpect(), description="values at the end of the run that `run` compares with"
    )

    def mesh_sources(self) -> dict[str, tuple[KeyPath, MeshSource]]:
        """Meshes of bodies by their names and of walls by their numbers, each with the key it stands at."""
        sources: dict[str, tuple[KeyPath, MeshSource]] = {}
        for name, body in self.bodies.items():
            if body.shape.kind == "mesh":
                sources[name] = (("bodies", name, "shape", "mesh"), body.shape.mesh)
        for number, wall in enumerate(self.walls):
            if wall.shape.kind == "mesh":
                sources[f"walls-{number}"] = (("walls", number, "shape", "mesh"), wall.shape.mesh)
        return sources

    @property
    def dim(self) -> int:
        """Dimension of space."""
        return len(self.grid.low)

    @property
    def n_cells(self) -> int:
        """Number of grid cells in the domain, which stands for the number of points."""
        size = 1.0
        for a, b in zip(self.grid.low, self.grid.high, strict=True):
            size *= (b - a) / self.grid.cell_size
        return int(size)
