"""Contact between bodies, and of bodies with themselves, by weak constraints that are found anew in each step.

A vertex and its closest point on the other surface make a row ``C = x_v - sum_j w_j x_j`` with the normal n out of
that surface, both frozen over the step. Energy of a row: ``k/2 min(0, n.C - d)^2``, d the thickness: it pushes and
never pulls, is convex and continuously differentiable, and its second derivative ``k n n^T`` is there or not. Rows
that push when the step begins resist sliding with ``k_t/2 |(I - n n^T)(C - C_start)|^2``.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse

from femdeform.contact.near_pairs import NearPairSearch
from femdeform.contact.terms import NodeBlocks
from femdeform.types import BoolArray, FloatArray, IntArray


class WeakContact:
    """Contact rows of the step begun, as a term over cells of dim + 1 nodes: a vertex and the corners of a facet.

    Parameters
    ----------
    search : NearPairSearch
        Finds vertices near surfaces.
    normal, tangential : (n_vertices,) float64
        Stiffness of the row of each vertex along the normal and across it [N/m].
    thickness : float
        Distance of a vertex from a surface below which it is pushed away [m].

    Attributes
    ----------
    cells : (n, dim + 1) int32
        Nodes: the vertex, then the facet.
    weights : (n, dim + 1) float64
        1 and minus the barycentric coordinates: they add up to zero [-].
    normals : (n, dim) float64
        Directions of the push on the vertex.

    References
    ----------
    Y. Chen, Y. Han, J. Chen, J. Teran, Position-Based Nonlinear Gauss-Seidel for Quasistatic Hyperelasticity (2023),
    for collisions by dynamic weak constraints. A. McAdams et al., Efficient elasticity for character skinning with
    contact and collisions (2011).

    Limitations
    -----------
    Penetration is force over stiffness. A row stands for the tangent plane at the closest point of the accepted state:
    what slides by more than a facet in one step, or around an edge, is held a step late. Linear momentum is conserved,
    angular momentum up to the sliding in a step. Friction is none of Coulomb's: `tangential` is a drag. See
    `NearPairSearch` for what is not found.
    """

    def __init__(self, search: NearPairSearch, normal: FloatArray, tangential: FloatArray, thickness: float) -> None:
        self._search = search
        self._stiffness = normal
        self._drag = tangential
        self.thickness = thickness
        dim = search.surface.dim
        self._set_rows(np.empty((0, dim + 1), np.int32), np.empty((0, dim + 1)), np.empty((0, dim)))
        self.normal_stiffness = self.tangential_stiffness = np.empty(0)
        self._start = np.empty((0, dim))

    def begin_step(self, x: FloatArray, ahead: FloatArray) -> None:
        """Find the rows of a step.

        Parameters
        ----------
        x : (n_nodes, dim) float64
            The accepted state [m].
        ahead : (n_nodes, dim) float64
            Where nodes are expected at the end of the step [m]. Nothing else is looked at, so that a run that goes on
            from a checkpoint finds the same rows.
        """
        nodes = self._search.surface.nodes
        found = self._search(x[nodes], ahead[nodes])
        cells = nodes[np.concatenate([found.vertices[:, None], found.corners], axis=1)].astype(np.int32)
        weights = np.concatenate([np.ones((len(cells), 1)), -found.weights], axis=1)
        self._set_rows(cells, weights, found.normals)
        self.normal_stiffness = self._stiffness[found.vertices]
        self._start = self._offsets(x)
        pushes = self._gaps(self._start) < 0.0
        self.tangential_stiffness = self._drag[found.vertices] * pushes

    def _set_rows(self, cells: np.ndarray, weights: FloatArray, normals: FloatArray) -> None:
        self.cells, self.weights, self.normals = cells, weights, normals
        a, b = np.triu_indices(cells.shape[1])
        self._products = weights[:, a] * weights[:, b]
        first, second = cells[:, a].astype(np.int64).ravel(), cells[:, b].astype(np.int64).ravel()
        low, high = np.minimum(first, second), np.maximum(first, second)
        size = int(cells.max(initial=0)) + 1
        pairs, place = np.unique(low * size + high, return_inverse=True)
        self._pair_rows, self._pair_columns = pairs // size, pairs % size
        entries = (np.ones(low.size), (place.ravel(), np.arange(low.size)))
        self._gather = scipy.sparse.csr_matrix(entries, shape=(pairs.size, low.size))

    # ------------------------------------------------------------------------------------------- the function

    def _offsets(self, x: FloatArray) -> FloatArray:
        """C of every row (n, dim) [m]."""
        return np.asarray(np.einsum("na,nac->nc", self.weights, x[self.cells]))

    def _gaps(self, C: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("nc,nc->n", self.normals, C) - self.thickness)

    def _slid(self, C: FloatArray) -> FloatArray:
        """How far each row has slid since the step began (n, dim) [m]."""
        moved = C - self._start
        return np.asarray(moved - np.einsum("nc,nc->n", moved, self.normals)[:, None] * self.normals)

    def gaps(self, x: FloatArray) -> FloatArray:
        """n.C less the thickness, of every row: negative where it pushes (n,) [m]."""
        return self._gaps(self._offsets(x))

    def pushing(self, x: FloatArray) -> BoolArray:
        """Which rows push, those that just touch included (n,)."""
        return np.asarray(self.gaps(x) <= 0.0)

    def stored_energy(self, x: FloatArray) -> float:
        """Energy of penetration [J]."""
        return 0.5 * float(np.dot(self.normal_stiffness, np.minimum(self.gaps(x), 0.0) ** 2))

    def value(self, x: FloatArray) -> float:
        """Energy of penetration and of sliding in the step [J]."""
        slid = self._slid(self._offsets(x))
        return self.stored_energy(x) + 0.5 * float(np.dot(self.tangential_stiffness, np.sum(slid**2, axis=1)))

    def gradient(self, x: FloatArray, slots: FloatArray, first: int) -> None:
        """Write each row's gradient [N] to rows of `slots` (n_slots, dim) from `first` on."""
        C = self._offsets(x)
        push = (self.normal_stiffness * np.minimum(self._gaps(C), 0.0))[:, None] * self.normals
        push += self.tangential_stiffness[:, None] * self._slid(C)
        parts = self.weights[:, :, None] * push[:, None, :]
        slots[first : first + self.cells.size] = parts.reshape(self.cells.size, -1)

    def hessian(
        self, x: FloatArray, project: bool, blocks: FloatArray, first: int, pushing: BoolArray | None = None
    ) -> None:
        """Write the upper block triangle of each row's second derivative [N/m] to rows of `blocks` from `first` on.

        It is positive semi-definite. At a gap of zero, where there are two, the pushing one; `pushing` (n,) says itself
        which rows push.
        """
        dim = self.normals.shape[1]
        outer = self.normals[:, :, None] * self.normals[:, None, :]
        normal = np.where(self.pushing(x) if pushing is None else pushing, self.normal_stiffness, 0.0)
        K = (normal - self.tangential_stiffness)[:, None, None] * outer
        K += self.tangential_stiffness[:, None, None] * np.eye(dim)
        parts = self._products[:, :, None] * K.reshape(len(K), 1, dim * dim)
        blocks[first : first + self._products.size] = parts.reshape(self._products.size, dim * dim)

    def add_gradient(self, x: FloatArray, out: FloatArray) -> None:
        """Add the energy gradient [N] to `out` (n_nodes, dim)."""
        if not len(self.cells):
            return
        slots = np.empty((self.cells.size, x.shape[1]))
        self.gradient(x, slots, 0)
        np.add.at(out, self.cells.ravel(), slots)

    def hessian_blocks(self, x: FloatArray, project: bool) -> NodeBlocks:
        """Second derivative [N/m], with the pairs of all rows, pushing or not: they do not change in a step."""
        blocks = np.empty((self._products.size, x.shape[1] ** 2))
        self.hessian(x, project, blocks, 0)
        total = np.asarray(self._gather @ blocks)
        upper, own = self._pair_rows < self._pair_columns, self._pair_rows == self._pair_columns
        return NodeBlocks(
            self._pair_rows[upper], self._pair_columns[upper], total[upper], self._pair_rows[own], total[own]
        )

    # --------------------------------------------------------------------------------------------- looking inside

    def nodes(self) -> IntArray:
        """Nodes of all rows of the step, ascending."""
        return np.unique(self.cells).astype(np.int64)

    def count(self, x: FloatArray) -> int:
        """Number of rows that push."""
        return int(np.count_nonzero(self.gaps(x) < 0.0))

    def penetration(self, x: FloatArray) -> float:
        """Largest depth of a vertex, from the thickness on [m]; 0 where none pushes."""
        return float(-self.gaps(x).min(initial=0.0))

    def touching(self, x: FloatArray) -> BoolArray:
        """Nodes of rows that push, each corner of a facet that takes part, (n_nodes,)."""
        marked = np.zeros(len(x), dtype=bool)
        pushes = self.gaps(x) < 0.0
        marked[self.cells[pushes][self.weights[pushes] != 0.0]] = True
        return marked
