"""From what a scene selects (points and facets of meshes) to nodes of the whole problem, mid-edge nodes included."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from femdeform.fem.discretization import EDGES, BodyNodes, Discretization
from femdeform.types import BoolArray, FloatArray, IntArray, Mesh


class NodeSets:
    """Nodes and facets of the bodies of a scene, in the numbering of the whole problem.

    Parameters
    ----------
    meshes : mapping of str to Mesh
    bodies : mapping of str to BodyNodes
        As in `Discretization.bodies`.
    """

    def __init__(self, meshes: Mapping[str, Mesh], bodies: Mapping[str, BodyNodes]) -> None:
        self.meshes = meshes
        self.bodies = bodies
        self._edges: dict[str, tuple[IntArray, IntArray]] = {}

    def _edge_nodes(self, body: str) -> tuple[IntArray, IntArray]:
        """Sorted keys of a quadratic body's edges and the mid-edge node (in the body) of each."""
        if body not in self._edges:
            mesh, nodes = self.meshes[body], self.bodies[body]
            pairs = np.array(EDGES[mesh.cell_type])
            edges = np.sort(nodes.connectivity[:, pairs], axis=2)
            key = (edges[..., 0] * mesh.n_points + edges[..., 1]).ravel()
            unique, first = np.unique(key, return_index=True)
            self._edges[body] = unique, nodes.connectivity[:, mesh.cells.shape[1] :].ravel()[first]
        return self._edges[body]

    def _middle(self, body: str, edges: IntArray) -> IntArray:
        keys, nodes = self._edge_nodes(body)
        pair = np.sort(edges, axis=-1)
        return nodes[np.searchsorted(keys, pair[..., 0] * self.meshes[body].n_points + pair[..., 1])]

    def is_quadratic(self, body: str) -> bool:
        """Whether the body has mid-edge nodes."""
        return self.bodies[body].n_nodes > self.bodies[body].n_vertices

    def from_points(self, body: str, points: IntArray) -> IntArray:
        """Nodes of the whole problem for points of a mesh, with the mid-edge nodes between two of them."""
        first = self.bodies[body].first
        if not self.is_quadratic(body):
            return first + points
        n = self.meshes[body].n_points
        chosen = np.zeros(n, dtype=bool)
        chosen[points] = True
        keys, middle = self._edge_nodes(body)
        between = middle[chosen[keys // n] & chosen[keys % n]]
        return first + np.concatenate([points, between])

    def from_facets(self, body: str, facets: IntArray) -> IntArray:
        """Nodes of the whole problem on facets, given by their points (n, k)."""
        return np.unique(self.facet_nodes(body, facets))

    def facet_nodes(self, body: str, facets: IntArray) -> IntArray:
        """Facets (n, k) by points to facets (n, k or 2k) by nodes of the whole problem, mid-edge nodes last."""
        first = self.bodies[body].first
        if not self.is_quadratic(body):
            return first + facets
        k = facets.shape[1]
        pairs = [(0, 1)] if k == 2 else EDGES["triangle"]
        middle = np.stack([self._middle(body, facets[:, list(pair)]) for pair in pairs], axis=1)
        return first + np.concatenate([facets, middle], axis=1)


def holds_facets(discretization: Discretization, body: str, mesh: Mesh, facets: IntArray) -> BoolArray:
    """Which boundary facets belong to a cell of this rank: each to exactly one rank, as it has one cell.

    Facets with as many corners as a cell are cells themselves, those of membranes and rods.
    """
    groups = [g.cell_ids for g in discretization.groups if g.body == body]
    if not groups:
        return np.zeros(len(facets), dtype=bool)
    cells = mesh.cells[np.concatenate(groups)]
    if facets.shape[1] < cells.shape[1]:
        cells = np.concatenate([np.delete(cells, k, axis=1) for k in range(cells.shape[1])])
    scale = mesh.n_points ** np.arange(facets.shape[1])
    return np.isin(np.sort(facets, axis=1) @ scale, np.sort(cells, axis=1) @ scale)


def facet_measure(points: FloatArray, facets: IntArray) -> FloatArray:
    """Length (2D, or edges in 3D) or area of facets by their corner points, (n,)."""
    corners = points[facets]
    if facets.shape[1] == 1:
        return np.ones(len(facets))
    if facets.shape[1] == 2:
        return np.asarray(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1))
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return 0.5 * np.asarray(np.linalg.norm(normal, axis=1))


# Integral of the shape functions over a facet of unit measure, by number of nodes:
# a point, P1 edge, P2 edge, P1 triangle, P2 triangle.
FACET_LOADS: dict[int, FloatArray] = {
    1: np.array([1.0]),
    2: np.array([1.0, 1.0]) / 2.0,
    3: np.array([1.0, 1.0, 1.0]) / 3.0,
    6: np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]) / 3.0,
}
QUADRATIC_EDGE_LOADS: FloatArray = np.array([1.0, 1.0, 4.0]) / 6.0


def facet_loads(n_corners: int, n_nodes: int) -> FloatArray:
    """Share of a facet's measure that each of its nodes carries under a constant load (n_nodes,)."""
    if n_corners == 2 and n_nodes == 3:
        return QUADRATIC_EDGE_LOADS
    return FACET_LOADS[n_nodes]
