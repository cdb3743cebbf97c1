"""The table of a study: a row for each run, with its keys, how it stands and its numbers; ``index.csv``."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

from femdeform.run import atomic
from femdeform.run.batch_plan import Plan, PlannedRun, short_keys, shown_value
from femdeform.run.batch_record import WAITING, Ending, RunFiles
from femdeform.run.plain import to_json


@dataclass(frozen=True)
class Row:
    """One run of a study.

    Attributes
    ----------
    number : int
        Place in the study, from 1.
    name : str
        Name of its folder in ``runs``.
    values : mapping of str to Any
        Its values of the varied keys; a key that it leaves as it is is missing.
    ending : Ending
        How it stands.
    scalars : mapping of str to Any
        Its numbers, as far as there are any.
    files : RunFiles
        Where its files lie.
    """

    number: int
    name: str
    values: Mapping[str, Any]
    ending: Ending
    scalars: Mapping[str, Any]
    files: RunFiles


@dataclass(frozen=True)
class StudyTable:
    """A study as it stands.

    Attributes
    ----------
    title : str
        Its title.
    out : Path
        Its folder.
    keys : tuple of str
        Keys that are varied.
    scalars : tuple of str
        Names of the numbers.
    rows : tuple of Row
        One for each run, in the order of the study.
    verdicts : tuple of mapping
        What the study expects of all runs together, as of `femdeform.run.batch_expectations.over_runs_verdicts`.
    """

    title: str
    out: Path
    keys: tuple[str, ...]
    scalars: tuple[str, ...]
    rows: tuple[Row, ...]
    verdicts: tuple[Mapping[str, Any], ...] = ()

    @property
    def short_keys(self) -> dict[str, str]:
        """Names of the keys for headings."""
        return short_keys(self.keys)

    def column(self, name: str) -> list[Any]:
        """Values of a key or of a scalar, None where a run has none."""
        kind = "values" if name in self.keys else "scalars"
        return [getattr(row, kind).get(name) for row in self.rows]


class Index:
    """Keeps the table of a study, and writes it.

    Parameters
    ----------
    plan : Plan
        The study's runs.
    out : Path
        Folder of the batch.
    """

    def __init__(self, plan: Plan, out: Path) -> None:
        self._plan = plan
        self._out = out
        self.files = {name: RunFiles.of(out, name) for name in plan.distinct}
        self._endings: dict[str, Ending] = {}
        self._scalars: dict[str, dict[str, Any]] = {}
        for name, files in self.files.items():
            self.update(name, files.ending())

    def update(self, name: str, ending: Ending) -> None:
        """Note how a run stands, and read its numbers."""
        self._endings[name] = ending
        self._scalars[name] = {} if ending == WAITING else _numbers(self.files[name].facts(), self._plan.scalars)

    def ending(self, run: PlannedRun) -> Ending:
        """How a run stands."""
        return self._endings[run.name]

    def table(self) -> StudyTable:
        """The table as it stands."""
        rows = tuple(
            Row(
                number=run.number,
                name=run.name,
                values={choice.key: choice.value for choice in run.varied},
                ending=self._endings[run.name],
                scalars=self._scalars[run.name],
                files=self.files[run.name],
            )
            for run in self._plan.runs
        )
        return StudyTable(self._plan.title, self._out, self._plan.keys, self._plan.scalars, rows)

    def write_csv(self) -> None:
        """Write ``index.csv``.

        Raises
        ------
        OutputError
            If it cannot be written.
        """
        atomic.write_text(self._out / "index.csv", to_csv(self.table()))

    def write_manifest(self, verdicts: Sequence[Mapping[str, Any]]) -> None:
        """Write ``study.json``: what each run sets, which folder it has, and what has become of the study's `expect`.

        Raises
        ------
        OutputError
            If it cannot be written.
        """
        study = self._plan.study
        data = {
            "title": self._plan.title,
            "study": study.path.name,
            "scene": study.study.scene,
            "keys": self._plan.keys,
            "scalars": self._plan.scalars,
            "runs": [
                {"number": run.number, "run": run.name, "hash": run.hash, "set": list(run.overrides)}
                for run in self._plan.runs
            ],
            "expect": list(verdicts),
        }
        atomic.write_text(self._out / "study.json", to_json(data))


def _numbers(facts: Mapping[str, Any], names: Sequence[str]) -> dict[str, Any]:
    quantities, judged = facts.get("quantities"), facts.get("expect")
    known = {**facts, **(quantities if isinstance(quantities, dict) else {})}
    for verdict in judged if isinstance(judged, list) else []:
        if isinstance(verdict, dict):
            known.setdefault(verdict.get("quantity", ""), verdict.get("computed"))
    return {name: known[name] for name in names if isinstance(known.get(name), (int, float))}


def to_csv(table: StudyTable) -> str:
    """A table as CSV: ``number, run``, the varied keys, ``status, reason, exit_code, seconds``, the scalars."""
    stream = StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["number", "run", *table.keys, "status", "reason", "exit_code", "seconds", *table.scalars])
    for row in table.rows:
        ending = row.ending
        writer.writerow(
            [
                *(row.number, row.name),
                *(shown_value(row.values[key]) if key in row.values else "" for key in table.keys),
                *(ending.status, ending.reason, _cell(ending.exit_code)),
                "" if ending.seconds is None else f"{ending.seconds:.3f}",
                *(_cell(row.scalars.get(name)) for name in table.scalars),
            ]
        )
    return stream.getvalue()


def _cell(value: float | None) -> str:
    return "" if value is None else repr(value)
