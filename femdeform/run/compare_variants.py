"""What is compared: methods and option sets, from the command line to checked scenes on one mesh."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from femdeform import registry
from femdeform.errors import Fault, InputError
from femdeform.scene.checks import check_file, check_scene
from femdeform.scene.load import LoadedScene, load_scene
from femdeform.scene.meshing import load_meshes
from femdeform.scene.overrides import parse_override, shortened
from femdeform.scene.wording import did_you_mean
from femdeform.types import Mesh

REFERENCE = "reference"
# What a variant may change: how a step is solved. The rest is the problem, which all of them share.
_ITS_OWN = ("solver", "linear_solver")
_EXAMPLE = 'for example --variant "exact: solver.hessian=exact"'


@dataclass(frozen=True)
class Variant:
    """One way to solve the steps of a scene.

    Attributes
    ----------
    label : str
        Its name in tables and plots.
    overrides : tuple of str
        ``key=value`` each, below `solver` or `linear_solver`.
    method : str
        A word of `registry.SOLVERS`. Where the scene uses that method its options stay; where it does not, the
        method's defaults are taken. Empty: the scene's own method. The overrides come after it.
    """

    label: str
    overrides: tuple[str, ...] = ()
    method: str = ""


@dataclass(frozen=True)
class Prepared:
    """A scene and its variants, read and checked.

    Attributes
    ----------
    base : LoadedScene
        The scene itself.
    meshes : dict of str to Mesh
        The mesh of every variant.
    variants : tuple of Variant
    scenes : dict of str to LoadedScene
        The scene of every variant, by its label.
    """

    base: LoadedScene
    meshes: dict[str, Mesh]
    variants: tuple[Variant, ...]
    scenes: dict[str, LoadedScene]


def parse_variants(methods: str | None, option_sets: Sequence[str]) -> list[Variant]:
    """Read ``--methods a,b`` and every ``--variant "LABEL: key=value key=value"``.

    Raises
    ------
    InputError
        With every fault.
    """
    variants: list[Variant] = []
    faults: list[Fault] = []
    for word in [] if methods is None else [part.strip() for part in methods.split(",")]:
        if word in registry.SOLVERS:
            variants.append(Variant(word, (), word))
        elif not word:
            faults.append(Fault("--methods", 0, "", "must be names of methods with commas between them"))
        else:
            faults.append(
                Fault("--methods", 0, "", f"there is no method `{word}`; {did_you_mean(word, registry.SOLVERS)}")
            )
    for text in option_sets:
        source = f"--variant {shortened(text)}"
        label, colon, options = text.partition(":")
        label = label.strip()
        if not colon or not label or "=" in label:
            faults.append(Fault(source, 0, "", f"must be LABEL: key=value key=value, {_EXAMPLE}"))
            continue
        try:
            overrides = tuple(shlex.split(options))
        except ValueError as error:
            faults.append(Fault(source, 0, "", f"the options cannot be split ({error}); quotes come in pairs"))
            continue
        if not overrides:
            faults.append(Fault(source, 0, "", f"has no options, {_EXAMPLE}"))
            continue
        variants.append(Variant(label, overrides))
    if faults:
        raise InputError(faults)
    return variants


def prepare(path: Path, variants: Sequence[Variant], overrides: Sequence[str] = ()) -> Prepared:
    """Read a scene and its variants, make the mesh, check everything.

    Parameters
    ----------
    path : Path
        Scene file.
    variants : sequence of Variant
        What to compare.
    overrides : sequence of str
        ``key=value`` for the scene, and so for all variants.

    Raises
    ------
    InputError
        With every fault of the scene; or of the variants, each with the variant it is in.
    """
    if not variants:
        raise InputError("there is nothing to compare: give --methods or --variant")
    try:
        base = load_scene(path, overrides)
    except InputError as error:
        raise InputError(check_file(path, overrides) or error.faults) from None
    faults = _label_faults(variants)
    scenes: dict[str, LoadedScene] = {}
    for variant in variants:
        found = _foreign_keys(variant)
        if not found:
            try:
                scenes[variant.label] = load_scene(path, [*overrides, *_own_overrides(variant, base)])
            except InputError as error:
                found = [_in_variant(variant, fault) for fault in error.faults]
        faults += found
    if faults:
        raise InputError(faults)
    meshes = load_meshes(base)
    faults = check_scene(base, meshes)
    if faults:
        raise InputError(faults)
    for variant in variants:
        faults += [_in_variant(variant, fault) for fault in check_scene(scenes[variant.label], meshes)]
    if faults:
        raise InputError(faults)
    return Prepared(base, meshes, tuple(variants), scenes)


def file_names(labels: Sequence[str]) -> dict[str, str]:
    """A file name without ending for every label, each different from all others and from the reference's."""
    names: dict[str, str] = {}
    taken = {REFERENCE}
    for label in labels:
        stem = re.sub(r"[^A-Za-z0-9._+-]+", "-", label).strip("-.")[:60] or "variant"
        name, number = stem, 1
        while name.lower() in taken:
            number += 1
            name = f"{stem}-{number}"
        taken.add(name.lower())
        names[label] = name
    return names


def variant_fault(label: str, fault: Fault) -> Fault:
    """A fault that a variant brought up, with the variant's name for a place."""
    # What cannot be read has no key yet: then the text itself says which override is meant.
    key = fault.key or fault.file.removeprefix("--set ")
    return replace(fault, file=f"--variant {label}", line=0, key=key)


def _label_faults(variants: Sequence[Variant]) -> list[Fault]:
    faults = []
    labels = [variant.label for variant in variants]
    for label in dict.fromkeys(labels):
        place = f"--variant {shortened(label)}"
        if labels.count(label) > 1:
            faults.append(Fault(place, 0, "", "there are two variants of this name; give them different labels"))
        if label == REFERENCE:
            faults.append(Fault(place, 0, "", "this name is kept for the converged reference; choose another label"))
        if len(label) > 40 or not label.isprintable():
            faults.append(Fault(place, 0, "", "a label has at most 40 characters, on one line"))
    return faults


def _foreign_keys(variant: Variant) -> list[Fault]:
    """Overrides that cannot be read, or that would change the problem."""
    faults = []
    for text in variant.overrides:
        override, problems = parse_override(text)
        faults += [_in_variant(variant, fault) for fault in problems]
        if override is not None and override.path[0] not in _ITS_OWN:
            message = "a variant changes solver or linear_solver only; what holds for all of them goes into --set"
            faults.append(Fault(f"--variant {variant.label}", 0, str(override.path[0]), message))
    return faults


def _own_overrides(variant: Variant, base: LoadedScene) -> list[str]:
    method = variant.method
    for text in variant.overrides:
        override, _ = parse_override(text)
        if override is not None and override.path == ("solver", "method"):
            method = str(override.value)
    if not method or method == base.deformable.solver.method:
        return list(variant.overrides)
    # The scene's options belong to another method.
    return [f"solver={{method: {method}}}", *variant.overrides]


def _in_variant(variant: Variant, fault: Fault) -> Fault:
    """A fault of a variant's own override names the variant; one of the file keeps its line."""
    return variant_fault(variant.label, fault) if fault.line == 0 else fault


def solver_options(loaded: LoadedScene) -> dict[str, object]:
    """Resolved blocks `solver` and `linear_solver` of a scene."""
    scene = loaded.deformable
    return {
        "solver": scene.solver.model_dump(mode="json"),
        "linear_solver": scene.linear_solver.model_dump(mode="json"),
    }
