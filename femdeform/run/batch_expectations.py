"""What a study expects of all its runs together: means over seeds, say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from femdeform.run.batch_index import StudyTable
from femdeform.run.expectations import verdict
from femdeform.scene.batch_schema import ExpectedOverRuns
from femdeform.types import FloatArray


def over_runs_verdicts(
    expected: Sequence[ExpectedOverRuns], columns: Sequence[str], table: StudyTable
) -> list[dict[str, Any]]:
    """Verdicts of a study's `expect`, as of `femdeform.run.expectations.verdict`.

    Parameters
    ----------
    expected : sequence of ExpectedOverRuns
        What is expected.
    columns : sequence of str
        Column of the table that each is about.
    table : StudyTable
        The study with all its runs; one that has no such number makes the verdict fail. As long as one is not
        finished, `computed` and `passed` are None.
    """
    is_over = all(row.ending.is_finished for row in table.rows)
    verdicts = []
    for wanted, column in zip(expected, columns, strict=True):
        values = np.array([np.nan if value is None else value for value in table.column(column)], dtype=float)
        name = f"{wanted.statistic} over {values.size} runs of {wanted.scalar}"
        found = verdict(name, over_runs(values, wanted.statistic), wanted)
        verdicts.append(found if is_over else {**found, "computed": None, "passed": None})
    return verdicts


def over_runs(values: FloatArray, statistic: str) -> float:
    """Mean, smallest, largest, or standard error of the mean of numbers (n,); nan if one of them is."""
    if statistic == "mean":
        return float(np.mean(values))
    if statistic == "standard_error":
        return float(np.std(values, ddof=1) / np.sqrt(values.size)) if values.size > 1 else float("nan")
    return float(np.min(values) if statistic == "smallest" else np.max(values))


def allowed(found: Mapping[str, Any]) -> str:
    """The range that a verdict allows, in words."""
    if "expected" in found:
        margin = found["atol"] + found["rtol"] * abs(found["expected"])
        return f"{found['expected']:.6g} ± {margin:.3g}"
    bounds = {"at least": found.get("at_least"), "at most": found.get("at_most")}
    return ", ".join(f"{words} {bound:.6g}" for words, bound in bounds.items() if bound is not None)


def described(found: Mapping[str, Any]) -> str:
    """A verdict on one line."""
    names = ("expected", "rtol", "atol", "at_least", "at_most")
    wanted = ", ".join(f"{name.replace('_', ' ')} {found[name]:g}" for name in names if found.get(name) is not None)
    return f"{found['quantity']}: {found['computed']:.6g} ({wanted}): {'passed' if found['passed'] else 'FAILED'}"
