"""Tables of the material point benchmark."""

from __future__ import annotations

from typing import Any

from verification.benchmarks.child_process import Outcome
from verification.benchmarks.environment import is_wanted
from verification.benchmarks.mpm import COURANT, COURANT_CELLS, DTYPES, POINTS, Results
from verification.benchmarks.mpm_case import DENSITY, DT, MU, PHASES, SAMPLED_PHASES
from verification.benchmarks.mpm_step_case import PHASES as STEP_PHASES
from verification.benchmarks.tables import Findings, Table, add_reasons, megabytes, ratio, seconds, threads_text

# Million points a second of the main case on two threads.
AIMS = {"float64": 5.0, "float32": 7.0}


def findings(results: Results) -> Findings:
    """Return everything the cases found, as tables and as data."""
    summary = (
        f"A cube of {results.points:,} material points, eight a cell, jittered, in a swirling motion, on a grid of "
        f"{results.nodes}^3 cells; mu = lambda = {MU:g} Pa, {DENSITY:g} kg/m^3, dt = {DT:g} s, quadratic splines, "
        "neo-Hookean and APIC where nothing else is said. A step sorts the points by block, brings mass, momentum and "
        "forces to the grid, and goes back. Medians. Each case runs in a process of its own."
    )
    tables = [_main(results), _growth(results), _others(results), _sampled(results), _scenes(results)]
    tables += [_courant(results, dim) for dim in COURANT_CELLS]
    tables += [_peers(results), _aims(results)]
    tables = [table for table in tables if table.rows or (table.notes and is_wanted(table.title))]
    failures = [f"{name}: {o.reason}" for name, o in results.own_cases().items() if o.status == "failed"]
    return Findings(summary, tables, _data(results), failures)


def speed(outcome: Outcome) -> float:
    """Million points a second."""
    return float(outcome.data["n"] / outcome.data["time"]["median"] / 1e6)


def _row(name: str, outcome: Outcome) -> list[Any]:
    data = outcome.data
    parts = [f"{1e3 * data['phases'][phase]:.1f} ms" for phase in PHASES]
    return [name, f"{speed(outcome):.2f}", seconds(data["time"]), *parts, f"{data['momentum']:.0e}"]


_COLUMNS = ["", "million points/s", "step", *PHASES, "momentum"]


def _main(results: Results) -> Table:
    table = Table(
        f"Explicit steps of {results.points:,} points",
        [*_COLUMNS, "memory"],
        notes=["momentum: what its change beside gravity's is, relative, after all steps."],
    )
    for (dtype, threads), outcome in results.main.items():
        name = f"{dtype}, {threads_text(threads)}"
        add_reasons(table, {name: outcome})
        if outcome.done:
            table.rows.append([*_row(name, outcome), megabytes(outcome.data["memory"])])
    return table


def _growth(results: Results) -> Table:
    table = Table("Growth with the number of points", ["points", *DTYPES, *(f"ns a point, {d}" for d in DTYPES)])
    for points in sorted({points for points, _ in results.growth}):
        found = [results.growth.get((points, dtype)) for dtype in DTYPES]
        done = [outcome if outcome is not None and outcome.done else None for outcome in found]
        if not any(done):
            continue
        actual = next(outcome.data["n"] for outcome in done if outcome is not None)
        table.rows.append(
            [
                f"{actual:,}",
                *("-" if o is None else seconds(o.data["time"]) for o in done),
                *("-" if o is None else f"{1e3 / speed(o):.0f}" for o in done),
            ]
        )
    add_reasons(table, {f"{points:,}, {dtype}": outcome for (points, dtype), outcome in results.growth.items()})
    return table


def _others(results: Results) -> Table:
    table = Table(f"Other materials and transfers, {results.points:,} points, float64", _COLUMNS)
    for (law, transfer), outcome in results.others.items():
        add_reasons(table, {f"{law}, {transfer}": outcome})
        if outcome.done:
            table.rows.append(_row(f"{law}, {transfer}", outcome))
    return table


def _sampled(results: Results) -> Table:
    table = Table(
        "Parts of a step with a sampled surface and heat",
        ["", "points", "samples", *SAMPLED_PHASES],
        notes=["stencils: of all points, samples and their mirror images; those of heat are taken from them."],
    )
    for threads, outcome in results.sampled.items():
        name = threads_text(threads)
        add_reasons(table, {name: outcome})
        if outcome.done:
            parts = [f"{1e3 * outcome.data['phases'][phase]:.1f} ms" for phase in SAMPLED_PHASES]
            table.rows.append([name, f"{outcome.data['n']:,}", f"{outcome.data['samples']:,}", *parts])
    return table


def _scenes(results: Results) -> Table:
    """As table 3.2 of the source."""
    table = Table(
        "Parts of a step of scenes, ms",
        ["", "steps", "points", "samples", "nodes", *STEP_PHASES],
        notes=[
            "split: masses and motion of points to their samples, and the stencils of both; to grid, to points: single "
            "transfers, merging included; solve: of the grid, all Newton iterations and passes of contact, which an "
            "explicit step has none of. Medians of the first steps but a fifth."
        ],
    )
    for name, outcome in results.scenes.items():
        add_reasons(table, {name: outcome})
        if outcome.done:
            data = outcome.data
            sizes = [f"{data[key]:,}" for key in ("n", "samples", "nodes")]
            table.rows.append([name, data["scheme"], *sizes, *(f"{1e3 * data['phases'][p]:.1f}" for p in STEP_PHASES)])
    return table


def _courant(results: Results, dim: int) -> Table:
    found = {method: outcome for (d, method), outcome in results.courant.items() if d == dim}
    table = Table(
        f"Iterations of a linear solve to 1e-6 by the Courant number of sound, {dim}D",
        ["", "unknowns", *(f"{number:g}" for number in COURANT)],
        notes=["A drop at rest with its surface; block_cg measures its residual as its preconditioner does."],
    )
    add_reasons(table, found)
    for method, outcome in found.items():
        if outcome.done:
            pairs = zip(outcome.data["iterations"], outcome.data["converged"], strict=True)
            table.rows.append(
                [method, f"{outcome.data['unknowns']:,}", *(str(n) if ok else "fails" for n, ok in pairs)]
            )
    return table


def _peers(results: Results) -> Table:
    table = Table(
        f"Beside Taichi, {results.points:,} points",
        ["", "million points/s", "step", "theirs / ours", "threads"],
        notes=[],
    )
    for dtype, outcome in results.peers.items():
        if not outcome.done:
            continue
        own = results.main.get((dtype, outcome.data["threads"]))
        ours = own.data["time"] if own is not None and own.done else None
        theirs = outcome.data["time"]
        row = [f"Taichi, {dtype}", f"{speed(outcome):.2f}", seconds(theirs), ratio(theirs, ours)]
        table.rows.append([*row, str(outcome.data["threads"])])
        for note in outcome.data["notes"]:
            if f"Taichi: {note}." not in table.notes:
                table.notes.append(f"Taichi: {note}.")
    add_reasons(table, {f"Taichi, {dtype}": outcome for dtype, outcome in results.peers.items()})
    return table


def _aims(results: Results) -> Table:
    """What the project set out to reach, beside what was found; nothing depends on it."""
    table = Table("Aims", ["", "aim", "found"])
    if results.points != POINTS:
        return table
    for dtype, aim in AIMS.items():
        outcome = results.main.get((dtype, 2))
        if outcome is not None and outcome.done:
            table.rows.append([f"million points/s, {dtype}", f"{aim:g}", f"{speed(outcome):.2f}"])
    return table


def _data(results: Results) -> dict[str, Any]:
    return {
        "points": results.points,
        "nodes": results.nodes,
        "main": [{"dtype": d, "threads": n, **o.as_data()} for (d, n), o in results.main.items()],
        "growth": [{"points": n, "dtype": d, **o.as_data()} for (n, d), o in results.growth.items()],
        "others": [{"law": law, "transfer": t, **o.as_data()} for (law, t), o in results.others.items()],
        "sampled": [{"threads": n, **o.as_data()} for n, o in results.sampled.items()],
        "scenes": [{"scene": name, **o.as_data()} for name, o in results.scenes.items()],
        "courant": [{"dim": dim, "method": method, **o.as_data()} for (dim, method), o in results.courant.items()],
        "peers": {dtype: outcome.as_data() for dtype, outcome in results.peers.items()},
    }
