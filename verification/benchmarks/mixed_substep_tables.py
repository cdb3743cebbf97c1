"""Tables of the mixed benchmark: substeps of the alternating scheme."""

from __future__ import annotations

from typing import Any

from verification.benchmarks.child_process import Outcome
from verification.benchmarks.mixed import Results
from verification.benchmarks.mixed_bodies import TableRow, Times
from verification.benchmarks.mixed_case import PHASES, ROW_TOLERANCE
from verification.benchmarks.mixed_outcomes import variants_of
from verification.benchmarks.tables import Cell, Table, add_reasons, seconds


def solved(outcome: Outcome | None) -> dict[str, dict[str, Any]]:
    """Variants of a substep that brought both block rows to the tolerance, the fastest first."""
    found = {name: variant for name, variant in variants_of(outcome).items() if "times" in variant}
    return dict(sorted(found.items(), key=lambda item: item[1]["sum"]["median"]))


def fastest_substep(outcome: Outcome | None) -> tuple[str, dict[str, Any]] | None:
    """The fastest of `solved`."""
    return next(iter(solved(outcome).items()), None)


def _solver(name: str, variant: dict[str, Any]) -> str:
    short = name.removeprefix("newton-")
    return f"{short}, {variant['tolerance']}" if variant["tolerance"] else short


def mesh_name(row: TableRow) -> str:
    """File or recipe that a row was run with."""
    block = row.body.mesh_block()
    if "file" in block:
        return row.body.file
    return f"recipe {block['recipe']}"


def _phase_cells(variant: dict[str, Any]) -> list[str | Cell]:
    return [seconds(variant["times"][phase]) for phase in PHASES]


def _row_cells(variant: dict[str, Any]) -> list[str | Cell]:
    return [str(variant["linear_iterations"]), f"{variant['momentum']:.0e}", f"{variant['constraint']:.0e}"]


def substeps(results: Results) -> Table:
    """Phases of a substep with the fastest accurate solver of each row."""
    threads = {outcome.data["threads"] for outcome in results.table.values() if outcome.done}
    table = Table(
        f"Table 1, a substep, {' or '.join(map(str, sorted(threads)))} thread{'' if threads == {1} else 's'}",
        [
            "case",
            "mesh",
            "nodes / cells",
            "solver",
            *("assembly", "KKT solve", "rotations, ds", "sum", "whole substep"),
            *("linear steps", "momentum", "constraint"),
        ],
        notes=[
            "mesh: a file published with the paper's code, or a recipe of about the same size. solver: the fastest of "
            f"those that leave both block rows below {ROW_TOLERANCE:g} of their own size, and its tolerance. assembly: "
            "matrix and right-hand side. KKT solve: of the condensed matrix, multipliers included. rotations, ds: also "
            "the local model of the energy. whole substep: also predictor, line search and residual. linear steps: of "
            "CG, 1 for a factorisation. momentum, constraint: residual of either row of the saddle system over the sum "
            "of the sizes of its terms, recomputed from positions and multipliers.",
        ],
    )
    for row in results.rows:
        outcome = results.table.get(row.body.name)
        best = fastest_substep(outcome)
        if outcome is None or best is None:
            continue
        name, variant = best
        table.rows.append(
            [
                row.body.name,
                mesh_name(row),
                f"{outcome.data['n_nodes']:,} / {outcome.data['n_cells']:,}",
                _solver(name, variant),
                *_phase_cells(variant),
                seconds(variant["sum"]),
                seconds(variant["times"]["whole"]),
                *_row_cells(variant),
            ]
        )
    _add_unsolved(table, results.table)
    return table


def _add_unsolved(table: Table, outcomes: dict[str, Outcome]) -> None:
    add_reasons(table, outcomes)
    for name, outcome in outcomes.items():
        for variant_name, variant in variants_of(outcome).items():
            if "reason" in variant:
                table.notes.append(f"{name}, {variant_name}: {variant['reason']}.")
    table.notes += [
        f"{name}: no solver brings both block rows below {ROW_TOLERANCE:g}."
        for name, outcome in outcomes.items()
        if outcome.done and not solved(outcome)
    ]


def beside(results: Results) -> Table:
    """The same beside published figures."""
    table = Table(
        "Table 1, assembly / KKT solve / rotations and ds, beside published figures [ms]",
        ["case", "femdeform", "sum", "paper", "sum", "paper / ours", "C++", "sum", "C++ / ours"],
        notes=[
            "paper: T. Trusty, D. M. Kaufman, D. I. W. Levin, Mixed variational finite elements (2022), Table 1; Apple "
            "M1, 8 cores. C++: the authors' code of that time, one thread of an AMD EPYC at 2 cores; its conjugate "
            "gradients stop after no iteration, with the constraint row wrong by 25 to 307 % of its size. Both are "
            "quoted, other machines did the work.",
        ],
    )
    for row in results.rows:
        best = fastest_substep(results.table.get(row.body.name))
        ours: Times | None = None
        if best is not None:
            times = best[1]["times"]
            ours = (1e3 * times["assembly"]["median"], 1e3 * times["solve"]["median"], 1e3 * times["local"]["median"])
        cells: list[str | Cell] = [row.body.name, *_three(ours)]
        for theirs in (row.paper, row.reference):
            cells += [*_three(theirs), f"{sum(theirs) / sum(ours):.2f} x" if theirs and ours else "-"]
        table.rows.append(cells)
    return table


def _three(times: Times | None) -> list[str]:
    if times is None:
        return ["-", "-"]
    return [" / ".join(f"{value:.3g}" for value in times), f"{sum(times):.3g}"]


def by_solver(results: Results) -> Table:
    """Sums of the phases with every linear solver."""
    names = list(dict.fromkeys(name for outcome in results.table.values() for name in variants_of(outcome)))
    table = Table(
        "Table 1, sum of the three by linear solver (linear steps)",
        ["case", *names],
        notes=[f"*: left a block row above {ROW_TOLERANCE:g} of its size, here the larger one, and was not timed."],
    )
    for row in results.rows:
        variants = variants_of(results.table.get(row.body.name))
        if variants:
            table.rows.append([row.body.name, *(_sum_and_steps(variants.get(name, {})) for name in names)])
    return table


def _sum_and_steps(variant: dict[str, Any]) -> str:
    if "momentum" not in variant:
        return "-"
    steps = f"({variant['linear_iterations']})"
    if "times" not in variant:
        return f"{max(variant['momentum'], variant['constraint']):.0e} {steps} *"
    return f"{1e3 * variant['sum']['median']:.3g} ms {steps}"


def saddle(results: Results) -> Table:
    """One body with every way to solve the saddle system."""
    table = Table(
        "Ways to solve the saddle system, Tet Bunny",
        [
            *("way", "assembly", "KKT solve", "rotations, ds", "sum"),
            *("linear steps", "momentum row", "constraint row"),
        ],
        notes=[
            "newton-...: condensed. kkt_cg needs the regularisation that the paper prints, 1e-6 on densities, and so "
            f"solves another, softer problem. Saddle systems to {ROW_TOLERANCE:g} in both rows."
        ],
    )
    for name, variant in variants_of(results.saddle).items():
        if "times" in variant:
            cells = [*_phase_cells(variant), seconds(variant["sum"]), *_row_cells(variant)]
            table.rows.append([_solver(name, variant), *cells])
        else:
            table.notes.append(f"{name}: {variant.get('reason', 'not accurate enough')}.")
    if results.saddle is not None:
        add_reasons(table, {"Tet Bunny": results.saddle})
    return table
