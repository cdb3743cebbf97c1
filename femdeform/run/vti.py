"""Image files (.vti) of fields on a regular grid that stays where it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.run.vtk_xml import as_vtk_columns, data_array, write_document
from femdeform.run.vtu import CellData


class VTIWriter:
    """Writes frames of fields in the voxels of a grid.

    Parameters
    ----------
    shape : sequence of int
        Voxels along x, y, z.
    spacing : float
        Side of a voxel [m].
    origin : sequence of float
        Lower corner of the grid [m], three numbers.
    """

    suffix = ".vti"

    def __init__(self, shape: Sequence[int], spacing: float, origin: Sequence[float]) -> None:
        nx, ny, nz = self.shape = (int(shape[0]), int(shape[1]), int(shape[2]))
        self._extent = f"0 {nx} 0 {ny} 0 {nz}"
        place = " ".join(repr(float(value)) for value in origin)
        side = repr(float(spacing))
        self._attributes = f' WholeExtent="{self._extent}" Origin="{place}" Spacing="{side} {side} {side}"'

    def write(self, path: Path, time: float, point_data: Mapping[str, NDArray[Any]], cell_data: CellData) -> None:
        """Write one frame atomically.

        Parameters
        ----------
        path : Path
            The ``.vti`` file.
        time : float
            Time of the frame [s].
        point_data : mapping
            Empty: the fields are those of voxels.
        cell_data : dict of str to list of one array
            (nx, ny, nz) or (nx, ny, nz, k) each.

        Raises
        ------
        OutputError
            If the file cannot be written.
        ValueError
            If there are point data, or an array is not of the grid's shape.
        """
        if point_data:
            raise ValueError("an image has no point data here")
        arrays = []
        for name, (values,) in cell_data.items():
            if values.shape[:3] != self.shape:
                raise ValueError(f"cell data {name!r} of shape {values.shape}, a grid of {self.shape}")
            # VTK's first index runs fastest.
            flat = np.moveaxis(values, (0, 1, 2), (2, 1, 0)).reshape(-1, *values.shape[3:])
            arrays.append(data_array(name, as_vtk_columns(flat)))
        piece = [f'<Piece Extent="{self._extent}">\n<CellData>\n', *arrays, "</CellData>\n</Piece>\n"]
        write_document(path, "ImageData", self._attributes, time, piece)
