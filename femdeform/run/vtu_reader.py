"""Reads the frames (.vtu) that `femdeform.run.vtu` writes, without VTK."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.run.vtk_reader import child, read_array, read_arrays, reading, time_of
from femdeform.run.vtu import VTK_CELLS
from femdeform.types import FloatArray, IntArray

_NAMES = {number: name for name, (number, _) in VTK_CELLS.items()}


@dataclass(frozen=True)
class VTUContents:
    """What a ``.vtu`` file holds, in read-only arrays; `cell_data` has one array per block.

    Neighbouring blocks of one cell type, say the tetrahedra of two bodies, come back as one block.
    """

    time: float
    points: FloatArray
    blocks: list[tuple[str, IntArray]]
    point_data: dict[str, NDArray[Any]]
    cell_data: dict[str, list[NDArray[Any]]]


def read_vtu(path: Path) -> VTUContents:
    """Read a file written by `VTUWriter`.

    Parameters
    ----------
    path : Path
        The ``.vtu`` file.

    Raises
    ------
    InputError
        If the file is missing, torn, or not of the kind `VTUWriter` writes.
    """
    with reading(path) as root:
        piece = child(root, "UnstructuredGrid/Piece")
        n_points, n_cells = int(piece.get("NumberOfPoints", -1)), int(piece.get("NumberOfCells", -1))
        points = read_array(child(piece, "Points/DataArray"))
        if len(points) != n_points:
            raise ValueError(f"there are not {n_points} points")
        cells = {array.get("Name"): read_array(array) for array in piece.findall("Cells/DataArray")}
        blocks, bounds = _split_blocks(cells["connectivity"], cells["offsets"], cells["types"])
        if bounds[-1] != n_cells:
            raise ValueError(f"there are not {n_cells} cells")
        for _, block in blocks:
            if block.size and (block.min() < 0 or block.max() >= n_points):
                raise ValueError("a cell refers to a point that is not there")
        cell_data = read_arrays(piece, "CellData", n_cells)
        return VTUContents(
            time=time_of(root),
            points=points.astype(np.float64),
            blocks=blocks,
            point_data=read_arrays(piece, "PointData", n_points),
            cell_data={
                name: [array[first:last] for first, last in pairwise(bounds)] for name, array in cell_data.items()
            },
        )


def _split_blocks(
    connectivity: IntArray, offsets: IntArray, types: NDArray[np.uint8]
) -> tuple[list[tuple[str, IntArray]], list[int]]:
    # Runs of equal types are the blocks, as the writer laid them down one after the other.
    changes = np.flatnonzero(np.diff(types)) + 1
    bounds = [0, *changes.tolist(), len(types)] if len(types) else [0]
    starts = np.concatenate([[0], offsets])
    blocks = []
    for first, last in pairwise(bounds):
        name = _NAMES[int(types[first])]
        cells = connectivity[starts[first] : starts[last]].reshape(-1, VTK_CELLS[name][1])
        blocks.append((name, cells.astype(np.int64)))
    return blocks, bounds
