"""Means, rates and times that a scene expects of its quantities over a stretch of time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.run.expectations import Columns, verdict
from femdeform.scene.point_quantity_schema import ExpectedOverTime
from femdeform.types import FloatArray


def over_time_verdicts(
    expected: Sequence[ExpectedOverTime], history: Columns | None, start: Mapping[str, float]
) -> list[dict[str, Any]]:
    """Verdicts of `over_time`; `start` holds the quantities at time 0.

    Raises
    ------
    ValueError
        If there is no history and something is expected.
    """
    verdicts = []
    for wanted in expected:
        if history is None:
            raise ValueError("these expectations need the history of the run")
        times = np.concatenate([[0.0], np.asarray(history["time"], dtype=float)])
        column: NDArray[Any] = history[f"measure.{wanted.quantity}"]
        values = np.concatenate([[start[wanted.quantity]], np.asarray(column, dtype=float)])
        verdicts.append(verdict(wanted.name, statistic(times, values, wanted), wanted))
    return verdicts


def statistic(times: FloatArray, values: FloatArray, wanted: ExpectedOverTime) -> float:
    """The number that is expected of a quantity.

    Parameters
    ----------
    times, values : (n,) float64
        The course of the quantity, with its start [s].
    wanted : ExpectedOverTime
        What of it.

    Returns
    -------
    float
        Not a number if the stretch has too few values, or one that is none.
    """
    end = times[-1] if wanted.before is None else wanted.before
    # Ends of stretches may be times of steps, which add up with rounding.
    slack = 1e-9 * max(times[-1], 1e-300)
    here = (times >= wanted.after - slack) & (times <= end + slack)
    t, v = times[here], values[here]
    if t.size < 2 or not np.isfinite(v).all():
        return float("nan")
    if wanted.statistic == "mean":
        return float(np.trapezoid(v, t) / (t[-1] - t[0]))
    if wanted.statistic == "largest_change":
        return float(np.abs(v - values[0]).max())
    if wanted.statistic == "peak_time":
        return _peak_time(t, v)
    if wanted.statistic == "decay_rate":
        apart = v - wanted.toward
        if not (apart > 0.0).all() and not (apart < 0.0).all():
            return float("nan")
        return float(-np.polyfit(t, np.log(np.abs(apart)), 1)[0])
    assert wanted.level is not None
    return _time_below(t, v - wanted.level)


def _peak_time(t: FloatArray, v: FloatArray) -> float:
    """Time of the largest value, of the parabola through it and its neighbours."""
    k = int(np.argmax(v))
    if k in (0, t.size - 1):
        return float(t[k])
    # The slope is zero where the slopes of the two chords, at their middles, say so.
    chords = np.diff(v[k - 1 : k + 2]) / np.diff(t[k - 1 : k + 2])
    middles = 0.5 * (t[k - 1 : k + 1] + t[k : k + 2])
    if chords[0] == chords[1]:
        return float(t[k])
    return float(middles[0] + chords[0] / (chords[0] - chords[1]) * (middles[1] - middles[0]))


def _time_below(t: FloatArray, v: FloatArray) -> float:
    """How long a piecewise linear function is negative."""
    low, high = np.minimum(v[:-1], v[1:]), np.maximum(v[:-1], v[1:])
    part = np.where(high < 0.0, 1.0, 0.0)
    crosses = (low < 0.0) & (high >= 0.0)
    part[crosses] = -low[crosses] / (high[crosses] - low[crosses])
    return float(part @ np.diff(t))
