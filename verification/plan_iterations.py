"""From an iteration sweep of a `study.yaml` to what is to be compared."""

from __future__ import annotations

from pathlib import Path

from femdeform.errors import InputError
from femdeform.run.compare import Plan
from femdeform.run.compare_variants import Variant, prepare
from femdeform.scene.key_path import KeyPath
from verification.plan import IterationPlan
from verification.plan_checks import iteration_band_faults
from verification.plan_scenes import SceneReader, settings_of
from verification.study_schema import IterationSweep, Quantity


def plan_iterations(reader: SceneReader, name: str, study: IterationSweep, scene: Path) -> IterationPlan | None:
    """Read the scene and the variants of a sweep.

    Parameters
    ----------
    reader : SceneReader
        Gets every fault.
    name : str
        Of the study.
    study : IterationSweep
        As the file has it.
    scene : Path
        Scene file.

    Returns
    -------
    IterationPlan or None
        None if anything is wrong.
    """
    path: KeyPath = ("studies", name)
    before = len(reader.faults)
    common = settings_of(study.set, (*path, "set"))
    variants = []
    quantities: dict[str, dict[str, Quantity]] = {}
    origins = {setting.source: setting.path for setting in common}
    for label, variant in study.variants.items():
        here = (*path, "variants", label)
        own = settings_of(variant.set, (*here, "set"))
        variants.append(Variant(label, tuple(setting.text for setting in own)))
        origins[f"--variant {label}"] = here
        given = [(path, study.quantities), (here, variant.quantities)]
        merged = {str(word): (spec, where) for where, specs in given for word, spec in specs.items()}
        quantities[label] = {word: spec for word, (spec, _) in merged.items()}
        if all(spec.report_only for spec, _ in merged.values()):
            reader.fault(here, "nothing is judged: give residual, distance or contraction a band in `quantities`")
        for word, (spec, where) in merged.items():
            reader.faults += iteration_band_faults(spec, (*where, "quantities", word), reader.source)
    budget = Plan(iterations=study.iterations, steps=study.steps)
    try:
        prepared = prepare(scene, variants, [setting.text for setting in common])
        budget.check(prepared.base.deformable)
    except InputError as error:
        reader.relocate(error.faults, origins, path)
    if len(reader.faults) > before:
        return None
    return IterationPlan(name, study.about, prepared, budget, quantities, study.full_only)
