"""Frames of results: of deformable bodies, of fields in voxels, of particles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from femdeform.errors import Fault, InputError
from femdeform.run.vti_reader import read_vti
from femdeform.run.vtp_reader import read_vtp
from femdeform.run.vtu_reader import read_vtu
from femdeform.types import FloatArray, IntArray


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


@dataclass(frozen=True)
class GridFrame:
    """A frame of fields in the voxels of a grid; arrays are read-only.

    Attributes
    ----------
    time : float
        Time [s].
    shape : (int, int, int)
        Voxels along x, y, z; one along z for a 2D scene.
    spacing : (3,) float64
        Sides of a voxel [m].
    origin : (3,) float64
        Lower corner of the grid [m].
    cell_data : dict of str to (nx, ny, nz) or (nx, ny, nz, k) arrays
        Fields at the centres of the voxels.
    """

    time: float
    shape: tuple[int, int, int]
    spacing: FloatArray
    origin: FloatArray
    cell_data: dict[str, NDArray[Any]]

    @property
    def dim(self) -> int:
        """Dimension of the scene."""
        return 2 if self.shape[2] == 1 else 3

    @property
    def box(self) -> FloatArray:
        """Lowest and highest corner of the grid, (2, 3) [m]; flat for a 2D scene."""
        high = self.origin + np.array(self.shape) * self.spacing
        if self.dim == 2:
            high[2] = self.origin[2]
        return np.stack([self.origin, high])

    @property
    def solid(self) -> NDArray[np.bool_]:
        """Voxels inside solids, (nx, ny, nz); none where the frame does not say."""
        return np.asarray(self.cell_data.get("solid", np.zeros(self.shape)), dtype=np.bool_)


@dataclass(frozen=True)
class ParticleFrame:
    """A frame of particles, whose number may differ from that of others; arrays are read-only.

    Attributes
    ----------
    time : float
        Time [s].
    positions : (n, 3) float64
        Positions [m], z = 0 for a 2D scene.
    point_data : dict of str to (n,) or (n, k) arrays
        Fields.
    """

    time: float
    positions: FloatArray
    point_data: dict[str, NDArray[Any]]


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
    contents = read_vti(path)
    return GridFrame(
        time=contents.time if time is None else time,
        shape=contents.shape,
        spacing=contents.spacing,
        origin=contents.origin,
        cell_data=contents.cell_data,
    )


def _load_particles(path: Path, time: float | None) -> ParticleFrame:
    contents = read_vtp(path)
    return ParticleFrame(contents.time if time is None else time, contents.positions, contents.point_data)


_READERS: dict[str, Callable[[Path, float | None], Frame]] = {
    ".vtu": _load_bodies,
    ".vtp": _load_particles,
    ".vti": _load_grid,
}
