"""The constant matrix near every condensed mixed system, factorised once: a preconditioner at any stiffness."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.fem.discretization import ElementGroup
from femdeform.parallel import Partition
from femdeform.types import FloatArray, IntArray
from solvers.linear.kkt_matrix import SaddleMatrix, make_matrix

# Without inertia a body that nothing holds moves at no cost: its diagonal is raised by this part.
_SHIFT = 1e-6


@dataclass(frozen=True)
class _Nodes:
    """One unknown a node, numbered as the partition numbers its nodes."""

    partition: Partition
    n_owned: int
    n_global: int


class ConstantMatrix:
    """P = M/h^2 + 2 mu J^T V J, the paper's constant matrix with its volumes.

    P couples no components: it is one scalar matrix over the nodes for each set of components that are prescribed
    together, factorised when the time step changes. With rotations R the condensed matrix K+ has
    R (2 mu I + ..) R^T where P has 2 mu I, so the spectrum of P^-1 K+ lies in (0, (2 mu + 3 lmbda) / (2 mu)] at rest;
    its lower end is Korn's constant of the body and its supports.

    Parameters
    ----------
    groups : sequence of ElementGroup

    References
    ----------
    T. Trusty, D. M. Kaufman, D. I. W. Levin, Mixed variational finite elements for implicit simulation of deformables
    (2022), section 4.

    Limitations
    -----------
    Contact, pressure and strains far from rest are not in P. Serial factors are SuperLU's, which solves three
    right-hand sides at once, faster than MUMPS one by one; several ranks use MUMPS.
    """

    def __init__(self, groups: Sequence[ElementGroup]) -> None:
        self._groups = list(groups)
        self._key: tuple[float, bool] | None = None
        # Components of the same pattern of prescribed nodes, and the factorised matrix they share.
        self._parts: list[tuple[IntArray, SaddleMatrix]] = []
        self._is_serial = True
        self.failure = ""

    def begin(self, problem: Any) -> None:
        """Make the factors for a step of `problem` (an `IncrementalPotential`) if the last ones are of another dt."""
        key = (problem.dt, problem.quasistatic)
        if key == self._key:
            return
        self.destroy()
        self._key = key
        partition: Partition = problem.partition
        self._is_serial = partition.comm is None
        nodes = _Nodes(partition, partition.n_owned, partition.n_global)
        rows, columns, values = self._scalar_entries(problem)
        masks, which = np.unique(problem.free, axis=1, return_inverse=True)
        for k in range(masks.shape[1]):
            free = masks[:, k]
            kept = np.where(free[rows] & free[columns], values, 0.0)
            kept[-free.size :] = np.where(free, kept[-free.size :], 1.0)
            # What other ranks add to the diagonal of a ghost is theirs.
            kept[-free.size :][nodes.n_owned :] = 0.0
            index = partition.global_index
            matrix = make_matrix(not self._is_serial, nodes, index[rows], index[columns])
            matrix.set_values(kept)
            self.failure = self.failure or matrix.factorise()
            self._parts.append((np.flatnonzero(which.ravel() == k), matrix))

    def _scalar_entries(self, problem: Any) -> tuple[IntArray, IntArray, FloatArray]:
        """Local rows, columns and values of the scalar matrix; the diagonal of every node comes last."""
        rows, columns, values = [], [], []
        for group in self._groups:
            n = group.cells.shape[1]
            stiffness = 2.0 * group.law.mu * group.weights
            rows.append(np.repeat(group.cells, n, axis=1).ravel())
            columns.append(np.tile(group.cells, (1, n)).ravel())
            values.append(np.einsum("eq,eqai,eqbi->eab", stiffness, group.gradients, group.gradients).ravel())
        diagonal = np.zeros(problem.partition.n_local)
        if problem.quasistatic:
            for group in self._groups:
                stiffness = 2.0 * group.law.mu * group.weights
                own = np.einsum("eq,eqai,eqai->ea", stiffness, group.gradients, group.gradients)
                diagonal += _SHIFT * np.bincount(group.cells.ravel(), own.ravel(), diagonal.size)
            problem.partition.accumulate(diagonal)
        else:
            mass = problem.discretization.consistent_mass
            if mass is None:
                diagonal += problem.discretization.lumped_mass / problem.dt**2
            else:
                entries = mass.tocoo()
                rows.append(entries.row)
                columns.append(entries.col)
                values.append(entries.data / problem.dt**2)
        everyone = np.arange(diagonal.size)
        r, c = np.concatenate([*rows, everyone]), np.concatenate([*columns, everyone])
        return r.astype(np.int64), c.astype(np.int64), np.concatenate([*values, diagonal])

    def solve(self, r: FloatArray) -> FloatArray:
        """Return P^-1 r for this rank's nodes, (n_owned, dim)."""
        z = np.empty_like(r)
        for components, matrix in self._parts:
            if self._is_serial:
                z[:, components] = matrix.apply_inverse(r[:, components])
            else:
                for c in components:
                    z[:, c] = matrix.apply_inverse(r[:, c])
        return z

    def reset(self) -> None:
        """Drop the factors: the next `begin` makes them anew."""
        self.destroy()

    def destroy(self) -> None:
        """Free the factors."""
        for _, matrix in self._parts:
            matrix.destroy()
        self._parts, self._key, self.failure = [], None, ""
