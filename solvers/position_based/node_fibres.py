"""Muscle fibres in a sweep over nodes: what they add to a node's force and matrix, and how far a step may go.

Moving node i by s moves ``y = F v`` by ``w_i s`` with ``w_i = grad N_i . v``. So fibres add ``-V w_i T n`` to the force
and ``V w_i^2 (a n n^T + c (I - n n^T))`` to the matrix, T being the tension at the length l = |y| along n = y / l.
The exact values are a = T' and c = T / l; but T' grows with the length where fibres are stiffest, so they bound no
step. Along a straight line the second derivative of the energy at the length m is

    T'(m) s_n'^2 + T(m) l^2 / m^3 s_p^2,    s_n'^2 = s_n^2 + s_p^2 (1 - l^2 / m^2),

s_n and s_p being the parts of w_i s along n and across it. With the suprema of T' (at least 0) and T over the lengths
within a reach r of l

    a = sup T',    c = sup T l^2 / (l - r)^3 + a (1 - l^2 / (l + r)^2)

bound every step with |w_i s| <= r. Longer steps are looked at, and halved until the energy is below the parabola.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from femdeform.fem.fibres import FibreCells
from femdeform.jit import njit, prange
from femdeform.materials import with_precision
from femdeform.materials.muscle_fibre import axial_matrix, fibre_derivatives, fibre_energy
from femdeform.step_problem import LocalCells
from femdeform.types import FloatArray
from solvers.position_based import layout
from solvers.position_based.node_kernels import add_terms, quadratic_form

# Reach of the bound in parts of the optimal length, and halvings after which a node waits for its neighbours.
REACH = 0.02
_HALVINGS = 30


@njit
def bounds(length: float, fibre: Any) -> tuple[float, float]:
    """Return (a, c) [Pa], see above, at a length of at least 0."""
    optimum, alpha = fibre.optimal_stretch, fibre.activation
    q = length / optimum
    low, high = q - REACH, q + REACH
    if not high > (0.4 if alpha > 0.0 else 1.0):
        return 0.0, 0.0
    scale = fibre.stress / optimum
    slope = 0.33 * math.exp(6.6 * (high - 1.0)) if high > 1.0 else 0.0
    tension = 0.05 * math.expm1(6.6 * (high - 1.0)) if high > 1.0 else 0.0
    if high < 0.6:
        u = max(high - 0.4, 0.0)
        slope += alpha * 18.0 * u
        tension += alpha * 9.0 * u * u
    elif low < 0.6:
        slope += alpha * 3.6
        tension += alpha * (1.0 - 4.0 * (high - 1.0) * (high - 1.0))
    elif low < 1.6:
        steepest = 8.0 * (1.0 - low) if low < 1.4 else -3.6
        if high > 1.4:
            steepest = max(steepest, 18.0 * (min(high, 1.6) - 1.6))
        slope += alpha * steepest
        # The place in reach that is nearest to the peak.
        best = min(max(1.0, low), high)
        if best <= 1.4:
            tension += alpha * (1.0 - 4.0 * (best - 1.0) * (best - 1.0))
        else:
            tension += alpha * 9.0 * (best - 1.6) * (best - 1.6)
    along = scale / optimum * max(slope, 0.0)
    shorter, longer = q / low, q / high
    across = scale / optimum * tension / low * shorter * shorter + along * (1.0 - longer * longer)
    return along, across


@njit
def visit_vector(x: Any, i: Any, others: Any, weights: Any, v: Any) -> Any:
    """y = F v of the cell of visit v of the node at flat place i."""
    last = others.shape[0] - 1
    b = others[last, v]
    w = weights[0, v]
    y0, y1, y2 = w * (x[i] - x[b]), w * (x[i + 1] - x[b + 1]), w * (x[i + 2] - x[b + 2])
    for k in range(last):
        j, w = others[k, v], weights[k + 1, v]
        y0 += w * (x[j] - x[b])
        y1 += w * (x[j + 1] - x[b + 1])
        y2 += w * (x[j + 2] - x[b + 2])
    return (y0, y1, y2)


@njit
def fibre_terms(x: Any, i: Any, first: Any, last: Any, others: Any, weights: Any, volumes: Any, fibre: Any) -> Any:
    """Force [N] and matrix [N/m] that the visits from first to last give the node at flat place i, nine numbers."""
    f0 = f1 = f2 = 0.0
    a0 = a1 = a2 = a3 = a4 = a5 = 0.0
    for v in range(first, last):
        y = visit_vector(x, i, others, weights, v)
        length = math.sqrt(y[0] * y[0] + y[1] * y[1] + y[2] * y[2])
        along, across = bounds(length, fibre)
        if not across > 0.0:
            continue
        w = volumes[v] * weights[0, v]
        tension, _ = fibre_derivatives(length, fibre)
        k = w * tension / length
        f0 -= k * y[0]
        f1 -= k * y[1]
        f2 -= k * y[2]
        w *= weights[0, v]
        A = axial_matrix(y, w * along, w * across)
        a0 += A[0]
        a1 += A[1]
        a2 += A[2]
        a3 += A[3]
        a4 += A[4]
        a5 += A[5]
    return (f0, f1, f2, a0, a1, a2, a3, a4, a5)


@njit(parallel=True)
def add_fibres(
    chunks: Any, nodes: Any, offsets: Any, others: Any, weights: Any, volumes: Any, fibre: Any, x: Any, acc: Any
) -> None:
    """Add forces and matrices of the nodes of one colour from the fibres of one muscle.

    Parameters
    ----------
    chunks, nodes, offsets, others, volumes
        See `node_kernels.add_cells`.
    weights : (dim, n_visits)
        grad N . v of the node and of the others but the last [1/m].
    fibre : MuscleFibre
        Parameters.
    x : (3 n_nodes,)
        Positions [m].
    acc : (9 n_nodes,)
        Added to.
    """
    for c in prange(chunks.size - 1):
        for r in range(chunks[c], chunks[c + 1]):
            i = nodes[r]
            terms = fibre_terms(x, 3 * i, offsets[r], offsets[r + 1], others, weights, volumes, fibre)
            add_terms(terms, acc, 9 * i)


@njit
def _energy(
    x: Any, i: Any, s: Any, first: Any, last: Any, others: Any, weights: Any, volumes: Any, fibre: Any
) -> tuple[float, float]:
    """Energies of the fibres of a node's cells when it has moved by s [J]: their sum, and the sum of their sizes."""
    energy = size = 0.0
    for v in range(first, last):
        y = visit_vector(x, i, others, weights, v)
        w = weights[0, v]
        y0, y1, y2 = y[0] + w * s[0], y[1] + w * s[1], y[2] + w * s[2]
        part = volumes[v] * fibre_energy(math.sqrt(y0 * y0 + y1 * y1 + y2 * y2), fibre)
        energy += part
        size += abs(part)
    return energy, size


@njit(parallel=True)
def shorten_steps(
    chunks: Any,
    nodes: Any,
    offsets: Any,
    others: Any,
    weights: Any,
    volumes: Any,
    fibre: Any,
    flat: Any,
    most: Any,
    x: Any,
    steps: Any,
    parts: Any,
) -> None:
    """Halve the steps of the nodes of one colour until the energy of the fibres is where it should be.

    See `node_kernels.shorten_steps`; steps within the reach of the bound are not looked at.
    """
    for c in prange(chunks.size - 1):
        for r in range(chunks[c], chunks[c + 1]):
            i = nodes[r]
            p = 3 * i
            first, last = offsets[r], offsets[r + 1]
            s = (steps[p], steps[p + 1], steps[p + 2])
            steepest = 0.0
            for v in range(first, last):
                steepest = max(steepest, abs(weights[0, v]))
            t = parts[i]
            farthest = REACH * fibre.optimal_stretch
            if t * steepest * math.sqrt(s[0] * s[0] + s[1] * s[1] + s[2] * s[2]) <= farthest:
                continue
            rest = (s[0] - s[0], s[1] - s[1], s[2] - s[2])
            before, size = _energy(x, p, rest, first, last, others, weights, volumes, fibre)
            terms = fibre_terms(x, p, first, last, others, weights, volumes, fibre)
            work = terms[0] * s[0] + terms[1] * s[1] + terms[2] * s[2]
            margin = 0.5 * quadratic_form(terms, s)
            for k in range(most + 1):
                if k == most:
                    t = 0.0 * t
                    break
                reached = (t * s[0], t * s[1], t * s[2])
                after, _ = _energy(x, p, reached, first, last, others, weights, volumes, fibre)
                if after - before + t * work <= t * margin + flat * size:
                    break
                t = t * 0.5
            parts[i] = t


class NodeFibres:
    """Visits of moving nodes to the cells of one muscle.

    Parameters
    ----------
    cells : LocalCells
        The cells that the rows of the fibres mean.
    fibres : FibreCells
    numbering : layout.Numbering
    dtype : numpy type
        Precision of the sweep.
    """

    def __init__(self, cells: LocalCells, fibres: FibreCells, numbering: layout.Numbering, dtype: Any) -> None:
        self.muscle = fibres.muscle
        self.dtype = np.dtype(dtype)
        self._flat = float(np.finfo(dtype).eps)
        part = LocalCells(
            fibres.muscle.law, cells.cells[fibres.rows], fibres.weights[:, 0, :, None], cells.volumes[fibres.rows]
        )
        self.visits = layout.list_visits(part, numbering, dtype)

    def _law(self) -> Any:
        """The muscle's law at the time of the step begun, in the precision of the sweep."""
        law: Any = self.muscle.law
        return with_precision(law, self.dtype)

    def add(self, color: int, x: FloatArray, acc: FloatArray) -> None:
        """Add forces and matrices of the nodes of one colour."""
        v = self.visits
        add_fibres(v.chunks[color], v.nodes, v.offsets, v.others, v.gradients, v.volumes, self._law(), x, acc)

    def shorten(self, color: int, x: FloatArray, steps: FloatArray, parts: FloatArray) -> None:
        """Lower the parts of steps that these fibres allow."""
        v = self.visits
        shorten_steps(
            v.chunks[color],
            v.nodes,
            v.offsets,
            v.others,
            v.gradients,
            v.volumes,
            self._law(),
            self._flat,
            _HALVINGS,
            x,
            steps,
            parts,
        )
