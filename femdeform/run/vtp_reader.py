"""Reads the frames (.vtp) of particles that `femdeform.run.vtp` writes, without VTK."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from femdeform.run.vtk_reader import Arrays, child, read_array, read_arrays, reading, time_of
from femdeform.types import FloatArray


@dataclass(frozen=True)
class VTPContents:
    """What a ``.vtp`` file holds; arrays are read-only.

    Attributes
    ----------
    time : float
        Time [s].
    positions : (n, 3) float64
        Positions [m].
    point_data : dict of str to (n,) or (n, k) arrays
        Fields.
    """

    time: float
    positions: FloatArray
    point_data: Arrays


def read_vtp(path: Path) -> VTPContents:
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
        return VTPContents(time=time_of(root), positions=positions.astype(np.float64), point_data=data)
