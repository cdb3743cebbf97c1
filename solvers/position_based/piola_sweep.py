"""Sweeps over cells whose stresses are the unknowns: FP-PXPBD."""

from __future__ import annotations

import numpy as np

from femdeform.step_problem import Feature, LocalStepProblem
from femdeform.types import FloatArray
from solvers.position_based import link_kernels, piola_kernels, residual_kernels
from solvers.position_based.cell_fibres import CellFibres
from solvers.position_based.cell_layout import CellBatch
from solvers.position_based.cell_sweep import BasedSweep, CellSweep
from solvers.position_based.nodal_blocks import is_bounded


class PiolaSweep(BasedSweep):
    """FP-PXPBD; after the stresses of the cells of a colour the tensions of their muscle fibres.

    Parameters
    ----------
    problem : LocalStepProblem
    local : int
        Steps of Newton's method a visit.
    exact : bool
        With the projected tangent instead of its model.
    search : bool, optional
        Whether steps are halved where a cell's energy rises; by law where not given.
    """

    blend = 0.0
    quick_below = (2.0, 1.0)
    link_mode = link_kernels.SOLVED
    knows = frozenset[Feature]({"links", "fibres"})

    def __init__(
        self,
        problem: LocalStepProblem,
        local: int = 3,
        exact: bool = False,
        search: bool | None = None,
        previous: CellSweep | None = None,
    ) -> None:
        super().__init__(problem, previous)
        self.local, self.exact = local, exact
        self._search = [(exact or not is_bounded(batch.law)) if search is None else search for batch in self.batches]
        self._fibres = [
            [CellFibres(batch, part, self.dim, self.stride) for part in batch.fibres] for batch in self.batches
        ]

    @property
    def stresses(self) -> list[FloatArray]:
        """P of the cells of each batch as it is in the base points (n_cells, dim dim) [Pa]."""
        return self._held

    def _push(self, k: int) -> FloatArray:
        return -self.h2 * self.batches[k].volumes[:, None] * self._held[k]

    def _add_further(self, k: int, total: FloatArray) -> None:
        for fibres in self._fibres[k]:
            fibres.add_push(self.h2, fibres.pulls, total)

    def _measure_further(self, k: int, points: FloatArray, held: FloatArray, missing: FloatArray) -> None:
        for fibres in self._fibres[k]:
            fibres.add_push(self.h2, fibres.pulls, held)
            fibres.add_push(self.h2, fibres.pulls - fibres.current_pulls(points), missing)

    def _forget(self) -> None:
        super()._forget()
        for parts in self._fibres:
            for fibres in parts:
                fibres.pulls[:] = 0.0

    def _visit(self, k: int, batch: CellBatch, first: int, last: int, reverse: bool) -> None:
        b = batch
        piola_kernels.relax_cells(
            first,
            last,
            b.corners,
            b.gradients,
            b.volumes,
            b.masks,
            b.law,
            self._dim,
            self.h2,
            self.local,
            self.exact,
            self._search[k],
            self._x,
            self._held[k],
        )
        color = int(np.searchsorted(b.offsets, first, side="right")) - 1
        for fibres in self._fibres[k]:
            fibres.visit(color, self.h2, self._x)

    def _measure(self, k: int, batch: CellBatch, held: FloatArray, missing: FloatArray) -> None:
        cells = (batch.corners, batch.gradients, batch.volumes, batch.law, self._dim, self.h2)
        residual_kernels.measure_stresses(*cells, self._x, self._held[k], held, missing)
