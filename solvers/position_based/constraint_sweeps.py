"""Sweeps over cells whose elasticity is a pair of constraints: XPBD, PBD, B-PXPBD."""

from __future__ import annotations

import numpy as np

from femdeform.errors import InputError
from femdeform.step_problem import Feature, LocalStepProblem
from femdeform.types import FloatArray
from solvers.position_based import constraint_kernels, link_kernels, residual_kernels
from solvers.position_based.cell_layout import CellBatch
from solvers.position_based.cell_sweep import BasedSweep, CellSweep
from solvers.position_based.constraints import PAIRED, VANISHING

# (1 - zeta) kappa that blended sweeps bear for kappa up to 3: half of what the fixed corotated law alone does.
_BLEND = 0.05
# Where a node belongs to hundreds of cells, as on a grid, each of which pulls it to its base point in a sweep: nothing
# changes while the largest kappa is below the first number; beyond it, for the pulls of all cells act together,
# (1 - zeta) kappa of every cell has to be the second one over that of the cells of a node.
_CALM, _CROWDED = 0.4, 0.4


class ConstraintSweep(CellSweep):
    """XPBD and PBD.

    Parameters
    ----------
    problem : LocalStepProblem
    epsilon : float
        See `constraints`.
    rigid : bool
        PBD: infinite stiffness.
    root : bool
        One constraint a cell, the root of the energy, instead of two.

    Raises
    ------
    InputError
        If a law has no such constraints.
    """

    knows = frozenset[Feature]({"links", "constraints"})

    def __init__(
        self,
        problem: LocalStepProblem,
        epsilon: float = 1e-10,
        rigid: bool = False,
        root: bool = False,
        previous: CellSweep | None = None,
    ) -> None:
        super().__init__(problem, rigid, previous)
        self.epsilon, self.rigid, self.root = epsilon, rigid, root
        if not root:
            require_pairs(self.batches, VANISHING if rigid else PAIRED)
        self.multipliers = [np.zeros((len(batch.volumes), 2)) for batch in self.batches]

    def _forget(self) -> None:
        for multipliers in self.multipliers:
            multipliers[:] = 0.0

    def _visit(self, k: int, batch: CellBatch, first: int, last: int, reverse: bool) -> None:
        b = batch
        cells = (first, last, b.corners, b.gradients, b.volumes, b.masks, b.law, self._dim, self.h2, self.epsilon)
        if self.root:
            constraint_kernels.project_roots(*cells, self._x, self.multipliers[k])
        else:
            constraint_kernels.project_pairs(*cells, self.rigid, reverse, self._x, self.multipliers[k])

    def _measure(self, k: int, batch: CellBatch, held: FloatArray, missing: FloatArray) -> None:
        measure = residual_kernels.measure_roots if self.root else residual_kernels.measure_pairs
        cells = (batch.corners, batch.gradients, batch.volumes, batch.law, self._dim, self.h2, self.epsilon)
        measure(*cells, self._x, self.multipliers[k], held, missing)


class BlendedSweep(BasedSweep):
    """B-PXPBD, and XPBD with the primary residual kept.

    Parameters
    ----------
    problem : LocalStepProblem
    zeta : float, optional
        Part of XPBD, in [0, 1]; from the stiffness number of each cell where it is not given.
    epsilon : float
        See `constraints`.
    keep_residual : bool
        The comparison of eq. 5.11.

    Raises
    ------
    InputError
        If a law has no constraints.
    """

    link_mode = link_kernels.BASED

    def __init__(
        self,
        problem: LocalStepProblem,
        zeta: float | None = None,
        epsilon: float = 1e-10,
        keep_residual: bool = False,
        previous: CellSweep | None = None,
    ) -> None:
        if keep_residual:
            self.link_mode = link_kernels.SOLVED
        self._wanted = 0.0 if keep_residual else zeta
        self.needs_kappa = self._wanted is None
        super().__init__(problem, previous)
        require_pairs(self.batches, PAIRED)
        self.epsilon, self.keep_residual = epsilon, keep_residual
        self.multipliers = [np.zeros((len(batch.volumes), 2)) for batch in self.batches]
        self.zeta = [np.zeros(len(batch.volumes)) for batch in self.batches]

    def _forget(self) -> None:
        super()._forget()
        for multipliers in self.multipliers:
            multipliers[:] = 0.0
        if self._wanted is None:
            largest = max((float(batch.unit_kappa.max()) for batch in self.batches), default=0.0)
            calm = self.h2 * largest <= _CALM
            for zeta, batch in zip(self.zeta, self.batches, strict=True):
                zeta[:] = self._safe_zeta(batch, calm)
        else:
            for zeta in self.zeta:
                zeta[:] = self._wanted
        self.blend = max((float(zeta.max()) for zeta in self.zeta if zeta.size), default=0.0)

    def _safe_zeta(self, batch: CellBatch, calm: bool) -> FloatArray:
        """Part of XPBD by the stiffness number of each cell."""
        kappa = self.h2 * batch.unit_kappa
        crowded = (batch.crowds > 0.0) & (not calm)
        bound = np.where(crowded, _CROWDED / np.maximum(batch.crowds, 1.0), _BLEND)
        return np.asarray(np.maximum(1.0 - bound / kappa, 0.0))

    def _push(self, k: int) -> FloatArray:
        return self._held[k]

    def _visit(self, k: int, batch: CellBatch, first: int, last: int, reverse: bool) -> None:
        b = batch
        constraint_kernels.project_blended(
            first,
            last,
            b.corners,
            b.gradients,
            b.volumes,
            b.masks,
            b.law,
            self._dim,
            self.h2,
            self.epsilon,
            self.zeta[k],
            self.keep_residual,
            self._x,
            self.multipliers[k],
            self._held[k],
        )

    def _measure(self, k: int, batch: CellBatch, held: FloatArray, missing: FloatArray) -> None:
        cells = (batch.corners, batch.gradients, batch.volumes, batch.law, self._dim, self.h2, self.epsilon)
        residual_kernels.measure_pairs(*cells, self._x, self.multipliers[k], held, missing)


def require_pairs(batches: list[CellBatch], known: tuple[type, ...]) -> None:
    """Refuse laws that are not among those known as pairs of constraints.

    Raises
    ------
    InputError
    """
    for batch in batches:
        if not isinstance(batch.law, known):
            names = ", ".join(kind.__name__ for kind in known)
            raise InputError(f"material.law: no constraints of {type(batch.law).__name__}; known are {names}")
