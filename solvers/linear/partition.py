"""Which rank owns which cell: PETSc's interface to PT-Scotch on the graph of cells that share a facet."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from typing import Any

import numpy as np

from femdeform.types import IntArray, Mesh
from solvers.linear import coo


def cell_graph(cells: IntArray) -> tuple[IntArray, IntArray]:
    """Adjacency of cells that share a facet, as CSR offsets (n_cells + 1,) and neighbours, sorted by cell."""
    n_cells, k = cells.shape
    sides = np.concatenate([np.sort(np.delete(cells, i, axis=1), axis=1) for i in range(k)])
    owner = np.tile(np.arange(n_cells), k)
    _, label = np.unique(sides, axis=0, return_inverse=True)
    order = np.argsort(label.ravel(), kind="stable")
    label, owner = label.ravel()[order], owner[order]
    # Rods and membranes may share a facet between more than two cells: link each to the next one.
    pair = np.flatnonzero(label[1:] == label[:-1])
    rows = np.concatenate([owner[pair], owner[pair + 1]])
    columns = np.concatenate([owner[pair + 1], owner[pair]])
    order = np.lexsort((columns, rows))
    offsets = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=n_cells))])
    return offsets, columns[order]


def _partition_graph(offsets: IntArray, neighbours: IntArray, parts: int) -> IntArray:
    from petsc4py import PETSc

    n = offsets.size - 1
    graph = PETSc.Mat().createAIJ(
        (n, n),
        csr=(offsets.astype(PETSc.IntType), neighbours.astype(PETSc.IntType), np.ones(neighbours.size)),
        comm=PETSc.COMM_SELF,
    )
    partitioning = PETSc.MatPartitioning().create(PETSc.COMM_SELF)
    partitioning.setType("ptscotch")
    partitioning.setAdjacency(graph)
    coo.check(
        coo.library().MatPartitioningSetNParts(ctypes.c_void_p(partitioning.handle), ctypes.c_int(parts)),
        "MatPartitioningSetNParts",
    )
    labels = PETSc.IS().create(PETSc.COMM_SELF)
    partitioning.apply(labels)
    result = np.array(labels.getIndices(), dtype=np.int64)
    for thing in (labels, partitioning, graph):
        thing.destroy()
    return result


def partition_cells(meshes: Mapping[str, Mesh], comm: Any) -> dict[str, IntArray]:
    """Assign the cells of every body to ranks, balanced over all bodies together.

    Rank 0 decides and tells the others, so that all agree.

    Parameters
    ----------
    meshes : mapping of str to Mesh
        Meshes by body, the same on every rank.
    comm : mpi4py communicator
        All ranks of the run.

    Returns
    -------
    dict of str to (n_cells,) int64
        Rank of each cell.
    """
    # PETSc starts on all ranks together, although only one of them uses it here.
    from petsc4py import PETSc  # noqa: F401

    answer: dict[str, IntArray] | None = None
    if comm.Get_rank() == 0:
        offsets, neighbours, first = [np.zeros(1, dtype=np.int64)], [], 0
        for mesh in meshes.values():
            own_offsets, own_neighbours = cell_graph(mesh.cells)
            offsets.append(offsets[-1][-1] + own_offsets[1:])
            neighbours.append(first + own_neighbours)
            first += mesh.n_cells
        ranks = _partition_graph(np.concatenate(offsets), np.concatenate(neighbours), comm.Get_size())
        ends = np.cumsum([mesh.n_cells for mesh in meshes.values()])
        answer = dict(zip(meshes, np.split(ranks, ends[:-1]), strict=True))
    result: dict[str, IntArray] = comm.bcast(answer, root=0)
    return result
