"""Compiled loops of the level set: distances of grid nodes, and of samples, to the closest point.

Points are listed by the cell of the grid they lie in. Nodes and samples read the cells around them, so nothing is
written twice and no result depends on the number of threads. All arrays are three-dimensional; in 2D the first axis
has one layer, on which everything lies.
"""

from __future__ import annotations

import math
from typing import Any

from femdeform.jit import njit, prange


@njit
def closest_in_cells(
    x: Any, y: Any, z: Any, low: Any, high: Any, points: Any, order: Any, starts: Any, shape: Any
) -> tuple[float, int]:
    """Squared distance to the closest of the points in a box of cells, low to high inclusive, and its number.

    Of points equally far the one of the lowest number is taken; (inf, -1) where there is none.
    """
    best, owner = math.inf, -1
    for i in range(max(low[0], 0), min(high[0], shape[0] - 1) + 1):
        for j in range(max(low[1], 0), min(high[1], shape[1] - 1) + 1):
            row = (i * shape[1] + j) * shape[2]
            first = starts[row + max(low[2], 0)]
            last = starts[row + min(high[2], shape[2] - 1) + 1]
            # Cells of a row follow one another, and so do their points.
            for t in range(first, last):
                p = order[t]
                d2 = (points[p, 0] - x) ** 2 + (points[p, 1] - y) ** 2 + (points[p, 2] - z) ** 2
                if d2 < best or (d2 == best and p < owner):
                    best, owner = d2, p
    return best, owner


@njit(parallel=True)
def node_levels(points: Any, order: Any, starts: Any, shape: Any, radius: Any, out: Any) -> None:
    """Level set of the union of spheres at nodes: distance to the closest point less the radius, in cells.

    Parameters
    ----------
    points : (n, 3)
        Positions in cells; node (i, j, k) lies at (i, j, k).
    order, starts
        Points by their cells; cell (i, j, k) lies between node (i, j, k) and the next one of each axis.
    shape : tuple of int
        Number of cells of each axis.
    radius : float
        Radius of the spheres, below 1.
    out : (nodes of each axis)
        Receives the level set; exact up to a distance of 2, `radius` where no point is as close as that.
    """
    for row in prange(out.shape[0] * out.shape[1]):
        i, j = row // out.shape[1], row % out.shape[1]
        for k in range(out.shape[2]):
            best, _ = closest_in_cells(i, j, k, (i - 1, j - 1, k - 1), (i, j, k), points, order, starts, shape)
            if best > 1.0:
                # The cells at the node reach as far as 1, the next ones as far as 2.
                best, _ = closest_in_cells(
                    i, j, k, (i - 2, j - 2, k - 2), (i + 1, j + 1, k + 1), points, order, starts, shape
                )
            out[i, j, k] = math.sqrt(best) - radius if best <= 4.0 else radius


@njit(parallel=True)
def closest_points(samples: Any, points: Any, order: Any, starts: Any, shape: Any, out: Any) -> None:
    """Number of the point closest to each sample; -1 where none lies within two cells.

    Parameters
    ----------
    samples : (n_samples, 3)
        Positions in cells.
    points, order, starts, shape
        See `node_levels`.
    out : (n_samples,) int64
        Result.
    """
    for r in prange(samples.shape[0]):
        x, y, z = samples[r, 0], samples[r, 1], samples[r, 2]
        i, j, k = math.floor(x), math.floor(y), math.floor(z)
        best, owner = math.inf, -1
        for ring in range(1, 3):
            if best > 1.0:
                best, owner = closest_in_cells(
                    x,
                    y,
                    z,
                    (i - ring, j - ring, k - ring),
                    (i + ring, j + ring, k + ring),
                    points,
                    order,
                    starts,
                    shape,
                )
        out[r] = owner
