"""Which plots a run of each kind of simulation has, in its report and as files in ``plots/``."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from femdeform.post import plots
from femdeform.post.flow_plots import divergence_figure, pressure_figure, smoke_figure
from femdeform.post.plots import Columns, figure_bytes, iterations_figure, numbers_of, panels_figure
from femdeform.run import atomic
from femdeform.run.result import Result

# Columns of particles that are in other plots, or say how a run went and not what came out of it.
_ELSEWHERE = (
    "step",
    "time",
    "dt",
    "substeps",
    "iterations",
    "linear_iterations",
    "relative_residual",
    "residual_norm",
    "seconds",
    "failed_attempts",
)


class Plot(NamedTuple):
    """A plot of ``history.csv``.

    Attributes
    ----------
    name : str
        Of the file.
    title : str
        Of the section in a report.
    make : callable
        From the columns to a figure; None where the run left no such numbers.
    always : bool
        Whether a report says so where there are no numbers.
    """

    name: str
    title: str
    make: Callable[[Columns], Any | None]
    always: bool = True


def further_figure(history: Columns) -> Any | None:
    """Columns over time that no other plot shows, a panel each; None where there are none."""
    names = [
        name
        for name in history
        if name not in _ELSEWHERE
        and not name.endswith("_energy")
        and not name.startswith("measure.")
        and np.any(np.isfinite(numbers_of(history, name)))
    ]
    return panels_figure(history, {name: name.replace("_", " ") for name in names})


_MEASURED = Plot("measured", "Measured", plots.measured_figure, always=False)
_RESIDUAL = Plot("residual", "Residual", plots.residual_figure)
_ENERGY = Plot("energy", "Energy", plots.energy_figure)
_PLOTS = {
    "deformable": (_ENERGY, _RESIDUAL, _MEASURED),
    "incompressible_flow": (
        Plot("divergence", "Divergence", divergence_figure),
        Plot("pressure", "Pressure solver", pressure_figure),
        Plot("smoke", "Smoke and energy", smoke_figure),
        _MEASURED,
    ),
    "material_points": (
        _ENERGY,
        _RESIDUAL._replace(always=False),
        _MEASURED,
        Plot("further", "Further quantities", further_figure, always=False),
    ),
}


def plots_of(result: Result) -> tuple[Plot, ...]:
    """The plots of a run, by the kind of its simulation."""
    return _PLOTS.get(result.simulation, (_MEASURED,))


def write_plots(result: Path) -> list[Path]:
    """Write the plots of a run into ``plots/``: for deformable bodies ``energy.png`` and ``residual.png``, for smoke
    ``divergence.png``, ``pressure.png``, ``smoke.png``; for a traced run ``iterations.png``.

    Parameters
    ----------
    result : Path
        Result folder.

    Returns
    -------
    list of Path
        Files written; a plot for which the run left no numbers is left out.

    Raises
    ------
    InputError
        If the folder is not a result, or its tables are missing or corrupt.
    MissingDependencyError
        If matplotlib cannot be imported.
    OutputError
        If a file cannot be written.
    """
    opened = Result.open(result)
    figures = {plot.name: plot.make(opened.history) for plot in plots_of(opened)}
    if opened.iterations is not None:
        figures["iterations"] = iterations_figure(opened.iterations)
    folder = opened.folder / "plots"
    atomic.make_folder(folder)
    written = []
    for name, figure in figures.items():
        if figure is not None:
            path = folder / f"{name}.png"
            atomic.write_bytes(path, figure_bytes(figure, "png"))
            written.append(path)
    return written
