"""Weak constraints in a sweep over cells: their rows by colour, and what a step freezes of them."""

from __future__ import annotations

import numpy as np

from femdeform.contact.weak_constraints import WeakConstraints
from femdeform.types import BoolArray, FloatArray, IntArray
from solvers.coloring import color, moving_sets
from solvers.position_based import link_kernels


class LinkSweep:
    """Rows sorted by colour, with their multipliers, and one visit to all of them.

    Parameters
    ----------
    links : WeakConstraints
        All rows of the problem.
    place : (n_nodes,) int64
        Place of each node in the sweep.
    free : (n_nodes, 3) uint8
        0 where a component is prescribed or missing; by place.
    stride : int
        Numbers a node.
    mode : int
        What is done about the primary residual, see `link_kernels`.
    rigid : bool
        PBD: infinite stiffness.
    """

    def __init__(
        self,
        links: WeakConstraints,
        place: IntArray,
        free: np.ndarray[tuple[int, ...], np.dtype[np.uint8]],
        stride: int,
        mode: int,
        rigid: bool,
    ) -> None:
        self._links, self._free = links, free
        self._stride, self._mode, self._rigid = stride, mode, rigid
        moves: BoolArray = np.any(free, axis=1)
        colors = color(moving_sets([term.cells for term in links.terms], moves[place]).transposed())
        self._order = np.argsort(colors, kind="stable")
        self._cuts = np.searchsorted(colors[self._order], np.arange(int(colors.max(initial=-1)) + 2))
        rows = links.rows.select(self._order)
        self._rows = rows
        n = rows.n_rows
        self._node_places = place[rows.nodes]
        self._places = stride * self._node_places
        self._frames = np.broadcast_to(np.eye(3), (n, 3, 3)).copy()
        self._stiffness = np.zeros((n, 3))
        self._targets = np.zeros((n, 3))
        self.held = np.zeros((n, 3))
        self.pulls = np.zeros(n)

    @property
    def n_colors(self) -> int:
        """Number of colours, one threaded loop each."""
        return self._cuts.size - 1

    def begin(self) -> None:
        """Take over what the step begun has frozen; multipliers of zero."""
        dim, rows = self._links.dim, self._rows
        self._targets[:, :dim] = self._links.target[self._order]
        direction = self._links.direction[self._order]
        self._frames[:, :dim, :dim] = _frames(direction)
        self._stiffness[:, :dim] = rows.tangential[:, None]
        self._stiffness[:, 0] = np.where(np.any(direction != 0.0, axis=1), rows.normal, rows.tangential)
        self.held[:] = 0.0
        self.pulls[:] = 0.0

    def sweep(self, x: FloatArray, h2: float, reverse: bool) -> None:
        """Visit every row once.

        Parameters
        ----------
        x : (n_nodes stride,) float64
            Positions as `constraint_kernels` has them; changed.
        h2 : float
            Square of the time step [s^2].
        reverse : bool
            Colours in reverse.
        """
        colors = range(self.n_colors)
        rows = self._rows
        for c in reversed(colors) if reverse else colors:
            link_kernels.project_rows(
                int(self._cuts[c]),
                int(self._cuts[c + 1]),
                rows.offsets,
                self._places,
                rows.weights,
                rows.length,
                self._frames,
                self._stiffness,
                self._targets,
                self._stride,
                self._free,
                h2,
                self._rigid,
                self._mode,
                x,
                self.held,
                self.pulls,
            )

    def add_held(self, out: FloatArray) -> None:
        """Add ``w_j held`` of every row to its nodes, (n_nodes, dim) by place [kg m]."""
        self._add(self.held, out)

    def _add(self, vectors: FloatArray, out: FloatArray) -> None:
        row = np.repeat(np.arange(self._rows.n_rows), np.diff(self._rows.offsets))
        for a in range(out.shape[1]):
            parts = self._rows.weights * vectors[row, a]
            out[:, a] += np.bincount(self._node_places, parts, minlength=len(out))

    def defects(self, points: FloatArray, h2: float, held: FloatArray, missing: FloatArray) -> None:
        """Add the forces that multipliers stand for, and what they lack, with directions as they are now.

        Parameters
        ----------
        points : (n_nodes, dim) float64
            Positions by place [m].
        h2 : float
            Square of the time step [s^2].
        held : (n_nodes, dim) float64
            ``sum l grad C`` [kg m]; added to.
        missing : (n_nodes, dim) float64
            ``sum (s C + l) grad C`` [kg m]; added to.
        """
        rows, dim = self._rows, points.shape[1]
        row = np.repeat(np.arange(rows.n_rows), np.diff(rows.offsets))
        parts = rows.weights[:, None] * points[self._node_places]
        C = -self._targets[:, :dim]
        for a in range(dim):
            C[:, a] += np.bincount(row, parts[:, a], minlength=rows.n_rows)
        size = np.linalg.norm(C, axis=1, keepdims=True)
        along = np.divide(C, size, out=np.zeros_like(C), where=size > 0.0)
        is_spring = rows.length > 0.0
        pull = self.pulls[:, None] * along
        own = np.where(is_spring[:, None], pull, self.held[:, :dim])
        # s C of linear rows is h^2 K C.
        local = np.einsum("nab,nb->na", self._frames[:, :dim, :dim], C) * self._stiffness[:, :dim]
        linear = np.einsum("nab,na->nb", self._frames[:, :dim, :dim], local)
        spring = self._stiffness[:, :1] * (size - rows.length[:, None]) * along
        force = h2 * np.where(is_spring[:, None], spring, linear)
        self._add(own, held)
        self._add(own + force, missing)


def _frames(direction: FloatArray) -> FloatArray:
    """Orthonormal frames (n, dim, dim), row by row, the first row being the direction; unit axes where it is zero."""
    n, dim = direction.shape
    out = np.broadcast_to(np.eye(dim), (n, dim, dim)).copy()
    turned = np.flatnonzero(np.any(direction != 0.0, axis=1))
    d = direction[turned]
    out[turned, 0] = d
    if dim == 2:
        out[turned, 1] = np.stack([-d[:, 1], d[:, 0]], axis=1)
        return out
    across = np.cross(d, np.eye(3)[np.argmin(np.abs(d), axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    out[turned, 1] = across
    out[turned, 2] = np.cross(d, across)
    return out
