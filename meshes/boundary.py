"""Topology of simplex meshes in whole arrays: boundary facets, edges, shared facets, measures."""

from __future__ import annotations

import numpy as np

from femdeform.types import BoolArray, FloatArray, IntArray

# Facets of a cell, each oriented outward when the cell is positively oriented.
_LOCAL_FACETS: dict[int, IntArray] = {
    2: np.array([[0], [1]], dtype=np.int64),
    3: np.array([[0, 1], [1, 2], [2, 0]], dtype=np.int64),
    4: np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]], dtype=np.int64),
}

_LOCAL_EDGES: dict[int, IntArray] = {
    2: np.array([[0, 1]], dtype=np.int64),
    3: np.array([[0, 1], [1, 2], [2, 0]], dtype=np.int64),
    4: np.array([[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]], dtype=np.int64),
}


def row_keys(*rows: IntArray) -> list[IntArray]:
    """Give equal integers to rows with the same nodes in any order.

    Parameters
    ----------
    *rows : (n_i, k) int64
        Arrays of node numbers, -1 or more; their keys can be compared with each other.

    Returns
    -------
    list of (n_i,) int64
        One key a row.
    """
    stacked = np.sort(np.concatenate(rows), axis=1) + 1
    base = int(stacked.max(initial=0)) + 1
    keys = stacked[:, 0].copy()
    for column in range(1, stacked.shape[1]):
        if int(keys.max(initial=0)) + 1 > (2**63 - 1) // base:
            # Ranks are as good as keys and keep the next product within 64 bits.
            keys = np.unique(keys, return_inverse=True)[1].astype(np.int64)
        keys = keys * base + stacked[:, column]
    return np.split(keys, np.cumsum([len(block) for block in rows])[:-1])


def all_facets(cells: IntArray) -> IntArray:
    """Every facet of every cell, cell by cell: (n_cells * k, k - 1), outward for positive cells."""
    k = cells.shape[1]
    return np.ascontiguousarray(cells[:, _LOCAL_FACETS[k]].reshape(-1, k - 1))


def boundary_facets(cells: IntArray, points: FloatArray | None = None) -> IntArray:
    """Facets that belong to exactly one cell.

    Parameters
    ----------
    cells : (n_cells, k) int64
        Nodes of lines, triangles or tetrahedra.
    points : (n_points, dim) float64, optional
        With points, facets of inverted cells (negative volume) point outward too; without, cells are taken to
        be positively oriented.

    Returns
    -------
    (n, k - 1) int64
        In the order of the cells; oriented outward where cells fill their space (tetrahedra in 3D, triangles
        in 2D), else with the orientation of their cell.
    """
    facets = all_facets(cells)
    if not len(facets):
        return facets
    _, first, counts = np.unique(row_keys(facets)[0], return_index=True, return_counts=True)
    rows = np.sort(first[counts == 1])
    outer: IntArray = facets[rows]
    if points is not None and _fills_space(cells, points):
        k = cells.shape[1]
        with np.errstate(all="ignore"):  # points that are not finite are found by `check_mesh`
            inverted = signed_measures(points, cells[rows // k]) < 0.0
        outer[inverted] = outer[inverted][:, ::-1]
    return outer


def facet_counts(cells: IntArray, facets: IntArray) -> IntArray:
    """Number of cells that each of the given facets belongs to, (n_facets,)."""
    of_cells, wanted = row_keys(all_facets(cells), facets)
    of_cells.sort()
    first, last = (np.searchsorted(of_cells, wanted, side) for side in ("left", "right"))
    return np.asarray(last - first, dtype=np.int64)


def find_rows(haystack: IntArray, needles: IntArray) -> IntArray:
    """Index in `haystack` of the row with the nodes, in any order, of each row of `needles`; -1 if none."""
    if not len(haystack):
        return np.full(len(needles), -1, dtype=np.int64)
    keys, wanted = row_keys(haystack, needles)
    order = np.argsort(keys, kind="stable")
    place = np.minimum(np.searchsorted(keys[order], wanted), len(keys) - 1)
    found = order[place]
    return np.where(keys[found] == wanted, found, -1).astype(np.int64)


def unique_edges(cells: IntArray) -> IntArray:
    """Every edge once, (n, 2), smaller node first, in lexicographic order."""
    pairs = cells[:, _LOCAL_EDGES[cells.shape[1]]].reshape(-1, 2)
    low, high = np.minimum(pairs[:, 0], pairs[:, 1]), np.maximum(pairs[:, 0], pairs[:, 1])
    base = int(high.max(initial=0)) + 1
    keys = np.unique(low * base + high)
    return np.stack([keys // base, keys % base], axis=1)


def _fills_space(cells: IntArray, points: FloatArray) -> bool:
    return int(cells.shape[1]) == int(points.shape[1]) + 1


def signed_measures(points: FloatArray, cells: IntArray) -> FloatArray:
    """Volumes of tetrahedra [m^3] or areas of triangles in 2D [m^2], negative where inverted, (n_cells,)."""
    corner = points[cells[:, 0]]
    edges = [points[cells[:, i]] - corner for i in range(1, cells.shape[1])]
    if cells.shape[1] == 4:
        volumes = np.einsum("ni,ni->n", np.cross(edges[0], edges[1]), edges[2]) / 6.0
        return np.asarray(volumes, dtype=np.float64)
    a, b = edges
    return np.asarray(0.5 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]), dtype=np.float64)


def measures(points: FloatArray, cells: IntArray) -> FloatArray:
    """Volumes [m^3], areas [m^2] or lengths [m] of the cells, not negative, (n_cells,)."""
    k = cells.shape[1]
    if k == 1:
        return np.zeros(len(cells))
    if k == 4 or (k == 3 and points.shape[1] == 2):
        return np.abs(signed_measures(points, cells))
    if k == 3:
        return np.asarray(np.linalg.norm(area_vectors(points, cells), axis=1), dtype=np.float64)
    return np.asarray(np.linalg.norm(points[cells[:, 1]] - points[cells[:, 0]], axis=1), dtype=np.float64)


def area_vectors(points: FloatArray, facets: IntArray) -> FloatArray:
    """Normals of facets times their areas: triangles in 3D [m^2] or edges in 2D [m], (n, dim)."""
    corner = points[facets[:, 0]]
    a = points[facets[:, 1]] - corner
    if facets.shape[1] == 2:
        return np.stack([a[:, 1], -a[:, 0]], axis=1)
    return np.asarray(0.5 * np.cross(a, points[facets[:, 2]] - corner), dtype=np.float64)


def edge_lengths_squared(points: FloatArray, cells: IntArray) -> FloatArray:
    """Squared lengths of each cell's edges [m^2], (n_cells, n_edges)."""
    local = _LOCAL_EDGES[cells.shape[1]]
    difference = points[cells[:, local[:, 1]]] - points[cells[:, local[:, 0]]]
    return np.asarray(np.einsum("nei,nei->ne", difference, difference), dtype=np.float64)


def connected_parts(cells: IntArray, n_points: int) -> tuple[int, IntArray]:
    """Number of parts that share no node, and the part of each cell, (n_cells,)."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    pairs = unique_edges(cells)
    ones = np.ones(len(pairs), dtype=np.int8)
    graph = coo_matrix((ones, (pairs[:, 0], pairs[:, 1])), shape=(n_points, n_points))
    _, labels = connected_components(graph, directed=False)
    names, parts = np.unique(labels[cells[:, 0]], return_inverse=True)
    return len(names), parts.astype(np.int64)


def used_nodes(cells: IntArray, n_points: int) -> BoolArray:
    """Which points belong to a cell, (n_points,)."""
    used = np.zeros(n_points, dtype=np.bool_)
    used[cells] = True
    return used
