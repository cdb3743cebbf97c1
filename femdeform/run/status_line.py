"""What a computation without a fixed end says on a terminal: a line that changes, and notices above it."""

from __future__ import annotations

import sys
from typing import Any


class StatusLine:
    """A line on standard error that says what is going on; on a terminal only.

    Parameters
    ----------
    active : bool
        False for ``--quiet``: nothing is said.
    """

    def __init__(self, active: bool) -> None:
        self._active = active
        self._status: Any = None

    def __enter__(self) -> StatusLine:
        if self._active and sys.stderr.isatty():
            from rich.console import Console

            self._status = Console(stderr=True).status("")
            self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._status is not None:
            self._status.stop()
            self._status = None

    def show(self, text: str) -> None:
        """Say what is going on, in the place of what was said before."""
        if self._status is not None:
            from rich.text import Text

            self._status.update(Text(text))

    def notice(self, text: str) -> None:
        """Say something that stays."""
        if not self._active:
            return
        if self._status is not None:
            self._status.console.print(text, highlight=False, markup=False, soft_wrap=True)
        else:
            print(text, file=sys.stderr, flush=True)
