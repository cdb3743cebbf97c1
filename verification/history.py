"""One number out of a quantity's course over time: its extremes, means and frequency.

A course is the value at the start and after every accepted step. Times need not be equally spaced.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np

from femdeform.types import FloatArray

_CALL = re.compile(r"([A-Za-z_]\w*)\(\s*([A-Za-z][A-Za-z0-9_-]*)\s*\)")


class HistoryError(ValueError):
    """A course does not have what is asked for; the message says what is missing."""


def split_quantity(name: str) -> tuple[str, str]:
    """Function and measured name of ``max(tip)``; a plain name is its value at the end.

    Raises
    ------
    ValueError
        If there is no such function.
    """
    match = _CALL.fullmatch(name.strip())
    if match is None:
        return "final", name
    if match[1] not in FUNCTIONS:
        from femdeform.scene.wording import did_you_mean

        raise ValueError(f"there is no function `{match[1]}` of a history; {did_you_mean(match[1], FUNCTIONS)}")
    return match[1], match[2]


def reduce_history(
    function: str, times: FloatArray, values: FloatArray, window: tuple[float, float] | None = None
) -> float:
    """Apply one of `FUNCTIONS` to a course.

    Parameters
    ----------
    function : str
        Its name.
    times : (n,) float64
        Increasing [s].
    values : (n,) float64
        In the unit of the quantity.
    window : (float, float), optional
        Only what lies between these times, both included [s].

    Returns
    -------
    float
        In the unit of the quantity, or [s] or [Hz], see `FUNCTIONS`.

    Raises
    ------
    HistoryError
        If the course is too short, has too few crossings or is not finite.
    """
    if window is not None:
        slack = 1e-9 * max(abs(window[0]), abs(window[1]))  # the last step may end short of the end by rounding
        inside = (times >= window[0] - slack) & (times <= window[1] + slack)
        times, values = times[inside], values[inside]
    if times.size == 0:
        raise HistoryError("no step lies in the window")
    if not np.isfinite(values).all():
        raise HistoryError("not finite")
    return float(FUNCTIONS[function](times, values))


def _mean(times: FloatArray, values: FloatArray) -> float:
    """Average over time: the trapezoidal rule, which weighs steps by their length."""
    if times.size == 1:
        return float(values[0])
    return float(np.trapezoid(values, times) / (times[-1] - times[0]))


def _middle(_: FloatArray, values: FloatArray) -> float:
    return float(0.5 * (values.max() + values.min()))


def _amplitude(_: FloatArray, values: FloatArray) -> float:
    return float(0.5 * (values.max() - values.min()))


def _ratio(_: FloatArray, values: FloatArray) -> float:
    if values[0] == 0.0:
        raise HistoryError("the first value is zero, which nothing has a ratio to")
    return float(values[-1] / values[0])


def crossings(times: FloatArray, values: FloatArray, level: float) -> tuple[FloatArray, FloatArray]:
    """Times at which a course passes a level upward and downward, by linear interpolation between its steps [s]."""
    above = values >= level
    found = []
    for change in (~above[:-1] & above[1:], above[:-1] & ~above[1:]):
        k = np.flatnonzero(change)
        part = (level - values[k]) / (values[k + 1] - values[k])
        found.append(times[k] + part * (times[k + 1] - times[k]))
    return found[0], found[1]


def _frequency(times: FloatArray, values: FloatArray) -> float:
    """Periods over time between crossings of the mean.

    A period is the time between two crossings in the same direction: that does not depend on where exactly the level
    lies. Upward and downward crossings are counted apart and together give the number.
    """
    periods, duration = 0, 0.0
    for passed in crossings(times, values, _mean(times, values)):
        if passed.size > 1:
            periods += passed.size - 1
            duration += float(passed[-1] - passed[0])
    if periods == 0:
        raise HistoryError("no whole period: fewer than two crossings of the mean in one direction")
    return periods / duration


def _time_of_max(times: FloatArray, values: FloatArray) -> float:
    """Time of the largest value, by the parabola through it and its neighbours; at an end, the time of that end."""
    k = int(np.argmax(values))
    if k == 0 or k == values.size - 1:
        return float(times[k])
    t, y = times[k - 1 : k + 2] - times[k], values[k - 1 : k + 2]
    first, second = (y[1] - y[0]) / (t[1] - t[0]), (y[2] - y[1]) / (t[2] - t[1])
    curvature = (second - first) / (t[2] - t[0])
    if curvature == 0.0:
        return float(times[k])
    # Newton's form: slope at the middle point over twice the curvature.
    slope = first + curvature * (t[1] - t[0])
    return float(times[k] - slope / (2.0 * curvature))


FUNCTIONS: dict[str, Callable[[FloatArray, FloatArray], float]] = {
    "final": lambda _, values: float(values[-1]),
    "first": lambda _, values: float(values[0]),
    "max": lambda _, values: float(values.max()),
    "min": lambda _, values: float(values.min()),
    "mean": _mean,
    "middle": _middle,
    "amplitude": _amplitude,
    "ratio": _ratio,
    "frequency": _frequency,
    "time_of_max": _time_of_max,
    "time_of_min": lambda times, values: _time_of_max(times, -values),
}
