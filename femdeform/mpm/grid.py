"""A background grid of which only the nodes near points exist."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.mpm import kernels, stencil_kernels
from femdeform.types import FloatArray, IntArray

# Degrees of the B-splines by their words.
DEGREES = {"linear": 1, "quadratic": 2}
# Parts of the points that are listed at the same time; a constant, so that nothing depends on the threads.
_PARTS = 8
# Nodes of a box around all points that are numbered one by one; in larger and emptier ones, only those near points.
_SMALL_BOX = 1_000_000


@dataclass(frozen=True)
class Stencils:
    """Active nodes of a grid, and which of them each point weighs how much.

    Attributes
    ----------
    spacing : float
        Distance of the nodes [m].
    degree : int
        1: linear, 2: quadratic B-splines.
    positions : (n_nodes, dim) float64
        Positions of the nodes [m], in lexicographic order.
    nodes : (n_points, n_stencil) int32
        Active nodes of each point; any where the weight is zero.
    weights : (n_points, n_stencil) float64
        Weights w, which add up to one.
    gradients : (n_points, n_stencil, dim) float64
        Their gradients [1/m].
    offsets : (n_nodes + 1,) int64
        First entry of each node.
    entries : (n_entries,) int64
        Points of each node in ascending order, as ``point n_stencil + place in its stencil``; weights are positive.
    """

    spacing: float
    degree: int
    positions: FloatArray
    nodes: np.ndarray[Any, np.dtype[np.int32]]
    weights: FloatArray
    gradients: FloatArray
    offsets: IntArray
    entries: IntArray

    @property
    def n_nodes(self) -> int:
        """Number of active nodes."""
        return int(self.positions.shape[0])

    def to_points(self, field: FloatArray) -> FloatArray:
        """Interpolate a field of the nodes (n_nodes, k): W field, (n_points, k)."""
        out = np.empty((len(self.weights), field.shape[1]))
        kernels.interpolate(np.ascontiguousarray(field), self.nodes, self.weights, out)
        return out

    def to_nodes(self, values: FloatArray) -> FloatArray:
        """Sum values of the points (n_points, k) at the nodes: W^T values, (n_nodes, k)."""
        out = np.empty((self.n_nodes, values.shape[1]))
        kernels.sum_at_nodes(np.ascontiguousarray(values), self.weights, self.offsets, self.entries, out)
        return out

    def of_first(self, n: int) -> Stencils:
        """Stencils of the first n points alone: what `Grid.stencils` would make of them."""
        weights, nodes = self.weights[:n], self.nodes[:n].copy()
        counts = np.empty(self.n_nodes, dtype=np.int64)
        stencil_kernels.count_below(self.offsets, self.entries, n * weights.shape[1], counts)
        is_active = counts > 0
        kept = np.flatnonzero(is_active)
        stencil_kernels.renumber((np.cumsum(is_active) - 1).astype(np.int32), weights, nodes)
        offsets = np.concatenate([[0], np.cumsum(counts[kept])]).astype(np.int64)
        entries = np.empty(int(offsets[-1]), dtype=np.int64)
        stencil_kernels.copy_entries(kept, self.offsets, self.entries, offsets, entries)
        positions = self.positions[kept]
        return Stencils(self.spacing, self.degree, positions, nodes, weights, self.gradients[:n], offsets, entries)

    def nodes_of(self, points: IntArray) -> IntArray:
        """Nodes with a weight at one of the points, ascending."""
        return np.unique(self.nodes[points][self.weights[points] > 0.0]).astype(np.int64)

    @property
    def points(self) -> IntArray:
        """Points of each node: the entries without their places."""
        return np.asarray(self.entries // self.weights.shape[1])

    def pattern(self) -> Any:
        """Where W (n_points, n_nodes) is not zero: a SciPy CSR matrix of ones."""
        import scipy.sparse

        n, size = self.weights.shape
        held = self.weights.ravel() > 0.0
        offsets = np.concatenate([[0], np.cumsum(held)])[::size]
        ones = np.ones(int(offsets[-1]), dtype=np.float32)
        return scipy.sparse.csr_matrix((ones, self.nodes.ravel()[held], offsets), shape=(n, self.n_nodes))


def product_pattern(columns: np.ndarray, row_offsets: np.ndarray, right: Any) -> Any:
    """Pattern of a product, from the CSR pattern of its left factor and a SciPy matrix of positive numbers.

    Columns are sorted in each row. All entries are positive: none vanishes by cancelling.
    """
    import scipy.sparse

    ones = np.ones(columns.size, dtype=np.float32)
    left = scipy.sparse.csr_matrix((ones, columns, row_offsets), shape=(row_offsets.size - 1, right.shape[0]))
    product = (left @ right).tocsr()
    product.sort_indices()
    product.data[:] = 1.0
    return product


class Grid:
    """A grid without bounds: node i lies at ``i spacing``.

    Parameters
    ----------
    spacing : float
        Distance of the nodes [m].
    kernel : str
        ``linear`` or ``quadratic``.
    """

    def __init__(self, spacing: float, kernel: str) -> None:
        self.spacing = float(spacing)
        self.degree = DEGREES[kernel]

    def stencils(self, points: FloatArray, n_carriers: int | None = None) -> Stencils:
        """Weights of points (n_points, dim) and the nodes they make active.

        Parameters
        ----------
        points : (n_points, dim) float64
            [m].
        n_carriers : int, optional
            Only this many of the points make nodes active; others have no weight and no gradient at other nodes.
            Default: all.

        Raises
        ------
        ValueError
            If a point is not finite, or the points lie too far apart for nodes to be numbered.
        """
        n, dim = points.shape
        side = self.degree + 1
        if not np.isfinite(points).all():
            raise ValueError("a position is not finite")
        base = np.empty((n, dim), dtype=np.int64)
        weights = np.empty((n, side**dim))
        gradients = np.empty((n, side**dim, dim))
        kernels.splines(np.ascontiguousarray(points), self.spacing, self.degree, base, weights, gradients)
        low = base.min(axis=0)
        extent = base.max(axis=0) - low + side
        if float(np.prod(extent.astype(float))) > 2.0**62:
            raise ValueError("the points lie too far apart for the cell size")
        strides = np.append(np.cumprod(extent[::-1])[-2::-1], 1)
        shift = np.stack(np.meshgrid(*[np.arange(side)] * dim, indexing="ij"), axis=-1).reshape(-1, dim) @ strides
        touched, cell_nodes, cell_of_point = _numbered((base - low) @ strides, shift, int(np.prod(extent)))
        nodes = np.empty((n, side**dim), dtype=np.int32)
        stencil_kernels.node_numbers(cell_nodes, cell_of_point, weights, nodes)
        if n_carriers is not None:
            is_carried = np.zeros(touched.size, dtype=bool)
            is_carried[nodes[:n_carriers][weights[:n_carriers] > 0.0]] = True
            lost = ~is_carried[nodes]
            weights[lost], gradients[lost] = 0.0, 0.0
        counts = np.empty((_PARTS, touched.size), dtype=np.int64)
        stencil_kernels.count_entries(nodes, weights, counts)
        # Nodes at which every weight vanishes, at knots of the splines, carry no mass.
        total = counts.sum(axis=0)
        is_active = total > 0
        if not is_active.all():
            stencil_kernels.renumber((np.cumsum(is_active) - 1).astype(np.int32), weights, nodes)
            counts, total, touched = np.ascontiguousarray(counts[:, is_active]), total[is_active], touched[is_active]
        offsets = np.concatenate([[0], np.cumsum(total)]).astype(np.int64)
        stencil_kernels.first_entries(offsets, counts)
        entries = np.empty(int(offsets[-1]), dtype=np.int64)
        stencil_kernels.fill_entries(nodes, weights, counts, entries)
        index, rest = np.empty((touched.size, dim), dtype=np.int64), touched
        for a in range(dim):
            index[:, a], rest = rest // strides[a], rest % strides[a]
        positions = (index + low) * self.spacing
        return Stencils(self.spacing, self.degree, positions, nodes, weights, gradients, offsets, entries)


def _numbered(first: IntArray, shift: IntArray, size: int) -> tuple[IntArray, Any, Any]:
    """Number the cells that hold points, and the nodes around them.

    Parameters
    ----------
    first : (n,) int64
        Number of the lowest node of each point in a box around all.
    shift : (n_stencil,) int64
        What is added to it for the other nodes of a stencil.
    size : int
        Number of nodes in the box.

    Returns
    -------
    touched : (n_touched,) int64
        Nodes of all stencils, ascending.
    cell_nodes : (n_cells, n_stencil) int32
        Their places in it, for each occupied cell.
    cell_of_point : (n,) int32
        Cell of each point.
    """
    if size > max(_SMALL_BOX, 8 * first.size):
        own, of_point = np.unique(first, return_inverse=True)
        touched = np.unique(own[:, None] + shift)
        cell_nodes = np.searchsorted(touched, own[:, None] + shift)
        return touched, cell_nodes.astype(np.int32), of_point.ravel().astype(np.int32)
    there, number = np.zeros(size, dtype=bool), np.empty(size, dtype=np.int32)
    there[first] = True
    own = np.flatnonzero(there)
    number[own] = np.arange(own.size)
    cell_of_point = number[first]
    for s in shift:
        there[own + s] = True
    touched = np.flatnonzero(there)
    number[touched] = np.arange(touched.size)
    return touched, number[own[:, None] + shift], cell_of_point
