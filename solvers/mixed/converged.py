"""The matrix of the converged mixed scheme: twist by rule, condensed or as a saddle system."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from femdeform.fem.mixed_cells import MixedCells
from femdeform.scene.mixed_schema import MixedFEMSolver
from femdeform.types import FloatArray
from solvers.descent import Column, Matrix
from solvers.linear.interface import LinearResult, LinearSolver
from solvers.linear.kkt import SaddleResult, SaddleSolver
from solvers.linear.kkt_system import SaddleSystem


class MixedRule:
    """Descent with the stretch eliminated: K+ = M/h^2 + J^T V C^+ J, twists on where the rule says.

    Parameters
    ----------
    options : MixedFEMSolver
    linear_solver : LinearSolver
        For the condensed form.
    saddle : SaddleSolver or None
        For the saddle form.
    cells : list of MixedCells
        One for each elastic term of the problem.
    """

    def __init__(
        self,
        options: MixedFEMSolver,
        linear_solver: LinearSolver,
        saddle: SaddleSolver | None,
        cells: list[MixedCells],
    ) -> None:
        self.options = options
        self.linear_solver = linear_solver
        self.saddle = saddle
        self.cells = cells
        self._at: FloatArray | None = None  # where the last matrix was made
        self._twisted = 0
        self._rows = (float("nan"), float("nan"))

    def begin(self, problem: Any, x: FloatArray) -> None:
        """See `MatrixRule`."""
        self._at = None
        if self.saddle is not None:
            # The magnitude by which rounding is judged comes from a whole Hessian, which the saddle form never makes.
            problem.hessian(x, project=True)

    def attempts(self, settled: bool) -> Sequence[Matrix]:
        """See `MatrixRule`."""
        return ("exact", "definite") if settled and self.options.finish == "exact" else ("definite",)

    def solve(self, problem: Any, x: FloatArray, b: FloatArray, matrix: Matrix) -> LinearResult:
        """See `MatrixRule`."""
        self._set_twists(problem, x, matrix)
        exact = matrix == "exact"
        if self.saddle is None:

            def whole(k: int, blocks: FloatArray, first: int) -> None:
                self.cells[k].hessian(x, exact, False, blocks, first)

            return self.linear_solver.solve(problem.hessian(x, project=not exact, elastic=whole), b)

        def rest(k: int, blocks: FloatArray, first: int) -> None:
            self.cells[k].hessian(x, exact, True, blocks, first)

        A = problem.hessian(x, project=not exact, elastic=rest, is_part=True)
        pairs = [cells.rows(x) for cells in self.cells]
        system = SaddleSystem(
            A,
            [cells.group.cells for cells in self.cells],
            [B for B, _ in pairs],
            [C for _, C in pairs],
        )
        answer: SaddleResult = self.saddle.solve(system, b, [np.zeros(B.shape[:3]) for B, _ in pairs])
        self._rows = (answer.momentum_residual, answer.constraint_residual)
        return LinearResult(answer.x, answer.iterations, answer.converged, answer.reason)

    def _set_twists(self, problem: Any, x: FloatArray, matrix: Matrix) -> None:
        """Values of the modes that turn the cells at x."""
        if self._at is None or not np.array_equal(x, self._at):
            at = x if self._at is None else self._at
            for cells in self.cells:
                cells.predict(at, x - at)
            self._at = x.copy()
        on = 0
        for cells in self.cells:
            if self.options.twist == "never" and matrix == "definite":
                cells.twists[:] = 0.0
            else:
                cells.set_twists(x, predicted=self.options.twist == "rule" and matrix != "spread")
            on += int(np.count_nonzero((cells.twists > 0.0).any(axis=(1, 2))))
        self._twisted = int(problem.partition.sum(on)) if matrix != "exact" else 0

    def columns(self) -> Mapping[str, Column]:
        """See `MatrixRule`."""
        columns: dict[str, Column] = {"twisted_cells": self._twisted}
        if self.saddle is not None:
            columns |= {"kkt_momentum_residual": self._rows[0], "kkt_constraint_residual": self._rows[1]}
        return columns
