"""Quadrature of an implicit grid step: gradients at material points and samples, and which nodes they couple."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.counting_sort import sort_by_number
from femdeform.fem.assembly import expand_to_dofs
from femdeform.mpm import point_kernels
from femdeform.mpm.grid import Stencils
from femdeform.types import FloatArray, IntArray


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
    """

    nodes: np.ndarray[Any, np.dtype[np.int32]]
    gradients: FloatArray
    base: FloatArray
    offsets: IntArray
    entries: IntArray

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
        return cls(nodes, gradients[:, None], base, offsets[:-1], entries)


def consistent_gradients(stencils: Stencils, n: int) -> FloatArray:
    """Gradients of the first n points, (n, n_stencil, dim) [1/m], zero where there is no weight.

    Grids leave out weights that are no more than rounding, but not their gradients, which go with the root of the
    weight and may be 1e-8 of the others. What is left out is given to the other nodes, so that ``sum G = 0`` and
    ``sum x G^T = I`` hold to rounding, as forces without resultant and torque need them.

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
    if rows.size:
        w = weights[rows]
        G = np.where(w[..., None] > 0.0, gradients[rows], 0.0)
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

    Attributes
    ----------
    neighbours : (n_nodes, 5^dim) int32
        Nodes around each in lexicographic order of their places, -1 where there is none.
    row_offsets, columns
        CSR structure over nodes.
    dof_row_offsets, dof_columns
        The same over degrees of freedom.
    relative : (n_stencil, n_stencil) int64
        See `relative_places`.
    """

    def __init__(self, stencils: Stencils) -> None:
        self.positions = stencils.positions
        n, dim = self.positions.shape
        width = 2 * stencils.degree + 1
        index = np.rint(self.positions / stencils.spacing).astype(np.int64)
        index -= index.min(axis=0)
        extent = index.max(axis=0) + 1 + width
        strides = np.append(np.cumprod(extent[::-1])[-2::-1], 1).astype(np.int64)
        self.neighbours = np.empty((n, width**dim), dtype=np.int32)
        point_kernels.find_neighbours(index @ strides, strides, width, self.neighbours)
        there = self.neighbours >= 0
        self.row_offsets = np.concatenate([[0], np.cumsum(there.sum(axis=1))]).astype(np.int64)
        self.columns = self.neighbours[there]
        self.dof_row_offsets, self.dof_columns = expand_to_dofs(self.row_offsets, self.columns, dim)
        self.relative = relative_places(stencils.degree, dim)

    def is_of(self, stencils: Stencils) -> bool:
        """Whether some stencils have the same active nodes."""
        return np.array_equal(self.positions, stencils.positions)
