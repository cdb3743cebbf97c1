"""A background grid of which only the nodes near points exist."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.mpm import kernels
from femdeform.types import FloatArray, IntArray

# Degrees of the B-splines by their words.
DEGREES = {"linear": 1, "quadratic": 2}


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
        first = (base - low) @ strides
        own, of_point = np.unique(first, return_inverse=True)
        touched = np.unique(own[:, None] + shift)
        numbers = np.searchsorted(touched, own[:, None] + shift)[of_point.ravel()]
        # Nodes at which every weight vanishes, at knots of the splines, carry no mass.
        is_active = np.zeros(touched.size, dtype=bool)
        is_active[numbers[:n_carriers][weights[:n_carriers] > 0.0]] = True
        if n_carriers is not None:
            lost = ~is_active[numbers]
            weights[lost], gradients[lost] = 0.0, 0.0
        renumbered = np.where(is_active, np.cumsum(is_active) - 1, 0)
        nodes = np.where(weights > 0.0, renumbered[numbers], 0).astype(np.int32)
        active = touched[is_active]
        index = np.empty((active.size, dim), dtype=np.int64)
        rest = active
        for a in range(dim):
            index[:, a], rest = rest // strides[a], rest % strides[a]
        flat = np.flatnonzero(weights.ravel() > 0.0)
        of_entry = nodes.ravel()[flat]
        order = np.argsort(of_entry, kind="stable")
        counts = np.bincount(of_entry, minlength=active.size)
        return Stencils(
            self.spacing,
            self.degree,
            (index + low) * self.spacing,
            nodes,
            weights,
            gradients,
            np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
            flat[order].astype(np.int64),
        )
