"""Walls that keep their temperature, in the conduction of heat on a grid.

Nodes in such a wall are no unknowns. A node at the signed distance phi <= 0 continues the temperature on the free side
in a straight line through that of the wall,

    T_i = T_wall + (phi_i / s) (T(y) - T_wall),          y = x_i + (s - phi_i) n,

with a place y at the distance s = max(|phi_i|, dx) from the wall, at which the values of the free nodes around it are
interpolated. Temperatures that are linear across a plane wall are then exact wherever it lies between the nodes. Test
functions follow the same rule, so the matrix of the free nodes stays symmetric and positive definite.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from femdeform.types import BoolArray, FloatArray, IntArray

# Weights of a place's nodes that count as none.
_SMALLEST = 1e-9


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
    n, dim = positions.shape
    wall_of, phi, normals = np.full(n, -1), np.zeros(n), np.zeros((n, dim))
    tempered = [wall for wall in walls if wall.temperature is not None]
    for number, wall in enumerate(tempered):
        distance, normal = wall.node_distance(positions, time, spacing)
        mine = np.flatnonzero((wall_of < 0) & active & (distance <= 0.0))
        wall_of[mine], phi[mine], normals[mine] = number, distance[mine], normal[mine]
    nodes = np.flatnonzero(wall_of >= 0)
    if nodes.size == 0:
        return None
    of_wall = np.array([wall.temperature for wall in tempered], dtype=np.float64)[wall_of[nodes]]
    is_free = active & (wall_of < 0)
    slope = _Places(positions, spacing, is_free).slope(positions[nodes], phi[nodes], normals[nodes])
    constant = of_wall * (1.0 - np.asarray(slope.sum(axis=1)).ravel())
    return HeldTemperatures(nodes, constant, slope)


class _Places:
    """Interpolation between free nodes of a grid."""

    def __init__(self, positions: FloatArray, spacing: float, is_free: BoolArray) -> None:
        self._spacing, self._is_free = spacing, is_free
        index = np.rint(positions / spacing).astype(np.int64)
        # With a margin for places outside, whose nodes must not be taken for those of another row.
        self._low = index.min(axis=0) - 4
        extent = index.max(axis=0) + 5 - self._low
        self._extent = extent
        self._strides = np.append(np.cumprod(extent[::-1])[-2::-1], 1).astype(np.int64)
        self._keys = (index - self._low) @ self._strides

    def slope(self, x: FloatArray, phi: FloatArray, normals: FloatArray) -> Any:
        """Rows ``phi/s`` times the weights of the places of nodes x (n, dim); empty where a place has no free nodes."""
        import scipy.sparse

        n, dim = x.shape
        rows, columns, values = [], [], []
        left = np.arange(n)
        # A second place farther off where the nearest one touches the wall: in a cell that lies aslant.
        for reach in (1.0, float(np.sqrt(dim))):
            s = np.maximum(-phi[left], reach * self._spacing)
            y = x[left] + (s - phi[left])[:, None] * normals[left]
            nodes, weights, known = self._around(y)
            ratio = (phi[left] / s)[:, None] * weights
            found = np.flatnonzero(known)
            rows.append(np.repeat(left[found], nodes.shape[1]))
            columns.append(nodes[found].ravel())
            values.append(ratio[found].ravel())
            left = left[~known]
        row, column, value = np.concatenate(rows), np.concatenate(columns), np.concatenate(values)
        kept = value != 0.0
        shape = (n, self._keys.size)
        return scipy.sparse.csr_matrix((value[kept], (row[kept], column[kept])), shape=shape)

    def _around(self, y: FloatArray) -> tuple[IntArray, FloatArray, BoolArray]:
        """Corners of the cells around places (n, 2^dim), their weights, and whether all that count are free."""
        dim = y.shape[1]
        place = y / self._spacing
        base = np.floor(place).astype(np.int64)
        f = place - base
        corners = np.stack(np.meshgrid(*[[0, 1]] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
        weights = np.prod(np.where(corners[None] == 1, f[:, None], 1.0 - f[:, None]), axis=2)
        weights = np.where(weights > _SMALLEST, weights, 0.0)
        weights /= weights.sum(axis=1, keepdims=True)
        index = base[:, None] + corners[None] - self._low
        within = ((index >= 0) & (index < self._extent)).all(axis=2)
        keys = np.where(within, index @ self._strides, -1)
        nodes = np.minimum(np.searchsorted(self._keys, keys), self._keys.size - 1)
        free = (self._keys[nodes] == keys) & self._is_free[nodes]
        return nodes, weights, np.asarray((free | (weights == 0.0)).all(axis=1))
