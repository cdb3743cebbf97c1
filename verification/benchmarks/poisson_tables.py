"""Tables and plots of the Poisson benchmark."""

from __future__ import annotations

import statistics
from functools import partial
from typing import Any

from verification.benchmarks.child_process import Outcome
from verification.benchmarks.poisson import SCENES, TOLERANCES, Grid, Results
from verification.benchmarks.tables import Cell, Findings, Table, add_reasons, megabytes, seconds

_COLOURS = (
    "#4477aa",
    "#66ccee",
    "#228833",
    "#994f00",
    "#ee6677",
    "#aa3377",
    "#ccbb44",
    "#666666",
    "#222222",
    "#bb5500",
    "#117733",
    "#882255",
)


def findings(results: Results) -> Findings:
    """Return everything the cases found, as tables, plots and data."""
    summary = (
        "Pressure systems of flows in a box of n^3 voxels, or a square of n^2 (smoke from a ball of radius 0.12 at its "
        "bottom, against "
        "nothing, a blob of seven ellipsoids or a box that turns; closed, or with a layer of air at the top), "
        "steps 5, 10, 20 and 40 of 1/40 s; and of hard domains with four random smooth velocities each. From zero "
        "to a residual of 1e-4 and 1e-6 of the right-hand side, computed anew at the end. Iterations: mean of the "
        "frames. Times: median of the frames, of each the best of three, or one over half "
        "a second. Each case runs in a process of its own; memory is the peak of the whole process."
    )
    tables: list[Table] = []
    for grid in results.grids:
        tables += [_solves(results, grid, tolerance) for tolerance in TOLERANCES]
        tables += [_set_up(results, grid), _quickest(results, grid)]
    failures = [f"{grid}, {scene}: {o.reason}" for (grid, scene), o in results.records.items() if o.status == "failed"]
    failures += [
        f"{grid}, {scene}, {solver}: {o.reason}"
        for (grid, scene, solver), o in results.solves.items()
        if o.status == "failed"
    ]
    tables = [table for table in tables if table.rows]
    return Findings(summary, tables, _data(results), failures, partial(_plots, results))


def _of(results: Results, grid: Grid) -> dict[tuple[str, str], Outcome]:
    return {(scene, solver): o for (each, scene, solver), o in results.solves.items() if each == grid}


def _solvers(results: Results, grid: Grid) -> list[str]:
    return list(dict.fromkeys(solver for _, solver in _of(results, grid)))


def _scenes(results: Results, grid: Grid) -> list[str]:
    return [scene for scene in SCENES if any(s == scene for s, _ in _of(results, grid))]


def _solves(results: Results, grid: Grid, tolerance: float) -> Table:
    solvers = _solvers(results, grid)
    table = Table(f"{grid} voxels, to {tolerance:g}: iterations and seconds of a solve", ["", *solvers])
    outcomes = _of(results, grid)
    for scene in _scenes(results, grid):
        row = [_solve(outcomes.get((scene, solver)), tolerance) for solver in solvers]
        if any(entry != "-" for entry in row):
            table.rows.append([scene, *row])
    add_reasons(table, {f"{scene}, {solver}:": o for (scene, solver), o in outcomes.items()})
    for (scene, solver), o in outcomes.items():
        if o.done and o.data["reasons"]:
            table.notes.append(f"{scene}, {solver}, frames without an answer: {'; '.join(o.data['reasons'])}.")
    return table


def _solve(outcome: Outcome | None, tolerance: float) -> str | Cell:
    if outcome is None or not outcome.done:
        return "-"
    data = outcome.data["tolerances"][f"{tolerance:g}"]
    if None in data["iterations"]:
        return f"{sum(each is None for each in data['iterations'])} of {len(data['iterations'])} failed"
    mean, time = statistics.mean(data["iterations"]), seconds(data["seconds"])
    assert isinstance(time, Cell)
    spread = f" +- {statistics.stdev(data['iterations']):.1f}" if len(set(data["iterations"])) > 1 else ""
    return Cell(f"{mean:.3g} / {time.short}", f"{mean:.3g}{spread} / {time.short}")


def _set_up(results: Results, grid: Grid) -> Table:
    solvers = _solvers(results, grid)
    table = Table(f"{grid} voxels: set-up of a domain, and memory", ["", *solvers])
    outcomes = _of(results, grid)
    for scene in _scenes(results, grid):
        row: list[str | Cell] = []
        for solver in solvers:
            o = outcomes.get((scene, solver))
            if o is None or not o.done:
                row.append("-")
                continue
            text = seconds(o.data["set_up"])
            assert isinstance(text, Cell)
            row.append(f"{text.short}, {megabytes(o.data['memory'])}")
        if any(entry != "-" for entry in row):
            table.rows.append([scene, *row])
    return table


def _quickest(results: Results, grid: Grid) -> Table:
    """Which solver wins, where set-up is paid once and where it is paid for every solve."""
    table = Table(
        f"{grid} voxels: the quickest",
        ["", *(f"to {t:g}, {w}" for t in TOLERANCES for w in ("solve", "set-up and solve"))],
    )
    outcomes = _of(results, grid)
    for scene in _scenes(results, grid):
        done = {solver: o.data for (s, solver), o in outcomes.items() if s == scene and o.done}
        row = []
        for tolerance in TOLERANCES:
            for with_set_up in (False, True):
                times = {
                    solver: data["tolerances"][f"{tolerance:g}"]["seconds"]["median"]
                    + (data["set_up"]["median"] if with_set_up else 0.0)
                    for solver, data in done.items()
                    if None not in data["tolerances"][f"{tolerance:g}"]["iterations"]
                }
                best = min(times, key=lambda solver: times[solver], default="")
                row.append(f"{best}, {seconds(times[best])}" if best else "-")
        if len(done) > 1:
            table.rows.append([scene, *row])
    return table


def _plots(results: Results) -> dict[str, bytes]:
    """Residual against iteration, a picture for each scene and size; none without matplotlib."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return {}
    from femdeform.post.plots import figure_bytes

    found: dict[str, bytes] = {}
    for grid in results.grids:
        outcomes, solvers = _of(results, grid), _solvers(results, grid)
        for scene in _scenes(results, grid):
            curves = {s: outcomes[scene, s].data["residuals"] for s in solvers if _is_done(outcomes, scene, s)}
            if not curves:
                continue
            figure = Figure(figsize=(6.4, 4.4), layout="constrained")
            ax = figure.add_subplot()
            for number, (solver, values) in enumerate(curves.items()):
                dashed = "--" if solver.startswith("petsc") else "-"  # over our own, where they take the same steps
                # The start is drawn at iteration 0.7: a logarithmic axis has no zero.
                colour = _COLOURS[number % len(_COLOURS)]
                ax.plot([0.7, *range(1, len(values))], values, dashed, color=colour, label=solver, linewidth=1.3)
            ax.set_xscale("log")
            ax.set_yscale("log")
            ax.set_xlabel("iteration")
            ax.set_ylabel("residual over right-hand side")
            ax.set_title(f"{scene}, {grid.cells}$^{grid.dim}$ voxels, last frame", fontsize=10)
            ax.grid(True, which="major", color="#dddddd", linewidth=0.6)
            ax.legend(fontsize=8)
            name = scene.replace(" %", "").replace(", ", "-").replace(" ", "-")
            found[f"poisson-{grid.cells}-{grid.dim}d-{name}.png"] = figure_bytes(figure, "png")
    return found


def _is_done(outcomes: dict[tuple[str, str], Outcome], scene: str, solver: str) -> bool:
    outcome = outcomes.get((scene, solver))
    return outcome is not None and outcome.done


def _data(results: Results) -> dict[str, Any]:
    return {
        "tolerances": list(TOLERANCES),
        "systems": [
            {**grid._asdict(), "scene": scene, **outcome.as_data()}
            for (grid, scene), outcome in results.records.items()
        ],
        "solves": [
            {**grid._asdict(), "scene": scene, "solver": solver, **outcome.as_data()}
            for (grid, scene, solver), outcome in results.solves.items()
        ],
    }
