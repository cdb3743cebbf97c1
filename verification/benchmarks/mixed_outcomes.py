"""What the tables of the mixed benchmark share."""

from __future__ import annotations

from typing import Any

from verification.benchmarks.child_process import Outcome
from verification.benchmarks.mixed import Results


def variants_of(outcome: Outcome | None) -> dict[str, dict[str, Any]]:
    """Results of a case by variant; empty unless it is done."""
    return {} if outcome is None or not outcome.done else outcome.data["variants"]


def quoted(value: float) -> dict[str, float]:
    """A published time [s] in the form of a summary."""
    return {"median": value, "min": value, "max": value}


def reference_of(results: Results, body: str, k: int) -> dict[str, float] | None:
    """Quoted time of an iteration of Newton's (k = 0) or of the mixed method (1)."""
    times = results.references.get(body)
    return None if times is None else quoted(times[k])
