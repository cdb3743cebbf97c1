"""Unstructured-grid files (.vtu) of a mesh that deforms.

A frame repeats the mesh, which never changes: its points and cells are compressed once, and a frame then
costs the compression of its own fields only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.run.vtk_xml import as_vtk_columns, data_array, write_document
from femdeform.types import FloatArray, IntArray

# VTK's number and node count of each cell; quadratic cells have the mid nodes of edges 01, 12, 20, then 03,
# 13, 23.
VTK_CELLS: dict[str, tuple[int, int]] = {
    "line": (3, 2),
    "triangle": (5, 3),
    "tetra": (10, 4),
    "triangle6": (22, 6),
    "tetra10": (24, 10),
}

CellData = Mapping[str, Sequence[NDArray[Any]]]


@dataclass(frozen=True)
class FrameMesh:
    """The mesh of all frames of a run: every body, in the reference state.

    Attributes
    ----------
    points : (n_points, dim) float64
        REFERENCE positions [m]. A frame stores these beside `displacement` (ParaView's "Warp By Vector"
        shows the deformed shape), so that strains and groups can still be found from any frame.
    blocks : list of (name, (n_cells, k) int64)
        Cells by type: ``line``, ``triangle``, ``tetra``, ``triangle6`` or ``tetra10``, in VTK's order of
        nodes.
    cell_data : dict of str to list of arrays
        What does not change over time, an array per block: ``body``, ``region``.

    Raises
    ------
    ValueError
        If a block is of an unknown type or shape, refers to points that are not there, or cell data do not
        fit.
    """

    points: FloatArray
    blocks: list[tuple[str, IntArray]]
    cell_data: CellData

    def __post_init__(self) -> None:
        if self.points.ndim != 2 or self.points.shape[1] not in (2, 3):
            raise ValueError(f"points of shape {self.points.shape} are not positions in 2D or 3D")
        for name, cells in self.blocks:
            if name not in VTK_CELLS:
                raise ValueError(f"unknown cell type {name!r}; known: {', '.join(VTK_CELLS)}")
            if cells.ndim != 2 or cells.shape[1] != VTK_CELLS[name][1]:
                raise ValueError(f"cells of shape {cells.shape} are not {name} cells")
            if cells.size and (cells.min() < 0 or cells.max() >= len(self.points)):
                raise ValueError(f"a {name} cell refers to a point that is not there")
        for name, arrays in self.cell_data.items():
            join_cell_data(self, name, arrays)

    @property
    def n_points(self) -> int:
        """Number of points."""
        return len(self.points)

    @property
    def n_cells(self) -> int:
        """Number of cells of all blocks."""
        return sum(len(cells) for _, cells in self.blocks)


def join_cell_data(mesh: FrameMesh, name: str, arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """One array over all cells, in the order of the blocks, from an array per block.

    Parameters
    ----------
    mesh : FrameMesh
        Mesh the data belong to.
    name : str
        Name of the data, for the error.
    arrays : sequence of (n_cells, ...) arrays
        One per block.

    Raises
    ------
    ValueError
        If the number of blocks, or of cells in one of them, differs from the mesh.
    """
    lengths = [len(cells) for _, cells in mesh.blocks]
    given = [len(array) for array in arrays]
    if given != lengths:
        raise ValueError(f"cell data {name!r} of lengths {given}, blocks of {lengths} cells")
    return np.concatenate([np.asarray(array) for array in arrays]) if arrays else np.zeros(0)


class VTUWriter:
    """Writes frames of one mesh, whose own part of the file is made once.

    Parameters
    ----------
    mesh : FrameMesh
        Mesh of all frames.
    """

    suffix = ".vtu"

    def __init__(self, mesh: FrameMesh) -> None:
        self.mesh = mesh
        sizes = [np.full(len(cells), cells.shape[1], dtype=np.int64) for _, cells in mesh.blocks]
        types = [np.full(len(cells), VTK_CELLS[name][0], dtype=np.uint8) for name, cells in mesh.blocks]
        connectivity = [np.asarray(cells, dtype=np.int64).ravel() for _, cells in mesh.blocks]
        geometry = [
            "<Points>\n",
            data_array("Points", as_vtk_columns(mesh.points)),
            "</Points>\n<Cells>\n",
            data_array("connectivity", _concatenate(connectivity, np.int64)),
            data_array("offsets", np.cumsum(_concatenate(sizes, np.int64), dtype=np.int64)),
            data_array("types", _concatenate(types, np.uint8)),
            "</Cells>\n",
        ]
        self._geometry = "".join(geometry)
        self._cell_arrays = {
            name: data_array(name, as_vtk_columns(join_cell_data(mesh, name, arrays)))
            for name, arrays in mesh.cell_data.items()
        }

    def write(self, path: Path, time: float, point_data: Mapping[str, NDArray[Any]], cell_data: CellData) -> None:
        """Write one frame atomically.

        Parameters
        ----------
        path : Path
            The ``.vtu`` file.
        time : float
            Time of the frame [s], stored as ``TimeValue``, where ParaView looks for it.
        point_data : dict of str to (n_points,) or (n_points, k) arrays
            Vectors with two components get a third, zero; 2 x 2 and 3 x 3 tensors become nine components.
        cell_data : dict of str to list of arrays
            An array per block of the mesh.

        Raises
        ------
        OutputError
            If the file cannot be written.
        ValueError
            If `displacement` is missing or an array does not fit the mesh.
        """
        if "displacement" not in point_data:
            raise ValueError("a frame needs the point data `displacement`")
        for name, array in point_data.items():
            if len(array) != self.mesh.n_points:
                raise ValueError(f"point data {name!r} of length {len(array)}, {self.mesh.n_points} points")
        cell_arrays = dict(self._cell_arrays)
        for name, arrays in cell_data.items():
            cell_arrays[name] = data_array(name, as_vtk_columns(join_cell_data(self.mesh, name, arrays)))
        piece = [
            f'<Piece NumberOfPoints="{self.mesh.n_points}" NumberOfCells="{self.mesh.n_cells}">\n',
            self._geometry,
            '<PointData Vectors="displacement">\n',
            *(data_array(name, as_vtk_columns(np.asarray(array))) for name, array in point_data.items()),
            "</PointData>\n<CellData>\n",
            *cell_arrays.values(),
            "</CellData>\n</Piece>\n",
        ]
        write_document(path, "UnstructuredGrid", "", time, piece)


def _concatenate(arrays: list[NDArray[Any]], dtype: type) -> NDArray[Any]:
    return np.concatenate(arrays) if arrays else np.zeros(0, dtype=dtype)
