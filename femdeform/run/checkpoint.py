"""Checkpoints: everything needed to go on from a step as if the run had never stopped."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from femdeform.errors import Fault, InputError
from femdeform.run import atomic
from femdeform.types import FloatArray

FILE_NAME = "checkpoint.h5"
# What to do where there is nothing to go on from; a run does not write over another one's result.
START_ANEW = "run without --resume, into another folder (--out) or after removing this one"
_VERSION = 1


@dataclass(frozen=True)
class Checkpoint:
    """State of a run after an accepted step.

    Attributes
    ----------
    x, v : (n_nodes, dim) float64
        Positions [m] and velocities [m/s] of the whole problem, in the order of the input.
    time : float
        Time [s].
    step : int
        Accepted steps.
    current_dt : float
        Step size in use [s], smaller than the scene's after a failure.
    frames : int
        Frames written.
    seconds : float
        Wall time spent so far [s].
    scene_hash : str
        Hash of the scene that was run.
    """

    x: FloatArray
    v: FloatArray
    time: float
    step: int
    current_dt: float
    frames: int
    seconds: float
    scene_hash: str


def write_checkpoint(folder: Path, checkpoint: Checkpoint) -> None:
    """Replace the checkpoint of a result folder atomically.

    Raises
    ------
    OutputError
        If it cannot be written; the old one is then still there.
    """
    import h5py

    with atomic.replacing(folder / FILE_NAME) as path, h5py.File(path, "w") as file:
        file.attrs["version"] = _VERSION
        for name, value in vars(checkpoint).items():
            if isinstance(value, np.ndarray):
                # A checksum, so that a damaged file is noticed instead of continued.
                file.create_dataset(name, data=value, fletcher32=True, chunks=True if value.size else None)
            else:
                file.attrs[name] = value


def is_unsaved(folder: Path) -> bool:
    """Whether a run was begun in a result folder and ended without a word before its first checkpoint."""
    if (folder / FILE_NAME).exists():
        return False
    try:
        facts = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(facts, dict) and facts.get("status") == "running"


def read_checkpoint(folder: Path, scene_hash: str | None = None) -> Checkpoint:
    """Read the checkpoint of a result folder.

    Parameters
    ----------
    folder : Path
        The result folder.
    scene_hash : str, optional
        Hash of the scene it has to belong to.

    Raises
    ------
    InputError
        If there is none, it is damaged, or it belongs to another scene.
    """
    import h5py

    path = folder / FILE_NAME
    if not path.is_file():
        raise InputError([Fault(str(path), 0, "", "no checkpoint to resume from; run without --resume")])
    try:
        with h5py.File(path, "r") as file:
            attributes: Mapping[str, Any] = dict(file.attrs)
            if int(attributes["version"]) != _VERSION:
                raise InputError([Fault(str(path), 0, "", f"checkpoint version {attributes['version']} is not known")])
            checkpoint = Checkpoint(
                x=file["x"][()],
                v=file["v"][()],
                time=float(attributes["time"]),
                step=int(attributes["step"]),
                current_dt=float(attributes["current_dt"]),
                frames=int(attributes["frames"]),
                seconds=float(attributes["seconds"]),
                scene_hash=str(attributes["scene_hash"]),
            )
    except (OSError, KeyError, ValueError) as error:
        message = f"the checkpoint is damaged ({error}); {START_ANEW}"
        raise InputError([Fault(str(path), 0, "", message)]) from None
    if scene_hash is not None and checkpoint.scene_hash != scene_hash:
        message = f"the checkpoint belongs to another version of this scene; {START_ANEW}"
        raise InputError([Fault(str(path), 0, "", message)])
    return checkpoint
