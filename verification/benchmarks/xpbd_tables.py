"""Tables of the XPBD benchmark."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from verification.benchmarks.block import DT, POISSON_RATIO, YOUNGS_MODULUS, stiffness_number
from verification.benchmarks.environment import is_wanted
from verification.benchmarks.newton import NODES_BLOCK
from verification.benchmarks.tables import Findings, Table, add_reasons, megabytes, ratio, seconds, threads_text
from verification.benchmarks.xpbd import KAPPAS, LAWS, LOOKS, METHODS, PEERS, Results

# Milliseconds a sweep on the block of 32^3 nodes, two threads, float64.
AIMS = {"xpbd": 8.0, "b_pxpbd": 12.0, "fp_pxpbd, 1 local": 12.0, "fp_pxpbd, 3 local": 25.0}


def findings(results: Results) -> Findings:
    """Return everything the cases found, as tables and as data."""
    n = results.cells
    summary = (
        f"Unit cube of {n}^3 grid cells ({(n + 1) ** 3:,} nodes, {5 * n**3:,} tetrahedra), E = {YOUNGS_MODULUS:g} Pa, "
        f"Poisson's ratio {POISSON_RATIO:g}, 1000 kg/m^3, x = 0 clamped, let go from a stretch of 10 % under gravity. "
        "float64. Medians; in Markdown with [minimum, maximum]. Each case runs in a process of its own; memory is the "
        "peak of the whole process."
    )
    tables = [_times(results), *(_residuals(results, law) for law in LAWS), _peers(results), _aims(results)]
    tables = [table for table in tables if table.rows or is_wanted(table.title)]
    failures = [
        f"{law}, {method}, {threads} threads: {outcome.reason}"
        for (law, method, threads), outcome in results.sweeps.items()
        if outcome.status == "failed"
    ]
    return Findings(summary, tables, _data(results), failures)


def _threads(results: Results) -> list[int]:
    return sorted({n for _, _, n in results.sweeps}, reverse=True)


def _times(results: Results) -> Table:
    counts = _threads(results)
    table = Table(
        f"A sweep over the cells, {results.cells}^3 cells",
        ["", *map(threads_text, counts), "speed-up", "ns a cell", "colours", "set-up", "memory"],
        notes=["ns a cell: on all threads. set-up: colouring, renumbering and layout."],
    )
    for law in LAWS:
        for method in METHODS:
            found = {n: results.sweeps[law, method, n] for n in counts if (law, method, n) in results.sweeps}
            add_reasons(table, {f"{law}, {method}, {n} threads": outcome for n, outcome in found.items()})
            times = {n: outcome.data["time"] for n, outcome in found.items() if outcome.done}
            if not times:
                continue
            data = found[max(times)].data
            table.rows.append(
                [
                    f"{method}, {law}",
                    *(seconds(times.get(n)) for n in counts),
                    ratio(times.get(1), times[max(times)]) if len(times) > 1 else "-",
                    f"{1e9 * data['time']['median'] / data['n_cells']:.1f}",
                    str(data["colors"]),
                    seconds(data["set_up"]),
                    megabytes(data["memory"]),
                ]
            )
    return table


def _residuals(results: Results, law: str) -> Table:
    table = Table(
        f"Residual after {_list(LOOKS)} sweeps, {law}, {results.cells}^3 cells",
        ["", *(f"kappa = {kappa:g}" for kappa in KAPPAS)],
        notes=[
            "|r| of backward Euler over that of free flight, where sweeps begin; kappa = h^2 E / (rho dx^2). -: not "
            "finite. b_pxpbd: zeta by its rule."
        ],
    )
    for method in METHODS:
        found = [o for key, o in results.sweeps.items() if key[:2] == (law, method) and o.done]
        if found:
            table.rows.append([method, *_rows(found[0].data)])
    return table


def _list(numbers: Iterable[object]) -> str:
    return " / ".join(str(number) for number in numbers)


def _rows(data: dict[str, Any]) -> list[str]:
    """A text for each stiffness number; a dash is not finite."""
    return [_list("-" if r is None else f"{r:.1e}" for r in row) for row in data["reached"]]


def _peers(results: Results) -> Table:
    table = Table(
        f"An iteration beside other codes, {results.cells}^3 cells, dt = {DT:g} s, kappa = "
        f"{stiffness_number(results.cells):.2g}",
        ["", "iteration", "theirs / ours", "threads", *(f"residual, kappa = {kappa:g}" for kappa in KAPPAS)],
        notes=[
            "ours: a sweep of xpbd with neo-Hookean material on as many threads, also beside Newton's VBD. residual: "
            f"after {_list(LOOKS)} iterations, of each code's own law, as in the tables above."
        ],
    )
    for name in PEERS:
        outcome = results.peers.get(name)
        if outcome is None or not outcome.done:
            continue
        data = outcome.data
        own = results.sweeps.get(("neo_hookean", "xpbd", data["threads"]))
        ours = own.data["time"] if own is not None and own.done else None
        times = [seconds(data["iteration"]), ratio(data["iteration"], ours), str(data["threads"])]
        table.rows.append([name, *times, *_rows(data)])
        table.notes += [f"{name}: {note}." for note in data["notes"]]
    add_reasons(table, results.peers)
    return table


def _aims(results: Results) -> Table:
    """What the project set out to reach, beside what was found; nothing depends on it."""
    table = Table("Aims", ["", "aim", "found"])
    # They were set for one block and for two threads.
    if results.cells != NODES_BLOCK:
        return table
    for method, aim in AIMS.items():
        for law in LAWS:
            outcome = results.sweeps.get((law, method, 2))
            if outcome is not None and outcome.done:
                table.rows.append([f"{method}, {law}", f"{aim:g} ms", seconds(outcome.data["time"])])
    return table


def _data(results: Results) -> dict[str, Any]:
    return {
        "cells": results.cells,
        "kappas": list(KAPPAS),
        "looks": list(LOOKS),
        "sweeps": [
            {"law": law, "method": method, "threads": n, **outcome.as_data()}
            for (law, method, n), outcome in results.sweeps.items()
        ],
        "peers": {name: outcome.as_data() for name, outcome in results.peers.items()},
    }
