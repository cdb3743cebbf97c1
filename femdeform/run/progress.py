"""What a run says on the terminal: a progress bar on one, notices and the outcome everywhere."""

from __future__ import annotations

import sys
from typing import Any


class Progress:
    """Progress of a run through simulated time.

    Parameters
    ----------
    end : float
        End time [s].
    active : bool
        False on every rank but the first, and for ``--quiet``.
    """

    def __init__(self, end: float, active: bool) -> None:
        self._active = active
        self._end = end
        self._bar: Any = None
        self._task: Any = None

    def __enter__(self) -> Progress:
        if self._active and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
            from rich.progress import Progress as Bar

            self._bar = Bar(
                TextColumn("{task.description}"),
                BarColumn(bar_width=24),
                TextColumn("{task.percentage:>3.0f}% {task.fields[numbers]}"),
                TimeElapsedColumn(),
                TextColumn("left"),
                TimeRemainingColumn(),
                console=Console(stderr=True),
            )
            self._bar.start()
            self._task = self._bar.add_task("step 0", total=self._end, numbers="")
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def advance(self, step: int, time: float, residual: float, iterations: int) -> None:
        """Show an accepted step: its number, relative residual and iterations."""
        if self._bar is not None:
            numbers = f"residual {residual:.1e}, {iterations} iterations"
            self._bar.update(self._task, completed=time, description=f"step {step}", numbers=numbers)

    def notice(self, text: str) -> None:
        """Tell the user something worth knowing; on standard error."""
        if not self._active:
            return
        if self._bar is not None:
            self._bar.console.print(text, highlight=False, markup=False, soft_wrap=True)
        else:
            print(text, file=sys.stderr, flush=True)
