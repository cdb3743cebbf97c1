"""Tables of results, for the screen and as Markdown."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from verification.benchmarks.child_process import Outcome


@dataclass(frozen=True)
class Cell:
    """One entry: short on the screen, with more detail in Markdown."""

    short: str
    long: str


@dataclass
class Table:
    """A table of results.

    Attributes
    ----------
    title : str
    columns : sequence of str
    rows : list of list of str or Cell
        The first column names what the row is about.
    notes : list of str
        Sentences below the table.
    """

    title: str
    columns: Sequence[str]
    rows: list[list[str | Cell]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def to_markdown(self) -> str:
        """Return the table in Markdown, with the long form of its cells."""
        lines = [f"### {self.title}", ""]
        lines.append(_markdown_row(self.columns))
        lines.append("|" + "|".join(["---"] + ["---:"] * (len(self.columns) - 1)) + "|")
        lines += [_markdown_row(row) for row in self.rows]
        for note in self.notes:
            lines += ["", note]
        return "\n".join(lines) + "\n"

    def to_rich(self) -> Any:
        """Return the table for `rich`, with the short form of its cells."""
        from rich.markup import escape
        from rich.table import Table as RichTable

        caption = "\n".join(self.notes)
        table = RichTable(title=escape(self.title), title_justify="left", caption=escape(caption) or None)
        table.caption_justify = "left"
        for number, column in enumerate(self.columns):
            table.add_column(escape(column), justify="left" if number == 0 else "right")
        for row in self.rows:
            table.add_row(*(escape(entry.short if isinstance(entry, Cell) else entry) for entry in row))
        return table


@dataclass
class Findings:
    """What a benchmark found.

    Attributes
    ----------
    summary : str
        One paragraph: what was measured.
    tables : list of Table
    data : dict
        Everything measured, for JSON.
    failures : list of str
        Cases of femdeform's own that broke; other codes that are absent or broken are notes of the tables.
    draw : callable
        Draws pictures, files beside the tables by name; called when all cases are done.
    """

    summary: str
    tables: list[Table] = field(default_factory=list)
    data: dict[str, Any] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)
    draw: Callable[[], dict[str, bytes]] = dict


def _markdown_row(entries: Sequence[str | Cell]) -> str:
    texts = [entry.long if isinstance(entry, Cell) else entry for entry in entries]
    return "| " + " | ".join(text.replace("|", "\\|") for text in texts) + " |"


def add_reasons(table: Table, outcomes: Mapping[str, Outcome]) -> None:
    """Say below a table why cases are not in it; the same reason once."""
    by_reason: dict[str, list[str]] = {}
    for name, outcome in outcomes.items():
        if not outcome.done:
            by_reason.setdefault(f"{outcome.status}: {outcome.reason}", []).append(name)
    table.notes += [f"{', '.join(names)} {reason}." for reason, names in by_reason.items()]


def seconds(value: dict[str, float] | float | None) -> str | Cell:
    """A time or a summary of times (see `measure.summary`) in ms or s; a dash where there is none."""
    if value is None:
        return "-"
    if isinstance(value, dict):
        short = _duration(value["median"])
        return Cell(short, f"{short} [{_duration(value['min'])}, {_duration(value['max'])}]")
    return _duration(value)


def _duration(value: float) -> str:
    return f"{1e3 * value:.3g} ms" if value < 0.9995 else f"{value:.3g} s"


def ratio(theirs: dict[str, float] | None, ours: dict[str, float] | None) -> str:
    """How many times longer they take than we do, by the medians."""
    if theirs is None or ours is None:
        return "-"
    return f"{theirs['median'] / ours['median']:.1f} x"


def threads_text(count: int) -> str:
    """A number of threads in words."""
    return "1 thread" if count == 1 else f"{count} threads"


def megabytes(size: int | None) -> str:
    """A size in bytes as MB."""
    return "-" if size is None else f"{size / 1e6:.0f} MB"
