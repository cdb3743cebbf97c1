"""How a comparison runs one variant: under its budget, with the judge beside it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from femdeform.errors import InputError
from femdeform.fem.incremental_potential import State
from femdeform.run.compare_reference import CONVERGED, Reference, Row, step_row
from femdeform.run.compare_variants import variant_fault
from femdeform.run.setup import Simulation, build_simulation
from femdeform.run.status_line import StatusLine
from femdeform.scene import schema
from femdeform.step_problem import Budget, StepResult
from femdeform.types import FloatArray, Mesh

SPENT, DIVERGED, STOPPED = "budget spent", "diverged", "stopped"
# Of a scheme that promises no tolerance: its fixed amount of work is done.
WORK_DONE = "work done"

_WARM_UP_ITERATIONS = 3
# Columns that only some solvers report, and only they can: what a method takes its residual apart into [N].
RESIDUAL_PARTS = ("primary_residual", "secondary_residual")
# A solver's own residual and the judge's are the same sum in another order: more than this apart, one is wrong.
_DISAGREEMENT = 0.01


class _NotFiniteError(Exception):
    """An iterate is not finite: what follows it is not either."""

    def __init__(self, iteration: int) -> None:
        super().__init__(f"iterate {iteration} is not finite")
        self.iteration = iteration


@dataclass(frozen=True)
class Outcome:
    """One run of one variant.

    Attributes
    ----------
    steps, iterations : list of dict
        Rows, see `femdeform.run.compare.Comparison`.
    state : State or None
        After the last step; None if the variant diverged.
    notices : list of str
    """

    steps: list[Row]
    iterations: list[Row]
    state: State | None
    notices: list[str] = field(default_factory=list)

    @property
    def seconds(self) -> float:
        """Time of all steps [s]."""
        return float(sum(row["seconds"] for row in self.steps))


@dataclass(frozen=True)
class Trial:
    """One variant, ready to run any number of times.

    Attributes
    ----------
    label : str
    scene : DeformableScene
        The scene with the variant's solver.
    meshes : mapping of str to Mesh
    reference : Reference
    make_budget : callable
        Gives a fresh budget for a step.
    status : StatusLine
    """

    label: str
    scene: schema.DeformableScene
    meshes: Mapping[str, Mesh]
    reference: Reference
    make_budget: Callable[[], Budget]
    status: StatusLine

    def warm_up(self) -> list[str]:
        """Take a few iterations and throw them away, so that kernels are compiled; notices of the scene.

        Raises
        ------
        InputError
            If the linear solver refuses its options, which it reads now.
        """
        self.status.show(f"{self.label}: warming up")
        simulation = self._build()
        start = self.reference.start
        try:
            problem = simulation.problem
            problem.begin_step(start, self.reference.control.next_step(start.time))
            budget = Budget(iterations=_WARM_UP_ITERATIONS)
            simulation.solver.step(problem, problem.solver_state(start.copy()), _stop_at_nonsense, budget)
        except _NotFiniteError:
            pass  # the run itself will say so
        except InputError as error:
            raise InputError([variant_fault(self.label, fault) for fault in error.faults]) from None
        finally:
            simulation.destroy()
        return simulation.notices

    def run(self, remark: str = "") -> Outcome:
        """Run all steps from the common start.

        Parameters
        ----------
        remark : str
            Added to what the status line says.
        """
        steps: list[Row] = []
        iterations: list[Row] = []
        doubtful: list[Row] = []
        simulation = self._build()
        state: State | None = self.reference.start.copy()
        try:
            for number, target in enumerate(self.reference.states, start=1):
                assert state is not None
                place = f"{self.label}: step {number} of {len(self.reference.states)}{remark}"
                row, rows, state = self._step(simulation, state, target.x, place)
                steps.append(row)
                iterations += rows
                if state is None:
                    break
                if self._is_doubtful(row, state):
                    doubtful.append(row)
        finally:
            simulation.destroy()
        return Outcome(steps, iterations, state, self._doubts(doubtful))

    def _build(self) -> Simulation:
        return build_simulation(self.scene, self.meshes)

    def _step(
        self, simulation: Simulation, state: State, target: FloatArray, place: str
    ) -> tuple[Row, list[Row], State | None]:
        """One step under the budget: its row, the rows of its iterations, the state after it (None: diverged)."""
        problem, judge = simulation.problem, self.reference.judge
        dt = self.reference.control.next_step(state.time)
        rows: list[Row] = []
        budget = self.make_budget()

        def record(iteration: int, seconds: float, x: FloatArray, reported: Row) -> None:
            head = {"variant": self.label, "step": state.step + 1, "iteration": iteration, "seconds": seconds}
            rows.append(head | judge.residual(x) | judge.distance(x, target) | reported)
            self.status.show(f"{place}, iteration {iteration}, r/R0 {rows[-1]['relative_residual']:.1e}")

        def observe(row: Mapping[str, float | int | str], x: FloatArray) -> None:
            with budget.paused():
                _stop_at_nonsense(row, x)
                parts = {name: row[name] for name in RESIDUAL_PARTS if name in row}
                record(int(row["iteration"]), budget.elapsed(), x, parts)

        judge.begin_step(state, dt, target)
        problem.begin_step(state, dt)
        begin = problem.solver_state(state)
        record(0, 0.0, judge.start(state), {})
        budget.start()
        try:
            result = simulation.solver.step(problem, begin, observe, budget)
        except _NotFiniteError as error:
            nowhere = np.full_like(begin.x, math.nan)
            result = StepResult(nowhere, False, str(error), error.iteration, 0, math.nan, math.nan)
        seconds = budget.elapsed()
        measured = judge.residual(result.x) | judge.distance(result.x, target)
        if np.isfinite(result.x).all() and math.isfinite(measured["residual_norm"]):
            status = CONVERGED if result.converged else STOPPED
            spent = budget.spent(result.iterations)
            if result.is_fixed_work:
                status = WORK_DONE
            elif spent is not None and spent in result.reason:  # on the way of the supports too
                status = SPENT
            after: State | None = problem.accept(state, result.x)
            assert after is not None
            invariants = judge.invariants(after)
        else:
            status, after = DIVERGED, None
            invariants = dict.fromkeys(judge.invariant_names(), math.nan)
        row = step_row(self.label, state, dt, result, seconds, status)
        return row | measured | invariants, rows, after

    def _doubts(self, rows: Sequence[Row]) -> list[str]:
        if not rows:
            return []
        first = rows[0]
        return [
            f"{self.label}: the solver reports another residual than is measured in {len(rows)} of the steps, first "
            f"in step {first['step']}: {first['reported_residual']:.3e} N reported, {first['residual_norm']:.3e} N "
            "measured"
        ]

    def _is_doubtful(self, row: Row, state: State) -> bool:
        reported, measured = row["reported_residual"], row["residual_norm"]
        larger = max(reported, measured)
        return bool(
            larger > 100.0 * self.reference.judge.roundoff(state.x)
            and abs(reported - measured) > _DISAGREEMENT * larger
        )


def _stop_at_nonsense(row: Mapping[str, float | int | str], x: FloatArray) -> None:
    if not np.isfinite(x).all():
        raise _NotFiniteError(int(row["iteration"]))
