"""Muscle fibres in FP-PXPBD: the tension of a cell's fibres as an unknown beside its stress.

What the fibres of a cell can do to its corners is ``x_i = b_i - w_i h^2 V omega_i t`` with ``omega_i = grad N_i . v``,
b_i being the base point of the corner without their part, and t = T(l) y / l their pull at ``y = F v = sum omega_i
x_i``.
Their problem is one in y,

    y + s k t(y) = B,    s = h^2 V,  k = sum_i w_i omega_i^2,  B = sum_i omega_i b_i,

and, t and y being parallel, one in the length: ``l + s k T(l) = |B|``. It is solved exactly, between brackets. (The
published way adds the fibre's rank-one tangent to that of the cell; with the tension as an unknown of its own the
update of the stress stays what it is.) Where single components are prescribed k differs between them, and ``y_c = B_c /
(1 + s k_c T(l) / l)``.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from femdeform.fem.fibres import FibreCells
from femdeform.jit import njit, prange
from femdeform.materials.muscle_fibre import fibre_derivatives, fibre_forces
from femdeform.types import FloatArray, IntArray
from solvers.position_based.cell_layout import CellBatch

# Steps of the search for a length, and where it ends, relative to the length.
_SEARCH, _CLOSE = 100, 4e-16


@njit
def _pulled(length: Any, B: Any, mobility: Any, fibre: Any) -> Any:
    """y under the tension at a length, that tension over the length, and how much the length exceeds that of y."""
    tension, _ = fibre_derivatives(length, fibre)
    k = tension / length
    y = (B[0] / (1.0 + mobility[0] * k), B[1] / (1.0 + mobility[1] * k), B[2] / (1.0 + mobility[2] * k))
    return y, k, length - math.sqrt(y[0] * y[0] + y[1] * y[1] + y[2] * y[2])


@njit
def balanced_pull(B: Any, mobility: Any, length: Any, fibre: Any) -> Any:
    """The pull t(y) [Pa] where y + mobility t(y) = B, component by component.

    Parameters
    ----------
    B, mobility : tuple of 3 floats
        What y would be without the fibres [-], and what a pull moves it by [1/Pa].
    length : float
        Where to begin: of several solutions, which active fibres on their descending limb may have, one is found
        between here and where the fibres have less energy.
    fibre : MuscleFibre
        Parameters.
    """
    high = math.sqrt(B[0] * B[0] + B[1] * B[1] + B[2] * B[2])
    none = (0.0 * high, 0.0 * high, 0.0 * high)
    if not high > 0.0:
        return none
    y, k, above = _pulled(high, B, mobility, fibre)
    if not k > 0.0:
        return none
    low, below = 0.0 * high, -high
    tried = length
    side = 0
    for _ in range(_SEARCH):
        if not low < tried < high:
            tried = 0.5 * (low + high)
        y, k, excess = _pulled(tried, B, mobility, fibre)
        if excess == 0.0 or high - low <= _CLOSE * high:
            break
        # Regula falsi; the value at an end that stays a second time is halved, so that both ends move.
        if excess > 0.0:
            high, above = tried, excess
            below = 0.5 * below if side > 0 else below
            side = 1
        else:
            low, below = tried, excess
            above = 0.5 * above if side < 0 else above
            side = -1
        tried = (low * above - high * below) / (above - below)
    return (k * y[0], k * y[1], k * y[2])


@njit(parallel=True)
def relax_fibres(
    first: Any,
    last: Any,
    rows: Any,
    corners: Any,
    weights: Any,
    volumes: Any,
    masks: Any,
    dim: Any,
    fibre: Any,
    h2: Any,
    x: Any,
    pulls: Any,
) -> None:
    """Solve for the tension of the fibres from first to last, each with its cell's corners.

    Parameters
    ----------
    first, last : int
        Fibres of one colour.
    rows : (n,) int64
        Cells of the fibres.
    corners, volumes
        See `CellBatch`.
    weights : (n, dim + 1)
        grad N . v of the corners [1/m].
    masks : (n_cells, (dim + 1) dim) or (0, 0)
        0 where a component of a corner is prescribed; empty where none is by itself.
    dim : int
        Dimension.
    fibre : MuscleFibre
        Parameters.
    h2 : float
        [s^2].
    x : (n_nodes 8,)
        See `constraint_kernels`.
    pulls : (n, 3)
        t of each cell's fibres as it is in the base points [Pa].
    """
    n_corners = dim + 1
    for i in prange(last - first):
        r = first + i
        e = rows[r]
        s = h2 * volumes[e]
        o = corners[e, 0]
        B0 = B1 = B2 = y0 = y1 = y2 = k0 = k1 = k2 = 0.0
        for a in range(n_corners):
            c, w = corners[e, a], weights[r, a]
            B0 += w * (x[c + 4] - x[o + 4])
            B1 += w * (x[c + 5] - x[o + 5])
            B2 += w * (x[c + 6] - x[o + 6])
            y0 += w * (x[c] - x[o])
            y1 += w * (x[c + 1] - x[o + 1])
            y2 += w * (x[c + 2] - x[o + 2])
            k = s * x[c + 3] * w * w
            k0 += k if masks.shape[0] == 0 else k * masks[e, dim * a]
            k1 += k if masks.shape[0] == 0 else k * masks[e, dim * a + 1]
            if dim == 3:
                k2 += k if masks.shape[0] == 0 else k * masks[e, dim * a + 2]
        t0, t1, t2 = pulls[r, 0], pulls[r, 1], pulls[r, 2]
        B = (B0 + k0 * t0, B1 + k1 * t1, B2 + k2 * t2)
        t = balanced_pull(B, (k0, k1, k2), math.sqrt(y0 * y0 + y1 * y1 + y2 * y2), fibre)
        for a in range(n_corners):
            c = corners[e, a]
            k = s * x[c + 3] * weights[r, a]
            for m in range(dim):
                move = k * (pulls[r, m] - t[m])
                if masks.shape[0] > 0:
                    move *= masks[e, dim * a + m]
                x[c + 4 + m] += move
                x[c + m] = x[c + 4 + m]
        pulls[r, 0], pulls[r, 1], pulls[r, 2] = t[0], t[1], t[2]


class CellFibres:
    """The fibres of one muscle in one batch of cells.

    Parameters
    ----------
    batch : CellBatch
        The cells.
    fibres : FibreCells
        With rows of the batch.
    dim : int
        Dimension.
    stride : int
        Numbers a node.

    Attributes
    ----------
    pulls : (n, 3) float64
        t of the fibres as it is in the base points [Pa].
    """

    def __init__(self, batch: CellBatch, fibres: FibreCells, dim: int, stride: int) -> None:
        self._stride = stride
        self.batch, self.muscle, self.rows, self._dim = batch, fibres.muscle, fibres.rows, dim
        self.weights = np.ascontiguousarray(fibres.weights[:, 0])
        self.pulls = np.zeros((len(self.rows), 3))
        self._masks: FloatArray = np.empty((0, 0)) if isinstance(batch.masks, tuple) else batch.masks
        self._cuts: IntArray = np.searchsorted(self.rows, batch.offsets)

    def visit(self, color: int, h2: float, x: FloatArray) -> None:
        """Update the fibres of one colour."""
        first, last = int(self._cuts[color]), int(self._cuts[color + 1])
        if last > first:
            b = self.batch
            relax_fibres(
                first,
                last,
                self.rows,
                b.corners,
                self.weights,
                b.volumes,
                self._masks,
                self._dim,
                self.muscle.law,
                h2,
                x,
                self.pulls,
            )

    def current_pulls(self, points: FloatArray) -> FloatArray:
        """t of the fibres at positions (n_nodes, dim) by place [Pa], (n, 3)."""
        Y = np.zeros((len(self.rows), 3))
        Y[:, : self._dim] = np.einsum("na,nac->nc", self.weights, points[self._places()])
        return fibre_forces(Y, self.muscle.law)

    def add_push(self, h2: float, pulls: FloatArray, out: FloatArray) -> None:
        """Add ``-h^2 V omega_i t`` of pulls t (n, 3) at the corners to `out` (n_nodes, dim) by place."""
        size = -h2 * self.batch.volumes[self.rows]
        parts = size[:, None, None] * self.weights[:, :, None] * pulls[:, None, : self._dim]
        places = self._places().ravel()
        for c in range(self._dim):
            out[:, c] += np.bincount(places, parts[:, :, c].ravel(), minlength=len(out))

    def _places(self) -> IntArray:
        return (self.batch.corners[self.rows] // self._stride).astype(np.int64)
