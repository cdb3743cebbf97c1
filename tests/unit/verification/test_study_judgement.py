"""Verdicts on rows of numbers, and the lines they become."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from verification.judgement import Row, judge, rates_of
from verification.study import CaseResult, StudyResult
from verification.study_schema import Band, Quantity
from verification.summary import case_lines

NAN = math.nan


def rows(
    computed: Sequence[float], reference: float = 1.0, study: str = "study", sizes: Sequence[float] = ()
) -> list[Row]:
    """Rows of levels of half the size each."""
    sizes = sizes or [0.5**k for k in range(len(computed))]
    errors = [abs(value - reference) for value in computed]
    rates = rates_of(sizes, errors)
    return [
        Row(study, f"{k + 1}", size, 10, 1.0, "tip", value, reference, error, rate, 0.1, 3)
        for k, (size, value, error, rate) in enumerate(zip(sizes, computed, errors, rates, strict=True))
    ]


def judged(values: Sequence[float], each_level: bool = False, **spec: Any) -> list[tuple[str, str, bool]]:
    quantity = Quantity(**spec)
    return [(v.judgement, v.level, v.passed) for v in judge(rows(values), quantity, quantity, each_level)]


def test_rates() -> None:
    rates = rates_of([1.0, 0.5, 0.25, 0.05], [4.0, 1.0, 0.5, 0.5e-1])
    assert math.isnan(rates[0])
    assert rates[1:] == pytest.approx([2.0, 1.0, math.log(10.0) / math.log(5.0)])


def test_a_rate_needs_positive_errors_and_falling_sizes() -> None:
    assert all(map(math.isnan, rates_of([1.0, 0.5, 0.25], [1.0, 0.0, NAN])))
    assert all(map(math.isnan, rates_of([NAN, NAN], [1.0, 0.5])))
    assert rates_of([], []) == []


def test_the_last_pair_is_judged() -> None:
    assert judged([3.0, 2.0, 1.25], rate=(1.9, 2.1)) == [("rate", "3", True)]
    assert judged([5.0, 2.0, 1.5], rate=(1.9, 2.1)) == [("rate", "3", False)]


def test_no_rate_is_a_failure() -> None:
    (verdict,) = judge(rows([1.0, 1.0]), Quantity(rate=(0.0, 9.0)), Band(rate=(0.0, 9.0)), False)
    assert not verdict.passed
    assert verdict.reason.startswith("no rate")


def test_tolerances_and_bounds_hold_on_the_finest_level_of_a_refinement_and_on_every_level_of_a_sweep() -> None:
    spec: dict[str, Any] = {"atol": 0.1, "at_most": 1.5}
    assert judged([3.0, 1.05], **spec) == [("tolerance", "2", True), ("value", "2", True)]
    assert judged([3.0, 1.05], each_level=True, **spec) == [
        ("tolerance", "1", False),
        ("tolerance", "2", True),
        ("value", "1", False),
        ("value", "2", True),
    ]


@pytest.mark.parametrize(
    ("spec", "passed"),
    [
        ({"between": [1.0, 2.0]}, True),
        ({"between": [1.3, 2.0]}, False),
        ({"at_least": 1.25}, True),
        ({"at_least": 1.26}, False),
        ({"at_most": 1.25}, True),
        ({"at_most": 1.24}, False),
        ({"rtol": 0.25}, True),
        ({"rtol": 0.24}, False),
        ({"rtol": 0.01, "scale": 25.0}, True),
        ({"rtol": 0.2, "atol": 0.05}, True),
        ({"rtol": 0.2, "atol": 0.049}, False),
    ],
)
def test_edges_of_bands(spec: dict[str, Any], passed: bool) -> None:
    assert judged([1.25], **spec)[0][2] is passed


def test_errors_that_do_not_fall() -> None:
    assert judged([2.0, 1.5, 1.4], decreasing=True) == [("decreasing", "", True)]
    assert judged([2.0, 1.4, 1.4], decreasing=True) == [("decreasing", "", False)]
    assert judged([1.0, 1.0], decreasing=True) == [("decreasing", "", False)]


def test_what_is_not_a_number_fails_whatever_is_asked() -> None:
    spec: dict[str, Any] = {"atol": 1e9, "between": [-1e9, 1e9], "rate": [-99.0, 99.0], "decreasing": True}
    assert {passed for *_, passed in judged([2.0, NAN], **{k: spec[k] for k in ("between", "rate")})} == {False}
    assert {passed for *_, passed in judged([NAN], **spec)} == {False}


def result(**studies: list[Row]) -> CaseResult:
    quantity = Quantity(atol=0.1, rate=(1.5, 2.5))
    made = [
        StudyResult(name, "mesh_refinement", "", "size", of, judge(of, quantity, quantity, False), 1.0)
        for name, of in ((name.replace("__", "/"), of) for name, of in studies.items())
    ]
    return CaseResult("case", "Title", "", Path(), False, made, 2.0)


def test_variations_share_a_line_that_shows_the_worst() -> None:
    good = rows([2.0, 1.2, 1.05], study="p1/good")
    close = rows([2.0, 1.2, 1.04], study="p1/close")
    bad = rows([2.0, 1.5, 1.45], study="p1/bad")
    lines = case_lines(result(p1__good=good, p1__close=close))
    assert [line.cells() for line in lines] == [
        ("p1", "tip", "rate 2.32 2.32, error 0.04", "1.5 to 2.5", "all 2 ok", "close, 3"),
        ("p1", "tip", "error 0.05", "<= 0.1", "all 2 ok", "good, 3"),
    ]
    lines = case_lines(result(p1__good=good, p1__bad=bad))
    assert [line.verdict for line in lines] == ["1 of 2 FAILED", "1 of 2 FAILED"]
    assert (lines[0].found, lines[0].place) == ("rate 1.00 0.15, error 0.45", "bad, 3")
    assert lines[0].reasons == ["p1/bad, tip, 3: the rate is 0.152, not 1.5 to 2.5"]
    apart = case_lines(result(p1__good=good, p1__bad=bad), apart=True)
    assert [(line.study, line.verdict) for line in apart][:2] == [("p1/good", "ok"), ("p1/good", "ok")]
