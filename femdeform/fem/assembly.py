"""The sparsity of the global Hessian, and which cell or contact adds to which of its blocks.

The pattern of the cells is computed once for a mesh. Contact between bodies couples further nodes; each set of them
makes a new pattern object out of the first (`BlockPattern.extended`), by whose identity a linear solver knows that
the sparsity has changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from femdeform.counting_sort import sort_by_number
from femdeform.fem import kernels
from femdeform.parallel import Partition
from femdeform.types import FloatArray, IntArray


class SlotSum:
    """Sum of values held per (cell, node of the cell) at the nodes.

    Parameters
    ----------
    cells : list of (n_cells, n_nodes) int arrays
        Nodes of the cells of each group; slots are numbered group by group, cell by cell, node by node.
    n_nodes : int
        Number of nodes.
    """

    def __init__(self, cells: Sequence[np.ndarray], n_nodes: int) -> None:
        nodes = np.concatenate([c.ravel() for c in cells]) if cells else np.empty(0, dtype=np.int32)
        self.n_slots = int(nodes.size)
        self.entries, self.offsets = sort_by_number(nodes, n_nodes)

    def __call__(self, slots: FloatArray, out: FloatArray) -> None:
        """Sum `slots` (n_slots, d) into `out` (n_nodes, d), overwriting it."""
        kernels.sum_slots(slots, self.offsets, self.entries, out)


@dataclass(frozen=True)
class SparseHessian:
    """A global Hessian as this rank's contribution in CSR form over local degrees of freedom.

    The matrix of the whole problem is the sum over the ranks, with `Partition.global_index` as the node numbering.

    Attributes
    ----------
    row_offsets : (n_local dim + 1,) int32
    columns : (n_values,) int32
    values : (n_values,) float64
        A buffer that the next evaluation overwrites.
    points : (n_local, dim) float64
        Reference positions of the nodes, for the rigid-body modes of multigrid.
    free : (n_local, dim) bool
        Degrees of freedom that are not prescribed; the rows and columns of the others are diagonal.
    partition : Partition
        Ownership of the nodes.
    pattern : object
        Identity of the sparsity: as long as it is the same object, `row_offsets` and `columns` are the same.
    """

    row_offsets: np.ndarray
    columns: np.ndarray
    values: FloatArray
    points: FloatArray
    free: np.ndarray
    partition: Partition
    pattern: object

    @property
    def dim(self) -> int:
        """Components per node."""
        return int(self.points.shape[1])

    def times(self, field: FloatArray) -> FloatArray:
        """Product with a (n_local, dim) field that is consistent on ghosts; so is the result."""
        import scipy.sparse

        n = field.size
        matrix = scipy.sparse.csr_matrix((self.values, self.columns, self.row_offsets), shape=(n, n))
        product = np.ascontiguousarray((matrix @ field.ravel()).reshape(field.shape))
        self.partition.accumulate(product)
        return product

    def diagonal_blocks(self) -> FloatArray:
        """Blocks of single nodes, (n_local, dim, dim), consistent on ghosts."""
        import scipy.sparse

        n, dim = self.points.shape
        matrix = scipy.sparse.csr_matrix((self.values, self.columns, self.row_offsets), shape=(n * dim, n * dim))
        blocks = matrix.tobsr(blocksize=(dim, dim))
        node = np.repeat(np.arange(n), np.diff(blocks.indptr))
        own = np.ascontiguousarray(blocks.data[blocks.indices == node].reshape(n, dim * dim))
        self.partition.accumulate(own)
        return own.reshape(n, dim, dim)


class BlockPattern:
    """Sparsity of the Hessian over nodes and the list of cell blocks that add to each of its blocks.

    Parameters
    ----------
    cells : list of (n_cells, n_nodes) int arrays
        Local nodes of the cells of each group.
    n_nodes, dim : int
        Local nodes and components per node.

    Attributes
    ----------
    first_slot : list of int
        First block slot of each group; cell e of group g starts at ``first_slot[g] + e n_pairs``.
    n_slots : int
        Number of blocks that the cells write: the upper triangle of each cell's matrix; in an extended pattern with
        one more for each pair, after those of the cells.
    pairs : (n_pairs,) int64
        Pairs of nodes of an extended pattern, as ``row n_nodes + column``, sorted.
    mirrors : (n_blocks,) int
        For each block (i, j) the number of block (j, i).
    """

    def __init__(self, cells: Sequence[np.ndarray], n_nodes: int, dim: int) -> None:
        self.dim = dim
        self.n_nodes = n_nodes
        rows: list[IntArray] = []
        columns: list[IntArray] = []
        slots: list[IntArray] = []
        self.first_slot: list[int] = []
        first = 0
        for group in cells:
            a, b = np.triu_indices(group.shape[1])
            self.first_slot.append(first)
            number = first + np.arange(group.shape[0] * a.size, dtype=np.int64)
            upper_row, upper_column = group[:, a].ravel().astype(np.int64), group[:, b].ravel().astype(np.int64)
            off = np.tile(a != b, group.shape[0])
            rows += [upper_row, upper_column[off]]
            columns += [upper_column, upper_row[off]]
            slots += [2 * number, 2 * number[off] + 1]
            first += number.size
        self.n_slots = first
        self.pairs: IntArray = np.empty(0, dtype=np.int64)
        # Every node has a diagonal block, also one that no cell of this rank touches.
        everyone = np.arange(n_nodes, dtype=np.int64)
        key = np.concatenate([r * n_nodes + c for r, c in zip(rows, columns, strict=True)] + [everyone * (n_nodes + 1)])
        order = np.argsort(key, kind="stable")
        entries = np.concatenate([*slots, np.full(n_nodes, -1, dtype=np.int64)])[order]
        key = key[order]
        start = np.flatnonzero(np.diff(key, prepend=-1))
        unique = key[start]
        self.rows: IntArray = unique // n_nodes
        self.columns = (unique % n_nodes).astype(np.int32)
        self.row_offsets = _offsets(self.rows, n_nodes)
        # The placeholders of the diagonal carry nothing to add.
        block = np.repeat(np.arange(unique.size), np.diff(np.append(start, key.size)))[entries >= 0]
        self.entries = entries[entries >= 0].astype(np.int32 if first < 2**30 else np.int64)
        self.offsets = _offsets(block, unique.size)
        self._expand()

    def extended(self, pairs: IntArray) -> BlockPattern:
        """Return this pattern with a block, and a slot of its own for it, for further pairs of nodes.

        Parameters
        ----------
        pairs : (n_pairs,) int64
            As ``row n_nodes + column`` with row < column, sorted, each once. Pairs that share a cell may be among them.

        Returns
        -------
        BlockPattern
            The slot of pair k is ``self.n_slots + k``.
        """
        n = self.n_nodes
        mirrored = pairs % n * n + pairs // n
        own = self.rows * n + self.columns
        keys = np.union1d(own, np.concatenate([pairs, mirrored]))
        old, upper, lower = (np.searchsorted(keys, some) for some in (own, pairs, mirrored))
        counts = np.zeros(keys.size, dtype=np.int64)
        held = np.diff(self.offsets)
        counts[old] = held
        counts[upper] += 1
        counts[lower] += 1
        first = self.n_slots
        slots = 2 * (first + np.arange(pairs.size, dtype=np.int64))

        new = object.__new__(BlockPattern)
        new.dim, new.n_nodes, new.first_slot, new.pairs = self.dim, n, self.first_slot, pairs
        new.n_slots = first + pairs.size
        new.rows = keys // n
        new.columns = (keys % n).astype(np.int32)
        new.row_offsets = _offsets(new.rows, n)
        new.offsets = np.concatenate([[0], np.cumsum(counts)]).astype(self.offsets.dtype)
        new.entries = np.empty(new.offsets[-1], dtype=np.int32 if new.n_slots < 2**30 else np.int64)
        # Cells come first in each block, then the pair.
        place = np.repeat(new.offsets[old] - self.offsets[:-1], held) + np.arange(self.entries.size)
        new.entries[place] = self.entries
        new.entries[new.offsets[upper + 1] - 1] = slots
        new.entries[new.offsets[lower + 1] - 1] = slots + 1
        new._expand()
        return new

    def _expand(self) -> None:
        """CSR structure over degrees of freedom: node by node, component by component."""
        n = self.n_nodes
        mirrors = np.searchsorted(self.rows * n + self.columns, self.columns.astype(np.int64) * n + self.rows)
        self.mirrors = mirrors.astype(self.offsets.dtype)
        self.dof_row_offsets, self.dof_columns = expand_to_dofs(self.row_offsets, self.columns, self.dim)

    @property
    def n_values(self) -> int:
        """Number of stored scalars of the global Hessian."""
        return int(self.dof_columns.size)

    def block_scalars(self, matrix: object) -> FloatArray:
        """Values of a scalar CSR matrix over nodes at the pattern's blocks (n_blocks,), zero where it has none."""
        import scipy.sparse

        scalar = scipy.sparse.csr_matrix(matrix)
        scalar.sum_duplicates()
        key = self.rows * self.n_nodes + self.columns
        n_row = np.diff(scalar.indptr)
        entry = np.repeat(np.arange(self.n_nodes, dtype=np.int64), n_row) * self.n_nodes + scalar.indices
        position = np.searchsorted(key, entry)
        result = np.zeros(key.size)
        result[position] = scalar.data
        return result


def expand_to_dofs(row_offsets: np.ndarray, columns: np.ndarray, dim: int) -> tuple[np.ndarray, np.ndarray]:
    """CSR structure over degrees of freedom, component by component of a node, from one over nodes.

    Parameters
    ----------
    row_offsets, columns : (n_nodes + 1,), (n_blocks,) int arrays
        Structure over nodes.
    dim : int
        Components per node.

    Returns
    -------
    (n_nodes dim + 1,), (n_blocks dim^2,) int32
        Row offsets and columns.
    """
    per_node = np.diff(row_offsets).astype(np.int64)
    # Each node's row of columns is repeated once per component.
    lengths = np.repeat(per_node * dim, dim)
    dof_row_offsets = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32)
    expanded = (dim * columns[:, None] + np.arange(dim, dtype=np.int32)).ravel()  # one dof row per node
    starts = np.repeat(row_offsets[:-1].astype(np.int64) * dim, dim)
    index = np.arange(lengths.sum()) - np.repeat(dof_row_offsets[:-1].astype(np.int64), lengths)
    return dof_row_offsets, expanded[np.repeat(starts, lengths) + index]


def row_sizes(values: FloatArray, row_offsets: np.ndarray) -> FloatArray:
    """Largest entry, by size, of each row of a CSR matrix."""
    return np.asarray(np.maximum.reduceat(np.abs(values), row_offsets[:-1].astype(np.int64)))


def roundoff(rows: FloatArray, x: FloatArray) -> float:
    """Sum of squares of what rounding of positions x [m] leaves of forces with rows of such sizes [N^2]."""
    size = float(np.abs(x).max(initial=0.0))
    return float(np.sum((4.0 * np.finfo(float).eps * rows * size) ** 2))


def _offsets(numbers: np.ndarray, n: int) -> np.ndarray:
    counts = np.bincount(numbers, minlength=n)
    total = int(counts.sum())
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int32 if total < 2**31 else np.int64)
