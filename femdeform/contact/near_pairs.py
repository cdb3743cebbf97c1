"""Vertices of a surface that are near another part of it, each with its closest point there.

Broad phase by ipctk's bounding volume hierarchy, over the way from the present positions to expected ones; the rest is
vectorised. Pairs come in a fixed order: by vertex, then by body.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.contact.closest import closest_weights
from femdeform.contact.ipc import make_collision_mesh
from femdeform.contact.surface import CollisionSurface
from femdeform.contact.weak_constraints import facet_normals
from femdeform.types import BoolArray, FloatArray, IntArray

# A vertex may touch facets that look against it. At a right-angled edge or corner of its own surface its normal has at
# least 0.57 along each side, so a block that stands flush on another one does not touch the sides of that.
_FACING = 0.4
# Distances that differ by less, in mean edges, are equal; directions of shorter ones are rounding.
_EQUAL, _TINY = 1e-9, 1e-6
# A vertex is inside of its own body where it is so much nearer to a facet, seen from inside, than at rest: a wall that
# is only pressed together is not.
_SQUEEZED = 0.25


@dataclass(frozen=True)
class NearPairs:
    """Vertices with the closest point of another surface.

    Attributes
    ----------
    vertices : (n,) int64
        Vertices of the surface, ascending.
    corners : (n, dim) int64
        Vertices of the facet that the closest point is on.
    weights : (n, dim) float64
        Its barycentric coordinates [-].
    normals : (n, dim) float64
        Unit vectors out of the surface there.
    distance : (n,) float64
        From the surface, negative inside [m].
    """

    vertices: IntArray
    corners: IntArray
    weights: FloatArray
    normals: FloatArray
    distance: FloatArray


class NearPairSearch:
    """Looks for vertices near other bodies, or near other parts of their own.

    Parameters
    ----------
    surface : CollisionSurface
        Boundaries of solids, facets oriented outward.
    may_touch : (n_bodies, n_bodies) bool
        Symmetric; the diagonal says whether a body may touch itself.
    reach : float
        Distance up to which pairs are looked for [m].

    Raises
    ------
    MissingDependencyError
        If ipctk cannot be imported.

    Limitations
    -----------
    Serial. One pair a vertex and body: a vertex in a corner of another body is held by the nearer side. Edges that
    cross without a vertex inside are not seen. A vertex deeper inside than `reach` is not either; in a body thinner
    than twice its depth it is on the other side.
    """

    def __init__(self, surface: CollisionSurface, may_touch: BoolArray, reach: float) -> None:
        self.surface = surface
        self.reach = reach
        self._mesh = make_collision_mesh(surface, may_touch)
        import ipctk

        self._broad_phase = ipctk.LBVH()
        self._broad_phase.can_vertices_collide = self._mesh.can_collide
        self._facets = np.ascontiguousarray(surface.edges if surface.dim == 2 else surface.faces, dtype=np.int64)
        self._mean_edge = float(surface.edge_lengths().mean())
        n = len(surface.rest)
        pairs = surface.edges.astype(np.int64)
        self._linked = np.unique(np.concatenate([pairs[:, 0] * n + pairs[:, 1], pairs[:, 1] * n + pairs[:, 0]]))
        if surface.dim == 3:
            sides = np.sort(self._facets[:, [[0, 1], [1, 2], [0, 2]]], axis=2)
            _, inverse = np.unique(sides.reshape(-1, 2), axis=0, return_inverse=True)
            self._sides = inverse.reshape(-1, 3)

    def __call__(self, start: FloatArray, end: FloatArray) -> NearPairs:
        """Pairs that are within reach, or that would be if all vertices moved straight to their expected places.

        Parameters
        ----------
        start, end : (n_vertices, dim) float64
            Present and expected positions [m].
        """
        vertex, facet = self._candidates(start, end)
        normals = facet_normals(start[self._facets])
        own = self._vertex_normals(start, normals)
        weights = closest_weights(start[vertex], start[self._facets[facet]])
        away = start[vertex] - np.einsum("nk,nkc->nc", weights, start[self._facets[facet]])
        size = np.linalg.norm(away, axis=1)
        outward = self._outward(weights, facet, normals, own)
        inside = np.einsum("nc,nc->n", away, outward) < 0.0
        body = self.surface.body[self._facets[facet, 0]]
        allowed = ~inside | (size <= self.reach)
        same = np.flatnonzero(body == self.surface.body[vertex])
        allowed[same] &= self._not_neighbours(vertex[same], facet[same], size[same], inside[same])

        # The nearest facet of a body, whichever way it looks, tells on which side of its surface a vertex is.
        rank = np.rint(size / (_EQUAL * self._mean_edge))
        key = vertex * (int(self.surface.body.max(initial=0)) + 1) + body
        order = np.lexsort((facet, rank, key))
        order = order[allowed[order]]
        nearest = order[np.flatnonzero(np.diff(key[order], prepend=-1))]
        facing = np.einsum("nc,nc->n", own[vertex], normals[facet])
        fits = allowed & (facing < _FACING * np.linalg.norm(own[vertex], axis=1))
        if nearest.size:
            teller = nearest[np.minimum(np.searchsorted(key[nearest], key), nearest.size - 1)]
            fits &= (inside == inside[teller]) | (size[teller] <= _TINY * self._mean_edge)
        # It is held by the nearest facet that looks against it; of equal ones by that which does so most.
        order = np.lexsort((facet, facing, rank, key))
        order = order[fits[order]]
        chosen = order[np.flatnonzero(np.diff(key[order], prepend=-1))]

        vertex, facet, weights, away = vertex[chosen], facet[chosen], weights[chosen], away[chosen]
        size, sign = size[chosen], np.where(inside[chosen], -1.0, 1.0)
        # On a face, and where the vertex lies on the surface, the normal is the facet's; else the line between them.
        flat = (weights > 0.0).all(axis=1) | (size <= _TINY * self._mean_edge)
        direction = np.where(flat[:, None], normals[facet], (sign / np.where(flat, 1.0, size))[:, None] * away)
        corners = self._facets[facet]
        moved = end[vertex] - np.einsum("nk,nkc->nc", weights, end[corners])
        near = (size <= self.reach) | (np.einsum("nc,nc->n", direction, moved) <= self.reach)
        return NearPairs(vertex[near], corners[near], weights[near], direction[near], (sign * size)[near])

    def _candidates(self, start: FloatArray, end: FloatArray) -> tuple[IntArray, IntArray]:
        """Vertices and facets whose boxes around the way come near each other."""
        tree = self._broad_phase
        ends = (np.asfortranarray(start), np.asfortranarray(end))
        # Boxes of both are inflated.
        tree.build(*ends, self._mesh.edges, self._mesh.faces, 0.5 * self.reach)
        found: list[Any]
        if self.surface.dim == 2:
            found = tree.detect_edge_vertex_candidates()
            facet = np.fromiter((pair.edge_id for pair in found), dtype=np.int64, count=len(found))
        else:
            found = tree.detect_face_vertex_candidates()
            facet = np.fromiter((pair.face_id for pair in found), dtype=np.int64, count=len(found))
        vertex = np.fromiter((pair.vertex_id for pair in found), dtype=np.int64, count=len(found))
        tree.clear()
        return vertex, facet

    def _vertex_normals(self, x: FloatArray, normals: FloatArray) -> FloatArray:
        """Sums of the facets' normals around each vertex, weighted by their angles there (n_vertices, dim)."""
        total = np.zeros_like(x)
        for k in range(self.surface.dim):
            weight = np.ones(len(self._facets))
            if self.surface.dim == 3:
                here = x[self._facets[:, k]]
                a, b = (x[self._facets[:, (k + j) % 3]] - here for j in (1, 2))
                cross = np.linalg.norm(np.cross(a, b), axis=1)
                weight = np.arctan2(cross, np.einsum("nc,nc->n", a, b))
            for c in range(self.surface.dim):
                total[:, c] += np.bincount(self._facets[:, k], weight * normals[:, c], minlength=len(x))
        return total

    def _outward(self, weights: FloatArray, facet: IntArray, normals: FloatArray, own: FloatArray) -> FloatArray:
        """Vectors that tell inside from outside at closest points: of a face, else of the edge or the vertex.

        References
        ----------
        J. A. Baerentzen, H. Aanaes, Signed distance computation using the angle weighted pseudonormal (2005).
        """
        result = np.array(normals[facet])
        held = weights > 0.0
        count = held.sum(axis=1)
        if self.surface.dim == 3:
            on_edge = np.flatnonzero(count == 2)
            total = np.zeros((int(self._sides.max(initial=-1)) + 1, 3))
            for c in range(3):
                total[:, c] = np.bincount(self._sides.ravel(), np.repeat(normals[:, c], 3), minlength=len(total))
            # Sides are (0, 1), (1, 2), (0, 2): opposite to the corners 2, 0, 1.
            side = np.array([1, 2, 0])[np.argmin(held[on_edge], axis=1)]
            result[on_edge] = total[self._sides[facet[on_edge], side]]
        at_vertex = np.flatnonzero(count == 1)
        corner = np.argmax(held[at_vertex], axis=1)
        result[at_vertex] = own[self._facets[facet[at_vertex], corner]]
        return result

    def _not_neighbours(self, vertex: IntArray, facet: IntArray, size: FloatArray, inside: BoolArray) -> BoolArray:
        """Which pairs of one body are no neighbours at rest, nor the two sides of a wall."""
        rest, n = self.surface.rest, len(self.surface.rest)
        corners = self._facets[facet]
        linked = np.isin(vertex[:, None] * n + corners, self._linked).any(axis=1)
        weights = closest_weights(rest[vertex], rest[corners])
        apart = np.linalg.norm(np.einsum("nk,nkc->nc", weights, rest[corners]) - rest[vertex], axis=1)
        return np.asarray(~linked & (apart > self.reach) & ~(inside & (size > _SQUEEZED * apart)))
