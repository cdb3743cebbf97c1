"""What a long computation says on standard error: something that moves on a terminal, and lines that stay."""

from __future__ import annotations

import sys
from typing import Any, Self


class Terminal:
    """Base of every progress display; a context in which the display is alive.

    Parameters
    ----------
    active : bool
        False where nothing is to be said: for ``--quiet``, and on every rank but the first.
    """

    def __init__(self, active: bool) -> None:
        self._active = active
        # What moves on the terminal, from `_display`; None where there is no terminal.
        self._live: Any = None

    def __enter__(self) -> Self:
        if self._active and sys.stderr.isatty():
            from rich.console import Console

            self._live = self._display(Console(stderr=True))
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._live is not None:
            self._live.stop()
            self._live = None

    def notice(self, text: str) -> None:
        """Tell the user something worth knowing: a line that stays."""
        if not self._active:
            return
        if self._live is not None:
            self._live.console.print(text, highlight=False, markup=False, soft_wrap=True)
        else:
            print(text, file=sys.stderr, flush=True)

    def _display(self, console: Any) -> Any:
        """Make what moves, not yet started."""
        raise NotImplementedError


class Bar(Terminal):
    """A progress bar of one task, with the time it took and the time it may still take.

    Parameters
    ----------
    active : bool
        As in `Terminal`.
    numbers : str
        What stands beside the bar, in the fields of rich's task.
    """

    def __init__(self, active: bool, numbers: str) -> None:
        super().__init__(active)
        self._numbers = numbers
        self._task: Any = None

    def _display(self, console: Any) -> Any:
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

        bar = Progress(
            # Names come from the user: they are no markup.
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=24),
            TextColumn(self._numbers, markup=False),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=console,
            # What goes to standard output may go to a file: it is not for the bar's console.
            redirect_stdout=False,
            transient=True,
        )
        self._task = self._first_task(bar)
        return bar

    def _first_task(self, bar: Any) -> Any:
        """Add the task that the bar shows."""
        raise NotImplementedError

    def _update(self, **changes: Any) -> None:
        """Change the task, where there is a bar."""
        if self._live is not None:
            self._live.update(self._task, **changes)
