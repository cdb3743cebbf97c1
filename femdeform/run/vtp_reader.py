"""Reads the frames (.vtp) of particles that `femdeform.run.vtp` writes, without VTK."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.run.vtk_reader import child, read_array, read_arrays, reading, time_of
from femdeform.types import FloatArray


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


def read_vtp(path: Path) -> ParticleFrame:
    """Read a file written by `VTPWriter`.

    Parameters
    ----------
    path : Path
        The ``.vtp`` file.

    Raises
    ------
    InputError
        If the file is missing, torn, or not of the kind `VTPWriter` writes.
    """
    with reading(path) as root:
        piece = child(root, "PolyData/Piece")
        n = int(piece.get("NumberOfPoints", -1))
        positions = read_array(child(piece, "Points/DataArray"))
        if n == 0:
            positions = positions.reshape(0, 3)
        if positions.shape != (n, 3):
            raise ValueError(f"there are not {n} points")
        data = read_arrays(piece, "PointData", n)
        return ParticleFrame(time=time_of(root), positions=positions.astype(np.float64), point_data=data)
