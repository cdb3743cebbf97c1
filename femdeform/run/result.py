"""Reads a result folder: of a finished run, of one that failed, or of one still running."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

from numpy.typing import NDArray

from femdeform.errors import Fault, InputError
from femdeform.run.frames import Frame, load_frame
from femdeform.run.table import read_table
from femdeform.run.vtk_reader import read_pvd

# Endings of the frames by the kind of the simulation.
_ENDINGS = {"deformable": ".vtu", "material_points": ".vtp", "incompressible_flow": ".vti"}


class FrameEntry(NamedTuple):
    """A frame in the folder: number in the file name, time [s], file."""

    number: int
    time: float
    path: Path


@dataclass(frozen=True)
class Result:
    """A result folder, open for reading; files are read when they are asked for.

    Attributes
    ----------
    folder : Path
        The folder.
    facts : mapping
        What ``result.json`` says.
    """

    folder: Path
    facts: Mapping[str, Any]

    @classmethod
    def open(cls, folder: Path) -> Result:
        """Open a result folder.

        Parameters
        ----------
        folder : Path
            The folder, or its ``result.json``.

        Raises
        ------
        InputError
            If there is no such folder, it is not a result, or its ``result.json`` is corrupt.
        """
        folder = folder.parent if folder.name == "result.json" else folder
        path = folder / "result.json"
        if not folder.is_dir():
            raise _fault(folder, "no such result folder")
        if not path.exists():
            raise _fault(folder, "not a result folder: result.json is missing")
        try:
            facts = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise _fault(path, f"the file is corrupt ({error})") from error
        if not isinstance(facts, dict) or not isinstance(facts.get("status"), str):
            raise _fault(path, "the file is corrupt (there is no status in it)")
        return cls(folder=folder, facts=facts)

    @property
    def simulation(self) -> str:
        """The kind of the simulation: ``deformable``, ``incompressible_flow``, ``material_points``."""
        return str(self.facts.get("simulation") or "deformable")

    @cached_property
    def history(self) -> dict[str, NDArray[Any]]:
        """Columns of ``history.csv``, (n_steps,) each; a torn last line is left out.

        Raises
        ------
        InputError
            If the file is missing or corrupt.
        """
        return read_table(self.folder / "history.csv")

    @cached_property
    def iterations(self) -> dict[str, NDArray[Any]] | None:
        """Columns of ``iterations.csv``; None for a run without trace.

        Raises
        ------
        InputError
            If the file is corrupt.
        """
        path = self.folder / "iterations.csv"
        return read_table(path) if path.exists() else None

    @cached_property
    def resolved_text(self) -> str:
        """The resolved scene, as text.

        Raises
        ------
        InputError
            If ``resolved.yaml`` is missing or cannot be read.
        """
        path = self.folder / "resolved.yaml"
        try:
            return path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise _fault(path, f"the resolved scene cannot be read ({error})") from error

    @cached_property
    def resolved(self) -> dict[str, Any]:
        """The resolved scene, every default and override in place.

        Raises
        ------
        InputError
            If ``resolved.yaml`` is missing or is not a YAML mapping.
        """
        from ruamel.yaml import YAML
        from ruamel.yaml.error import YAMLError

        path = self.folder / "resolved.yaml"
        try:
            resolved = YAML(typ="safe", pure=True).load(self.resolved_text)
        except YAMLError as error:
            raise _fault(path, f"the file is corrupt ({' '.join(str(error).split())})") from error
        if not isinstance(resolved, dict):
            raise _fault(path, "the file is corrupt (it is not a mapping)")
        return resolved

    @cached_property
    def frames(self) -> list[FrameEntry]:
        """Frames listed in ``frames.pvd`` by time; empty where none was written.

        Raises
        ------
        InputError
            If the list is corrupt, or names a file that is missing.
        """
        listing = self.folder / "frames.pvd"
        entries = []
        for time, file in sorted(read_pvd(listing)):
            path = self.folder / file
            if not path.exists():
                raise _fault(listing, f"the result is incomplete: {file} is missing")
            try:
                number = int(path.stem.rsplit("_", 1)[1])
            except (IndexError, ValueError) as error:
                raise _fault(listing, f"{file} is not the name of a frame") from error
            entries.append(FrameEntry(number, time, path))
        return entries

    def read_frame(self, i: int) -> Frame:
        """Read one frame.

        Parameters
        ----------
        i : int
            Position in `frames`; negative numbers count from the end.

        Returns
        -------
        Frame
            A `BodyFrame`, `GridFrame` or `ParticleFrame`, as the simulation is.

        Raises
        ------
        InputError
            If there is no such frame, or its file is corrupt.
        """
        n_frames = len(self.frames)
        if not -n_frames <= i < n_frames:
            known = f"it has frames 0 to {n_frames - 1}" if n_frames else "it has no frames"
            raise _fault(self.folder, f"there is no frame {i} in this result: {known}")
        entry = self.frames[i]
        return load_frame(entry.path, entry.time)

    def read_final(self) -> Frame:
        """Read the last accepted state of a run that has ended: ``final.vtu``, or ``.vtp``, ``.vti``.

        Raises
        ------
        InputError
            If the file is missing (the run has not ended) or corrupt.
        """
        expected = f"final{_ENDINGS.get(self.simulation, '.vtu')}"
        if not (self.folder / expected).exists():
            raise _fault(self.folder, f"there is no {expected}: the run's status is {self.facts['status']}")
        return load_frame(self.folder / expected)


def _fault(path: Path, message: str) -> InputError:
    return InputError([Fault(str(path), 0, "", message)])
