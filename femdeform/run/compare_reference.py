"""The converged solution that a comparison measures distances from."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from femdeform import registry
from femdeform.errors import NotConvergedError
from femdeform.fem.incremental_potential import State
from femdeform.run.compare_judge import Judge
from femdeform.run.compare_variants import REFERENCE
from femdeform.run.setup import build_simulation
from femdeform.run.status_line import StatusLine
from femdeform.run.time_loop import StepControl, take_step
from femdeform.scene import schema
from femdeform.step_problem import StepResult
from femdeform.types import Mesh

CONVERGED = "converged"

REFERENCE_TOLERANCE = 1e-11
_REFERENCE_ITERATIONS = 500
# A reference may end at the level of rounding. Above this part of R0, that is so only where nothing acts at all.
_REFERENCE_LIMIT = 1e-6
_REST = 100.0

Row = dict[str, Any]


class Reference:
    """The converged solution that distances are measured from: projected Newton down to rounding.

    Parameters
    ----------
    scene : DeformableScene
    meshes : mapping of str to Mesh
    start_step : int
        Steps before the common start.
    steps : int
        Steps that are compared.
    status : StatusLine

    Attributes
    ----------
    simulation : Simulation
        Done with stepping.
    start : State
        Where every variant starts.
    states : list of State
        After each step that is compared.
    rows : list of dict
        As those of the variants; the time is left out (NaN), for it contains compilation.
    control : StepControl
        Size of each step.
    judge : Judge
        On the problem of `simulation`.

    Raises
    ------
    NotConvergedError
        If a step does not converge.
    """

    def __init__(
        self,
        scene: schema.DeformableScene,
        meshes: Mapping[str, Mesh],
        start_step: int,
        steps: int,
        status: StatusLine,
    ) -> None:
        self._status = status
        self.simulation = build_simulation(_reference_scene(scene), meshes)
        self.control = StepControl(scene.time.dt, scene.time.end, scene.time.dt, halve=False)
        try:
            self.start = self.simulation.state
            for step in range(start_step):
                self.start = self._step(self.start, f"start, step {step + 1} of {start_step}")[0]
            self.states: list[State] = []
            results: list[StepResult] = []
            state = self.start
            for step in range(steps):
                state, result = self._step(state, f"step {step + 1} of {steps}")
                self.states.append(state)
                results.append(result)
        finally:
            self.simulation.destroy()
        self.judge = Judge(self.simulation)
        self.rows: list[Row] = []
        before = self.start
        for state, result in zip(self.states, results, strict=True):
            dt = self.control.next_step(before.time)
            self.judge.begin_step(before, dt, state.x)
            row = step_row(REFERENCE, before, dt, result, math.nan, CONVERGED)
            measured = self.judge.residual(result.x) | self.judge.distance(result.x, state.x)
            at_rest = measured["residual_norm"] <= _REST * self.judge.roundoff(self.judge.start(before))
            if not (measured["relative_residual"] <= _REFERENCE_LIMIT or at_rest):
                # A body that has run away to where rounding exceeds its forces.
                raise self._failure(before, dt, result.reason, measured["relative_residual"])
            self.rows.append(row | measured | self.judge.invariants(state))
            before = state

    def _step(self, state: State, place: str) -> tuple[State, StepResult]:
        self._status.show(f"reference: {place}")
        problem = self.simulation.problem
        dt = self.control.next_step(state.time)
        limit = problem.step_limit(state)
        if dt > limit:
            raise NotConvergedError(
                f"step {state.step + 1} of the reference may not be longer than {limit:.3g} s (grid.cfl: bodies move "
                f"too fast for the cells), and a comparison keeps its steps: time.dt = {dt:.3g} s has to be smaller"
            )
        result = take_step(problem, self.simulation.solver, state, dt)
        if not result.converged:
            raise self._failure(state, dt, result.reason, result.relative_residual)
        return problem.accept(state, result.x), result

    def _failure(self, state: State, dt: float, reason: str, residual: float) -> NotConvergedError:
        return NotConvergedError(
            f"the reference does not converge in step {state.step + 1} to t = {state.time + dt:.6g} s with dt = "
            f"{dt:.3g} s: {reason} (relative residual {residual:.2e}); without it there is nothing to compare with; "
            "a smaller time.dt may help"
        )

    def facts(self) -> dict[str, Any]:
        """How the reference was made."""
        scene = self.simulation.scene
        return {
            "solver": scene.solver.model_dump(mode="json"),
            "linear_solver": self.simulation.linear_solver.name,
            "largest_relative_residual": max(row["relative_residual"] for row in self.rows),
        }


def _reference_scene(scene: schema.DeformableScene) -> schema.DeformableScene:
    own = scene.solver if isinstance(scene.solver, schema.ProjectedNewtonSolver) else schema.ProjectedNewtonSolver()
    solver = own.model_copy(
        update={
            "tolerance": min(own.tolerance, REFERENCE_TOLERANCE),
            "max_iterations": max(own.max_iterations, _REFERENCE_ITERATIONS),
            "hessian": "adaptive",
        }
    )
    linear = scene.linear_solver
    named = "linear_solver" in scene.model_fields_set
    if not named or (isinstance(linear, schema.KSPLinearSolver) and registry.saddle_preset(linear.preset)):
        # Large meshes need another one, which their scene names: the residual tells whether it was good enough.
        linear = schema.KSPLinearSolver(preset="newton-mumps")
    return scene.model_copy(update={"solver": solver, "linear_solver": linear})


def step_row(label: str, before: State, dt: float, result: StepResult, seconds: float, status: str) -> Row:
    """What a solver's result says of a step, without any judgement of it."""
    return {
        "variant": label,
        "step": before.step + 1,
        "time": before.time + dt,
        "dt": dt,
        "iterations": result.iterations,
        "linear_iterations": result.linear_iterations,
        "seconds": seconds,
        "status": status,
        "stopped_by": result.reason,
        "reported_residual": result.residual_norm,
    }
