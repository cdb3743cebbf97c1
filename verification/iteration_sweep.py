"""Iteration sweeps: how fast the residual of one or more methods falls, by iterations and by seconds."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from femdeform.errors import NotConvergedError
from femdeform.run.compare import compare_prepared
from verification.judgement import Row, Verdict, judge
from verification.plan import IterationPlan
from verification.verify_progress import VerifyProgress

if TYPE_CHECKING:
    from verification.study import StudyResult

# Contraction is measured where a method has settled: over this last part of its iterations.
_SETTLED = 0.5


def run_iterations(plan: IterationPlan, progress: VerifyProgress) -> StudyResult:
    """Run every variant of an iteration sweep for its iterations and judge what it reaches.

    Parameters
    ----------
    plan : IterationPlan
        Checked.
    progress : VerifyProgress
        Told what is going on.

    Returns
    -------
    StudyResult
        Three rows a variant: residual, distance and contraction, of its last step.
    """
    from verification.study import StudyResult

    begin = time.perf_counter()
    table: list[dict[str, Any]] = []
    reason, n_dofs = "", 0
    with progress.run(""):
        try:
            comparison = compare_prepared(plan.prepared, plan.budget)
        except NotConvergedError as error:
            reason = f"the reference does not converge: {error}"
        else:
            table = [dict(row) for row in comparison.iterations]
            n_dofs = int(comparison.facts["n_dofs"])
    seconds = time.perf_counter() - begin
    end = f"failed: {reason}" if reason else f"{seconds:.2f} s"
    progress.finished("", f"{n_dofs:,} degrees of freedom, {end}", bool(reason))
    rows: list[Row] = []
    verdicts: list[Verdict] = []
    for label, quantities in plan.quantities.items():
        course = _last_step(table, label)
        for name, value in measure_course(course).items():
            row = Row(
                study=plan.name,
                level=label,
                size=math.nan,
                n_dofs=n_dofs,
                dt=plan.prepared.base.scene.time.dt,
                quantity=name,
                computed=value,
                reference=math.nan,
                error=math.nan,
                rate=math.nan,
                seconds=float(course[-1]["seconds"]) if course else math.nan,
                iterations=int(course[-1]["iteration"]) if course else 0,
                note=reason,
            )
            rows.append(row)
            if name in quantities and not quantities[name].report_only:
                verdicts += judge([row], quantities[name], quantities[name], each_level=True)
    return StudyResult(plan.name, plan.kind, plan.about, "iteration", rows, verdicts, seconds, table)


def measure_course(course: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Residual, distance and contraction of one variant's iterations in one step.

    The contraction is the geometric mean of the factors by which the residual fell, over the last half of the
    iterations; it needs three iterates.
    """
    if not course:
        return dict.fromkeys(("residual", "distance", "contraction"), math.nan)
    residuals = [float(row["relative_residual"]) for row in course]
    first = min(math.floor(len(residuals) * (1.0 - _SETTLED)), len(residuals) - 2)
    contraction = math.nan
    if len(residuals) > 2 and residuals[first] > 0.0 and residuals[-1] > 0.0:
        contraction = (residuals[-1] / residuals[first]) ** (1.0 / (len(residuals) - 1 - first))
    return {
        "residual": residuals[-1],
        "distance": float(course[-1]["distance"]),
        "contraction": contraction,
    }


def _last_step(table: Sequence[dict[str, Any]], label: str) -> list[dict[str, Any]]:
    own = [row for row in table if row["variant"] == label]
    return [row for row in own if row["step"] == own[-1]["step"]]
