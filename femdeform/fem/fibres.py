"""Muscles in the discretization: which cells carry fibres, along which direction, and how active they are.

A cell with fibres along v stretches them to ``y = F v = sum_a x_a (grad N_a . v)``: all that fibres need of a cell are
the numbers ``grad N_a . v``, which are constant.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from femdeform.materials.muscle_fibre import MuscleFibre
from femdeform.types import FloatArray, IntArray


@dataclass
class Muscle:
    """The fibres of one muscle: their law at the time that was set last.

    Parameters
    ----------
    stress, optimal_stretch : float
        See `MuscleFibre`.
    activation : callable
        Activation from 0 to 1 over time.

    Attributes
    ----------
    law : MuscleFibre
        With the activation of the time set; shared by all that knows the muscle.
    """

    stress: float
    optimal_stretch: float
    activation: Callable[[float], float]
    law: MuscleFibre = field(init=False)

    def __post_init__(self) -> None:
        self.set_time(0.0)

    def set_time(self, time: float) -> None:
        """Set the activation to that of a time [s]."""
        self.law = MuscleFibre(float(self.stress), float(self.optimal_stretch), float(self.activation(time)))


@dataclass(frozen=True)
class FibreInput:
    """Cells of a body's mesh that belong to a muscle.

    Attributes
    ----------
    cells : (n,) int64
        Cells of the mesh.
    directions : (n, dim) float64
        Unit directions of their fibres in the reference state.
    muscle : Muscle
    """

    cells: IntArray
    directions: FloatArray
    muscle: Muscle


@dataclass(frozen=True)
class FibreCells:
    """Cells of a list of cells that belong to a muscle.

    Attributes
    ----------
    rows : (n,) int64
        Rows of the list, ascending.
    weights : (n, n_q, n_nodes) float64
        grad N_a . v at the quadrature points [1/m].
    directions : (n, dim) float64
        Unit directions v of the fibres in the reference state.
    muscle : Muscle
    """

    rows: IntArray
    weights: FloatArray
    directions: FloatArray
    muscle: Muscle

    def shifted(self, offset: int) -> FibreCells:
        """The same cells in a list in which they come later by `offset` rows."""
        return replace(self, rows=self.rows + offset)

    def taken(self, chosen: IntArray, n_cells: int) -> FibreCells:
        """The cells that are left where the list of `n_cells` is replaced by its rows `chosen`, in that order."""
        place = np.full(n_cells, -1, dtype=np.int64)
        place[chosen] = np.arange(len(chosen))
        rows = place[self.rows]
        order = np.argsort(rows, kind="stable")
        order = order[rows[order] >= 0]
        return replace(self, rows=rows[order], weights=self.weights[order], directions=self.directions[order])


def fibre_cells(inputs: FibreInput, cell_ids: IntArray, gradients: FloatArray) -> FibreCells:
    """Those cells of a list that belong to a muscle.

    Parameters
    ----------
    inputs : FibreInput
        The muscle.
    cell_ids : (n_cells,) int64
        Cell of the mesh that each row of the list is.
    gradients : (n_cells, n_q, n_nodes, dim) float64
        Gradients of the shape functions [1/m].
    """
    order = np.argsort(inputs.cells)
    known = inputs.cells[order]
    place = np.minimum(np.searchsorted(known, cell_ids), max(len(known) - 1, 0))
    rows = np.flatnonzero(known[place] == cell_ids) if known.size else np.empty(0, dtype=np.int64)
    directions = np.ascontiguousarray(inputs.directions[order[place[rows]]])
    weights = np.einsum("eqai,ei->eqa", gradients[rows], directions)
    return FibreCells(rows, np.ascontiguousarray(weights), directions, inputs.muscle)
