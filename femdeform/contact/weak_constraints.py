"""Weak constraints: energies that hold interpolated points of bodies together, or to points of space.

Linear: ``1/2 C^T K C`` with ``C = sum_j w_j x_j - c``, where ``w_j = w0_j - w1_j`` are the weights of two points and c
is where the constraint has no force, which may move. Springs: ``1/2 k (|C| - L)^2``, which for L = 0 is the linear one
with ``K = k I``. Weights of two points of bodies add up to zero, those of one point held in space to one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femdeform.types import FloatArray, IntArray


@dataclass(frozen=True)
class ConstraintRows:
    """Weak constraints, one a row.

    Attributes
    ----------
    offsets : (n + 1,) int64
        Where each row's nodes begin in `nodes` and `weights`.
    nodes : (n_entries,) int64
        Nodes, each once a row, their weights not zero.
    weights : (n_entries,) float64
        ``w0 - w1`` [-].
    target : (n, dim) float64
        C without force at time 0 [m].
    velocity : (n, dim) float64
        Velocity of the target [m/s].
    length : (n,) float64
        Length L of a spring without force; 0 for linear constraints [m].
    normal, tangential : (n,) float64
        Stiffness along `direction` and across it [N/m]; equal for springs and isotropic constraints.
    direction : (n, dim) float64
        Unit vectors; zero where stiffness is isotropic, or where the direction is the normal of a facet.
    facets : (n, dim) int64
        Corners of the facet whose normal is the direction; -1 elsewhere.
    link : (n,) int64
        Number of the link in the scene that each row is of.
    """

    offsets: IntArray
    nodes: IntArray
    weights: FloatArray
    target: FloatArray
    velocity: FloatArray
    length: FloatArray
    normal: FloatArray
    tangential: FloatArray
    direction: FloatArray
    facets: IntArray
    link: IntArray

    @property
    def n_rows(self) -> int:
        """Number of constraints."""
        return int(self.length.size)

    def select(self, chosen: IntArray) -> ConstraintRows:
        """Return some of the rows, in that order."""
        counts = np.diff(self.offsets)[chosen]
        offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        entries = np.repeat(self.offsets[:-1][chosen] - offsets[:-1], counts) + np.arange(offsets[-1])
        return ConstraintRows(
            offsets,
            self.nodes[entries],
            self.weights[entries],
            self.target[chosen],
            self.velocity[chosen],
            self.length[chosen],
            self.normal[chosen],
            self.tangential[chosen],
            self.direction[chosen],
            self.facets[chosen],
            self.link[chosen],
        )

    def coupled(self) -> tuple[IntArray, IntArray]:
        """Pairs of nodes: the first of a row, and one that whoever evaluates the row has to know."""
        owner = self.nodes[self.offsets[:-1]]
        turning = np.flatnonzero(self.facets[:, 0] >= 0)
        corners = self.facets[turning]
        return (
            np.concatenate([np.repeat(owner, np.diff(self.offsets)), np.repeat(owner[turning], corners.shape[1])]),
            np.concatenate([self.nodes, corners.ravel()]),
        )

    def local(self, numbers: IntArray, n_owned: int) -> ConstraintRows:
        """Return the rows of this rank, in its numbering: those whose first node it owns.

        Parameters
        ----------
        numbers : (n_global,) int64
            Local number of each node of the whole problem, -1 where this rank does not hold it.
        n_owned : int
            Nodes this rank owns; they come first.
        """
        first = numbers[self.nodes[self.offsets[:-1]]]
        mine = self.select(np.flatnonzero((first >= 0) & (first < n_owned)))
        facets = np.where(mine.facets >= 0, numbers[mine.facets], -1)
        return ConstraintRows(**{**vars(mine), "nodes": numbers[mine.nodes], "facets": facets})


class WeakConstraints:
    """The weak constraints of one rank.

    Rows are sorted by their number of nodes, so that each width is one array of cells; `terms` has one a width.

    Parameters
    ----------
    rows : ConstraintRows
        In local numbering.

    Attributes
    ----------
    rows : ConstraintRows
        Sorted. With `stiffness` and `target` all that a sweep over nodes needs, see `by_node`.
    stiffness : (n, dim, dim) float64
        K [N/m], frozen over a step; k I for springs.
    direction : (n, dim) float64
        Unit vectors along which the stiffness is `rows.normal`, frozen over a step; zero where there is none.
    target : (n, dim) float64
        c at the end of the step [m].
    terms : list of WeakConstraintTerm
        Terms of an incremental potential.

    References
    ----------
    A. McAdams et al., Efficient elasticity for character skinning with contact and collisions (2011), for weak
    constraints between interpolated points.

    Limitations
    -----------
    Linear constraints with a target other than zero, or with stiffness that differs between directions, push along
    lines that need not pass through both points: they conserve linear momentum, not angular momentum. A spring that
    has shrunk to a point has no direction and pushes nowhere.
    """

    def __init__(self, rows: ConstraintRows) -> None:
        order = np.argsort(np.diff(rows.offsets), kind="stable")
        self.rows = rows = rows.select(order)
        self.dim = int(rows.target.shape[1])
        self.target = rows.target.copy()
        self.stiffness = np.empty((rows.n_rows, self.dim, self.dim))
        self.direction = rows.direction.copy()
        self._turning = np.flatnonzero(rows.facets[:, 0] >= 0)
        self._set_stiffness()
        widths = np.diff(rows.offsets)
        self.terms = [
            WeakConstraintTerm(self, slice(*np.searchsorted(widths, [width, width + 1]))) for width in np.unique(widths)
        ]

    def _set_stiffness(self) -> None:
        """K = k_n n n^T + k_t (I - n n^T); k_t I where there is no direction."""
        outer = self.direction[:, :, None] * self.direction[:, None, :]
        difference = (self.rows.normal - self.rows.tangential)[:, None, None]
        self.stiffness[:] = self.rows.tangential[:, None, None] * np.eye(self.dim) + difference * outer

    def begin_step(self, x: FloatArray, time: float) -> None:
        """Place the targets of a step to `time` and freeze the normals of facets at the accepted state `x`."""
        self.target[:] = self.rows.target + time * self.rows.velocity
        if self._turning.size:
            self.direction[self._turning] = facet_normals(x[self.rows.facets[self._turning]])
            self._set_stiffness()

    def by_node(self, n_nodes: int) -> tuple[IntArray, IntArray, FloatArray]:
        """Constraints of every node, for sweeps that visit nodes.

        The part of a constraint in the gradient at its node of weight w is ``w f``, in the node's diagonal Hessian
        block ``w^2 H``: for length 0 with ``f = K C`` and ``H = K``, for springs with ``f = k (1 - L/|C|) C`` and ``H =
        k [n n^T + max(1 - L/|C|, 0) (I - n n^T)]``, n = C/|C|, k = K_00.

        Returns
        -------
        offsets : (n_nodes + 1,) int64
            Where the entries of each node begin.
        constraints : (n_entries,) int64
            Rows, increasing for each node.
        weights : (n_entries,) float64
            Weight of the node in the row [-].
        """
        row = np.repeat(np.arange(self.rows.n_rows), np.diff(self.rows.offsets))
        order = np.argsort(self.rows.nodes, kind="stable")
        counts = np.bincount(self.rows.nodes, minlength=n_nodes)
        offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        return offsets, row[order], self.rows.weights[order]

    def add_gradient(self, x: FloatArray, out: FloatArray) -> None:
        """Add the gradient of this rank's rows [N] to ``out`` (n_local, dim)."""
        for term in self.terms:
            slots = np.empty((term.cells.size, self.dim))
            term.gradient(x, slots, 0)
            for a in range(self.dim):
                out[:, a] += np.bincount(term.cells.ravel(), slots[:, a], minlength=len(out))

    # ------------------------------------------------------------------------------------- what is measured

    def _of_link(self, x: FloatArray, link: int | None) -> tuple[IntArray, FloatArray]:
        """Rows of a link, or all, and their C [m]."""
        chosen = np.arange(self.rows.n_rows) if link is None else np.flatnonzero(self.rows.link == link)
        C = np.concatenate([np.empty((0, self.dim)), *(term.offsets(x) for term in self.terms)])
        return chosen, C[chosen]

    def gap(self, x: FloatArray, link: int | None = None) -> float:
        """Largest |C|, for springs | |C| - L |, of a link or of all [m]; 0 where this rank has none."""
        chosen, C = self._of_link(x, link)
        return float(np.abs(np.linalg.norm(C, axis=1) - self.rows.length[chosen]).max(initial=0.0))

    def energy(self, x: FloatArray, link: int | None = None) -> float:
        """Energy of this rank's rows of a link, or of all [J]."""
        chosen, C = self._of_link(x, link)
        return float(np.sum(_energies(C, self.stiffness[chosen], self.rows.length[chosen])))

    def force(self, x: FloatArray, link: int) -> FloatArray:
        """Sum of the forces on the first points of this rank's rows of a link (dim,) [N]."""
        chosen, C = self._of_link(x, link)
        return np.asarray(-_slopes(C, self.stiffness[chosen], self.rows.length[chosen]).sum(axis=0))


class WeakConstraintTerm:
    """The rows of one width, as a term of the incremental potential."""

    def __init__(self, constraints: WeakConstraints, part: slice) -> None:
        rows = constraints.rows
        entries = slice(int(rows.offsets[part.start]), int(rows.offsets[part.stop]))
        n = part.stop - part.start
        self.cells = rows.nodes[entries].reshape(n, -1).astype(np.int32)
        self.weights = rows.weights[entries].reshape(n, -1)
        self.length = rows.length[part]
        # Views: they follow `WeakConstraints.begin_step`.
        self._stiffness = constraints.stiffness[part]
        self._target = constraints.target[part]
        a, b = np.triu_indices(self.cells.shape[1])
        self._products = self.weights[:, a] * self.weights[:, b]

    def offsets(self, x: FloatArray) -> FloatArray:
        """C of every row (n, dim) [m]."""
        return np.asarray(np.einsum("na,nac->nc", self.weights, x[self.cells]) - self._target)

    def value(self, x: FloatArray) -> float:
        """Energy [J]."""
        return float(np.sum(_energies(self.offsets(x), self._stiffness, self.length)))

    def gradient(self, x: FloatArray, slots: FloatArray, first: int) -> None:
        """Write each row's gradient [N] to rows of `slots` (n_slots, dim) from `first` on."""
        slope = _slopes(self.offsets(x), self._stiffness, self.length)
        parts = self.weights[:, :, None] * slope[:, None, :]
        slots[first : first + self.cells.size] = parts.reshape(self.cells.size, -1)

    def hessian(self, x: FloatArray, project: bool, blocks: FloatArray, first: int) -> None:
        """Write the upper block triangle of each row's Hessian [N/m] to rows of `blocks` from `first` on."""
        K = _curvatures(self.offsets(x), self._stiffness, self.length, project)
        parts = self._products[:, :, None] * K.reshape(len(K), 1, -1)
        blocks[first : first + self._products.size] = parts.reshape(self._products.size, -1)


# ------------------------------------------------------------------------------ the function of C, one row each


def _energies(C: FloatArray, K: FloatArray, length: FloatArray) -> FloatArray:
    """1/2 C^T K C, or 1/2 k (|C| - L)^2 where L > 0, (n,) [J]."""
    linear = 0.5 * np.einsum("nc,ncd,nd->n", C, K, C)
    is_spring = length > 0.0
    if not is_spring.any():
        return np.asarray(linear)
    elongation = np.linalg.norm(C, axis=1) - length
    return np.asarray(np.where(is_spring, 0.5 * K[:, 0, 0] * elongation**2, linear))


def _slackness(C: FloatArray, length: FloatArray) -> FloatArray:
    """1 - L/|C| of springs, 1 of linear rows, (n,); 0 for a spring without direction: it pushes nowhere."""
    size = np.linalg.norm(C, axis=1)
    ratio = np.divide(length, size, out=np.ones_like(size), where=size > 0.0)
    return np.asarray(np.where(length > 0.0, 1.0 - ratio, 1.0))


def _slopes(C: FloatArray, K: FloatArray, length: FloatArray) -> FloatArray:
    """Derivative of the energy by C, (n, dim) [N]."""
    return np.asarray(np.einsum("ncd,nd->nc", K, C) * _slackness(C, length)[:, None])


def _curvatures(C: FloatArray, K: FloatArray, length: FloatArray, project: bool) -> FloatArray:
    """Second derivative by C, (n, dim, dim) [N/m]; positive semi-definite if `project`."""
    is_spring = length > 0.0
    if not is_spring.any():
        return K
    size = np.linalg.norm(C, axis=1)
    across = _slackness(C, length)
    if project:
        # A compressed spring loses stability sideways.
        across = np.maximum(across, 0.0)
    n = np.divide(C, size[:, None], out=np.zeros_like(C), where=size[:, None] > 0.0)
    outer = n[:, :, None] * n[:, None, :]
    bent = across[:, None, None] * (np.eye(C.shape[1]) - outer) + outer
    return np.asarray(np.where(is_spring[:, None, None], K[:, :1, :1] * bent, K))


def facet_normals(corners: FloatArray) -> FloatArray:
    """Unit normals (n, dim) of segments in the plane or triangles in space; zero where a facet has collapsed.

    Parameters
    ----------
    corners : (n, dim, dim) float64
        Corner by corner [m].
    """
    if corners.shape[2] == 2:
        tangent = corners[:, 1] - corners[:, 0]
        normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    else:
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.asarray(np.divide(normal, size, out=np.zeros_like(normal), where=size > 0.0))
