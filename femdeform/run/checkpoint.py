"""Checkpoints: everything needed to go on from a step as if the run had never stopped.

The file is HDF5 with a line behind its end that holds the checksum of all before it. HDF5 ignores that line; whatever
damages the file is noticed before HDF5 has to make sense of it. One checkpoint is kept: as it is replaced atomically,
an older one beside it would never be needed.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from femdeform.errors import Fault, InputError
from femdeform.run import atomic

FILE_NAME = "checkpoint.h5"
# What to do where there is nothing to go on from; a run does not write over another one's result unasked.
START_ANEW = "run without --resume, with --overwrite or into another folder (--out)"
_VERSION = 4
_SEAL = b"\nfemdeform checkpoint sha256 "
# Results of runs that ended too early to leave a checkpoint: nothing is lost by beginning again.
_BEGUN = ("running", "interrupted", "failed")


@dataclass(frozen=True)
class Checkpoint:
    """State of a run after an accepted step.

    Attributes
    ----------
    fields : dict of str to array
        What the state is made of. Of deformable bodies: positions ``x`` [m] and velocities ``v`` [m/s] of all nodes in
        the order of the input, (n_nodes, dim) each, and where they are embedded in a grid their ``affine`` velocities
        (n_nodes, dim, dim) [1/s].
    time : float
        Time [s].
    step : int
        Accepted steps.
    current_dt : float
        Size of the next step [s], smaller than the scene's after a failure.
    streak : int
        Accepted steps of that size, while it is smaller.
    frames : int
        Frames written.
    seconds : float
        Wall time spent so far [s].
    scene_hash : str
        Hash of the scene that was run.
    mesh_files : dict of str to str
        SHA-256 of the mesh file of every body that has one.
    """

    fields: Mapping[str, NDArray[Any]]
    time: float
    step: int
    current_dt: float
    streak: int
    frames: int
    seconds: float
    scene_hash: str
    mesh_files: dict[str, str] = field(default_factory=dict)


def write_checkpoint(folder: Path, checkpoint: Checkpoint) -> None:
    """Replace the checkpoint of a result folder atomically.

    Raises
    ------
    OutputError
        If it cannot be written; the old one is then still there.
    """
    import h5py

    # In memory first: HDF5 itself reports a full disk in ways that differ between versions, at times at exit only.
    image = io.BytesIO()
    with h5py.File(image, "w") as file:
        file.attrs["version"] = _VERSION
        for name, values in checkpoint.fields.items():
            file.create_dataset(name, data=values)
        for name, value in vars(checkpoint).items():
            if name != "fields":
                file.attrs[name] = json.dumps(value) if isinstance(value, dict) else value
    data = image.getvalue()
    atomic.write_bytes(folder / FILE_NAME, data + _SEAL + hashlib.sha256(data).hexdigest().encode("ascii") + b"\n")


def is_unsaved(folder: Path) -> bool:
    """Whether a run was begun in a result folder and ended before its first checkpoint."""
    if (folder / FILE_NAME).exists():
        return False
    try:
        facts = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False
    return isinstance(facts, dict) and facts.get("status") in _BEGUN


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
        data = path.read_bytes()
    except OSError as error:
        raise InputError([Fault(str(path), 0, "", f"the checkpoint cannot be read: {error.strerror}")]) from None
    try:
        with h5py.File(io.BytesIO(_unsealed(data)), "r") as file:
            attributes: Mapping[str, Any] = dict(file.attrs)
            version = int(attributes["version"])
            if version != _VERSION:
                message = f"checkpoint version {version} is not known here, only {_VERSION}; {START_ANEW}"
                raise InputError([Fault(str(path), 0, "", message)])
            checkpoint = Checkpoint(
                fields={name: values[()] for name, values in file.items()},
                time=float(attributes["time"]),
                step=int(attributes["step"]),
                current_dt=float(attributes["current_dt"]),
                streak=int(attributes["streak"]),
                frames=int(attributes["frames"]),
                seconds=float(attributes["seconds"]),
                scene_hash=str(attributes["scene_hash"]),
                mesh_files=dict(json.loads(attributes["mesh_files"])),
            )
    except (OSError, KeyError, ValueError) as error:
        message = f"the checkpoint is damaged ({error}); {START_ANEW}"
        raise InputError([Fault(str(path), 0, "", message)]) from None
    if scene_hash is not None and checkpoint.scene_hash != scene_hash:
        message = f"the checkpoint belongs to another version of this scene; {START_ANEW}"
        raise InputError([Fault(str(path), 0, "", message)])
    return checkpoint


def _unsealed(data: bytes) -> bytes:
    """Contents of a checkpoint file without its checksum, which has to be right."""
    at = data.rfind(_SEAL)
    if at < 0:
        raise ValueError("its end is missing, or an older femdeform wrote it")
    if data[at + len(_SEAL) :] != hashlib.sha256(data[:at]).hexdigest().encode("ascii") + b"\n":
        raise ValueError("its checksum is wrong")
    return data[:at]
