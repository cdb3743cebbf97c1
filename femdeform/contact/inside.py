"""Which points lie inside of a closed surface of segments (2D) or triangles (3D).

A ray goes from the point along the last axis; the point is inside if it crosses the surface an odd number of times.
Facets are found through bins of the other axes. Whether a ray passes an edge is decided from the edge alone, so two
triangles never both miss it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.jit import njit, prange
from femdeform.types import BoolArray, FloatArray, IntArray

# Points that one thread takes at a time.
_CHUNK = 2048
# Bins an axis at most.
_MOST_BINS = 512


@njit
def _list_facets(corners: Any, low: Any, inverse: Any, shape: Any, starts: Any, facets: Any) -> None:
    """Count the facets of each bin into `starts`[1:], or, where `facets` has room, list them and move `starts`."""
    writes = facets.size > 0
    first, last = np.zeros(2, np.int64), np.zeros(2, np.int64)
    for f in range(corners.shape[0]):
        for a in range(corners.shape[2] - 1):
            least, most = corners[f, 0, a], corners[f, 0, a]
            for k in range(1, corners.shape[1]):
                least, most = min(least, corners[f, k, a]), max(most, corners[f, k, a])
            first[a] = min(max(int((least - low[a]) * inverse[a]), 0), shape[a] - 1)
            last[a] = min(max(int((most - low[a]) * inverse[a]), 0), shape[a] - 1)
        for i in range(first[0], last[0] + 1):
            for j in range(first[1], last[1] + 1):
                b = i * shape[1] + j
                if writes:
                    facets[starts[b]] = f
                    starts[b] += 1
                else:
                    starts[b + 1] += 1


@njit
def _passes(p: Any, q: Any, x: float, y: float) -> bool:
    """Whether the edge p, q goes from one side of the line through (x, y) along the first axis to the other, beyond."""
    if (p[1] > y) == (q[1] > y):
        return False
    return bool(x < p[0] + (y - p[1]) * (q[0] - p[0]) / (q[1] - p[1]))


@njit(parallel=True)
def _inside(
    x: Any, points: Any, elements: Any, low: Any, inverse: Any, shape: Any, starts: Any, facets: Any, out: Any
) -> None:
    dim = x.shape[1]
    for chunk in prange((x.shape[0] + _CHUNK - 1) // _CHUNK):
        for n in range(chunk * _CHUNK, min((chunk + 1) * _CHUNK, x.shape[0])):
            out[n] = False
            b = 0
            beyond = False
            for a in range(dim - 1):
                place = (x[n, a] - low[a]) * inverse[a]
                # The last bin has its upper end.
                if not (place >= 0.0 and place <= shape[a]):
                    beyond = True
                    break
                b = b * shape[a] + min(int(place), shape[a] - 1)
            if beyond:
                continue
            odd = False
            for t in range(starts[b], starts[b + 1]):
                e = elements[facets[t]]
                if dim == 2:
                    p, q = points[e[0]], points[e[1]]
                    if (p[0] > x[n, 0]) != (q[0] > x[n, 0]):
                        height = p[1] + (x[n, 0] - p[0]) * (q[1] - p[1]) / (q[0] - p[0])
                        odd = odd != (height > x[n, 1])
                    continue
                p, q, r = points[e[0]], points[e[1]], points[e[2]]
                # Nodes ascend in each element: an edge is the same numbers to both of its triangles.
                crossed = _passes(p, q, x[n, 0], x[n, 1]) != _passes(p, r, x[n, 0], x[n, 1])
                crossed = crossed != _passes(q, r, x[n, 0], x[n, 1])
                if crossed:
                    area = (q[0] - p[0]) * (r[1] - p[1]) - (r[0] - p[0]) * (q[1] - p[1])
                    s = ((x[n, 0] - p[0]) * (r[1] - p[1]) - (r[0] - p[0]) * (x[n, 1] - p[1])) / area
                    u = ((q[0] - p[0]) * (x[n, 1] - p[1]) - (x[n, 0] - p[0]) * (q[1] - p[1])) / area
                    height = p[2] + s * (q[2] - p[2]) + u * (r[2] - p[2])
                    odd = odd != (height > x[n, 2])
            out[n] = odd


class InsideTest:
    """Tells which points are inside of a closed surface.

    Parameters
    ----------
    points : (n, dim) float64
        Corners [m].
    facets : (m, dim) int64
        Triangles in 3D, edges in 2D, in any orientation.

    Limitations
    -----------
    The surface has to be closed; of parts that overlap, the overlap counts as outside. A point on the surface may be
    found on either side.
    """

    def __init__(self, points: FloatArray, facets: IntArray) -> None:
        # Corners at one place become one node.
        self._points, number = np.unique(np.ascontiguousarray(points, dtype=float), axis=0, return_inverse=True)
        self._elements = np.sort(number.ravel()[facets], axis=1)
        corners = self._points[self._elements]
        dim = self._points.shape[1]
        self._low = corners.min(axis=(0, 1))
        extent = corners.max(axis=(0, 1)) - self._low
        bins = int(min(_MOST_BINS, max(1.0, np.ceil(len(facets) ** (1.0 / (dim - 1))))))
        # In 2D the second axis has one bin.
        self._shape = np.array([bins, bins if dim == 3 else 1], dtype=np.int64)
        # A surface without extent has no inside, whatever its bins.
        wide = np.where(extent[:-1] > 0.0, extent[:-1], 1.0)
        self._inverse = self._shape[: dim - 1] / wide
        counts = np.zeros(int(self._shape.prod()) + 1, dtype=np.int64)
        _list_facets(corners, self._low, self._inverse, self._shape, counts, np.empty(0, np.int64))
        self._starts = np.cumsum(counts)
        self._facets = np.zeros(max(1, int(self._starts[-1])), dtype=np.int64)
        _list_facets(corners, self._low, self._inverse, self._shape, self._starts[:-1].copy(), self._facets)

    def contains(self, x: FloatArray) -> BoolArray:
        """Whether each of the positions (n, dim) is inside."""
        out = np.zeros(len(x), dtype=np.bool_)
        _inside(
            np.ascontiguousarray(x, dtype=float),
            self._points,
            self._elements,
            self._low,
            self._inverse,
            self._shape,
            self._starts,
            self._facets,
            out,
        )
        return out
