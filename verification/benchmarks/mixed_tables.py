"""Everything that the mixed benchmark found, as tables and as data."""

from __future__ import annotations

from typing import Any

from verification.benchmarks import mixed_iteration_tables, mixed_substep_tables
from verification.benchmarks.mixed import DT, METHODS, Results
from verification.benchmarks.mixed_outcomes import quoted, reference_of, variants_of
from verification.benchmarks.tables import Findings, Table, ratio


def findings(results: Results) -> Findings:
    """Return everything the cases found, as tables and as data."""
    summary = (
        f"Mixed variational method. A substep is one step of {DT:g} s of the alternating scheme with one outer and one "
        "inner iteration, the multipliers eliminated (`global_solve: condensed`), after five steps that spin the body "
        "under gravity. Bodies of the paper's Table 1 are held as in its pictures, those that it drops fly freely. "
        "Medians; in Markdown with [minimum, maximum]. Each body runs in a process of its own."
    )
    tables = [
        mixed_substep_tables.substeps(results),
        mixed_substep_tables.beside(results),
        mixed_substep_tables.by_solver(results),
        mixed_substep_tables.saddle(results),
        mixed_iteration_tables.iterations(results),
        mixed_iteration_tables.presets(results),
        mixed_iteration_tables.growth(results),
        mixed_iteration_tables.counts(results),
        _aims(results),
    ]
    failures = [f"{name}: {outcome.reason}" for name, outcome in results.cases().items() if outcome.status == "failed"]
    return Findings(summary, tables, _data(results), failures)


def _aims(results: Results) -> Table:
    """What the project set out to reach, beside what was found; nothing depends on it."""
    table = Table("Aims", ["", "aim", "found"])
    for row in results.rows:
        if row.reference is not None:
            best = mixed_substep_tables.fastest_substep(results.table.get(row.body.name))
            theirs = quoted(1e-3 * sum(row.reference))
            found = "-" if best is None else ratio(theirs, best[1]["sum"])
            table.rows.append([f"substep, {row.body.name}, against C++", "2 x", found])
    for body, outcomes in results.iterations.items():
        newton, mixed = (mixed_iteration_tables.fastest_iteration(outcomes.get(method)) for method in METHODS)
        if newton is None or mixed is None:
            continue
        reference = reference_of(results, body, 0)
        if reference is not None:
            found = ratio(reference, newton[1]["whole"])
            table.rows.append([f"Newton iteration, {body}, against C++", "2.5 x", found])
        share = mixed[1]["whole"]["median"] / newton[1]["whole"]["median"]
        table.rows.append([f"mixed iteration over Newton's, {body}", "at most 1.3", f"{share:.2f}"])
    for (kind, law, modulus), outcome in results.counts.items():
        variants = variants_of(outcome)
        if kind == "twist" and modulus >= 1e8:
            other, aim = "projected", "at most 0.5"
        elif kind == "sag":
            other, aim = "adaptive", "at most 1.5"
        else:
            continue
        label = (
            f"iterations over Newton's ({other}), {mixed_iteration_tables.PROBLEM_NAMES[kind]}, {law}, {modulus:.0e} Pa"
        )
        table.rows.append([label, aim, _share(variants.get("mixed"), variants.get(f"Newton, {other}"))])
    return table


def _share(ours: dict[str, Any] | None, theirs: dict[str, Any] | None) -> str:
    if not ours or not theirs or not (ours["converged"] and theirs["converged"]):
        return "-"
    return f"{ours['iterations'] / theirs['iterations']:.2f}"


def _data(results: Results) -> dict[str, Any]:
    return {
        "table": {
            row.body.name: {
                "mesh": mixed_substep_tables.mesh_name(row),
                "paper_ms": row.paper,
                "reference_ms": row.reference,
                **results.table[row.body.name].as_data(),
            }
            for row in results.rows
            if row.body.name in results.table
        },
        "saddle": None if results.saddle is None else results.saddle.as_data(),
        "iterations": {
            body: {method: outcome.as_data() for method, outcome in outcomes.items()}
            for body, outcomes in results.iterations.items()
        },
        "growth": {
            str(cells): {preset: outcome.as_data() for preset, outcome in outcomes.items()}
            for cells, outcomes in results.growth.items()
        },
        "counts": {
            f"{kind}, {law}, {modulus:g} Pa": outcome.as_data()
            for (kind, law, modulus), outcome in results.counts.items()
        },
    }
