"""What a verification leaves: tables, rates, plots, one page about all cases and one file for programs."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from io import StringIO
from pathlib import Path
from typing import Any

from femdeform.errors import Fault, InputError
from femdeform.info import versions
from femdeform.post.plots import figure_bytes
from femdeform.run import atomic
from femdeform.run.plain import to_json
from verification.judgement import Row
from verification.study import CaseResult, StudyResult, count_passed
from verification.study_page import case_section, page
from verification.study_plots import figures

ERRORS, RATES, ITERATIONS = "errors.csv", "rates.json", "iterations.csv"
PAGE, FACTS = "index.html", "verify.json"
# What the folder's verify.json says it is; another program's file of that name says something else.
_KIND = "femdeform verification"
_COLUMNS = tuple(item.name for item in fields(Row) if item.name != "is_reference")


class Report:
    """The folder of a verification, up to date after every case: a later one that is interrupted takes nothing with it.

    Parameters
    ----------
    folder : Path
        Created where it is missing. What an earlier verification left there is replaced.
    n_cases : int
        How many cases there are to do.

    Raises
    ------
    InputError
        If the folder holds files that are not of a verification.
    OutputError
        If the folder cannot be written.
    """

    def __init__(self, folder: Path, n_cases: int) -> None:
        self._folder = folder
        self._n_cases = n_cases
        self._results: list[CaseResult] = []
        self._sections: list[str] = []
        if folder.is_dir() and any(folder.iterdir()) and _earlier(folder / FACTS).get("kind") != _KIND:
            message = "holds files that are not of a verification; give another folder with --out"
            raise InputError([Fault(str(folder), 0, "", message)])
        atomic.make_folder(folder)
        self._write()

    def add(self, result: CaseResult) -> None:
        """Write a case that is done, and the page and summary of all cases so far.

        Raises
        ------
        OutputError
            If a file cannot be written.
        """
        plots = write_case(result, self._folder / result.name)
        self._results.append(result)
        self._sections.append(case_section(result, plots))
        self._write()

    def _write(self) -> None:
        facts = _facts(self._results, self._n_cases)
        atomic.write_text(self._folder / FACTS, to_json(facts))
        atomic.write_text(self._folder / PAGE, page(self._results, self._sections, self._n_cases, facts["versions"]))


def write_case(result: CaseResult, folder: Path) -> dict[str, bytes]:
    """Write a case's tables and plots.

    Parameters
    ----------
    result : CaseResult
        What was computed.
    folder : Path
        Created where it is missing. It gets `errors.csv`, `rates.json`, a PNG for each study with something to plot,
        and `iterations.csv` if there is an iteration sweep. What else an earlier verification left there is removed.

    Returns
    -------
    dict of str to bytes
        The plots by the name of their study.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    atomic.make_folder(folder)
    rows = [asdict(row) for study in result.studies for row in study.rows]
    texts = {ERRORS: _csv(_COLUMNS, rows)}
    sweeps = [{"study": study.name, **row} for study in result.studies for row in study.iterations]
    if sweeps:
        texts[ITERATIONS] = _csv(list(dict.fromkeys(key for row in sweeps for key in row)), sweeps)
    plots = {name: figure_bytes(figure, "png") for name, figure in figures(result.studies).items()}
    files = [*texts, *(f"{name}.png" for name in plots)]
    atomic.remove_listed(folder, _earlier(folder / RATES).get("files"), kept=files)
    for name, data in plots.items():
        atomic.write_bytes(folder / f"{name}.png", data)
    for name, text in texts.items():
        atomic.write_text(folder / name, text)
    atomic.write_text(folder / RATES, to_json({**_rates(result), "files": files}))
    return plots


def _earlier(path: Path) -> dict[str, Any]:
    """What an earlier verification wrote to a JSON file; nothing where it holds none."""
    try:
        facts = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return facts if isinstance(facts, dict) else {}


def _facts(results: Sequence[CaseResult], n_cases: int) -> dict[str, Any]:
    """What `verify.json` says of the cases so far."""
    n_passed, n_judged = count_passed(results)
    return {
        "kind": _KIND,
        "status": "running" if len(results) < n_cases else "passed" if n_passed == n_judged else "failed",
        "full": any(result.full for result in results),
        "cases": [
            {
                "name": result.name,
                "title": result.title,
                "passed": result.passed,
                "judgements": len(result.verdicts),
                "inside": sum(verdict.passed for verdict in result.verdicts),
                "seconds": result.seconds,
                "failed": [asdict(verdict) for verdict in result.verdicts if not verdict.passed],
            }
            for result in results
        ],
        "judgements": n_judged,
        "inside": n_passed,
        "versions": versions(),
    }


def _rates(result: CaseResult) -> dict[str, Any]:
    return {
        "case": result.name,
        "title": result.title,
        "full": result.full,
        "passed": result.passed,
        "seconds": result.seconds,
        "studies": {study.name: _rates_of_study(study) for study in result.studies},
    }


def _rates_of_study(study: StudyResult) -> dict[str, Any]:
    quantities: dict[str, Any] = {}
    for name in dict.fromkeys(row.quantity for row in study.rows):
        rows = [row for row in study.rows if row.quantity == name]
        quantities[name] = {
            "levels": [row.level for row in rows],
            "sizes": [row.size for row in rows],
            "computed": [row.computed for row in rows],
            "references": [row.reference for row in rows],
            "errors": [row.error for row in rows],
            "rates": [row.rate for row in rows[1:]],
            "verdicts": [
                {
                    "judgement": verdict.judgement,
                    "level": verdict.level,
                    "computed": verdict.computed,
                    # A band without an end has none here either.
                    "band": [verdict.low, verdict.high],
                    "passed": verdict.passed,
                    "reason": verdict.reason,
                }
                for verdict in study.verdicts
                if verdict.quantity == name
            ],
        }
    return {"kind": study.kind, "passed": study.passed, "seconds": study.seconds, "quantities": quantities}


def _csv(columns: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> str:
    stream = StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_cell(row.get(name, "")) for name in columns] for row in rows)
    return stream.getvalue()


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else repr(value)
    return " ".join(str(value).splitlines())
