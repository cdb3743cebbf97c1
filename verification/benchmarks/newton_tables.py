"""Tables of the Newton benchmark."""

from __future__ import annotations

from typing import Any

from verification.benchmarks.block import DT, YOUNGS_MODULUS, stiffness_number
from verification.benchmarks.child_process import Outcome
from verification.benchmarks.newton import Results
from verification.benchmarks.tables import Cell, Findings, Table, add_reasons, megabytes, ratio, seconds, threads_text

_PARTS = {
    "energy": "energy",
    "residual": "residual",
    "tangent_projected": "tangent, projected, as CSR values",
    "tangent_exact": "tangent, exact, as CSR values",
    "values": "CSR values into PETSc",
    "all": "residual + tangent into PETSc",
}
_MODES = ("statics", "dynamics")


def findings(results: Results) -> Findings:
    """Return everything the cases found, as tables and as data."""
    n = results.cells
    summary = (
        f"Unit cube of {n}^3 grid cells ({(n + 1) ** 3:,} nodes, {5 * n**3:,} tetrahedra, {3 * (n + 1) ** 3:,} degrees "
        f"of freedom), neo-Hookean, E = {YOUNGS_MODULUS:g} Pa, Poisson's ratio 0.3, 1000 kg/m^3, x = 0 clamped, under "
        f"gravity, stretched by 10 %, sagging, with noise. Dynamics: dt = {DT:g} s, kappa = h^2 E / (rho dx^2) = "
        f"{stiffness_number(n):.3g}. Medians; in Markdown with [minimum, maximum]. Each case runs in a process of its "
        "own; memory is the peak of the whole process."
    )
    tables = [
        _assembly(results),
        *(_iterations(results, mode) for mode in _MODES),
        _ranks(results),
        _comparison(results),
        _aims(results),
    ]
    failures = [f"{name}: {o.reason}" for name, o in results.own_cases().items() if o.status == "failed"]
    return Findings(summary, tables, _data(results), failures)


def _assembly(results: Results) -> Table:
    outcomes = {name: outcome for name, outcome in results.assembly.items() if outcome.done}
    table = Table(
        f"Assembly, {results.cells}^3 cells",
        ["", *(threads_text(outcome.data["threads"]) for outcome in outcomes.values()), "million cells a second"],
    )
    for key, label in _PARTS.items():
        values = [outcome.data[key] for outcome in outcomes.values()]
        if not values or values[0] is None:
            continue
        n_cells = next(iter(outcomes.values())).data["n_cells"]
        rate = f"{n_cells / values[0]['median'] / 1e6:.2f}"
        table.rows.append([label, *(seconds(value) for value in values), rate])
    add_reasons(table, results.assembly)
    return table


def _iterations(results: Results, mode: str) -> Table:
    table = Table(
        f"One Newton iteration, {mode}, {results.cells}^3 cells",
        ["preset", "evaluation", "first solve", "solve", "iteration", "linear steps", "linear residual", "memory"],
        notes=[
            "evaluation: residual and tangent. solve: values into PETSc, set-up and solution, repeated; first solve: "
            "with all that depends on the mesh only. linear steps: of CG, 1 for a direct solver. linear residual: "
            "|K dx + r| / |r|, recomputed. memory: peak of the process, and what of it came with the first solve."
        ],
    )
    outcomes = results.iterations.get(mode, {})
    for preset, outcome in outcomes.items():
        if not outcome.done:
            continue
        data = outcome.data
        repeated = data["repeated"] or {}
        total, before = data["memory"][0], data["memory_before_solve"][0]
        table.rows.append(
            [
                preset,
                seconds(_sum_of_medians(repeated, ("residual", "tangent"))),
                seconds(data["first"]["solve"]),
                seconds(repeated.get("solve")),
                seconds(repeated.get("whole")),
                str(data["iterations"]) if data["converged"] else data["reason"],
                f"{data['relative_residual']:.1e}",
                f"{megabytes(total)} (+{megabytes(total - before)})",
            ]
        )
        if data["converged"] and data["repeated"] is None:
            table.notes.append(f"{preset}: not repeated, because the first iteration took too long.")
    add_reasons(table, outcomes)
    return table


def _sum_of_medians(parts: dict[str, Any], names: tuple[str, ...]) -> float | None:
    return sum(parts[name]["median"] for name in names) if parts else None


def _ranks(results: Results) -> Table:
    table = Table(
        f"Two ranks, one thread each, {results.cells}^3 cells",
        ["preset", "one rank", "two ranks", "speed-up", "of evaluation", "of solve", "linear steps", "memory a rank"],
    )
    for mode in _MODES:
        outcomes = results.ranks.get(mode, {})
        one, two = (_repeated(outcomes.get(n)) for n in (1, 2))
        add_reasons(table, {f"{mode}, {n} ranks": outcome for n, outcome in outcomes.items()})
        if one is None or two is None:
            continue
        evaluate = [_sum_of_medians(parts, ("residual", "tangent")) or 0.0 for parts in (one, two)]
        table.rows.append(
            [
                f"{results.best[mode]}, {mode}",
                seconds(one["whole"]),
                seconds(two["whole"]),
                ratio(one["whole"], two["whole"]),
                f"{evaluate[0] / evaluate[1]:.1f} x",
                ratio(one["solve"], two["solve"]),
                " / ".join(str(outcomes[n].data["iterations"]) for n in (1, 2)),
                " / ".join(megabytes(max(outcomes[n].data["memory"])) for n in (1, 2)),
            ]
        )
    return table


def _repeated(outcome: Outcome | None) -> dict[str, Any] | None:
    if outcome is None or not outcome.done or not outcome.data["converged"]:
        return None
    repeated: dict[str, Any] | None = outcome.data["repeated"]
    return repeated


def _comparison(results: Results) -> Table:
    names = [name for name, outcome in results.peers.items() if outcome.done]
    columns = ["", "femdeform"]
    single = results.own.get("single")
    if single is not None:
        columns.append("one thread")
    for name in names:
        columns += [name, f"{name} / ours"]
    table = Table(f"Beside other codes, {results.peer_cells}^3 cells", columns)
    own = _own_times(results)
    rows: dict[str, list[str | Cell]] = {
        "residual": ["residual"],
        "tangent": ["tangent"],
        "both": ["residual + tangent (ours into PETSc)"],
        "iteration": ["Newton iteration, statics, to 1e-6"],
        "memory": ["memory of assembly"],
        "iteration_memory": ["memory of an iteration"],
    }
    for key, row in rows.items():
        is_memory = key.endswith("memory")
        row.append(megabytes(own.get(key)) if is_memory else seconds(own.get(key)))
        if single is not None:
            row.append(seconds(_assembly_times(single).get(key)) if not is_memory else "-")
        for name in names:
            theirs = results.peers[name].data.get(key)
            if is_memory:
                row += [megabytes(theirs), f"{theirs / own[key]:.1f} x" if theirs and own.get(key) else "-"]
            else:
                row += [seconds(theirs), ratio(theirs, own.get(key))]
        table.rows.append(row)
    for name, outcome in results.peers.items():
        table.notes += [f"{name}: {note}" for note in outcome.data.get("notes", [])]
    if results.own.get("iteration") is not None and results.own["iteration"].done:
        steps = results.own["iteration"].data["iterations"]
        table.notes.append(f"femdeform: {results.best['statics']}, {steps} linear steps.")
    add_reasons(table, results.own | results.peers)
    return table


def _assembly_times(outcome: Outcome) -> dict[str, Any]:
    if not outcome.done:
        return {}
    data = outcome.data
    return {"residual": data["residual"], "tangent": data["tangent_projected"], "both": data["all"]}


def _own_times(results: Results) -> dict[str, Any]:
    assembly = results.own.get("assembly")
    own: dict[str, Any] = {}
    if assembly is not None and assembly.done:
        own = _assembly_times(assembly) | {"memory": assembly.data["memory"]}
    repeated = _repeated(results.own.get("iteration"))
    if repeated is not None:
        own["iteration"] = repeated["whole"]
        own["iteration_memory"] = results.own["iteration"].data["memory"][0]
    return own


def _aims(results: Results) -> Table:
    """What the project set out to reach, beside what was found; nothing depends on it."""
    table = Table("Aims", ["", "aim", "found"])
    own = _own_times(results)
    for name, aim in (("FElupe", 5), ("scikit-fem", 40)):
        theirs = results.peers[name].data.get("both") if name in results.peers else None
        label = f"residual + tangent in PETSc, against {name}"
        table.rows.append([label, f"{aim} x", ratio(theirs, own.get("both"))])
    best = results.best.get("statics")
    whole = None if best is None else results.iterations["statics"][best].data["repeated"]["whole"]
    table.rows.append(["Newton iteration to 1e-6, best preset, statics", "1.5 s", seconds(whole)])
    for mode in _MODES:
        one, two = (_repeated(results.ranks.get(mode, {}).get(n)) for n in (1, 2))
        speed_up = "-" if one is None or two is None else ratio(one["whole"], two["whole"])
        table.rows.append([f"two ranks against one, {mode}", "1.6 x", speed_up])
    return table


def _data(results: Results) -> dict[str, Any]:
    return {
        "cells": results.cells,
        "comparison_cells": results.peer_cells,
        "stiffness_number": stiffness_number(results.cells),
        "assembly": {name: outcome.as_data() for name, outcome in results.assembly.items()},
        "iterations": {
            mode: {name: outcome.as_data() for name, outcome in outcomes.items()}
            for mode, outcomes in results.iterations.items()
        },
        "best": results.best,
        "ranks": {
            mode: {str(n): outcome.as_data() for n, outcome in outcomes.items()}
            for mode, outcomes in results.ranks.items()
        },
        "own": {name: outcome.as_data() for name, outcome in results.own.items()},
        "peers": {name: outcome.as_data() for name, outcome in results.peers.items()},
    }
