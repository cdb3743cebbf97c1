"""Which voxels of a grid lie inside of a closed surface."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.flow.mac_grid import MACGrid
from femdeform.jit import njit, prange
from femdeform.types import FloatArray, IntArray

# Rays are moved off the voxels' centres by parts of a voxel that no mesh shares, so that none runs along an edge.
_SHIFT_X, _SHIFT_Y = 1.2345e-7, 2.3456e-7


@njit
def _count_crossings(
    points: Any, triangles: Any, first: Any, spacing: Any, count: Any, start: Any, heights: Any
) -> None:
    """Count the triangles above each column of voxels, or, where `heights` has room, write where they cross it."""
    writes = heights.size > 0
    for t in range(triangles.shape[0]):
        a, b, c = points[triangles[t, 0]], points[triangles[t, 1]], points[triangles[t, 2]]
        low_x, high_x = min(a[0], b[0], c[0]), max(a[0], b[0], c[0])
        low_y, high_y = min(a[1], b[1], c[1]), max(a[1], b[1], c[1])
        i0 = max(0, int(np.ceil((low_x - first[0]) / spacing)))
        i1 = min(count.shape[0] - 1, int(np.floor((high_x - first[0]) / spacing)))
        j0 = max(0, int(np.ceil((low_y - first[1]) / spacing)))
        j1 = min(count.shape[1] - 1, int(np.floor((high_y - first[1]) / spacing)))
        area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
        if area == 0.0:
            continue
        for i in range(i0, i1 + 1):
            x = first[0] + i * spacing
            for j in range(j0, j1 + 1):
                y = first[1] + j * spacing
                s = ((x - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (y - a[1])) / area
                t_ = ((b[0] - a[0]) * (y - a[1]) - (x - a[0]) * (b[1] - a[1])) / area
                if s >= 0.0 and t_ >= 0.0 and s + t_ < 1.0:
                    if writes:
                        heights[start[i, j] + count[i, j]] = a[2] + s * (b[2] - a[2]) + t_ * (c[2] - a[2])
                    count[i, j] += 1


@njit(parallel=True)
def _fill_columns(first: Any, spacing: Any, count: Any, start: Any, heights: Any, inside: Any) -> None:
    """Mark voxels between the first and second crossing of their column, the third and fourth, and so on."""
    for i in prange(inside.shape[0]):
        for j in range(inside.shape[1]):
            found = np.sort(heights[start[i, j] : start[i, j] + count[i, j]])
            crossed = 0
            for k in range(inside.shape[2]):
                z = first[2] + k * spacing
                while crossed < found.size and found[crossed] <= z:
                    crossed += 1
                inside[i, j, k] = crossed % 2 == 1


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
    first = grid.origin + 0.5 * grid.spacing
    corners, triangles = points, facets
    if grid.dim == 2:
        # An edge becomes the wall above it: rays go along y, which takes the place of z.
        corners, triangles = _walls(points, facets, grid.spacing)
        first = np.array([first[0], 0.0, first[1]])
        shape = (grid.shape[0], 1, grid.shape[1])
    else:
        shape = grid.shape
    first = first + grid.spacing * np.array([_SHIFT_X, _SHIFT_Y, 0.0])
    corners = np.ascontiguousarray(corners, dtype=float)
    count = np.zeros(shape[:2], dtype=np.int64)
    start = np.zeros(shape[:2], dtype=np.int64)
    _count_crossings(corners, triangles, first, grid.spacing, count, start, np.empty(0))
    total = int(count.sum())
    start = (np.cumsum(count) - count.ravel()).reshape(count.shape)
    heights = np.empty(max(1, total))
    count[...] = 0
    _count_crossings(corners, triangles, first, grid.spacing, count, start, heights)
    inside = np.zeros(shape, dtype=np.bool_)
    _fill_columns(first, grid.spacing, count, start, heights, inside)
    return np.ascontiguousarray(np.swapaxes(inside, 1, 2)) if grid.dim == 2 else inside


def _walls(points: FloatArray, edges: IntArray, spacing: float) -> tuple[FloatArray, IntArray]:
    n = len(points)
    below = np.column_stack([points[:, 0], np.full(n, -spacing), points[:, 1]])
    above = np.column_stack([points[:, 0], np.full(n, spacing), points[:, 1]])
    a, b = edges.T
    return np.vstack([below, above]), np.vstack([np.column_stack([a, b, b + n]), np.column_stack([a, b + n, a + n])])
