"""The result folder as a whole: whether there is room for a run, and how a run ends that cannot end by itself."""

from __future__ import annotations

import json
import secrets
import shutil
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from femdeform.errors import Fault, FemdeformError, InputError, OutputError
from femdeform.run import atomic
from femdeform.run.plain import to_json
from femdeform.run.table import last_step

# Named like a leftover of `atomic`, so that it goes with those.
_RESERVE = ".reserve.part"

# The last frame, by the kind of the simulation.
_FINAL = ("final.vtu", "final.vtp", "final.vti")
# Everything a run, or what is drawn from it, leaves in its folder: the files that an overwriting run removes.
_OWN_FILES = (
    "resolved.yaml",
    "result.json",
    "history.csv",
    "linear_solver.log",
    "iterations.csv",
    "frames.pvd",
    *_FINAL,
    "checkpoint.h5",
    "skins.npz",
    "report.html",
    "view.png",
)
_OWN_FOLDERS = {"frames": "frame_*.vt?", "plots": "*.png"}
# Any of these says that the folder belongs to a run.
_MARKS = ("result.json", "history.csv", "iterations.csv", "frames.pvd", *_FINAL, "checkpoint.h5")


def check_vacant(folder: Path) -> None:
    """Make sure that there is no result in a folder.

    Raises
    ------
    InputError
        If there is one, or what is left of one.
    """
    if not any((folder / name).exists() for name in _MARKS):
        return
    try:
        status = json.loads((folder / "result.json").read_text(encoding="utf-8"))["status"]
    except (OSError, ValueError, KeyError, TypeError):
        status = ""
    kind = "an unfinished result" if status in ("running", "interrupted") else "a result"
    message = (
        f"holds {kind} already: give --resume to go on with it, --overwrite to replace it, or another folder with --out"
    )
    raise InputError([Fault(str(folder), 0, "", message)])


def clear(folder: Path, results: bool) -> None:
    """Remove what a killed run left behind and, if `results`, the result itself; files of others stay.

    Raises
    ------
    OutputError
        If something cannot be removed.
    """
    atomic.remove_leftovers(folder)
    if not results:
        return
    with atomic.writing(folder):
        for name in _OWN_FILES:
            (folder / name).unlink(missing_ok=True)
        for name, pattern in _OWN_FOLDERS.items():
            for path in (folder / name).glob(pattern):
                path.unlink()
            atomic.remove_leftovers(folder / name)
            if (folder / name).is_dir() and not any((folder / name).iterdir()):
                shutil.rmtree(folder / name)


def reserve(folder: Path, facts: Mapping[str, Any]) -> None:
    """Set room aside for the last ``result.json`` of a run that finds the disk full.

    Parameters
    ----------
    folder : Path
        Result folder.
    facts : mapping
        What is known at the start.

    Raises
    ------
    OutputError
        If there is none.
    """
    with atomic.writing(folder):
        # Noise: some file systems give no room to zeros. What is added at the end is about as much again.
        (folder / _RESERVE).write_bytes(secrets.token_bytes(2 * len(to_json(facts)) + 4096))


def release(folder: Path) -> None:
    """Give the room back."""
    with atomic.writing(folder):
        (folder / _RESERVE).unlink(missing_ok=True)


def write_facts(folder: Path, facts: Mapping[str, Any]) -> None:
    """Replace ``result.json``, in the room set aside by `reserve` if there is no other.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    text = to_json(facts)
    try:
        atomic.write_text(folder / "result.json", text)
    except OutputError:
        if not (folder / _RESERVE).exists():
            raise
        release(folder)
        atomic.write_text(folder / "result.json", text)


def mark_ended(folder: Path, status: str, reason: str) -> None:
    """Let ``result.json`` say why a run ended that cannot end in the usual way; any rank or thread may call this.

    Nothing happens where no run is going on, or nothing can be written: who calls this has an error to report already.

    Parameters
    ----------
    folder : Path
        Result folder.
    status, reason : str
        As for `Recorder.finish`.
    """
    with suppress(OSError, ValueError, FemdeformError):
        facts = json.loads((folder / "result.json").read_text(encoding="utf-8"))
        if isinstance(facts, dict) and facts.get("status") == "running":
            facts.update(status=status, reason=reason)
            with suppress(FemdeformError):
                facts["steps"] = last_step(folder / "history.csv")
            write_facts(folder, facts)
            release(folder)
