"""The surfaces that links hold nodes to, and the area around nodes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from femdeform.contact.closest import closest_points
from femdeform.fem.discretization import BodyNodes
from femdeform.fem.energies import facet_shapes
from femdeform.fem.node_sets import NodeSets, facet_loads, facet_measure
from femdeform.scene import schema
from femdeform.scene.key_path import KeyPath
from femdeform.scene.selection_schema import Selection
from femdeform.scene.selections import select_facets, select_nodes
from femdeform.types import BoolArray, FloatArray, IntArray, Mesh


class LinkError(Exception):
    """A link that its geometry does not allow: the key to blame, and why."""

    def __init__(self, path: KeyPath, message: str) -> None:
        super().__init__(message)
        self.path = path
        self.message = message


def place_in_words(point: FloatArray) -> str:
    """``(0.5, 0, 1)``."""
    return "(" + ", ".join(f"{c:.4g}" for c in point) + ")"


def surface_facets(
    selection: Selection, scene: schema.DeformableScene, meshes: Mapping[str, Mesh]
) -> dict[str, IntArray]:
    """Facets of a surface by body and points of its mesh: boundary facets of solids, cells of thin bodies."""
    result = {}
    for name, nodes in select_nodes(selection, meshes).items():
        mesh = meshes[name]
        if scene.bodies[name].kind == "solid":
            facets = select_facets(selection, meshes).get(name, np.empty((0, mesh.dim), dtype=np.int64))
        else:
            is_selected = np.zeros(mesh.n_points, dtype=bool)
            is_selected[nodes] = True
            facets = mesh.cells[is_selected[mesh.cells].all(axis=1)]
        if len(facets):
            result[name] = facets
    return result


def node_areas(
    selection: Selection,
    scene: schema.DeformableScene,
    meshes: Mapping[str, Mesh],
    sets: NodeSets,
    counted: BoolArray,
) -> FloatArray:
    """Share of the selected surface that belongs to each node of the whole problem, (n_global,) [m^2].

    Facets count all of whose nodes do (`counted`, (n_global,) bool). A share is that of a constant traction: nothing
    for the corners of quadratic triangles. Rods in space are as wide as the side of a square section; in 2D areas are
    lengths, per unit thickness.
    """
    areas = np.zeros(counted.size)
    for name, facets in surface_facets(selection, scene, meshes).items():
        nodes = sets.facet_nodes(name, facets)
        measure = _measure(scene.bodies[name], meshes[name], facets) * counted[nodes].all(axis=1)
        np.add.at(areas, nodes, measure[:, None] * facet_loads(facets.shape[1], nodes.shape[1]))
    return areas


def facet_samples(
    selection: Selection, scene: schema.DeformableScene, meshes: Mapping[str, Mesh], sets: NodeSets
) -> list[tuple[IntArray, FloatArray, FloatArray]]:
    """Quadrature points of the selected surface, body by body.

    Returns
    -------
    list of (nodes, weights, areas)
        Nodes of the whole problem (n, k), their shape functions at the points (n, k) and the area that belongs to each
        point (n,) [m^2].
    """
    result = []
    for name, facets in surface_facets(selection, scene, meshes).items():
        nodes = sets.facet_nodes(name, facets)
        shapes, _, weights = facet_shapes(facets.shape[1], nodes.shape[1])
        measure = _measure(scene.bodies[name], meshes[name], facets)
        areas = measure[:, None] * (weights / weights.sum())
        n, n_q = areas.shape
        result.append((np.repeat(nodes, n_q, axis=0), np.tile(shapes, (n, 1)), areas.ravel()))
    return result


def _measure(body: schema.Body, mesh: Mesh, facets: IntArray) -> FloatArray:
    measure = facet_measure(mesh.points, facets)
    if isinstance(body, schema.RodBody) and mesh.dim == 3:
        return np.asarray(measure * np.sqrt(body.cross_section))
    return measure


@dataclass(frozen=True)
class Found:
    """Closest points of a surface.

    Attributes
    ----------
    body : (n,) int64
        Number of the body in `HoldingSurface.bodies`.
    facet : (n,) int64
        Facet of that body's part of the surface.
    weights : (n, k) float64
        Barycentric coordinates on the facet; k is the most corners of any, others are padded with zeros.
    distance : (n,) float64
        [m]
    """

    body: IntArray
    facet: IntArray
    weights: FloatArray
    distance: FloatArray

    def select(self, chosen: IntArray) -> Found:
        """Return some of them."""
        return Found(self.body[chosen], self.facet[chosen], self.weights[chosen], self.distance[chosen])


class SurfaceBody:
    """One body's part of a surface.

    Parameters
    ----------
    number : int
    name : str
    mesh : Mesh
    facets : (n, k) int64
        Points of the mesh.
    is_thin : bool
        The facets are the cells of a membrane or a rod.
    first : int
        Number of the body's first node in the whole problem.
    """

    def __init__(self, number: int, name: str, mesh: Mesh, facets: IntArray, is_thin: bool, first: int) -> None:
        self.number = number
        self.name = name
        self.mesh = mesh
        self.facets = facets
        self.is_thin = is_thin
        self.first = first

    def closest(self, points: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """As `closest_points`."""
        return closest_points(points, self.mesh.points[self.facets])

    def edge_lengths(self) -> FloatArray:
        """Lengths of the edges of all facets, those between facets twice [m]."""
        corners = self.mesh.points[self.facets]
        pairs = [(0, 1)] if corners.shape[1] == 2 else [(0, 1), (1, 2), (0, 2)]
        return np.concatenate([np.linalg.norm(corners[:, a] - corners[:, b], axis=1) for a, b in pairs])

    def in_cells(self, found: Found, points: FloatArray, is_kept: bool) -> tuple[IntArray, FloatArray]:
        """Cells and barycentric coordinates of what points are held to.

        Parameters
        ----------
        found : Found
            On this body.
        points : (n, dim) float64
            The points that are held [m].
        is_kept : bool
            Hold each point to the place where it is, as the cell behind the facet goes on beyond its boundary. Thin
            bodies do not go on beyond theirs.

        Returns
        -------
        cells : (n,) int64
        barycentric : (n, n_corners) float64
            [-]
        """
        cells, place = self._parents(found.facet)
        barycentric = np.zeros((len(cells), self.mesh.cells.shape[1]))
        np.put_along_axis(barycentric, place, found.weights[:, : place.shape[1]], axis=1)
        if is_kept and not self.is_thin:
            corners = self.mesh.points[self.mesh.cells[cells]]
            edges = np.swapaxes(corners[:, 1:] - corners[:, :1], 1, 2)
            local = np.linalg.solve(edges, (points - corners[:, 0])[:, :, None])[:, :, 0]
            barycentric = np.concatenate([1.0 - local.sum(axis=1, keepdims=True), local], axis=1)
        return cells, barycentric

    def oriented_facets(self, found: Found, path: KeyPath) -> IntArray:
        """Facets whose normals are the directions of a link, by nodes of the whole problem (n, dim).

        Raises
        ------
        LinkError
            If the body is a rod in space, which has no normal.
        """
        if self.facets.shape[1] != self.mesh.dim:
            message = f"missing; the rod `{self.name}` has no normal in 3D, along which the link could act"
            raise LinkError((*path, "direction"), message)
        return np.asarray(self.first + self.facets[found.facet])

    def _parents(self, chosen: IntArray) -> tuple[IntArray, IntArray]:
        """Cell behind each of some facets, and the place of the facet's corners among those of the cell (n, k)."""
        cells, facets = self.mesh.cells, self.facets[chosen]
        if self.is_thin:
            owner = self._matching(np.sort(facets, axis=1), np.sort(cells, axis=1), np.arange(len(cells)))
        else:
            is_corner = np.zeros(self.mesh.n_points, dtype=bool)
            is_corner[facets] = True
            near = np.flatnonzero(is_corner[cells].sum(axis=1) >= facets.shape[1])
            # Every cell has as many faces as corners, each leaving one of them out.
            faces = np.concatenate([np.delete(cells[near], i, axis=1) for i in range(cells.shape[1])])
            owner = self._matching(np.sort(facets, axis=1), np.sort(faces, axis=1), np.tile(near, cells.shape[1]))
        place = np.argmax(cells[owner][:, None, :] == facets[:, :, None], axis=2)
        return owner, place

    def _matching(self, wanted: IntArray, faces: IntArray, owner: IntArray) -> IntArray:
        """Owner of the face that is each of the wanted ones; rows are sorted."""
        unique, inverse = np.unique(np.concatenate([wanted, faces]), axis=0, return_inverse=True)
        inverse = inverse.ravel()
        of_face = np.full(len(unique), -1, dtype=np.int64)
        of_face[inverse[len(wanted) :]] = owner
        return of_face[inverse[: len(wanted)]]


class HoldingSurface:
    """The surface that a tie or a binding names with `to`.

    Parameters
    ----------
    selection : str or selection model
    scene : DeformableScene
    meshes : mapping of str to Mesh
    numbering : mapping of str to BodyNodes
    path : tuple of str or int
        Key of the selection, for messages.

    Raises
    ------
    LinkError
        If the selection holds no facet.
    """

    def __init__(
        self,
        selection: Selection,
        scene: schema.DeformableScene,
        meshes: Mapping[str, Mesh],
        numbering: Mapping[str, BodyNodes],
        path: KeyPath,
    ) -> None:
        self._path = path
        found = surface_facets(selection, scene, meshes)
        if not found:
            raise LinkError(path, "holds nodes, but no facet of a boundary nor a cell of a membrane or rod")
        self.bodies = [
            SurfaceBody(number, name, meshes[name], facets, scene.bodies[name].kind != "solid", numbering[name].first)
            for number, (name, facets) in enumerate(found.items())
        ]
        self.nodes = np.concatenate([body.first + np.unique(body.facets) for body in self.bodies])
        self.mean_edge = float(np.concatenate([body.edge_lengths() for body in self.bodies]).mean())
        self.size = float(max(np.linalg.norm(np.ptp(body.mesh.points, axis=0)) for body in self.bodies))

    def closest(self, points: FloatArray) -> Found:
        """Closest points of the surface, over all its bodies."""
        widest = max(body.facets.shape[1] for body in self.bodies)
        body = np.zeros(len(points), dtype=np.int64)
        facet = np.zeros_like(body)
        weights = np.zeros((len(points), widest))
        distance = np.full(len(points), np.inf)
        for part in self.bodies:
            at, place, gap = part.closest(points)
            nearer = gap < distance
            body[nearer], facet[nearer], distance[nearer] = part.number, at[nearer], gap[nearer]
            weights[nearer] = 0.0
            weights[nearer, : place.shape[1]] = place[nearer]
        return Found(body, facet, weights, distance)
