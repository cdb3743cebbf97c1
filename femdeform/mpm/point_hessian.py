"""The Hessian of an implicit step: products without a matrix, and the matrix if somebody asks for it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.mpm import cell_kernels, point_kernels
from femdeform.mpm.point_quadrature import NodePattern, Quadrature
from femdeform.parallel import Partition
from femdeform.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Tangents:
    """Tangents of all points; buffers that the next evaluation overwrites.

    Attributes
    ----------
    place : (n_points,) int64
        Row of `matrices` of each point; -1 for liquids.
    matrices : (n, dim^2, dim^2) float64
        [J].
    alpha, beta : (n_points,) float64
        ``alpha I x I + beta Sym``, the tangents of liquids [J].
    """

    place: IntArray
    matrices: FloatArray
    alpha: FloatArray
    beta: FloatArray


class PointHessian:
    """``Q^T (M/h^2 + sum_q G_q C_q G_q^T) Q`` over the unknowns of a `PointPotential`.

    A linear solver may take it for a `SparseHessian`, whose `values` are assembled when they are first read, or use
    `times` and `diagonal_blocks` alone. Rows and columns of unknowns that are prescribed are diagonal.

    Parameters
    ----------
    quadrature : Quadrature
    tangents : Tangents
    weights : (n_nodes,) float64
        m_i / h^2 [N/m], of ghosts too.
    frames : (n_nodes, dim, dim) float64
        Q, see `WallContact`.
    free : (n_nodes, dim) bool
        Unknowns that are not prescribed.
    positions : (n_nodes, dim) float64
        Grid nodes [m].
    partition : Partition
        Ranks add up what their points give to the nodes they share.
    owner : object
        Has `node_pattern()` and `matrix_values(n)`, which keep the sparsity and the buffer from step to step.
    """

    def __init__(
        self,
        quadrature: Quadrature,
        tangents: Tangents,
        weights: FloatArray,
        frames: FloatArray,
        free: BoolArray,
        positions: FloatArray,
        partition: Partition,
        owner: Any,
    ) -> None:
        self.quadrature, self.tangents, self.weights = quadrature, tangents, weights
        self.frames, self.free, self.points, self.partition = frames, free, positions, partition
        self._owner = owner
        self._values: FloatArray | None = None
        self._diagonal: FloatArray | None = None
        self._turned = (frames != np.eye(self.dim)).any(axis=(1, 2))
        self._is_turned, self._is_held = bool(self._turned.any()), not bool(free.all())
        self._dims = (0,) * self.dim
        self._stencil = (0,) * quadrature.nodes.shape[1]
        # What is added up over ranks has the mass of a node once.
        self._own_weights = np.where(np.arange(weights.size) < partition.n_owned, weights, 0.0)

    @property
    def dim(self) -> int:
        """Components per node."""
        return int(self.points.shape[1])

    @property
    def pattern(self) -> NodePattern:
        """Identity of the sparsity."""
        pattern: NodePattern = self._owner.node_pattern()
        return pattern

    @property
    def row_offsets(self) -> np.ndarray:
        """First value of each degree of freedom's row."""
        return self.pattern.dof_row_offsets

    @property
    def columns(self) -> np.ndarray:
        """Column of each value."""
        return self.pattern.dof_columns

    @property
    def values(self) -> FloatArray:
        """Values of the matrix; a buffer that the next one assembled overwrites."""
        if self._values is None:
            pattern, q, t = self.pattern, self.quadrature, self.tangents
            self._values = self._owner.matrix_values(pattern.dof_columns.size)
            point_kernels.assemble(
                q.gradients,
                q.offsets,
                q.entries,
                t.place,
                t.matrices,
                t.alpha,
                t.beta,
                self._own_weights,
                pattern.relative,
                pattern.neighbours,
                pattern.row_offsets,
                self.frames,
                self._turned.view(np.uint8),
                self.free.view(np.uint8),
                self._dims,
                self._stencil,
                self._values,
            )
            point_kernels.mirror(pattern.row_offsets, pattern.neighbours, pattern.ranks, self._dims, self._values)
        return self._values

    def diagonal_blocks(self) -> FloatArray:
        """Blocks of single nodes [N/m], (n_nodes, dim, dim)."""
        if self._diagonal is None:
            q, t = self.quadrature, self.tangents
            blocks = np.empty(self.frames.shape)
            point_kernels.diagonal_blocks(
                q.gradients,
                q.offsets,
                q.entries,
                t.place,
                t.matrices,
                t.alpha,
                t.beta,
                self._own_weights,
                self._dims,
                self._stencil,
                blocks,
            )
            self.partition.accumulate(blocks)
            if self._is_turned:
                blocks = np.swapaxes(self.frames, 1, 2) @ blocks @ self.frames
            own = np.einsum("icc->ic", blocks).copy()
            blocks[~self.free] = 0.0
            np.swapaxes(blocks, 1, 2)[~self.free] = 0.0
            # A prescribed unknown keeps the size of its own entry.
            np.einsum("icc->ic", blocks)[~self.free] = np.abs(own[~self.free])
            self._diagonal = blocks
        return self._diagonal

    def times(self, field: FloatArray) -> FloatArray:
        """Product with a (n_nodes, dim) field of the unknowns, without the matrix."""
        q, t = self.quadrature, self.tangents
        u = np.where(self.free, field, 0.0) if self._is_held else np.ascontiguousarray(field)
        if self._is_turned:
            u = np.einsum("iab,ib->ia", self.frames, u)
        at_cells = q.cells.empty(self.dim)
        cell_kernels.products(
            u,
            q.nodes,
            q.gradients,
            q.cells.offsets,
            q.cells.points,
            t.place,
            t.matrices,
            t.alpha,
            t.beta,
            self._dims,
            self._stencil,
            at_cells,
        )
        out = q.cells.gather(at_cells)
        self.partition.accumulate(out)
        out += self.weights[:, None] * u
        if self._is_turned:
            out = np.einsum("iba,ib->ia", self.frames, out)
        if not self._is_held:
            return out
        own = np.einsum("icc->ic", self.diagonal_blocks())
        return np.where(self.free, out, own * field)
