"""What a batch says while it works: a bar on a terminal, a line for each run elsewhere."""

from __future__ import annotations

import time
from typing import Any

from femdeform.run.terminal import Bar

# Judging scenes is quick; only where it takes longer than this is it worth a word.
_PATIENCE = 2.0


class BatchProgress(Bar):
    """Progress of a batch through its runs.

    Parameters
    ----------
    active : bool
        False for ``--quiet``: nothing is said.
    """

    def __init__(self, active: bool) -> None:
        super().__init__(active, "{task.completed:.0f} of {task.total:.0f}{task.fields[failures]}")
        self._done = 0
        self._failed = 0
        self._begin = time.monotonic()

    def _first_task(self, bar: Any) -> Any:
        return bar.add_task("checking", total=None, completed=0, failures="", visible=False)

    def checked(self, done: int, total: int) -> None:
        """Say how many scenes have been checked."""
        if time.monotonic() > self._begin + _PATIENCE:
            self._update(completed=done, total=total, visible=True)

    def start(self, done: int, total: int) -> None:
        """Say how many runs there are, and how many of them need nothing any more."""
        self._done = done
        if self._live is not None:
            self._live.reset(self._task, description="runs", completed=done, total=total, visible=True, failures="")

    def ended(self, text: str, failed: bool) -> None:
        """Say how a run ended."""
        self._done += 1
        self._failed += failed
        failures = f", {self._failed} failed" if self._failed else ""
        self._update(completed=self._done, failures=failures)
        if failed or self._live is None:
            self.notice(text)
