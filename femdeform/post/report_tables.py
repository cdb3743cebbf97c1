"""The tables of a report, as HTML."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

_LABELS = {
    "n_dofs": "degrees of freedom",
    "n_cells": "cells",
    "wall_seconds": "wall time [s]",
    "time": "simulated time [s]",
}
# What has a place of its own on the page, or is for programs.
_ELSEWHERE = {"title", "status", "reason", "versions", "expect", "obstacles", "link_lines", "method", "linear_solver"}
_FIRST = ("steps", "time", "wall_seconds", "n_dofs", "n_cells", "ranks", "threads", "bodies")
_PASSED = ("passed", "ok", "pass")
_VERDICTS = {True: ("pass", "passed"), None: ("open", "not yet")}


def facts_table(facts: Mapping[str, Any]) -> str:
    """What ``result.json`` says of the run as a whole."""
    names = [*(name for name in _FIRST if name in facts), *(n for n in facts if n not in _FIRST)]
    rows = [(_LABELS.get(name, _words(name)), facts[name]) for name in names if name not in _ELSEWHERE]
    return _two_columns(rows)


def numbers_table(history: Mapping[str, NDArray[Any]]) -> str:
    """Totals and extremes over the steps.

    Parameters
    ----------
    history : dict of str to (n_steps,) arrays
        As from `Result.history`.
    """
    rows: list[tuple[str, Any]] = []

    def add(label: str, column: str, reduce: Any) -> None:
        values = history.get(column)
        if values is not None and values.dtype.kind in "if":
            finite = values[np.isfinite(values)]
            if finite.size:
                rows.append((label, reduce(finite).item()))

    add("iterations, total", "iterations", np.sum)
    add("iterations, most in a step", "iterations", np.max)
    add("linear iterations, total", "linear_iterations", np.sum)
    add("largest relative residual", "relative_residual", np.max)
    add("largest divergence [1/s]", "divergence", np.max)
    add("parts of steps, total", "substeps", np.sum)
    add("smallest dt [s]", "dt", np.min)
    return _two_columns(rows)


def settings_table(resolved: Mapping[str, Any]) -> str:
    """Time scheme and solvers of the resolved scene, a row for each key."""
    rows: list[tuple[str, Any]] = [("simulation", resolved["simulation"])] if "simulation" in resolved else []
    for block in ("grid", "boundaries", "time", "solver", "linear_solver", "on_failure"):
        if isinstance(resolved.get(block), Mapping):
            rows += _flat(block, resolved[block])
    return _two_columns(rows)


def versions_table(facts: Mapping[str, Any]) -> str:
    """Versions of the software, in a fold."""
    versions = facts.get("versions")
    if not isinstance(versions, Mapping) or not versions:
        return ""
    rows = [(str(name), version) for name, version in versions.items()]
    return f"<details><summary>versions</summary>{_two_columns(rows)}</details>"


def verdict_table(expect: Any) -> str:
    """Verdicts of the `expect` block; empty where the scene expects nothing.

    Parameters
    ----------
    expect : list of mappings
        As in ``result.json``: `quantity`, `computed`, `expected`, tolerances, and `passed`, None before it is known.
    """
    rows = [row for row in expect if isinstance(row, Mapping)] if isinstance(expect, Sequence) else []
    if not rows:
        return ""
    columns = list(dict.fromkeys(key for row in rows for key in row if key not in _PASSED))
    lines = ["<table><tr>", *(f"<th>{escape(_words(str(c)))}</th>" for c in columns), "<th>verdict</th></tr>"]
    for row in rows:
        passed = next((row[key] for key in _PASSED if key in row), False)
        kind, word = _VERDICTS.get(passed, ("fail", "FAILED"))
        cells = "".join(f"<td>{escape(_text(row.get(column)))}</td>" for column in columns)
        lines.append(f'<tr>{cells}<td class="{kind}">{word}</td></tr>')
    return "\n".join([*lines, "</table>"])


def _flat(prefix: str, block: Mapping[str, Any]) -> list[tuple[str, Any]]:
    rows: list[tuple[str, Any]] = []
    for key, value in block.items():
        if isinstance(value, Mapping):
            rows += _flat(f"{prefix}.{key}", value)
        else:
            rows.append((f"{prefix}.{key}", value))
    return rows


def _two_columns(rows: Sequence[tuple[str, Any]]) -> str:
    if not rows:
        return ""
    # Dotted keys may break after a dot, not in the middle of a word.
    names = [escape(name).replace(".", ".<wbr>") for name, _ in rows]
    values = [escape(_text(value)) for _, value in rows]
    lines = [f"<tr><th>{name}</th><td>{value}</td></tr>" for name, value in zip(names, values, strict=True)]
    return '<table class="facts">\n' + "\n".join(lines) + "\n</table>"


def _text(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key}: {_text(item)}" for key, item in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(_text(item) for item in value)
    return str(value)


def _words(name: str) -> str:
    return name.replace("_", " ")
