"""What a batch says while it works: a bar on a terminal, a line for each run elsewhere."""

from __future__ import annotations

import sys
import time
from typing import Any

# Judging scenes is quick; only where it takes longer than this is it worth a word.
_PATIENCE = 2.0


class BatchProgress:
    """Progress of a batch through its runs, on standard error.

    Parameters
    ----------
    active : bool
        False for ``--quiet``: nothing is said.
    """

    def __init__(self, active: bool) -> None:
        self._active = active
        self._bar: Any = None
        self._task: Any = None
        self._done = 0
        self._failed = 0
        self._begin = time.monotonic()

    def __enter__(self) -> BatchProgress:
        if self._active and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

            self._bar = Progress(
                TextColumn("{task.description}"),
                BarColumn(bar_width=24),
                TextColumn("{task.completed:.0f} of {task.total:.0f}{task.fields[failures]}"),
                TimeElapsedColumn(),
                TextColumn("left"),
                TimeRemainingColumn(),
                console=Console(stderr=True),
                transient=True,
            )
            self._bar.start()
            self._task = self._bar.add_task("checking", total=None, completed=0, failures="", visible=False)
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def checked(self, done: int, total: int) -> None:
        """Say how many scenes have been checked."""
        if self._bar is not None and time.monotonic() > self._begin + _PATIENCE:
            self._bar.update(self._task, completed=done, total=total, visible=True)

    def start(self, done: int, total: int) -> None:
        """Say how many runs there are, and how many of them need nothing any more."""
        self._done = done
        if self._bar is not None:
            self._bar.reset(self._task, description="runs", completed=done, total=total, visible=True, failures="")

    def ended(self, text: str, failed: bool) -> None:
        """Say how a run ended."""
        self._done += 1
        self._failed += failed
        if self._bar is not None:
            failures = f", {self._failed} failed" if self._failed else ""
            self._bar.update(self._task, completed=self._done, failures=failures)
        if failed or self._bar is None:
            self.notice(text)

    def notice(self, text: str) -> None:
        """Tell the user something worth knowing."""
        if not self._active:
            return
        if self._bar is not None:
            self._bar.console.print(text, highlight=False, markup=False, soft_wrap=True)
        else:
            print(text, file=sys.stderr, flush=True)
