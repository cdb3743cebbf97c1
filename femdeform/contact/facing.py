"""How much of the surface around each node faces an obstacle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from femdeform.parallel import Partition
from femdeform.types import FloatArray, IntArray

# Part of a facet that counts however it is turned: the tip of a spike must not fall through.
_LEAST = 0.05


@dataclass(frozen=True)
class FacetShares:
    """Facets of one body's surface, each seen by exactly one rank.

    Attributes
    ----------
    facets : (n, k) int64
        Local nodes, corners first.
    n_corners : int
        2 or 3.
    share : (n,) float64
        What every node of a facet that lies flat on an obstacle gets of it: stiffness per area times area over k [N/m].
    is_closed : bool
        Whether the facets bound a solid, oriented outward; sheets and lines have an obstacle on either side.
    """

    facets: IntArray
    n_corners: int
    share: FloatArray
    is_closed: bool

    def facing(self, x: FloatArray, normals: FloatArray) -> FloatArray:
        """Cosine between facets and the obstacle below each of their nodes, (n, k), at least a small positive one.

        Parameters
        ----------
        x : (n_local, dim) float64
            Positions [m].
        normals : (n_local, dim) float64
            Unit normals of the obstacle at the nodes, towards the free side.
        """
        corners = x[self.facets[:, : self.n_corners]]
        along = corners[:, 1] - corners[:, 0]
        toward = normals[self.facets]
        dim = x.shape[1]
        if dim == 3 and self.n_corners == 2:
            cosine = np.einsum("fc,fkc->fk", _unit(along), toward)
            return np.asarray(np.maximum(np.sqrt(np.maximum(1.0 - cosine**2, 0.0)), _LEAST))
        if dim == 2:
            normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
        else:
            normal = np.cross(along, corners[:, 2] - corners[:, 0])
        cosine = -np.einsum("fc,fkc->fk", _unit(normal), toward)
        return np.asarray(np.maximum(cosine if self.is_closed else np.abs(cosine), _LEAST))


def _unit(vectors: FloatArray) -> FloatArray:
    """Vectors over their lengths; zero stays zero."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0.0, length, 1.0))


class FacingStiffness:
    """Stiffness of nodes by the part of the surface that faces an obstacle.

    A node at the lower edge of a block that stands on the ground has a share of the bottom, none of the side faces.

    Parameters
    ----------
    parts : sequence of FacetShares
        Surfaces of the bodies, as far as this rank holds their cells.
    nodes : (m,) int64
        Owned local nodes to give stiffnesses of.
    partition : Partition
    """

    def __init__(self, parts: Sequence[FacetShares], nodes: IntArray, partition: Partition) -> None:
        self._parts = list(parts)
        self._nodes = nodes
        self._partition = partition

    def __call__(self, x: FloatArray, normals: FloatArray) -> FloatArray:
        """Stiffness of the nodes (m,) [N/m] at positions, see `FacetShares.facing`; collective over the ranks."""
        total = np.zeros((len(x), 1))
        for part in self._parts:
            np.add.at(total[:, 0], part.facets, part.share[:, None] * part.facing(x, normals))
        self._partition.accumulate(total)
        return np.asarray(total[self._nodes, 0])
