"""XPBD, PBD and XPBD's pseudo-time steps for statics: sweeps over constraints with multipliers."""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.scene.constraint_schema import PBDSolver, XPBDQSSolver, XPBDSolver
from femdeform.step_problem import Budget, IterationObserver, LocalStepProblem, StepResult
from solvers.linear.interface import LinearSolver
from solvers.position_based.cell_sweep import CellSweep
from solvers.position_based.constraint_step import ConstraintStep, PseudoTimeStep, Stopping
from solvers.position_based.constraint_sweeps import BlendedSweep, ConstraintSweep


class CellSolver:
    """What solvers that sweep over cells share: the layout of a problem is made once.

    Parameters
    ----------
    options : SceneModel
        The scene's block.
    linear_solver : LinearSolver
        Not used.
    """

    def __init__(self, options: Any, linear_solver: LinearSolver | None = None) -> None:
        self.options = options
        self._problem: LocalStepProblem | None = None
        self._sweep: CellSweep | None = None
        self._layout = 0

    def sweep_of(self, problem: LocalStepProblem) -> CellSweep:
        """The sweep for a problem, laid out once, or again where its cells are over other nodes than before."""
        if self._sweep is None or self._problem is not problem:
            self._problem, self._sweep = problem, self.make_sweep(problem)
            self._sweep.links_first = getattr(self.options, "links_first", False)
        elif self._layout != problem.layout:
            self._sweep = self.make_sweep(problem, self._sweep)
        self._layout = problem.layout
        return self._sweep

    def make_sweep(self, problem: LocalStepProblem, previous: CellSweep | None = None) -> CellSweep:
        """Lay out the sweep for a problem, with the colours of an earlier one of the same problem if there is one."""
        raise NotImplementedError

    def stopping(self) -> Stopping:
        """When a step ends."""
        raise NotImplementedError

    def step(
        self,
        problem: LocalStepProblem,
        state: Any,
        observe: IterationObserver | None = None,
        budget: Budget | None = None,
    ) -> StepResult:
        """Take a step from an accepted state; see `StepSolver.step`.

        Rows of `observe` come with every look at the residual.

        Raises
        ------
        InputError
            If the problem is not one the method knows.
        """
        step = ConstraintStep(self.sweep_of(problem), problem, state, observe, Budget() if budget is None else budget)
        return step.dynamics(self.stopping(), getattr(self.options, "order", "forward") == "reverse")

    def reset(self) -> None:
        """Forget colours, where they come from earlier steps: else the layout depends on the problem alone."""
        if self._problem is not None and self._problem.layout > 0:
            self.destroy()

    def destroy(self) -> None:
        """Free the layout."""
        self._problem = self._sweep = None


class XPBD(CellSolver):
    """Extended position-based dynamics of hyperelastic cells, two constraints each.

    A step starts from free flight with multipliers of zero; sweeps visit one constraint after another, in threads by
    colour; the multipliers add up over the sweeps. Nothing in it has a scale of its own.

    References
    ----------
    M. Macklin, M. Mueller, N. Chentanez, XPBD: position-based simulation of compliant constrained dynamics (2016).
    Y. Chen, Y. Han, J. Chen, S. Ma, R. Fedkiw, J. Teran, Primal extended position based dynamics for hyperelasticity
    (2023).

    Limitations
    -----------
    The constraints are met, C + alpha/h^2 l = 0, but the equations of motion are not: the residual stagnates at some
    tenth of what it was, and where it ends depends on the order of the constraints. Linear triangles and tetrahedra
    with lumped mass; fixed corotated, ARAP and neo-Hookean laws; obstacles by penalty; dynamics; one rank.
    """

    options: XPBDSolver

    def make_sweep(self, problem: LocalStepProblem, previous: CellSweep | None = None) -> CellSweep:
        """See `CellSolver`."""
        options = self.options
        if options.keep_primary_residual:
            return BlendedSweep(problem, epsilon=options.epsilon, keep_residual=True, previous=previous)
        return ConstraintSweep(problem, options.epsilon, root=options.constraints == "root", previous=previous)

    def stopping(self) -> Stopping:
        """See `CellSolver`."""
        return Stopping(self.options.iterations, self.options.tolerance, self.options.check_every, True)


class PBD(CellSolver):
    """Position-based dynamics: constraints projected as if they were infinitely stiff.

    References
    ----------
    M. Mueller, B. Heidelberger, M. Hennix, J. Ratcliff, Position based dynamics (2007).

    Limitations
    -----------
    A comparison. Stiffness comes from too few sweeps: with more of them the body turns rigid and loads, which act only
    on where the sweeps start, are forgotten. So are they in statics, where a step starts from ``x + h^2 M^-1 f``. Laws
    whose constraints vanish at rest: fixed corotated and ARAP; otherwise as XPBD.
    """

    options: PBDSolver

    def make_sweep(self, problem: LocalStepProblem, previous: CellSweep | None = None) -> CellSweep:
        """See `CellSolver`."""
        return ConstraintSweep(problem, 0.0, rigid=True, previous=previous)

    def stopping(self) -> Stopping:
        """See `CellSolver`."""
        return Stopping(self.options.iterations, None, self.options.check_every, True)

    def step(
        self,
        problem: LocalStepProblem,
        state: Any,
        observe: IterationObserver | None = None,
        budget: Budget | None = None,
    ) -> StepResult:
        """See `CellSolver`."""
        if np.any(problem.nodal_terms().weights > 0.0):
            return super().step(problem, state, observe, budget)
        options = self.options
        dt = problem.dt if options.pseudo_step is None else options.pseudo_step
        step = ConstraintStep(self.sweep_of(problem), problem, state, observe, Budget() if budget is None else budget)
        return step.pushed(dt, self.stopping(), options.order == "reverse")


class XPBDQuasistatic(CellSolver):
    """Statics by pseudo-time steps of XPBD.

    References
    ----------
    Y. Chen, Y. Han, J. Chen, J. Teran, Position-Based Nonlinear Gauss-Seidel for Quasistatic Hyperelasticity (2023),
    section on XPBD.

    Limitations
    -----------
    A comparison. Where it comes to rest is not the static solution: it depends on the pseudo-time step, on the sweeps
    in it and on the order of the constraints. The residual tells by how much. Otherwise as XPBD.
    """

    options: XPBDQSSolver

    def make_sweep(self, problem: LocalStepProblem, previous: CellSweep | None = None) -> CellSweep:
        """See `CellSolver`."""
        return ConstraintSweep(problem, self.options.epsilon, previous=previous)

    def step(
        self,
        problem: LocalStepProblem,
        state: Any,
        observe: IterationObserver | None = None,
        budget: Budget | None = None,
    ) -> StepResult:
        """See `CellSolver`."""
        options = self.options
        budget = Budget() if budget is None else budget
        step = PseudoTimeStep(self.sweep_of(problem), problem, state, observe, budget)
        return step.statics(
            options.pseudo_step,
            options.iterations,
            options.max_pseudo_steps,
            options.at_rest,
            options.tolerance,
            options.order == "reverse",
        )
