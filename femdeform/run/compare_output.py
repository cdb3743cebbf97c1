"""The folder of a comparison, and its table on the screen."""

from __future__ import annotations

import contextlib
import csv
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import Any

from femdeform.errors import Fault, InputError
from femdeform.run import atomic
from femdeform.run.compare import Comparison
from femdeform.run.compare_reference import CONVERGED
from femdeform.run.compare_trial import DIVERGED
from femdeform.run.compare_variants import REFERENCE, file_names
from femdeform.run.plain import to_json
from femdeform.run.vtu import VTUWriter

# What the folder's compare.json says it is; another program's file of that name says something else.
_KIND = "femdeform comparison"
_FACTS = "compare.json"
TABLES = ("compare.csv", "iterations.csv")


def claim_folder(folder: Path) -> None:
    """Make sure that a comparison may be written to a folder, before anything is computed.

    Parameters
    ----------
    folder : Path
        Created where it is missing. What an earlier comparison left there stays until the new one is written.

    Raises
    ------
    InputError
        If the folder holds files and none of them says that they are a comparison's.
    OutputError
        If it cannot be written to.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError([Fault(str(folder), 0, "", "is a file; give a folder with --out")])
    facts = _earlier(folder)
    if facts is None and folder.exists() and any(folder.iterdir()):
        message = "holds files that are not of a comparison; give another folder with --out"
        raise InputError([Fault(str(folder), 0, "", message)])
    atomic.make_folder(folder)
    _write_facts(folder, facts or {"status": "running", "files": []})


def abandon_folder(folder: Path) -> None:
    """Remove a claimed folder that nothing was written to; for a comparison that came to nothing."""
    facts = _earlier(folder)
    if facts is not None and not facts.get("files"):
        with contextlib.suppress(OSError):
            (folder / _FACTS).unlink()
            folder.rmdir()


def write_comparison(comparison: Comparison, folder: Path, further: Iterable[str] = ()) -> list[Path]:
    """Write tables, facts and last states.

    Parameters
    ----------
    comparison : Comparison
        What to write.
    folder : Path
        Claimed by `claim_folder`. Files of an earlier comparison there are removed.
    further : iterable of str
        Names of files that others will add to the folder: the next comparison may remove them.

    Returns
    -------
    list of Path
        Files written.

    Raises
    ------
    OutputError
        If a file cannot be written.
    """
    states = state_files(comparison)
    files = [_FACTS, *TABLES, *states.values(), *further]
    atomic.remove_listed(folder, (_earlier(folder) or {}).get("files"), kept=(_FACTS,))
    atomic.remove_leftovers(folder)
    _write_facts(folder, {"status": "running", "files": files})
    atomic.write_text(folder / "compare.csv", _to_csv([*comparison.steps, *comparison.reference]))
    atomic.write_text(folder / "iterations.csv", _to_csv(comparison.iterations))
    writer = VTUWriter(comparison.mesh)
    for label, name in states.items():
        writer.write(folder / name, comparison.of(label)[-1]["time"], comparison.states[label], {})
    facts = {
        "stiffness_number": comparison.stiffness_number,
        **comparison.facts,
        "summary": summary(comparison),
        "notices": comparison.notices,
        "files": files,
    }
    _write_facts(folder, {"status": "done", **facts})
    return [folder / name for name in (_FACTS, *TABLES, *states.values())]


def state_files(comparison: Comparison) -> dict[str, str]:
    """File of the last state of the reference and of every variant that has one, by label."""
    names = file_names(comparison.labels) | {REFERENCE: REFERENCE}
    return {label: f"{names[label]}.vtu" for label in comparison.states}


def _earlier(folder: Path) -> dict[str, Any] | None:
    """Facts of the comparison that a folder holds; None where it holds none."""
    try:
        facts = json.loads((folder / _FACTS).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return facts if isinstance(facts, dict) and facts.get("kind") == _KIND else None


def _write_facts(folder: Path, facts: Mapping[str, Any]) -> None:
    atomic.write_text(folder / _FACTS, to_json({"kind": _KIND, **facts}))


def _to_csv(rows: Sequence[Mapping[str, Any]]) -> str:
    stream = StringIO()
    # What only some of the variants report is empty in the rows of the others.
    names = dict.fromkeys(name for row in rows for name in row)
    writer = csv.DictWriter(stream, fieldnames=list(names), restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue()


# ------------------------------------------------------------------------------------------------- summary


def summary(comparison: Comparison) -> list[dict[str, Any]]:
    """One row a variant, and one of the reference: sums over the steps, and the state after the last one.

    Returns
    -------
    list of dict
        variant, steps, iterations, seconds (sums); relative_residual (the largest of all steps), distance,
        distance_max, total_energy, inverted_cells (after the last step); status, in words.
    """
    rows = []
    for label in [*comparison.labels, REFERENCE]:
        steps = comparison.of(label)
        last = steps[-1]
        # max() would pass over a NaN that is not the first.
        residuals = [row["relative_residual"] for row in steps]
        rows.append(
            {
                "variant": label,
                "steps": len(steps),
                "iterations": sum(row["iterations"] for row in steps),
                "seconds": sum(row["seconds"] for row in steps),
                "relative_residual": math.nan if any(map(math.isnan, residuals)) else max(residuals),
                **{name: last[name] for name in ("distance", "distance_max", "total_energy", "inverted_cells")},
                "status": _status_text(steps),
            }
        )
    return rows


def _status_text(steps: Sequence[Mapping[str, Any]]) -> str:
    last = steps[-1]
    if last["status"] == DIVERGED:
        return f"{DIVERGED} in step {last['step']}: {last['stopped_by']}"
    unfinished = [row for row in steps if row["status"] != CONVERGED]
    if not unfinished:
        return CONVERGED
    kinds = list(dict.fromkeys(row["status"] for row in unfinished))
    text = f"{' or '.join(kinds)} in {len(unfinished)} of {len(steps)} steps" if len(steps) > 1 else kinds[0]
    given_up = [row["stopped_by"] for row in unfinished if row["status"] == "stopped"]
    return f"{text}: {given_up[0]}" if given_up else text


def budget_text(facts: Mapping[str, Any]) -> str:
    """The budget in words."""
    iterations, seconds = facts["budget"]["iterations"], facts["budget"]["seconds"]
    if iterations is None:
        return f"{seconds:g} s a step"
    return f"{iterations} iteration{'s' if iterations != 1 else ''} a step"


def table_text(comparison: Comparison) -> str:
    """The summary as an aligned table, with a line about what was compared above it."""
    facts = comparison.facts
    many = facts["steps"] > 1
    steps = f"{facts['steps']} steps" if many else "1 step"
    head = (
        f"{facts['title'] or facts['scene_file']}: {steps} from t = {facts['start_time']:.6g} s, {budget_text(facts)}, "
        f"kappa = {comparison.stiffness_number:.3g}, {facts['n_dofs']} degrees of freedom"
    )
    residual = "max r/R0" if many else "r/R0"
    titles = ["variant", "iterations", "seconds", residual, "distance [m]", "energy [J]", "status"]
    rows = [titles]
    for row in summary(comparison):
        rows.append(
            [
                row["variant"],
                str(row["iterations"]),
                _number(row["seconds"], ".3g"),
                _number(row["relative_residual"], ".2e"),
                "-" if row["variant"] == REFERENCE else _number(row["distance"], ".2e"),
                _number(row["total_energy"], ".6g"),
                row["status"],
            ]
        )
    widths = [max(len(row[i]) for row in rows) for i in range(len(titles))]
    lines = []
    for texts in rows:
        cells = [
            text.ljust(width) if i in (0, len(titles) - 1) else text.rjust(width)
            for i, (text, width) in enumerate(zip(texts, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    return "\n".join([head, "", lines[0], "  ".join("-" * width for width in widths), *lines[1:]])


def _number(value: float, form: str) -> str:
    return "-" if math.isnan(value) else format(value, form)
