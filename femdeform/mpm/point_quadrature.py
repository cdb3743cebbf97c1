"""Quadrature of an implicit grid step: gradients at material points and samples, and which nodes they couple."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.counting_sort import sort_by_number
from femdeform.fem.assembly import expand_to_dofs
from femdeform.mpm import cell_kernels, point_kernels
from femdeform.mpm.grid import Stencils
from femdeform.parallel import Partition
from femdeform.types import FloatArray, IntArray

# Weights that add up to one but for this belong to points whose nodes are all there.
_COMPLETE = 1e-12


@dataclass(frozen=True)
class PointCells:
    """Points by the cells they lie in: all of a cell have the same nodes.

    Attributes
    ----------
    offsets : (n_cells + 1,)
        First point of each cell in `points`.
    points : (n_points,)
        Points of one cell after the other, ascending in each.
    size : int
        Nodes of a cell.
    row_offsets, rows
        Rows ``cell size + place of the node in the cell`` of each node, ascending.
    """

    offsets: IntArray
    points: IntArray
    size: int
    row_offsets: IntArray
    rows: IntArray

    @classmethod
    def of(cls, stencils: Stencils, n: int) -> PointCells:
        """Cells of the first n points of some stencils."""
        held = stencils.weights[:n] > 0.0
        size = held.shape[1]
        # The middle node tells the cell; a point without it has one of its own.
        middle = size // 2
        cell = np.where(held[:, middle], stencils.nodes[:n, middle], stencils.n_nodes + np.arange(n))
        points, offsets = sort_by_number(cell, stencils.n_nodes + n)
        offsets = offsets[np.concatenate([[True], np.diff(offsets) > 0])]
        numbers = np.where(held, stencils.nodes[:n], stencils.n_nodes)[points]
        # Nodes that no point of a cell weighs are sorted behind the last node.
        nodes = np.minimum.reduceat(numbers, offsets[:-1], axis=0) if n else numbers
        rows, row_offsets = sort_by_number(nodes.ravel(), stencils.n_nodes + 1)
        return cls(offsets, points, size, row_offsets[:-1], rows)

    def empty(self, dim: int) -> FloatArray:
        """Room for vectors at the nodes of all cells, (n_cells, n_stencil, dim)."""
        return np.empty((self.offsets.size - 1, self.size, dim))

    def gather(self, at_cells: FloatArray) -> FloatArray:
        """Sums (n_nodes, dim) of what cells have for their nodes."""
        dim = at_cells.shape[2]
        out = np.empty((self.row_offsets.size - 1, dim))
        cell_kernels.gather(at_cells.reshape(-1, dim), self.row_offsets, self.rows, out)
        return out


@dataclass(frozen=True)
class Quadrature:
    """Where deformation is taken: ``F_q = B_q + sum_k u[nodes[q, k]] gradients[q, 0, k]^T``.

    Attributes
    ----------
    nodes : (n_points, n_stencil) int32
        Grid nodes of each point.
    gradients : (n_points, 1, n_stencil, dim) float64
        [1/m]; zero at nodes that have no weight.
    base : (n_points, dim^2) float64
        B: F^n of solids, else the identity [-].
    offsets, entries
        Points of each node, ascending, as ``point n_stencil + place in its stencil``.
    cells : PointCells
        The same points by cells.
    """

    nodes: np.ndarray[Any, np.dtype[np.int32]]
    gradients: FloatArray
    base: FloatArray
    offsets: IntArray
    entries: IntArray
    cells: PointCells

    @classmethod
    def of(cls, stencils: Stencils, n: int, F: FloatArray, solid: IntArray) -> Quadrature:
        """Quadrature at the first n points of some stencils.

        Parameters
        ----------
        stencils : Stencils
            Of quadratic splines.
        n : int
            Number of points; further ones of the stencils only carry mass.
        F : (n_particles, dim, dim) float64
            Deformation gradients before the step [-]; read at `solid`.
        solid : (n_solid,) int64
            Points whose stress depends on ``F^ F^n``.
        """
        held = stencils.weights[:n] > 0.0
        gradients = consistent_gradients(stencils, n)
        dim = gradients.shape[2]
        base = np.tile(np.eye(dim).ravel(), (n, 1))
        base[solid] = F[solid].reshape(-1, dim * dim)
        # G = F^nT grad w: the law's stress and tangent then belong to these gradients as they are.
        gradients[solid] = gradients[solid] @ F[solid]
        # Entries without weight are sorted behind those of the last node.
        numbers = np.where(held, stencils.nodes[:n], stencils.n_nodes).ravel()
        entries, offsets = sort_by_number(numbers, stencils.n_nodes + 1)
        nodes = np.ascontiguousarray(stencils.nodes[:n])
        return cls(nodes, gradients[:, None], base, offsets[:-1], entries, PointCells.of(stencils, n))


def consistent_gradients(stencils: Stencils, n: int) -> FloatArray:
    """Gradients of the first n points, (n, n_stencil, dim) [1/m], zero where there is no weight.

    Grids leave out weights that are no more than rounding, but not their gradients, which go with the root of the
    weight and may be 1e-8 of the others. What is left out is given to the other nodes, so that ``sum G = 0`` and
    ``sum x G^T = I`` hold to rounding, as forces without resultant and torque need them. Points whose nodes are not all
    there, of `Grid.stencils` with carriers, stay as they are: their part of the forces is lost.

    Raises
    ------
    ValueError
        If the splines are not quadratic.
    """
    if stencils.degree != 2:
        raise ValueError("an implicit step takes quadratic splines")
    weights = stencils.weights[:n]
    gradients = np.array(stencils.gradients[:n])
    rows = np.flatnonzero((weights == 0.0).any(axis=1))
    gradients[weights == 0.0] = 0.0
    rows = rows[weights[rows].sum(axis=1) > 1.0 - _COMPLETE]
    if rows.size:
        w, G = weights[rows], gradients[rows]
        x = stencils.positions[stencils.nodes[rows]]
        apart = x - np.einsum("pk,pkc->pc", w, x)[:, None]
        dim = G.shape[2]
        excess = np.einsum("pki,pkj->pij", apart, G) - np.eye(dim)
        # sum w r r^T = dx^2/4 I of quadratic splines.
        change = G.sum(axis=1)[:, None] + 4.0 / stencils.spacing**2 * np.einsum("pij,pki->pkj", excess, apart)
        gradients[rows] = G - w[..., None] * change
    return gradients


def relative_places(degree: int, dim: int) -> IntArray:
    """Number, among the nodes around one, of place b of a stencil seen from place a: (n_stencil, n_stencil)."""
    side, width = degree + 1, 2 * degree + 1
    places = np.stack(np.meshgrid(*[np.arange(side)] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    apart = places[None] - places[:, None] + degree
    return np.asarray(apart @ (width ** np.arange(dim - 1, -1, -1)), dtype=np.int64)


class NodePattern:
    """Sparsity of the Hessian over active nodes: every node and those within two cells of it on each axis.

    It follows from the active nodes alone, so it stays while they do, whatever the points are.

    Parameters
    ----------
    stencils : Stencils
    partition : Partition
        Of its nodes.

    Attributes
    ----------
    neighbours : (n_nodes, 5^dim) int32
        Nodes around each in lexicographic order of their places, -1 where there is none.
    ranks : (n_nodes, 5^dim) uint8
        Number of each of them among those of its node that exist.
    row_offsets, columns
        CSR structure over nodes; columns come in the order of the places.
    dof_row_offsets, dof_columns
        The same over degrees of freedom.
    relative : (n_stencil, n_stencil) int64
        See `relative_places`.
    """

    neighbours: np.ndarray[Any, np.dtype[np.int32]]
    ranks: np.ndarray[Any, np.dtype[np.uint8]]
    row_offsets: IntArray
    columns: np.ndarray[Any, np.dtype[np.int32]]
    dof_row_offsets: np.ndarray
    dof_columns: np.ndarray
    relative: IntArray

    def __init__(self, stencils: Stencils, partition: Partition) -> None:
        self.positions, self._index = stencils.positions, partition.global_index
        n, dim = self.positions.shape
        width = 2 * stencils.degree + 1
        index = np.rint(self.positions / stencils.spacing).astype(np.int64)
        index -= index.min(axis=0)
        extent = index.max(axis=0) + 1 + width
        strides = np.append(np.cumprod(extent[::-1])[-2::-1], 1).astype(np.int64)
        self.neighbours = np.empty((n, width**dim), dtype=np.int32)
        keys = index @ strides
        if np.all(keys[1:] > keys[:-1]):
            point_kernels.find_neighbours(keys, strides, width, self.neighbours)
        else:  # ghosts follow the nodes of a rank
            order = np.argsort(keys).astype(np.int32)
            found = np.empty_like(self.neighbours)
            point_kernels.find_neighbours(keys[order], strides, width, found)
            self.neighbours[order] = np.where(found >= 0, order[found], -1)
        there = self.neighbours >= 0
        self.ranks = (np.cumsum(there, axis=1) - there).astype(np.uint8)
        self.row_offsets = np.concatenate([[0], np.cumsum(there.sum(axis=1))]).astype(np.int64)
        self.columns = self.neighbours[there]
        self.dof_row_offsets, self.dof_columns = expand_to_dofs(self.row_offsets, self.columns, dim)
        self.relative = relative_places(stencils.degree, dim)

    def is_of(self, stencils: Stencils, partition: Partition) -> bool:
        """Whether some stencils have the same active nodes, in the same hands on all ranks."""
        same = np.array_equal(self.positions, stencils.positions)
        same = same and np.array_equal(self._index, partition.global_index)
        return bool(partition.min(float(same)))
