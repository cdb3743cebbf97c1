"""Frames of results: of deformable bodies, of fields in voxels, of particles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from femdeform.errors import Fault, InputError
from femdeform.run.vti_reader import GridFrame, read_vti
from femdeform.run.vtp_reader import ParticleFrame, read_vtp
from femdeform.run.vtu_reader import read_vtu
from femdeform.types import FloatArray, IntArray

__all__ = ["BodyFrame", "Frame", "GridFrame", "ParticleFrame", "load_frame", "of_kind"]


@dataclass(frozen=True)
class BodyFrame:
    """A frame of deformable bodies; arrays are read-only.

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


Frame = BodyFrame | GridFrame | ParticleFrame
_F = TypeVar("_F", BodyFrame, GridFrame, ParticleFrame)
_NAMES = {BodyFrame: "deformable bodies", GridFrame: "fields on a grid", ParticleFrame: "particles"}


def load_frame(path: Path, time: float | None = None) -> Frame:
    """Read a frame of any kind.

    Parameters
    ----------
    path : Path
        The file; its ending tells the kind.
    time : float, optional
        Time of the frame [s]; default: that in the file.

    Raises
    ------
    InputError
        If the file is missing, torn, or no frame.
    """
    if path.suffix not in _READERS:
        raise InputError([Fault(str(path), 0, "", f"a frame ends in {', '.join(_READERS)}")])
    return _READERS[path.suffix](path, time)


def of_kind(frame: Frame, kind: type[_F], place: Path) -> _F:
    """The frame, if it is of a kind.

    Raises
    ------
    InputError
        If it is of another one.
    """
    if not isinstance(frame, kind):
        message = f"a frame of {_NAMES[type(frame)]}, not of {_NAMES[kind]}"
        raise InputError([Fault(str(place), 0, "", message)])
    return frame


def _load_bodies(path: Path, time: float | None) -> BodyFrame:
    contents = read_vtu(path)
    displacement = contents.point_data.get("displacement")
    if displacement is None or displacement.shape != contents.points.shape:
        raise InputError([Fault(str(path), 0, "", "the file is corrupt (there is no displacement in it)")])
    return BodyFrame(
        time=contents.time if time is None else time,
        points=contents.points,
        displacement=np.asarray(displacement, dtype=np.float64),
        blocks=contents.blocks,
        point_data=contents.point_data,
        cell_data=contents.cell_data,
    )


def _load_grid(path: Path, time: float | None) -> GridFrame:
    frame = read_vti(path)
    return frame if time is None else replace(frame, time=time)


def _load_particles(path: Path, time: float | None) -> ParticleFrame:
    frame = read_vtp(path)
    return frame if time is None else replace(frame, time=time)


_READERS: dict[str, Callable[[Path, float | None], Frame]] = {
    ".vtu": _load_bodies,
    ".vtp": _load_particles,
    ".vti": _load_grid,
}
