"""Plots of studies: errors over the size with the rates they should have, sweeps against their reference, courses."""

from __future__ import annotations

import importlib
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from femdeform.errors import MissingDependencyError
from femdeform.types import FloatArray
from verification.judgement import Row
from verification.study import StudyResult

_COLOURS = ("#4477aa", "#ee6677", "#228833", "#aa3377", "#ccbb44", "#66ccee", "#994f00", "#666666")
_MARKERS = "osD^vP*X"
_REFERENCE = "#222222"


def figures(studies: Sequence[StudyResult]) -> dict[str, Any]:
    """Figures by name; the variations of a study share one.

    Parameters
    ----------
    studies : sequence of StudyResult
        Of one case.

    Returns
    -------
    dict of str to matplotlib Figure
        A study that left nothing to plot has none.

    Raises
    ------
    MissingDependencyError
        If matplotlib cannot be imported.
    """
    groups: dict[str, list[StudyResult]] = {}
    for study in studies:
        groups.setdefault(study.name.partition("/")[0], []).append(study)
    drawn = {name: _draw(group) for name, group in groups.items()}
    return {name: figure for name, figure in drawn.items() if figure is not None}


def _draw(group: Sequence[StudyResult]) -> Any | None:
    kind = group[0].kind
    if kind == "iteration_sweep":
        return _iteration_figure(group[0])
    if kind == "value":
        return _course_figure(group)
    return _refinement_figure(group) if kind != "parameter_sweep" else _sweep_figure(group)


# ---------------------------------------------------------------------------------------------- refinements


def _refinement_figure(group: Sequence[StudyResult]) -> Any | None:
    """Errors over the size, a panel for each quantity, with the slope in the middle of its band."""
    curves = _curves(group, lambda row: row.error)
    errors = {name: c for name, c in curves.items() if any(np.isfinite(y[y > 0.0]).any() for _, _, y in c)}
    shown = errors or _curves(group, lambda row: row.computed)
    if not shown:
        return None
    figure, axes = _grid(len(shown))
    for ax, (name, lines) in zip(axes, shown.items(), strict=False):
        for k, (label, x, y) in enumerate(lines):
            ax.plot(x, np.where(y > 0.0, y, np.nan) if errors else y, label=label, **_style(k))
        ax.set_xscale("log")
        if errors:
            ax.set_yscale("log")
            for slope in _slopes(group, name):
                _slope_triangle(ax, lines, slope)
        _ticks_at(ax, [x for _, x, _ in lines])
        ax.set_title(name, fontsize=10)
        ax.set_xlabel(group[0].axis)
        ax.set_ylabel("error" if errors else "computed")
    _legend(figure, axes[0])
    return figure


def _curves(group: Sequence[StudyResult], value: Any) -> dict[str, list[tuple[str, FloatArray, FloatArray]]]:
    """Label, sizes and values of each variation, by quantity; only where there are two of them."""
    curves: dict[str, list[tuple[str, FloatArray, FloatArray]]] = {}
    for study in group:
        for name, rows in _by_quantity(study).items():
            x = np.array([row.size for row in rows])
            y = np.array([value(row) for row in rows])
            if np.isfinite(y).sum() > 0 and len(rows) > 1:
                curves.setdefault(name, []).append((study.name.partition("/")[2], x, y))
    return curves


def _by_quantity(study: StudyResult) -> dict[str, list[Row]]:
    rows: dict[str, list[Row]] = {}
    for row in study.rows:
        rows.setdefault(row.quantity, []).append(row)
    return rows


def _slopes(group: Sequence[StudyResult], quantity: str) -> list[float]:
    """Rates in the middle of the bands of a quantity, each once; whole numbers where the middle is close to one."""
    bands = {
        (v.low, v.high)
        for study in group
        for v in study.verdicts
        if v.quantity == quantity and v.judgement == "rate" and math.isfinite(v.low + v.high)
    }
    middles = {0.5 * (low + high) for low, high in bands}
    return sorted({float(round(m)) if abs(m - round(m)) <= 0.25 and round(m) > 0 else round(m, 2) for m in middles})


def _slope_triangle(ax: Any, lines: Sequence[tuple[str, FloatArray, FloatArray]], slope: float) -> None:
    """A triangle of a slope below the lowest curve, at its finest pair."""
    best: tuple[float, float, float] | None = None
    for _, x, y in lines:
        known = np.flatnonzero(np.isfinite(y) & (y > 0.0))
        if known.size > 1:
            fine, coarse = known[-1], known[-2]
            if best is None or y[fine] < best[2]:
                best = (float(x[fine]), float(x[coarse]), float(y[fine]))
    if best is None:
        return
    x0, x1, y0 = best
    y0 *= 0.55
    y1 = y0 * (x1 / x0) ** slope
    ax.plot([x0, x1, x1, x0], [y0, y1, y0, y0], color=_REFERENCE, linewidth=1.0)
    ax.annotate(f"{slope:g}", (x1, math.sqrt(y0 * y1)), (5, 0), textcoords="offset points", fontsize=9, va="center")
    ax.annotate("1", (math.sqrt(x0 * x1), y0), (0, -3), textcoords="offset points", fontsize=9, ha="center", va="top")
    ax.margins(0.12)


def _ticks_at(ax: Any, levels: Sequence[FloatArray]) -> None:
    """Marks of the axis at the levels themselves, where they are few."""
    values = np.unique(np.concatenate(levels))
    values = values[np.isfinite(values)]
    if 0 < values.size <= 8:
        ticker = importlib.import_module("matplotlib.ticker")
        ax.xaxis.set_major_locator(ticker.FixedLocator(values))
        ax.xaxis.set_major_formatter(ticker.FuncFormatter(lambda value, _: f"{value:.3g}"))
        ax.xaxis.set_minor_locator(ticker.NullLocator())


# --------------------------------------------------------------------------------------------------- sweeps


def _sweep_figure(group: Sequence[StudyResult]) -> Any | None:
    """Computed values and references over the parameter, and the errors below; a column for each quantity."""
    names = list(dict.fromkeys(row.quantity for study in group for row in study.rows))
    if not names:
        return None
    figure, columns = _columns(len(names))
    for (upper, lower), name in zip(columns, names, strict=True):
        places: list[FloatArray] = []
        for k, study in enumerate(group):
            rows = _by_quantity(study).get(name, [])
            if not rows:
                continue
            x, is_number = _places(upper, lower, rows)
            places.append(x)
            order = np.argsort(x, kind="stable")
            reference = np.array([row.reference for row in rows])
            computed = np.array([row.computed for row in rows])
            error = np.array([row.error for row in rows])
            dots = {**_style(k), "linestyle": "none"}
            if is_number:
                upper.plot(x[order], reference[order], color=_style(k)["color"], linewidth=1.2, alpha=0.7)
            else:  # nothing lies between one level and the next
                upper.plot(x, reference, color=_REFERENCE, marker="_", markersize=14, linestyle="none")
            upper.plot(x, computed, label=study.name.partition("/")[2], **dots)
            lower.plot(x, np.where(error > 0.0, error, np.nan), **dots)
            if is_number:
                _ticks_at(upper, places)
        if any(line.get_ydata().size and np.isfinite(line.get_ydata()).any() for line in lower.lines):
            lower.set_yscale("log")
        upper.set_title(name, fontsize=10)
        upper.set_ylabel("computed (dots), reference (lines)")
        lower.set_ylabel("error")
        lower.set_xlabel(group[0].axis)
    _legend(figure, columns[0][0])
    return figure


def _places(upper: Any, lower: Any, rows: Sequence[Row]) -> tuple[FloatArray, bool]:
    """Where the levels are on the axis, and whether that is a number of theirs or one after the other."""
    x = np.array([row.size for row in rows])
    if np.isfinite(x).all() and np.unique(x).size == x.size:
        return x, True
    places = np.arange(len(rows), dtype=np.float64)
    for ax in (upper, lower):
        ax.set_xticks(places)
    upper.set_xticklabels([])
    lower.set_xticklabels([row.level for row in rows], rotation=30, ha="right", fontsize=8)
    return places, False


# -------------------------------------------------------------------------------------- courses, iterations


def _course_figure(group: Sequence[StudyResult]) -> Any | None:
    """Measured quantities over time, a panel for each, where a run has enough steps to show any course."""
    names = list(dict.fromkeys(course.measure for study in group for course in study.courses))
    if not names:
        return None
    figure, axes = _grid(len(names))
    for ax, name in zip(axes, names, strict=False):
        for k, study in enumerate(group):
            for course in study.courses:
                if course.measure == name:
                    style = {**_style(k), "marker": "", "linewidth": 1.3}
                    ax.plot(course.times, course.values, label=study.name.partition("/")[2], **style)
        ax.set_title(name, fontsize=10)
        ax.set_xlabel("time [s]")
    _legend(figure, axes[0])
    return figure


def _iteration_figure(study: StudyResult) -> Any | None:
    """Residual against iterations and against seconds, of the last step."""
    labels = list(dict.fromkeys(row.level for row in study.rows))
    if not study.iterations:
        return None
    last = max(row["step"] for row in study.iterations)
    figure, axes = _grid(2)
    for k, label in enumerate(labels):
        rows = [row for row in study.iterations if row["variant"] == label and row["step"] == last]
        residual = np.array([float(row["relative_residual"]) for row in rows])
        residual = np.where(residual > 0.0, residual, np.nan)
        for ax, key in zip(axes, ("iteration", "seconds"), strict=True):
            ax.plot([float(row[key]) for row in rows], residual, label=label, **_style(k))
    for ax, name in zip(axes, ("iteration", "time [s]"), strict=True):
        if any(np.isfinite(line.get_ydata()).any() for line in ax.lines):
            ax.set_yscale("log")
        ax.set_xlabel(name)
        ax.set_ylabel("relative residual")
    axes[0].xaxis.get_major_locator().set_params(integer=True)
    _legend(figure, axes[0])
    return figure


# -------------------------------------------------------------------------------------------------- drawing


def _grid(n_panels: int) -> tuple[Any, list[Any]]:
    """A figure with panels side by side, at most three in a row."""
    n_columns = 2 if n_panels == 4 else min(n_panels, 3)
    n_rows = -(-n_panels // n_columns)
    figure = _figure((3.6 * n_columns + 0.4, 3.3 * n_rows))
    axes = figure.subplots(n_rows, n_columns, squeeze=False).ravel().tolist()
    for ax in axes[n_panels:]:
        ax.set_visible(False)
    for ax in axes:
        _plain(ax)
    return figure, axes[:n_panels]


def _columns(n: int) -> tuple[Any, list[tuple[Any, Any]]]:
    """A figure with columns of two panels over one axis."""
    figure = _figure((3.8 * n + 0.4, 5.0))
    axes = figure.subplots(2, n, sharex="col", squeeze=False, height_ratios=(3, 2))
    for ax in axes.ravel():
        _plain(ax)
    return figure, [(axes[0, k], axes[1, k]) for k in range(n)]


def _figure(size: tuple[float, float]) -> Any:
    try:
        module = importlib.import_module("matplotlib.figure")
    except ImportError as error:
        raise MissingDependencyError(f"plots need matplotlib, which cannot be imported ({error})") from error
    # A Figure by itself, without pyplot, needs no display and leaves nothing open.
    return module.Figure(figsize=size, layout="constrained")


def _plain(ax: Any) -> None:
    ax.grid(True, which="major", color="#e4e4e4", linewidth=0.8)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
    ax.tick_params(which="both", labelsize=8)


def _style(k: int) -> Mapping[str, Any]:
    n = len(_COLOURS)
    return {
        "color": _COLOURS[k % n],
        "marker": _MARKERS[k % len(_MARKERS)],
        "markersize": 4.5,
        "linewidth": 1.4,
        "linestyle": ("-", "--", ":")[k // n % 3],
    }


def _legend(figure: Any, ax: Any) -> None:
    """Names of the curves of a panel below the figure; none where there is nothing to tell apart."""
    handles, labels = ax.get_legend_handles_labels()
    if len(labels) > 1:
        figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=8)
