"""Cases: folders with a `study.yaml`. Finding them, reading them, and judging everything in them before any is run."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from femdeform.errors import Fault, InputError
from femdeform.scene.document import read_document
from femdeform.scene.key_path import format_key
from femdeform.scene.load import Source, schema_faults, sort_faults
from femdeform.scene.wording import did_you_mean
from verification.plan import CasePlan
from verification.study_schema import StudyFile

CASES = Path(__file__).parent / "cases"
STUDY_FILE = "study.yaml"
README = "README.md"


def shipped_cases() -> dict[str, Path]:
    """Folders of the cases of this package by name, sorted."""
    if not CASES.is_dir():
        return {}
    return {folder.name: folder for folder in sorted(CASES.iterdir()) if (folder / STUDY_FILE).is_file()}


def choose_cases(names: Sequence[str]) -> dict[str, Path]:
    """Folders of the cases that a user names; all shipped ones if none is named.

    Parameters
    ----------
    names : sequence of str
        Each the name of a shipped case, or the path of a folder.

    Returns
    -------
    dict of str to Path
        By the name of the folder, in the order given.

    Raises
    ------
    InputError
        With one fault for each that cannot be found, or whose folder's name another one has.
    """
    shipped = shipped_cases()
    if not names:
        return shipped
    chosen: dict[str, Path] = {}
    faults = []
    for text in names:
        folder = shipped.get(text)
        if folder is None:
            folder = Path(text)
            if folder.name == STUDY_FILE:
                folder = folder.parent
            if not folder.is_dir():
                hint = did_you_mean(text, shipped)
                faults.append(Fault("", 0, "verify", f"there is no case and no folder `{text}`; {hint}"))
                continue
            if not (folder / STUDY_FILE).is_file():
                faults.append(Fault(str(folder), 0, "", f"the folder has no {STUDY_FILE}"))
                continue
        name = folder.resolve().name
        if name in chosen and chosen[name].resolve() != folder.resolve():
            faults.append(Fault("", 0, "verify", f"two cases are called `{name}`; verify them one after the other"))
        chosen.setdefault(name, folder)
    if faults:
        raise InputError(faults)
    return chosen


def read_title(folder: Path) -> str:
    """Title of a case, or a remark that it cannot be read."""
    document = read_document(folder / STUDY_FILE, "study")
    title = document.data.get("title") if isinstance(document.data, dict) else None
    return title if isinstance(title, str) else "(cannot be read)"


def load_case(folder: Path) -> CasePlan:
    """Read a case and judge all of it: the study file, its scenes with the overrides of every level, expressions.

    Parameters
    ----------
    folder : Path
        Holds `study.yaml`, scenes and, for people, `README.md`.

    Returns
    -------
    CasePlan

    Raises
    ------
    InputError
        With every fault, each with the line it comes from: of the study file, or of a scene.
    """
    from verification.planner import Planner

    shown = _short_path(folder)
    path = shown / STUDY_FILE
    document = read_document(path, "study")
    source = Source(str(path), document.lines)
    faults = [Fault(str(path), found.line, format_key(found.path), found.message) for found in document.faults]
    if document.readable:
        faults += schema_faults(StudyFile, document, document.data, source)
    if faults:
        raise InputError(sort_faults(faults))
    file = StudyFile.model_validate(document.data)
    planner = Planner(shown, source)
    studies = [plan for name, study in file.studies.items() for plan in planner.plan(name, study)]
    if planner.faults:
        raise InputError(sort_faults(planner.faults))
    return CasePlan(folder.resolve().name, folder, file.title, _read_text(folder / README), studies)


def _short_path(folder: Path) -> Path:
    """The folder as messages name it: relative where it lies below the current folder."""
    try:
        relative = os.path.relpath(folder)
    except ValueError:  # another drive
        return folder
    return folder if relative.startswith("..") else Path(relative)


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
