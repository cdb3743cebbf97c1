"""The visible part of a mesh: boundary faces, lines, element edges, and the sharp edges that outline a body.

All of it is found once, on the reference mesh, as indices into the points of a frame; a frame of an
animation then only moves points. Quadratic faces become four flat triangles each.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from femdeform.types import FloatArray, IntArray

# Corners, then mid nodes 01, 12, 20 of each face of a tetrahedron, outward; quadratic numbering as in VTK.
_TETRA_FACES = np.array(
    [[1, 2, 3, 5, 9, 8], [0, 3, 2, 7, 9, 6], [0, 1, 3, 4, 8, 7], [0, 2, 1, 6, 5, 4]], dtype=np.int64
)
_QUADRATIC_FACE = np.array([[0, 3, 5], [3, 1, 4], [5, 4, 2], [3, 4, 5]], dtype=np.int64)
_QUADRATIC_EDGES = np.array([[0, 3], [3, 1], [1, 4], [4, 2], [2, 5], [5, 0]], dtype=np.int64)
_EDGES = np.array([[0, 1], [1, 2], [2, 0]], dtype=np.int64)

SHARP_ANGLE = 30.0  # [deg] between the normals of two faces


@dataclass(frozen=True)
class Part:
    """Cells over some of the points of a frame.

    Attributes
    ----------
    nodes : (n,) int64
        Point of the frame behind each node of the part; a point may occur several times.
    cells : (m, k) int64
        Nodes of the part, not points of the frame.
    """

    nodes: IntArray
    cells: IntArray

    @classmethod
    def of(cls, cells: IntArray) -> Part:
        """The part that some cells, given by the points of the frame, make up."""
        nodes, inverse = np.unique(cells, return_inverse=True)
        return cls(nodes.astype(np.int64), inverse.reshape(cells.shape).astype(np.int64))


@dataclass(frozen=True)
class Surface:
    """What one sees of a mesh.

    Attributes
    ----------
    faces : Part
        Triangles, outward for solids. Nodes are doubled along sharp edges, so that normals averaged at the
        nodes shade smoothly within a face of the body and not around its edges.
    face_cells : (n_faces,) int64
        Cell of the mesh each triangle belongs to, counted over all blocks.
    lines : Part
        Line elements.
    line_cells : (n_lines,) int64
        Cell of each line.
    edges : Part
        Edges of the elements on the surface.
    outline : Part
        Sharp and open edges of the reference shape.
    """

    faces: Part
    face_cells: IntArray
    lines: Part
    line_cells: IntArray
    edges: Part
    outline: Part

    @property
    def n_faces(self) -> int:
        """Number of triangles."""
        return len(self.faces.cells)

    @property
    def nodes(self) -> IntArray:
        """Points of the frame that are visible at all."""
        return np.union1d(self.faces.nodes, self.lines.nodes)


def extract_surface(points: FloatArray, blocks: Sequence[tuple[str, IntArray]]) -> Surface:
    """Find the surface of a mesh.

    Parameters
    ----------
    points : (n_points, 3) float64
        Reference positions [m].
    blocks : list of (name, (n_cells, k) int64)
        Cells as in `femdeform.run.vtu.FrameMesh`.
    """
    starts = np.cumsum([0, *(len(cells) for _, cells in blocks)])
    empty = [np.zeros((0, 3), np.int64), np.zeros((0, 2), np.int64), np.zeros(0, np.int64)]
    triangles, edges, owners = [empty[0]], [empty[1]], [empty[2]]
    lines, line_owners = [empty[1]], [empty[2]]

    numbered = list(zip(blocks, starts, strict=False))
    solid = [(cells, start) for (name, cells), start in numbered if name in ("tetra", "tetra10")]
    faces = _boundary_faces(solid)
    for (name, cells), start in numbered:
        if name in ("triangle", "triangle6"):
            faces.append((cells, start + np.arange(len(cells))))
        elif name == "line":
            lines.append(cells)
            line_owners.append(start + np.arange(len(cells)))
    for face, owner in faces:
        quadratic = face.shape[1] == 6
        split, sides = (_QUADRATIC_FACE, _QUADRATIC_EDGES) if quadratic else (np.arange(3)[None], _EDGES)
        triangles.append(face[:, split].reshape(-1, 3))
        owners.append(np.repeat(owner, len(split)))
        edges.append(face[:, sides].reshape(-1, 2))

    all_triangles = np.concatenate(triangles)
    nodes, corners, outline = _split_at_sharp_edges(points, all_triangles)
    return Surface(
        faces=Part(nodes, corners),
        face_cells=np.concatenate(owners),
        lines=Part.of(np.concatenate(lines)),
        line_cells=np.concatenate(line_owners),
        edges=Part.of(_unique_edges(np.concatenate(edges))),
        outline=Part.of(outline),
    )


def vertex_normals(positions: FloatArray, triangles: IntArray) -> FloatArray:
    """Unit normals at the nodes: the mean of the triangles around, weighted by area; zero where none are.

    Parameters
    ----------
    positions : (n, 3) float64
        Positions of the nodes.
    triangles : (m, 3) int64
        Nodes of each triangle.
    """
    normals = np.repeat(_area_vectors(positions, triangles), 3, axis=0)
    corners = triangles.ravel()
    total = np.stack([np.bincount(corners, normals[:, c], len(positions)) for c in range(3)], axis=1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.asarray(total / np.where(length > 0.0, length, 1.0), dtype=np.float64)


def coarsen(points: FloatArray, faces: Part, max_triangles: int) -> tuple[Part, IntArray]:
    """Thin out triangles until there are at most `max_triangles`, by merging the nodes in cells of a grid.

    Every node kept is a node of the original, so that any field of any frame can be shown on the result.

    Parameters
    ----------
    points : (n_points, 3) float64
        Reference positions [m].
    faces : Part
        Triangles.
    max_triangles : int
        Upper bound.

    Returns
    -------
    Part, (n_faces,) int64
        The thinned triangles, and the original triangle behind each.
    """
    kept = np.arange(len(faces.cells))
    coarse = faces
    low, high = points[faces.nodes].min(axis=0), points[faces.nodes].max(axis=0)
    # On a surface the number of triangles falls with the square of the size of the grid's cells.
    size = float(np.max(high - low)) / np.sqrt(max(max_triangles, 1))
    while len(coarse.cells) > max_triangles:
        coarse, kept = _merge_nodes(points, faces, low, size)
        size *= 1.25
    return coarse, kept


def _merge_nodes(points: FloatArray, faces: Part, low: FloatArray, size: float) -> tuple[Part, IntArray]:
    bins = np.floor((points[faces.nodes] - low) / size).astype(np.int64)
    _, first, cluster = np.unique(bins, axis=0, return_index=True, return_inverse=True)
    triangles = cluster.reshape(-1)[faces.cells]
    a, b, c = triangles.T
    whole = np.flatnonzero((a != b) & (b != c) & (c != a))
    _, unique = np.unique(np.sort(triangles[whole], axis=1), axis=0, return_index=True)
    kept = whole[np.sort(unique)]
    part = Part.of(triangles[kept])
    return Part(faces.nodes[first[part.nodes]], part.cells), kept


def _boundary_faces(solid: list[tuple[IntArray, int]]) -> list[tuple[IntArray, IntArray]]:
    """Faces that only one tetrahedron has, as (faces, cells) per block; mid nodes go along."""
    if not solid:
        return []
    blocks = [cells[:, _TETRA_FACES[:, : 3 if cells.shape[1] == 4 else 6]] for cells, _ in solid]
    blocks = [faces.reshape(-1, faces.shape[2]) for faces in blocks]
    keys = _row_keys(np.concatenate([np.sort(faces[:, :3], axis=1) for faces in blocks]))
    order = np.argsort(keys, kind="stable")
    repeated = keys[order][1:] == keys[order][:-1]
    alone = np.ones(len(keys), dtype=np.bool_)
    alone[order[1:][repeated]] = False
    alone[order[:-1][repeated]] = False
    found = []
    offset = 0
    for faces, (_, start) in zip(blocks, solid, strict=True):
        mask = alone[offset : offset + len(faces)]
        found.append((faces[mask], start + np.flatnonzero(mask) // 4))
        offset += len(faces)
    return found


def _split_at_sharp_edges(points: FloatArray, triangles: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Double the nodes along sharp edges.

    Returns the point behind each new node, the triangles in new nodes, and the sharp or open edges by points.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n_triangles = len(triangles)
    if n_triangles == 0:
        return np.zeros(0, np.int64), np.zeros((0, 3), np.int64), np.zeros((0, 2), np.int64)
    normals = _area_vectors(points, triangles)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals / np.where(length > 0.0, length, 1.0)

    # Row 3 t + k is edge k of triangle t, from corner k to corner k + 1; sorted, equal edges lie together.
    sides = triangles[:, _EDGES].reshape(-1, 2)
    keys = _row_keys(np.sort(sides, axis=1))
    order = np.argsort(keys, kind="stable")
    _, starts, counts = np.unique(keys[order], return_index=True, return_counts=True)
    first, second = order[starts[counts == 2]], order[starts[counts == 2] + 1]
    cosine = np.einsum("ij,ij->i", normals[first // 3], normals[second // 3])
    opposite = sides[first, 0] == sides[second, 1]
    # Two triangles that run along their edge in the same direction have different ideas of up (it happens in
    # membranes): such an edge is no edge of the shape, but their normals must not be averaged either.
    flat = np.where(opposite, cosine, -cosine) > np.cos(np.radians(SHARP_ANGLE))
    outline = np.concatenate([sides[order[starts[counts != 2]]], sides[first[~flat]]])

    # Corners that meet across a smooth edge are one node: corner k of side 3 t + k is where the side starts.
    first, second = first[flat & opposite], second[flat & opposite]
    rows = np.concatenate([first, _next_corner(first)])
    columns = np.concatenate([_next_corner(second), second])
    n_corners = 3 * n_triangles
    graph = coo_array((np.ones(len(rows), np.int8), (rows, columns)), shape=(n_corners, n_corners))
    n_nodes, label = connected_components(graph, directed=False)
    nodes = np.zeros(n_nodes, dtype=np.int64)
    nodes[label] = triangles.ravel()
    return nodes, label.reshape(-1, 3).astype(np.int64), outline


def _next_corner(side: IntArray) -> IntArray:
    return np.asarray(side - side % 3 + (side % 3 + 1) % 3, dtype=np.int64)


def _area_vectors(positions: FloatArray, triangles: IntArray) -> FloatArray:
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    return np.asarray(np.cross(b - a, c - a), dtype=np.float64)


def _unique_edges(edges: IntArray) -> IntArray:
    _, first = np.unique(_row_keys(np.sort(edges, axis=1)), return_index=True)
    return edges[first]


def _row_keys(rows: IntArray) -> NDArray[np.int64]:
    """One number for each row, equal for equal rows."""
    if len(rows) == 0:
        return np.zeros(0, dtype=np.int64)
    base = int(rows.max()) + 1
    if base ** rows.shape[1] < 2**63:
        weights = base ** np.arange(rows.shape[1], dtype=np.int64)
        return np.asarray(rows @ weights, dtype=np.int64)
    return np.asarray(np.unique(rows, axis=0, return_inverse=True)[1], dtype=np.int64).reshape(-1)
