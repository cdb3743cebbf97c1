"""What `femdeform verify` says while it computes: a bar on a terminal, a line for every run elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol

from femdeform.run.terminal import Bar


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


class OnScreen(Bar):
    """A bar over all runs on a terminal; elsewhere a line on standard error after each.

    Parameters
    ----------
    n_runs : int
        Runs of all cases, for the bar.
    """

    def __init__(self, n_runs: int) -> None:
        super().__init__(True, "{task.percentage:>3.0f}%")
        self._n_runs = n_runs
        self._done = 0
        self._place = ""

    def _first_task(self, bar: Any) -> Any:
        return bar.add_task("reading", total=self._n_runs)

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Take the bar away for as long as somebody else writes to the terminal."""
        if self._live is not None:
            self._live.stop()
        yield
        if self._live is not None:
            self._live.start()

    def study(self, case: str, study: str) -> None:
        """A study begins."""
        self._place = f"{case} {study}"

    @contextmanager
    def run(self, label: str) -> Iterator[Callable[[float], None]]:
        """Move the bar while a run goes on."""

        def advance(part: float) -> None:
            self._update(completed=self._done + min(part, 1.0))

        self._update(description=f"{self._place} {label}".strip())
        yield advance
        self._done += 1
        advance(0.0)

    def finished(self, label: str, text: str, failed: bool) -> None:
        """Say what came of a run; where the bar shows that it goes on, only if it failed."""
        if failed or self._live is None:
            self.notice(f"{self._place} {label}".rstrip() + f": {text}")
