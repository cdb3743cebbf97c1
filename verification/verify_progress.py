"""What `femdeform verify` says while it computes: a bar on a terminal, a line for every run elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol


class VerifyProgress(Protocol):
    """What a case tells while it runs."""

    def notice(self, text: str) -> None:
        """Say something that stays."""

    def study(self, case: str, study: str) -> None:
        """A study begins."""

    def run(self, label: str) -> Any:
        """Context of a run; gives a function that is told the part of it that is done, from 0 to 1."""

    def finished(self, label: str, text: str, failed: bool) -> None:
        """A run is over: what came of it."""


class Silent:
    """Says nothing."""

    def notice(self, text: str) -> None:
        """Say nothing."""

    def study(self, case: str, study: str) -> None:
        """Say nothing."""

    @contextmanager
    def run(self, label: str) -> Iterator[Callable[[float], None]]:
        """Say nothing."""
        yield lambda _: None

    def finished(self, label: str, text: str, failed: bool) -> None:
        """Say nothing."""


class OnScreen:
    """A bar over all runs on a terminal; elsewhere a line on standard error after each.

    Parameters
    ----------
    n_runs : int
        Runs of all cases, for the bar.
    """

    def __init__(self, n_runs: int) -> None:
        self._n_runs = n_runs
        self._done = 0
        self._bar: Any = None
        self._task: Any = None
        self._place = ""
        self._begin = time.perf_counter()

    def __enter__(self) -> OnScreen:
        if sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

            self._bar = Progress(
                TextColumn("{task.description}", markup=False),
                BarColumn(bar_width=24),
                TextColumn("{task.percentage:>3.0f}%"),
                TimeElapsedColumn(),
                TextColumn("left"),
                TimeRemainingColumn(),
                console=Console(stderr=True),
                # What goes to standard output may go to a file: it is not for the bar's console.
                redirect_stdout=False,
            )
            self._bar.start()
            self._task = self._bar.add_task("reading", total=self._n_runs)
        return self

    def __exit__(self, *_: object) -> None:
        if self._bar is not None:
            self._bar.stop()
            self._bar = None

    def notice(self, text: str) -> None:
        """Say something that stays."""
        if self._bar is not None:
            self._bar.console.print(text, highlight=False, markup=False, soft_wrap=True)
        else:
            print(text, file=sys.stderr, flush=True)

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Take the bar away for as long as somebody else writes to the terminal."""
        if self._bar is not None:
            self._bar.stop()
        yield
        if self._bar is not None:
            self._bar.start()

    def study(self, case: str, study: str) -> None:
        """A study begins."""
        self._place = f"{case} {study}"

    @contextmanager
    def run(self, label: str) -> Iterator[Callable[[float], None]]:
        """Move the bar while a run goes on."""

        def advance(part: float) -> None:
            if self._bar is not None:
                self._bar.update(self._task, completed=self._done + min(part, 1.0))

        if self._bar is not None:
            self._bar.update(self._task, description=f"{self._place} {label}".strip())
        yield advance
        self._done += 1
        advance(0.0)

    def finished(self, label: str, text: str, failed: bool) -> None:
        """Say what came of a run; where the bar shows that it goes on, only if it failed."""
        if failed or self._bar is None:
            self.notice(f"{self._place} {label}".rstrip() + f": {text}")
