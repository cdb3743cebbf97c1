"""The scene: everything a YAML file may say, with units, defaults and bounds.

Only the deformable simulation is described here; `femdeform.scene.kinds` joins it with the others. What needs the
meshes or another block to be judged (an empty selection, an unknown body) is checked in `femdeform.scene.checks`.

A validator of a whole block that blames one of its keys starts its message with that key, ``"dt: ..."``; the
fault is then reported at that key.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from femdeform import registry
from femdeform.scene.amplitude_schema import Amplitude, check_increasing
from femdeform.scene.constraint_schema import BPXPBDSolver, FPPXPBDSolver, PBDSolver, XPBDQSSolver, XPBDSolver
from femdeform.scene.contact_schema import Contact, PenaltyMethod
from femdeform.scene.grid_schema import GridEmbedding
from femdeform.scene.key_path import KeyPath
from femdeform.scene.link_schema import Link
from femdeform.scene.mesh_schema import MeshSource
from femdeform.scene.mixed_schema import MixedFEMSolver
from femdeform.scene.muscle_schema import Muscle
from femdeform.scene.position_schema import PBNGSolver
from femdeform.scene.quantity_schema import Expect, Quantity
from femdeform.scene.scene_model import (
    Direction,
    Finite,
    LineSearch,
    Name,
    NonNegative,
    Positive,
    SceneModel,
    Vector,
    as_tuple,
    default_tag,
    distinct,
)
from femdeform.scene.selection_schema import Selection
from femdeform.scene.thin_schema import MembraneConstraints, RodConstraints

# ------------------------------------------------------------------------------------------------- materials


class _MaterialModel(SceneModel):
    density: Positive = Field(description="mass density in the reference state [kg/m^3]")
    youngs_modulus: Positive = Field(description="Young's modulus at small strain [Pa]")


class _LameMaterial(_MaterialModel):
    poisson_ratio: float = Field(gt=-1.0, lt=0.5, description="Poisson's ratio at small strain [-]")


class LinearMaterial(_LameMaterial):
    law: Literal["linear"] = Field(description="linear elasticity: small strains and small rotations only")


class SaintVenantKirchhoffMaterial(_LameMaterial):
    law: Literal["saint_venant_kirchhoff"] = Field(description="St. Venant-Kirchhoff: large rotations, small strains")


class ARAPMaterial(_LameMaterial):
    law: Literal["arap"] = Field(description="as-rigid-as-possible, mu |F - R|^2: no resistance to volume change")
    poisson_ratio: float = Field(
        default=0.0,
        gt=-1.0,
        lt=0.5,
        description="only enters mu = E / (2 (1 + nu)); the law itself has lambda = 0 [-]",
    )


class CorotatedMaterial(_LameMaterial):
    law: Literal["corotated"] = Field(description="corotated linear elasticity with lambda/2 tr(S - I)^2")


class FixedCorotatedMaterial(_LameMaterial):
    law: Literal["fixed_corotated"] = Field(description="fixed corotated, with lambda/2 (J - 1)^2")


class NeoHookeanMaterial(_LameMaterial):
    law: Literal["neo_hookean"] = Field(
        description="neo-Hookean in the form of Macklin and Mueller, with Lame correction"
    )


class StableNeoHookeanMaterial(_LameMaterial):
    law: Literal["stable_neo_hookean"] = Field(
        description="stable neo-Hookean (Smith et al. 2018), with Lame correction"
    )


class LogarithmicNeoHookeanMaterial(_LameMaterial):
    law: Literal["logarithmic_neo_hookean"] = Field(
        description="neo-Hookean with ln J (Bonet and Wood): defined for J > 0 only"
    )


Material = Annotated[
    LinearMaterial
    | SaintVenantKirchhoffMaterial
    | ARAPMaterial
    | CorotatedMaterial
    | FixedCorotatedMaterial
    | NeoHookeanMaterial
    | StableNeoHookeanMaterial
    | LogarithmicNeoHookeanMaterial,
    Field(discriminator="law"),
]


# ---------------------------------------------------------------------------------------------------- bodies


class _BodyModel(SceneModel):
    mesh: MeshSource = Field(description="mesh of the body: {recipe: NAME, ...} or {file: PATH, ...}")
    material: Material | None = Field(default=None, description="material of every cell without a region of its own")
    regions: dict[str, Material] = Field(
        default_factory=dict, description="materials of named cell groups, over `material`"
    )
    element_order: Literal[1, 2] = Field(default=1, description="polynomial order of the displacement, P1 or P2")
    mass: Literal["lumped", "consistent"] = Field(
        default="lumped", description="mass matrix; lumped is row sum for P1, diagonal scaling (HRZ) for P2"
    )

    @model_validator(mode="after")
    def _has_material(self) -> _BodyModel:
        if self.material is None and not self.regions:
            raise ValueError("a body needs `material`, or `regions` that cover every cell")
        return self


class SolidBody(_BodyModel):
    kind: Literal["solid"] = Field(default="solid", description="tetrahedra in 3D, triangles (plane strain) in 2D")
    skin: MeshSource | None = Field(
        default=None,
        description="surface of triangles that pictures show in place of a body of tetrahedra; it follows the cells "
        "around its points",
    )
    muscle: Muscle | None = Field(default=None, description="muscle fibres in all cells, beside the material")
    muscles: dict[str, Muscle] = Field(
        default_factory=dict, description="muscle fibres in named cell groups, each with its own activation"
    )

    @model_validator(mode="after")
    def _one_way(self) -> SolidBody:
        if self.muscle is not None and self.muscles:
            raise ValueError("muscles: `muscle` means all cells already; use one of the two")
        return self

    @property
    def all_muscles(self) -> Sequence[tuple[str | None, Muscle]]:
        """Muscles by their cell group; None for all cells."""
        return ((None, self.muscle),) if self.muscle is not None else tuple(self.muscles.items())


class MembraneBody(_BodyModel):
    kind: Literal["membrane"] = Field(description="triangles in 3D")
    thickness: Positive = Field(description="thickness of the membrane [m]")
    constraints: MembraneConstraints | None = Field(
        default=None, description="constraints in place of the energy of the law, for the methods xpbd and pbd"
    )
    element_order: Literal[1] = Field(default=1, description="polynomial order of the displacement, P1 only")


class RodBody(_BodyModel):
    kind: Literal["rod"] = Field(description="line cells")
    cross_section: Positive = Field(description="area of the cross-section [m^2]")
    constraints: RodConstraints | None = Field(
        default=None, description="constraints in place of the energy of the law, for the methods xpbd and pbd"
    )
    element_order: Literal[1] = Field(default=1, description="polynomial order of the displacement, P1 only")


Body = Annotated[
    Annotated[SolidBody | MembraneBody | RodBody, Field(discriminator="kind")],
    BeforeValidator(default_tag("kind", "solid")),
]


# ------------------------------------------------------------------------------------------------ conditions


class _ConditionModel(SceneModel):
    on: Selection = Field(description="`body`, `body.group`, or a box, plane, sphere or list of nodes")


class _Support(_ConditionModel):
    components: (
        Annotated[
            tuple[Literal["x", "y", "z"], ...],
            BeforeValidator(as_tuple),
            Field(min_length=1),
            AfterValidator(distinct),
        ]
        | None
    ) = Field(default=None, description="components prescribed, the others are free; all when left out")


class Fixed(_Support):
    kind: Literal["fixed"] = Field(description="held in place")


class _Motion(_Support):
    start: NonNegative = Field(default=0.0, description="time at which the motion starts [s]")
    stop: Positive | None = Field(default=None, description="time at which it stops and holds [s]")

    @model_validator(mode="after")
    def _ordered(self) -> _Motion:
        if self.stop is not None and self.stop <= self.start:
            raise ValueError(f"stop: must be later than start, {self.start:g} [s], not {self.stop:g}")
        return self


class Translate(_Motion):
    kind: Literal["translate"] = Field(description="moves with a constant velocity")
    velocity: Vector = Field(description="velocity of the group [m/s]")


class Rotate(_Motion):
    kind: Literal["rotate"] = Field(description="turns about an axis with a constant rate")
    rate: Finite = Field(description="angular velocity, right-handed about `axis` [rad/s]")
    axis: Direction | None = Field(
        default=None, description="axis of rotation, of any length [-]; needed in 3D, not allowed in 2D"
    )
    center: Vector | None = Field(default=None, description="a point of the axis [m]; default: centroid of the group")


class Twist(Rotate):
    """A screw motion: a rotation with a translation along its axis (stretch while twisting)."""

    kind: Literal["twist"] = Field(  # type: ignore[assignment]
        description="turns about an axis and moves along it, in 3D"
    )
    elongation_rate: Finite = Field(default=0.0, description="velocity along the axis [m/s]")


class Path(_Support):
    kind: Literal["path"] = Field(description="moves along a given path")
    times: list[Finite] = Field(min_length=2, description="increasing times [s]")
    displacements: list[Vector] = Field(min_length=2, description="displacement at each time, linear between [m]")

    @model_validator(mode="after")
    def _consistent(self) -> Path:
        if len(self.times) != len(self.displacements):
            raise ValueError(f"displacements: {len(self.displacements)} displacements for {len(self.times)} times")
        check_increasing(self.times)
        return self


# Conditions that prescribe positions, with `components`.
SUPPORTS = (Fixed, Translate, Rotate, Twist, Path)


class _Load(_ConditionModel):
    amplitude: Amplitude | None = Field(
        default=None,
        description="factor over time; default 1, or a ramp from 0 to 1 over the run if quasistatic",
    )


class Traction(_Load):
    kind: Literal["traction"] = Field(description="force per area on facets, or on a membrane, constant in direction")
    value: Vector = Field(description="force per reference area (2D: per unit thickness), dead load [Pa]")


class Pressure(_Load):
    kind: Literal["pressure"] = Field(description="pressure on facets or a membrane, normal to the deformed surface")
    value: Finite = Field(
        description="pressure on the deformed surface, positive inward; on a membrane against the normals of its "
        "triangles, which point outward in closed recipes [Pa]"
    )


class PointLoad(_Load):
    kind: Literal["point_load"] = Field(description="force on nodes")
    force: Vector = Field(description="total force, shared equally by the selected nodes [N]")


class InitialVelocity(_ConditionModel):
    kind: Literal["initial_velocity"] = Field(description="velocity at time 0")
    velocity: Vector | None = Field(default=None, description="velocity [m/s]")
    angular_velocity: Vector | Finite | None = Field(
        default=None, description="angular velocity about `center`, a vector in 3D, a number in 2D [rad/s]"
    )
    center: Vector | None = Field(
        default=None, description="centre of the rotation [m]; default: centroid of the selected nodes"
    )

    @model_validator(mode="after")
    def _has_velocity(self) -> InitialVelocity:
        if self.velocity is None and self.angular_velocity is None:
            raise ValueError("needs `velocity` or `angular_velocity`")
        return self


Condition = Annotated[
    Fixed | Translate | Rotate | Twist | Path | Traction | Pressure | PointLoad | InitialVelocity,
    Field(discriminator="kind"),
]


# ------------------------------------------------------------------------------------------------- obstacles


class _ObstacleModel(SceneModel):
    stiffness: Positive | None = Field(
        default=None,
        description="penalty per area [Pa/m]; default 10 E / (element size) of the touching body",
    )
    friction: NonNegative = Field(default=0.0, description="Coulomb's coefficient [-]")
    velocity: Vector | None = Field(default=None, description="velocity of the obstacle [m/s]")


class PlaneObstacle(_ObstacleModel):
    kind: Literal["plane"] = Field(description="rigid half space")
    point: Vector = Field(description="a point of the plane [m]")
    normal: Direction = Field(description="normal towards the free side, of any length [-]")


class SphereObstacle(_ObstacleModel):
    kind: Literal["sphere"] = Field(description="rigid ball, a disc in 2D")
    center: Vector = Field(description="centre [m]")
    radius: Positive = Field(description="radius [m]")
    inside: bool = Field(default=False, description="true: bodies are kept inside (a bowl)")


class BoxObstacle(_ObstacleModel):
    kind: Literal["box"] = Field(description="rigid axis-parallel box")
    min: Vector = Field(description="lowest corner [m]")
    max: Vector = Field(description="highest corner [m]")
    inside: bool = Field(default=False, description="true: bodies are kept inside (a container)")

    @model_validator(mode="after")
    def _ordered(self) -> BoxObstacle:
        if len(self.min) != len(self.max):
            raise ValueError(f"max: has {len(self.max)} entries but min has {len(self.min)}")
        if any(a >= b for a, b in zip(self.min, self.max, strict=True)):
            raise ValueError("max: every component must exceed that of min")
        return self


Obstacle = Annotated[PlaneObstacle | SphereObstacle | BoxObstacle, Field(discriminator="kind")]


# ------------------------------------------------------------------------------------------- time and solver


class TimeStepping(SceneModel):
    """Size and end of time steps."""

    dt: Positive = Field(description="time step [s]")
    end: Positive = Field(description="end time [s]")

    @model_validator(mode="after")
    def _ordered(self) -> TimeStepping:
        # A step that exceeds the end by rounding alone is a single step.
        if self.dt > self.end * (1.0 + 1e-9):
            raise ValueError(f"dt: must not exceed end, {self.end:g} [s], not {self.dt:g}")
        return self


class BackwardEulerTime(TimeStepping):
    scheme: Literal["backward_euler"] = Field(description="backward Euler, with inertia")


class QuasistaticTime(TimeStepping):
    scheme: Literal["quasistatic"] = Field(description="a sequence of equilibria, without inertia")
    dt: Positive = Field(description="load step, in the units of the conditions' rates [s]")
    end: Positive = Field(default=1.0, description="end of the loading [s]")


Time = Annotated[BackwardEulerTime | QuasistaticTime, Field(discriminator="scheme")]


class ProjectedNewtonSolver(SceneModel):
    method: Literal["projected_newton"] = Field(
        default="projected_newton", description="Newton with positive semi-definite element Hessians"
    )
    tolerance: float = Field(default=1e-8, gt=0.0, lt=1.0, description="residual over the forces of the problem [-]")
    max_iterations: int = Field(default=100, ge=1, description="Newton iterations a step")
    hessian: Literal["adaptive", "projected", "exact"] = Field(
        default="adaptive",
        description="projected: element Hessians clamped to positive semi-definite; exact: as they are; "
        "adaptive: exact where the step is a descent direction, projected otherwise",
    )
    line_search: LineSearch = Field(default=LineSearch(), description="backtracking line search (Armijo)")

    @property
    def accuracy(self) -> str:
        """What a step promises, in words."""
        return f"{self.tolerance:g} of the forces of each step (column force_scale, N)"


Solver = Annotated[
    Annotated[
        ProjectedNewtonSolver
        | MixedFEMSolver
        | PBNGSolver
        | XPBDSolver
        | PBDSolver
        | XPBDQSSolver
        | BPXPBDSolver
        | FPPXPBDSolver,
        Field(discriminator="method"),
    ],
    BeforeValidator(default_tag("method", "projected_newton")),
]


class KSPLinearSolver(SceneModel):
    method: Literal["ksp"] = Field(default="ksp", description="PETSc's Krylov and direct solvers")
    preset: str = Field(default="newton-mumps", description="a named option set of solvers/presets")
    options: dict[Name, str | int | Finite | bool | None] = Field(
        default_factory=dict, description="PETSc options over the preset, without prefix and dash"
    )


class SciPyDirectLinearSolver(SceneModel):
    method: Literal["scipy_direct"] = Field(description="sparse direct solver of SciPy, serial only")


LinearSolver = Annotated[
    Annotated[KSPLinearSolver | SciPyDirectLinearSolver, Field(discriminator="method")],
    BeforeValidator(default_tag("method", "ksp")),
]


class OnFailure(SceneModel):
    action: Literal["halve_dt", "stop"] = Field(default="halve_dt", description="what to do when a step fails")
    min_dt: Positive | None = Field(default=None, description="smallest step before stopping [s]; default dt / 64")


OutputField = Literal[
    "displacement", "velocity", "reaction", "contact", "von_mises", "jacobian", "energy_density", "cauchy_stress", "pk1"
]


class Output(SceneModel):
    fields: Annotated[list[OutputField], AfterValidator(distinct)] = Field(
        default=["displacement", "velocity"], description="what a frame holds"
    )
    every: int = Field(default=1, ge=1, description="steps between frames")
    checkpoint_every: int = Field(default=10, ge=1, description="steps between checkpoints")


class DeformableScene(SceneModel):
    """A scene of deformable bodies."""

    schema_version: Literal[1] = Field(default=1, description="version of this schema")
    title: str = Field(default="", description="one line for pictures and reports")
    simulation: Literal["deformable"] = Field(description="what is simulated: deformable bodies")
    bodies: dict[Name, Body] = Field(min_length=1, description="bodies by name")
    conditions: list[Condition] = Field(
        default_factory=list, description="supports, motions, loads, initial velocities"
    )
    obstacles: list[Obstacle] = Field(default_factory=list, description="rigid obstacles")
    contact: Contact = Field(default=PenaltyMethod(), description="how contact is treated")
    grid: GridEmbedding | None = Field(
        default=None,
        description="a background grid with which all bodies move, and through which they touch; default: none, bodies "
        "move with the nodes of their meshes",
    )
    links: dict[Name, Link] = Field(
        default_factory=dict, description="springs, ties and attachments by name: energies that hold points together"
    )
    gravity: Vector | None = Field(default=None, description="acceleration of gravity [m/s^2]")
    gravity_amplitude: Amplitude | None = Field(
        default=None,
        description="factor over time; default 1, or a ramp from 0 to 1 over the run if quasistatic",
    )
    time: Time = Field(description="time scheme, step and end")
    solver: Solver = Field(
        default=ProjectedNewtonSolver(),
        description="what solves the equations of a step",
    )
    linear_solver: LinearSolver = Field(
        default=KSPLinearSolver(), description="what solves the linear systems inside the solver"
    )
    on_failure: OnFailure = Field(default=OnFailure(), description="what happens when a step does not converge")
    output: Output = Field(default=Output(), description="what is written, and how often")
    measure: dict[Name, Quantity] = Field(
        default_factory=dict,
        description="quantities by name: a column `measure.NAME` each in history.csv, final values in result.json",
    )
    expect: Expect = Field(default=Expect(), description="values at the end of the run that `run` compares with")

    def mesh_sources(self) -> dict[str, tuple[KeyPath, MeshSource]]:
        """Meshes by body, each with the key it stands at."""
        return {name: (("bodies", name, "mesh"), body.mesh) for name, body in self.bodies.items()}

    @model_validator(mode="before")
    @classmethod
    def _preset_says_how(cls, data: Any) -> Any:
        """A preset for saddle systems is `global_solve` of the mixed solver, unless the scene says it itself."""
        if not isinstance(data, dict):
            return data
        solver, linear = data.get("solver"), data.get("linear_solver")
        preset = linear.get("preset") if isinstance(linear, dict) else None
        word = registry.saddle_preset(preset) if isinstance(preset, str) else ""
        if word and isinstance(solver, dict) and solver.get("method") == "mixed_fem" and "global_solve" not in solver:
            return {**data, "solver": {**solver, "global_solve": word}}
        return data
