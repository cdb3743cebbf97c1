"""The page of a study: a row for each run with its picture, its keys and its numbers, and plots over the keys."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from femdeform.post.backend import load_pyvista
from femdeform.post.batch_plots import study_figure
from femdeform.post.page import data_address, figure_image, guarded, html_page, resource, section
from femdeform.post.render import encode_picture
from femdeform.post.report_tables import verdict_table
from femdeform.post.stage import Stage
from femdeform.post.survey import survey
from femdeform.run import atomic
from femdeform.run.batch_expectations import allowed
from femdeform.run.batch_index import Row, StudyTable
from femdeform.run.batch_plan import shown_value
from femdeform.run.result import Result

PAGE = "index.html"
# Drawn twice as large and averaged: thin lines stay lines.
_SIZE = (640, 400)
_SHRINK = 2
# Pictures are part of the page; beyond this number they would make it too heavy, and the rest are links.
_MAX_PICTURES = 400
_NOTE = (
    '<p class="note">Pictures show the last frame, coloured by the displacement, each with a range of its own. '
    "A click on a heading sorts the runs.</p>"
)
_CLASSES = {"done": "good", "waiting": "open", "running": "open", "interrupted": "open"}


class BatchPage:
    """Pictures and page of a batch; see `femdeform.run.batch.Page`."""

    def draw(self, result: Path, picture: Path) -> None:
        """Write a small picture of the last frame of a result.

        Parameters
        ----------
        result : Path
            Result folder.
        picture : Path
            PNG file, 320 pixels wide.

        Raises
        ------
        InputError
            If the result has no frames, or they cannot be read.
        MissingDependencyError
            If nothing can be drawn on this machine.
        OutputError
            If the file cannot be written.
        """
        opened = Result.open(result)
        last = max(0, len(opened.frames) - 1)
        pyvista = load_pyvista()
        setting = survey(opened, [last], None)
        with closing(Stage(pyvista, opened, setting, None, size=_SIZE, bare=True)) as stage:
            stage.show(last)
            large = stage.picture()
        blocks = large.reshape(_SIZE[1] // _SHRINK, _SHRINK, _SIZE[0] // _SHRINK, _SHRINK, 3)
        small = np.rint(blocks.mean(axis=(1, 3))).astype(np.uint8)
        atomic.write_bytes(picture, encode_picture(small))

    def write(self, table: StudyTable) -> Path:
        """Write ``index.html`` into the folder of a batch; it needs no other file to be read.

        Parameters
        ----------
        table : StudyTable
            The study as it stands.

        Returns
        -------
        Path
            The page.

        Raises
        ------
        OutputError
            If it cannot be written.
        """
        path = table.out / PAGE
        atomic.write_text(path, page_text(table))
        return path


def page_text(table: StudyTable) -> str:
    """The page of a study as HTML."""
    counts = Counter(row.ending.status for row in table.rows)
    n_over = sum(row.ending.is_finished or row.ending.is_failure for row in table.rows)
    is_over = n_over == len(table.rows)
    n_done = counts["done"]
    if not is_over:
        status, kind = f"{n_over} of {len(table.rows)} runs are over", "open"
    elif n_done == len(table.rows):
        status, kind = f"{n_done} runs, all done", "good"
    else:
        status, kind = f"{n_done} of {len(table.rows)} runs done", "bad"
    n_failed = sum(found["passed"] is False for found in table.verdicts)
    if n_failed:
        status, kind = f"{status}, {n_failed} of {len(table.verdicts)} expectations failed", "bad"
    badges = [
        f'<span class="badge {_class(word)}">{count} {escape(word.replace("_", " "))}</span>'
        for word, count in counts.most_common()
    ]
    body = [
        f"<style>\n{resource('batch_page.css')}</style>",
        f'<div class="counts">{"".join(badges)}</div>' if len(counts) > 1 else "",
        section("Expected of all runs together", _verdicts(table)),
        section("Plots", guarded(lambda: _plots(table))),
        section("Runs", f'{_NOTE}<div class="scroll">{_table(table)}</div>'),
    ]
    return html_page(table.title, status, kind, body, f"<script>\n{resource('batch_page.js')}</script>")


def _plots(table: StudyTable) -> str:
    figure = study_figure(table)
    return "" if figure is None else figure_image(figure, "numbers of the runs over the varied keys")


def _verdicts(table: StudyTable) -> str:
    return verdict_table(
        [
            {
                "quantity": found["quantity"],
                "computed": found["computed"],
                "allowed": allowed(found),
                "passed": found["passed"],
            }
            for found in table.verdicts
        ]
    )


def _class(status: str) -> str:
    return _CLASSES.get(status, "bad")


def _table(table: StudyTable) -> str:
    names = table.short_keys
    number_keys = {key for key in table.keys if all(_is_number(v) for v in table.column(key) if v is not None)}
    head = [
        "<th>run</th>",
        '<th class="plain">picture</th>',
        *(
            f'<th class="key{_number_class(key in number_keys)}" title="{escape(key)}">{escape(names[key])}</th>'
            for key in table.keys
        ),
        "<th>status</th>",
        '<th class="number" title="wall time of the run\'s processes">seconds</th>',
        *(f'<th class="number">{escape(name)}</th>' for name in table.scalars),
        '<th class="plain">files</th>',
    ]
    with_picture = [row.name for row in table.rows if row.files.picture.exists()][:_MAX_PICTURES]
    rows = [_row(row, table, number_keys, row.name in with_picture) for row in table.rows]
    return (
        f'<table class="runs">\n<thead><tr>{"".join(head)}</tr></thead>\n<tbody>\n'
        + "\n".join(rows)
        + "\n</tbody></table>"
    )


def _number_class(is_number: bool) -> str:
    return " number" if is_number else " text"


def _row(row: Row, table: StudyTable, number_keys: set[str], show_picture: bool) -> str:
    cells = [f'<td data-value="{row.number}">{row.number}</td>', f"<td>{_picture(row, show_picture)}</td>"]
    for key in table.keys:
        if key not in row.values:
            cells.append("<td></td>")
        elif key in number_keys:
            cells.append(_number_cell(row.values[key]))
        else:
            cells.append(f'<td class="text">{escape(shown_value(row.values[key]))}</td>')
    ending = row.ending
    reason = f"<small>{escape(ending.reason)}</small>" if ending.reason else ""
    status = escape(ending.status.replace("_", " "))
    cells.append(f'<td><span class="badge {_class(ending.status)}">{status}</span>{reason}</td>')
    cells.append("<td></td>" if ending.seconds is None else _number_cell(ending.seconds, ".1f"))
    for name in table.scalars:
        value = row.scalars.get(name)
        cells.append("<td></td>" if value is None else _number_cell(value))
    cells.append(f"<td>{_links(row)}</td>")
    return f"<tr>{''.join(cells)}</tr>"


def _number_cell(value: Any, form: str = ".6g") -> str:
    text = str(value) if isinstance(value, int) else format(value, form)
    return f'<td class="number" data-value="{value!r}">{escape(text)}</td>'


def _picture(row: Row, show: bool) -> str:
    path = row.files.picture
    if not show:
        return f'<a href="{_address(path, row)}">picture</a>' if path.exists() else ""
    try:
        data = path.read_bytes()
    except OSError:
        return ""
    return f'<img alt="last frame of run {row.number}" src="{data_address("image/png", data)}">'


def _links(row: Row) -> str:
    """Links to what there is of a run; they work as long as the page stays in its folder."""
    files: Sequence[tuple[str, Path]] = [
        ("folder", row.files.folder),
        ("report", row.files.folder / "report.html"),
        ("log", row.files.log),
    ]
    return " ".join(f'<a href="{_address(path, row)}">{word}</a>' for word, path in files if path.exists())


def _address(path: Path, row: Row) -> str:
    """Address of a file of a run, from the page on."""
    inside = path.relative_to(row.files.folder.parent).as_posix()
    return escape(f"runs/{inside}" + ("/" if path.is_dir() else ""))


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)
