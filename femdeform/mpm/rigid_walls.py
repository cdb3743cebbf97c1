"""Rigid walls that act on the velocities of grid nodes in an explicit step: stick, slip, separate, rub.

A node belongs to a wall if it lies inside of it, or on its surface but for rounding. With normal n, relative to the
velocity of the wall: stick, ``v = 0``; slip, ``v -= (v.n) n``; separate, the same where ``v.n < 0``. Coulomb friction
follows, with the impulse ``j = max(0, -v.n)`` that was taken: ``v_t *= max(0, 1 - mu j / |v_t|)``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np

from femdeform.mpm.block_grid import BlockGrid
from femdeform.mpm.block_kernels import SIDE
from femdeform.types import FloatArray

Kind = Literal["stick", "slip", "separate"]
# Distance of a node from a wall, over that of nodes, that counts as none: walls through nodes hold them.
_TOUCHING = 1e-6
# Sweeps over the walls of a node that several of them hold.
_SWEEPS = 20


class SignedDistance(Protocol):
    """A rigid shape; positive distances are free space. Shapes of obstacles are such, and those of `mpm.shapes`."""

    def distance(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Signed distance (n,) [m] of positions (n, dim) and its unit gradient (n, dim)."""


@dataclass(frozen=True)
class RigidWall:
    """A wall that moves without turning.

    Attributes
    ----------
    shape : SignedDistance
        At time zero.
    kind : str
        ``stick``, ``slip`` or ``separate``.
    velocity : (dim,) float64
        [m/s].
    friction : float
        Coulomb's coefficient [-].
    temperature : float, optional
        What it keeps bodies at that touch it [K]; default: no heat goes through it.
    """

    shape: SignedDistance
    kind: Kind
    velocity: FloatArray
    friction: float = 0.0
    temperature: float | None = None

    def distance(self, positions: FloatArray, time: float) -> tuple[FloatArray, FloatArray]:
        """Signed distance (n,) [m] and unit normal (n, dim) at positions (n, dim) and a time."""
        distance, normals = self.shape.distance(positions - self.velocity * time)
        return distance, np.array(normals)

    def node_distance(self, nodes: FloatArray, time: float, spacing: float) -> tuple[FloatArray, FloatArray]:
        """As `distance` of grid nodes at a `spacing` [m] from one another; 0 at those within a millionth of it.

        Whether a wall that is meant to pass through nodes holds them is then no matter of rounding: it does.
        """
        distance, normals = self.distance(nodes, time)
        return np.where(np.abs(distance) <= _TOUCHING * spacing, 0.0, distance), normals


def constrain(
    walls: Sequence[RigidWall], positions: FloatArray, velocity: FloatArray, time: float, spacing: float
) -> FloatArray:
    """Velocities (n, dim) [m/s] of nodes after the walls.

    Where several walls hold a node, those that slip or separate take turns until all are satisfied, friction acts with
    the first impulse of each; a wall that sticks overrules the others.

    Parameters
    ----------
    walls : sequence of RigidWall
        In any number.
    positions, velocity : (n, dim) array
        Of the nodes [m], [m/s]; not changed.
    time : float
        At which the walls are where they are [s].
    spacing : float
        Of the nodes [m].
    """
    out = np.array(velocity)
    found = []
    for wall in walls:
        distance, normals = wall.node_distance(positions, time, spacing)
        rows = np.flatnonzero(distance <= 0.0)
        found.append((wall, rows, normals[rows]))
    sliding = [each for each in found if each[0].kind != "stick" and each[1].size]
    for wall, rows, normals in sliding:
        out[rows] = _slide(wall, normals, out[rows], wall.friction)
    held = np.zeros(len(out), dtype=np.int64)
    for _, rows, _ in sliding:
        held[rows] += 1
    if np.any(held > 1):
        for _ in range(_SWEEPS):
            for wall, rows, normals in sliding:
                several = held[rows] > 1
                out[rows[several]] = _slide(wall, normals[several], out[rows[several]], 0.0)
    for wall, rows, _ in found:
        if wall.kind == "stick":
            out[rows] = wall.velocity
    return out


def _slide(wall: RigidWall, normals: FloatArray, velocity: FloatArray, friction: float) -> FloatArray:
    relative = velocity - wall.velocity
    across = np.einsum("ic,ic->i", relative, normals)
    tangential = relative - across[:, None] * normals
    kept = np.zeros_like(across) if wall.kind == "slip" else np.maximum(across, 0.0)
    if friction > 0.0:
        length = np.linalg.norm(tangential, axis=1)
        loss = friction * np.maximum(-across, 0.0)
        part = np.minimum(1.0, np.divide(loss, length, out=np.zeros_like(loss), where=length > 0.0))
        tangential *= 1.0 - part[:, None]
    return np.asarray(wall.velocity + tangential + kept[:, None] * normals)


def constrain_blocks(walls: Sequence[RigidWall], grid: BlockGrid, time: float) -> None:
    """Let walls act on the nodes of a grid; see `constrain`. Only blocks that are close to a wall are looked at."""
    if not walls or grid.blocks.size == 0:
        return
    half = 0.5 * (SIDE - 1) * grid.spacing
    centers = grid.node_corners * grid.spacing + half
    reach = half * np.sqrt(grid.dim) + 2.0 * _TOUCHING * grid.spacing
    is_near = np.zeros(len(centers), dtype=bool)
    for wall in walls:
        is_near |= wall.distance(centers, time)[0] <= reach
    near = np.flatnonzero(is_near)
    if near.size == 0:
        return
    # Nodes without mass stay at rest.
    block, node = np.nonzero(grid.mass[near] > 0.0)
    positions = grid.node_positions(near)[block, node]
    before = grid.velocity[near[block], node].astype(np.float64)
    grid.velocity[near[block], node] = constrain(walls, positions, before, time, grid.spacing)
