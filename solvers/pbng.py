"""Position-based nonlinear Gauss-Seidel: sweeps of one modified Newton step per node."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from femdeform.scene.position_schema import PBNGSolver
from femdeform.step_problem import Budget, IterationObserver, LocalStepProblem, StepResult
from femdeform.types import FloatArray
from solvers.acceleration import SOR, Accelerator, Anderson, Chebyshev
from solvers.descent import Advance, Iterate, is_rounding, ratio
from solvers.linear.interface import LinearSolver
from solvers.newton_finish import NewtonFinish
from solvers.position_based.grid_node_sweep import GridNodeSweep
from solvers.position_based.node_arrays import NodeArrays
from solvers.position_based.node_sweep import NodeSweep

# An acceleration that is taken back again and again rests for at most 2 to this power looks.
_STRIKES = 4
# A rise of Phi by this part of its terms is rounding.
_FLAT = 1e-11
# Halvings of a motion of supports that no material stands at once, and sweeps between two portions.
_PORTIONS, _SETTLING = 30, 5
# Where the residual is below this part of the forces and falls no more, it may be rounding.
_SMALL = 1e-6


class PBNG:
    """One node after another takes a step of Newton's method on Phi with a modified, always definite 3x3 Hessian.

    Nodes of one colour share no cell and move at the same time, in threads; the result is the same for any number of
    them. In a grid its nodes are moved, with the cells of the embedded meshes. A step starts from free flight with
    inertia, else from the last state, with supports where they are at its end. The residual is that of the
    `StepProblem`, looked at every `check_every` sweeps.

    Parameters
    ----------
    options : PBNGSolver
        The scene's block.
    linear_solver : LinearSolver
        For `finish: newton_krylov` only.

    References
    ----------
    Y. Chen, Y. Han, J. Chen, J. Teran, Position-Based Nonlinear Gauss-Seidel for Quasistatic Hyperelasticity (2023).

    Limitations
    -----------
    The first digits come fast, the last ones slowly unless there is a `finish`:
    the number of sweeps to a tolerance grows with the square of the
    number of cells across a body, and with h^2 E / (rho dx^2) in dynamics. Linear triangles and tetrahedra with lumped
    mass; obstacles by penalty, or as walls of a grid; one rank. Forces of pressure are those of the last check, so
    convergence under large pressure is slower.
    """

    def __init__(self, options: PBNGSolver, linear_solver: LinearSolver | None = None) -> None:
        self.options = options
        self.finish: NewtonFinish | None = None
        if options.finish == "newton_krylov":
            if linear_solver is None:
                raise ValueError("finish: newton_krylov needs a linear solver")
            self.finish = NewtonFinish(linear_solver)
        self._sweeps: dict[str, NodeArrays] = {}
        self._problem: LocalStepProblem | None = None
        self._grid: GridNodeSweep | None = None
        self._layout = 0

    def step(
        self,
        problem: LocalStepProblem,
        state: Any,
        observe: IterationObserver | None = None,
        budget: Budget | None = None,
    ) -> StepResult:
        """Minimise Phi from an accepted state; see `StepSolver.step`.

        Rows of `observe` come with every look at the residual.
        """
        return _Step(self, problem, state, observe, Budget() if budget is None else budget).run()

    def sweep_of(self, problem: LocalStepProblem, precision: str) -> NodeArrays:
        """The sweep for a problem, laid out once, or again where its cells are over other nodes than before.

        The step is begun.
        """
        if self._problem is not problem:
            self.destroy()
        elif self._layout != problem.layout:
            self._sweeps = {}
        self._problem, self._layout = problem, problem.layout
        if precision not in self._sweeps:
            if problem.gathered_cells() is None:
                self._sweeps[precision] = NodeSweep(problem, np.dtype(precision))
            else:
                self._grid = GridNodeSweep(problem, np.dtype(precision), self._grid)
                self._sweeps[precision] = self._grid
        sweep = self._sweeps[precision]
        sweep.begin_step(problem)
        return sweep

    def reset(self) -> None:
        """Forget colours, where they come from earlier steps: else the layout depends on the problem alone."""
        if self._problem is not None and self._problem.layout > 0:
            self.destroy()

    def destroy(self) -> None:
        """Free the layout."""
        self._problem, self._sweeps, self._grid = None, {}, None


def make_accelerator(options: PBNGSolver) -> Accelerator | None:
    """What the options ask for; None for plain sweeps."""
    if options.acceleration == "chebyshev":
        return Chebyshev(options.rho, options.gamma)
    if options.acceleration == "sor":
        return SOR(options.omega)
    if options.acceleration == "anderson":
        return Anderson(options.window)
    return None


class _Step:
    """One step: sweeps, looks at the residual, and going back where an acceleration did harm."""

    def __init__(
        self,
        solver: PBNG,
        problem: LocalStepProblem,
        state: Any,
        observe: IterationObserver | None,
        budget: Budget,
    ) -> None:
        self.solver, self.options = solver, solver.options
        self.problem, self.state = problem, state
        self.observe, self.budget = observe, budget
        self.precision = self.options.precision
        self.sweep = solver.sweep_of(problem, self.precision)
        self.accelerator = make_accelerator(self.options)
        self.finish = solver.finish
        if self.finish is not None:
            self.finish.begin_step()
        self.strikes, self.waiting, self.taken_back = 0, 0, 0
        self.iteration = 0
        self.was_newton = False
        self.x = state.x
        self.flat = np.empty(0)
        self.norm = math.inf

    def run(self) -> StepResult:
        """Take the step."""
        problem, options = self.problem, self.options
        problem.place_obstacles(1.0)
        problem.linearize_at(self.state.x)
        failure = self._start()
        problem.settle_force_scale(self.x)
        start = self.x.copy()
        residual = self._look()
        if failure:
            return self._result(False, failure)
        value = self._value()
        best = self.norm
        stalled = 0
        limit = options.max_iterations if options.iterations is None else options.iterations
        while True:
            fixed = options.iterations is not None
            if not math.isfinite(self.norm):
                return self._result(False, "the residual is not finite")
            if self.norm <= options.tolerance * problem.force_scale and not fixed:
                return self._result(True, "residual below tolerance")
            if stalled > 0 and not fixed and self._is_rounding(residual, start):
                return self._result(True, "residual at the level of rounding")
            if self.iteration >= limit:
                if fixed:
                    below = self.norm <= options.tolerance * problem.force_scale
                    return self._result(below, f"{self.iteration} sweeps, as asked for", True)
                return self._result(False, f"no convergence in {self.iteration} sweeps")
            spent = self.budget.spent(self.iteration)
            if spent is not None:
                return self._result(False, spent)
            newton = self._newton_step(residual)
            if newton is not None and newton.found is not None:
                residual, value = self._look(), self._value()
                stalled = stalled + 1 if self.norm > 0.99 * best else 0
                best = min(best, self.norm)
                self._report(value, False, True, newton.all_iterations)
                continue
            if newton is not None:
                # What found nothing has cost time all the same.
                self._report(value, False, True, newton.all_iterations)

            saved, saved_norm = self.flat.copy(), self.norm
            accelerated = self._sweeps(limit)
            residual = self._look()
            after = self._value()
            if accelerated and self._is_worse(value, after, saved_norm):
                self._take_back(saved)
                residual = self._look()
            else:
                value = after
                if accelerated:
                    self.strikes = max(self.strikes - 1, 0)
            stalled = stalled + 1 if self.norm > 0.99 * best else 0
            best = min(best, self.norm)
            if self.precision == "float32" and not fixed and (stalled > 1 or not math.isfinite(self.norm)):
                self._refine(saved if not math.isfinite(self.norm) else self.flat)
                residual = self._look()
                best, stalled, value = self.norm, 0, self._value()
            self._report(value, accelerated)

    # --------------------------------------------------------------------------------------------- parts

    def _sweeps(self, limit: int) -> bool:
        """Sweeps up to the next look; whether they were accelerated."""
        self.was_newton = False
        end = min(self.iteration + self.options.check_every, limit)
        if self.budget.iterations is not None:
            end = min(end, self.budget.iterations)
        accelerated = self.accelerator is not None and self.waiting == 0
        self.waiting = max(self.waiting - 1, 0)
        moving = self.sweep.moving
        while self.iteration < end:
            before = self.flat[moving].copy() if accelerated else None
            self.sweep.sweep(self.flat, self.options.relaxation)
            self.iteration += 1
            if accelerated and self.accelerator is not None and before is not None:
                self.accelerator.mix(before, self.flat[moving])
            if self.budget.seconds is not None and self.budget.spent(self.iteration) is not None:
                break
        return accelerated

    def _newton_step(self, residual: FloatArray) -> Advance | None:
        """A Newton step from the present positions, in turn with sweeps; None where none is due."""
        finish = self.finish
        if finish is None or finish.is_given_up or self.was_newton:
            return None
        if not self.norm <= self.options.finish_below * self.problem.force_scale:
            return None
        if self.precision == "float32":
            self._refine(self.flat)
        answer = finish.advance(self.problem, self.x, residual)
        self.iteration += 1
        if answer.found is not None:
            self.flat = self.sweep.flat(answer.found.x)
            self.was_newton = True
            if self.accelerator is not None:
                self.accelerator.restart()
        return answer

    def _is_worse(self, before: float, after: float, norm: float) -> bool:
        """Whether accelerated sweeps raised the energy, or the residual where the energy is flat."""
        if not (math.isfinite(after) and math.isfinite(self.norm)):
            return True
        flat = _FLAT * self.problem.value_magnitude
        if after > before + flat:
            return True
        return after > before - flat and self.norm > 2.0 * norm

    def _take_back(self, saved: FloatArray) -> None:
        """Go back to the last look and sweep plainly for a while, the longer the more often it happens."""
        self.flat[:] = saved
        self.taken_back += 1
        self.strikes = min(self.strikes + 1, _STRIKES)
        self.waiting = 2**self.strikes
        assert self.accelerator is not None
        self.accelerator.restart()

    def _refine(self, flat: FloatArray) -> None:
        """Go over to float64 from positions in float32."""
        self.sweep.unflat(flat, self.x)
        self.precision = "float64"
        self.sweep = self.solver.sweep_of(self.problem, "float64")
        self.flat = self.sweep.flat(self.x)
        if self.accelerator is not None:
            self.accelerator = make_accelerator(self.options)

    def _look(self) -> FloatArray:
        """Residual at the present positions [N]."""
        self.sweep.unflat(self.flat, self.x)
        self.sweep.update_loads(self.problem, self.x)
        residual = self.problem.gradient(self.x)
        self.norm = self.problem.residual_norm(residual)
        return residual

    def _value(self) -> float:
        """Phi, where the safeguard of an acceleration needs it."""
        return self.problem.value(self.x) if self.accelerator is not None else math.nan

    def _start(self) -> str:
        """Set the first positions; why there are none, or empty."""
        problem = self.problem
        for x in (problem.predictor(self.state), problem.initial_guess(self.state)):
            self.x = x
            if math.isfinite(problem.value(x)):
                self.flat = self.sweep.flat(x)
                return ""
        # A material that must not invert does not stand the motion of its supports at once.
        guess, x, done = self.x, self.state.x.copy(), 0.0
        part = 1.0
        for _ in range(_PORTIONS):
            ahead = np.where(problem.free, x, x + part * (guess - x))
            if math.isfinite(problem.value(ahead)):
                x, done = ahead, done + part * (1.0 - done)
                self.flat = self.sweep.flat(x)
                if part == 1.0:
                    self.x = x
                    return ""
                for _ in range(_SETTLING):
                    self.sweep.sweep(self.flat)
                self.iteration += _SETTLING
                self.sweep.unflat(self.flat, x)
                part = 1.0
            else:
                part *= 0.5
        self.x = x
        self.flat = self.sweep.flat(x)
        return f"only {100.0 * done:.3g} % of the prescribed motion could be carried out: a material is in the way"

    def _is_rounding(self, residual: FloatArray, start: FloatArray) -> bool:
        if self.norm > _SMALL * self.problem.force_scale:
            return False
        if self.problem.roundoff_norm(self.x) == 0.0:
            self.problem.hessian(self.x, project=True)  # the size of its rows tells how much rounding leaves
        return is_rounding(self.problem, Iterate(self.x, residual, self.norm), start, 1.0)

    def _report(self, value: float, accelerated: bool, is_newton: bool = False, linear_iterations: int = 0) -> None:
        if self.observe is None:
            return
        if self.accelerator is None:
            with self.budget.paused():  # nobody but the observer needs it
                value = self.problem.value(self.x)
        row: dict[str, float | int | str] = {
            "iteration": self.iteration,
            "residual_norm": self.norm,
            "relative_residual": ratio(self.norm, self.problem.force_scale),
            "objective": value,
            "linear_iterations": linear_iterations,
            "newton": int(is_newton),
            "accelerated": int(accelerated),
            "taken_back": self.taken_back,
            "seconds": self.budget.elapsed(),
        }
        self.observe(row, self.x)

    def _result(self, converged: bool, reason: str, is_fixed_work: bool = False) -> StepResult:
        relative = ratio(self.norm, self.problem.force_scale)
        linear = 0 if self.finish is None else self.finish.linear_iterations
        return StepResult(self.x, converged, reason, self.iteration, linear, self.norm, relative, is_fixed_work)
