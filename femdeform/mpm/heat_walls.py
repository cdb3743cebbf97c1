"""Walls that keep their temperature, in the conduction of heat on a grid.

Nodes in such a wall, and those less than half a cell outside of it, are no unknowns. Each continues the temperature of
a free node beside it in a straight line through that of the wall,

    T_i = T_wall + (phi_i / phi_j) (T_j - T_wall),

with the signed distances phi and j the closest free node on the grid line through i that lies most across the wall.
Across a wall along the axes such fields, and test functions of the same kind, meet the condition at the wall exactly,
wherever it lies between the nodes: temperatures that are linear across it are exact. The matrix of the free nodes stays
symmetric and positive definite.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy.sparse

from femdeform.types import BoolArray, FloatArray, IntArray

# Cells within which a free node is looked for.
_REACH = 4


class TemperedWall(Protocol):
    """A wall as heat sees it."""

    @property
    def temperature(self) -> float | None:
        """What it keeps bodies at [K]; None where no heat goes through it."""

    def node_distance(self, nodes: FloatArray, time: float, spacing: float) -> tuple[FloatArray, FloatArray]:
        """Signed distance (n,) [m] and unit normal (n, dim) at grid nodes (n, dim) and a time."""


@dataclass(frozen=True)
class HeldTemperatures:
    """Nodes whose temperatures follow from those of others: ``T[nodes] = constant + slope T``.

    Attributes
    ----------
    nodes : (n,) int64
    constant : (n,) float64
        [K].
    slope : SciPy CSR matrix (n, n_nodes)
        Columns are those of free nodes.
    """

    nodes: IntArray
    constant: FloatArray
    slope: Any

    def spread(self, free: FloatArray) -> FloatArray:
        """Changes of all nodes (n_nodes,) from those of the free ones."""
        out = free.copy()
        out[self.nodes] = self.slope @ free
        return out

    def collect(self, residual: FloatArray) -> FloatArray:
        """The transpose of `spread`: residuals (n_nodes,) of the free nodes, zero at those held."""
        out = residual + self.slope.T @ residual[self.nodes]
        out[self.nodes] = 0.0
        return np.asarray(out)


def hold_temperatures(
    walls: Sequence[TemperedWall], positions: FloatArray, spacing: float, active: BoolArray, time: float
) -> HeldTemperatures | None:
    """Nodes that walls keep at a temperature; None if there are none.

    Parameters
    ----------
    walls : sequence of TemperedWall
        Of two at a node the first one counts.
    positions : (n_nodes, dim) float64
        Grid nodes in lexicographic order [m].
    spacing : float
        dx [m].
    active : (n_nodes,) bool
        Nodes that take part in the conduction.
    time : float
        [s].
    """
    n = len(positions)
    tempered = [wall for wall in walls if wall.temperature is not None]
    wall_of, across = np.full(n, -1), np.zeros(n, dtype=np.int64)
    phi, of_wall = np.zeros((len(tempered), n)), np.zeros(n)
    towards = np.zeros(n, dtype=np.int64)
    for number, wall in enumerate(tempered):
        phi[number], normal = wall.node_distance(positions, time, spacing)
        axis = np.argmax(np.abs(normal), axis=1)
        along = np.take_along_axis(normal, axis[:, None], axis=1)[:, 0]
        mine = np.flatnonzero((wall_of < 0) & active & (phi[number] <= 0.5 * spacing * np.abs(along)))
        wall_of[mine], of_wall[mine] = number, wall.temperature
        across[mine], towards[mine] = axis[mine], np.where(along[mine] > 0.0, 1, -1)
    nodes = np.flatnonzero(wall_of >= 0)
    if nodes.size == 0:
        return None
    beside = _closest_free(positions, spacing, active & (wall_of < 0), nodes, across[nodes], towards[nodes])
    found = np.flatnonzero(beside >= 0)
    held, other = nodes[found], beside[found]
    ratio = np.zeros(nodes.size)
    ratio[found] = phi[wall_of[held], held] / phi[wall_of[held], other]
    # Where no free node is near, in a film, the wall alone counts.
    slope = scipy.sparse.csr_matrix((ratio[found], (found, other)), shape=(nodes.size, n))
    return HeldTemperatures(nodes, of_wall[nodes] * (1.0 - ratio), slope)


def _closest_free(
    positions: FloatArray, spacing: float, is_free: BoolArray, nodes: IntArray, axis: IntArray, towards: IntArray
) -> IntArray:
    """Closest free node (n,) on the line through each of some nodes, along an axis in one direction; -1 if none is."""
    dim = positions.shape[1]
    index = np.rint(positions / spacing).astype(np.int64)
    # With a margin, so that places outside are not those of another row.
    index -= index.min(axis=0) - _REACH
    extent = index.max(axis=0) + 1 + _REACH
    strides = np.append(np.cumprod(extent[::-1])[-2::-1], 1).astype(np.int64)
    keys = index @ strides
    out = np.full(nodes.size, -1)
    for k in range(1, _REACH + 1):
        left = np.flatnonzero(out < 0)
        shift = np.zeros((left.size, dim), dtype=np.int64)
        shift[np.arange(left.size), axis[left]] = k * towards[left]
        wanted = keys[nodes[left]] + shift @ strides
        place = np.minimum(np.searchsorted(keys, wanted), keys.size - 1)
        found = (keys[place] == wanted) & is_free[place]
        out[left[found]] = place[found]
    return out
