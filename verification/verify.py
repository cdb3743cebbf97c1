"""`femdeform verify`: runs cases, shows their verdicts, writes their tables, plots and one page."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

from femdeform import parallel
from femdeform.errors import Fault, InputError
from femdeform.scene.load import sort_faults
from verification.case import choose_cases, load_case, read_title, shipped_cases
from verification.plan import CasePlan
from verification.report import PAGE, Report
from verification.study import CaseResult, count_passed, run_plan
from verification.summary import COLUMNS, Line, case_lines
from verification.verify_progress import OnScreen, Silent

DEFAULT_FOLDER = Path("results") / "verify"


def verify_command(names: Sequence[str], full: bool, out: Path | None, quiet: bool) -> int:
    """Verify cases, one after the other.

    Parameters
    ----------
    names : sequence of str
        Names of shipped cases, or folders; all shipped cases if empty.
    full : bool
        All levels of all studies, not the coarse end only.
    out : Path or None
        Folder for the results; default ``results/verify``.
    quiet : bool
        No progress and no tables, the last line only.

    Returns
    -------
    int
        0, or 1 if a judgement lies outside its band or a run did not converge.

    Raises
    ------
    InputError
        With every fault of all cases, before anything is computed; or on several ranks.
    OutputError
        If the folder cannot be written.
    """
    if parallel.launched_ranks() > 1:
        raise InputError("verify runs on one rank; start it without mpiexec")
    plans = _load(choose_cases(names))
    folder = DEFAULT_FOLDER if out is None else out
    report = Report(folder, len(plans))
    results: list[CaseResult] = []
    progress = Silent() if quiet else OnScreen(sum(plan.n_runs(full) for plan in plans))
    with nullcontext() if isinstance(progress, Silent) else progress:
        for plan in plans:
            result = run_plan(plan, full, None, progress)
            results.append(result)
            report.add(result)
            if isinstance(progress, OnScreen):
                with progress.aside():
                    _show(result)
    n_passed, n_judged = count_passed(results)
    print(f"{n_passed} of {n_judged} judgements inside their band; {folder / PAGE}")
    return 0 if n_passed == n_judged else 1


def list_cases() -> int:
    """Print the shipped cases with their titles."""
    cases = shipped_cases()
    width = max(map(len, cases), default=0)
    for name, folder in cases.items():
        print(f"{name:<{width}}  {read_title(folder)}")
    return 0


def _load(chosen: dict[str, Path]) -> list[CasePlan]:
    plans: list[CasePlan] = []
    faults: list[Fault] = []
    for folder in chosen.values():
        try:
            plans.append(load_case(folder))
        except InputError as error:
            faults += error.faults
    if faults:
        raise InputError(sort_faults(faults))
    return plans


def _show(result: CaseResult) -> None:
    """Print the verdicts of a case."""
    lines = case_lines(result)
    head = f"{result.name}: {result.title} ({result.seconds:.1f} s)"
    print()
    if sys.stdout.isatty():
        _show_coloured(head, lines)
    else:
        rows = [COLUMNS, *(line.cells() for line in lines)]
        widths = [max(len(row[k]) for row in rows) for k in range(len(COLUMNS))]
        print(head)
        for row in rows:
            print("  " + "  ".join(f"{text:<{width}}" for text, width in zip(row, widths, strict=True)).rstrip())
    for line in lines:
        for reason in line.reasons:
            print(f"  FAILED {reason}")
    sys.stdout.flush()


def _show_coloured(head: str, lines: Sequence[Line]) -> None:
    from rich import box
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in COLUMNS:
        table.add_column(column, no_wrap=True)
    for line in lines:
        styles = {"verdict": "green" if line.passed else "bold red"}
        table.add_row(*(Text(text, styles.get(name, "")) for name, text in zip(COLUMNS, line.cells(), strict=True)))
    console: Any = Console(highlight=False)
    # Digits must not be cut: a terminal that is too narrow wraps whole lines instead.
    console.width = max(console.width, Console(width=10_000).measure(table).maximum)
    console.print(Text(head, "bold"), soft_wrap=True)
    console.print(table)
