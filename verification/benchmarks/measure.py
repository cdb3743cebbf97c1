"""How the benchmarks measure time and memory; standard library only, because the peers' scripts use it too."""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

REPETITIONS = 5


def summary(seconds: list[float]) -> dict[str, float]:
    """Return median, minimum, maximum and number of repeated measurements [s].

    Raises
    ------
    ValueError
        If there are none.
    """
    if not seconds:
        raise ValueError("a summary needs at least one measurement")
    return {
        "median": statistics.median(seconds),
        "min": min(seconds),
        "max": max(seconds),
        "n": len(seconds),
    }


def measure(
    work: Callable[[], object],
    repetitions: int = REPETITIONS,
    warm_up: int = 1,
    barrier: Callable[[], object] | None = None,
) -> dict[str, float]:
    """Time a function, again and again.

    Parameters
    ----------
    work : callable
        What to time; its answer is dropped.
    repetitions, warm_up : int
        Calls that count, and calls before them that do not.
    barrier : callable, optional
        Called before and after each piece of work; on several ranks it makes all of them wait for the slowest.

    Returns
    -------
    dict
        See `summary`.
    """
    for _ in range(warm_up):
        work()
    return summary([time_once(work, barrier) for _ in range(repetitions)])


def time_once(work: Callable[[], object], barrier: Callable[[], object] | None = None) -> float:
    """Return the seconds that one call takes; see `measure`."""
    if barrier is not None:
        barrier()
    start = time.perf_counter()
    work()
    if barrier is not None:
        barrier()
    return time.perf_counter() - start


def peak_memory() -> int:
    """Return the largest resident memory of this process so far [bytes]."""
    import resource

    # Linux hands the peak of the parent on to a child through getrusage; the line in /proc is the process's own.
    status = Path("/proc/self/status")
    if status.is_file():
        for line in status.read_text(encoding="ascii", errors="replace").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
