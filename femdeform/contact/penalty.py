"""Penalty contact of nodes with a rigid obstacle, with Coulomb friction.

Normal force: energy ``sum_i k A_i / 2 min(d_i, 0)^2`` with the signed distance d and the area A_i of the surface
around node i that faces the obstacle at the last accepted state. Friction: a potential ``mu N_i f(|u_i|)`` of the
tangential slip u over the step, where the normal force N is that of the last accepted state and f is quadratic up to
the slip ``eps_v dt`` and linear beyond. Below that slip friction behaves like a stiff spring, so a body at rest on a
slope creeps with at most `eps_v`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from femdeform.contact.obstacles import Shape
from femdeform.types import FloatArray, IntArray

# Stiffness of the nodes that may touch (n,) [N/m], from positions and unit normals of the obstacle of all local nodes.
NodeStiffness = Callable[[FloatArray, FloatArray], FloatArray]


class PenaltyContact:
    """One obstacle and the nodes that may touch it.

    Parameters
    ----------
    shape : Shape
        Obstacle at time zero.
    nodes : (n,) int64
        Owned local nodes on the surface of the bodies.
    weigh : callable
        Gives the penalty stiffness of each node, per area times the area there that faces the obstacle [N/m].
    friction : float
        Coulomb's coefficient [-].
    velocity : (dim,) float64
        Velocity of the obstacle [m/s].
    stick_velocity : float
        Slip velocity up to which friction sticks, eps_v [m/s].

    References
    ----------
    M. Li et al., Incremental Potential Contact (2020), for the smooth lagged friction potential.

    Limitations
    -----------
    Penetration is proportional to the force; stiffness decides how deep. The area that faces the obstacle lags by a
    step: a body that turns while it touches gains or loses a little energy. Friction uses the normal force of the step
    before, so a body's first step of contact is frictionless.
    """

    def __init__(
        self,
        shape: Shape,
        nodes: IntArray,
        weigh: NodeStiffness,
        friction: float,
        velocity: FloatArray,
        stick_velocity: float,
    ) -> None:
        self.shape = shape
        self.nodes = nodes
        self.weigh = weigh
        self.stiffness = np.zeros(nodes.size)
        self.friction = friction
        self.velocity = velocity
        self.stick_velocity = stick_velocity
        self._shift = np.zeros_like(velocity)
        self._slip_scale = 1.0
        self._start = np.empty((nodes.size, velocity.size))
        self._normal = np.zeros((nodes.size, velocity.size))
        self._lagged_force = np.zeros(nodes.size)

    def begin_step(self, x: FloatArray, time: float, dt: float) -> None:
        """Freeze stiffnesses, normal forces and directions of friction at the accepted state `x`."""
        every, normals = self.shape.distance(x - self.velocity * (time - dt))
        self.stiffness = self.weigh(x, normals)
        distance = every[self.nodes]
        self._start = x[self.nodes] + self.velocity * dt
        self._normal = np.array(normals[self.nodes])
        self._lagged_force = self.friction * self.stiffness * np.maximum(-distance, 0.0)
        self._shift = self.velocity * time
        self._slip_scale = max(self.stick_velocity * dt, 1e-300)

    @property
    def frozen(self) -> tuple[FloatArray, float, FloatArray, FloatArray, FloatArray]:
        """What the step begun freezes.

        The obstacle's shift (dim,) [m], the slip up to which friction sticks [m], and for each node where it would be
        if it stuck (n, dim) [m], the normal (n, dim) across which it slips, and the limit of friction (n,) [N].
        """
        return self._shift, self._slip_scale, self._start, self._normal, self._lagged_force

    def _slip(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        moved = x[self.nodes] - self._start
        slip = moved - np.einsum("ic,ic->i", moved, self._normal)[:, None] * self._normal
        return slip, np.linalg.norm(slip, axis=1)

    def stored_energy(self, x: FloatArray) -> float:
        """Energy of penetration of this rank's nodes [J]."""
        distance, _ = self.shape.distance(x[self.nodes] - self._shift)
        return 0.5 * float(np.dot(self.stiffness, np.minimum(distance, 0.0) ** 2))

    def value(self, x: FloatArray) -> float:
        """Energy of penetration and friction of this rank's nodes [J]."""
        energy = self.stored_energy(x)
        if self.friction > 0.0:
            _, length = self._slip(x)
            h = self._slip_scale
            potential = np.where(length < h, 0.5 * length**2 / h, length - 0.5 * h)
            energy += float(np.dot(self._lagged_force, potential))
        return energy

    def add_gradient(self, x: FloatArray, out: FloatArray) -> None:
        """Add the energy gradient [N] to `out` (n_local, dim)."""
        distance, normal = self.shape.distance(x[self.nodes] - self._shift)
        out[self.nodes] += (self.stiffness * np.minimum(distance, 0.0))[:, None] * normal
        if self.friction > 0.0:
            slip, length = self._slip(x)
            out[self.nodes] += (self._lagged_force / np.maximum(length, self._slip_scale))[:, None] * slip

    def add_hessian(self, x: FloatArray, project: bool, diagonal: FloatArray) -> None:
        """Add node blocks [N/m] to `diagonal` (n_local, dim*dim), each positive semi-definite if `project`."""
        dim = self.velocity.size
        where = x[self.nodes] - self._shift
        distance, normal = self.shape.distance(where)
        # A node that just touches counts: a body placed on the floor is held by it from the first iteration on.
        touching = distance <= 0.0
        outer = normal[:, :, None] * normal[:, None, :]
        # The distance's own curvature acts with a force that pushes back, d < 0: stiff in bowls and in the corners of
        # containers, soft around a ball.
        bend = distance[:, None, None] * self.shape.curvature(where)
        if project:
            bend[np.trace(bend, axis1=1, axis2=2) < 0.0] = 0.0
        blocks = (self.stiffness * touching)[:, None, None] * (outer + bend)
        if self.friction > 0.0:
            slip, length = self._slip(x)
            h = self._slip_scale
            frozen = np.eye(dim) - self._normal[:, :, None] * self._normal[:, None, :]
            direction = slip / np.maximum(length, 1e-300)[:, None]
            sliding = frozen - direction[:, :, None] * direction[:, None, :]
            blocks = blocks + np.where(
                (length < h)[:, None, None],
                (self._lagged_force / h)[:, None, None] * frozen,
                (self._lagged_force / np.maximum(length, h))[:, None, None] * sliding,
            )
        np.add.at(diagonal, self.nodes, blocks.reshape(-1, dim * dim))
