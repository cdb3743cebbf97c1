"""Scenes of `simulation: incompressible_flow`: smoke in air on a grid of voxels."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from femdeform.scene.key_path import KeyPath
from femdeform.scene.mesh_schema import MeshSource
from femdeform.scene.pressure_schema import MultigridPressureSolver, PressureSolver
from femdeform.scene.quantity_schema import Component, ExpectedTime, ExpectedValue
from femdeform.scene.scene_model import (
    Direction,
    Finite,
    Name,
    NonNegative,
    Positive,
    SceneModel,
    Vector,
    as_tuple,
    distinct,
)
from femdeform.scene.schema import OnFailure, TimeStepping
from femdeform.scene.selection_schema import check_corners

Side = Literal["wall", "open"]
SideName = Literal["left", "right", "bottom", "top", "back", "front"]


class VoxelGrid(SceneModel):
    """The voxels of a flow, cubes of one size."""

    cells: Annotated[
        tuple[Annotated[int, Field(ge=4)], ...], BeforeValidator(as_tuple), Field(min_length=2, max_length=3)
    ] = Field(description="number of voxels along each axis; two numbers make a flow in the plane")
    cell_size: Positive = Field(description="side of a voxel [m]")
    origin: Vector | None = Field(default=None, description="lower corner of the grid [m]; default 0")


class FlowBoundaries(SceneModel):
    """The sides of the grid: walls, or open to air at rest, where the outermost voxels are air."""

    left: Side = Field(default="wall", description="side of lowest x")
    right: Side = Field(default="wall", description="side of highest x")
    bottom: Side = Field(default="wall", description="side of lowest y")
    top: Side = Field(default="wall", description="side of highest y")
    back: Side = Field(default="wall", description="side of lowest z, in 3D")
    front: Side = Field(default="wall", description="side of highest z, in 3D")


class BoxRegion(SceneModel):
    box: Annotated[tuple[Vector, Vector], BeforeValidator(as_tuple)] = Field(
        description="lowest and highest corner of an axis-parallel box [m]"
    )

    @model_validator(mode="after")
    def _ordered(self) -> BoxRegion:
        check_corners("box", *self.box)
        return self


class Ball(SceneModel):
    center: Vector = Field(description="centre [m]")
    radius: Positive = Field(description="radius [m]")


class BallRegion(SceneModel):
    sphere: Ball = Field(description="a ball, in the plane a disc")


Region = BoxRegion | BallRegion


class SolidMotion(SceneModel):
    """Motion of a solid as a whole: it turns about a centre, which moves on a line."""

    velocity: Vector | None = Field(default=None, description="velocity of the centre [m/s]; default 0")
    rate: Finite = Field(default=0.0, description="rate of turning [rad/s]")
    axis: Direction | None = Field(default=None, description="axis in 3D, of any length [-]; default z")
    center: Vector | None = Field(
        default=None, description="centre at the start [m]; default: middle of the box around the solid"
    )


class FlowSolid(SceneModel):
    mesh: MeshSource = Field(description="a closed surface, or a solid whose boundary is one")
    motion: SolidMotion | None = Field(default=None, description="how it moves; default: it rests")


class SmokeSource(SceneModel):
    region: Region = Field(description="voxels with their centre inside give off smoke")
    density: NonNegative = Field(default=1.0, description="density of smoke there [-]")
    velocity: Vector | None = Field(
        default=None,
        description="velocity given to the fluid there before each projection, which stirs it [m/s]; default: that of "
        "the flow. Fluid enters through `inlets` only",
    )
    end: Positive | None = Field(default=None, description="time at which it stops [s]; default: never")


class Inlet(SceneModel):
    side: SideName = Field(description="side of the grid that it is in, which has to be a wall beside it")
    region: Region | None = Field(
        default=None, description="faces of that side with their centre inside belong to it; default: the whole side"
    )
    velocity: Finite | Vector = Field(
        description="velocity on those faces: speed into the grid, at right angles to the side, or a vector; fluid is "
        "drawn out where it points outwards [m/s]"
    )
    density: NonNegative = Field(default=0.0, description="density of smoke in what comes in [-]")


class FlowTime(TimeStepping):
    """Time steps of a flow. A step in which something would cross more than three voxels is taken in parts."""


FlowField = Literal["density", "velocity", "speed", "pressure", "vorticity", "divergence", "solid"]


class FlowOutput(SceneModel):
    fields: Annotated[list[FlowField], AfterValidator(distinct)] = Field(
        default=["density", "velocity", "solid"], description="what a frame holds, at the centres of the voxels"
    )
    every: int = Field(default=1, ge=1, description="steps between frames")
    checkpoint_every: int = Field(default=10, ge=1, description="steps between checkpoints")


class FlowQuantity(SceneModel):
    kind: Literal["smoke", "kinetic_energy", "max_speed", "divergence", "imbalance"] = Field(
        description="integral of the density of smoke [m^3, in the plane m^2], kinetic energy [J, in the plane J/m], "
        "largest velocity component of a face [m/s], largest divergence of a fluid voxel after the last projection "
        "[1/s], largest mean divergence of a closed part, which no pressure can take away [1/s]"
    )


class SmokeCentroid(SceneModel):
    kind: Literal["smoke_centroid"] = Field(description="centroid of the smoke [m]")
    component: Component = Field(description="component, or the norm")


class FlowPointQuantity(SceneModel):
    kind: Literal["velocity", "density"] = Field(description="velocity [m/s] or density of smoke [-] at a point")
    at: Vector = Field(description="the point, inside of the grid [m]")
    component: Component = Field(default="norm", description="component of the velocity, or its norm")


FlowMeasure = Annotated[FlowQuantity | SmokeCentroid | FlowPointQuantity, Field(discriminator="kind")]


class FlowExpect(SceneModel):
    """Values at the end of the run; one outside its tolerance makes the exit code 1."""

    residual: ExpectedValue | None = Field(
        default=None, description="largest relative residual of a pressure solve of any step [-]"
    )
    divergence: ExpectedValue | None = Field(
        default=None, description="largest divergence of a fluid voxel after the projection of any step [1/s]"
    )
    measured: dict[Name, ExpectedValue] = Field(
        default_factory=dict, description="quantities of `measure`, by name, at the end"
    )
    time_to_reach: list[ExpectedTime] = Field(
        default_factory=list, description="simulated times at which quantities of `measure` reach a level [s]"
    )


class FlowScene(SceneModel):
    """A scene of smoke in an incompressible flow."""

    schema_version: Literal[1] = Field(default=1, description="version of this schema")
    title: str = Field(default="", description="one line for pictures and reports")
    simulation: Literal["incompressible_flow"] = Field(description="what is simulated: smoke in air, in voxels")
    grid: VoxelGrid = Field(description="the voxels")
    boundaries: FlowBoundaries = Field(default=FlowBoundaries(), description="the sides of the grid")
    solids: dict[Name, FlowSolid] = Field(default_factory=dict, description="solids in the flow, by name")
    sources: dict[Name, SmokeSource] = Field(default_factory=dict, description="where smoke comes from, by name")
    inlets: dict[Name, Inlet] = Field(default_factory=dict, description="where fluid is driven in, by name")
    density: Positive = Field(
        default=1.0, description="density of the fluid, which only energies and pressures need [kg/m^3]"
    )
    buoyancy: Finite = Field(default=2.0, description="upward acceleration of smoke of density 1, along y [m/s^2]")
    time: FlowTime = Field(description="time step and end")
    linear_solver: PressureSolver = Field(default=MultigridPressureSolver(), description="what solves for the pressure")
    on_failure: OnFailure = Field(default=OnFailure(), description="what happens when a pressure is not found")
    output: FlowOutput = Field(default=FlowOutput(), description="what is written, and how often")
    measure: dict[Name, FlowMeasure] = Field(
        default_factory=dict,
        description="quantities by name: a column `measure.NAME` each in history.csv, final values in result.json",
    )
    expect: FlowExpect = Field(
        default=FlowExpect(), description="values at the end of the run that `run` compares with"
    )

    def mesh_sources(self) -> dict[str, tuple[KeyPath, MeshSource]]:
        """Meshes by solid, each with the key it stands at."""
        return {name: (("solids", name, "mesh"), solid.mesh) for name, solid in self.solids.items()}

    @property
    def dim(self) -> int:
        """Dimension of space."""
        return len(self.grid.cells)

    @property
    def n_cells(self) -> int:
        """Number of voxels."""
        return math.prod(self.grid.cells)
