"""Which rank has which grid nodes and which quadrature points of an implicit step.

All ranks hold all material points, samples and grid nodes. For the solve the nodes are cut, in lexicographic order,
into one piece for each rank with about as many points in each; a point belongs to the rank of its middle node, whose
weight is never zero. A rank then sees its points and the nodes that they reach, like the cells of a mesh
(`femdeform.parallel`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.counting_sort import sort_by_number
from femdeform.mpm.grid import Stencils
from femdeform.parallel import Partition
from femdeform.types import IntArray


@dataclass(frozen=True)
class NodeShare:
    """What a rank has of a step.

    Attributes
    ----------
    partition : Partition
        Of the grid nodes; `partition.nodes` are their numbers among all.
    particles, samples : (n,) int64
        Material points and samples of the surface that are integrated here.
    stencils : Stencils
        Of these, in this order, over the local nodes.
    """

    partition: Partition
    particles: IntArray
    samples: IntArray
    stencils: Stencils


def share_out(stencils: Stencils, n_particles: int, n_samples: int, comm: Any | None) -> NodeShare:
    """Share nodes and points out to ranks; all of them to the only one where there is no communicator.

    Parameters
    ----------
    stencils : Stencils
        Quadratic ones of the material points, then of the samples, then of anything else; the same on all ranks.
    n_particles, n_samples : int
        Numbers of points.
    comm : mpi4py communicator or None
        Every rank calls.
    """
    if comm is None:
        everything = (np.arange(n_particles), np.arange(n_samples))
        return NodeShare(Partition.serial(stencils.n_nodes), *everything, stencils)
    n, size = n_particles + n_samples, stencils.weights.shape[1]
    middle = stencils.nodes[:n, size // 2]
    # A row of the matrix costs about as much as a point.
    work = np.cumsum(1.0 + np.bincount(middle, minlength=stencils.n_nodes))
    owner = np.minimum((comm.Get_size() * work / work[-1] * (1.0 - 1e-12)).astype(np.int64), comm.Get_size() - 1)
    rows = np.flatnonzero(owner[middle] == comm.Get_rank())
    weights = np.ascontiguousarray(stencils.weights[rows])
    reached = stencils.nodes[rows][weights > 0.0]
    own = np.flatnonzero(owner == comm.Get_rank())
    partition = Partition(owner, np.concatenate([own, reached]), comm)
    local = np.zeros(stencils.n_nodes, dtype=np.int32)
    local[partition.nodes] = np.arange(partition.n_local)
    nodes = np.where(weights > 0.0, local[stencils.nodes[rows]], 0).astype(np.int32)
    # Entries without weight are sorted behind those of the last node.
    numbers = np.where(weights > 0.0, nodes, partition.n_local).ravel()
    entries, offsets = sort_by_number(numbers, partition.n_local + 1)
    mine = Stencils(
        stencils.spacing,
        stencils.degree,
        partition.restrict(stencils.positions),
        nodes,
        weights,
        np.ascontiguousarray(stencils.gradients[rows]),
        offsets[:-1].astype(np.int64),
        entries.astype(np.int64),
    )
    cut = int(np.searchsorted(rows, n_particles))
    return NodeShare(partition, rows[:cut], rows[cut:] - n_particles, mine)
