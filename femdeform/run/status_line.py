"""What a computation without a fixed end says on a terminal: a line that changes, and notices above it."""

from __future__ import annotations

from typing import Any

from femdeform.run.terminal import Terminal


class StatusLine(Terminal):
    """A line on standard error that says what is going on; on a terminal only."""

    def _display(self, console: Any) -> Any:
        return console.status("")

    def show(self, text: str) -> None:
        """Say what is going on, in the place of what was said before."""
        if self._live is not None:
            from rich.text import Text

            self._live.update(Text(text))
