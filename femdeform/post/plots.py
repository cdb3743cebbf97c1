"""Plots of a run over its steps and iterations, as figures."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.errors import MissingDependencyError
from femdeform.types import FloatArray

Columns = dict[str, NDArray[Any]]

_ENERGIES = (
    ("kinetic_energy", "kinetic", "#4477aa"),
    ("elastic_energy", "elastic", "#ee6677"),
    ("link_energy", "links", "#aa3377"),
    ("potential_energy", "potential of the loads", "#228833"),
    ("contact_energy", "contact", "#ccbb44"),
)
_KNOWN = tuple(name for name, _, _ in _ENERGIES)
_FURTHER = ("#66ccee", "#ee9944", "#888888", "#8a5a3b")
_MAX_PANELS = 8  # more make the figure too high
_MAX_CURVES = 12  # steps in the plot of the iterations: more cannot be told apart
MARKED = 60  # points up to which each is marked


def energy_figure(history: Columns) -> Any | None:
    """Kinetic, elastic, potential, further and total energy over time; None where there are no such numbers.

    Parameters
    ----------
    history : dict of str to (n_steps,) arrays
        As from `Result.history`.
    """
    curves = [(numbers_of(history, name), label, colour) for name, label, colour in _ENERGIES]
    others = sorted(name for name in history if name.endswith("_energy") and name not in (*_KNOWN, "total_energy"))
    curves += [
        (numbers_of(history, name), name.removesuffix("_energy").replace("_", " "), _FURTHER[i % len(_FURTHER)])
        for i, name in enumerate(others)
    ]
    known = [curve for curve in curves if np.any(np.isfinite(curve[0]))]
    # A quasistatic run has no kinetic energy, one without loads no potential: lines along zero say nothing.
    present = [curve for curve in known if np.any(curve[0][np.isfinite(curve[0])])] or known
    time = numbers_of(history, "time")
    if not present or not np.any(np.isfinite(time)):
        return None
    figure, axes = new_figure(1)
    marker = "." if len(time) <= MARKED else ""
    for values, label, colour in present:
        axes[0].plot(time, values, color=colour, label=label, marker=marker, linewidth=1.6)
    if len(present) > 1:
        total = numbers_of(history, "total_energy")
        if not np.any(np.isfinite(total)):
            total = np.sum([values for values, _, _ in present], axis=0)
        axes[0].plot(time, total, color="#222222", label="total", linewidth=1.2, linestyle="--")
    axes[0].set_xlabel("time [s]")
    axes[0].set_ylabel("energy [J]")
    axes[0].ticklabel_format(axis="y", style="sci", scilimits=(-3, 4))
    axes[0].legend(frameon=False, fontsize=9)
    return figure


def residual_figure(history: Columns, label: str = "relative residual") -> Any | None:
    """Relative residual at the end of each step, and iterations it took; None where there are no numbers.

    Parameters
    ----------
    history : dict of str to (n_steps,) arrays
        As from `Result.history`.
    label : str
        What the residual is called.
    """
    step, residual = numbers_of(history, "step"), positive(numbers_of(history, "relative_residual"))
    iterations = numbers_of(history, "iterations")
    if not np.any(np.isfinite(residual)) and not np.any(np.isfinite(iterations)):
        return None
    figure, axes = new_figure(2)
    marker = "." if len(step) <= MARKED else ""
    axes[0].plot(step, residual, color="#4477aa", marker=marker, linewidth=1.4)
    if np.any(np.isfinite(residual)):
        axes[0].set_yscale("log")
    axes[0].set_ylabel(label)
    if len(step) <= 400:
        axes[1].bar(step, iterations, color="#66ccee", width=0.8)
    else:
        axes[1].step(step, iterations, color="#4477aa", where="mid", linewidth=1.0)
    axes[1].set_ylabel("iterations")
    axes[1].set_xlabel("step")
    for ax in axes:
        ax.xaxis.get_major_locator().set_params(integer=True)
    axes[1].yaxis.get_major_locator().set_params(integer=True)
    return figure


def iterations_figure(iterations: Columns) -> Any | None:
    """Relative residual over the iterations, a curve for each of some steps; None where there are no numbers.

    Parameters
    ----------
    iterations : dict of str to (n_iterations,) arrays
        As from `Result.iterations`. The attempts of a step that was repeated with a smaller dt are curves of
        their own.
    """
    step, number = numbers_of(iterations, "step"), numbers_of(iterations, "iteration")
    residual = positive(numbers_of(iterations, "relative_residual"))
    if not np.any(np.isfinite(residual)):
        return None
    # A new curve begins where the step changes or the count of iterations starts again.
    begins = np.flatnonzero((np.diff(step) != 0) | (np.diff(number) <= 0)) + 1
    curves = np.split(np.arange(len(step)), begins)
    shown = np.unique(np.linspace(0, len(curves) - 1, min(len(curves), _MAX_CURVES)).round().astype(int))
    figure, axes = new_figure(1)
    colours = importlib.import_module("matplotlib").colormaps["viridis"](np.linspace(0.0, 0.9, len(shown)))
    for colour, position in zip(colours, shown, strict=True):
        rows = curves[position]
        label = f"step {int(step[rows[0]])}"
        axes[0].plot(number[rows], residual[rows], color=colour, marker="o", markersize=3.5, label=label)
    axes[0].set_yscale("log")
    axes[0].set_xlabel("iteration")
    axes[0].set_ylabel("relative residual")
    axes[0].xaxis.get_major_locator().set_params(integer=True)
    axes[0].legend(frameon=False, fontsize=8, ncols=2)
    return figure


def figure_bytes(figure: Any, kind: str) -> bytes:
    """A figure as the bytes of a ``png`` or ``svg`` file, the same ones for the same figure."""
    matplotlib = _matplotlib()
    stream = BytesIO()
    # A fixed salt and no date: a report made twice is the same file.
    with matplotlib.rc_context({"svg.hashsalt": "femdeform"}):
        metadata = {"Date": None} if kind == "svg" else None
        figure.savefig(stream, format=kind, dpi=150, metadata=metadata)
    return stream.getvalue()


def new_figure(n_rows: int) -> tuple[Any, list[Any]]:
    """A figure with a grid, its axes one below the other.

    Raises
    ------
    MissingDependencyError
        If matplotlib cannot be imported.
    """
    _matplotlib()
    # A Figure by itself, without pyplot, needs no display and leaves nothing open.
    figure = importlib.import_module("matplotlib.figure").Figure(
        figsize=(7.0, 3.6 + 1.2 * (n_rows - 1)), layout="constrained"
    )
    axes = figure.subplots(n_rows, 1, sharex=True, squeeze=False)[:, 0].tolist()
    for ax in axes:
        ax.grid(True, color="#e4e4e4", linewidth=0.8)
        ax.set_axisbelow(True)
        ax.spines[["top", "right"]].set_visible(False)
    return figure, axes


def _matplotlib() -> Any:
    try:
        return importlib.import_module("matplotlib")
    except ImportError as error:
        raise MissingDependencyError(f"plots need matplotlib, which cannot be imported ({error})") from error


def measured_figure(history: Columns) -> Any | None:
    """What the scene measures over time, a panel each; None where it measures nothing."""
    names = [name for name in history if name.startswith("measure.")]
    return panels_figure(history, {name: name.removeprefix("measure.") for name in names})


def panels_figure(history: Columns, labels: Mapping[str, str]) -> Any | None:
    """Columns over time, a panel each, one below the other; None where there are no such numbers.

    Parameters
    ----------
    history : dict of str to (n_steps,) arrays
        As from `Result.history`.
    labels : mapping of str to str
        Labels of the axes by the name of the column.
    """
    time = numbers_of(history, "time")
    shown = [name for name in labels if np.any(np.isfinite(numbers_of(history, name)))][:_MAX_PANELS]
    if not shown or not np.any(np.isfinite(time)):
        return None
    figure, axes = new_figure(len(shown))
    marker = "." if len(time) <= MARKED else ""
    for ax, name in zip(axes, shown, strict=True):
        ax.plot(time, numbers_of(history, name), color="#4477aa", marker=marker, linewidth=1.4)
        ax.set_ylabel(labels[name])
        ax.ticklabel_format(axis="y", scilimits=(-3, 4))
    axes[-1].set_xlabel("time [s]")
    return figure


def numbers_of(columns: Columns, name: str) -> FloatArray:
    """A column as numbers; NaN where it is missing or holds text."""
    n_rows = len(next(iter(columns.values()), ()))
    column = columns.get(name)
    if column is None or column.dtype.kind not in "if":
        return np.full(n_rows, np.nan)
    return np.asarray(column, dtype=np.float64)


def positive(values: FloatArray) -> FloatArray:
    """Values for a logarithmic axis: what is not positive is left out."""
    return np.where(values > 0.0, values, np.nan)
