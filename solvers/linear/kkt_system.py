"""A saddle system of positions and cell multipliers: its parts, its numbering over the ranks, its blocks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from femdeform.fem.assembly import SparseHessian
from femdeform.parallel import Partition
from femdeform.types import FloatArray, IntArray


@dataclass(frozen=True)
class SaddleSystem:
    """One saddle system, this rank's part.

    Attributes
    ----------
    A : SparseHessian
        First block [N/m].
    cells : list of (n_cells, n_nodes) int arrays
        Local nodes of each group of cells.
    B : list of (n_cells, n_q, n_m, n_nodes dim) float64
        Rows of the multipliers of every quadrature point.
    C : list of (n_cells, n_q, n_m, n_m) float64
        Their compliances.
    """

    A: SparseHessian
    cells: list[np.ndarray]
    B: list[FloatArray]
    C: list[FloatArray]


class Layout:
    """Numbering of the whole system: the degrees of freedom of a rank's nodes, then its multipliers, rank by rank."""

    def __init__(self, system: SaddleSystem) -> None:
        partition, dim = system.A.partition, system.A.dim
        self.partition: Partition = partition
        self.dim = dim
        self.shapes = [B.shape[:3] for B in system.B]
        self.n_multipliers = sum(int(np.prod(shape)) for shape in self.shapes)
        self.n_dofs = partition.n_owned * dim
        self.n_owned = self.n_dofs + self.n_multipliers
        pairs = [(partition.n_owned, self.n_multipliers)]
        if partition.comm is not None:
            pairs = partition.comm.allgather(pairs[0])
        nodes_before = np.concatenate([[0], np.cumsum([n for n, _ in pairs])])
        multipliers_before = np.concatenate([[0], np.cumsum([m for _, m in pairs])])
        self.n_global = int(nodes_before[-1] * dim + multipliers_before[-1])
        owner = np.searchsorted(nodes_before, partition.global_index, side="right") - 1
        first = partition.global_index * dim + multipliers_before[owner]
        self.dofs: IntArray = (first[:, None] + np.arange(dim)).astype(np.int64)
        own = int(nodes_before[partition.rank] * dim + multipliers_before[partition.rank])
        self.first = own
        self.multipliers: IntArray = own + self.n_dofs + np.arange(self.n_multipliers, dtype=np.int64)

    def coordinates(self, system: SaddleSystem) -> tuple[IntArray, IntArray]:
        """Global rows and columns of everything `values` gives, in its order."""
        flat = self.dofs.ravel()
        rows = [np.repeat(flat, np.diff(system.A.row_offsets))]
        columns = [flat[system.A.columns]]
        upper: list[tuple[IntArray, IntArray]] = []
        square: list[tuple[IntArray, IntArray]] = []
        start = 0
        for cells, shape in zip(system.cells, self.shapes, strict=True):
            size = int(np.prod(shape))
            own = self.multipliers[start : start + size].reshape(shape)
            start += size
            nodes = self.dofs[cells].reshape(shape[0], 1, 1, -1)
            wide = (*shape, nodes.shape[-1])
            upper.append((np.broadcast_to(own[..., None], wide).ravel(), np.broadcast_to(nodes, wide).ravel()))
            tall = (*shape, shape[2])
            square.append(
                (np.broadcast_to(own[..., None], tall).ravel(), np.broadcast_to(own[:, :, None], tall).ravel())
            )
        for r, c in upper:
            rows.append(r)
            columns.append(c)
        for r, c in upper:
            rows.append(c)
            columns.append(r)
        for r, c in square:
            rows.append(r)
            columns.append(c)
        return np.concatenate(rows), np.concatenate(columns)

    def values(self, system: SaddleSystem, B: Sequence[FloatArray], C: Sequence[FloatArray]) -> FloatArray:
        """Entries of the matrix; `B` with the columns of prescribed degrees of freedom at zero."""
        flat = [b.ravel() for b in B]
        return np.concatenate([system.A.values, *flat, *flat, *(-c.ravel() for c in C)])

    def join(self, x: FloatArray, y: Sequence[FloatArray]) -> FloatArray:
        """Owned part of a vector of the whole system."""
        return np.concatenate([x[: self.partition.n_owned].ravel(), *(part.ravel() for part in y)])

    def split(self, vector: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
        """Positions (n_local, dim), ghosts updated, and multipliers of an owned vector."""
        x = np.empty((self.partition.n_local, self.dim))
        x[: self.partition.n_owned] = vector[: self.n_dofs].reshape(-1, self.dim)
        self.partition.update_ghosts(x)
        y, start = [], self.n_dofs
        for shape in self.shapes:
            size = int(np.prod(shape))
            y.append(vector[start : start + size].reshape(shape))
            start += size
        return x, y

    def dot(self, a: FloatArray, b: FloatArray) -> float:
        """Inner product of two vectors."""
        # Not BLAS; see `Partition.dot`.
        return self.partition.sum(float(np.einsum("i,i->", a, b)))

    def row_norms(self, vector: FloatArray) -> tuple[float, float]:
        """Norms of the two block rows."""
        first, second = vector[: self.n_dofs], vector[self.n_dofs :]
        return float(np.sqrt(self.dot(first, first))), float(np.sqrt(self.dot(second, second)))
