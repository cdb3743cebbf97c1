"""Newton's method on the incremental potential with positive semi-definite element Hessians."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from femdeform.scene.schema import ProjectedNewtonSolver
from femdeform.step_problem import Budget, IterationObserver, StepProblem, StepResult
from femdeform.types import FloatArray
from solvers.linear.interface import LinearSolver
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


@dataclass
class _Iterate:
    """Positions with everything already evaluated there."""

    x: FloatArray
    residual: FloatArray
    norm: float


@dataclass(frozen=True)
class _Direction:
    """A search direction and how it was found."""

    step: FloatArray
    slope: float
    iterations: int
    projected: bool
    usable: bool
    reason: str


class ProjectedNewton:
    """The reference solver: every other family is judged by its answers.

    Each iteration solves ``K dx = -r`` with the Hessian of Phi and backtracks along dx until Armijo's condition holds.
    With ``hessian: projected`` each element's part of K is clamped to positive semi-definite by its analytic
    eigensystem, which makes dx a descent direction; with ``adaptive`` the exact Hessian takes over once full steps
    reduce the residual, for quadratic convergence, and is given up for the clamped one in any iteration where its
    direction does not descend. Prescribed positions enter by a first linearised step that spreads their motion over
    the body instead of crushing the elements at the support (`solvers.support_motion`). Where contact bounds the
    length of a step, backtracking starts from that bound.

    Parameters
    ----------
    options : ProjectedNewtonSolver
        The scene's block.
    linear_solver : LinearSolver

    References
    ----------
    J. Teran et al., Robust quasistatic finite elements and flesh simulation (2005): clamping of element Hessians.
    B. Smith, F. de Goes, T. Kim, Analytic eigensystems for isotropic distortion energies (2019).

    Limitations
    -----------
    Finds a stationary point near the last state, not all of them: past a buckling load the branch taken depends on
    imperfections and step size. Non-symmetric parts of follower loads are left out of K; convergence is then linear.
    """

    def __init__(self, options: ProjectedNewtonSolver, linear_solver: LinearSolver) -> None:
        self.options = options
        self.linear_solver = linear_solver

    def step(
        self,
        problem: StepProblem,
        state: Any,
        observe: IterationObserver | None = None,
        budget: Budget | None = None,
    ) -> StepResult:
        """Minimise Phi from an accepted state.

        Parameters
        ----------
        problem : StepProblem
            With the step begun.
        state : State
            Last accepted state; not changed.
        observe : callable, optional
            Called after every iteration.
        budget : Budget, optional
            What the step may take; without one, `max_iterations` alone ends it.

        Returns
        -------
        StepResult
            `converged` is False, with the reason, if the tolerance was not reached; nothing is raised for that.
        """
        budget = Budget() if budget is None else budget
        first = carry_supports(problem, state, self.linear_solver, lambda x: self._relax(problem, x), budget)
        current = self._evaluate(problem, first.x)
        problem.settle_force_scale(first.x)
        previous_norm, previous_length = math.inf, 0.0
        iteration, linear_iterations = first.iterations, first.linear_iterations

        def result(converged: bool, reason: str) -> StepResult:
            relative = _ratio(current.norm, problem.force_scale)
            return StepResult(
                current.x, converged, reason, iteration, linear_iterations, current.norm, relative
            )

        def report(objective: float, length: float, linear: int, projected: bool) -> None:
            if observe is None:
                return
            row = {
                "iteration": iteration,
                "residual_norm": current.norm,
                "relative_residual": _ratio(current.norm, problem.force_scale),
                "objective": objective,
                "step_length": length,
                "linear_iterations": linear,
                "projected": int(projected),
                "seconds": budget.elapsed(),
            }
            observe(row, current.x)

        if first.failure:
            return result(False, first.failure)
        if first.iterations:
            report(first.objective, first.length, first.linear_iterations, True)
        while True:
            if not math.isfinite(current.norm):
                return result(False, "the residual is not finite")
            if current.norm <= self.options.tolerance * problem.force_scale:
                return result(True, "residual below tolerance")
            # The level of rounding is an estimate: it ends a step only once the residual falls no further.
            if current.norm > 0.25 * previous_norm and current.norm <= problem.roundoff_norm(current.x):
                return result(True, "residual at the level of rounding")
            spent = budget.spent(iteration)
            if spent is not None:
                return result(False, spent)
            if iteration >= self.options.max_iterations:
                return result(False, f"no convergence in {iteration} iterations")

            problem.linearize_at(current.x)
            value, magnitude = problem.value(current.x), problem.value_magnitude
            settled = previous_length == 1.0 and current.norm < _SETTLED * previous_norm
            attempts = [True] if self.options.hessian == "projected" else [False]
            if self.options.hessian == "adaptive":
                attempts = [False, True] if settled else [True]
            length, found, direction = 0.0, None, None
            for project in attempts:
                direction = self._direction(problem, current, project)
                linear_iterations += direction.iterations
                if not direction.usable:
                    continue
                length, found = self._line_search(problem, current, direction, value, magnitude)
                if found is not None:
                    break
            assert direction is not None
            if found is None:
                if current.norm <= 10.0 * problem.roundoff_norm(current.x):
                    return result(True, "residual at the level of rounding")
                return result(False, "the line search failed" if direction.usable else direction.reason)

            previous_norm, previous_length = current.norm, length
            current = found
            iteration += 1
            report(value, length, direction.iterations, direction.projected)

    def _evaluate(self, problem: StepProblem, x: FloatArray) -> _Iterate:
        residual = problem.gradient(x)
        return _Iterate(x, residual, problem.residual_norm(residual))

    def _relax(self, problem: StepProblem, x: FloatArray) -> tuple[FloatArray, int, int]:
        """A few iterations with the supports where they are: positions, iterations, linear iterations."""
        current, linear_iterations = self._evaluate(problem, x), 0
        for iteration in range(RELAXATIONS):
            problem.linearize_at(current.x)
            value, magnitude = problem.value(current.x), problem.value_magnitude
            direction = self._direction(problem, current, project=True)
            linear_iterations += direction.iterations
            if not direction.usable:
                return current.x, iteration, linear_iterations
            _, found = self._line_search(problem, current, direction, value, magnitude)
            if found is None:
                return current.x, iteration, linear_iterations
            current = found
        return current.x, RELAXATIONS, linear_iterations

    def _direction(self, problem: StepProblem, current: _Iterate, project: bool) -> _Direction:
        answer = self.linear_solver.solve(problem.hessian(current.x, project), -current.residual)
        slope = problem.partition.dot(current.residual, answer.x) if answer.converged else math.nan
        usable, reason = True, ""
        if not answer.converged:
            usable, reason = False, f"the linear solver failed: {answer.reason}"
        elif not math.isfinite(slope):
            usable, reason = False, "the solution of the linear system is not finite"
        elif slope >= 0.0:
            usable, reason = False, "the search direction does not descend"
        if project and not usable:
            # A clamped Hessian cannot be indefinite: what spoils it is a motion that costs nothing.
            reason += "; the system may be singular: is every body held, or has it inertia?"
        return _Direction(answer.x, slope, answer.iterations, project, usable, reason)

    def _line_search(
        self, problem: StepProblem, current: _Iterate, direction: _Direction, value: float, magnitude: float
    ) -> tuple[float, _Iterate | None]:
        """Step length and the iterate there; None if no admissible length gives a decrease."""
        search = self.options.line_search
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


def _ratio(norm: float, scale: float) -> float:
    return norm / scale if scale > 0.0 else (0.0 if norm == 0.0 else math.inf)
