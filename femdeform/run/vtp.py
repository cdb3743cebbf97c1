"""Point files (.vtp) of particles, whose number may change from frame to frame."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.run.vtk_xml import as_vtk_columns, data_array, write_document
from femdeform.run.vtu import CellData


class VTPWriter:
    """Writes frames of particles."""

    suffix = ".vtp"

    def write(self, path: Path, time: float, point_data: Mapping[str, NDArray[Any]], cell_data: CellData) -> None:
        """Write one frame atomically.

        Parameters
        ----------
        path : Path
            The ``.vtp`` file.
        time : float
            Time of the frame [s].
        point_data : dict of str to (n,) or (n, k) arrays
            `position` [m] is required; it becomes the points.
        cell_data : mapping
            Empty.

        Raises
        ------
        OutputError
            If the file cannot be written.
        ValueError
            If `position` is missing, an array has another length, or there are cell data.
        """
        if "position" not in point_data or cell_data:
            raise ValueError("a frame of particles needs the point data `position` and has no cell data")
        n = len(point_data["position"])
        for name, array in point_data.items():
            if len(array) != n:
                raise ValueError(f"point data {name!r} of length {len(array)}, {n} particles")
        ends = np.arange(1, n + 1, dtype=np.int64)
        piece = [
            f'<Piece NumberOfPoints="{n}" NumberOfVerts="{n}" NumberOfLines="0" NumberOfStrips="0" ',
            'NumberOfPolys="0">\n',
            "<Points>\n",
            data_array("Points", as_vtk_columns(np.asarray(point_data["position"]))),
            "</Points>\n<Verts>\n",
            data_array("connectivity", ends - 1),
            data_array("offsets", ends),
            "</Verts>\n<PointData>\n",
            *(data_array(k, as_vtk_columns(np.asarray(v))) for k, v in point_data.items() if k != "position"),
            "</PointData>\n</Piece>\n",
        ]
        write_document(path, "PolyData", "", time, piece)
