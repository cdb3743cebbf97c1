"""XPBD and PBD on the constraints of a membrane or rod: edges, tethers, hinges, bends, an enclosed volume."""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.fem.thin_constraints import ThinConstraints, enclosed_volume, volume_gradient
from femdeform.fem.thin_kernels import BENDING, FLEX_X, FLEX_Y, FLEX_Z, TETHER, add_weighted, constraint
from femdeform.jit import njit, prange
from femdeform.types import BoolArray, FloatArray, IntArray
from solvers.coloring import color, moving_sets
from solvers.position_based.link_kernels import step_length

# Constraints that one thread takes at a time.
_CHUNK = 64


class ThinSweep:
    """Constraints of one body sorted by colour, with their multipliers, and one visit to all of them.

    Parameters
    ----------
    constraints : ThinConstraints
        With rows of nodes of the problem.
    place : (n_nodes,) int64
        Place of each node in the sweep.
    free : (n_nodes, 3) uint8
        0 where a component is prescribed; by place.
    stride : int
        Numbers a node.
    rigid : bool
        PBD: infinite stiffness.

    Limitations
    -----------
    Constraints at a node that moves are visited one after another: a tether to an anchor that is not held costs a
    colour a node. The volume is one constraint, visited last, by one thread.
    """

    def __init__(
        self,
        constraints: ThinConstraints,
        place: IntArray,
        free: np.ndarray[tuple[int, ...], np.dtype[np.uint8]],
        stride: int,
        rigid: bool,
    ) -> None:
        c = constraints
        self._free, self._stride, self._rigid = free, stride, rigid
        moves: BoolArray = np.any(free, axis=1)
        colors = _colors(c, moves[place])
        order = np.lexsort((c.kinds, colors))
        self._cuts = np.searchsorted(colors[order], np.arange(int(colors.max(initial=-1)) + 2))
        self._kinds, self._rests, self._stiffness = c.kinds[order], c.rests[order], c.stiffness[order]
        self._shares = c.shares[order]
        self._nodes = np.ascontiguousarray(place[c.nodes[order]])
        self._surface = place[c.surface]
        self._volume, self._bulk = c.volume, c.bulk
        self.multipliers = np.zeros(order.size)
        self.volume_multiplier = 0.0

    @property
    def n_colors(self) -> int:
        """Number of colours, one threaded loop each."""
        return self._cuts.size - 1

    def begin(self) -> None:
        """Multipliers of zero."""
        self.multipliers[:] = 0.0
        self.volume_multiplier = 0.0

    def sweep(self, x: FloatArray, h2: float, reverse: bool) -> None:
        """Visit every constraint once; see `LinkSweep.sweep`."""
        if reverse:
            self._keep_volume(x, h2)
        colors = range(self.n_colors)
        for c in reversed(colors) if reverse else colors:
            project_thin(
                int(self._cuts[c]),
                int(self._cuts[c + 1]),
                self._kinds,
                self._nodes,
                self._rests,
                self._shares,
                self._stiffness,
                self._stride,
                self._free,
                h2,
                self._rigid,
                x,
                self.multipliers,
            )
        if not reverse:
            self._keep_volume(x, h2)

    def _keep_volume(self, x: FloatArray, h2: float) -> None:
        if not self._surface.size:
            return
        fields = x.reshape(-1, self._stride)
        points = np.ascontiguousarray(fields[:, :3])
        gradient = np.where(self._free != 0, volume_gradient(points, self._surface), 0.0)
        pushed = fields[:, 3:4] * gradient
        W, s = float(np.sum(gradient * pushed)), h2 * self._bulk
        excess = enclosed_volume(points, self._surface) - self._volume
        step = float(step_length(excess, W, s, self.volume_multiplier, self._rigid))
        self.volume_multiplier += step
        fields[:, :3] += step * pushed

    def defects(self, points: FloatArray, h2: float, held: FloatArray, missing: FloatArray) -> None:
        """Add ``sum l grad C`` and ``sum (s C + l) grad C`` at the present positions; see `LinkSweep.defects`."""
        none = np.zeros_like(self._stiffness)
        rows = (self._kinds, self._nodes, self._rests, self._shares)
        add_weighted(*rows, none, self.multipliers, points, held)
        add_weighted(*rows, h2 * self._stiffness, self.multipliers, points, missing)
        if self._surface.size:
            gradient = volume_gradient(points, self._surface)
            excess = enclosed_volume(points, self._surface) - self._volume
            held += self.volume_multiplier * gradient
            missing += (h2 * self._bulk * excess + self.volume_multiplier) * gradient


def _colors(constraints: ThinConstraints, moves: BoolArray) -> IntArray:
    """Colours of the constraints, by the nodes that move; components of one bend move nothing in common."""
    kinds, nodes = constraints.kinds, constraints.nodes
    hinged, flat = kinds == BENDING, kinds < BENDING
    # Kinds lie one after another; a body has hinges or bends.
    later = (kinds == FLEX_Y) | (kinds == FLEX_Z)
    bends = (kinds > BENDING) & ~later
    colors = np.empty(kinds.size, dtype=np.int64)
    sets = [nodes[flat, :2], nodes[hinged], nodes[bends, :3]]
    colors[~later] = color(moving_sets(sets, moves).transposed())
    for kind in (FLEX_Y, FLEX_Z):
        colors[kinds == kind] = colors[kinds == FLEX_X]
    return colors


@njit
def _mobility(i: Any, g: Any, stride: Any, free: Any, x: Any) -> Any:
    """``g . m^-1 g`` of a gradient at the node in place i, over its free components."""
    total = g[0] * g[0] * free[i, 0] + g[1] * g[1] * free[i, 1] + g[2] * g[2] * free[i, 2]
    return x[stride * i + 3] * total


@njit
def _point(i: Any, stride: Any, x: Any) -> Any:
    p = stride * i
    return x[p], x[p + 1], x[p + 2]


@njit
def _move(i: Any, step: Any, g: Any, stride: Any, free: Any, x: Any) -> None:
    p = stride * i
    scale = step * x[p + 3]
    for a in range(3):
        # Another thread may move a component that this constraint does not have.
        if free[i, a] != 0 and g[a] != 0.0:
            x[p + a] += scale * g[a]


@njit(parallel=True)
def project_thin(
    first: Any,
    last: Any,
    kinds: Any,
    nodes: Any,
    rests: Any,
    shares: Any,
    stiffness: Any,
    stride: Any,
    free: Any,
    h2: Any,
    rigid: Any,
    x: Any,
    multipliers: Any,
) -> None:
    """XPBD's step of the constraints from first to last, each by itself; no two of them move a node in common.

    Multipliers of tethers are not positive: they only pull.

    Parameters
    ----------
    first, last : int
        Constraints of one colour.
    kinds, nodes, rests, shares, stiffness
        See `ThinConstraints`; nodes by place.
    stride, free, h2, rigid, x
        See `link_kernels.project_rows`.
    multipliers : (n,)
        [kg m] or [kg m^2].
    """
    for c in prange((last - first + _CHUNK - 1) // _CHUNK):
        for r in range(first + c * _CHUNK, min(first + (c + 1) * _CHUNK, last)):
            i, j, k, m = nodes[r, 0], nodes[r, 1], nodes[r, 2], nodes[r, 3]
            C, gi, gj, gk, gm = constraint(
                kinds[r],
                rests[r],
                shares[r],
                _point(i, stride, x),
                _point(j, stride, x),
                _point(k, stride, x),
                _point(m, stride, x),
            )
            W = _mobility(i, gi, stride, free, x) + _mobility(j, gj, stride, free, x)
            if kinds[r] >= BENDING:
                W += _mobility(k, gk, stride, free, x)
            if kinds[r] == BENDING:
                W += _mobility(m, gm, stride, free, x)
            if kinds[r] == TETHER and rigid and C <= 0.0:
                continue
            step = step_length(C, W, h2 * stiffness[r], multipliers[r], rigid)
            if kinds[r] == TETHER:
                step = min(step, -multipliers[r])
            if W == 0.0:
                continue
            multipliers[r] += step
            _move(i, step, gi, stride, free, x)
            _move(j, step, gj, stride, free, x)
            if kinds[r] >= BENDING:
                _move(k, step, gk, stride, free, x)
            if kinds[r] == BENDING:
                _move(m, step, gm, stride, free, x)
