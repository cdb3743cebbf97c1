"""The plain data that travels between the parts of femdeform."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

CellType = Literal["line", "triangle", "tetra"]

CELL_SIZES: dict[CellType, int] = {"line": 2, "triangle": 3, "tetra": 4}


@dataclass(frozen=True)
class Mesh:
    """An immutable simplex mesh with named parts; arrays are read-only.

    Attributes
    ----------
    points : (n_points, dim) float64
        Reference positions [m]; ``dim`` is 2 or 3.
    cells : (n_cells, k) int64
        Nodes of each line (k = 2), triangle (k = 3) or tetrahedron (k = 4). Solids are positively oriented.
    cell_type : str
        ``line``, ``triangle`` or ``tetra``.
    facet_groups : dict of str to (n, k - 1) int64
        Named boundary facets, each row the nodes of one facet (a triangle of a tet, an edge of a triangle, an end
        point of a line), oriented outward for solids.
    cell_groups : dict of str to (n,) int64
        Named sets of cells.
    node_groups : dict of str to (n,) int64
        Named sets of nodes that are not facets (a corner, a mid line).
    cell_data : dict of str to (n_cells, dim) float64
        Named vectors of the cells, as the mesh file has them (fibre directions).
    """

    points: FloatArray
    cells: IntArray
    cell_type: CellType
    facet_groups: dict[str, IntArray] = field(default_factory=dict)
    cell_groups: dict[str, IntArray] = field(default_factory=dict)
    node_groups: dict[str, IntArray] = field(default_factory=dict)
    cell_data: dict[str, FloatArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", np.ascontiguousarray(self.points, dtype=np.float64))
        object.__setattr__(self, "cells", np.ascontiguousarray(self.cells, dtype=np.int64))
        for array in (self.points, self.cells):
            array.setflags(write=False)
        if self.cells.ndim != 2 or self.cells.shape[1] != CELL_SIZES[self.cell_type]:
            raise ValueError(f"cells of shape {self.cells.shape} are not {self.cell_type}s")

    @property
    def dim(self) -> int:
        """Dimension of the space the points live in."""
        return int(self.points.shape[1])

    @property
    def n_points(self) -> int:
        """Number of points."""
        return int(self.points.shape[0])

    @property
    def n_cells(self) -> int:
        """Number of cells."""
        return int(self.cells.shape[0])

    def group_names(self) -> list[str]:
        """Names that ``on:`` can select, sorted."""
        return sorted({*self.facet_groups, *self.cell_groups, *self.node_groups})

    def group_nodes(self, name: str) -> IntArray:
        """Sorted nodes of a named facet, node or cell group.

        Raises
        ------
        KeyError
            If there is no group of that name.
        """
        if name in self.facet_groups:
            return np.unique(self.facet_groups[name])
        if name in self.node_groups:
            return np.unique(self.node_groups[name])
        return np.unique(self.cells[self.cell_groups[name]])
