"""What of a study can only be judged with its scenes at hand: fields, quantities and bands that do not fit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from femdeform.errors import Fault
from femdeform.scene import schema
from femdeform.scene.key_path import KeyPath
from femdeform.scene.load import LoadedScene, Source
from femdeform.scene.wording import did_you_mean
from verification.plan import FieldSet, Level, MeasuredQuantity, Problem
from verification.study_schema import Band, Quantity


def field_faults(
    loaded: LoadedScene, fields: FieldSet, integrator: str, dim: int | None, integrator_path: KeyPath
) -> list[Fault]:
    """Faults of fields and integrator against one scene; `dim` is that of its meshes, None if not known."""
    scene = loaded.deformable
    quasistatic = scene.time.scheme == "quasistatic"
    faults = []
    if fields.displacement is not None:
        if not quasistatic:
            faults.append(fields.fault("displacement", "needs a scene with `scheme: quasistatic`"))
        if len(scene.bodies) > 1:
            faults.append(fields.fault("displacement", f"needs a scene with one body, not {len(scene.bodies)}"))
    if fields.manufactured and any(body.kind != "solid" or body.regions for body in scene.bodies.values()):
        faults.append(fields.fault("body_force", "needs a solid of one material, without regions"))
    if fields.initial_velocity is not None and quasistatic:
        faults.append(fields.fault("initial_velocity", "a quasistatic run has no velocities"))
    for name in ("displacement", "initial_velocity", "move_mesh"):
        field = getattr(fields, name)
        if field is not None and dim is not None and field.dim != dim:
            faults.append(fields.fault(name, f"has {field.dim} components, the meshes have {dim}"))
    if integrator == "trapezoidal":
        faults += [fields.source.fault(integrator_path, text) for text in _trapezoidal_problems(scene)]
    return faults


def _trapezoidal_problems(scene: schema.DeformableScene) -> Iterator[str]:
    if scene.time.scheme == "quasistatic":
        yield "the trapezoidal rule needs a scene with inertia, `scheme: backward_euler`"
    moving = [c for c in scene.conditions if isinstance(c, schema.SUPPORTS) and not isinstance(c, schema.Fixed)]
    if moving:
        yield f"the trapezoidal rule knows no moving supports, and the scene has a `{moving[0].kind}`"
    if any(obstacle.friction > 0.0 for obstacle in scene.obstacles):
        yield "the trapezoidal rule knows no friction"


def quantity_faults(problem: Problem, quantities: Sequence[MeasuredQuantity], source: Source) -> list[Fault]:
    """Faults of quantities against one scene."""
    scene = problem.loaded.deformable
    faults = []
    for quantity in quantities:
        if quantity.is_norm:
            if quantity.spec.window is not None:
                faults.append(source.fault((*quantity.path, "window"), "a norm is taken at the end of the run"))
            if len(scene.bodies) > 1 or any(body.kind != "solid" for body in scene.bodies.values()):
                faults.append(source.fault(quantity.path, "needs a scene with one body, a solid"))
            continue
        if quantity.measure not in scene.measure:
            known = did_you_mean(quantity.measure, scene.measure) if scene.measure else "it measures nothing"
            faults.append(source.fault(quantity.path, f"the scene's `measure` has no `{quantity.measure}`; {known}"))
        if quantity.spec.window is not None and quantity.spec.window[0] > scene.time.end:
            message = f"begins after the end of the run, {scene.time.end:g} s"
            faults.append(source.fault((*quantity.path, "window"), message))
    return faults


def band_faults(
    kind: str,
    sizes: Sequence[float],
    n_quick: int,
    quantities: Sequence[MeasuredQuantity],
    fields: FieldSet,
    levels: Sequence[Level],
    source: Source,
) -> list[Fault]:
    """Faults of bands: what cannot be judged in a study of this kind, or on so few levels."""
    faults = []
    for quantity in quantities:
        spec, path = quantity.spec, quantity.path
        exact = quantity.is_norm and fields.displacement is not None
        targets = [level.targets.get(quantity.name) for level in levels]
        if quantity.is_norm and not exact and any(target is None for target in targets):
            faults.append(source.fault(path, "needs fields.displacement, or a run or level as its reference"))
        n_without = _levels_without_error(targets)
        if n_without and kind == "value":
            faults.append(source.fault((*path, "reference", "level"), "a study of one run has no other level"))
        bands: list[tuple[KeyPath, Band, int]] = [(path, spec, len(sizes))]
        if n_quick:
            of_quick = path if spec.coarse is None else (*path, "coarse")
            bands.append((of_quick, quantity.band(full=False), n_quick))
        for where, band, n_levels in bands:
            if not exact and (band.rate or band.decreasing or _tolerance(band)) and any(t is None for t in targets):
                faults.append(source.fault(where, "a rate, a tolerance or `decreasing` needs a `reference`"))
                continue
            if band.rate is not None and kind not in ("mesh_refinement", "time_step_refinement"):
                faults.append(source.fault((*where, "rate"), "only mesh and time-step refinements have a rate"))
            elif (band.rate is not None or band.decreasing) and n_levels - n_without < 2:
                key = "rate" if band.rate is not None else "decreasing"
                message = f"needs errors on two levels; of {n_levels} computed, {max(n_levels - n_without, 0)} have one"
                faults.append(source.fault((*where, key), message))
        if spec.coarse is not None and (spec.coarse.is_empty or spec.report_only):
            faults.append(source.fault((*path, "coarse"), "needs a band, in place of those of the full run"))
    return list(dict.fromkeys(faults))


def _tolerance(band: Band) -> bool:
    return band.rtol is not None or band.atol is not None


def _levels_without_error(targets: Sequence[Any]) -> int:
    """Levels that are their own reference: one, where any is compared with another level."""
    return int(any(target is not None and target.level is not None for target in targets))


def iteration_band_faults(spec: Quantity, path: KeyPath, source: Source) -> list[Fault]:
    """Faults of a quantity of an iteration sweep: it knows bounds only."""
    unknown = [key for key in ("rate", "rtol", "atol", "reference", "scale", "window", "coarse") if getattr(spec, key)]
    unknown += ["decreasing"] if spec.decreasing else []
    return [
        source.fault((*path, key), "an iteration sweep is judged by between, at_most and at_least") for key in unknown
    ]
