"""The scenes of a study: overrides read like those of the command line, their faults reported at the study's line."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from femdeform.errors import Fault, InputError
from femdeform.scene.checks import check_file, check_scene
from femdeform.scene.key_path import KeyPath
from femdeform.scene.load import LoadedScene, Source, load_scene
from femdeform.scene.meshing import survey_meshes
from femdeform.scene.overrides import shortened
from verification.expressions import ExpressionError, evaluate
from verification.plan import FieldSet, Integrator, Problem
from verification.plan_checks import field_faults


@dataclass(frozen=True)
class Setting:
    """One override: its text as after ``--set``, and where it stands in the study file."""

    text: str
    path: KeyPath

    @property
    def source(self) -> str:
        """What stands in the place of ``file:line`` in a fault that it brings up."""
        return f"--set {shortened(self.text)}"


def settings_of(given: Mapping[str, Any], path: KeyPath) -> list[Setting]:
    """Overrides of a block `set`; JSON is YAML, so that they can be read back as after ``--set``."""
    return [Setting(f"{key}={json.dumps(value, ensure_ascii=False)}", (*path, key)) for key, value in given.items()]


class SceneReader:
    """Reads the scenes of a case and collects everything that is wrong, with them and elsewhere.

    Parameters
    ----------
    source : Source
        Lines of the study file.

    Attributes
    ----------
    source : Source
    faults : list of Fault
        What was found so far.
    """

    def __init__(self, source: Source) -> None:
        self.source = source
        self.faults: list[Fault] = []

    def fault(self, path: KeyPath, message: str) -> None:
        """Keep a fault of the study file."""
        self.faults.append(self.source.fault(path, message))

    def relocate(self, faults: Sequence[Fault], origins: Mapping[str, KeyPath], path: KeyPath) -> None:
        """Keep faults of a scene.

        Parameters
        ----------
        faults : sequence of Fault
            What an override brought up becomes a fault of the line of the study file that the override is in.
        origins : mapping of str to KeyPath
            Where each override is, by its `Setting.source`.
        path : KeyPath
            Where faults belong that have neither a line nor an origin.
        """
        for fault in faults:
            if fault.line > 0:
                self.faults.append(fault)
                continue
            place = origins.get(fault.file, path)
            # The key of the override itself is part of the place already.
            key = f"{fault.key}: " if fault.key and place[-1] != fault.key else ""
            self.fault(place, f"{key}{fault.message}")

    def number(self, given: float | str, constants: Mapping[str, float], path: KeyPath) -> float:
        """Value of a number or expression; NaN, and a fault, if it has none."""
        try:
            return evaluate(given, constants)
        except ExpressionError as error:
            self.fault(path, str(error))
            return math.nan

    def problem(
        self,
        scene: Path,
        settings: Sequence[Setting],
        integrator: Integrator,
        fields: FieldSet,
        path: KeyPath,
        deep: bool,
    ) -> Problem | None:
        """Load a scene with overrides and judge it together with the fields of the study.

        Parameters
        ----------
        scene : Path
            Scene file.
        settings : sequence of Setting
            Overrides; later ones win.
        integrator : str
            Time integration.
        fields : FieldSet
            Of the study.
        path : KeyPath
            The study.
        deep : bool
            Judge also what needs the meshes of the scene, which takes longer.

        Returns
        -------
        Problem or None
            None if anything is wrong; it is among the `faults` then.
        """
        loaded, faults, dim = _load(scene, [setting.text for setting in settings], deep)
        self.relocate(faults, {setting.source: setting.path for setting in settings}, path)
        if loaded is None or faults:
            return None
        found = field_faults(loaded, fields, integrator, dim, (*path, "integrator"))
        self.faults += found
        return None if found else Problem(loaded, fields, integrator)


def _load(scene: Path, texts: Sequence[str], deep: bool) -> tuple[LoadedScene | None, list[Fault], int | None]:
    """The scene if it can be read, everything wrong with it, and the dimension of its meshes if they were made."""
    try:
        loaded = load_scene(scene, texts)
    except InputError as error:
        return None, check_file(scene, texts) or list(error.faults), None
    if not deep:
        return loaded, [], None
    survey = survey_meshes(loaded)
    faults = [*survey.faults, *check_scene(loaded, survey.meshes, survey.coarse)]
    return loaded, faults, next((mesh.dim for mesh in survey.meshes.values()), None)
