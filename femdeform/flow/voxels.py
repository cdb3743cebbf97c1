"""Which voxels of a grid lie inside of a closed surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from femdeform.contact.inside import InsideTest
from femdeform.flow.mac_grid import MACGrid
from femdeform.types import FloatArray, IntArray


def voxels_inside(grid: MACGrid, points: FloatArray, facets: IntArray) -> NDArray[np.bool_]:
    """Return the voxels whose centre lies inside of a closed surface.

    Parameters
    ----------
    grid : MACGrid
        Its centres are asked for.
    points : (n, dim) float64
        Corners [m].
    facets : (m, dim) int64
        Triangles in 3D, edges in 2D.

    Returns
    -------
    (nx, ny, nz) bool
    """
    inside = InsideTest(points, facets).contains(grid.centres().reshape(-1, grid.dim))
    return inside.reshape(grid.shape)
