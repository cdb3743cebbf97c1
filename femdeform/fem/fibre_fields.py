"""Directions of muscle fibres in the cells of a mesh: constant, from the mesh file, or along a harmonic field."""

from __future__ import annotations

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph

from femdeform.errors import InputError
from femdeform.fem.discretization import harmonic_values
from femdeform.types import BoolArray, FloatArray, IntArray, Mesh

# A gradient below this part of the largest one is none.
_FLAT = 1e-6


def constant_directions(direction: tuple[float, ...], n_cells: int) -> FloatArray:
    """The same unit direction for every cell, (n_cells, dim)."""
    v = np.array(direction) / np.linalg.norm(direction)
    return np.tile(v, (n_cells, 1))


def stored_directions(mesh: Mesh, name: str, cells: IntArray) -> FloatArray:
    """Unit directions of cells from the cell data of a mesh, (n, dim).

    Raises
    ------
    InputError
        If there is no such data, or no direction in a cell.
    """
    if name not in mesh.cell_data:
        known = ", ".join(sorted(mesh.cell_data)) or "none"
        raise InputError(f"the mesh has no cell data `{name}` (there are: {known})")
    vectors = mesh.cell_data[name][cells]
    if vectors.ndim != 2 or vectors.shape[1] != mesh.dim:
        raise InputError(f"cell data `{name}` has the shape {vectors.shape}, not ({len(cells)}, {mesh.dim})")
    length = np.linalg.norm(vectors, axis=1)
    bad = np.flatnonzero(~(np.isfinite(length) & (length > 0.0)))
    if bad.size:
        raise InputError(f"cell data `{name}` has no direction in {bad.size} cells, the first is cell {cells[bad[0]]}")
    return np.asarray(vectors / length[:, None])


def harmonic_directions(mesh: Mesh, cells: IntArray, origin: IntArray, insertion: IntArray) -> FloatArray:
    """Directions along the gradient of a harmonic function from 0 at the origin to 1 at the insertion.

    The function is that of linear elements on these cells alone. Where all nodes of a cell belong to one end it has
    no gradient: such cells take the volume-weighted mean of those around them.

    Parameters
    ----------
    mesh : Mesh
        Triangles in 2D or tetrahedra.
    cells : (n,) int64
        Cells of the muscle.
    origin, insertion : (n_nodes,) int64
        Nodes of the mesh; those that no cell of the muscle has do not count.

    Returns
    -------
    (n, dim) float64
        Unit directions.

    Raises
    ------
    InputError
        If an end has no node in the muscle, both share nodes, a part of the muscle does not reach from one to the
        other, or the gradient vanishes in a cell between them.
    """
    nodes, corners = np.unique(mesh.cells[cells], return_inverse=True)
    corners = corners.reshape(-1, mesh.cells.shape[1])
    low, high = np.isin(nodes, origin), np.isin(nodes, insertion)
    for name, is_end in (("origin", low), ("insertion", high)):
        if not is_end.any():
            raise InputError(f"{name}: none of its nodes belongs to the muscle")
    if (low & high).any():
        raise InputError(f"insertion: shares {np.count_nonzero(low & high)} nodes of the muscle with the origin")
    _check_connected(corners, low, high)
    values = harmonic_values(mesh.points[nodes], corners, low, high)
    edges = mesh.points[mesh.cells[cells]]
    edges = edges[:, 1:] - edges[:, :1]
    rises = values[corners[:, 1:]] - values[corners[:, :1]]
    gradients = np.linalg.solve(edges, rises[..., None])[..., 0]
    length = np.linalg.norm(gradients, axis=1)
    flat = length <= _FLAT * float(length.max())
    at_end = low[corners].all(axis=1) | high[corners].all(axis=1)
    _check_gradient(flat & ~at_end, cells)
    directions = np.where(flat[:, None], 0.0, gradients / np.where(flat, 1.0, length)[:, None])
    return _filled(directions, flat, corners, np.abs(np.linalg.det(edges)), cells)


def _check_gradient(bad: BoolArray, cells: IntArray) -> None:
    if bad.any():
        raise InputError(
            f"the gradient of the harmonic field vanishes in {np.count_nonzero(bad)} cells, the first is cell "
            f"{cells[int(np.argmax(bad))]}; choose other ends, or give directions by `kind: cell_data`"
        )


def _check_connected(corners: IntArray, low: BoolArray, high: BoolArray) -> None:
    """Every connected part has to have nodes of both ends: without, the function is constant there."""
    n = low.size
    first = np.repeat(corners[:, 0], corners.shape[1] - 1)
    graph = scipy.sparse.csr_matrix((np.ones(first.size), (first, corners[:, 1:].ravel())), shape=(n, n))
    n_parts, part = scipy.sparse.csgraph.connected_components(graph, directed=False)
    for name, is_end in (("origin", low), ("insertion", high)):
        missing = n_parts - np.unique(part[is_end]).size
        if missing:
            raise InputError(f"{name}: {missing} of {n_parts} unconnected parts of the muscle have no node of it")


def _filled(
    directions: FloatArray, flat: BoolArray, corners: IntArray, sizes: FloatArray, cells: IntArray
) -> FloatArray:
    """Directions with those of `flat` cells taken from around them, layer by layer."""
    flat = flat.copy()
    while flat.any():
        n = int(corners.max()) + 1
        at_nodes = np.zeros((n, directions.shape[1]))
        known = ~flat
        weighted = (sizes[known, None] * directions[known]).repeat(corners.shape[1], axis=0)
        np.add.at(at_nodes, corners[known].ravel(), weighted)
        found = at_nodes[corners[flat]].sum(axis=1)
        length = np.linalg.norm(found, axis=1)
        reached = length > 0.0
        if not reached.any():
            _check_gradient(flat, cells)
        rows = np.flatnonzero(flat)[reached]
        directions[rows] = found[reached] / length[reached, None]
        flat[rows] = False
    return directions
