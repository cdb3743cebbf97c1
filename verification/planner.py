"""From a study of a `study.yaml` to its levels, and every fault on the way with its line."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from femdeform.errors import Fault
from femdeform.scene.key_path import KeyPath
from femdeform.scene.load import Source
from femdeform.scene.wording import did_you_mean
from verification import plan_checks as checks
from verification.expressions import COORDINATES, RESERVED, ExpressionError, VectorField, parse_expression
from verification.history import split_quantity
from verification.plan import (
    NORMS,
    FieldSet,
    IterationPlan,
    Level,
    MeasuredQuantity,
    Problem,
    StudyPlan,
    Target,
)
from verification.plan_iterations import plan_iterations
from verification.plan_scenes import SceneReader, Setting, settings_of
from verification.references import ReferenceValueError, static_value
from verification.study_schema import (
    Fields,
    IterationSweep,
    LevelReference,
    MeshRefinement,
    ParameterSweep,
    Reference,
    RunReference,
    Study,
    SweepLevel,
    TimeStepRefinement,
    Value,
    Variation,
)

FieldStudy = MeshRefinement | TimeStepRefinement | ParameterSweep | Value
_AXES = {"mesh_refinement": "element size", "time_step_refinement": "time step [s]", "value": ""}


@dataclass(frozen=True)
class _RawLevel:
    """A level as the study file has it."""

    label: str
    size: float
    settings: list[Setting]
    path: KeyPath
    arguments: Mapping[str, Any]
    references: Mapping[str, Reference]


class Planner:
    """Plans the studies of one case.

    Parameters
    ----------
    folder : Path
        The case, as messages name it.
    source : Source
        Lines of its study file.
    """

    def __init__(self, folder: Path, source: Source) -> None:
        self._folder = folder
        self._reader = SceneReader(source)

    @property
    def faults(self) -> list[Fault]:
        """What was found so far; plans are of use only while it is empty."""
        return self._reader.faults

    def plan(self, name: str, study: Study) -> list[StudyPlan | IterationPlan]:
        """Plan a study, once for each of its variations."""
        path: KeyPath = ("studies", name)
        scene = self._folder / study.scene
        if not scene.is_file():
            beside = [item.name for item in scene.parent.glob("*.yaml")] if scene.parent.is_dir() else []
            hint = did_you_mean(scene.name, beside)
            self._reader.fault((*path, "scene"), f"there is no file {study.scene} in the case; {hint}")
            return []
        if isinstance(study, IterationSweep):
            sweep = plan_iterations(self._reader, name, study, scene)
            return [] if sweep is None else [sweep]
        plans: list[StudyPlan | IterationPlan] = []
        for word, variation in (study.each or {"": Variation()}).items():
            own = (*path, "each", word) if word else path
            plan = self._plan_levels(f"{name}/{word}" if word else name, study, variation, scene, path, own)
            plans += [plan] if plan is not None else []
        return plans

    # ------------------------------------------------------------------------------------------- field studies

    def _plan_levels(
        self, name: str, study: FieldStudy, variation: Variation, scene: Path, path: KeyPath, own: KeyPath
    ) -> StudyPlan | None:
        before = len(self._reader.faults)
        constants = {**study.constants, **variation.constants}
        for symbol in sorted(RESERVED & constants.keys()):
            where = own if symbol in variation.constants else path
            self._reader.fault((*where, "constants", symbol), "this name has a meaning of its own; choose another one")
        fields = self._fields(study.fields, constants, (*path, "fields"))
        quantities = self._quantities(study, variation, path, own)
        raw = self._raw_levels(study, constants, path)
        if len(self._reader.faults) > before:
            return None
        n_quick = self._n_quick(study, variation, len(raw))
        common = settings_of(study.set, (*path, "set")) + settings_of(variation.set, (*own, "set"))
        levels = []
        for number, level in enumerate(raw):
            problem = self._reader.problem(
                scene, [*common, *level.settings], study.integrator, fields, path, deep=number < max(n_quick, 1)
            )
            if problem is None:
                continue
            self._reader.faults += checks.quantity_faults(problem, quantities, self._reader.source)
            targets = self._targets(quantities, level, problem, constants, scene, [*common, *level.settings], path)
            levels.append(Level(level.label, level.size, problem, targets))
        sizes = [level.size for level in levels]
        self._reader.faults += checks.band_faults(
            study.kind, sizes, n_quick, quantities, fields, levels, self._reader.source
        )
        if len(self._reader.faults) > before:
            return None
        axis = study.parameter or self._parameter(raw) if isinstance(study, ParameterSweep) else _AXES[study.kind]
        return StudyPlan(name, study.kind, study.about, axis, levels, n_quick, quantities)

    def _n_quick(self, study: FieldStudy, variation: Variation, n_levels: int) -> int:
        if study.full_only if variation.full_only is None else variation.full_only:
            return 0
        coarse = variation.coarse if variation.coarse is not None else getattr(study, "coarse", None)
        return n_levels if coarse is None else min(coarse, n_levels)

    def _raw_levels(self, study: FieldStudy, constants: Mapping[str, float], path: KeyPath) -> list[_RawLevel]:
        if isinstance(study, Value):
            return [_RawLevel("", math.nan, [], path, {}, {})]
        if isinstance(study, TimeStepRefinement):
            steps = []
            for k, dt in enumerate(study.steps):
                here: KeyPath = (*path, "steps", k)
                settings = [Setting(f"time.dt={json.dumps(dt)}", here)]
                steps.append(_RawLevel(f"dt {dt:g}", dt, settings, here, {}, {}))
            self._check_decreasing(study.steps, (*path, "steps"), "time steps")
            return steps
        if isinstance(study, ParameterSweep):
            return [self._raw_entry(level, k, (*path, "levels", k)) for k, level in enumerate(study.levels)]
        meshes = []
        for k, mesh in enumerate(study.levels):
            here = (*path, "levels", k)
            size = self._reader.number(mesh.size, constants, (*here, "size"))
            settings = settings_of(mesh.set, (*here, "set"))
            meshes.append(_RawLevel(mesh.label or f"{k + 1}", size, settings, here, {}, {}))
        self._check_decreasing([mesh.size for mesh in meshes], (*path, "levels"), "sizes")
        return meshes

    def _raw_entry(self, level: SweepLevel, k: int, here: KeyPath) -> _RawLevel:
        value = _only_number(level.set) if level.value is None else level.value
        label = level.label or (f"{k + 1}" if value is None else f"{value:g}")
        settings = settings_of(level.set, (*here, "set"))
        size = math.nan if value is None else value
        return _RawLevel(label, size, settings, here, level.arguments, level.references)

    def _check_decreasing(self, sizes: Sequence[float], path: KeyPath, what: str) -> None:
        for k, (coarse, fine) in enumerate(pairwise(sizes), start=1):
            if not 0.0 < fine < coarse and not math.isnan(fine + coarse):
                self._reader.fault((*path, k), f"{what} must decrease from level to level and be positive")

    @staticmethod
    def _parameter(raw: Sequence[_RawLevel]) -> str:
        """The key that all levels set, as the name of the axis."""
        keys = {level.settings[0].text.partition("=")[0] for level in raw if len(level.settings) == 1}
        return keys.pop() if len(keys) == 1 and all(len(level.settings) == 1 for level in raw) else "level"

    def _fields(self, given: Fields, constants: Mapping[str, float], path: KeyPath) -> FieldSet:
        def vector(name: str) -> VectorField | None:
            components = getattr(given, name)
            if components is None:
                return None
            sound = True
            for k, component in enumerate(components):
                try:
                    parse_expression(component, constants, COORDINATES[: len(components)])
                except ExpressionError as error:
                    sound = False
                    self._reader.fault((*path, name, k), str(error))
            return VectorField(components, constants) if sound else None

        return FieldSet(
            self._reader.source,
            path,
            vector("displacement"),
            vector("initial_velocity"),
            vector("move_mesh"),
            given.body_force == "manufactured",
        )

    def _quantities(
        self, study: FieldStudy, variation: Variation, path: KeyPath, own: KeyPath
    ) -> list[MeasuredQuantity]:
        merged = {name: (spec, (*path, "quantities", name)) for name, spec in study.quantities.items()}
        merged |= {name: (spec, (*own, "quantities", name)) for name, spec in variation.quantities.items()}
        if not any(not spec.report_only for spec, _ in merged.values()):
            self._reader.fault((*own, "quantities"), "nothing is judged: name at least one quantity with a band")
        quantities = []
        for name, (spec, where) in merged.items():
            try:
                function, measure = ("", "") if name in NORMS else split_quantity(name)
            except ValueError as error:
                self._reader.fault(where, str(error))
                continue
            quantities.append(MeasuredQuantity(name, function, measure, spec, where))
        return quantities

    def _targets(
        self,
        quantities: Sequence[MeasuredQuantity],
        level: _RawLevel,
        problem: Problem,
        constants: Mapping[str, float],
        scene: Path,
        settings: list[Setting],
        path: KeyPath,
    ) -> dict[str, Target]:
        for name in level.references:
            if all(quantity.name != name for quantity in quantities):
                hint = did_you_mean(name, [quantity.name for quantity in quantities])
                self._reader.fault((*level.path, "references", name), f"the study has no such quantity; {hint}")
        targets: dict[str, Target] = {}
        for quantity in quantities:
            reference, where = quantity.spec.reference, (*quantity.path, "reference")
            if quantity.name in level.references:
                reference, where = level.references[quantity.name], (*level.path, "references", quantity.name)
            if isinstance(reference, LevelReference):
                targets[quantity.name] = Target(level=reference.level)
            elif isinstance(reference, RunReference):
                finer = [*settings, *settings_of(reference.run.set, (*where, "run", "set"))]
                integrator = reference.run.integrator or problem.integrator
                # Without a run there is a fault; that there is no reference need not be said as well.
                targets[quantity.name] = Target(
                    run=self._reader.problem(scene, finer, integrator, problem.fields, path, deep=False)
                )
            elif reference is not None and quantity.is_norm:
                targets[quantity.name] = Target()
                self._reader.fault(where, "a norm is compared with fields.displacement, a run or a level")
            elif reference is not None:
                targets[quantity.name] = Target()
                try:
                    value = static_value(reference, level.arguments, problem.loaded.deformable, constants)
                except ReferenceValueError as error:
                    at_level = error.of_level and len(error.key) > 1 and error.key[1] in level.arguments
                    self._reader.fault((*level.path, *error.key) if at_level else (*where, *error.key), str(error))
                    continue
                targets[quantity.name] = Target(value=value)
        return targets


def _only_number(settings: Mapping[str, Any]) -> float | None:
    """The number that a level sets, if it sets one number and nothing else."""
    values = list(settings.values())
    if len(values) == 1 and isinstance(values[0], int | float) and not isinstance(values[0], bool):
        return float(values[0])
    return None
