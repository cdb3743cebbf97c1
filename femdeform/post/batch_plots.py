"""Plots of a study: the numbers of its runs against the keys that are varied."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.errors import MissingDependencyError
from femdeform.run.batch_index import StudyTable
from femdeform.run.batch_plan import shown_value
from femdeform.types import FloatArray

# Numbers of a result that depend on the computer, or say little about the outcome.
_COSTS = ("steps", "wall_seconds", "threads")
_MAX_PANELS = 9
# More curves than this in one panel cannot be told apart.
_MAX_CURVES = 8
_MAX_KEYS = 4
_COLUMNS = 3
_PANEL = (4.4, 3.1)
_COLOURS = ("#2f6690", "#ee6677", "#228833", "#aa3377", "#ccaa33", "#66ccee", "#8a5a3b", "#777777")
# From these ratios of the largest to the smallest value on, an axis is logarithmic.
_LOG_KEY = 15.0
_LOG_SCALAR = 1000.0
# Values that crowd at the low end of their range are spread by ratios; others merely begin close to zero.
_LOW = 0.35


@dataclass(frozen=True)
class _Key:
    """Values of a varied key in the plotted runs: numbers, or numbers of words."""

    label: str
    values: FloatArray
    words: tuple[str, ...] = ()

    @property
    def n_distinct(self) -> int:
        return len(np.unique(self.values))

    def word(self, value: float) -> str:
        return self.words[int(value)] if self.words else f"{value:.6g}"


@dataclass(frozen=True)
class _Scalar:
    label: str
    values: FloatArray


def study_figure(table: StudyTable) -> Any | None:
    """Small panels, a scalar each, over the varied keys; None where there is nothing to compare.

    With one key that varies its values are the axis. With two, the second one is the curves, or, where it has too
    many values for that (a random sample), the second axis with the scalar as the colour. With more, each scalar
    is shown against each key.

    Parameters
    ----------
    table : StudyTable
        The study; runs without a result are left out, as are scalars that are the same in all runs.

    Raises
    ------
    MissingDependencyError
        If matplotlib cannot be imported.
    """
    shown = [index for index, row in enumerate(table.rows) if row.ending.is_finished]
    names = table.short_keys
    keys = [_key(names[key], [table.column(key)[index] for index in shown]) for key in table.keys]
    keys = [key for key in keys if key.n_distinct > 1]
    scalars = [_Scalar(name, _numbers([table.column(name)[index] for index in shown])) for name in table.scalars]
    # What a run takes says less than what comes out of it.
    scalars = sorted(filter(_varies, scalars), key=lambda scalar: scalar.label in _COSTS)
    if not keys or not scalars:
        return None
    # Numbers before words, many values before few: the first key is the axis.
    keys.sort(key=lambda key: (bool(key.words), -key.n_distinct))
    if len(keys) > 2:
        keys = [key for key in keys if not key.words][:_MAX_KEYS] or keys[:1]
        scalars = scalars[: max(1, _MAX_PANELS // len(keys))]
        figure, panels = _new_figure(len(scalars), len(keys))
        for row, scalar in zip(panels, scalars, strict=True):
            for ax, key in zip(row, keys, strict=True):
                _draw_points(ax, key, scalar)
        return figure
    scalars = scalars[:_MAX_PANELS]
    n_columns = min(_COLUMNS, len(scalars))
    figure, panels = _new_figure(-(-len(scalars) // n_columns), n_columns)
    spots = [ax for row in panels for ax in row]
    for ax, scalar in zip(spots, scalars, strict=False):
        if len(keys) == 1:
            _draw_curve(ax, keys[0], scalar, np.arange(len(shown)), _COLOURS[0], "")
            _finish(ax, keys[0], scalar)
        elif keys[1].n_distinct <= _MAX_CURVES:
            _draw_curves(ax, keys[0], keys[1], scalar)
        else:
            _draw_map(figure, ax, keys[0], keys[1], scalar)
    for ax in spots[len(scalars) :]:
        ax.set_visible(False)
    return figure


def _key(label: str, values: Sequence[Any]) -> _Key:
    if all(_is_number(value) for value in values):
        return _Key(label, np.array(values, dtype=np.float64))
    texts = ["(as it is)" if value is None else shown_value(value) for value in values]
    words = tuple(dict.fromkeys(texts))
    return _Key(label, np.array([words.index(text) for text in texts], dtype=np.float64), words)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e300


def _numbers(values: Sequence[Any]) -> FloatArray:
    return np.array([value if _is_number(value) else np.nan for value in values], dtype=np.float64)


def _varies(scalar: _Scalar) -> bool:
    finite = scalar.values[np.isfinite(scalar.values)]
    return finite.size > 1 and bool(np.ptp(finite) > 1e-9 * np.abs(finite).max())


# --------------------------------------------------------------------------------------------------- panels


def _draw_curves(ax: Any, key: _Key, other: _Key, scalar: _Scalar) -> None:
    for position, value in enumerate(np.unique(other.values)):
        rows = np.flatnonzero(other.values == value)
        _draw_curve(ax, key, scalar, rows, _COLOURS[position % len(_COLOURS)], other.word(float(value)))
    _finish(ax, key, scalar)
    ax.legend(title=other.label, frameon=False, fontsize=7, title_fontsize=7)


def _draw_curve(ax: Any, key: _Key, scalar: _Scalar, rows: Any, colour: str, label: str) -> None:
    rows = rows[np.argsort(key.values[rows], kind="stable")]
    style = "none" if key.words else "-"
    ax.plot(
        key.values[rows],
        scalar.values[rows],
        color=colour,
        marker="o",
        markersize=3.5,
        linewidth=1.4,
        linestyle=style,
        label=label,
    )


def _draw_points(ax: Any, key: _Key, scalar: _Scalar) -> None:
    ax.plot(key.values, scalar.values, color=_COLOURS[0], marker="o", markersize=3.0, linestyle="none", alpha=0.75)
    _finish(ax, key, scalar)


def _draw_map(figure: Any, ax: Any, key: _Key, other: _Key, scalar: _Scalar) -> None:
    points = ax.scatter(key.values, other.values, c=scalar.values, s=26, cmap="viridis", edgecolors="none")
    bar = figure.colorbar(points, ax=ax, pad=0.02)
    bar.outline.set_visible(False)
    bar.ax.tick_params(labelsize=7)
    _set_axis(ax, "x", key)
    _set_axis(ax, "y", other)
    ax.set_title(scalar.label, fontsize=9)


def _finish(ax: Any, key: _Key, scalar: _Scalar) -> None:
    _set_axis(ax, "x", key)
    ax.set_ylabel(scalar.label, fontsize=8)
    if _spans(scalar.values, _LOG_SCALAR):
        ax.set_yscale("log")
    else:
        ax.ticklabel_format(axis="y", scilimits=(-3, 4), useMathText=True)


def _set_axis(ax: Any, which: str, key: _Key) -> None:
    getattr(ax, f"set_{which}label")(key.label, fontsize=8)
    if key.words:
        labels = [word if len(word) <= 16 else word[:15] + "…" for word in key.words]
        turned = {"rotation": 30, "ha": "right"} if which == "x" and sum(map(len, labels)) > 28 else {}
        getattr(ax, f"set_{which}ticks")(range(len(labels)), labels, **turned)
    elif _spans(key.values, _LOG_KEY) and np.median(key.values) < _LOW * key.values.max():
        getattr(ax, f"set_{which}scale")("log")
    else:
        getattr(ax, f"{which}axis").get_major_locator().set_params(nbins=5)
        ax.ticklabel_format(axis=which, scilimits=(-3, 4), useOffset=False, useMathText=True)


def _spans(values: FloatArray, ratio: float) -> bool:
    finite = values[np.isfinite(values)]
    return bool(finite.min() > 0.0 and finite.max() >= ratio * finite.min())


def _new_figure(n_rows: int, n_columns: int) -> tuple[Any, list[list[Any]]]:
    try:
        module = importlib.import_module("matplotlib.figure")
    except ImportError as error:
        raise MissingDependencyError(f"plots need matplotlib, which cannot be imported ({error})") from error
    # A Figure by itself, without pyplot, needs no display and leaves nothing open.
    figure = module.Figure(figsize=(_PANEL[0] * n_columns, _PANEL[1] * n_rows), layout="constrained")
    panels = figure.subplots(n_rows, n_columns, squeeze=False).tolist()
    for ax in (ax for row in panels for ax in row):
        ax.grid(True, color="#e4e4e4", linewidth=0.8)
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
        ax.tick_params(labelsize=7)
        for axis in (ax.xaxis, ax.yaxis):
            axis.get_offset_text().set_fontsize(7)
    return figure, panels
