"""In which cell of a mesh a point lies, and where inside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femdeform.types import FloatArray, Mesh

# A point this far outside, relative to the size of the mesh, still counts as inside: mesh points are rounded.
_ROUNDING = 1e-6


@dataclass(frozen=True)
class CellPoint:
    """A point inside a cell.

    Attributes
    ----------
    cell : int
        Number of the cell.
    barycentric : (k,) float64
        Barycentric coordinates, one for each corner; they add up to one [-].
    distance : float
        Distance of the point from the cell, rounding if it is inside [m].
    """

    cell: int
    barycentric: FloatArray
    distance: float


def locate_point(mesh: Mesh, point: FloatArray) -> CellPoint | None:
    """Find the cell of a mesh that holds a point; None where the point lies outside.

    Parameters
    ----------
    mesh : Mesh
        Straight-sided simplices; triangles may lie in space, lines in the plane or in space.
    point : (dim,) float64
        [m]
    """
    tolerance = _ROUNDING * float(np.linalg.norm(np.ptp(mesh.points, axis=0)))
    corners = mesh.points[mesh.cells]
    near = (corners.min(axis=1) - tolerance <= point).all(axis=1) & (corners.max(axis=1) + tolerance >= point).all(
        axis=1
    )
    cells = np.flatnonzero(near)
    if not cells.size:
        return None
    corners = corners[cells]
    edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)  # (n, dim, k - 1)
    local = np.einsum("nij,nj->ni", np.linalg.pinv(edges), point - corners[:, 0])
    weights = np.concatenate([1.0 - local.sum(axis=1, keepdims=True), local], axis=1)
    # The nearest point with weights cut to [0, 1] is not exactly the projection, but close enough to tell the inside.
    inside = np.clip(weights, 0.0, None)
    inside /= inside.sum(axis=1, keepdims=True)
    distance = np.linalg.norm(np.einsum("nk,nkj->nj", inside, corners) - point, axis=1)
    best = int(np.argmin(distance))
    if distance[best] > tolerance:
        return None
    return CellPoint(int(cells[best]), np.asarray(inside[best]), float(distance[best]))
