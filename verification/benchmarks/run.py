"""`femdeform bench`: run benchmarks, show their tables, keep them as JSON and Markdown."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from femdeform import parallel, registry
from femdeform.errors import InputError
from femdeform.run import atomic
from femdeform.scene.wording import did_you_mean
from verification.benchmarks import machine
from verification.benchmarks.tables import Table

DEFAULT_FOLDER = Path("results") / "bench"
# Characters a line where the output is no terminal, and nobody else says how wide it is.
_WIDTH = 120


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
    pictures : dict of str to bytes
        Files beside the tables, by name.
    """

    summary: str
    tables: list[Table] = field(default_factory=list)
    data: dict[str, Any] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)
    pictures: dict[str, bytes] = field(default_factory=dict)


# A benchmark says what it is doing by its argument.
Benchmark = Callable[[Callable[[str], None]], Findings]

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
        Folder for ``bench.json`` and ``bench.md``; default ``results/bench``.

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
    """
    from rich.console import Console

    chosen = check_names(names)
    if parallel.launched_ranks() > 1:
        raise InputError("bench: start it on one rank; it starts further ranks itself")
    folder = DEFAULT_FOLDER if out is None else out
    atomic.make_folder(folder)
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=_WIDTH)
    facts = machine.machine_facts()
    for line in machine.describe(facts):
        console.print(line, style="dim", markup=False, soft_wrap=True)
    found: dict[str, Findings] = {}
    for name in chosen:
        benchmark: Benchmark = registry.resolve(BENCHMARKS[name])
        found[name] = benchmark(lambda text: console.print(text, style="dim", markup=False, soft_wrap=True))
        for table in found[name].tables:
            console.print()
            console.print(table.to_rich())
        # Written after each benchmark: a later one that is interrupted takes nothing with it.
        write_results(folder, facts, found)
    console.print(f"\n{folder / 'bench.md'}\n{folder / 'bench.json'}", markup=False, soft_wrap=True)
    failures = [f"{name}: {text}" for name, findings in found.items() for text in findings.failures]
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


def write_results(folder: Path, facts: dict[str, Any], found: dict[str, Findings]) -> None:
    """Write ``bench.json`` (everything), ``bench.md`` (the tables) and pictures."""
    document = {
        "schema_version": 1,
        "machine": facts,
        "benchmarks": {name: findings.data for name, findings in found.items()},
    }
    atomic.write_text(folder / "bench.json", json.dumps(document, indent=2) + "\n")
    lines = ["# Benchmarks", "", *(f"{line}  " for line in machine.describe(facts)), ""]
    for name, findings in found.items():
        lines += [f"## {name}", "", findings.summary, ""]
        lines += [table.to_markdown() for table in findings.tables]
        lines += [f"![{picture}]({picture})\n" for picture in findings.pictures]
        lines += [f"Failed: {text}\n" for text in findings.failures]
        for picture, content in findings.pictures.items():
            atomic.write_bytes(folder / picture, content)
    atomic.write_text(folder / "bench.md", "\n".join(lines))
