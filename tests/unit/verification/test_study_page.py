"""What a verification leaves: tables, rates, plots, the page."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from femdeform.errors import InputError
from verification.readme import render_readme
from verification.report import Report, write_case
from verification.study import CaseResult, run_case

Case = Callable[..., Path]
README = """\
# A case

Body force and **boundary**, from `study.yaml`:

    div P + b = 0,   u < 1 & v > 2

| law | rate |
|---|---:|
| `arap` | 2 |

- one
  and more
- two <script>alert(1)</script>
"""


@pytest.fixture
def result(case: Case, refinement: Callable[..., str]) -> CaseResult:
    """A case with a study that passes, one that fails, one of a single run and one of iterations."""
    more = """\
    each: {soft: {set: {bodies.body.material.youngs_modulus: 1.0}}, stiff: {}}
  one:
    kind: value
    about: a single run
    set: {time.dt: 0.1}
    fields: {displacement: ["0.1*x*y", "0"]}
    quantities: {max(energy): {at_most: 1.0e-9}, middle: {report_only: true}}
  sweep:
    kind: parameter_sweep
    fields: {displacement: ["0.1*x", "0"]}
    levels: [{label: plain}, {label: <b>, set: {bodies.body.material.law: arap}}]
    quantities: {middle: {reference: {value: 0.04, source: exact}, atol: 1.0e-9}}
  newton:
    kind: iteration_sweep
    iterations: 2
    set: {gravity: [0.0, -0.01], "conditions[0].on": body.left}
    variants: {adaptive: {}, projected: {set: {solver.hessian: projected}}}
    quantities: {residual: {at_most: 1.0}}
"""
    return run_case(case(refinement("{l2: {rate: [1.8, 2.2]}, h1: {rate: [0.9, 1.1]}}", more=more), readme=README))


def test_tables_rates_and_plots(result: CaseResult, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    for name in ("gone.png", "mine.png", "errors.csv"):
        (folder / name).write_bytes(b"of an earlier verification, or not")
    (tmp_path / "outside.png").write_bytes(b"not of this folder")
    (folder / "rates.json").write_text('{"files": ["gone.png", "errors.csv", "../outside.png", 7]}')
    plots = write_case(result, folder)
    assert (tmp_path / "outside.png").exists()
    assert {path.name for path in folder.iterdir()} == {
        "mine.png",
        "errors.csv",
        "rates.json",
        "iterations.csv",
        *(f"{name}.png" for name in ("p1", "one", "sweep", "newton")),
    }
    assert all(data.startswith(b"\x89PNG") for data in plots.values())
    with (folder / "errors.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    head = "study level size n_dofs dt quantity computed reference error rate seconds iterations note"
    assert list(rows[0]) == head.split()
    l2 = [row for row in rows if row["study"] == "p1/stiff" and row["quantity"] == "l2"]
    assert [row["size"] for row in l2] == ["0.25", "0.125", "0.0625"]
    assert l2[0]["rate"] == ""
    rates = json.loads((folder / "rates.json").read_text(encoding="utf-8"))
    assert rates["passed"] is False
    found = rates["studies"]["p1/stiff"]["quantities"]["l2"]
    assert found["rates"][-1] == float(l2[2]["rate"])
    assert found["verdicts"] == [
        {
            "judgement": "rate",
            "level": "3",
            "computed": found["rates"][-1],
            "band": [1.8, 2.2],
            "passed": True,
            "reason": "",
        }
    ]
    bound = rates["studies"]["one"]["quantities"]["max(energy)"]["verdicts"][0]
    assert bound["band"] == [None, 1e-9]
    with (folder / "iterations.csv").open(encoding="utf-8", newline="") as file:
        iterations = list(csv.DictReader(file))
    assert {row["variant"] for row in iterations} == {"adaptive", "projected"}
    assert {row["study"] for row in iterations} == {"newton"}


def test_the_page_and_the_summary_grow_with_the_cases(result: CaseResult, tmp_path: Path) -> None:
    report = Report(tmp_path / "out", 2)
    assert "0 of 2 cases" in (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    report.add(result)
    facts = json.loads((tmp_path / "out" / "verify.json").read_text(encoding="utf-8"))
    assert (facts["status"], len(facts["cases"])) == ("running", 1)
    assert "1 of 2 cases" in (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    report.add(result)
    facts = json.loads((tmp_path / "out" / "verify.json").read_text(encoding="utf-8"))
    assert facts["status"] == "failed"
    # Each time: four rates of two variations, a maximum, two levels, two variants.
    assert (facts["judgements"], facts["inside"]) == (2 * 9, 2 * 8)
    assert facts["cases"][0]["failed"][0]["quantity"] == "max(energy)"
    assert facts["versions"]["femdeform"]


def test_the_page_needs_nothing_and_shows_everything(result: CaseResult, tmp_path: Path) -> None:
    Report(tmp_path / "out", 1).add(result)
    page = (tmp_path / "out" / "index.html").read_text(encoding="utf-8")
    assert not re.search(r'(?:src|href)="(?!data:|#)', page)
    assert page.count("data:image/png") == 4
    assert "2 failed" not in page
    assert ">1 failed<" in page
    assert "div P + b = 0,   u &lt; 1 &amp; v &gt; 2" in page
    assert "<b>" not in page.replace("<body>", "")
    assert "<script>alert" not in page
    assert "class=failed" in page
    for text in ("one: a single run", "p1/soft", "All variations", "All levels", "numpy"):
        assert text in page


def test_only_a_folder_of_a_verification_is_written_to(result: CaseResult, tmp_path: Path) -> None:
    folder = tmp_path / "out"
    Report(folder, 1).add(result)
    Report(folder, 1)
    (folder / "verify.json").write_text("{}")
    with pytest.raises(InputError, match="not of a verification"):
        Report(folder, 1)


def test_a_readme_becomes_html() -> None:
    assert render_readme(README).splitlines() == [
        "<h3>A case</h3>",
        "<p>Body force and <strong>boundary</strong>, from <code>study.yaml</code>:</p>",
        "<pre>div P + b = 0,   u &lt; 1 &amp; v &gt; 2</pre>",
        "<table><tr><th>law</th><th>rate</th></tr><tr><td><code>arap</code></td><td>2</td></tr></table>",
        "<ul><li>one and more</li><li>two &lt;script&gt;alert(1)&lt;/script&gt;</li></ul>",
    ]


@pytest.mark.parametrize(
    ("text", "html"),
    [
        ("", ""),
        ("a\nb\n\nc", "<p>a b</p>\n<p>c</p>"),
        ("```\nx <- 1\n```\ny", "<pre>x &lt;- 1</pre>\n<p>y</p>"),
        ("```\nnever closed", "<pre>never closed</pre>"),
        ("text\n| a |\n| b |", "<p>text</p>\n<table><tr><td>a</td></tr><tr><td>b</td></tr></table>"),
        ("a `b` c ` d", "<p>a <code>b</code> c ` d</p>"),
        ("[here](other.md)", "<p>here (other.md)</p>"),
        ("    u = x\n\n    v = y\n\nend", "<pre>u = x\n\nv = y</pre>\n<p>end</p>"),
        ("#no heading", "<p>#no heading</p>"),
    ],
)
def test_parts_of_a_readme(text: str, html: str) -> None:
    assert render_readme(text) == html
