"""Newton's method on the incremental potential with positive semi-definite element Hessians."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from femdeform.scene.schema import ProjectedNewtonSolver
from femdeform.step_problem import Budget, IterationObserver, StepProblem, StepResult
from femdeform.types import FloatArray
from solvers.descent import Column, Descent, Matrix
from solvers.linear.interface import LinearResult, LinearSolver


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
        options = self.options
        rule = NewtonRule(options.hessian, self.linear_solver)
        descent = Descent(rule, options.tolerance, options.max_iterations, options.line_search)
        return descent.step(problem, state, observe, budget)

    def reset(self) -> None:
        """Nothing is held between steps."""

    def destroy(self) -> None:
        """Nothing is held between steps."""


class NewtonRule:
    """The Hessian of Phi, exact or clamped cell by cell."""

    def __init__(self, hessian: str, linear_solver: LinearSolver) -> None:
        self.hessian = hessian
        self.linear_solver = linear_solver

    def begin(self, problem: StepProblem, x: FloatArray) -> None:
        """See `MatrixRule`."""

    def attempts(self, settled: bool) -> Sequence[Matrix]:
        """See `MatrixRule`."""
        if self.hessian == "adaptive":
            return ("exact", "definite") if settled else ("definite",)
        return ("definite",) if self.hessian == "projected" else ("exact",)

    def solve(self, problem: StepProblem, x: FloatArray, b: FloatArray, matrix: Matrix) -> LinearResult:
        """See `MatrixRule`."""
        return self.linear_solver.solve(problem.hessian(x, project=matrix != "exact"), b)

    def columns(self) -> Mapping[str, Column]:
        """See `MatrixRule`."""
        return {}
