"""Reads a result folder: of a finished run, of one that failed, or of one still running."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from femdeform.errors import Fault, InputError
from femdeform.run.table import read_table
from femdeform.run.vtu_reader import VTUContents, read_pvd, read_vtu
from femdeform.types import FloatArray, IntArray


class FrameEntry(NamedTuple):
    """A frame in the folder: number in the file name, time [s], file."""

    number: int
    time: float
    path: Path


@dataclass(frozen=True)
class Frame:
    """One frame; arrays are read-only.

    Attributes
    ----------
    time : float
        Time [s].
    points : (n_points, 3) float64
        Reference positions [m], z = 0 for a 2D scene.
    displacement : (n_points, 3) float64
        Displacements [m].
    blocks : list of (name, (n_cells, k) int64)
        Cells by type, in VTK's order of nodes; neighbouring blocks of one type are one.
    point_data : dict of str to (n_points,) or (n_points, k) arrays
        All point data, `displacement` among them.
    cell_data : dict of str to list of arrays
        An array per block.
    """

    time: float
    points: FloatArray
    displacement: FloatArray
    blocks: list[tuple[str, IntArray]]
    point_data: dict[str, NDArray[Any]]
    cell_data: dict[str, list[NDArray[Any]]]

    @property
    def positions(self) -> FloatArray:
        """Deformed positions [m], (n_points, 3)."""
        return self.points + self.displacement


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
        return _as_frame(entry.path, read_vtu(entry.path), entry.time)

    def read_final(self) -> Frame:
        """Read ``final.vtu``, the last accepted state of a run that has ended.

        Raises
        ------
        InputError
            If the file is missing (the run has not ended) or corrupt.
        """
        path = self.folder / "final.vtu"
        if not path.exists():
            raise _fault(self.folder, f"there is no final.vtu: the run's status is {self.facts['status']}")
        contents = read_vtu(path)
        return _as_frame(path, contents, contents.time)


def _as_frame(path: Path, contents: VTUContents, time: float) -> Frame:
    displacement = contents.point_data.get("displacement")
    if displacement is None or displacement.shape != contents.points.shape:
        raise _fault(path, "the file is corrupt (there is no displacement in it)")
    return Frame(
        time=time,
        points=contents.points,
        displacement=np.asarray(displacement, dtype=np.float64),
        blocks=contents.blocks,
        point_data=contents.point_data,
        cell_data=contents.cell_data,
    )


def _fault(path: Path, message: str) -> InputError:
    return InputError([Fault(str(path), 0, "", message)])
