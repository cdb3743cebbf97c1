"""Verdicts as lines of a table, for the screen and for the page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from verification.judgement import Verdict
from verification.study import CaseResult, StudyResult

COLUMNS = ("study", "quantity", "found", "band", "verdict", "worst")
_WORDS = {"tolerance": "error", "decreasing": "ratio of errors"}


@dataclass(frozen=True)
class Line:
    """Judgements of one kind on one quantity of a study, over all variations and levels that were judged.

    Attributes
    ----------
    study, quantity : str
    found : str
        What was judged and what it came to; of several, the worst.
    band : str
        What it had to be.
    place : str
        Variation and level of the worst; empty where there is one only.
    n_passed, n_judged : int
    reasons : list of str
        Why it failed.
    """

    study: str
    quantity: str
    found: str
    band: str
    place: str
    n_passed: int
    n_judged: int
    reasons: list[str]

    @property
    def passed(self) -> bool:
        """Whether all lie inside their band."""
        return self.n_passed == self.n_judged

    @property
    def verdict(self) -> str:
        """A few words."""
        if self.n_judged == 1:
            return "ok" if self.passed else "FAILED"
        if self.passed:
            return f"all {self.n_judged} ok"
        return f"{self.n_judged - self.n_passed} of {self.n_judged} FAILED"

    def cells(self) -> tuple[str, ...]:
        """Texts in the order of `COLUMNS`."""
        return self.study, self.quantity, self.found, self.band, self.verdict, self.place


def case_lines(result: CaseResult, apart: bool = False) -> list[Line]:
    """Lines of all studies of a case.

    Parameters
    ----------
    result : CaseResult
        What was computed.
    apart : bool
        Every variation of a study by itself; otherwise they share their lines.
    """
    groups: dict[tuple[str, str, str], list[tuple[StudyResult, Verdict]]] = {}
    for study in result.studies:
        name = study.name if apart else study.name.partition("/")[0]
        for verdict in study.verdicts:
            groups.setdefault((name, verdict.quantity, verdict.judgement), []).append((study, verdict))
    return [_line(name, judged) for (name, _, _), judged in groups.items()]


def _line(name: str, judged: Sequence[tuple[StudyResult, Verdict]]) -> Line:
    study, worst = max(judged, key=lambda pair: _badness(pair[1]))
    place = ", ".join(part for part in (study.name[len(name) + 1 :], worst.level) if part) if len(judged) > 1 else ""
    reasons = []
    for _, verdict in judged:
        if not verdict.passed:
            level = f", {verdict.level}" if verdict.level else ""
            reasons.append(f"{verdict.study}, {verdict.quantity}{level}: {verdict.reason}")
    return Line(
        name,
        worst.quantity,
        _found(study, worst),
        band_text(worst),
        place,
        sum(verdict.passed for _, verdict in judged),
        len(judged),
        reasons,
    )


def _badness(verdict: Verdict) -> float:
    """How far on the way to the edge of its band, or beyond: 0 is as good as can be, above 1 has failed."""
    if math.isnan(verdict.computed):
        return math.inf
    low, high = verdict.low, verdict.high
    if verdict.judgement in ("tolerance", "decreasing"):
        return verdict.computed / high if high > 0.0 else (math.inf if verdict.computed > 0.0 else 0.0)
    if math.isfinite(low) and math.isfinite(high) and high > low:
        return abs(2.0 * verdict.computed - low - high) / (high - low)
    if not verdict.passed:
        return math.inf
    if math.isfinite(low) == math.isfinite(high):
        return 0.0
    # One bound: how close to it, in no particular unit.
    return verdict.computed / abs(high or 1.0) if math.isfinite(high) else -verdict.computed / abs(low or 1.0)


def _found(study: StudyResult, verdict: Verdict) -> str:
    if verdict.judgement == "run":
        return "no result"
    word = _WORDS.get(verdict.judgement, verdict.judgement)
    if verdict.judgement != "rate":
        return f"{word} {number(verdict.computed)}"
    rows = [row for row in study.rows if row.quantity == verdict.quantity]
    rates = " ".join(f"{row.rate:.2f}" for row in rows if not math.isnan(row.rate))
    errors = [row.error for row in rows if not math.isnan(row.error)]
    return f"{word} {rates or '-'}" + (f", error {errors[-1]:.2g}" if errors else "")


def band_text(verdict: Verdict) -> str:
    """The band in words."""
    if verdict.judgement == "run":
        return "a result"
    if verdict.judgement == "decreasing":
        return "< 1"
    if verdict.judgement == "tolerance" or not math.isfinite(verdict.low):
        return f"<= {number(verdict.high)}"
    if not math.isfinite(verdict.high):
        return f">= {number(verdict.low)}"
    return f"{number(verdict.low)} to {number(verdict.high)}"


def number(value: float) -> str:
    """A number for a table; a dash where there is none."""
    return "-" if math.isnan(value) else f"{value:.4g}"
