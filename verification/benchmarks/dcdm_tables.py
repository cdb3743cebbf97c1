"""Tables and plots of the benchmark of deep conjugate directions."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from solvers.linear.poisson.guard import DCDM_LIMITS, Watchdog
from verification.benchmarks.dcdm import NUMBERS, STEPS, Results
from verification.benchmarks.dcdm_case import KEPT, TOLERANCE
from verification.benchmarks.tables import Cell, Findings, Table, add_reasons

_TOLERANCES = (1e-4, TOLERANCE)
_COLOURS = ("#4477aa", "#ee6677", "#228833", "#aa3377", "#ccbb44", "#66ccee", "#994f00", "#666666", "#222222")
# The source draws this reduction, where its solves end.
_ENOUGH = 1e-4

# How the default is called.
_TWO_KEPT = f"dcdm, kept {next(name for name, kept in KEPT.items() if kept == 2)}"

Curves = Mapping[str, list[list[float]]]


def findings(results: Results) -> Findings:
    """Return everything the cases found, as tables, plots and data."""
    summary = (
        "Deep conjugate directions. Pressures: smoke past a blob of seven ellipsoids, some steps of one flow; "
        "iterations until the residual is 1e-4 and 1e-6 of the right-hand side, mean of the steps. Heat: one step of "
        "backward Euler, a hot ball in a box whose walls are at zero. Networks: trained in the plane for "
        f"{STEPS} steps on {results.training}^2 voxels, and tried on {results.tests}^2 with the last of the "
        "pressures, closed. Transfer: the source's network, trained so on grids of one size and tried on others. No "
        "solver has a guard here: it may fail."
    )
    tables = [_pressures(results), _heat(results), _networks(results), _transfer(results)]
    named = {f"{grid}, {_word(is_open)}:": o for (grid, is_open), o in results.pressures.items()}
    add_reasons(tables[0], named)
    add_reasons(tables[1], {f"{grid}:": o for grid, o in results.heat.items()})
    add_reasons(tables[2], {f"{name}:": o for name, o in results.networks.items()})
    sizes = {f"trained on {size}^2:": o for size, o in results.transfer.items()}
    add_reasons(tables[3], sizes)
    everything = named | {f"{grid}, heat:": o for grid, o in results.heat.items()} | results.networks | sizes
    failures = [f"{name} {o.reason}" for name, o in everything.items() if o.status == "failed"]
    tables = [table for table in tables if table.rows or table.notes]
    return Findings(summary, tables, _data(results), failures, partial(_plots, results))


def iterations(curve: list[float], tolerance: float) -> int | None:
    """Iterations until the residual is as small as that; None if it never is."""
    below = np.flatnonzero(np.array(curve) <= tolerance)
    return int(below[0]) if below.size else None


def _word(is_open: bool) -> str:
    return "open" if is_open else "closed"


def _counts(curves: list[list[float]]) -> str | Cell:
    """Mean iterations to both tolerances."""
    short, long = [], []
    for tolerance in _TOLERANCES:
        counts = [iterations(curve, tolerance) for curve in curves]
        done = [each for each in counts if each is not None]
        if len(done) < len(counts):
            least = max(len(curve) - 1 for curve in curves)
            short.append(f"> {least}")
            long.append(f"{len(counts) - len(done)} of {len(counts)} not in {least}")
        else:
            short.append(f"{statistics.mean(done):.3g}")
            spread = f" +- {statistics.stdev(done):.1f}" if len(set(done)) > 1 else ""
            long.append(short[-1] + spread)
    return Cell(" / ".join(short), " / ".join(long))


def _pressures(results: Results) -> Table:
    done = {key: o.data["curves"] for key, o in results.pressures.items() if o.done}
    names = list(dict.fromkeys(name for curves in done.values() for name in curves))
    table = Table("Pressures: iterations to 1e-4 / 1e-6", ["", *names, "solves the guard would stop"])
    for (grid, is_open), curves in done.items():
        counts = [_counts(curves[n]) if n in curves else "-" for n in names]
        stopped = " / ".join(str(sum(_is_stopped(curve, t) for curve in curves[_TWO_KEPT])) for t in _TOLERANCES)
        table.rows.append([f"{grid}, {_word(is_open)}", *counts, stopped])
    return table


def _is_stopped(curve: list[float], tolerance: float) -> bool:
    """Whether the guard lets another solver go on before the tolerance is met."""
    watchdog = Watchdog(DCDM_LIMITS, 1.0, tolerance, tolerance)
    last = iterations(curve, tolerance)
    return any(watchdog(k, norm) for k, norm in enumerate(curve[1:last], start=1))


def _heat(results: Results) -> Table:
    done = {grid: o.data["curves"] for grid, o in results.heat.items() if o.done}
    names = list(dict.fromkeys(n for curves in done.values() for each in curves.values() for n in each))
    table = Table("Steps of the heat equation: iterations to 1e-4 / 1e-6", ["", "diffusion number", *names])
    for grid, curves in done.items():
        for number in NUMBERS:
            row = curves[f"{number:g}"]
            table.rows.append([str(grid), f"{number:g}", *(_counts(row[n]) for n in names)])
    return table


def _networks(results: Results) -> Table:
    table = Table(
        "Networks: iterations to 1e-4 / 1e-6 by directions kept",
        ["", "parameters", "training, s", "loss", *KEPT],
    )
    for name, o in results.networks.items():
        if o.done:
            facts = [f"{o.data['n_parameters']:,}", f"{o.data['seconds']:.0f}", f"{o.data['loss']:.3f}"]
            table.rows.append([name, *facts, *(_counts(o.data["curves"][kept]) for kept in KEPT)])
    return table


def _transfer(results: Results) -> Table:
    done = {size: o.data for size, o in results.transfer.items() if o.done}
    tests = list(dict.fromkeys(cells for data in done.values() for cells in data["curves"]))
    table = Table(
        "Transfer: iterations to 1e-4 / 1e-6 by the grid, two directions kept",
        ["trained on", "training, s", "loss", *(f"{cells}^2" for cells in tests)],
    )
    for size, data in done.items():
        facts = [f"{size}^2", f"{data['seconds']:.0f}", f"{data['loss']:.3f}"]
        table.rows.append([*facts, *(_counts(data["curves"][cells]) for cells in tests)])
    return table


def _plots(results: Results) -> dict[str, bytes]:
    """Residual against iteration; none without matplotlib."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return {}
    from femdeform.post.plots import figure_bytes

    def draw(curves: Curves, title: str, dashed: Curves | None = None) -> bytes:
        figure = Figure(figsize=(6.4, 4.4), layout="constrained")
        ax = figure.add_subplot()
        for number, (name, each) in enumerate(curves.items()):
            colour = _COLOURS[number % len(_COLOURS)]
            middle, low, high = _mean(each)
            steps = np.array([0.7, *range(1, middle.size)])  # a logarithmic axis has no zero
            ax.plot(steps, middle, color=colour, label=name, linewidth=1.4)
            ax.fill_between(steps, low, high, color=colour, alpha=0.2, linewidth=0.0)
            if dashed is not None:
                ax.plot(steps_of(dashed[name][0]), dashed[name][0], "--", color=colour, linewidth=0.9)
        ax.axhline(_ENOUGH, color="#888888", linewidth=0.7, linestyle=":")
        ax.set(xscale="log", yscale="log", xlabel="iteration", ylabel="residual over right-hand side")
        ax.set_title(title, fontsize=10)
        ax.grid(True, which="major", color="#dddddd", linewidth=0.6)
        ax.legend(fontsize=8)
        return figure_bytes(figure, "png")

    def steps_of(curve: list[float]) -> list[float]:
        return [0.7, *range(1, len(curve))]

    found: dict[str, bytes] = {}
    for (grid, is_open), o in results.pressures.items():
        if o.done:
            where = f"blob, {_word(is_open)}, {grid.cells}$^{grid.dim}$ voxels, mean and deviation of {{}} steps"
            name = f"{grid.cells}-{grid.dim}d-{_word(is_open)}"
            kept = {key: each for key, each in o.data["curves"].items() if key.startswith("dcdm")}
            solvers = {key: each for key, each in o.data["curves"].items() if key not in kept or key == _TWO_KEPT}
            title = where.format(len(kept[_TWO_KEPT]))
            found[f"dcdm-solvers-{name}.png"] = draw(solvers, title)
            found[f"dcdm-kept-{name}.png"] = draw(kept, title)
    trained = {name: o.data["curves"] for name, o in results.networks.items() if o.done}
    if trained:
        title = f"blob, {results.tests}$^2$ voxels; two directions kept, dashed: all"
        two_kept, all_kept = ({n: each[k] for n, each in trained.items()} for k in ("2", "all"))
        found["dcdm-networks.png"] = draw(two_kept, title, all_kept)
    sizes = {size: o.data["curves"] for size, o in results.transfer.items() if o.done}
    if sizes:
        cells = list(next(iter(sizes.values())))[-1]
        curves = {f"trained on {size}$^2$ voxels": each[cells] for size, each in sizes.items()}
        found["dcdm-transfer.png"] = draw(curves, f"blob, {cells}$^2$ voxels, two directions kept")
    for grid, o in results.heat.items():
        if o.done:
            curves = {
                f"{s}, {n}": each for n, row in o.data["curves"].items() for s, each in row.items() if s != "ic(0)"
            }
            title = f"heat, {grid.cells}$^{grid.dim}$ voxels; solver, diffusion number"
            found[f"dcdm-heat-{grid.cells}-{grid.dim}d.png"] = draw(curves, title)
    return found


def _mean(curves: list[list[float]]) -> tuple[Any, Any, Any]:
    """Mean of the logarithms, as far as the shortest curve goes, and one deviation to both sides."""
    length = min(len(curve) for curve in curves)
    logs = np.log10(np.maximum([curve[:length] for curve in curves], 1e-300))
    middle, width = logs.mean(axis=0), logs.std(axis=0)
    return 10.0**middle, 10.0 ** (middle - width), 10.0 ** (middle + width)


def _data(results: Results) -> dict[str, Any]:
    return {
        "pressures": [{**g._asdict(), "open": is_open, **o.as_data()} for (g, is_open), o in results.pressures.items()],
        "heat": [{**grid._asdict(), **o.as_data()} for grid, o in results.heat.items()],
        "networks": [{"network": name, **o.as_data()} for name, o in results.networks.items()],
        "transfer": [{"trained_on": size, **o.as_data()} for size, o in results.transfer.items()],
    }
