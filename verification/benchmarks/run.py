"""`femdeform bench`: run benchmarks, show their tables, keep them as JSON and Markdown."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from femdeform import parallel, registry
from femdeform.errors import InputError
from femdeform.run import atomic
from femdeform.run.interrupts import Interrupts
from femdeform.scene.wording import did_you_mean
from verification.benchmarks import machine
from verification.benchmarks.cases import Benchmark, Cases
from verification.benchmarks.tables import Findings

DEFAULT_FOLDER = Path("results") / "bench"
_DATA = "bench.json"
# Characters a line where the output is no terminal, and nobody else says how wide it is.
_WIDTH = 120


# By name, as `module:function`: a benchmark and its libraries are imported only when it runs.
BENCHMARKS: dict[str, str] = {
    "newton": "verification.benchmarks.newton:run_newton",
    "mixed": "verification.benchmarks.mixed:run_mixed",
    "pbng": "verification.benchmarks.pbng:run_pbng",
    "xpbd": "verification.benchmarks.xpbd:run_xpbd",
    "mpm": "verification.benchmarks.mpm:run_mpm",
    "poisson": "verification.benchmarks.poisson:run_poisson",
    "dcdm": "verification.benchmarks.dcdm:run_dcdm",
}


def run_benchmarks(names: list[str], out: Path | None) -> int:
    """Run benchmarks one after the other.

    Parameters
    ----------
    names : list of str
        Which; all if empty.
    out : Path or None
        Folder for ``bench.json`` and ``bench.md``; default ``results/bench``. Both are written after every case.
        Pictures that an earlier run has left there are removed.

    Returns
    -------
    int
        0, or 1 if a case of femdeform's own broke. No time is ever judged.

    Raises
    ------
    InputError
        If a name is unknown, or several ranks were started: the benchmarks start ranks themselves.
    OutputError
        If the folder cannot be written.
    KeyboardInterrupt
        On SIGINT or SIGTERM; the case that runs is ended, what others have found is kept.
    """
    from rich.console import Console

    chosen = check_names(names)
    if parallel.launched_ranks() > 1:
        raise InputError("bench: start it on one rank; it starts further ranks itself")
    folder = DEFAULT_FOLDER if out is None else out
    atomic.make_folder(folder)
    _remove_pictures(folder)
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=_WIDTH)
    results = Results(folder, machine.machine_facts(), chosen)

    def say(text: str) -> None:
        console.print(text, style="dim", markup=False, soft_wrap=True)

    for line in machine.describe(results.facts):
        say(line)
    for name in chosen:
        benchmark: Benchmark = registry.resolve(BENCHMARKS[name])
        with Interrupts():
            findings = benchmark(Cases(say, partial(results.keep, name)))
        results.finish(name, findings)
        for table in findings.tables:
            console.print()
            console.print(table.to_rich())
    console.print(f"\n{folder / 'bench.md'}\n{folder / _DATA}", markup=False, soft_wrap=True)
    failures = [f"{name}: {text}" for name, findings in results.found.items() for text in findings.failures]
    for text in failures:
        console.print(f"failed: {text}", style="red", markup=False, soft_wrap=True)
    return 1 if failures else 0


def check_names(names: Sequence[str]) -> list[str]:
    """Return the benchmarks to run, each once.

    Raises
    ------
    InputError
        With one fault for each unknown name.
    """
    unknown = [name for name in names if name not in BENCHMARKS]
    if unknown:
        from femdeform.errors import Fault

        raise InputError(
            [Fault("", 0, "bench", f"unknown benchmark `{name}`; {did_you_mean(name, BENCHMARKS)}") for name in unknown]
        )
    return list(dict.fromkeys(names)) or list(BENCHMARKS)


def _remove_pictures(folder: Path) -> None:
    """Remove the pictures that an earlier run lists: the tables they belong to are about to be replaced."""
    try:
        document = json.loads((folder / _DATA).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return
    if isinstance(document, dict):
        atomic.remove_listed(folder, document.get("pictures"))


@dataclass
class Results:
    """What benchmarks have found so far, and the files that say so: each is the old one or the new one at any time.

    Attributes
    ----------
    folder : Path
        Where ``bench.json`` (everything), ``bench.md`` (the tables) and pictures lie.
    facts : dict
        About the machine.
    unfinished : list of str
        Benchmarks that have cases to come.
    found : dict of str to Findings
        By benchmark.
    pictures : dict of str to list of str
        Names of the files, by benchmark.
    """

    folder: Path
    facts: dict[str, Any]
    unfinished: list[str]
    found: dict[str, Findings] = field(default_factory=dict)
    pictures: dict[str, list[str]] = field(default_factory=dict)

    def keep(self, name: str, findings: Findings) -> None:
        """Write what a benchmark has found so far.

        Raises
        ------
        OutputError
            If the folder cannot be written.
        """
        self.found[name] = findings
        document = {
            "schema_version": 1,
            "machine": self.facts,
            "unfinished": self.unfinished,
            "benchmarks": {name: findings.data for name, findings in self.found.items()},
            "pictures": [picture for pictures in self.pictures.values() for picture in pictures],
        }
        atomic.write_text(self.folder / _DATA, json.dumps(document, indent=2) + "\n")
        atomic.write_text(self.folder / "bench.md", self._markdown())

    def finish(self, name: str, findings: Findings) -> None:
        """Write what a benchmark has found in the end, with its pictures; see `keep`."""
        self.unfinished = [each for each in self.unfinished if each != name]
        self.keep(name, findings)
        drawn = findings.draw()
        if drawn:
            for picture, content in drawn.items():
                atomic.write_bytes(self.folder / picture, content)
            self.pictures[name] = list(drawn)
            self.keep(name, findings)

    def _markdown(self) -> str:
        lines = ["# Benchmarks", "", *(f"{line}  " for line in machine.describe(self.facts)), ""]
        if self.unfinished:
            lines += [f"Not finished: {', '.join(self.unfinished)}.", ""]
        for name, findings in self.found.items():
            lines += [f"## {name}", "", findings.summary, ""]
            lines += [table.to_markdown() for table in findings.tables]
            lines += [f"![{picture}]({picture})\n" for picture in self.pictures.get(name, [])]
            lines += [f"Failed: {text}\n" for text in findings.failures]
        return "\n".join(lines)
