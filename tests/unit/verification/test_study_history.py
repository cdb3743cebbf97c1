"""Functions of a quantity's course over time."""

from __future__ import annotations

import numpy as np
import pytest

from verification.history import FUNCTIONS, HistoryError, reduce_history, split_quantity

TIMES = np.array([0.0, 1.0, 3.0, 4.0])
VALUES = np.array([2.0, 4.0, -1.0, 1.0])


@pytest.mark.parametrize(
    ("function", "value"),
    [
        ("final", 1.0),
        ("first", 2.0),
        ("max", 4.0),
        ("min", -1.0),
        ("mean", (3.0 + 3.0 + 0.0) / 4.0),  # trapezia of widths 1, 2 and 1
        ("middle", 1.5),
        ("amplitude", 2.5),
        ("ratio", 0.5),
    ],
)
def test_values(function: str, value: float) -> None:
    assert reduce_history(function, TIMES, VALUES) == pytest.approx(value)


def test_every_function_is_tested_or_a_time() -> None:
    assert {"frequency", "time_of_max", "time_of_min"} < set(FUNCTIONS)
    assert len(FUNCTIONS) == 11


def test_a_window_takes_its_ends_in() -> None:
    assert reduce_history("max", TIMES, VALUES, (1.0, 3.0)) == 4.0
    assert reduce_history("max", TIMES, VALUES, (1.5, 4.0)) == 1.0
    assert reduce_history("final", TIMES, VALUES, (0.0, 3.0 - 1e-12)) == -1.0, "a step that ends by rounding before it"
    with pytest.raises(HistoryError, match="no step"):
        reduce_history("max", TIMES, VALUES, (1.1, 1.2))


@pytest.mark.parametrize("offset", [0.0, 5.0])
@pytest.mark.parametrize("periods", [2.2, 5.75])
def test_frequency_of_a_swing(offset: float, periods: float) -> None:
    """Neither a mean besides zero nor a broken number of periods shifts it."""
    times = np.linspace(0.0, periods / 1.7, 2001)
    swing = offset + np.cos(2.0 * np.pi * 1.7 * times + 0.3)
    assert reduce_history("frequency", times, swing) == pytest.approx(1.7, rel=1e-4)


def test_frequency_is_that_of_the_interpolated_crossings() -> None:
    """A saw-tooth of ones: linear between its points, so that interpolation is exact."""
    times = np.arange(9.0)
    swing = np.array([1.0, -1.0] * 4 + [1.0])
    assert reduce_history("frequency", times, swing) == pytest.approx(0.5, rel=1e-12)


def test_frequency_of_less_than_a_period_is_refused() -> None:
    times = np.linspace(0.0, 1.0, 50)
    with pytest.raises(HistoryError, match="no whole period"):
        reduce_history("frequency", times, np.cos(np.pi * times))
    with pytest.raises(HistoryError, match="no whole period"):
        reduce_history("frequency", times, np.zeros(50))


def test_time_of_an_extreme_between_steps_that_are_not_equal() -> None:
    times = np.array([0.0, 0.3, 0.55, 0.7, 1.0])
    parabola = -3.0 * (times - 0.51) ** 2 + 7.0
    assert reduce_history("time_of_max", times, parabola) == pytest.approx(0.51, rel=1e-12)
    assert reduce_history("time_of_min", times, -parabola) == pytest.approx(0.51, rel=1e-12)
    assert reduce_history("time_of_max", times, times) == 1.0
    assert reduce_history("time_of_max", times, np.array([0.0, 1.0, 1.0, 1.0, 0.0])) == pytest.approx(0.425)


def test_what_is_not_finite_has_no_value() -> None:
    with pytest.raises(HistoryError, match="not finite"):
        reduce_history("final", TIMES, np.array([0.0, 1.0, np.nan, 1.0]))
    with pytest.raises(HistoryError, match="zero"):
        reduce_history("ratio", TIMES, VALUES - 2.0)


def test_names() -> None:
    assert split_quantity("tip") == ("final", "tip")
    assert split_quantity("max( tip )") == ("max", "tip")
    with pytest.raises(ValueError, match="did you mean `amplitude`"):
        split_quantity("amplitud(tip)")
