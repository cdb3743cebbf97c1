"""A grid of which only the blocks of nodes near points exist, and sets of points that are sorted by block."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.errors import InputError
from femdeform.mpm import block_kernels as kernels
from femdeform.mpm.block_kernels import REACH, SIDE
from femdeform.mpm.explicit_laws import Liquid
from femdeform.mpm.particles import Particles
from femdeform.types import BoolArray, FloatArray, IntArray

# Points are moved in memory when this part of them no longer follows its neighbour.
_BROKEN = 1.0 / 16.0
# Nodes below this part of the largest mass of a point have no velocity: they hold rounding.
_FLOOR = 1e-14


class PointsOutsideError(InputError):
    """Points have left the domain of the grid, or are no longer numbers."""


@dataclass
class PointSet:
    """Points of one material, as the kernels want them: sorted by block, in the type of numbers of the run.

    Attributes
    ----------
    law : NamedTuple
        A law of `femdeform.materials` or `Liquid`.
    x, v, affine, mass, volume
        See `Particles`.
    state : (n, dim, dim) or (n,) array
        F of solids, J of liquids.
    numbers : (n,) int64
        Rows of these points in the particles they came from.
    order : (n,) int32
        Points block after block; nearly ascending.
    blocks : (n_own,) int32
        Blocks that have points of this set, ascending.
    first : (n_own + 1,) int64
        Where the points of each begin in `order`.
    starts : (n_blocks + 1,) int64
        The same for all blocks of the grid.
    """

    law: Any
    x: FloatArray
    v: FloatArray
    affine: FloatArray
    mass: FloatArray
    volume: FloatArray
    state: FloatArray
    numbers: IntArray
    order: np.ndarray[Any, np.dtype[np.int32]]
    blocks: np.ndarray[Any, np.dtype[np.int32]]
    first: IntArray
    starts: IntArray

    @classmethod
    def of(cls, particles: Particles, numbers: IntArray, law: Any, dtype: Any) -> PointSet:
        """The given rows of particles, copied."""
        state = particles.J if isinstance(law, Liquid) else particles.F
        # Parameters of the type of the points: kernels compute in it.
        law = type(law)(*(np.dtype(dtype).type(value) for value in law))

        def own(values: FloatArray) -> FloatArray:
            return np.ascontiguousarray(values[numbers], dtype=dtype)

        return cls(
            law=law,
            x=own(particles.x),
            v=own(particles.v),
            affine=own(particles.affine),
            mass=own(particles.mass),
            volume=own(particles.volume),
            state=own(state),
            numbers=numbers.copy(),
            order=np.arange(numbers.size, dtype=np.int32),
            blocks=np.empty(0, np.int32),
            first=np.zeros(1, np.int64),
            starts=np.zeros(1, np.int64),
        )

    @property
    def n(self) -> int:
        """Number of points."""
        return int(self.mass.size)

    def _move(self) -> None:
        """Put the points in memory in their order."""
        for name in ("x", "v", "affine", "mass", "volume", "state", "numbers"):
            setattr(self, name, getattr(self, name)[self.order])
        self.order = np.arange(self.n, dtype=np.int32)

    def sort(self, grid: BlockGrid) -> None:
        """Sort by block, and by number in each; the arrays are moved only when many points are out of place.

        So what a step does depends on the points and their numbers, not on the steps before it.

        Raises
        ------
        PointsOutsideError
        """
        of_point = grid.blocks_of(self.x)
        touched = np.empty(self.n, np.int32)
        first = np.empty(self.n + 1, np.int64)
        n_blocks = kernels.sort_by_block(of_point, grid.counts, touched, first, self.order)
        self.blocks, self.first = touched[:n_blocks], first[: n_blocks + 1]
        kernels.order_in_blocks(self.numbers, self.first, self.order)
        n_breaks = np.count_nonzero(np.diff(self.order) != 1)
        if n_breaks > _BROKEN * self.n:
            self._move()


class BlockGrid:
    """Blocks of nodes inside a box; node i lies at ``i spacing``.

    Parameters
    ----------
    spacing : float
        Distance of the nodes [m].
    low, high : (dim,) array
        The domain [m]; points must stay in it.
    dtype : type
        float64 or float32, of all fields of the nodes.

    Attributes
    ----------
    blocks : (n_blocks,) int32
        Blocks that have points, ascending.
    corners : (n_blocks, dim) float64
        Index of their first nodes.
    near : (n_blocks, 2^dim) int32
        Blocks of nodes that the points of each reach.
    node_corners : (n_node_blocks, dim) float64
        Index of the first node of each block of nodes.
    mass : (n_node_blocks, SIDE^dim)
        [kg].
    velocity : (n_node_blocks, SIDE^dim, dim)
        [m/s]; zero where there is no mass.
    arena : (n_blocks, REACH^dim, dim + 1)
        What each block has summed; see `block_kernels`.
    """

    def __init__(self, spacing: float, low: FloatArray, high: FloatArray, dtype: Any = np.float64) -> None:
        self.spacing = float(spacing)
        self.low, self.high = np.array(low, dtype=float), np.array(high, dtype=float)
        self.dtype = np.dtype(dtype)
        self.dim = self.low.size
        if not np.all(self.high > self.low):
            raise InputError("grid: the domain is empty: each component of `max` has to be larger than that of `min`")
        self.first = np.floor(self.low / spacing - 0.5) - 1.0
        last = np.floor(self.high / spacing - 0.5) + 1.0
        # One block more at the end, for nodes.
        self.shape = ((last - self.first).astype(np.int64) // SIDE) + 2
        n_table = float(np.prod(self.shape.astype(float)))
        if n_table >= 2.0**31:
            raise InputError("grid.cell_size: too small for the domain: there would be more than 2^31 blocks of nodes")
        self.counts = np.zeros(int(n_table), np.int32)
        dim = self.dim
        self._strides = np.append(np.cumprod(self.shape[::-1])[-2::-1], 1)
        self._sides = _lattice(2, dim)
        inner, reached = _lattice(SIDE, dim), _lattice(REACH, dim)
        # Node i of a block seen from the block that lies `side` before it, and back.
        there = inner[:, None] + SIDE * self._sides
        flat = there @ REACH ** np.arange(dim - 1, -1, -1)
        self._places = np.where((there < REACH).all(axis=2), flat, -1).astype(np.int32)
        powers = np.arange(dim - 1, -1, -1)
        which, place = (reached // SIDE) @ 2**powers, (reached % SIDE) @ SIDE**powers
        self.sources = np.column_stack([which, place]).astype(np.int32)
        self._inner = inner
        self.blocks: np.ndarray[Any, np.dtype[np.int32]] = np.empty(0, np.int32)
        self._lay(self.blocks)

    def blocks_of(self, x: FloatArray) -> np.ndarray[Any, np.dtype[np.int32]]:
        """Block of each point (n, dim).

        Raises
        ------
        PointsOutsideError
        """
        out = np.empty(len(x), np.int32)
        is_bad = np.zeros((len(x) + kernels.CHUNK - 1) // kernels.CHUNK, np.uint8)
        kernels.blocks_of(x, self.spacing, self.first, self.shape, self.low, self.high, out, is_bad)
        if is_bad.any():
            outside = ~((x >= self.low) & (x <= self.high)).all(axis=1)
            row = int(np.flatnonzero(outside)[0])
            raise PointsOutsideError(
                f"{int(outside.sum())} material points are outside of the domain, or not numbers; the first is at "
                f"{x[row].tolist()} m: walls have to hold them, or the domain has to be larger"
            )
        return out

    def activate(self, sets: list[PointSet]) -> None:
        """Sort the sets and make the blocks near their points."""
        for points in sets:
            points.sort(self)
        blocks = np.unique(np.concatenate([self.blocks[:0], *(points.blocks for points in sets)]))
        if not np.array_equal(blocks, self.blocks):
            self._lay(blocks)
        for points in sets:
            points.starts = np.append(points.first[np.searchsorted(points.blocks, blocks)], points.n)

    def _lay(self, blocks: np.ndarray[Any, np.dtype[np.int32]]) -> None:
        dim = self.dim
        self.blocks = blocks
        index = np.stack(np.unravel_index(blocks, tuple(self.shape)), axis=1).reshape(-1, dim)
        self.corners = self.first + SIDE * index
        reached = (index[:, None] + self._sides) @ self._strides
        nodes = np.unique(reached)
        self.near = np.searchsorted(nodes, reached).astype(np.int32)
        node_index = np.stack(np.unravel_index(nodes, tuple(self.shape)), axis=1).reshape(-1, dim)
        self.node_corners = self.first + SIDE * node_index
        self._parts = np.full((nodes.size, 2**dim), -1, np.int32)
        for side in range(2**dim):
            self._parts[self.near[:, side], side] = np.arange(blocks.size)
        self.mass = np.zeros((nodes.size, SIDE**dim), self.dtype)
        self.velocity = np.zeros((nodes.size, SIDE**dim, dim), self.dtype)
        self.arena = np.empty((blocks.size, REACH**dim, dim + 1), self.dtype)

    def collect(self, push: FloatArray, adds: bool, largest_mass: float) -> None:
        """Masses and velocities of the nodes from what the blocks hold, and `push` [m/s] on top; see the kernel."""
        kernels.collect(
            self.arena,
            self._parts,
            self._places,
            self.dtype.type(_FLOOR * largest_mass),
            push.astype(self.dtype),
            adds,
            self.mass,
            self.velocity,
        )

    def node_positions(self, which: IntArray | BoolArray | slice = slice(None)) -> FloatArray:
        """Positions of the nodes of some blocks of nodes, (n, SIDE^dim, dim) [m]."""
        return np.asarray((self.node_corners[which][:, None] + self._inner) * self.spacing)

    def fastest(self) -> float:
        """Largest speed of a node [m/s]."""
        return float(np.sqrt(np.max(np.einsum("nic,nic->ni", self.velocity, self.velocity), initial=0.0)))


def _lattice(side: int, dim: int) -> IntArray:
    """Index of the nodes of a cube of nodes, (side^dim, dim), the last axis fastest."""
    return np.stack(np.meshgrid(*[np.arange(side)] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
