"""What every HTML page of femdeform is made of: a frame that needs nothing else, neither files nor network."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from html import escape
from importlib.resources import files
from typing import Any

from femdeform.errors import FemdeformError
from femdeform.post import plots

# With this the browser itself refuses whatever would have to be fetched. Plotly compiles some of its drawing
# code at run time, hence 'unsafe-eval'.
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' 'unsafe-eval'; style-src 'unsafe-inline'; "
    "img-src data: blob:; font-src data:"
)
_MAX_POINTS_IN_SVG = 2000
# A click on a picture shows it over the whole width, and back.
_ENLARGE = """document.querySelectorAll(".pictures figure").forEach(function (figure) {
  figure.addEventListener("click", function () { figure.classList.toggle("large"); });
});
"""


def html_page(title: str, status: str, status_class: str, body: Sequence[str], scripts: str = "") -> str:
    """A page around its sections.

    Parameters
    ----------
    title : str
        Heading, as plain text.
    status : str
        Words of the badge beside it.
    status_class : str
        ``good``, ``open`` or ``bad``: its colour.
    body : sequence of str
        HTML of the sections; empty ones are left out.
    scripts : str
        HTML of further scripts, for the end of the page.
    """
    lines = [
        "<!DOCTYPE html>",
        '<html lang="en">',
        "<head>",
        '<meta charset="utf-8">',
        f'<meta http-equiv="Content-Security-Policy" content="{escape(_POLICY)}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escape(title)} - femdeform</title>",
        f"<style>\n{resource('report.css')}</style>",
        "</head>",
        "<body>",
        "<main>",
        f'<header><h1>{escape(title)}</h1><span class="badge {status_class}">'
        f"{escape(status.replace('_', ' '))}</span></header>",
        *body,
        "</main>",
        f"<script>\n{_ENLARGE}</script>",
        scripts,
        "</body>",
        "</html>",
    ]
    return "\n".join(line for line in lines if line) + "\n"


def section(title: str, content: str, *, identity: str = "") -> str:
    """A section with a heading; nothing where there is no content."""
    attribute = f' id="{identity}"' if identity else ""
    return f"<section{attribute}><h2>{escape(title)}</h2>\n{content}\n</section>" if content else ""


def guarded(make: Callable[[], str]) -> str:
    """A part of a page, or the reason why it cannot be had."""
    try:
        return make()
    except FemdeformError as error:
        return f'<p class="note">{escape(str(error))}</p>'


def figure_image(figure: Any, description: str) -> str:
    """A figure of matplotlib as an image inside the page."""
    n_points = max((len(line.get_xdata()) for ax in figure.axes for line in ax.lines), default=0)
    # As an image of its own, an SVG keeps its identifiers to itself; with many points a bitmap is smaller.
    if n_points <= _MAX_POINTS_IN_SVG:
        address = data_address("image/svg+xml", plots.figure_bytes(figure, "svg"))
    else:
        address = data_address("image/png", plots.figure_bytes(figure, "png"))
    return f'<img alt="{escape(description)}" src="{address}">'


def data_address(kind: str, data: bytes) -> str:
    """Bytes as an address that stands for them."""
    return f"data:{kind};base64,{base64.b64encode(data).decode('ascii')}"


def resource(name: str) -> str:
    """A text file that lies beside this module."""
    return files("femdeform.post").joinpath(name).read_text(encoding="utf-8")
