"""Bodies of material points, and the walls around them."""

from __future__ import annotations

from math import inf
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, model_validator

from femdeform.scene.mesh_schema import MeshSource
from femdeform.scene.scene_model import (
    Direction,
    Finite,
    NonNegative,
    Positive,
    SceneModel,
    Vector,
    as_tuple,
    default_tag,
)
from femdeform.scene.schema import Material
from femdeform.scene.selection_schema import check_corners

# ---------------------------------------------------------------------------------------- functions of temperature


class LinearFunction(SceneModel):
    kind: Literal["linear"] = Field(description="linear in the temperature, between two limits")
    value: Finite = Field(description="value at `reference` [unit of what it stands for]")
    slope: Finite = Field(description="change of the value by kelvin [that unit/K]")
    reference: Finite = Field(description="reference temperature [K]")
    lowest: Finite | None = Field(default=None, description="lower limit [that unit]")
    highest: Finite | None = Field(default=None, description="upper limit [that unit]")

    @model_validator(mode="after")
    def _ordered(self) -> LinearFunction:
        if self.lowest is not None and self.highest is not None and self.lowest > self.highest:
            raise ValueError(f"highest: must not be below lowest, {self.lowest:g}, not {self.highest:g}")
        return self


class TableFunction(SceneModel):
    kind: Literal["table"] = Field(description="linear between given temperatures, constant beyond")
    temperatures: list[Finite] = Field(min_length=1, description="ascending temperatures [K]")
    values: list[Finite] = Field(min_length=1, description="a value for each [unit of what it stands for]")

    @model_validator(mode="after")
    def _consistent(self) -> TableFunction:
        if len(self.temperatures) != len(self.values):
            raise ValueError(f"values: {len(self.values)} values for {len(self.temperatures)} temperatures")
        if any(b <= a for a, b in zip(self.temperatures, self.temperatures[1:], strict=False)):
            raise ValueError("temperatures: must increase from entry to entry")
        return self


TemperatureLaw = Finite | Annotated[LinearFunction | TableFunction, Field(discriminator="kind")]


# ------------------------------------------------------------------------------------------------------- shapes


class _Box(SceneModel):
    kind: Literal["box"] = Field(description="axis-parallel box")
    min: Vector = Field(description="lowest corner [m]")
    max: Vector = Field(description="highest corner [m]")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if len(self.min) != len(self.max):
            raise ValueError(f"max: has {len(self.max)} entries but min has {len(self.min)}")
        check_corners("max", self.min, self.max)
        return self


class BoxShape(_Box):
    pass


class SphereShape(SceneModel):
    kind: Literal["sphere"] = Field(description="ball, a disc in 2D")
    center: Vector = Field(description="centre [m]")
    radius: Positive = Field(description="radius [m]")


class EllipsoidShape(SceneModel):
    kind: Literal["ellipsoid"] = Field(description="axis-parallel ellipsoid, an ellipse in 2D")
    center: Vector = Field(description="centre [m]")
    semi_axes: Annotated[list[Positive], Field(min_length=2, max_length=3)] = Field(description="semi-axes [m]")


class MeshShape(SceneModel):
    kind: Literal["mesh"] = Field(description="inside of a closed surface")
    mesh: MeshSource = Field(description="a closed surface, or a solid whose boundary is one")


Shape = Annotated[BoxShape | SphereShape | EllipsoidShape | MeshShape, Field(discriminator="kind")]


class PlaneShape(SceneModel):
    kind: Literal["plane"] = Field(description="half space behind a plane")
    point: Vector = Field(description="a point of the plane [m]")
    normal: Direction = Field(description="normal towards the free side, of any length [-]")


class PointWall(SceneModel):
    """A rigid wall, as the grid nodes inside of it see it."""

    shape: Annotated[PlaneShape | BoxShape | SphereShape | EllipsoidShape | MeshShape, Field(discriminator="kind")] = (
        Field(description="its shape")
    )
    inside: bool = Field(default=False, description="true: points are kept inside of it (a container)")
    kind: Literal["stick", "slip", "separate"] = Field(
        default="separate", description="nodes move with the wall, along it, or along it and away from it"
    )
    friction: NonNegative = Field(default=0.0, description="Coulomb's coefficient, where it slips or separates [-]")
    velocity: Vector | None = Field(default=None, description="velocity [m/s]")
    temperature: Finite | None = Field(
        default=None, description="temperature that it keeps bodies at where they touch it [K]; default: it insulates"
    )


# ------------------------------------------------------------------------------------------------------- bodies


def value_range(function: TemperatureLaw) -> tuple[float, float]:
    """Lowest and highest value that a number or a function of the temperature can have."""
    if isinstance(function, float):
        return function, function
    if isinstance(function, TableFunction):
        return min(function.values), max(function.values)
    low, high = limits(function)
    if function.slope == 0.0:
        level = min(max(function.value, low), high)
        return level, level
    return low, high


def limits(function: LinearFunction) -> tuple[float, float]:
    """Values that a linear function does not go beyond."""
    low = -inf if function.lowest is None else function.lowest
    return low, inf if function.highest is None else function.highest


class SolidModuli(SceneModel):
    """Constants of a solid that follow the temperature, in place of the numbers of its law."""

    youngs_modulus: Annotated[LinearFunction | TableFunction, Field(discriminator="kind")] | None = Field(
        default=None, description="Young's modulus [Pa]; a linear function needs `lowest`"
    )
    poisson_ratio: Annotated[LinearFunction | TableFunction, Field(discriminator="kind")] | None = Field(
        default=None, description="Poisson's ratio [-]; a linear function needs `lowest` and `highest`"
    )

    @model_validator(mode="after")
    def _in_range(self) -> SolidModuli:
        if self.youngs_modulus is None and self.poisson_ratio is None:
            raise ValueError("needs youngs_modulus or poisson_ratio")
        if self.youngs_modulus is not None and not value_range(self.youngs_modulus)[0] > 0.0:
            raise ValueError("youngs_modulus: has to be positive at every temperature")
        if self.poisson_ratio is not None:
            low, high = value_range(self.poisson_ratio)
            if not (low > -1.0 and high < 0.5):
                raise ValueError("poisson_ratio: has to be between -1 and 0.5, both excluded, at every temperature")
        return self


class LiquidMaterial(SceneModel):
    density: Positive = Field(description="mass density at rest [kg/m^3], in 2D [kg/m^2]")
    bulk_modulus: TemperatureLaw = Field(
        description="pressure over the loss of volume, not negative [Pa]; a linear function needs `lowest`"
    )
    viscosity: TemperatureLaw = Field(
        default=0.0, description="dynamic viscosity, not negative [Pa s]; a linear function needs `lowest`"
    )

    @model_validator(mode="after")
    def _resists(self) -> LiquidMaterial:
        for key, function in (("bulk_modulus", self.bulk_modulus), ("viscosity", self.viscosity)):
            if value_range(function)[0] < 0.0:
                raise ValueError(f"{key}: must not be negative at any temperature")
        return self


class TensionRegion(SceneModel):
    """Another surface tension in a box."""

    box: Annotated[tuple[Vector, Vector], BeforeValidator(as_tuple)] = Field(
        description="lowest and highest corner [m]"
    )
    liquid_gas: TemperatureLaw = Field(description="tension of the free surface there [N/m]")


class SurfaceTensionBlock(SceneModel):
    liquid_gas: TemperatureLaw = Field(description="tension of the free surface [N/m]")
    regions: list[TensionRegion] = Field(default_factory=list, description="boxes with a tension of their own")
    solid_liquid: TemperatureLaw | None = Field(
        default=None, description="tension where the liquid touches walls [N/m]; default that of the free surface"
    )
    contact_angle: float | None = Field(
        default=None,
        ge=0.0,
        le=180.0,
        description="angle through the liquid, in place of `solid_liquid` and by Young's relation [degrees]",
    )
    on_solid: bool = Field(default=False, description="true: solid points have a tension too")

    @model_validator(mode="after")
    def _one_of_them(self) -> SurfaceTensionBlock:
        if self.solid_liquid is not None and self.contact_angle is not None:
            raise ValueError("contact_angle: cannot be combined with solid_liquid")
        if self.contact_angle is not None and not isinstance(self.liquid_gas, float):
            raise ValueError("contact_angle: needs liquid_gas to be a number; give solid_liquid in its place")
        return self


class MovingArc(SceneModel):
    """Heating within a sector that turns about a centre, in the x-y plane."""

    kind: Literal["arc"] = Field(default="arc", description="sector that turns about a centre, in the x-y plane")
    center: Vector = Field(description="centre [m]")
    half_angle: Positive = Field(description="half of the sector's angle [rad]")
    start: Finite = Field(default=0.0, description="direction of its middle at time 0, from the x axis [rad]")
    rate: Finite = Field(default=0.0, description="rate of turning [rad/s]")


class HeatedBox(_Box):
    velocity: Vector | None = Field(default=None, description="velocity; the corners are those at time 0 [m/s]")


class HeatedBall(SceneModel):
    kind: Literal["ball"] = Field(description="ball, a disc in 2D")
    center: Vector = Field(description="centre at time 0 [m]")
    radius: Positive = Field(description="radius [m]")
    velocity: Vector | None = Field(default=None, description="velocity [m/s]")


class Wick(SceneModel):
    """Heating around the end of a wick: where it comes out of the bodies, so it burns down with them."""

    kind: Literal["wick"] = Field(description="ball about the place where a spline comes out of the bodies")
    path: list[Vector] = Field(
        min_length=2, description="points that the wick's spline passes through, from its foot to its end [m]"
    )
    radius: Positive = Field(description="radius of the heated ball [m]")

    @model_validator(mode="after")
    def _consistent(self) -> Wick:
        if len({len(point) for point in self.path}) > 1:
            raise ValueError("path: all points need as many coordinates")
        if any(a == b for a, b in zip(self.path, self.path[1:], strict=False)):
            raise ValueError("path: consecutive points must differ")
        return self


HeatedPlace = Annotated[
    Annotated[MovingArc | HeatedBox | HeatedBall | Wick, Field(discriminator="kind")],
    BeforeValidator(default_tag("kind", "arc")),
]


class HeatBlock(SceneModel):
    capacity: TemperatureLaw = Field(
        description="specific heat, positive [J/(kg K)]; a linear function needs the limit that keeps it so"
    )
    conductivity: TemperatureLaw = Field(description="thermal conductivity [W/(m K)]")
    transfer: NonNegative = Field(default=0.0, description="heat transfer coefficient of the surface [W/(m^2 K)]")
    ambient: Finite = Field(default=0.0, description="ambient temperature [K]")
    flux: Finite = Field(default=0.0, description="heating of the surface whatever its temperature [W/m^2]")
    flux_within: HeatedPlace | None = Field(default=None, description="where the flux acts; default: everywhere")
    flux_start: NonNegative = Field(default=0.0, description="time at which the flux begins [s]")
    flux_end: NonNegative | None = Field(default=None, description="time at which it ends [s]; default: never")
    source: Finite = Field(default=0.0, description="heating of the volume [W/m^3]")
    source_within: HeatedPlace | None = Field(default=None, description="where the source acts; default: everywhere")
    source_start: NonNegative = Field(default=0.0, description="time at which the source begins [s]")
    source_end: NonNegative | None = Field(default=None, description="time at which it ends [s]; default: never")

    @model_validator(mode="after")
    def _conducts(self) -> HeatBlock:
        if not value_range(self.capacity)[0] > 0.0:
            raise ValueError("capacity: has to be positive at every temperature")
        if value_range(self.conductivity)[0] < 0.0:
            raise ValueError("conductivity: must not be negative at any temperature")
        times = {"flux": (self.flux_start, self.flux_end), "source": (self.source_start, self.source_end)}
        for name, (start, end) in times.items():
            if end is not None and end <= start:
                raise ValueError(f"{name}_end: must be later than {name}_start, {start:g} [s], not {end:g}")
        return self


class MeltingBlock(SceneModel):
    solidus: Finite = Field(description="temperature below which liquid freezes [K]")
    liquidus: Finite = Field(description="temperature above which solid melts, not below solidus [K]")
    latent_heat: NonNegative = Field(default=0.0, description="heat of melting, which needs a band [J/kg]")
    liquid_capacity: TemperatureLaw | None = Field(
        default=None,
        description="specific heat above liquidus, positive, where `heat.capacity` is that below solidus, and in "
        "between their mean [J/(kg K)]; default: the same",
    )

    @model_validator(mode="after")
    def _ordered(self) -> MeltingBlock:
        if self.liquidus < self.solidus:
            raise ValueError(f"liquidus: must not be below solidus, {self.solidus:g} [K], not {self.liquidus:g}")
        if self.liquid_capacity is not None and not value_range(self.liquid_capacity)[0] > 0.0:
            raise ValueError("liquid_capacity: has to be positive at every temperature")
        if self.latent_heat > 0.0 and self.liquidus == self.solidus:
            raise ValueError("latent_heat: needs liquidus above solidus, to be spread over the band")
        return self


class TemperatureStart(SceneModel):
    """A temperature that is linear in space at the start."""

    value: Finite = Field(description="temperature at `at` [K]")
    gradient: Vector = Field(description="its gradient [K/m]")
    at: Vector = Field(description="a point [m]")


class PointBody(SceneModel):
    shape: Shape = Field(description="what it fills at the start")
    without: list[Annotated[BoxShape | SphereShape | EllipsoidShape, Field(discriminator="kind")]] = Field(
        default_factory=list, description="what is cut out of the shape"
    )
    points_per_axis: int = Field(default=2, ge=1, le=8, description="points a cell and axis")
    jitter: float = Field(
        default=0.0, ge=0.0, le=1.0, description="random displacement of points over half their distance [-]"
    )
    seed: int = Field(default=0, ge=0, description="seed of the random displacements")
    phase: Literal["solid", "liquid"] | None = Field(
        default=None, description="phase at the start; default that of the only material given"
    )
    solid: Material | None = Field(default=None, description="law of the solid phase")
    moduli: SolidModuli | None = Field(default=None, description="constants of `solid` that follow the temperature")
    liquid: LiquidMaterial | None = Field(
        default=None, description="the liquid phase; what melts or freezes keeps its mass and its volume at rest"
    )
    velocity: Vector | None = Field(default=None, description="velocity at the start [m/s]")
    angular_velocity: Finite | Vector | None = Field(
        default=None, description="rate of turning about the centre at the start [rad/s]; a vector in 3D"
    )
    velocity_gradient: Annotated[list[Vector], Field(min_length=2, max_length=3)] | None = Field(
        default=None,
        description="its change with the place at the start, about the centre of mass: rows are those of a component "
        "[1/s]",
    )
    temperature: Finite | TemperatureStart = Field(default=0.0, description="temperature at the start [K]")
    surface_tension: SurfaceTensionBlock | None = Field(default=None, description="tension of its surface")
    heat: HeatBlock | None = Field(default=None, description="conduction of heat; all bodies have it, or none")
    melting: MeltingBlock | None = Field(default=None, description="melting and freezing; needs `heat`, both phases")

    @model_validator(mode="after")
    def _has_its_materials(self) -> PointBody:
        if self.solid is None and self.liquid is None:
            raise ValueError("needs `solid` or `liquid`, a material")
        if self.moduli is not None and self.solid is None:
            raise ValueError("moduli: needs `solid`, the law that they are of")
        if self.phase is None and self.solid is not None and self.liquid is not None:
            raise ValueError("phase: needed where there are both, solid and liquid")
        if self.phase is not None and getattr(self, self.phase) is None:
            raise ValueError(f"phase: there is no material `{self.phase}`")
        if self.melting is not None and (self.heat is None or self.solid is None or self.liquid is None):
            raise ValueError("melting: needs heat, solid and liquid")
        return self

    @property
    def starts_liquid(self) -> bool:
        """Whether its points are liquid at the start."""
        return self.phase == "liquid" or (self.phase is None and self.liquid is not None)

    @property
    def density(self) -> float:
        """Density of the phase it starts in [kg/m^3]."""
        material = self.liquid if self.starts_liquid else self.solid
        assert material is not None
        return material.density
