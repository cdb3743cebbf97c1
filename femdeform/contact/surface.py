"""The collision surface: the part of the bodies that may touch, as vertices, edges and triangles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from femdeform.types import FloatArray, IntArray

# Quadratic facets are split at their mid-edge nodes (corners first, then the middles of 01, 12 and 02).
_SEGMENTS = np.array([[0, 2], [2, 1]])
_TRIANGLES = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]])


@dataclass(frozen=True)
class SurfacePart:
    """Surface of one body.

    Attributes
    ----------
    body : str
        Name of the body.
    facets : (n, k) int64
        Nodes of the whole problem: segments (k = 2) or triangles (k = 3), or quadratic ones with mid-edge nodes
        after the corners (k = 3 from two corners, k = 6).
    n_corners : int
        2 or 3.
    width : float
        Area per length of segments of a rod in 3D [m]; 1 otherwise.
    half_thickness : float
        Distance from the nodes to the surface: half a membrane's thickness, a rod's radius, 0 for solids [m].
    stiffness : float
        Stiffness of the barrier on this body [Pa].
    """

    body: str
    facets: IntArray
    n_corners: int
    width: float
    half_thickness: float
    stiffness: float

    def linear_facets(self) -> IntArray:
        """Facets with quadratic ones split into linear ones."""
        if self.facets.shape[1] == self.n_corners:
            return self.facets
        pieces = _SEGMENTS if self.n_corners == 2 else _TRIANGLES
        return self.facets[:, pieces].reshape(-1, self.n_corners)


@dataclass(frozen=True)
class CollisionSurface:
    """Surfaces of all bodies over one numbering of their vertices.

    Attributes
    ----------
    nodes : (n,) int64
        Node of each vertex.
    rest : (n, dim) float64
        Reference positions [m].
    edges : (n_edges, 2) int32
    faces : (n_faces, 3) int32
        Empty in 2D.
    vertex_weight, edge_weight : (n,), (n_edges,) float64
        Area that belongs to each, times the stiffness of its body [N].
    half_thickness : (n,) float64
        See `SurfacePart` [m].
    body : (n,) int32
        Number of the body of each vertex.
    bodies : list of str
        Their names.
    """

    nodes: IntArray
    rest: FloatArray
    edges: np.ndarray
    faces: np.ndarray
    vertex_weight: FloatArray
    edge_weight: FloatArray
    half_thickness: FloatArray
    body: np.ndarray
    bodies: list[str]

    @property
    def dim(self) -> int:
        """Dimension of space."""
        return int(self.rest.shape[1])

    def edge_lengths(self) -> FloatArray:
        """Reference length of every edge [m]."""
        return np.asarray(np.linalg.norm(self.rest[self.edges[:, 1]] - self.rest[self.edges[:, 0]], axis=1))


def collision_surface(parts: Sequence[SurfacePart], points: FloatArray) -> CollisionSurface:
    """Join the surfaces of the bodies.

    Parameters
    ----------
    parts : sequence of SurfacePart
        One a body.
    points : (n_nodes, dim) float64
        Reference positions of the nodes [m].
    """
    facets = [part.linear_facets() for part in parts]
    nodes = np.unique(np.concatenate([f.ravel() for f in facets]))
    rest = points[nodes]
    weight = np.zeros(nodes.size)
    thickness = np.zeros(nodes.size)
    body = np.zeros(nodes.size, dtype=np.int32)
    edges: list[IntArray] = [np.empty((0, 2), dtype=np.int64)]
    faces: list[IntArray] = [np.empty((0, 3), dtype=np.int64)]
    edge_weight: list[FloatArray] = [np.empty(0)]
    for number, (part, nodes_of) in enumerate(zip(parts, facets, strict=True)):
        local = np.searchsorted(nodes, nodes_of)
        corners = rest[local]
        own = np.unique(local)
        thickness[own] = part.half_thickness
        body[own] = number
        if part.n_corners == 2:
            area = np.asarray(part.width * np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1))
            edges.append(local)
            edge_weight.append(part.stiffness * area)
        else:
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            area = 0.5 * np.linalg.norm(normal, axis=1)
            faces.append(local)
            pairs = np.sort(local[:, [[0, 1], [1, 2], [0, 2]]].reshape(-1, 2), axis=1)
            unique, inverse = np.unique(pairs, axis=0, return_inverse=True)
            share = np.bincount(inverse.ravel(), np.repeat(area / 3.0, 3), len(unique))
            edges.append(unique)
            edge_weight.append(np.asarray(part.stiffness * share, dtype=np.float64))
        np.add.at(weight, local, part.stiffness * area[:, None] / part.n_corners)
    return CollisionSurface(
        nodes,
        rest,
        np.asfortranarray(np.concatenate(edges), dtype=np.int32),
        np.asfortranarray(np.concatenate(faces), dtype=np.int32),
        weight,
        np.concatenate(edge_weight),
        thickness,
        body,
        [part.body for part in parts],
    )
