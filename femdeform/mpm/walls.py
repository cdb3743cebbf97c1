"""Rigid obstacles on a grid: conditions on the velocities of the nodes that lie inside them, or less than half a cell
outside.

Such a node sticks (its position at the end of the step is prescribed), slips, or separates. The latter
two are energies of the motion across the wall, ``k/2 g^2`` with the gap ``g = n . (y - y_n - h v_wall)``, of either
sign (slip) or where it is negative (separating). With a stiffness k that is a large multiple of the node's own, what
is left of the forbidden motion is that part of the motion without the wall.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from femdeform.contact.obstacles import Shape
from femdeform.types import BoolArray, FloatArray, IntArray

# Nodes so many cells outside an obstacle still belong to it. Mesh nodes near a wall are borne by wall nodes and by free
# ones, and sink until the weights of the latter are small: by up to 0.7 of a cell were it zero, 0.3 of a cell to either
# side as it is. A stiffer wall changes nothing.
_MARGIN = 0.5
# Stiffness of a wall over that of inertia and elasticity at a node: the part of a motion into it that is left is the
# inverse. More of it would show as rounding in the residual.
STIFFNESS = 1e4


@dataclass(frozen=True)
class Wall:
    """An obstacle with one smooth surface.

    Attributes
    ----------
    shape : Shape
        At time zero.
    velocity : (dim,) float64
        [m/s].
    friction : float
        Coulomb's coefficient [-].
    """

    shape: Shape
    velocity: FloatArray
    friction: float


class WallRows:
    """Slip and separation of the nodes inside walls, in one step; one row for each node and wall.

    Attributes
    ----------
    nodes : (n,) int64
        Grid nodes, ascending for each wall.
    normals : (n, dim) float64
        Unit normals into the free space.
    targets : (n,) float64
        n . y where the node just follows the wall [m].
    stiffness : (n,) float64
        k [N/m].
    two_sided : bool
        Whether nodes slip, rather than separate.
    """

    def __init__(
        self,
        nodes: IntArray,
        normals: FloatArray,
        targets: FloatArray,
        stiffness: FloatArray,
        walls: Sequence[tuple[slice, Wall]],
        two_sided: bool,
    ) -> None:
        self.nodes, self.normals, self.targets, self.stiffness = nodes, normals, targets, stiffness
        self.two_sided = two_sided
        self._walls = list(walls)

    def gaps(self, y: FloatArray) -> FloatArray:
        """g of each row [m]; separating walls act on negative ones only."""
        return np.asarray(np.einsum("ic,ic->i", self.normals, y[self.nodes]) - self.targets)

    def _active(self, y: FloatArray) -> tuple[FloatArray, BoolArray]:
        gaps = self.gaps(y)
        return gaps, np.ones(gaps.shape, dtype=bool) if self.two_sided else gaps <= 0.0

    def value(self, y: FloatArray) -> float:
        """Energy [J]."""
        gaps, active = self._active(y)
        return 0.5 * float(np.sum((self.stiffness * gaps**2)[active]))

    def add_gradient(self, y: FloatArray, out: FloatArray) -> None:
        """Add the gradient [N] to `out` (n_nodes, dim)."""
        gaps, active = self._active(y)
        force = (self.stiffness * np.where(active, gaps, 0.0))[:, None] * self.normals
        np.add.at(out, self.nodes, force)

    def add_hessian(self, y: FloatArray, diagonal: FloatArray) -> None:
        """Add the node blocks [N/m] to `diagonal` (n_nodes, dim^2)."""
        _, active = self._active(y)
        outer = self.normals[:, :, None] * self.normals[:, None, :]
        blocks = (self.stiffness * active)[:, None, None] * outer
        np.add.at(diagonal, self.nodes, blocks.reshape(len(blocks), diagonal.shape[1]))

    def rub(self, y: FloatArray, velocity: FloatArray, mass: FloatArray, dt: float) -> FloatArray:
        """Velocities (n_nodes, dim) [m/s] of the nodes after Coulomb friction.

        The normal impulse of a node is that of its wall over the step; it takes as much off the tangential velocity
        relative to the wall, down to nothing.
        """
        out = velocity
        impulse = self.stiffness * np.maximum(-self.gaps(y), 0.0) * dt
        # A node at several walls is in several rows: walls follow one another.
        for rows, wall in self._walls:
            if wall.friction == 0.0:
                continue
            nodes, normals = self.nodes[rows], self.normals[rows]
            relative = out[nodes] - wall.velocity
            tangential = relative - np.einsum("ic,ic->i", relative, normals)[:, None] * normals
            length = np.linalg.norm(tangential, axis=1)
            reach = wall.friction * impulse[rows] / mass[nodes]
            part = np.minimum(1.0, np.divide(reach, length, out=np.zeros_like(reach), where=length > 0.0))
            out = out.copy()
            out[nodes] -= part[:, None] * tangential
        return out


def inside(
    walls: Sequence[Wall], positions: FloatArray, time: float, spacing: float
) -> list[tuple[IntArray, FloatArray]]:
    """Nodes (n,) of each wall at a time and the normals (n, dim) there; `spacing` is that of the nodes [m]."""
    found = []
    for wall in walls:
        distance, normals = wall.shape.distance(positions - wall.velocity * time)
        nodes = np.flatnonzero(distance <= _MARGIN * spacing)
        found.append((nodes, np.array(normals[nodes])))
    return found


def wall_rows(
    walls: Sequence[Wall],
    found: Sequence[tuple[IntArray, FloatArray]],
    positions: FloatArray,
    node_stiffness: FloatArray,
    dt: float,
    two_sided: bool,
) -> WallRows:
    """Rows of all walls.

    Parameters
    ----------
    walls, found
        See `inside`.
    positions : (n_nodes, dim) float64
        Nodes before the step [m].
    node_stiffness : (n_nodes,) float64
        Stiffness of inertia and elasticity of each node [N/m].
    dt : float
        [s].
    two_sided : bool
        Slip instead of separation.
    """
    dim = positions.shape[1]
    nodes = np.concatenate([np.empty(0, np.int64), *(n for n, _ in found)])
    normals = np.concatenate([np.empty((0, dim)), *(n for _, n in found)])
    counts = [n.size for n, _ in found]
    ends = np.cumsum(counts, dtype=np.int64)
    parts = [(slice(int(end) - count, int(end)), wall) for end, count, wall in zip(ends, counts, walls, strict=True)]
    velocity = np.repeat(np.array([wall.velocity for wall in walls]).reshape(-1, dim), counts, axis=0)
    targets = np.einsum("ic,ic->i", normals, positions[nodes] + dt * velocity)
    return WallRows(nodes, normals, targets, STIFFNESS * node_stiffness[nodes], parts, two_sided)
