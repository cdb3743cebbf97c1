"""Conjugate gradients on condensed mixed systems, preconditioned by a constant matrix that is factorised once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.fem.assembly import SparseHessian
from femdeform.fem.discretization import ElementGroup
from femdeform.parallel import Partition
from femdeform.types import FloatArray, IntArray
from solvers.linear.interface import LinearResult
from solvers.linear.kkt_matrix import SaddleMatrix, make_matrix


@dataclass(frozen=True)
class _Nodes:
    """One unknown a node, numbered as the partition numbers its nodes."""

    partition: Partition
    n_owned: int
    n_global: int


class ConstantCG:
    """K dx = b with P = M/h^2 + 2 mu J^T V J as preconditioner (methods.md 2.7 iii; the paper's constant matrix).

    P couples no components: it is one scalar matrix over the nodes for each set of components that are prescribed
    together, factorised when the time step changes. With rotations R the condensed matrix K+ has
    R (2 mu I + ..) R^T where P has 2 mu I, so the spectrum of P^-1 K+ lies in (0, (2 mu + 3 lmbda) / (2 mu)] at rest;
    its lower end is Korn's constant of the body and its supports.

    Parameters
    ----------
    groups : sequence of ElementGroup
    tolerance : float
        Residual over the right-hand side [-].
    max_iterations : int

    References
    ----------
    T. Trusty, D. M. Kaufman, D. I. W. Levin, Mixed variational finite elements for implicit simulation of deformables
    (2022), section 4.

    Limitations
    -----------
    Contact, pressure and strains far from rest are in K and not in P: they cost iterations. K has to be positive
    definite; where it is not the solver says so. Serial factors are SuperLU's, which solves three right-hand sides
    faster than MUMPS here; several ranks use MUMPS.
    """

    name = "constant_cg"

    def __init__(self, groups: Sequence[ElementGroup], tolerance: float, max_iterations: int) -> None:
        self._groups = list(groups)
        self.tolerance = tolerance
        self.max_iterations = max_iterations
        self._key: tuple[float, bool] | None = None
        # Components of the same pattern of prescribed nodes, and the factorised matrix they share.
        self._parts: list[tuple[IntArray, SaddleMatrix]] = []
        self._failure = ""

    def begin(self, problem: Any) -> None:
        """Make the factors for a step of `problem` (an `IncrementalPotential`) if the last ones are of another dt."""
        key = (problem.dt, problem.quasistatic)
        if key == self._key:
            return
        self.destroy()
        self._key = key
        partition: Partition = problem.partition
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
            matrix = make_matrix(partition.comm is not None, nodes, index[rows], index[columns])
            matrix.set_values(kept)
            self._failure = self._failure or matrix.factorise()
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
        if not problem.quasistatic:
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

    def solve(self, K: SparseHessian, b: FloatArray) -> LinearResult:
        """Solve K x = b; see `LinearSolver`."""
        import scipy.sparse

        partition = K.partition
        x = np.zeros_like(b)
        if self._failure:
            return LinearResult(x, 0, False, f"the constant matrix: {self._failure}")
        size = b.size
        matrix = scipy.sparse.csr_matrix((K.values, K.columns, K.row_offsets), shape=(size, size))
        r = b.copy()
        target, norm = self.tolerance * partition.norm(b), partition.norm(b)
        iteration, p, rz = 0, np.zeros_like(b), 1.0
        while norm > target and iteration < self.max_iterations:
            z = self._precondition(r, partition)
            rz, previous = partition.dot(r, z), rz
            p = z if iteration == 0 else z + (rz / previous) * p
            Kp = np.ascontiguousarray((matrix @ p.ravel()).reshape(p.shape))
            partition.accumulate(Kp)
            curvature = partition.dot(p, Kp)
            if not curvature > 0.0:
                return LinearResult(x, iteration, False, "the matrix is not positive definite, or not finite")
            x += (rz / curvature) * p
            r -= (rz / curvature) * Kp
            norm = partition.norm(r)
            iteration += 1
        converged = norm <= target
        return LinearResult(x, iteration, converged, "converged" if converged else f"{iteration} conjugate gradients")

    def _precondition(self, r: FloatArray, partition: Partition) -> FloatArray:
        z = np.zeros_like(r)
        n = partition.n_owned
        for components, matrix in self._parts:
            if partition.comm is None:
                z[:, components] = matrix.apply_inverse(r[:, components])
            else:
                for c in components:
                    z[:n, c] = matrix.apply_inverse(r[:n, c])
        partition.update_ghosts(z)
        return z

    def reset(self) -> None:
        """See `LinearSolver`."""
        self.destroy()

    def destroy(self) -> None:
        """See `LinearSolver`."""
        for _, matrix in self._parts:
            matrix.destroy()
        self._parts, self._key, self._failure = [], None, ""
