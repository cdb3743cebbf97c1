"""Plots of a comparison: one curve a variant, the same colour and mark in every plot."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from functools import partial
from typing import Any

import numpy as np

from femdeform.post.plots import new_figure, positive
from femdeform.run.compare import Comparison
from femdeform.run.compare_trial import RESIDUAL_PARTS
from femdeform.run.compare_variants import REFERENCE
from femdeform.types import FloatArray

_COLOURS = ("#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377", "#ee9944", "#555555")
_DASHES = ("-", "--", "-.", ":")
_MARKS = "osD^vPX*"
_FAR = 100.0
_MARKED = 60  # points up to which each is marked
# How far above the largest first value of all curves an axis of iterations goes: past it a curve has diverged.
_ABOVE = 1e3
_REFERENCE_STYLE: dict[str, Any] = {"color": "#222222", "linestyle": (0, (1, 2)), "linewidth": 1.8, "zorder": 5}


def all_figures(comparison: Comparison) -> dict[str, Callable[[], Any]]:
    """What draws each plot, by the name of its file."""
    figures: dict[str, Callable[[], Any]] = {
        "residual-iterations.png": lambda: residual_figure(comparison, "iteration"),
        "residual-time.png": lambda: residual_figure(comparison, "seconds"),
        "distance-iterations.png": lambda: distance_figure(comparison),
        "energy.png": lambda: energy_figure(comparison),
    }
    if comparison.split_labels:
        figures["residual-parts.png"] = lambda: parts_figure(comparison)
    if comparison.facts["steps"] > 1:
        figures["steps.png"] = lambda: steps_figure(comparison)
    return figures


def residual_figure(comparison: Comparison, against: str) -> Any:
    """Relative residual within the first step, which all begin at the same state.

    Parameters
    ----------
    comparison : Comparison
        What to draw.
    against : str
        ``iteration`` or ``seconds``.
    """
    figure, (ax,) = new_figure(1)
    _draw_iterations(ax, comparison, against, lambda row: row["relative_residual"])
    ax.set_ylabel("residual over R0 [-]")
    return figure


def parts_figure(comparison: Comparison) -> Any:
    """Primary and secondary residual over the iterations of the first step, of the variants that report them."""
    figure, axes = new_figure(2)
    for ax, column in zip(axes, RESIDUAL_PARTS, strict=True):
        _draw_iterations(ax, comparison, "iteration", partial(_over_scale, column), comparison.split_labels)
        ax.set_ylabel(f"{column.removesuffix('_residual')} over R0 [-]")
    axes[0].set_xlabel("")
    axes[1].get_legend().remove()
    return figure


def distance_figure(comparison: Comparison) -> Any:
    """Distance to the reference over the iterations of the first step."""
    figure, (ax,) = new_figure(1)
    _draw_iterations(ax, comparison, "iteration", lambda row: row["distance"])
    ax.set_ylabel("distance to the reference [m]")
    return figure


def energy_figure(comparison: Comparison) -> Any:
    """Total energy over the steps; for a single step, how far the objective is above the reference's."""
    figure, (ax,) = new_figure(1)
    if comparison.facts["steps"] == 1:
        lowest = comparison.reference[0]["objective"]
        _draw_iterations(ax, comparison, "iteration", lambda row: row["objective"] - lowest)
        ax.set_ylabel("objective above the reference's [J]")
        return figure
    _draw_steps(ax, comparison, "total_energy")
    time, reference = _columns(comparison.reference, "time", "total_energy")
    ax.plot(time, reference, label=REFERENCE, **_REFERENCE_STYLE)
    _limit(ax, reference)
    ax.set_xlabel("time [s]")
    ax.set_ylabel("total energy [J]")
    ax.ticklabel_format(axis="y", style="sci", scilimits=(-3, 4))
    ax.legend(frameon=False, fontsize=9)
    return figure


def steps_figure(comparison: Comparison) -> Any:
    """Residual at the end of each step, and distance to the reference, over time."""
    figure, axes = new_figure(2)
    for ax, column, label in zip(
        axes, ("relative_residual", "distance"), ("residual over R0 [-]", "distance [m]"), strict=True
    ):
        _draw_steps(ax, comparison, column)
        _set_log(ax)
        ax.set_ylabel(label)
    axes[-1].set_xlabel("time [s]")
    axes[0].legend(frameon=False, fontsize=9)
    return figure


def _over_scale(column: str, row: Mapping[str, Any]) -> float:
    return float(row.get(column, np.nan)) / float(row["force_scale"])  # iteration 0 is before any solver


def _draw_iterations(
    ax: Any,
    comparison: Comparison,
    against: str,
    value: Callable[[dict[str, Any]], float],
    shown: Container[str] | None = None,
) -> None:
    """A curve for each variant, or each one shown."""
    first = min(row["step"] for row in comparison.iterations)
    for number, label in enumerate(comparison.labels):
        if shown is not None and label not in shown:
            continue
        rows = [row for row in comparison.iterations if row["variant"] == label and row["step"] == first]
        x = np.array([row[against] for row in rows], dtype=np.float64)
        y = positive(np.array([value(row) for row in rows], dtype=np.float64))
        ax.plot(x, y, label=label, **_style(number, len(rows)))
    _set_log(ax)
    _cut_off(ax)
    if against == "iteration":
        ax.xaxis.get_major_locator().set_params(integer=True)
    which = "" if comparison.facts["steps"] == 1 else " of the first step"
    ax.set_xlabel(f"iteration{which}" if against == "iteration" else f"time{which} [s]")
    ax.legend(frameon=False, fontsize=9)


def _draw_steps(ax: Any, comparison: Comparison, column: str) -> None:
    for number, label in enumerate(comparison.labels):
        x, y = _columns(comparison.of(label), "time", column)
        ax.plot(x, y, label=label, **_style(number, len(x)))


def _cut_off(ax: Any) -> None:
    """Leave out of the axis what has grown so far that the other curves would be one line."""
    curves = [np.asarray(line.get_ydata(), dtype=np.float64) for line in ax.lines]
    begins = [curve[np.isfinite(curve)][0] for curve in curves if np.isfinite(curve).any()]
    if begins and max(np.nanmax(curve, initial=0.0) for curve in curves) > _ABOVE * max(begins):
        lowest = min(np.nanmin(curve, initial=np.inf) for curve in curves)
        ax.set_ylim(0.3 * lowest, _ABOVE * max(begins))


def _limit(ax: Any, reference: FloatArray) -> None:
    """Leave out of the axis what is so far from the reference that nothing else could be told apart."""
    reach = _FAR * max(float(np.abs(reference).max()), float(np.ptp(reference)))
    values = np.concatenate([np.asarray(line.get_ydata(), dtype=np.float64) for line in ax.lines])
    values = values[np.isfinite(values)]
    near = values[np.abs(values - reference.mean()) <= reach]
    if near.size < values.size:
        margin = 0.05 * max(float(np.ptp(near)), 1e-3 * reach)
        ax.set_ylim(near.min() - margin, near.max() + margin)


def _columns(rows: list[dict[str, Any]], *names: str) -> list[FloatArray]:
    return [np.array([row[name] for row in rows], dtype=np.float64) for name in names]


def _set_log(ax: Any) -> None:
    if any(np.any(line.get_ydata() > 0.0) for line in ax.lines):
        ax.set_yscale("log")


def _style(number: int, n_points: int) -> dict[str, Any]:
    # Curves may lie on one another: later ones are thinner, with smaller marks, so that each can be seen.
    return {
        "color": _COLOURS[number % len(_COLOURS)],
        "linestyle": _DASHES[number // len(_COLOURS) % len(_DASHES)],
        "linewidth": max(3.0 - 0.5 * number, 1.2),
        "marker": _MARKS[number % len(_MARKS)] if n_points <= _MARKED else "",
        "markersize": max(8.0 - 1.2 * number, 4.0),
        "markerfacecolor": "none",
    }
