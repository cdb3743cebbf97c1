"""Tables of the PBNG benchmark."""

from __future__ import annotations

from typing import Any

from verification.benchmarks.block import POISSON_RATIO, YOUNGS_MODULUS, stiffness_number
from verification.benchmarks.child_process import Outcome
from verification.benchmarks.environment import is_wanted
from verification.benchmarks.newton import NODES_BLOCK
from verification.benchmarks.pbng import LEVELS, PROBLEMS, Results
from verification.benchmarks.pbng_case import ANGLE
from verification.benchmarks.tables import Findings, Table, add_reasons, megabytes, ratio, seconds, threads_text

# Table 6.1 of the dissertation, by grid cells along an edge: colours of nodes and constraints, ms an iteration of PBNG
# and of PBD; 64 cores, AMD Ryzen Threadripper PRO 3995WX, corotated.
PUBLISHED = {15: (5, 39, 3.6, 4.1), 31: (5, 39, 28.0, 26.8), 63: (5, 39, 65.0, 137.0), 127: (5, 40, 1520.0, 1080.0)}
# Milliseconds an iteration on the block of 32^3 nodes, two threads, by law and precision.
AIMS = {
    ("neo_hookean", "float64"): 5.0,
    ("fixed_corotated", "float64"): 7.5,
    ("neo_hookean", "float32"): 4.0,
    ("fixed_corotated", "float32"): 6.0,
}
_AIM_THREADS, _AIM_NEWTON = 1.8, 3.0
# What the peer took where it was measured last: Newton 1.8, 32^3 cells, one thread of an AMD EPYC.
_PEER_SECONDS = 0.073


def findings(results: Results) -> Findings:
    """Return everything the cases found, as tables and as data."""
    n = results.cells
    summary = (
        f"Unit cube of {n}^3 grid cells ({(n + 1) ** 3:,} nodes, {5 * n**3:,} tetrahedra), E = {YOUNGS_MODULUS:g} Pa, "
        f"Poisson's ratio {POISSON_RATIO:g}, x = 0 clamped, stretched by 10 %. In dynamics 1000 kg/m^3, dt = 0.01 s, "
        f"kappa = h^2 E / (rho dx^2) = {stiffness_number(n):.3g}. Medians; in Markdown with [minimum, maximum]. Each "
        "case runs in a process of its own; memory is the peak of the whole process."
    )
    tables = [
        _sweeps(results),
        _growth(results),
        *(_convergence(results, problem) for problem in PROBLEMS),
        *(_budgets(results, problem) for problem in PROBLEMS),
        _comparison(results),
        _aims(results),
    ]
    failures = [f"{name}: {o.reason}" for name, o in results.own_cases().items() if o.status == "failed"]
    # Where only some cases were asked for, the tables of the others are empty.
    tables = [table for table in tables if table.rows or is_wanted(table.title)]
    return Findings(summary, tables, _data(results), failures)


def _sweeps(results: Results) -> Table:
    counts = list(dict.fromkeys(n for _, _, n in results.sweeps))
    table = Table(
        f"A plain sweep, {results.cells}^3 cells",
        ["", *(threads_text(n) for n in counts), "speed-up", "bytes a visit", "operations a visit", "GB/s", "Gflop/s"],
        notes=[
            "visit: of a node to one of its tetrahedra. bytes: of the arrays that stream by, all of them over the "
            "visits; neighbours' positions come from the cache and are not counted. operations: additions, "
            "multiplications, divisions and roots, by counting them in the kernels. Both rates are on all threads."
        ],
    )
    for law, precision in dict.fromkeys((law, precision) for law, precision, _ in results.sweeps):
        outcomes = {n: results.sweeps[law, precision, n] for n in counts if (law, precision, n) in results.sweeps}
        add_reasons(table, {f"{law}, {precision}, {threads_text(n)}": o for n, o in outcomes.items()})
        times = {n: outcome.data["time"] for n, outcome in outcomes.items() if outcome.done}
        if counts[0] not in times:
            continue
        data, most = outcomes[counts[0]].data, times[counts[0]]
        visits = data["visits"]
        table.rows.append(
            [
                f"{law}, {precision}",
                *(seconds(times.get(n)) for n in counts),
                ratio(times.get(counts[-1]), most) if len(counts) > 1 else "-",
                f"{data['bytes'] / visits:.0f}",
                f"{data['flops'] / visits:.0f}",
                f"{data['bytes'] / most['median'] / 1e9:.1f}",
                f"{data['flops'] / most['median'] / 1e9:.1f}",
            ]
        )
    if results.bandwidth.done:
        rate, on = results.bandwidth.data["bandwidth"] / 1e9, threads_text(results.bandwidth.data["threads"])
        table.notes.append(f"Copies of large arrays run at {rate:.1f} GB/s, read and written, on {on}.")
    return table


def _growth(results: Results) -> Table:
    table = Table(
        "Growth with the mesh, float64, all threads (Table 6.1 of the dissertation)",
        [
            "",
            "nodes",
            "tetrahedra",
            "colours: nodes",
            "constraints",
            "sweep",
            "ns a visit",
            "colouring",
            "set-up",
            "memory",
            "published: colours",
            "PBNG",
            "PBD",
        ],
        notes=[
            "set-up: colouring, renumbering and layout. memory: with mesh and problem. published: 64 cores, corotated, "
            "milliseconds an iteration."
        ],
    )
    for (law, cells), outcome in results.growth.items():
        if not outcome.done:
            continue
        data, published = outcome.data, PUBLISHED.get(cells)
        colors = data["constraint_colors"]
        table.rows.append(
            [
                law,
                f"{data['n_nodes']:,}",
                f"{data['n_cells']:,}",
                str(data["colors"]),
                "-" if colors is None else str(colors),
                seconds(data["time"]),
                f"{1e9 * data['time']['median'] / data['visits']:.2f}",
                seconds(data["coloring"]),
                seconds(data["set_up"]),
                megabytes(data["memory"]),
                "-" if published is None else f"{published[0]} / {published[1]}",
                "-" if published is None else f"{published[2]:g} ms",
                "-" if published is None else f"{published[3]:g} ms",
            ]
        )
    add_reasons(table, {f"{law}, {cells}^3 cells,": outcome for (law, cells), outcome in results.growth.items()})
    return table


def _convergence(results: Results, problem: str) -> Table:
    table = Table(
        f"To a relative residual, neo-Hookean, {PROBLEMS[problem]}, {results.cells}^3 cells",
        ["", *(f"{level:g}: iterations" if part == 0 else "time" for level in LEVELS for part in (0, 1)), "memory"],
        notes=[
            "iterations: sweeps and Newton steps, with linear iterations in brackets. time: to the first look at the "
            "residual (every 10 sweeps) below the level, in the second of two equal steps."
        ],
    )
    if problem == "twist":
        table.notes.append(
            f"From an even stretch of 10 % and twist of {ANGLE:g} rad, the ends held there; 10 kg/m^3, no gravity."
        )
    outcomes = results.convergence.get(problem, {})
    for name, outcome in outcomes.items():
        if not outcome.done:
            continue
        row = [name]
        for entry in outcome.data["reached"]:
            if entry is None:
                row += ["-", "-"]
                continue
            iterations, linear, taken = entry
            row += [f"{iterations} ({linear})" if linear else str(iterations), f"{taken:.3g} s"]
        table.rows.append([*row, megabytes(outcome.data["memory"])])
        if not outcome.data["converged"]:
            table.notes.append(f"{name}: {outcome.data['reason']}.")
    add_reasons(table, outcomes)
    return table


def fastest(outcomes: dict[str, Outcome], start: str, level: int) -> tuple[str, float] | None:
    """The quickest of the methods whose names begin so, to a level, with its seconds; None if none got there."""
    times = {
        name: outcome.data["reached"][level][2]
        for name, outcome in outcomes.items()
        if name.startswith(start) and outcome.done and outcome.data["reached"][level] is not None
    }
    return min(times.items(), key=lambda item: item[1]) if times else None


def _budgets(results: Results, problem: str) -> Table:
    table = Table(
        f"Equal budgets, fixed corotated, {PROBLEMS[problem]}, {results.cells}^3 cells (Table 6.2 of the dissertation)",
        ["", "time", "iterations", "relative residual", "energy left"],
        notes=[
            "The budget of the other methods is the time that the sweeps of PBNG took; the iteration that has begun is "
            "finished. Newton's method: linear systems get a fixed number of conjugate gradients with incomplete "
            "Cholesky. energy left: of what is to be lost, above 100 % more than at the start."
        ],
    )
    if problem == "twist":
        table.notes.append(
            "PBD in statics: sweeps over infinitely stiff constraints from the same start. XPBD-QS: pseudo-time steps "
            "of 10 sweeps. Published, 64 cores: 6 sweeps or 2 Newton iterations (7 CG) in 170 ms, 40 or 11 (10 CG) in "
            "1.3 s."
        )
    outcome = results.budgets.get(problem)
    if outcome is None:
        return table
    if outcome.done:
        for row in outcome.data["rows"]:
            energy = row["energy"]
            table.rows.append(
                [
                    row["name"],
                    seconds(row["seconds"]),
                    str(row["iterations"]),
                    f"{row['residual']:.1e}",
                    "-" if energy is None else f"{100.0 * energy:.3g} %",
                ]
            )
        table.notes += outcome.data["notes"]
    add_reasons(table, {"equal budgets": outcome})
    return table


def _comparison(results: Results) -> Table:
    table = Table(
        f"An iteration beside Newton's VBD, {results.peer_cells}^3 cells, dynamics", ["", "iteration", "theirs / ours"]
    )
    theirs = results.peer.data.get("iteration")
    for outcome in (results.own, results.single):
        if outcome.done:
            for precision, taken in outcome.data["times"].items():
                name = f"femdeform, {precision}, {threads_text(outcome.data['threads'])}"
                table.rows.append([name, seconds(taken), ratio(theirs, taken)])
    if theirs is not None:
        table.rows.append(["Newton, SolverVBD", seconds(theirs), "-"])
        table.notes += results.peer.data["notes"]
    table.notes.append(
        f"Quoted: {1e3 * _PEER_SECONDS:g} ms an iteration of SolverVBD of Newton 1.8 on 32^3 cells, one thread of an "
        "AMD EPYC; r / r0 = 0.107 after 20 iterations from the 10 % stretch."
    )
    add_reasons(
        table, {"comparison": results.own, "comparison, one thread": results.single, "Newton's VBD": results.peer}
    )
    return table


def _aims(results: Results) -> Table:
    """What the project set out to reach, beside what was found; nothing depends on it."""
    table = Table("Aims", ["", "aim", "found"])
    # They were set for one block and for two threads.
    if results.cells != NODES_BLOCK:
        return table
    counts = list(dict.fromkeys(n for _, _, n in results.sweeps))
    for (law, precision), aim in AIMS.items() if counts[:1] == [2] else ():
        outcome = results.sweeps.get((law, precision, counts[0]))
        if outcome is None:
            continue
        taken = outcome.data["time"] if outcome.done else None
        table.rows.append([f"sweep, {law}, {precision}", f"{aim:g} ms", seconds(taken)])
        alone = results.sweeps.get((law, precision, 1))
        if alone is not None and alone.done:
            table.rows.append([f"threads, {law}, {precision}", f"{_AIM_THREADS:g} x", ratio(alone.data["time"], taken)])
    for problem, outcomes in results.convergence.items():
        for level, aim_text in ((1, f"{_AIM_NEWTON:g} x"), (2, "1 x")):
            ours, theirs = (fastest(outcomes, start, level) for start in ("pbng", "newton"))
            if ours is None or theirs is None:
                continue
            found = f"{theirs[1] / ours[1]:.1f} x ({ours[0]} against {theirs[0]})"
            table.rows.append([f"to {LEVELS[level]:g}, {problem}, against projected Newton", aim_text, found])
    return table


def _data(results: Results) -> dict[str, Any]:
    return {
        "cells": results.cells,
        "comparison_cells": results.peer_cells,
        "bandwidth": results.bandwidth.as_data(),
        "sweeps": [
            {"law": law, "precision": precision, "threads": n, **outcome.as_data()}
            for (law, precision, n), outcome in results.sweeps.items()
        ],
        "growth": [
            {"law": law, "cells": cells, **outcome.as_data()} for (law, cells), outcome in results.growth.items()
        ],
        "levels": list(LEVELS),
        "convergence": {
            problem: {name: outcome.as_data() for name, outcome in outcomes.items()}
            for problem, outcomes in results.convergence.items()
        },
        "budgets": {problem: outcome.as_data() for problem, outcome in results.budgets.items()},
        "own": results.own.as_data(),
        "single": results.single.as_data(),
        "peer": results.peer.as_data(),
    }
