"""The published interactive scheme: rotations and a linear solve in turn, a fixed number of times (Algorithm 1)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from femdeform.fem.assembly import SparseHessian
from femdeform.scene.mixed_schema import MixedFEMSolver
from femdeform.step_problem import Budget, IterationObserver, StepResult
from femdeform.types import FloatArray
from solvers.descent import Column, ratio
from solvers.linear.interface import LinearSolver
from solvers.linear.kkt import SaddleSolver
from solvers.linear.kkt_system import SaddleSystem
from solvers.mixed.local_state import LocalState
from solvers.stopwatch import Stopwatch

# A step that promises less than this fraction of the energies that cancel in Phi is taken as it is. A rise by less than
# the second is rounding.
_FLAT = 1e-8
_ROUNDING = 1e-15


class Alternating:
    """Algorithm 1 of the paper with its formulas corrected (docs/methods/mixed-fem.md).

    Parameters
    ----------
    options : MixedFEMSolver
    linear_solver : LinearSolver
        For ``global_solve: condensed``.
    saddle : SaddleSolver or None
        For the others.
    problem : IncrementalPotential
        Its element groups are taken once.

    Attributes
    ----------
    stopwatch : Stopwatch
        Phases of the iterations: ``assembly`` of the linear system and its right-hand side, its ``solve``, multipliers
        included, and the ``local`` updates of rotations, stretches and the model of psi.
    """

    def __init__(
        self, options: MixedFEMSolver, linear_solver: LinearSolver, saddle: SaddleSolver | None, problem: Any
    ) -> None:
        self.options = options
        self.linear_solver = linear_solver
        self.saddle = saddle
        self.groups = [LocalState(term.group, options) for term in problem.elastic]
        # Stretches that belong to accepted positions: those of the step before, and of its start in case it is retried.
        self._known: list[tuple[FloatArray, list[FloatArray]]] = []
        self._rows = (math.nan, math.nan)
        self._condensed_system: tuple[SparseHessian, FloatArray, FloatArray, FloatArray] | None = None
        self._is_scaled = False
        self.stopwatch = Stopwatch()

    def reset(self) -> None:
        """Forget the stretches: the next step takes those of its positions."""
        self._known = []

    def step(
        self, problem: Any, state: Any, observe: IterationObserver | None = None, budget: Budget | None = None
    ) -> StepResult:
        """See `StepSolver.step`."""
        options = self.options
        budget = Budget() if budget is None else budget
        known = self._stretches_at(problem, state.x)
        for k, group in enumerate(self.groups):
            group.begin(None if known is None else known[k], state.x)
        start = (state.x.copy(), [group.S.copy() for group in self.groups])
        x = problem.predictor(state)
        if not self._is_scaled:
            # The magnitude by which rounding is judged comes from a whole Hessian, which this scheme need not make.
            problem.hessian(state.x, project=True)
            self._is_scaled = True
        problem.settle_force_scale(x)
        alpha, iteration, linear_iterations = options.beta, 0, 0

        def result(reason: str, converged: bool = False, is_fixed_work: bool = False) -> StepResult:
            norm = problem.residual_norm(problem.gradient(x))
            if not math.isfinite(norm):
                converged, is_fixed_work, reason = False, False, "the residual is not finite"
            relative = ratio(norm, problem.force_scale)
            return StepResult(x, converged, reason, iteration, linear_iterations, norm, relative, is_fixed_work)

        for _ in range(options.outer_iterations):
            outer = x
            self.stopwatch.start()
            for group in self.groups:
                group.freeze()
            self.stopwatch.lap("local")
            spent = None
            for _ in range(options.inner_iterations):
                spent = budget.spent(iteration)
                if spent is not None:
                    break
                self.stopwatch.start()
                for group in self.groups:
                    group.rotate(x, alpha)
                self.stopwatch.lap("local")
                alpha *= options.beta_growth
                change, count, failure = self._global_solve(problem, x)
                linear_iterations += count
                if failure:
                    return result(failure)
                x = x + change
                for group in self.groups:
                    group.update_stretch()
                self.stopwatch.lap("local")
                iteration += 1
                if observe is not None:
                    with budget.paused():
                        row = self._row(problem, x, iteration, count)
                    row["seconds"] = budget.elapsed()
                    observe(row, x)
            if x is outer:
                assert spent is not None
                return result(spent)
            length, x = self._line_search(problem, outer, x, problem.initial_guess(state))
            if length == 0.0:
                return result("the line search failed")
            self._known = [start, (x.copy(), [group.S.copy() for group in self.groups])]
            norm = problem.residual_norm(problem.gradient(x))
            if norm <= options.tolerance * problem.force_scale:
                return result("residual below tolerance", converged=True)
            if spent is not None:
                return result(spent)
        return result("fixed number of iterations", is_fixed_work=True)

    def _stretches_at(self, problem: Any, x: FloatArray) -> list[FloatArray] | None:
        """Stretches of the last step if it ended in these positions, on every rank."""
        for positions, stretches in reversed(self._known):
            same = positions.shape == x.shape and np.array_equal(positions, x)
            if problem.partition.min(float(same)) > 0.0:
                return stretches
        return None

    def _row(self, problem: Any, x: FloatArray, iteration: int, count: int) -> dict[str, Column]:
        norm = problem.residual_norm(problem.gradient(x))
        row: dict[str, Column] = {
            "iteration": iteration,
            "residual_norm": norm,
            "relative_residual": ratio(norm, problem.force_scale),
            "objective": problem.value(x),
            "step_length": 1.0,
            "linear_iterations": count,
        }
        if self.saddle is not None:
            row |= {"kkt_momentum_residual": self._rows[0], "kkt_constraint_residual": self._rows[1]}
        else:
            row["kkt_momentum_residual"] = self._momentum_residual(problem)
        return row

    def _momentum_residual(self, problem: Any) -> float:
        """Residual of the first block row after a condensed solve, over the sizes of its terms; the second is exact."""
        assert self._condensed_system is not None
        K, b, forces, change = self._condensed_system
        residual = K.times(change) - b
        inertia = np.zeros_like(change)
        if not problem.quasistatic:
            inertia = np.where(problem.free, problem.apply_mass(change) / problem.dt**2, 0.0)
        norm = problem.partition.norm
        return ratio(norm(residual), norm(inertia) + norm(forces) + norm(residual + forces - inertia))

    # ------------------------------------------------------------------------------------------- global solve

    def _global_solve(self, problem: Any, x: FloatArray) -> tuple[FloatArray, int, str]:
        """Change of positions, linear iterations, and why it failed; the multipliers are set."""
        for group in self.groups:
            group.set_sides(x)
        b = -np.where(problem.free, problem.full_gradient(x, elastic=False), 0.0)
        if self.saddle is None:
            return self._condensed(problem, x, b)

        def nothing(k: int, blocks: FloatArray, first: int) -> None:
            n = self.groups[k].group.cells.shape[1]
            blocks[first : first + self.groups[k].group.n_cells * n * (n + 1) // 2] = 0.0

        A = problem.hessian(x, project=True, elastic=nothing, is_part=True)
        parts = [group.saddle() for group in self.groups]
        system = SaddleSystem(
            A,
            [group.group.cells for group in self.groups],
            [B for B, _, _ in parts],
            [C for _, C, _ in parts],
        )
        constant = None
        if self.saddle.method == "kkt_cg":
            constant = [group.constant_compliances() for group in self.groups]
        self.stopwatch.lap("assembly")
        answer = self.saddle.solve(system, b, [side for _, _, side in parts], constant)
        self._rows = (answer.momentum_residual, answer.constraint_residual)
        if not answer.converged:
            return answer.x, answer.iterations, f"the saddle solver failed: {answer.reason}"
        for group, y in zip(self.groups, answer.y, strict=True):
            group.take_multipliers(y)
        self.stopwatch.lap("solve")
        return answer.x, answer.iterations, ""

    def _condensed(self, problem: Any, x: FloatArray, b: FloatArray) -> tuple[FloatArray, int, str]:
        def write(k: int, blocks: FloatArray, first: int) -> None:
            slots, first_slot = problem.slots_of(k)
            self.groups[k].condensed(blocks, first, slots, first_slot)

        K = problem.hessian(x, project=True, elastic=write)
        forces = b
        b = b + np.where(problem.free, problem.sum_elastic_slots(), 0.0)
        self.stopwatch.lap("assembly")
        answer = self.linear_solver.solve(K, b)
        self._condensed_system = (K, b, forces, answer.x)
        if not answer.converged:
            return answer.x, answer.iterations, f"the linear solver failed: {answer.reason}"
        for group in self.groups:
            group.take_condensed(answer.x)
        self.stopwatch.lap("solve")
        return answer.x, answer.iterations, ""

    # ------------------------------------------------------------------------------------------- line search

    def _line_search(
        self, problem: Any, begin: FloatArray, end: FloatArray, last: FloatArray
    ) -> tuple[float, FloatArray]:
        """Length and positions on the way from `begin` to `end` at which Phi is lower; the stretches go along.

        The paper names no merit; Phi with the stretch eliminated is one. Where free flight has turned
        a cell inside out whose law is not defined there, the way starts from the positions of the `last` state.
        """
        search = self.options.line_search
        problem.linearize_at(begin)
        value = problem.value(begin)
        if not math.isfinite(value):
            begin = last
            problem.linearize_at(begin)
            value = problem.value(begin)
        magnitude, change = problem.value_magnitude, end - begin
        slope = problem.partition.dot(problem.gradient(begin), change)
        if not math.isfinite(slope):
            slope = 0.0
        goals = [group.S.copy() for group in self.groups]
        length = problem.max_step(begin, change)
        for _ in range(1 + search.max_backtracks):
            x = end if length == 1.0 else begin + length * change
            reached = problem.value(x)
            allowed = value + search.armijo * length * min(slope, 0.0) + _ROUNDING * magnitude
            is_lower = reached <= allowed
            is_flat = abs(slope) * length <= _FLAT * magnitude
            if math.isfinite(reached) and (is_lower or is_flat or not math.isfinite(value)):
                for group, goal in zip(self.groups, goals, strict=True):
                    group.S[:] = group.frozen + length * (goal - group.frozen)
                undefined = sum(group.n_undefined(group.S) for group in self.groups)
                if problem.partition.sum(undefined) == 0:
                    return length, x
            length *= search.shrink
        return 0.0, begin
