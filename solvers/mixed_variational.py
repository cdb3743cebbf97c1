"""Mixed variational finite elements: positions, stretches, rotations and stress multipliers."""

from __future__ import annotations

from typing import Any

from femdeform.errors import InputError
from femdeform.fem.mixed_cells import MixedCells
from femdeform.materials import supports_codimension
from femdeform.scene.mixed_schema import MixedFEMSolver
from femdeform.step_problem import Budget, IterationObserver, StepResult
from solvers.descent import Descent
from solvers.linear.interface import LinearSolver
from solvers.linear.kkt import SaddleSolver
from solvers.mixed.alternating import Alternating
from solvers.mixed.converged import MixedRule


class MixedVariational:
    """Solids, membranes and rods by the mixed variational method, to a tolerance or with a fixed amount of work.

    The elastic energy is a function psi(S) of a symmetric stretch a point, tied to the positions by R S = F with a
    rotation R and multipliers, which are stresses. ``scheme: converged`` eliminates the stretch and descends on the
    energy of the step; the stiffness of rotations comes from the multipliers, the stress that the last linear model
    predicts, and not from the stress at the present positions, which after a large turn is spurious.
    ``scheme: alternating`` is Algorithm 1 of the paper: from the predictor, rotations and a linear solve in turn, a
    fixed number of times, then one line search.

    Parameters
    ----------
    options : MixedFEMSolver
        The scene's block.
    linear_solver : LinearSolver
        Solves the condensed systems; with `global_solve` of the kkt kind it only tells whether PETSc is there.

    References
    ----------
    T. Trusty, D. M. Kaufman, D. I. W. Levin, Mixed variational finite elements for implicit simulation of deformables
    (2022).
    D. Magisano, L. Leonetti, G. Garcea, How to improve efficiency and robustness of the Newton method in geometrically
    non-linear structural problem discretized via displacement-based finite elements (2017): the stiffness at the
    extrapolated stress.
    J. Teran et al., Robust quasistatic finite elements and flesh simulation (2005).

    Limitations
    -----------
    Laws of the principal stretches only: not the linear one. The converged scheme finds a stationary point near the
    last state, as any descent. A step of the alternating scheme ends where its work ends, whatever the residual is;
    its fixed point is that of the energy only without `tikhonov`, or in its proximal form. It starts from a predictor
    that contact does not bound, so it refuses incremental potential contact.
    """

    def __init__(self, options: MixedFEMSolver, linear_solver: LinearSolver) -> None:
        self.options = options
        self.linear_solver = linear_solver
        self._problem: Any = None
        self._saddle: SaddleSolver | None = None
        self._rule: MixedRule | None = None
        self._alternating: Alternating | None = None

    def step(
        self, problem: Any, state: Any, observe: IterationObserver | None = None, budget: Budget | None = None
    ) -> StepResult:
        """See `StepSolver.step`; the problem is an `IncrementalPotential`.

        Raises
        ------
        InputError
            If a law is not a function of the principal stretches, or the alternating scheme meets barriers of contact.
        """
        if self._problem is not problem:
            self._set_up(problem)
        if self._alternating is not None:
            return self._alternating.step(problem, state, observe, budget)
        assert self._rule is not None
        options = self.options
        descent = Descent(self._rule, options.tolerance, options.max_iterations, options.line_search)
        return descent.step(problem, state, observe, budget)

    def _set_up(self, problem: Any) -> None:
        options = self.options
        self.destroy()
        if options.scheme == "alternating" and problem.has_barriers:
            raise InputError("the alternating scheme of mixed_fem cannot start inside a barrier, as its predictor may")
        for term in problem.elastic:
            if not supports_codimension(term.group.law):
                law = type(term.group.law).__name__
                raise InputError(f"mixed_fem needs laws of the principal stretches, which {law} is not")
        if options.global_solve != "condensed":
            use_petsc = self.linear_solver.name != "scipy_direct"
            self._saddle = SaddleSolver(
                options.global_solve, options.kkt_tolerance, options.kkt_max_iterations, use_petsc
            )
        if options.scheme == "alternating":
            self._alternating = Alternating(options, self.linear_solver, self._saddle, problem)
        else:
            cells = [MixedCells(term.group, options.floor) for term in problem.elastic]
            self._rule = MixedRule(options, self.linear_solver, self._saddle, cells)
        self._problem = problem

    def reset(self) -> None:
        """Forget stretches and factors, so that a run resumed from here repeats an unbroken one."""
        if self._alternating is not None:
            self._alternating.reset()
        if self._saddle is not None:
            self._saddle.reset()

    def destroy(self) -> None:
        """Free the saddle solver."""
        if self._saddle is not None:
            self._saddle.destroy()
        self._saddle = self._rule = self._alternating = self._problem = None
