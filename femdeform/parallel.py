"""Who owns which node, and how ghost values travel between MPI ranks.

A rank holds the cells it owns and every node they touch. Nodes owned by the rank come first in its local numbering,
ghosts (owned by another rank) follow. In a serial run there are no ghosts and every operation is the identity.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from femdeform.errors import MissingDependencyError
from femdeform.types import FloatArray, IntArray

_SIZE_VARIABLES = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "MV2_COMM_WORLD_SIZE")
_RANK_VARIABLES = ("OMPI_COMM_WORLD_RANK", "PMI_RANK", "MV2_COMM_WORLD_RANK")


def _first_integer(variables: tuple[str, ...], default: int) -> int:
    for name in variables:
        if os.environ.get(name, "").isdigit():
            return int(os.environ[name])
    return default


def launched_ranks() -> int:
    """Number of ranks the process was launched with, read from the launcher's environment (no MPI start-up)."""
    return _first_integer(_SIZE_VARIABLES, 1)


def launched_rank() -> int:
    """Rank of this process, read from the launcher's environment."""
    return _first_integer(_RANK_VARIABLES, 0)


def world() -> Any | None:
    """Return the world communicator, or None in a serial run (mpi4py is then never imported).

    Raises
    ------
    MissingDependencyError
        If several ranks were launched but mpi4py is not installed.
    """
    if launched_ranks() == 1:
        return None
    try:
        from mpi4py import MPI
    except ImportError as error:
        message = f"{launched_ranks()} ranks need mpi4py, which cannot be imported: {error}"
        raise MissingDependencyError(message) from None
    return MPI.COMM_WORLD


class Partition:
    """The nodes of one rank, and the exchange of their values with the other ranks.

    Parameters
    ----------
    owner : (n_nodes,) int64
        Owning rank of every node of the whole problem.
    local_nodes : (n_local,) int64
        Nodes that this rank's cells touch, together with those it owns, in any order.
    comm : mpi4py communicator or None
        None for a serial run.

    Attributes
    ----------
    n_owned, n_local, n_global : int
        Counts of nodes owned by this rank, held by it, and of the whole problem.
    nodes : (n_local,) int64
        Number of each local node in the whole problem (the order of the input).
    global_index : (n_local,) int64
        Number of each local node in the rank-contiguous order of the distributed vectors.
    """

    def __init__(self, owner: IntArray, local_nodes: IntArray, comm: Any | None = None) -> None:
        self.comm = comm
        self.rank: int = 0 if comm is None else comm.Get_rank()
        self.size: int = 1 if comm is None else comm.Get_size()
        self.n_global = int(owner.size)
        nodes = np.unique(local_nodes)
        is_owned = owner[nodes] == self.rank
        ghosts = nodes[~is_owned]
        # Ghosts grouped by owner, so that each message is one slice.
        ghosts = ghosts[np.argsort(owner[ghosts], kind="stable")]
        self.nodes: IntArray = np.concatenate([nodes[is_owned], ghosts])
        self.n_owned = int(np.count_nonzero(is_owned))
        self.n_local = int(self.nodes.size)

        counts = np.bincount(owner, minlength=self.size)
        self.first_owned = int(counts[: self.rank].sum())
        position = np.empty(self.n_global, dtype=np.int64)
        # A stable sort by owner keeps the input's order inside each rank.
        position[np.argsort(owner, kind="stable")] = np.arange(self.n_global)
        self.global_index: IntArray = position[self.nodes]

        self._receive: list[tuple[int, slice]] = []
        self._send: list[tuple[int, IntArray]] = []
        if comm is not None:
            self._build_exchange(owner[ghosts], ghosts)

    @classmethod
    def serial(cls, n_nodes: int) -> Partition:
        """Return the partition of a serial run: every node owned, no ghosts."""
        return cls(np.zeros(n_nodes, dtype=np.int64), np.arange(n_nodes, dtype=np.int64))

    def _build_exchange(self, ghost_owner: IntArray, ghosts: IntArray) -> None:
        assert self.comm is not None
        wanted: list[IntArray] = []
        for rank in range(self.size):
            where = np.flatnonzero(ghost_owner == rank)
            wanted.append(ghosts[where])
            if where.size:
                start = self.n_owned + int(where[0])
                self._receive.append((rank, slice(start, start + where.size)))
        requested: list[IntArray] = self.comm.alltoall(wanted)
        owned = self.nodes[: self.n_owned]
        for rank, asked in enumerate(requested):
            if asked.size:
                self._send.append((rank, np.searchsorted(owned, asked)))

    def update_ghosts(self, values: FloatArray) -> None:
        """Overwrite ghost rows of `values` (n_local, ...) by their owner's, in place."""
        if self.comm is None:
            return
        requests = []
        buffers = []
        for rank, part in self._receive:
            buffer = np.empty((part.stop - part.start, *values.shape[1:]))
            buffers.append((part, buffer))
            requests.append(self.comm.Irecv(buffer, source=rank, tag=1))
        for rank, index in self._send:
            requests.append(self.comm.Isend(np.ascontiguousarray(values[index]), dest=rank, tag=1))
        _wait_all(requests)
        for part, buffer in buffers:
            values[part] = buffer

    def accumulate(self, values: FloatArray) -> None:
        """Add ghost rows of `values` (n_local, ...) to their owner's row, then update the ghosts, in place."""
        if self.comm is None:
            return
        requests = []
        buffers = []
        for rank, index in self._send:
            buffer = np.empty((index.size, *values.shape[1:]))
            buffers.append((index, buffer))
            requests.append(self.comm.Irecv(buffer, source=rank, tag=2))
        for rank, part in self._receive:
            requests.append(self.comm.Isend(np.ascontiguousarray(values[part]), dest=rank, tag=2))
        _wait_all(requests)
        # In order of rank, so that the sum does not depend on which message came first.
        for index, buffer in buffers:
            values[index] += buffer
        self.update_ghosts(values)

    def sum(self, value: float) -> float:
        """Sum of one number over the ranks."""
        return value if self.comm is None else float(self.comm.allreduce(value))

    def max(self, value: float) -> float:
        """Maximum of one number over the ranks; NaN wins."""
        if self.comm is None:
            return value
        return float(np.max(self.comm.allgather(value)))

    def min(self, value: float) -> float:
        """Minimum of one number over the ranks; NaN wins."""
        return -self.max(-value)

    def dot(self, a: FloatArray, b: FloatArray) -> float:
        """Inner product of two node fields (n_local, ...), each node counted once."""
        # Not BLAS: it would start threads of its own, which wait busily and take the cores from the kernels.
        return self.sum(float(np.einsum("i,i->", a[: self.n_owned].ravel(), b[: self.n_owned].ravel())))

    def norm(self, a: FloatArray) -> float:
        """Euclidean norm of a node field, each node counted once."""
        return float(np.sqrt(self.dot(a, a)))

    def gather(self, values: FloatArray) -> FloatArray | None:
        """Return a node field of the whole problem, in the order of the input, on rank 0; None elsewhere."""
        if self.comm is None:
            return np.array(values)
        parts = self.comm.gather((self.nodes[: self.n_owned], values[: self.n_owned]), root=0)
        return None if parts is None else self._joined(parts)

    def everywhere(self, values: FloatArray) -> FloatArray:
        """Return a node field of the whole problem, in the order of the input, on every rank."""
        if self.comm is None:
            return np.array(values)
        return self._joined(self.comm.allgather((self.nodes[: self.n_owned], values[: self.n_owned])))

    def _joined(self, parts: list[tuple[IntArray, FloatArray]]) -> FloatArray:
        whole = np.empty((self.n_global, *parts[0][1].shape[1:]))
        for nodes, part in parts:
            whole[nodes] = part
        return whole

    def restrict(self, whole: FloatArray) -> FloatArray:
        """Return this rank's rows of a node field of the whole problem."""
        return np.ascontiguousarray(whole[self.nodes])


def _wait_all(requests: list[Any]) -> None:
    from mpi4py import MPI

    MPI.Request.Waitall(requests)
