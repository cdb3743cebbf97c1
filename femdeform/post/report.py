"""The report of a run: one HTML page that needs nothing else, neither files nor network."""

from __future__ import annotations

import importlib
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

from femdeform.errors import FemdeformError, MissingDependencyError
from femdeform.post import plots
from femdeform.post.page import data_address, figure_image, guarded, html_page, resource, section
from femdeform.post.render import draw_frames, encode_picture
from femdeform.post.report_tables import (
    facts_table,
    numbers_table,
    settings_table,
    verdict_table,
    versions_table,
)
from femdeform.post.run_plots import Plot, plots_of
from femdeform.post.scene3d import interactive_data
from femdeform.run import atomic
from femdeform.run.result import Result

_STATUS_CLASSES = {"done": "good", "running": "open", "interrupted": "open"}


def write_report(result: Path, out: Path | None = None) -> Path:
    """Write the HTML report of a run.

    A part whose data are missing or corrupt (a run that failed early, a machine that cannot draw) says so in
    its place; the rest of the page is made all the same.

    Parameters
    ----------
    result : Path
        Result folder.
    out : Path, optional
        The page; default ``report.html`` in the result folder.

    Returns
    -------
    Path
        The page written.

    Raises
    ------
    InputError
        If the folder is not a result.
    OutputError
        If the page cannot be written.
    """
    opened = Result.open(result)
    path = out if out is not None else opened.folder / "report.html"
    atomic.make_folder(path.parent)
    atomic.write_text(path, _page(opened))
    return path


def _page(result: Result) -> str:
    facts = result.facts
    title = str(facts.get("title") or result.folder.resolve().name)
    status = str(facts["status"])
    reason = str(facts.get("reason") or "")
    view, script = _interactive_part(result)
    body = [
        f'<p class="reason">{escape(reason)}</p>' if reason else "",
        section("Pictures", guarded(lambda: _pictures(result))),
        view,
        '<div class="columns">',
        section("Run", facts_table(facts) + guarded(lambda: numbers_table(result.history))),
        section("Settings", guarded(lambda: settings_table(result.resolved)) + versions_table(facts)),
        "</div>",
        section("Expectations", verdict_table(facts.get("expect"))),
        '<div class="columns">',
        *(section(plot.title, guarded(partial(_history_plot, result, plot))) for plot in plots_of(result)),
        "</div>",
        _iterations_part(result),
        section("Scene", guarded(lambda: _scene_text(result.resolved_text))),
    ]
    return html_page(title, status, _STATUS_CLASSES.get(status, "bad"), body, script)


def _pictures(result: Result) -> str:
    n_frames = len(result.frames)
    if n_frames == 0:
        return '<p class="note">No frames were written.</p>'
    chosen = sorted({0, n_frames // 2, n_frames - 1})
    parts = []
    for index, picture in zip(chosen, draw_frames(result, chosen), strict=True):
        caption = f"frame {index}, t = {result.frames[index].time:.4g} s"
        parts.append(
            f'<figure><img alt="{caption}" src="{data_address("image/png", encode_picture(picture))}">'
            f"<figcaption>{caption}</figcaption></figure>"
        )
    return '<div class="pictures">' + "\n".join(parts) + "</div>"


def _interactive_part(result: Result) -> tuple[str, str]:
    """The section with the view, and the scripts for the end of the page."""
    try:
        # Smoke and particles have no surface to turn around.
        if result.simulation != "deformable" or not result.frames:
            return "", ""
        data = interactive_data(result)
        library = _plotly_source()
    except FemdeformError as error:
        note = f'<p class="note">{escape(str(error))}</p>'
        return section("Interactive view", note, identity="view3d-section"), ""
    content = (
        '<div id="view3d"></div>\n<div id="view3d-controls">'
        '<button id="view3d-play" type="button">Play</button>'
        '<input id="view3d-slider" type="range" min="0" step="1" aria-label="frame">'
        '<span id="view3d-time"></span></div>\n<noscript>The view needs JavaScript.</noscript>'
    )
    script = "\n".join(
        [
            f'<script type="application/json" id="view3d-data">{data}</script>',
            f"<script>{library}</script>",
            f"<script>\n{resource('viewer.js')}</script>",
        ]
    )
    return section("Interactive view", content, identity="view3d-section"), script


def _iterations_part(result: Result) -> str:
    def make() -> str:
        if result.iterations is None or not len(result.iterations.get("step", ())):
            return ""
        return _plot(plots.iterations_figure(result.iterations), "residual per iteration")

    return section("Convergence within steps", guarded(make))


def _history_plot(result: Result, plot: Plot) -> str:
    figure = plot.make(result.history)
    return "" if figure is None and not plot.always else _plot(figure, plot.title.lower())


def _plot(figure: Any | None, description: str) -> str:
    if figure is None:
        return '<p class="note">The run left no numbers to plot.</p>'
    return figure_image(figure, description)


def _scene_text(text: str) -> str:
    return f"<details><summary>resolved.yaml</summary><pre>{escape(text)}</pre></details>"


def _plotly_source() -> str:
    try:
        source = importlib.import_module("plotly.offline").get_plotlyjs()
    except ImportError as error:
        raise MissingDependencyError(f"the interactive view needs plotly ({error})") from error
    return str(source)
