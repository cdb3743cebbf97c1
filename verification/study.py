"""Runs cases: every level of every study, its errors and verdicts. The command and the tests both come here."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from femdeform.jit import CompilationAnnouncer
from femdeform.types import FloatArray
from verification.case import load_case
from verification.execution import Outcome, run_problem
from verification.history import reduce_history
from verification.judgement import Row, Verdict, judge, rates_of
from verification.plan import CasePlan, IterationPlan, Level, MeasuredQuantity, Problem, StudyPlan, Target
from verification.verify_progress import Silent, VerifyProgress

# A run of fewer steps has no course worth a plot.
_STEPS_OF_A_COURSE = 5


@dataclass(frozen=True)
class Course:
    """A measured quantity over the time of a run, `times` [s] and `values` (n,)."""

    measure: str
    times: FloatArray
    values: FloatArray


@dataclass(frozen=True)
class StudyResult:
    """A study, computed.

    Attributes
    ----------
    name, kind, about : str
    axis : str
        What the sizes of the rows are, with the unit.
    rows : list of Row
    verdicts : list of Verdict
    seconds : float
        Wall time [s].
    iterations : list of dict
        Rows of an iteration sweep: `variant`, `step`, `iteration`, `seconds`, `relative_residual`, `distance`, ...
    courses : list of Course
        Of a single run, what was measured over its time.
    """

    name: str
    kind: str
    about: str
    axis: str
    rows: list[Row]
    verdicts: list[Verdict]
    seconds: float
    iterations: list[dict[str, Any]] = field(default_factory=list)
    courses: list[Course] = field(default_factory=list)

    @property
    def passed(self) -> bool:
        """Whether every judgement lies inside its band."""
        return all(verdict.passed for verdict in self.verdicts)


@dataclass(frozen=True)
class CaseResult:
    """A case, computed.

    Attributes
    ----------
    name, title, readme : str
    folder : Path
    full : bool
        Whether all of it was run, or the coarse end.
    studies : list of StudyResult
    seconds : float
        Wall time [s].
    """

    name: str
    title: str
    readme: str
    folder: Path
    full: bool
    studies: list[StudyResult]
    seconds: float

    @property
    def verdicts(self) -> list[Verdict]:
        """Verdicts of all studies."""
        return [verdict for study in self.studies for verdict in study.verdicts]

    @property
    def passed(self) -> bool:
        """Whether every judgement lies inside its band."""
        return all(verdict.passed for verdict in self.verdicts)


def run_case(
    folder: Path, full: bool = False, out: Path | None = None, progress: VerifyProgress | None = None
) -> CaseResult:
    """Run a case and judge it.

    Parameters
    ----------
    folder : Path
        Holds `study.yaml`.
    full : bool
        All levels of all studies, not the coarse end only.
    out : Path, optional
        Folder to write the case's tables and plots to; nothing is written if left out.
    progress : VerifyProgress, optional
        Told what is going on.

    Returns
    -------
    CaseResult

    Raises
    ------
    InputError
        With every fault of the case, before anything is computed.
    """
    return run_plan(load_case(folder), full, out, progress)


def run_plan(
    plan: CasePlan, full: bool = False, out: Path | None = None, progress: VerifyProgress | None = None
) -> CaseResult:
    """Run a case that has been read; see `run_case`."""
    progress = Silent() if progress is None else progress
    begin = time.perf_counter()
    studies = []
    with CompilationAnnouncer(progress.notice):
        for study in plan.chosen(full):
            progress.study(plan.name, study.name)
            if isinstance(study, IterationPlan):
                from verification.iteration_sweep import run_iterations

                studies.append(run_iterations(study, progress))
            else:
                studies.append(_run_study(study, full, progress))
    seconds = time.perf_counter() - begin
    result = CaseResult(plan.name, plan.title, plan.readme, plan.folder, full, studies, seconds)
    if out is not None:
        from verification.report import write_case

        write_case(result, out)
    return result


def _run_study(plan: StudyPlan, full: bool, progress: VerifyProgress) -> StudyResult:
    begin = time.perf_counter()
    runs = _Runs(progress)
    outcomes: list[Outcome] = []
    levels = plan.chosen(full)
    for level in levels:
        outcome = runs.of(level.problem, level.label)
        outcomes.append(outcome)
        if outcome.reason and plan.is_refinement:
            break  # the finer ones could be judged by nothing
    reached = levels[: len(outcomes)]
    rows: list[Row] = []
    verdicts: list[Verdict] = []
    for quantity in plan.quantities:
        of_quantity = _rows(plan.name, quantity, reached, outcomes, runs)
        rows += of_quantity
        if quantity.spec.report_only:
            continue
        broken = next((row for row, o in zip(of_quantity, outcomes, strict=True) if o.reason), None)
        if broken is not None and plan.is_refinement:
            verdicts.append(
                Verdict(plan.name, quantity.name, broken.level, "run", math.nan, math.nan, math.nan, False, broken.note)
            )
        else:
            verdicts += judge(of_quantity, quantity.spec, quantity.band(full), each_level=not plan.is_refinement)
    courses = []
    if plan.kind == "value" and outcomes[0].times.size > _STEPS_OF_A_COURSE:
        measures = dict.fromkeys(quantity.measure for quantity in plan.quantities if not quantity.is_norm)
        courses = [Course(name, outcomes[0].times, outcomes[0].history[name]) for name in measures]
    seconds = time.perf_counter() - begin
    return StudyResult(plan.name, plan.kind, plan.about, plan.axis, rows, verdicts, seconds, courses=courses)


class _Runs:
    """Runs of a study, each computed once however many quantities look at it."""

    def __init__(self, progress: VerifyProgress) -> None:
        self._progress = progress
        self._known: dict[tuple[str, str], Outcome] = {}

    def of(self, problem: Problem, label: str) -> Outcome:
        key = (problem.loaded.hash, problem.integrator)
        if key not in self._known:
            with self._progress.run(label) as advance:
                self._known[key] = run_problem(problem, advance)
            outcome = self._known[key]
            end = f"failed: {outcome.reason}" if outcome.reason else f"{outcome.seconds:.2f} s"
            self._progress.finished(label, f"{outcome.n_dofs:,} degrees of freedom, {end}", bool(outcome.reason))
        return self._known[key]


@dataclass(frozen=True)
class _Found:
    """A quantity of a level: computed value and reference, NaN where there is none, and a note."""

    computed: float = math.nan
    reference: float = math.nan
    note: str = ""
    is_reference: bool = False


def _rows(
    study: str, quantity: MeasuredQuantity, levels: Sequence[Level], outcomes: Sequence[Outcome], runs: _Runs
) -> list[Row]:
    """Rows of one quantity over the levels."""
    found = [_measure(quantity, k, levels, outcomes, runs) for k in range(len(outcomes))]
    errors = [abs(of_level.computed - of_level.reference) for of_level in found]
    rates = rates_of([level.size for level in levels], errors)
    return [
        Row(
            study,
            level.label,
            level.size,
            outcome.n_dofs,
            outcome.dt,
            quantity.name,
            of_level.computed,
            # The distance from a field is its own error: there is no other number to show.
            math.nan if quantity.is_norm else of_level.reference,
            error,
            rate,
            outcome.seconds,
            outcome.iterations,
            of_level.note or (f"{outcome.n_halved} steps had to be halved" if outcome.n_halved else ""),
            of_level.is_reference,
        )
        for level, outcome, of_level, error, rate in zip(levels, outcomes, found, errors, rates, strict=True)
    ]


def _measure(
    quantity: MeasuredQuantity, k: int, levels: Sequence[Level], outcomes: Sequence[Outcome], runs: _Runs
) -> _Found:
    """A quantity of level k."""
    outcome, target = outcomes[k], levels[k].targets.get(quantity.name)
    if outcome.reason:
        return _Found(note=outcome.reason)
    other, note = _other(target, levels[k], k, outcomes, runs)
    if note:
        return _Found(note=note)
    try:
        if quantity.is_norm:
            return _norm(quantity, levels[k], outcome, other)
        computed = _reduced(quantity, outcome)
        if other is outcome:
            return _Found(computed, is_reference=True)
        if other is not None:
            return _Found(computed, _reduced(quantity, other))
        return _Found(computed, math.nan if target is None or target.value is None else target.value)
    except ValueError as error:  # a course or a mesh that does not have what is asked for
        return _Found(note=f"{quantity.name}: {error}")


def _norm(quantity: MeasuredQuantity, level: Level, outcome: Outcome, other: Outcome | None) -> _Found:
    """A norm of the distance from another run, or else from the exact displacement."""
    exact = level.problem.fields.displacement
    if other is outcome:
        return _Found(is_reference=True)
    if other is not None:
        norms = outcome.distance_to(other)
    else:
        assert exact is not None  # judged with the study
        norms = outcome.distance_from(exact)
    return _Found(norms.l2 if quantity.name == "l2" else norms.h1, 0.0)


def _other(
    target: Target | None, level: Level, k: int, outcomes: Sequence[Outcome], runs: _Runs
) -> tuple[Outcome | None, str]:
    """The run that a level is compared with (itself where it has no error), and why it cannot be."""
    if target is None:
        return None, ""
    if target.run is not None:
        other = runs.of(target.run, f"{level.label}, reference" if level.label else "reference")
        return (None, f"reference: {other.reason}") if other.reason else (other, "")
    if target.level is None:
        return None, ""
    index = {"first": 0, "last": len(outcomes) - 1, "previous": max(k - 1, 0)}[target.level]
    if outcomes[index].reason:
        return None, f"the level it is compared with: {outcomes[index].reason}"
    return outcomes[index], ""


def _reduced(quantity: MeasuredQuantity, outcome: Outcome) -> float:
    course: Mapping[str, Any] = outcome.history
    return reduce_history(quantity.function, outcome.times, course[quantity.measure], quantity.spec.window)


def count_passed(results: Iterable[CaseResult]) -> tuple[int, int]:
    """Number of judgements inside their band, and of all."""
    verdicts = [verdict for result in results for verdict in result.verdicts]
    return sum(verdict.passed for verdict in verdicts), len(verdicts)
