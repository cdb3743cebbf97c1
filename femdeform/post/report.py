"""The report of a run: one HTML page that needs nothing else, neither files nor network."""

from __future__ import annotations

import base64
import importlib
from collections.abc import Callable
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any

from femdeform.errors import FemdeformError, MissingDependencyError
from femdeform.post import plots
from femdeform.post.render import draw_frames, encode_picture
from femdeform.post.report_tables import (
    facts_table,
    numbers_table,
    settings_table,
    verdict_table,
    versions_table,
)
from femdeform.post.scene3d import interactive_data
from femdeform.run import atomic
from femdeform.run.result import Result

# With this the browser itself refuses whatever would have to be fetched. Plotly compiles some of its drawing
# code at run time, hence 'unsafe-eval'.
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; "
    "img-src data: blob:; font-src data:"
)
_STATUS_CLASSES = {"done": "good", "running": "open", "interrupted": "open"}
_MAX_POINTS_IN_SVG = 2000
# A click on a picture shows it over the whole width, and back.
_ENLARGE = """document.querySelectorAll(".pictures figure").forEach(function (figure) {
  figure.addEventListener("click", function () { figure.classList.toggle("large"); });
});
"""


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
    head = [
        "<!DOCTYPE html>",
        '<html lang="en">',
        "<head>",
        '<meta charset="utf-8">',
        f'<meta http-equiv="Content-Security-Policy" content="{escape(_POLICY)}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(title)} - femdeform</title>",
        f"<style>\n{_resource('report.css')}</style>",
        "</head>",
    ]
    body = [
        "<body>",
        "<main>",
        f'<header><h1>{escape(title)}</h1><span class="badge {_STATUS_CLASSES.get(status, "bad")}">'
        f"{escape(status.replace('_', ' '))}</span></header>",
        f'<p class="reason">{escape(reason)}</p>' if reason else "",
        _section("Pictures", _guarded(lambda: _pictures(result))),
        view,
        '<div class="columns">',
        _section("Run", facts_table(facts) + _guarded(lambda: numbers_table(result.history))),
        _section("Settings", _guarded(lambda: settings_table(result.resolved)) + versions_table(facts)),
        "</div>",
        _section("Expectations", verdict_table(facts.get("expect"))),
        '<div class="columns">',
        _section("Energy", _guarded(lambda: _plot(plots.energy_figure(result.history), "energy"))),
        _section("Residual", _guarded(lambda: _plot(plots.residual_figure(result.history), "residual"))),
        "</div>",
        _iterations_part(result),
        _section("Scene", _guarded(lambda: _scene_text(result.resolved_text))),
        "</main>",
        f"<script>\n{_ENLARGE}</script>",
        script,
        "</body>",
        "</html>",
    ]
    return "\n".join(line for line in head + body if line) + "\n"


def _section(title: str, content: str, *, identity: str = "") -> str:
    attribute = f' id="{identity}"' if identity else ""
    return f"<section{attribute}><h2>{escape(title)}</h2>\n{content}\n</section>" if content else ""


def _guarded(make: Callable[[], str]) -> str:
    """A part of the page, or the reason why it cannot be had."""
    try:
        return make()
    except FemdeformError as error:
        return f'<p class="note">{escape(str(error))}</p>'


def _pictures(result: Result) -> str:
    n_frames = len(result.frames)
    if n_frames == 0:
        return '<p class="note">No frames were written.</p>'
    chosen = sorted({0, n_frames // 2, n_frames - 1})
    parts = []
    for index, picture in zip(chosen, draw_frames(result, chosen), strict=True):
        caption = f"frame {index}, t = {result.frames[index].time:.4g} s"
        parts.append(
            f'<figure><img alt="{caption}" src="{_data_address("image/png", encode_picture(picture))}">'
            f"<figcaption>{caption}</figcaption></figure>"
        )
    return '<div class="pictures">' + "\n".join(parts) + "</div>"


def _interactive_part(result: Result) -> tuple[str, str]:
    """The section with the view, and the scripts for the end of the page."""
    try:
        if not result.frames:
            return "", ""
        data = interactive_data(result)
        library = _plotly_source()
    except FemdeformError as error:
        note = f'<p class="note">{escape(str(error))}</p>'
        return _section("Interactive view", note, identity="view3d-section"), ""
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
            f"<script>\n{_resource('viewer.js')}</script>",
        ]
    )
    return _section("Interactive view", content, identity="view3d-section"), script


def _iterations_part(result: Result) -> str:
    def make() -> str:
        if result.iterations is None:
            return ""
        return _plot(plots.iterations_figure(result.iterations), "residual per iteration")

    return _section("Convergence within steps", _guarded(make))


def _plot(figure: Any | None, description: str) -> str:
    if figure is None:
        return '<p class="note">The run left no numbers to plot.</p>'
    n_points = max(len(line.get_xdata()) for ax in figure.axes for line in ax.lines)
    # As an image of its own, an SVG keeps its identifiers to itself; with many points a bitmap is smaller.
    if n_points <= _MAX_POINTS_IN_SVG:
        address = _data_address("image/svg+xml", plots.figure_bytes(figure, "svg"))
    else:
        address = _data_address("image/png", plots.figure_bytes(figure, "png"))
    return f'<img alt="{escape(description)}" src="{address}">'


def _scene_text(text: str) -> str:
    return f"<details><summary>resolved.yaml</summary><pre>{escape(text)}</pre></details>"


def _data_address(kind: str, data: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode('ascii')}"


def _resource(name: str) -> str:
    return files("femdeform.post").joinpath(name).read_text(encoding="utf-8")


def _plotly_source() -> str:
    try:
        source = importlib.import_module("plotly.offline").get_plotlyjs()
    except ImportError as error:
        raise MissingDependencyError(f"the interactive view needs plotly ({error})") from error
    return str(source)
