"""Where the time of a loop goes, by phase."""

from __future__ import annotations

import time
from collections.abc import Callable


class Stopwatch:
    """Adds up seconds by phase: each lap counts from the end of the one before.

    Parameters
    ----------
    clock : callable
        Gives a time that only grows [s].

    Attributes
    ----------
    seconds : dict of str to float
        By phase, since the object was made [s].
    """

    def __init__(self, clock: Callable[[], float] = time.perf_counter) -> None:
        self.seconds: dict[str, float] = {}
        self._clock = clock
        self._begin = clock()

    def start(self) -> None:
        """Begin a lap; the time since the last one belongs to no phase."""
        self._begin = self._clock()

    def lap(self, phase: str) -> None:
        """End a lap: its seconds belong to that phase. The next one begins."""
        now = self._clock()
        self.seconds[phase] = self.seconds.get(phase, 0.0) + now - self._begin
        self._begin = now
