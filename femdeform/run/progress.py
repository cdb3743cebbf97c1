"""What a run says on the terminal: a progress bar on one, notices and the outcome everywhere."""

from __future__ import annotations

from typing import Any

from femdeform.run.terminal import Bar


class Progress(Bar):
    """Progress of a run through simulated time.

    Parameters
    ----------
    end : float
        End time [s].
    active : bool
        False on every rank but the first, and for ``--quiet``.
    """

    def __init__(self, end: float, active: bool) -> None:
        super().__init__(active, "{task.percentage:>3.0f}% {task.fields[numbers]}")
        self._end = end

    def _first_task(self, bar: Any) -> Any:
        return bar.add_task("step 0", total=self._end, numbers="")

    def advance(self, step: int, time: float, residual: float, iterations: int) -> None:
        """Show an accepted step: its number, relative residual and iterations."""
        numbers = f"residual {residual:.1e}, {iterations} iterations"
        self._update(completed=time, description=f"step {step}", numbers=numbers)
