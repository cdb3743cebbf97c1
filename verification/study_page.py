"""The page of a verification: what was judged, case by case, in one HTML file that needs nothing else."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files

from femdeform.post.page import data_address, html_page, section
from femdeform.post.report_tables import versions_table
from verification.judgement import Row
from verification.readme import render_readme
from verification.study import CaseResult, StudyResult, count_passed
from verification.summary import COLUMNS, Line, case_lines, number

_ROW = ("level", "size", "n_dofs", "dt", "quantity", "computed", "reference", "error", "rate", "seconds", "iterations")
_HEADS = {"n_dofs": "unknowns", "dt": "dt [s]", "seconds": "time [s]"}


def page(results: Sequence[CaseResult], sections: Sequence[str], n_cases: int, versions: Mapping[str, str]) -> str:
    """The page about the cases that are done.

    Parameters
    ----------
    results : sequence of CaseResult
        Cases that are done.
    sections : sequence of str
        What `case_section` made of each.
    n_cases : int
        How many there are to do.
    versions : mapping of str to str
        Of the software.
    """
    n_passed, n_judged = count_passed(results)
    if len(results) < n_cases:
        status, colour = f"{len(results)} of {n_cases} cases", "open"
    else:
        status, colour = ("passed", "good") if n_passed == n_judged else (f"{n_judged - n_passed} failed", "bad")
    style = files("verification").joinpath("study_page.css").read_text(encoding="utf-8")
    extent = "All levels" if any(result.full for result in results) else "Coarse end of the studies"
    seconds = sum(result.seconds for result in results)
    intro = f"{extent}: {n_passed} of {n_judged} judgements inside their band, {seconds:.0f} s."
    return html_page(
        "Verification",
        status,
        colour,
        [
            f"<style>{style}</style>",
            section("Summary", f"<p>{intro}</p>\n{_overview(results)}\n{_failures(results)}"),
            *sections,
            section("Software", versions_table({"versions": versions})),
        ],
    )


def _overview(results: Sequence[CaseResult]) -> str:
    heads = ("case", "what", "studies", "inside", "time [s]", "verdict")
    lines = ['<table class="numbers">', _row("th", heads)]
    for result in results:
        inside = sum(verdict.passed for verdict in result.verdicts)
        link = f'<a href="#{escape(result.name)}">{escape(result.name)}</a>'
        texts = [escape(result.title), str(len(result.studies)), f"{inside} of {len(result.verdicts)}"]
        cells = [link, *texts, f"{result.seconds:.1f}"]
        body = "".join(f"<td>{cell}</td>" for cell in cells)
        lines.append(f"<tr>{body}{_verdict_cell('passed' if result.passed else 'FAILED', result.passed)}</tr>")
    return "\n".join([*lines, "</table>"])


def _failures(results: Sequence[CaseResult]) -> str:
    reasons = [
        f"<li>{escape(result.name)}: {escape(reason)}</li>"
        for result in results
        for line in case_lines(result)
        for reason in line.reasons
    ]
    return f'<ul class="reason">{"".join(reasons)}</ul>' if reasons else ""


def case_section(result: CaseResult, plots: Mapping[str, bytes]) -> str:
    """The section about one case.

    Parameters
    ----------
    result : CaseResult
        What was computed.
    plots : mapping of str to bytes
        PNG pictures by the name of their study.
    """
    pictures = []
    for name, data in plots.items():
        # All at one scale: the width in a PNG's head is that of the figure at 150 dots an inch.
        width = round(int.from_bytes(data[16:20], "big") / 1.5)
        image = f'<img alt="{escape(name)}" width="{width}" src="{data_address("image/png", data)}">'
        caption = f"<figcaption>{escape(name)}: {escape(_about(result, name))}</figcaption>"
        pictures.append(f"<figure>{image}{caption}</figure>")
    readme = render_readme(result.readme) if result.readme else ""
    parts = [
        f"<details><summary>Equations, exact solution, what is expected</summary>{readme}</details>" if readme else "",
        _verdicts(case_lines(result)),
        '<div class="plots">' + "\n".join(pictures) + "</div>" if pictures else "",
        f"<details><summary>All variations</summary>{_verdicts(case_lines(result, apart=True))}</details>"
        if any("/" in study.name for study in result.studies)
        else "",
        f"<details><summary>All levels</summary>{''.join(map(_levels, result.studies))}</details>",
    ]
    return section(f"{result.name}: {result.title}", "\n".join(part for part in parts if part), identity=result.name)


def _about(result: CaseResult, name: str) -> str:
    study = next(study for study in result.studies if study.name.partition("/")[0] == name)
    return study.about or study.kind.replace("_", " ")


def _verdicts(lines: Sequence[Line]) -> str:
    html = ['<table class="numbers">', _row("th", COLUMNS)]
    study = ""
    for line in lines:
        cells = dict(zip(COLUMNS, line.cells(), strict=True))
        # The name of a study once, where its lines begin.
        cells["study"], study = "" if line.study == study else line.study, line.study
        row = "".join(
            _verdict_cell(text, line.passed) if name == "verdict" else f"<td>{escape(text)}</td>"
            for name, text in cells.items()
        )
        html.append(f"<tr{'' if line.passed else ' class=failed'}>{row}</tr>")
    return "\n".join([*html, "</table>"])


def _levels(study: StudyResult) -> str:
    columns = [name for name in _ROW if any(_text(row, name) not in ("", "-") for row in study.rows)]
    has_notes = any(row.note for row in study.rows)
    heads = [study.axis or name if name == "size" else _HEADS.get(name, name) for name in columns]
    heads += ["note"] if has_notes else []
    html = [f"<h3>{escape(study.name)}</h3>", f"<p>{escape(study.about)}</p>" if study.about else ""]
    html += ['<table class="numbers">', _row("th", heads)]
    html += [
        _row("td", [_text(row, name) for name in columns] + ([row.note] if has_notes else [])) for row in study.rows
    ]
    return "\n".join([*html, "</table>"])


def _text(row: Row, name: str) -> str:
    value = getattr(row, name)
    if name == "seconds" and not math.isnan(value):
        return f"{value:.2f}"
    if name == "rate" and not math.isnan(value):
        return f"{value:.3f}"
    if name in ("computed", "reference") and not math.isnan(value):
        return f"{value:.8g}"
    if isinstance(value, float):
        return number(value)
    return f"{value:,}" if isinstance(value, int) else str(value)


def _row(tag: str, cells: Sequence[str]) -> str:
    return "<tr>" + "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in cells) + "</tr>"


def _verdict_cell(text: str, passed: bool) -> str:
    return f'<td class="{"pass" if passed else "fail"}">{escape(text)}</td>'
