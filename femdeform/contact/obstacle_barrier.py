"""Contact of nodes with a rigid obstacle by a barrier on the gap, with Coulomb friction: nothing ever penetrates."""

from __future__ import annotations

import numpy as np

from femdeform.contact.barrier import barrier, friction_force, friction_work
from femdeform.contact.obstacles import Shape
from femdeform.types import FloatArray, IntArray

# A step may close the gap of a node down to this part.
_KEPT = 0.1
# Smallest gap that a step may leave, in d_hat.
_CLOSEST = 1e-6
# Advancements towards an obstacle; each is safe, later ones only lengthen the step.
_ADVANCES = 40


class ObstacleBarrier:
    """One obstacle and the nodes that may come near it.

    Parameters
    ----------
    shape : Shape
        Obstacle at time zero.
    nodes : (n,) int64
        Local nodes on the surface of the bodies.
    weight : (n,) float64
        Stiffness of the barrier times the node's share of the surface [N].
    offset : (n,) float64
        Distance that the node itself takes up: half a thickness, the radius of a rod [m].
    reach : float
        Gap at which the barrier starts, d_hat [m].
    friction : float
        Coulomb's coefficient [-].
    velocity : (dim,) float64
        Velocity of the obstacle [m/s].
    stick_velocity : float
        Slip velocity up to which friction sticks, eps_v [m/s].

    References
    ----------
    M. Li et al., Incremental Potential Contact (2020).

    Limitations
    -----------
    Nodes only: between the nodes of a coarse surface a sharp obstacle can reach into a body. Friction uses the normal
    force of the last accepted state, so a body's first step of contact is frictionless. Beside the edges of a box the
    curvature of the distance jumps: the energy is once continuously differentiable there.
    """

    def __init__(
        self,
        shape: Shape,
        nodes: IntArray,
        weight: FloatArray,
        offset: FloatArray,
        reach: float,
        friction: float,
        velocity: FloatArray,
        stick_velocity: float,
    ) -> None:
        self.shape = shape
        self.nodes = nodes
        self.weight = weight
        self.offset = offset
        self.reach = reach
        self.friction = friction
        self.velocity = velocity
        self.stick_velocity = stick_velocity
        self.moves = bool(np.any(velocity != 0.0))
        self._time, self._dt, self._progress = 0.0, 1.0, 0.0
        self._shift = np.zeros_like(velocity)
        self._slip_scale = 1.0
        # Nodes with friction in this step: their index, start, normal and limit of the friction force.
        self._rubbing = np.empty(0, dtype=np.int64)
        self._start = np.empty((0, velocity.size))
        self._normal = np.empty((0, velocity.size))
        self._limit = np.empty(0)

    def begin_step(self, x: FloatArray, time: float, dt: float) -> None:
        """Freeze normal forces and directions of friction at the accepted state `x`, the obstacle still there."""
        self._time, self._dt = time, dt
        self.place(0.0)
        self._slip_scale = max(self.stick_velocity * dt, 1e-300)
        self._rubbing = np.empty(0, dtype=np.int64)
        if self.friction > 0.0:
            near, gap, normal = self._near(x)
            slope = barrier(gap, self.reach, self.offset[near])[1]
            self._rubbing = near
            self._limit = -self.friction * self.weight[near] * slope
            self._start = x[self.nodes[near]]
            self._normal = normal

    def place(self, progress: float) -> None:
        """Put the obstacle where it is after that part of the step."""
        self._progress = progress
        self._shift = self.velocity * (self._time - (1.0 - progress) * self._dt)

    def gaps(self, x: FloatArray) -> FloatArray:
        """Gap of every node (n,) [m], negative inside."""
        return np.asarray(self.shape.distance(x[self.nodes] - self._shift)[0] - self.offset)

    def _near(self, x: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """Which of the nodes feel the barrier, with their gaps and normals."""
        distance, normal = self.shape.distance(x[self.nodes] - self._shift)
        gap = distance - self.offset
        near = np.flatnonzero(~(gap >= self.reach))
        return near, gap[near], np.asarray(normal[near])

    def _slip(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        moved = x[self.nodes[self._rubbing]] - self._start - self._progress * self._dt * self.velocity
        slip = moved - np.einsum("ic,ic->i", moved, self._normal)[:, None] * self._normal
        return slip, np.linalg.norm(slip, axis=1)

    def value(self, x: FloatArray) -> float:
        """Energy of the barrier and work of friction [J]; infinite if a node is inside."""
        near, gap, _ = self._near(x)
        energy = float(np.dot(self.weight[near], barrier(gap, self.reach, self.offset[near])[0]))
        if self._rubbing.size:
            energy += float(np.dot(self._limit, friction_work(self._slip(x)[1], self._slip_scale)))
        return energy

    def add_gradient(self, x: FloatArray, out: FloatArray) -> None:
        """Add the energy gradient [N] to `out` (n_local, dim)."""
        near, gap, normal = self._near(x)
        slope = barrier(gap, self.reach, self.offset[near])[1]
        out[self.nodes[near]] += (self.weight[near] * slope)[:, None] * normal
        if self._rubbing.size:
            slip, length = self._slip(x)
            secant, _ = friction_force(length, self._slip_scale)
            out[self.nodes[self._rubbing]] += (self._limit * secant)[:, None] * slip

    def _normal_blocks(self, x: FloatArray, project: bool) -> tuple[IntArray, FloatArray]:
        near, gap, normal = self._near(x)
        _, slope, curvature = barrier(gap, self.reach, self.offset[near])
        bend = slope[:, None, None] * self.shape.curvature(x[self.nodes[near]] - self._shift)
        if project:
            bend[np.trace(bend, axis1=1, axis2=2) < 0.0] = 0.0
        blocks = curvature[:, None, None] * (normal[:, :, None] * normal[:, None, :]) + bend
        return near, self.weight[near, None, None] * blocks

    def _friction_blocks(self, x: FloatArray) -> FloatArray:
        slip, length = self._slip(x)
        secant, tangent = friction_force(length, self._slip_scale)
        direction = slip / np.maximum(length, 1e-300)[:, None]
        across = np.eye(self.velocity.size) - self._normal[:, :, None] * self._normal[:, None, :]
        along = direction[:, :, None] * direction[:, None, :]
        blocks = secant[:, None, None] * across + (tangent - secant)[:, None, None] * along
        return np.asarray(self._limit[:, None, None] * blocks)

    def add_hessian(self, x: FloatArray, project: bool, diagonal: FloatArray) -> None:
        """Add node blocks [N/m] to `diagonal` (n_local, dim*dim), each positive semi-definite if `project`."""
        size = self.velocity.size**2
        near, blocks = self._normal_blocks(x, project)
        diagonal[self.nodes[near]] += blocks.reshape(-1, size)
        if self._rubbing.size:
            diagonal[self.nodes[self._rubbing]] += self._friction_blocks(x).reshape(-1, size)

    def drift_force(self, x: FloatArray, drift: float, out: FloatArray) -> None:
        """Add the change of the gradient [N] if the obstacle moves on by that part of the step, to first order."""
        if not self.moves:
            return
        motion = -drift * self._dt * self.velocity
        near, blocks = self._normal_blocks(x, True)
        out[self.nodes[near]] += blocks @ motion
        if self._rubbing.size:
            out[self.nodes[self._rubbing]] += self._friction_blocks(x) @ motion

    def max_step(self, x: FloatArray, step: FloatArray, drift: float) -> float:
        """Largest part in [0, 1] of `step` that leaves every node a tenth of its gap, by conservative advancement.

        `drift` is the part of the obstacle's motion over the time step that goes along with the whole of `step`.

        Along a line the distance from a convex obstacle is convex, so its tangent never overshoots; inside a bowl it
        is concave, and its chord never does.
        """
        move = step[self.nodes] - drift * self._dt * self.velocity
        start = x[self.nodes] - self._shift
        distance, normal = self.shape.distance(start)
        gap = distance - self.offset
        # Distances are 1-Lipschitz: most nodes are too far away to matter.
        chosen = np.flatnonzero(np.linalg.norm(move, axis=1) >= (1.0 - _KEPT) * gap)
        if chosen.size == 0:
            return 1.0
        start, move, normal = start[chosen], move[chosen], normal[chosen]
        floor = self.offset[chosen] + np.maximum(_KEPT * gap[chosen], _CLOSEST * self.reach)
        distance = distance[chosen]
        length = np.zeros(chosen.size)
        end = self.shape.distance(start + move)[0]
        for _ in range(_ADVANCES):
            room = distance - floor
            if self.shape.concave:
                closing = (distance - end) / np.maximum(1.0 - length, 1e-300)
            else:
                closing = -np.einsum("ic,ic->i", normal, move)
            with np.errstate(divide="ignore", invalid="ignore"):
                advance = np.where(closing > 0.0, room / closing, np.inf)
            after = np.minimum(length + np.maximum(advance, 0.0), 1.0)
            if np.all(after - length <= 1e-3 * after):
                length = after
                break
            length = after
            distance, normal = self.shape.distance(start + length[:, None] * move)
        return float(length.min())
