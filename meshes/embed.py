"""Points bound to the cells of a mesh, so that a fine surface follows a coarse body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femdeform.types import FloatArray, IntArray, Mesh

# Points that are treated at a time: bounds the memory of the candidates.
_CHUNK = 20_000


@dataclass(frozen=True)
class Embedding:
    """Cell and place of each of a number of points.

    Attributes
    ----------
    cells : (n,) int64
        Cell that a point is bound to.
    weights : (n, k) float64
        Barycentric coordinates in it; negative ones belong to points outside, which follow the cell's gradient [-].
    distance : (n,) float64
        Distance from the cell, about 0 inside [m].
    """

    cells: IntArray
    weights: FloatArray
    distance: FloatArray


def embed_points(mesh: Mesh, points: FloatArray) -> Embedding:
    """Bind points to the nearest cells of a mesh that fills its space.

    Parameters
    ----------
    mesh : Mesh
        Tetrahedra in 3D or triangles in 2D.
    points : (n, dim) float64
        [m]

    Returns
    -------
    Embedding

    Raises
    ------
    ValueError
        If the cells do not fill the space of the points.
    """
    if mesh.cells.shape[1] != mesh.dim + 1 or points.shape[1] != mesh.dim:
        raise ValueError(f"{mesh.cell_type} cells in {mesh.dim}D do not fill a space for points in {points.shape[1]}D")
    search = _Search(mesh)
    parts = [search.nearest(points[first : first + _CHUNK]) for first in range(0, max(len(points), 1), _CHUNK)]
    cells, weights, distance = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return Embedding(cells, weights, distance)


class _Search:
    """Nearest cells, exactly: a cell as near as d has its centroid within d and the cell's own radius.

    Cells are sorted by their radius in powers of two, so that a few large ones do not make candidates of all others.
    """

    def __init__(self, mesh: Mesh) -> None:
        from scipy.spatial import cKDTree

        self._corners = mesh.points[mesh.cells]
        self._inverse = np.linalg.inv(np.swapaxes(self._corners[:, 1:] - self._corners[:, :1], 1, 2))
        centroids = self._corners.mean(axis=1)
        radius = np.linalg.norm(self._corners - centroids[:, None], axis=2).max(axis=1)
        self._all = cKDTree(centroids)
        sizes = np.floor(np.log2(radius))
        self._classes = []
        for size in np.unique(sizes):
            cells = np.flatnonzero(sizes == size)
            self._classes.append((cKDTree(centroids[cells]), cells, float(radius[cells].max())))

    def nearest(self, points: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """Cells (n,), barycentric coordinates (n, k) and distances (n,) of points."""
        n = len(points)
        first = np.asarray(self._all.query(points)[1]).reshape(n)
        _, bound = self._place(points, first)
        owners, candidates = [np.arange(n)], [first]
        for tree, cells, radius in self._classes:
            # A little more than exact, for rounding.
            found = tree.query_ball_point(points, (bound + radius) * (1.0 + 1e-9))
            counts = np.fromiter((len(inner) for inner in found), dtype=np.int64, count=n)
            owners.append(np.repeat(np.arange(n), counts))
            candidates.append(cells[np.fromiter((i for inner in found for i in inner), np.int64, int(counts.sum()))])
        owner, candidate = np.concatenate(owners), np.concatenate(candidates)
        weights, distance = self._place(points[owner], candidate)
        # Among cells that share the point, the one it lies deepest in.
        tie = np.round(distance / max(float(bound.max(initial=0.0)), self._classes[0][2]), 12)
        order = np.lexsort((candidate, -weights.min(axis=1), tie, owner))
        best = order[np.searchsorted(owner[order], np.arange(n))]
        return candidate[best].astype(np.int64), weights[best], distance[best]

    def _place(self, points: FloatArray, cells: IntArray) -> tuple[FloatArray, FloatArray]:
        """Barycentric coordinates (n, k) of points in cells, and their distances from them (n,)."""
        local = np.einsum("nij,nj->ni", self._inverse[cells], points - self._corners[cells, 0])
        weights = np.concatenate([1.0 - local.sum(axis=1, keepdims=True), local], axis=1)
        # The foot of cut weights is not quite the nearest point of the cell, but its distance bounds the true one.
        inside = np.clip(weights, 0.0, None)
        inside /= inside.sum(axis=1, keepdims=True)
        foot = np.einsum("nk,nkj->nj", inside, self._corners[cells])
        return weights, np.linalg.norm(foot - points, axis=1)
