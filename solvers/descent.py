"""Newton-like descent on the function of a step: one loop for every solver that chooses its matrix its own way."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from femdeform.scene.scene_model import LineSearch
from femdeform.step_problem import Budget, IterationObserver, StepProblem, StepResult
from femdeform.types import FloatArray
from solvers.linear.interface import LinearResult
from solvers.support_motion import RELAXATIONS, carry_supports

# Phi is a sum of terms that cancel. Where a step promises less than this fraction of them, the residual judges it,
# because differences of Phi may be rounding; so short a way from the solution few backtracks make sense.
_FLAT = 1e-8
_FLAT_BACKTRACKS = 6
# Near a saddle the residual grows on the way down. A promise above this fraction still shows in differences of Phi.
_RESOLVED = 1e-12
# A full step that reduces the residual at least to this part is taken for a neighbourhood of the solution. Clamped
# Hessians converge linearly, under compression slowly: to ask for more would keep the exact one away for ever.
_SETTLED = 0.95
# A residual is put down to rounding only where it is small beside the forces: a body that runs away from its supports
# makes the positions, and with them the estimate of rounding, as large as one likes. The forces themselves count as
# rounding (a body at rest) below this multiple of the estimate.
_NEGLIGIBLE = 1e-6
_IDLE = 100.0
# A change of the positions by this multiple of their size comes from a singular matrix.
_ABSURD = 1e10

# Matrices a rule may be asked for. `definite` descends by construction; `exact` is the Hessian of Phi as it is;
# `spread` is the definite Hessian of projected Newton, which carries the motion of supports into the body.
Matrix = Literal["definite", "exact", "spread"]
Column = float | int | str


@dataclass
class Iterate:
    """Positions with everything already evaluated there."""

    x: FloatArray
    residual: FloatArray
    norm: float


class MatrixRule(Protocol):
    """What distinguishes one descent method from another: the matrix of an iteration, and how it is solved with."""

    def begin(self, problem: StepProblem, x: FloatArray) -> None:
        """Start a step from the last state; what earlier steps left must not matter."""

    def attempts(self, settled: bool) -> Sequence[Matrix]:
        """Matrices to try in an iteration, the first whose direction descends is taken."""

    def solve(self, problem: StepProblem, x: FloatArray, b: FloatArray, matrix: Matrix) -> LinearResult:
        """Solve with a matrix at x (n_local, dim) for a right-hand side [N] that is zero where x is prescribed."""

    def columns(self) -> Mapping[str, Column]:
        """What the log should say of the last solve, the same columns every time."""


@dataclass(frozen=True)
class _Direction:
    """A search direction and how it was found."""

    step: FloatArray
    slope: float
    iterations: int
    matrix: Matrix
    usable: bool
    reason: str


@dataclass(frozen=True)
class Advance:
    """What an iteration came to.

    Attributes
    ----------
    found : Iterate or None
        The next iterate; None if no matrix gave a usable direction and an admissible length.
    value : float
        Phi where the iteration began [J].
    length : float
        Part of the direction that was taken.
    matrix : Matrix
        The last that was tried, the one taken if something was found.
    iterations, all_iterations : int
        Linear iterations with that matrix, and with all that were tried.
    reason : str
        Why nothing was found.
    """

    found: Iterate | None
    value: float
    length: float
    matrix: Matrix
    iterations: int
    all_iterations: int
    reason: str


class Descent:
    """The loop: direction from a rule's matrix, Armijo's line search on Phi, one test of the residual.

    Parameters
    ----------
    rule : MatrixRule
        Chooses and solves with the matrix.
    tolerance : float
        Residual over `StepProblem.force_scale` [-].
    max_iterations : int
    search : LineSearch
    """

    def __init__(self, rule: MatrixRule, tolerance: float, max_iterations: int, search: LineSearch) -> None:
        self.rule = rule
        self.tolerance = tolerance
        self.max_iterations = max_iterations
        self.search = search

    def step(
        self, problem: StepProblem, state: Any, observe: IterationObserver | None = None, budget: Budget | None = None
    ) -> StepResult:
        """Minimise Phi from an accepted state; see `StepSolver.step`."""
        budget = Budget() if budget is None else budget
        self.rule.begin(problem, state.x)
        first = carry_supports(
            problem,
            state,
            lambda x, b: self.rule.solve(problem, x, b, "spread"),
            lambda x: self._relax(problem, x),
            budget,
        )
        current = self._evaluate(problem, first.x)
        problem.settle_force_scale(first.x)
        previous_norm, previous_length = math.inf, 0.0
        iteration, linear_iterations = first.iterations, first.linear_iterations

        def result(converged: bool, reason: str) -> StepResult:
            relative = ratio(current.norm, problem.force_scale)
            return StepResult(current.x, converged, reason, iteration, linear_iterations, current.norm, relative)

        def report(objective: float, length: float, linear: int, matrix: Matrix) -> None:
            if observe is None:
                return
            row: dict[str, Column] = {
                "iteration": iteration,
                "residual_norm": current.norm,
                "relative_residual": ratio(current.norm, problem.force_scale),
                "objective": objective,
                "step_length": length,
                "linear_iterations": linear,
                "projected": int(matrix != "exact"),
                "seconds": budget.elapsed(),
                **self.rule.columns(),
            }
            observe(row, current.x)

        if first.failure:
            return result(False, first.failure)
        if first.iterations:
            report(first.objective, first.length, first.linear_iterations, "spread")
        while True:
            if not math.isfinite(current.norm):
                return result(False, "the residual is not finite")
            if current.norm <= self.tolerance * problem.force_scale:
                return result(True, "residual below tolerance")
            # The level of rounding is an estimate: it ends a step only once the residual falls no further.
            if current.norm > 0.25 * previous_norm and is_rounding(problem, current, first.x, 1.0):
                return result(True, "residual at the level of rounding")
            spent = budget.spent(iteration)
            if spent is not None:
                return result(False, spent)
            if iteration >= self.max_iterations:
                return result(False, f"no convergence in {iteration} iterations")

            settled = previous_length == 1.0 and current.norm < _SETTLED * previous_norm
            advance = self.advance(problem, current, self.rule.attempts(settled))
            linear_iterations += advance.all_iterations
            if advance.found is None:
                if is_rounding(problem, current, first.x, 10.0):
                    return result(True, "residual at the level of rounding")
                return result(False, advance.reason)

            previous_norm, previous_length = current.norm, advance.length
            current = advance.found
            iteration += 1
            report(advance.value, advance.length, advance.iterations, advance.matrix)

    def advance(self, problem: StepProblem, current: Iterate, matrices: Sequence[Matrix]) -> Advance:
        """One iteration: the first of the matrices whose direction descends, and a line search along it."""
        problem.linearize_at(current.x)
        value, magnitude = problem.value(current.x), problem.value_magnitude
        total = 0
        for matrix in matrices:
            direction = self._direction(problem, current, matrix)
            total += direction.iterations
            length, found, reason = 0.0, None, direction.reason
            if direction.usable:
                length, found = self._line_search(problem, current, direction, value, magnitude)
                reason = "" if found is not None else "the line search failed"
            answer = Advance(found, value, length, matrix, direction.iterations, total, reason)
            if found is not None:
                break
        return answer

    def _evaluate(self, problem: StepProblem, x: FloatArray) -> Iterate:
        residual = problem.gradient(x)
        return Iterate(x, residual, problem.residual_norm(residual))

    def _relax(self, problem: StepProblem, x: FloatArray) -> tuple[FloatArray, int, int]:
        """A few iterations with the supports where they are: positions, iterations, linear iterations."""
        current, linear_iterations = self._evaluate(problem, x), 0
        for iteration in range(RELAXATIONS):
            problem.linearize_at(current.x)
            value, magnitude = problem.value(current.x), problem.value_magnitude
            direction = self._direction(problem, current, "spread")
            linear_iterations += direction.iterations
            if not direction.usable:
                return current.x, iteration, linear_iterations
            _, found = self._line_search(problem, current, direction, value, magnitude)
            if found is None:
                return current.x, iteration, linear_iterations
            current = found
        return current.x, RELAXATIONS, linear_iterations

    def _direction(self, problem: StepProblem, current: Iterate, matrix: Matrix) -> _Direction:
        answer = self.rule.solve(problem, current.x, -current.residual, matrix)
        slope = problem.partition.dot(current.residual, answer.x) if answer.converged else math.nan
        usable, reason = True, ""
        if not answer.converged:
            usable, reason = False, f"the linear solver failed: {answer.reason}"
        elif not math.isfinite(slope):
            usable, reason = False, "the solution of the linear system is not finite"
        elif slope >= 0.0:
            usable, reason = False, "the search direction does not descend"
        elif problem.partition.norm(answer.x) > _ABSURD * problem.partition.norm(current.x):
            # Whether a singular matrix shows by its sign or by its size is a matter of rounding.
            usable, reason = False, "the solution of the linear system is beyond all measure"
        if matrix != "exact" and not usable:
            # A clamped Hessian cannot be indefinite: what spoils it is a motion that costs nothing.
            other = "it needs more iterations (ksp_max_it) or another preset, or " if answer.ran_out else ""
            reason += f"; {other}the system may be singular: is every body held, or has it inertia?"
        return _Direction(answer.x, slope, answer.iterations, matrix, usable, reason)

    def _line_search(
        self, problem: StepProblem, current: Iterate, direction: _Direction, value: float, magnitude: float
    ) -> tuple[float, Iterate | None]:
        """Step length and the iterate there; None if no admissible length gives a decrease."""
        search = self.search
        length = longest = problem.max_step(current.x, direction.step)
        if longest <= 0.0:
            return 0.0, None
        is_flat = -direction.slope <= _FLAT * magnitude
        for _ in range(1 + (_FLAT_BACKTRACKS if is_flat else search.max_backtracks)):
            x = current.x + length * direction.step
            if is_flat:
                candidate = self._evaluate(problem, x)
                if candidate.norm <= (1.0 - search.armijo * length) * current.norm:
                    return length, candidate
            elif problem.value(x) <= value + search.armijo * length * direction.slope:
                return length, self._evaluate(problem, x)
            length *= search.shrink
        if is_flat and -direction.slope > _RESOLVED * magnitude:
            length = longest
            for _ in range(1 + _FLAT_BACKTRACKS):
                x = current.x + length * direction.step
                if problem.value(x) <= value + search.armijo * length * direction.slope:
                    return length, self._evaluate(problem, x)
                length *= search.shrink
        return length, None


def is_rounding(problem: StepProblem, current: Iterate, start: FloatArray, factor: float) -> bool:
    """Whether a residual is no more than what rounding may leave, and nothing that matters beside the forces."""
    if current.norm > factor * problem.roundoff_norm(current.x):
        return False
    before = problem.roundoff_norm(start)
    if current.norm <= factor * before:  # not the motion that made the estimate large (steel under its own weight)
        return True
    return problem.force_scale <= _IDLE * before or current.norm <= _NEGLIGIBLE * problem.force_scale


def ratio(norm: float, scale: float) -> float:
    """Norm over scale, with 0 / 0 = 0."""
    return norm / scale if scale > 0.0 else (0.0 if norm == 0.0 else math.inf)
