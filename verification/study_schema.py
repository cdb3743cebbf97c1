"""What a `study.yaml` may say: studies of one or more scenes, what is measured in them, and the bands it must lie in.

Keys, types and bounds are checked as those of a scene are, every fault at once and with its line. What needs the scene
of a study, its expressions or the table of analytic references to be judged is checked in `verification.case`.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from femdeform.scene.scene_model import Finite, Name, NonNegative, Positive, SceneModel, as_tuple

Interval = Annotated[tuple[Finite, Finite], BeforeValidator(as_tuple)]
# A number, or an expression such as "2*a/3" (see `verification.expressions`).
Number = Annotated[float | str, Field(union_mode="smart")]
Symbol = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
Settings = dict[str, Any]
Vector = Annotated[list[Number], Field(min_length=2, max_length=3)]


# ---------------------------------------------------------------------------------------------- references


class ValueReference(SceneModel):
    """A published or known number."""

    value: Number = Field(description="the number, or an expression of the constants, in the unit of the quantity")
    source: str = Field(min_length=1, description="where the number is from: authors, title, table; or why it holds")


class AnalyticReference(SceneModel):
    """A formula of the table `verification.analytic.ANALYTIC`, evaluated for the scene of each level."""

    analytic: str = Field(description="name of a function f(scene, **arguments) -> float")
    arguments: dict[Symbol, Any] = Field(
        default_factory=dict, description="numbers, expressions of the constants, or lists of them"
    )


class FinerRun(SceneModel):
    """Another run of the study's scene."""

    set: Settings = Field(default_factory=dict, description="overrides, over those of the study")
    integrator: Literal["backward_euler", "trapezoidal"] | None = Field(
        default=None, description="time integration; default: that of the study"
    )


class RunReference(SceneModel):
    run: FinerRun = Field(description="a finer run of the same scene; for l2 and h1 on the same mesh")


class LevelReference(SceneModel):
    level: Literal["first", "last", "previous"] = Field(
        description="another level of the study; the level itself has no error then"
    )


Reference = ValueReference | AnalyticReference | RunReference | LevelReference


# ---------------------------------------------------------------------------------------------- judgements


class Band(SceneModel):
    """What a quantity has to fulfil. Several conditions are several judgements."""

    rate: Interval | None = Field(default=None, description="observed order of the last pair of levels [-]")
    rtol: NonNegative | None = Field(default=None, description="error allowed, as a part of `scale` [-]")
    atol: NonNegative | None = Field(default=None, description="error allowed, in the unit of the quantity")
    between: Interval | None = Field(default=None, description="lowest and highest value, in the unit of the quantity")
    at_most: Finite | None = Field(default=None, description="highest value, in the unit of the quantity")
    at_least: Finite | None = Field(default=None, description="lowest value, in the unit of the quantity")
    decreasing: bool = Field(default=False, description="true: the error falls from level to level")

    @model_validator(mode="after")
    def _ordered(self) -> Band:
        for key in ("rate", "between"):
            pair = getattr(self, key)
            if pair is not None and pair[0] > pair[1]:
                raise ValueError(f"{key}: the lower bound comes first")
        if self.at_least is not None and self.at_most is not None and self.at_least > self.at_most:
            raise ValueError(f"at_most: must not be below at_least, {self.at_least:g}, not {self.at_most:g}")
        return self

    @property
    def is_empty(self) -> bool:
        """Whether nothing is asked for."""
        bounds = (self.rate, self.rtol, self.atol, self.between, self.at_most, self.at_least)
        return not self.decreasing and all(bound is None for bound in bounds)


class Quantity(Band):
    """A quantity of a study: its reference and its bands."""

    reference: Reference | None = Field(default=None, description="what it is compared with")
    scale: Positive | None = Field(
        default=None, description="what `rtol` is a part of; default: the size of the reference"
    )
    window: Interval | None = Field(
        default=None, description="first and last time that FUNCTION(name) looks at [s]; default: the whole run"
    )
    coarse: Band | None = Field(default=None, description="bands of the quick run, in place of those above")
    report_only: bool = Field(default=False, description="true: shown, not judged")

    @model_validator(mode="after")
    def _asks_for_something(self) -> Quantity:
        if self.report_only != self.is_empty:
            raise ValueError(
                "report_only: cannot be combined with a band"
                if self.report_only
                else "needs a band: rate, rtol, atol, between, at_most, at_least or decreasing (or report_only: true)"
            )
        if self.window is not None and self.window[0] >= self.window[1]:
            raise ValueError("window: the first time comes first")
        return self


# ------------------------------------------------------------------------------------------- the problem solved


class Fields(SceneModel):
    """What a scene cannot say: expressions in x, y, z (reference position, [m]) and the constants."""

    displacement: Vector | None = Field(
        default=None,
        description="displacement that held components follow, growing linearly over a quasistatic run; the exact "
        "solution of l2 and h1 [m]",
    )
    body_force: Literal["manufactured", "none"] = Field(
        default="none",
        description="manufactured: force per volume, and traction on free boundary, that keep `displacement` in "
        "equilibrium",
    )
    initial_velocity: Vector | None = Field(default=None, description="velocity at time 0 [m/s]")
    move_mesh: Vector | None = Field(default=None, description="shift of the mesh points before all else [m]")

    @model_validator(mode="after")
    def _consistent(self) -> Fields:
        if self.body_force == "manufactured" and self.displacement is None:
            raise ValueError("body_force: `manufactured` needs `displacement`")
        return self


class Variation(SceneModel):
    """One of the repetitions of a study under `each`."""

    set: Settings = Field(default_factory=dict, description="overrides of the scene, over those of the study")
    constants: dict[Symbol, Finite] = Field(default_factory=dict, description="over those of the study")
    quantities: dict[str, Quantity] = Field(
        default_factory=dict, description="each in place of the study's one of the same name, or in addition"
    )
    coarse: int | None = Field(default=None, ge=1, description="levels of the quick run; default: the study's")
    full_only: bool | None = Field(default=None, description="true: left out of the quick run; default: the study's")


class RefinementLevel(SceneModel):
    """A mesh."""

    set: Settings = Field(description="overrides that make the mesh of this level")
    size: Number = Field(description="element size, of any unit common to all levels; a number or an expression")
    label: str = Field(default="", description="name of the level; default: its number")


class SweepLevel(SceneModel):
    """One entry of a sweep."""

    set: Settings = Field(default_factory=dict, description="overrides of this level")
    value: Finite | None = Field(
        default=None, description="place on the axis of the plot; default: the number that `set` gives, if it is one"
    )
    label: str = Field(default="", description="name of the level; default: its number")
    arguments: dict[Symbol, Any] = Field(
        default_factory=dict, description="arguments of analytic references, over those of the quantities"
    )
    references: dict[str, Reference] = Field(
        default_factory=dict, description="references of this level by quantity, over those of the quantities"
    )


class SweepVariant(SceneModel):
    """One method, or one set of options, of an iteration sweep."""

    set: Settings = Field(default_factory=dict, description="overrides of the scene, over those of the study")
    quantities: dict[Literal["residual", "distance", "contraction"], Quantity] = Field(
        default_factory=dict, description="each in place of the study's one of the same name"
    )


# -------------------------------------------------------------------------------------------------- studies


class _Study(SceneModel):
    about: str = Field(default="", description="one line")
    scene: str = Field(default="scene.yaml", min_length=1, description="scene file, relative to the case folder")
    set: Settings = Field(default_factory=dict, description="overrides of the scene for all runs of the study")
    full_only: bool = Field(default=False, description="true: left out of the quick run")


class _FieldStudy(_Study):
    each: dict[Name, Variation] = Field(
        default_factory=dict, description="the study is repeated for each entry, as study/NAME"
    )
    constants: dict[Symbol, Finite] = Field(default_factory=dict, description="symbols of the expressions")
    fields: Fields = Field(default=Fields(), description="fields that the scene itself cannot describe")
    integrator: Literal["backward_euler", "trapezoidal"] = Field(
        default="backward_euler", description="time integration of scenes with inertia"
    )
    quantities: dict[str, Quantity] = Field(
        default_factory=dict,
        description="by name: l2, h1, NAME of the scene's `measure` (at the end), or FUNCTION(NAME) of its history",
    )


class MeshRefinement(_FieldStudy):
    kind: Literal["mesh_refinement"] = Field(description="the same problem on finer and finer meshes")
    levels: list[RefinementLevel] = Field(min_length=1, description="meshes, the coarsest first")
    coarse: int | None = Field(default=None, ge=1, description="first levels that the quick run computes; default: all")


class TimeStepRefinement(_FieldStudy):
    kind: Literal["time_step_refinement"] = Field(description="the same problem with smaller and smaller steps")
    steps: list[Positive] = Field(min_length=1, description="time steps, the largest first [s]")
    coarse: int | None = Field(default=None, ge=1, description="first steps that the quick run computes; default: all")


class ParameterSweep(_FieldStudy):
    kind: Literal["parameter_sweep"] = Field(description="one quantity over a parameter, every level judged")
    parameter: str = Field(default="", description="what varies, with its unit, for the plot")
    levels: list[SweepLevel] = Field(min_length=1, description="any overrides")
    coarse: int | None = Field(default=None, ge=1, description="first levels that the quick run computes; default: all")


class Value(_FieldStudy):
    kind: Literal["value"] = Field(description="a single run")


class IterationSweep(_Study):
    kind: Literal["iteration_sweep"] = Field(description="residual against iterations, of one or more methods")
    variants: dict[Name, SweepVariant] = Field(min_length=1, description="methods or option sets by label")
    iterations: int = Field(ge=1, description="nonlinear iterations of each in each step")
    steps: int = Field(default=1, ge=1, description="time steps, each from the converged state of the last")
    quantities: dict[Literal["residual", "distance", "contraction"], Quantity] = Field(
        default_factory=dict,
        description="residual: relative residual after the last iteration [-]; distance: RMS distance of the nodes "
        "from the converged solution then [m]; contraction: factor by which an iteration reduces the residual [-]",
    )


Study = Annotated[
    MeshRefinement | TimeStepRefinement | ParameterSweep | Value | IterationSweep, Field(discriminator="kind")
]


class StudyFile(SceneModel):
    """A `study.yaml`."""

    schema_version: Literal[1] = Field(default=1, description="version of this schema")
    title: str = Field(min_length=1, description="one line for tables and reports")
    studies: dict[Name, Study] = Field(min_length=1, description="studies by name")
