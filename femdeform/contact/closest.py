"""The closest points of surfaces made of segments or triangles."""

from __future__ import annotations

import numpy as np

from femdeform.types import FloatArray, IntArray

# Points that are treated at a time: bounds the memory of the candidates.
_CHUNK = 20_000
# Candidates this much farther than the nearest found are looked at too, relative: rounding of the search tree.
_ROUNDING = 1.0 + 1e-9


def closest_points(points: FloatArray, corners: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
    """Closest point of a surface to each of a number of points; exact, of equal ones that of the lowest number.

    Parameters
    ----------
    points : (n, dim) float64
        [m]
    corners : (n_facets, k, dim) float64
        Corners of segments (k = 2) or triangles (k = 3) [m].

    Returns
    -------
    facets : (n,) int64
        Facet that the closest point is on.
    weights : (n, k) float64
        Its barycentric coordinates, in [0, 1] [-].
    distance : (n,) float64
        Distance from the point [m].
    """
    from scipy.spatial import cKDTree

    centers = corners.mean(axis=1)
    radius = float(np.linalg.norm(corners - centers[:, None], axis=2).max())
    tree = cKDTree(centers)
    parts = []
    for first in range(0, max(len(points), 1), _CHUNK):
        some = points[first : first + _CHUNK]
        bound = np.asarray(tree.query(some)[0]).reshape(len(some))
        # The centre of the closest facet is at most its radius farther away than its closest point.
        found = tree.query_ball_point(some, (bound + radius) * _ROUNDING, return_sorted=True)
        counts = np.fromiter(map(len, found), dtype=np.int64, count=len(some))
        facet = np.fromiter((i for inner in found for i in inner), dtype=np.int64, count=int(counts.sum()))
        owner = np.repeat(np.arange(len(some)), counts)
        weights = closest_weights(some[owner], corners[facet])
        distance = np.linalg.norm(np.einsum("nk,nkc->nc", weights, corners[facet]) - some[owner], axis=1)
        best = np.lexsort((facet, distance, owner))[np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64)]
        parts.append((facet[best], weights[best], distance[best]))
    facets, weights, distance = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return facets, weights, distance


def closest_weights(points: FloatArray, corners: FloatArray) -> FloatArray:
    """Coordinates (n, k) of the closest point of each one's segment or triangle (n, k, dim), exact zeros on its rim."""
    if corners.shape[1] == 2:
        return _on_segment(points, corners)
    edges = corners[:, 1:] - corners[:, :1]
    metric = np.einsum("nic,njc->nij", edges, edges)
    right = np.einsum("nic,nc->ni", edges, points - corners[:, 0])
    determinant = metric[:, 0, 0] * metric[:, 1, 1] - metric[:, 0, 1] ** 2
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (metric[:, 1, 1] * right[:, 0] - metric[:, 0, 1] * right[:, 1]) / determinant
        v = (metric[:, 0, 0] * right[:, 1] - metric[:, 0, 1] * right[:, 0]) / determinant
    weights = np.stack([1.0 - u - v, u, v], axis=1)
    # Outside of the triangle (or of one without area) the closest point is that of one of its edges.
    outside = np.flatnonzero(~(weights >= 0.0).all(axis=1))
    if outside.size:
        some, of = points[outside], corners[outside]
        tries = np.zeros((3, outside.size, 3))
        for number, pair in enumerate(((0, 1), (1, 2), (0, 2))):
            tries[number][:, pair] = _on_segment(some, of[:, pair])
        distance = np.linalg.norm(np.einsum("tnk,nkc->tnc", tries, of) - some, axis=2)
        weights[outside] = tries[np.argmin(distance, axis=0), np.arange(outside.size)]
    return weights


def _on_segment(points: FloatArray, corners: FloatArray) -> FloatArray:
    edge = corners[:, 1] - corners[:, 0]
    square = np.einsum("nc,nc->n", edge, edge)
    along = np.einsum("nc,nc->n", edge, points - corners[:, 0])
    t = np.clip(np.divide(along, square, out=np.zeros_like(along), where=square > 0.0), 0.0, 1.0)
    return np.stack([1.0 - t, t], axis=1)
