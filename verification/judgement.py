"""From computed values and references to errors, observed rates and verdicts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from verification.norms import observed_rates
from verification.study_schema import Band, Quantity


@dataclass(frozen=True)
class Row:
    """A quantity on a level; NaN where there is no number.

    Attributes
    ----------
    study, level : str
    size : float
        Element size, time step [s] or value of the parameter.
    n_dofs : int
    dt : float
        [s]
    quantity : str
    computed, reference, error : float
        In the unit of the quantity; the error is the distance of the two.
    rate : float
        Observed order between the level before and this one [-].
    seconds : float
        Wall time of the run [s].
    iterations : int
        Nonlinear iterations of the run.
    note : str
        What is odd about the run, or why there is no number.
    is_reference : bool
        The level is the one that others are compared with: it has no error of its own.
    """

    study: str
    level: str
    size: float
    n_dofs: int
    dt: float
    quantity: str
    computed: float
    reference: float
    error: float
    rate: float
    seconds: float
    iterations: int
    note: str = ""
    is_reference: bool = False


@dataclass(frozen=True)
class Verdict:
    """One judgement.

    Attributes
    ----------
    study, quantity : str
    level : str
        Which level was judged; empty for a judgement of several.
    judgement : str
        ``rate``, ``tolerance``, ``value``, ``decreasing`` or, where there was nothing to judge, ``run``.
    computed, low, high : float
        What was judged and its band; infinite where it has no end.
    passed : bool
    reason : str
        Why it failed, in words; empty if it passed.
    """

    study: str
    quantity: str
    level: str
    judgement: str
    computed: float
    low: float
    high: float
    passed: bool
    reason: str = ""


def rates_of(sizes: Sequence[float], errors: Sequence[float]) -> list[float]:
    """Observed order at each level, from the one before to it; NaN at the first and where an error is not positive."""
    rates = [math.nan]
    for (h0, h1), (e0, e1) in zip(pairwise(sizes), pairwise(errors), strict=True):
        defined = e0 > 0.0 and e1 > 0.0 and math.isfinite(e0 + e1) and h0 > h1 > 0.0
        rates.append(observed_rates([h0, h1], [e0, e1])[0] if defined else math.nan)
    return rates[: len(sizes)]


def judge(rows: Sequence[Row], spec: Quantity, band: Band, each_level: bool) -> list[Verdict]:
    """Verdicts on one quantity of a study.

    Parameters
    ----------
    rows : sequence of Row
        Of this quantity, the coarsest level first; at least one.
    spec : Quantity
        Its scale.
    band : Band
        What is asked for.
    each_level : bool
        Tolerances and bounds hold on every level, not on the finest only.

    Returns
    -------
    list of Verdict
        One for each thing asked for, and for each level where every level is judged.
    """
    verdicts = []
    if band.rate is not None:
        verdicts.append(_judge_rate(rows, band.rate))
    if band.decreasing:
        verdicts.append(_judge_decrease(rows))
    with_error = [row for row in rows if not math.isnan(row.error)]
    with_error = with_error or [row for row in rows if row.note] or list(rows)
    if band.rtol is not None or band.atol is not None:
        compared = [row for row in rows if not row.is_reference] or rows
        verdicts += [_judge_error(row, spec, band) for row in (compared if each_level else with_error[-1:])]
    low, high = _bounds(band)
    if math.isfinite(low) or math.isfinite(high):
        for row in rows if each_level else rows[-1:]:
            passed = low <= row.computed <= high
            verdicts.append(
                _verdict(
                    row,
                    "value",
                    row.computed,
                    low,
                    high,
                    passed,
                    f"is {_text(row.computed)}, not {_text_of(low, high)}",
                )
            )
    return verdicts


def _judge_rate(rows: Sequence[Row], band: tuple[float, float]) -> Verdict:
    known = [row for row in rows if not math.isnan(row.rate)]
    last = known[-1] if known else rows[-1]
    passed = band[0] <= last.rate <= band[1]
    reason = (
        f"the rate is {last.rate:.3f}, not {band[0]:g} to {band[1]:g}"
        if known
        else "no rate: an error is zero or not a number"
    )
    return _verdict(last, "rate", last.rate, *band, passed, reason)


def _judge_decrease(rows: Sequence[Row]) -> Verdict:
    errors = [row.error for row in rows if not math.isnan(row.error)]
    ratios = [fine / coarse if coarse > 0.0 else math.inf for coarse, fine in pairwise(errors)]
    worst = max(ratios, default=math.nan)
    reason = f"an error is {_text(worst)} times the one of the level before"
    return _verdict(rows[-1], "decreasing", worst, 0.0, 1.0, worst < 1.0, reason, level="")


def _judge_error(row: Row, spec: Quantity, band: Band) -> Verdict:
    allowed = band.atol or 0.0
    if band.rtol:
        scale = spec.scale if spec.scale is not None else abs(row.reference)
        allowed += band.rtol * scale
    passed = row.error <= allowed
    reason = f"off by {_text(row.error)}, allowed {_text(allowed)}"
    return _verdict(row, "tolerance", row.error, 0.0, allowed, passed, reason)


def _bounds(band: Band) -> tuple[float, float]:
    low, high = band.between if band.between is not None else (-math.inf, math.inf)
    return max(low, -math.inf if band.at_least is None else band.at_least), min(
        high, math.inf if band.at_most is None else band.at_most
    )


def _verdict(
    row: Row,
    judgement: str,
    computed: float,
    low: float,
    high: float,
    passed: bool,
    reason: str,
    level: str | None = None,
) -> Verdict:
    place = row.level if level is None else level
    why = "" if passed else (row.note if math.isnan(computed) and row.note else reason)
    return Verdict(row.study, row.quantity, place, judgement, computed, low, high, bool(passed), why)


def _text_of(low: float, high: float) -> str:
    if math.isfinite(low) and math.isfinite(high):
        return f"{low:.4g} to {high:.4g}"
    return f"at least {low:.4g}" if math.isfinite(low) else f"at most {high:.4g}"


def _text(value: float) -> str:
    return "not a number" if math.isnan(value) else f"{value:.4g}"
