"""Newton's method for the last digits of an iteration whose first digits are cheap."""

from __future__ import annotations

import numpy as np

from femdeform.scene.scene_model import LineSearch
from femdeform.step_problem import StepProblem
from femdeform.types import FloatArray
from solvers.descent import Advance, Descent, Iterate, Matrix
from solvers.linear.interface import LinearSolver
from solvers.projected_newton import NewtonRule

# Steps that find nothing, or that are cut short, before the finish is given up for the step.
_FAILURES = 3
_EXACT: tuple[Matrix, ...] = ("exact", "definite")
_DEFINITE: tuple[Matrix, ...] = ("definite",)


class NewtonFinish:
    """Single Newton steps from wherever cheaper iterations have arrived, with line search, taken or left alone.

    Between them the caller goes on with its own iterations: they are the nonlinear preconditioner on the right,
    ``x <- N(S(x))`` with sweeps S and a Newton step N. They smooth what a linearisation is worst at, single cells far
    out of balance, so that full steps of N are admissible early.

    Parameters
    ----------
    linear_solver : LinearSolver
        For the Hessian of Phi; its tolerance is that of the Krylov iteration.

    References
    ----------
    P. R. Brune, M. G. Knepley, B. F. Smith, X. Tu, Composing scalable nonlinear algebraic solvers (2015): N on the
    right of S is nonlinear right preconditioning.

    Limitations
    -----------
    The Hessian is assembled: memory and first solves are those of projected Newton.
    """

    def __init__(self, linear_solver: LinearSolver) -> None:
        self._descent = Descent(NewtonRule("adaptive", linear_solver), 0.0, 1, LineSearch())
        self.begin_step()

    def begin_step(self) -> None:
        """Forget what the last step taught."""
        self._exact = True
        self._failures = 0
        self.steps = 0
        self.linear_iterations = 0

    @property
    def is_given_up(self) -> bool:
        """Whether Newton steps have failed too often in this step."""
        return self._failures >= _FAILURES

    def advance(self, problem: StepProblem, x: FloatArray, residual: FloatArray) -> Advance:
        """Try a Newton step at x; whoever asks may only take it if `found` is not None.

        The exact Hessian comes first. Where it does not descend or is cut short by the line search, the clamped one has
        the next turn.
        """
        current = Iterate(x, residual, problem.residual_norm(residual))
        answer = self._descent.advance(problem, current, _EXACT if self._exact else _DEFINITE)
        self.linear_iterations += answer.all_iterations
        self.steps += 1
        found = answer.found
        is_good = found is not None and bool(np.isfinite(found.norm))
        self._exact = is_good and answer.length == 1.0
        if not is_good or (answer.length < 1.0 and found is not None and found.norm >= current.norm):
            self._failures += 1
        return answer
