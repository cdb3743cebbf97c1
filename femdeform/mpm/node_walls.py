"""Walls in an implicit grid step: unknowns that are eliminated, the set of nodes in contact, friction afterwards.

A node in a wall sticks, slips or separates. What a wall forbids is removed from the unknowns: each node has axes of its
own, the first of them across the walls that hold it. Which separating walls hold is found by an active set: a node
whose wall would have to pull is let go, a node that has moved into its wall is held, until nothing changes. Friction
follows the solve, with the reaction: ``v_t *= max(0, 1 - mu j / |v_t|)``, ``j = h lambda / m``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from femdeform.jit import njit
from femdeform.types import BoolArray, FloatArray, IntArray

Kind = Literal["stick", "slip", "separate"]
# A normal with less than this beside those before it adds nothing to them.
_DEPENDENT = 1e-6


@dataclass(frozen=True)
class NodeWall:
    """A wall as the grid nodes see it.

    Attributes
    ----------
    phi : (n_nodes,) float64
        Signed distance [m]; the wall holds nodes where it is not positive.
    normals : (n_nodes, dim) float64
        Unit normals, out of the wall; read where it holds.
    velocity : (n_nodes, dim) float64
        Velocities of the wall [m/s].
    kind : str
        ``stick``, ``slip`` or ``separate``.
    friction : float
        Coulomb's coefficient [-], for walls that slip or separate.
    """

    phi: FloatArray
    normals: FloatArray
    velocity: FloatArray
    kind: Kind
    friction: float = 0.0

    def take(self, nodes: IntArray) -> NodeWall:
        """The same wall at the nodes of the given numbers."""
        return NodeWall(self.phi[nodes], self.normals[nodes], self.velocity[nodes], self.kind, self.friction)


@njit
def _make_frames(
    offsets: Any, active: Any, normals: Any, targets: Any, frames: Any, held: Any, shift: Any, upper: Any
) -> None:
    """Axes of each node: across its active rows first, by Gram and Schmidt, then any others.

    Parameters
    ----------
    offsets : (n_nodes + 1,)
        Rows of each node.
    active : (n_rows,) uint8
        1 where a row holds; set to 2 where its normal adds nothing to those before it.
    normals, targets : (n_rows, dim), (n_rows,)
        The row is ``normal . u = target``.
    frames : (n_nodes, dim, dim)
        Receives the axes as columns.
    held : (n_nodes,)
        Receives the number of axes that are prescribed.
    shift : (n_nodes, dim)
        Receives the displacement along them [m].
    upper : (n_nodes, dim, dim)
        Receives the triangular matrix of ``normals = frames upper``.
    """
    dim = normals.shape[1]
    v = np.empty(dim)
    for i in range(offsets.shape[0] - 1):
        k = 0
        for r in range(offsets[i], offsets[i + 1]):
            if active[r] == 0:
                continue
            for c in range(dim):
                v[c] = normals[r, c]
            rest = targets[r]
            for a in range(k):
                s = 0.0
                for c in range(dim):
                    s += frames[i, c, a] * v[c]
                for c in range(dim):
                    v[c] -= s * frames[i, c, a]
                if k < dim:
                    upper[i, a, k] = s
                rest -= s * shift[i, a]
            size = np.sqrt(np.sum(v * v))
            if k == dim or size < _DEPENDENT:
                active[r] = 2
                continue
            upper[i, k, k] = size
            for c in range(dim):
                frames[i, c, k] = v[c] / size
            shift[i, k] = rest / size
            k += 1
        held[i] = k
        if k == 0:
            continue
        for a in range(k, dim):
            # The coordinate axis that sticks out most of those found.
            best = -1.0
            for e in range(dim):
                s = 1.0
                for b in range(a):
                    s -= frames[i, e, b] ** 2
                if s > best:
                    best, axis = s, e
            for c in range(dim):
                v[c] = 1.0 if c == axis else 0.0
            for _ in range(2):
                for b in range(a):
                    s = 0.0
                    for c in range(dim):
                        s += frames[i, c, b] * v[c]
                    for c in range(dim):
                        v[c] -= s * frames[i, c, b]
            size = np.sqrt(np.sum(v * v))
            for c in range(dim):
                frames[i, c, a] = v[c] / size


@njit
def _multipliers(offsets: Any, active: Any, frames: Any, held: Any, upper: Any, forces: Any, out: Any) -> None:
    """Reactions of the rows: ``sum_r out[r] normal_r`` is the force at the node along its prescribed axes."""
    dim = frames.shape[1]
    y = np.empty(dim)
    for i in range(offsets.shape[0] - 1):
        k = held[i]
        for a in range(k):
            y[a] = 0.0
            for c in range(dim):
                y[a] += frames[i, c, a] * forces[i, c]
        for a in range(k - 1, -1, -1):
            for b in range(a + 1, k):
                y[a] -= upper[i, a, b] * y[b]
            y[a] /= upper[i, a, a]
        a = 0
        for r in range(offsets[i], offsets[i + 1]):
            out[r] = 0.0
            if active[r] == 1:
                out[r] = y[a]
                a += 1


class WallContact:
    """Rows ``n . u >= target`` or ``= target`` of the nodes in walls, in one step; u is their displacement.

    Parameters
    ----------
    walls : sequence of NodeWall
        Of two walls at a node whose normals agree, the first one counts where both hold.
    n_nodes, dim : int
    dt : float
        [s].
    predicted : (n_nodes, dim) float64
        Displacement by inertia and gravity alone [m]: separating walls hold first where it goes into them.

    Raises
    ------
    ValueError
        If a normal that is needed is not one.

    Attributes
    ----------
    nodes : (n_rows,) int64
        Node of each row, ascending.
    stuck : (n_nodes,) bool
        Nodes in a wall that sticks.
    frames : (n_nodes, dim, dim) float64
        Axes of each node, as columns.
    held : (n_nodes, dim) bool
        Axes along which the displacement is prescribed.
    shift : (n_nodes, dim) float64
        Prescribed displacements along them [m].

    References
    ----------
    J. Nocedal, S. Wright, Numerical optimization (2006), section 16.5: active sets, of one inequality a node.

    Limitations
    -----------
    A node in two walls follows both as long as their normals tell them apart; a wall thinner than a cell, or an edge
    sharper than one, is seen by the nodes that lie inside of it alone.
    """

    def __init__(self, walls: Sequence[NodeWall], n_nodes: int, dim: int, dt: float, predicted: FloatArray) -> None:
        self.walls, self.dt = list(walls), dt
        self.stuck: BoolArray = np.zeros(n_nodes, dtype=bool)
        self._carried = np.zeros((n_nodes, dim))
        for wall in self.walls:
            inside = (wall.phi <= 0.0) & ~self.stuck
            if wall.kind == "stick":
                self.stuck |= inside
                self._carried[inside] = dt * wall.velocity[inside]
        nodes, numbers = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=np.int64)]
        for number, wall in enumerate(self.walls):
            if wall.kind != "stick":
                found = np.flatnonzero((wall.phi <= 0.0) & ~self.stuck)
                nodes.append(found)
                numbers.append(np.full(found.size, number))
        order = np.argsort(np.concatenate(nodes), kind="stable")
        self.nodes: IntArray = np.concatenate(nodes)[order]
        self.wall: IntArray = np.concatenate(numbers)[order]
        self.offsets = np.concatenate([[0], np.cumsum(np.bincount(self.nodes, minlength=n_nodes))])
        self.normals, self._wall_velocity = np.empty((2, self.nodes.size, dim))
        self.two_sided = np.zeros(self.nodes.size, dtype=bool)
        self.friction = np.zeros(self.nodes.size)
        for number, wall in enumerate(self.walls):
            rows = self.wall == number
            self.normals[rows] = wall.normals[self.nodes[rows]]
            self._wall_velocity[rows] = wall.velocity[self.nodes[rows]]
            self.two_sided[rows] = wall.kind == "slip"
            self.friction[rows] = wall.friction
        if not np.allclose(np.einsum("rc,rc->r", self.normals, self.normals), 1.0):
            raise ValueError("a wall has no unit normal at a node inside it")
        self.targets = dt * np.einsum("rc,rc->r", self.normals, self._wall_velocity)
        self.active = np.where(self.two_sided | (self.gaps(predicted) < 0.0), 1, 0).astype(np.uint8)
        self.frames: FloatArray = np.empty((n_nodes, dim, dim))
        self.held: BoolArray = np.empty((n_nodes, dim), dtype=bool)
        self.shift: FloatArray = np.empty((n_nodes, dim))
        self._arrange()

    def gaps(self, u: FloatArray) -> FloatArray:
        """``n . u - target`` of each row [m]."""
        return np.asarray(np.einsum("rc,rc->r", self.normals, u[self.nodes]) - self.targets)

    @property
    def any(self) -> bool:
        """Whether any wall acts."""
        return bool(self.held.any())

    def _arrange(self) -> None:
        n, dim = self.shift.shape
        self.active[self.active == 2] = 1
        self.frames[:] = np.eye(dim)
        self.shift[:] = 0.0
        self._upper = np.zeros((n, dim, dim))
        self._count = np.zeros(n, dtype=np.int64)
        _make_frames(
            self.offsets, self.active, self.normals, self.targets, self.frames, self._count, self.shift, self._upper
        )
        self.held[:] = np.arange(dim) < self._count[:, None]
        self.held[self.stuck] = True
        self.shift[self.stuck] = self._carried[self.stuck]

    def reactions(self, gradient: FloatArray) -> FloatArray:
        """Forces of the walls along the normals of the rows [N], from the gradient of the step (n_nodes, dim)."""
        out = np.empty(self.nodes.size)
        _multipliers(self.offsets, self.active, self.frames, self._count, self._upper, gradient, out)
        return out

    def update(self, u: FloatArray, gradient: FloatArray, smallest: FloatArray, gap: float) -> bool:
        """Let go of nodes that are pulled, hold those that have gone into their wall; tell whether anything changed.

        Parameters
        ----------
        u : (n_nodes, dim) float64
            Displacements of a solved step [m].
        gradient : (n_nodes, dim) float64
            Gradient of its function [N].
        smallest : (n_nodes,) float64
            Forces that count as none [N].
        gap : float
            Distance that counts as none [m].
        """
        one_sided = ~self.two_sided
        pulled = one_sided & (self.active == 1) & (self.reactions(gradient) < -smallest[self.nodes])
        entered = one_sided & (self.active == 0) & (self.gaps(u) < -gap)
        if not (pulled.any() or entered.any()):
            return False
        self.active[pulled] = 0
        self.active[entered] = 1
        self._arrange()
        return True

    def rub(self, velocity: FloatArray, gradient: FloatArray, mass: FloatArray) -> FloatArray:
        """Velocities (n_nodes, dim) [m/s] after Coulomb friction with the reactions of a solved step.

        Walls at one node follow one another; each acts along the directions in which the node is free.
        """
        impulse = self.dt * self.friction * np.maximum(self.reactions(gradient), 0.0)
        out = np.array(velocity)
        for number, wall in enumerate(self.walls):
            rows = np.flatnonzero((self.wall == number) & (impulse > 0.0))
            if wall.kind == "stick" or rows.size == 0:
                continue
            nodes = self.nodes[rows]
            frames = np.where(self.held[nodes][:, None, :], 0.0, self.frames[nodes])
            relative = out[nodes] - self._wall_velocity[rows]
            free = np.einsum("rca,rba,rb->rc", frames, frames, relative)
            speed = np.linalg.norm(free, axis=1)
            reach = impulse[rows] / mass[nodes]
            part = np.minimum(1.0, np.divide(reach, speed, out=np.zeros_like(reach), where=speed > 0.0))
            out[nodes] -= part[:, None] * free
        return out
