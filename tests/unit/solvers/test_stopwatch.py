"""Seconds by phase."""

from __future__ import annotations

from solvers.stopwatch import Stopwatch


def test_laps_add_up_and_time_before_a_start_belongs_to_nobody() -> None:
    times = iter([0.0, 10.0, 12.0, 15.0, 100.0, 101.0])
    watch = Stopwatch(clock=lambda: next(times))
    watch.start()
    watch.lap("a")
    watch.lap("b")
    watch.start()
    watch.lap("a")
    assert watch.seconds == {"a": 3.0, "b": 3.0}
