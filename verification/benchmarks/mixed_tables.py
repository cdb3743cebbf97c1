"""Tables of the mixed benchmark."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from verification.benchmarks.child_process import Outcome
from verification.benchmarks.mixed import COUNTED, DT, METHODS, Results
from verification.benchmarks.mixed_bodies import BEAM_DT, TableRow, Times
from verification.benchmarks.mixed_case import PHASES, ROW_TOLERANCE
from verification.benchmarks.run import Findings
from verification.benchmarks.tables import Cell, Table, add_reasons, megabytes, ratio, seconds

_FACTORS = "newton-mumps"
# Exponents come from the largest meshes: small ones are all overhead.
_FITTED = 3
_PROBLEMS = {"twist": "quarter turn in 1/30 s", "sag": "sag under its own weight"}


def findings(results: Results) -> Findings:
    """Return everything the cases found, as tables and as data."""
    summary = (
        f"Mixed variational method. A substep is one step of {DT:g} s of the alternating scheme with one outer and one "
        "inner iteration, the multipliers eliminated (`global_solve: condensed`), after five steps that spin the body "
        "under gravity. Bodies of the paper's Table 1 are held as in its pictures, those that it drops fly freely. "
        "Medians; in Markdown with [minimum, maximum]. Each body runs in a process of its own."
    )
    tables = [
        _substeps(results),
        _beside(results),
        _by_solver(results),
        _saddle(results),
        _iterations(results),
        _presets(results),
        _growth(results),
        _counts(results),
        _aims(results),
    ]
    failures = [f"{name}: {outcome.reason}" for name, outcome in results.cases().items() if outcome.status == "failed"]
    return Findings(summary, tables, _data(results), failures)


# ------------------------------------------------------------------------------------------- substeps


def solved(outcome: Outcome | None) -> dict[str, dict[str, Any]]:
    """Variants of a substep that brought both block rows to the tolerance, the fastest first."""
    found = {name: variant for name, variant in _variants(outcome).items() if "times" in variant}
    return dict(sorted(found.items(), key=lambda item: item[1]["sum"]["median"]))


def _variants(outcome: Outcome | None) -> dict[str, dict[str, Any]]:
    return {} if outcome is None or not outcome.done else outcome.data["variants"]


def _fastest(outcome: Outcome | None) -> tuple[str, dict[str, Any]] | None:
    return next(iter(solved(outcome).items()), None)


def _solver(name: str, variant: dict[str, Any]) -> str:
    short = name.removeprefix("newton-")
    return f"{short}, {variant['tolerance']}" if variant["tolerance"] else short


def _mesh(row: TableRow) -> str:
    block = row.body.mesh_block()
    if "file" in block:
        return row.body.file
    return f"recipe {block['recipe']}"


def _phase_cells(variant: dict[str, Any]) -> list[str | Cell]:
    return [seconds(variant["times"][phase]) for phase in PHASES]


def _row_cells(variant: dict[str, Any]) -> list[str | Cell]:
    return [str(variant["linear_iterations"]), f"{variant['momentum']:.0e}", f"{variant['constraint']:.0e}"]


def _substeps(results: Results) -> Table:
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
        best = _fastest(outcome)
        if outcome is None or best is None:
            continue
        name, variant = best
        table.rows.append(
            [
                row.body.name,
                _mesh(row),
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
        for variant_name, variant in _variants(outcome).items():
            if "reason" in variant:
                table.notes.append(f"{name}, {variant_name}: {variant['reason']}.")
    table.notes += [
        f"{name}: no solver brings both block rows below {ROW_TOLERANCE:g}."
        for name, outcome in outcomes.items()
        if outcome.done and not solved(outcome)
    ]


def _beside(results: Results) -> Table:
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
        best = _fastest(results.table.get(row.body.name))
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


def _by_solver(results: Results) -> Table:
    names = list(dict.fromkeys(name for outcome in results.table.values() for name in _variants(outcome)))
    table = Table(
        "Table 1, sum of the three by linear solver (linear steps)",
        ["case", *names],
        notes=[f"*: left a block row above {ROW_TOLERANCE:g} of its size, here the larger one, and was not timed."],
    )
    for row in results.rows:
        variants = _variants(results.table.get(row.body.name))
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


def _saddle(results: Results) -> Table:
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
    for name, variant in _variants(results.saddle).items():
        if "times" in variant:
            cells = [*_phase_cells(variant), seconds(variant["sum"]), *_row_cells(variant)]
            table.rows.append([_solver(name, variant), *cells])
        else:
            table.notes.append(f"{name}: {variant.get('reason', 'not accurate enough')}.")
    if results.saddle is not None:
        add_reasons(table, {"Tet Bunny": results.saddle})
    return table


# ------------------------------------------------------------------------------------------- iterations


def fastest_iteration(outcome: Outcome | None) -> tuple[str, dict[str, Any]] | None:
    """The linear solver with the shortest iteration, and what was measured with it."""
    found = {name: variant for name, variant in _variants(outcome).items() if "whole" in variant}
    if not found:
        return None
    name = min(found, key=lambda name: float(found[name]["whole"]["median"]))
    return name, found[name]


def _quoted(value: float) -> dict[str, float]:
    return {"median": value, "min": value, "max": value}


def _reference(results: Results, body: str, k: int) -> dict[str, float] | None:
    """Quoted time of an iteration of Newton's (k = 0) or of the mixed method (1)."""
    times = results.references.get(body)
    return None if times is None else _quoted(times[k])


def _iterations(results: Results) -> Table:
    table = Table(
        f"One iteration, neo-Hookean, 1e6 Pa, dt = {BEAM_DT:.4f} s, linear systems to 1e-6",
        ["", "nodes / cells", "solver", "iteration", "linear solve", "linear steps", "C++", "C++ / ours", "/ Newton"],
        notes=[
            "Newton: projected. mixed: converged scheme. The best linear solver of each; evaluation, matrix, linear "
            "solve and line search, medians over the iterations of a step but its first. C++: the authors' code with "
            "CHOLMOD, one thread of an AMD EPYC, quoted."
        ],
    )
    for body, outcomes in results.iterations.items():
        newton = fastest_iteration(outcomes.get("newton"))
        for k, method in enumerate(METHODS):
            outcome = outcomes.get(method)
            best = fastest_iteration(outcome)
            if outcome is None or best is None:
                continue
            preset, variant = best
            steps = variant["linear_iterations"]
            reference = _reference(results, body, k)
            share = f"{variant['whole']['median'] / newton[1]['whole']['median']:.2f}" if newton else "-"
            table.rows.append(
                [
                    f"{body}, {method}",
                    f"{outcome.data['n_nodes']:,} / {outcome.data['n_cells']:,}",
                    preset,
                    seconds(variant["whole"]),
                    seconds(variant["solve"]),
                    _range(steps),
                    "-" if reference is None else seconds(reference["median"]),
                    ratio(reference, variant["whole"]),
                    share,
                ]
            )
        add_reasons(table, {f"{body}, {method}": outcome for method, outcome in outcomes.items()})
    return table


def _range(steps: list[int]) -> str:
    return str(steps[0]) if min(steps) == max(steps) else f"{min(steps)} to {max(steps)}"


def _presets(results: Results) -> Table:
    outcomes = {
        f"{body}, {method}": outcome
        for body, methods in results.iterations.items()
        for method, outcome in methods.items()
    }
    names = list(dict.fromkeys(name for outcome in outcomes.values() for name in _variants(outcome)))
    table = Table("One iteration by linear solver (linear steps)", ["", *names])
    for label, outcome in outcomes.items():
        cells = [label]
        for name in names:
            variant = _variants(outcome).get(name, {})
            if "whole" in variant:
                cells.append(f"{1e3 * variant['whole']['median']:.3g} ms ({_range(variant['linear_iterations'])})")
            else:
                cells.append(variant.get("reason", "-"))
        table.rows.append([*cells])
    return table


# ------------------------------------------------------------------------------------------- growth


def _growth(results: Results) -> Table:
    presets = list(dict.fromkeys(name for outcomes in results.growth.values() for name in outcomes))
    table = Table(
        f"Growth with the mesh: a substep of a clamped cube of 1e6 Pa, dt = {DT:g} s, CG to 1e-6",
        [
            "tetrahedra",
            "assembly",
            "rotations, ds",
            *(f"KKT solve, {preset}" for preset in presets),
            *(f"memory, {preset}" for preset in presets),
        ],
        notes=[
            "KKT solve: with linear steps of CG. memory: what came with stepping, over mesh, pattern and cell blocks. "
            f"exponent: p of tetrahedra^p, from the largest {_FITTED} meshes."
        ],
    )
    columns: dict[str, list[tuple[float, float]]] = {}

    def note(column: str, n: int, value: float) -> None:
        if value > 0.0:
            columns.setdefault(column, []).append((n, value))

    for cells, outcomes in results.growth.items():
        n = 5 * cells**3
        found = {name: _variants(outcome).get(name, {}) for name, outcome in outcomes.items()}
        found = {name: variant for name, variant in found.items() if "times" in variant}
        any_one = next(iter(found.values()), None)
        if any_one is None:
            continue
        row: list[str | Cell] = [f"{n:,}"]
        for phase in ("assembly", "local"):
            row.append(seconds(any_one["times"][phase]))
            note(phase, n, any_one["times"][phase]["median"])
        for name in presets:
            variant = found.get(name)
            if variant is None:
                row.append("-")
                continue
            solve = variant["times"]["solve"]["median"]
            steps = f" ({variant['linear_iterations']})" if variant["tolerance"] else ""
            row.append(f"{1e3 * solve:.3g} ms{steps}")
            note(name, n, solve)
        for name in presets:
            variant = found.get(name)
            grown = variant["memory"] - variant["memory_before"] if variant else 0
            row.append(megabytes(grown) if variant else "-")
            note(f"memory, {name}", n, grown)
        table.rows.append(row)
    keys = ["assembly", "local", *presets, *(f"memory, {name}" for name in presets)]
    table.rows.append(["exponent", *(exponent(columns.get(key, [])) for key in keys)])
    for name in presets:
        if name != _FACTORS and _FACTORS in presets:
            table.notes.append(f"{name} {_overtaking(columns.get(name, []), columns.get(_FACTORS, []))}.")
    add_reasons(
        table,
        {f"{5 * cells**3:,}, {name}": o for cells, outcomes in results.growth.items() for name, o in outcomes.items()},
    )
    return table


def exponent(points: Iterable[tuple[float, float]]) -> str:
    """Slope of log value over log size of the last points."""
    chosen = list(points)[-_FITTED:]
    if len(chosen) < _FITTED:
        return "-"
    sizes, values = np.log(np.array(chosen)).T
    return f"{np.polyfit(sizes, values, 1)[0]:.2f}"


def _overtaking(ours: list[tuple[float, float]], factors: list[tuple[float, float]]) -> str:
    number = crossing(ours, factors)
    if number is None:
        return "does not overtake the factorisation on these meshes"
    if math.isclose(number, 0.0):
        return "is faster than the factorisation on all of these meshes"
    return f"overtakes the factorisation at about {float(f'{number:.2g}'):,.0f} tetrahedra"


def crossing(ours: list[tuple[float, float]], theirs: list[tuple[float, float]]) -> float | None:
    """Size from which our times stay below theirs, between meshes by powers; 0 from the first, None never."""
    both = dict(theirs)
    pairs = [(n, math.log(value / both[n])) for n, value in ours if n in both]
    if not pairs or pairs[-1][1] >= 0.0:
        return None
    last = max((k for k, (_, difference) in enumerate(pairs) if difference >= 0.0), default=-1)
    if last < 0:
        return 0.0
    (n0, d0), (n1, d1) = pairs[last : last + 2]
    return math.exp(math.log(n0) + d0 / (d0 - d1) * math.log(n1 / n0))


# ------------------------------------------------------------------------------------------- counts and aims


def _counts(results: Results) -> Table:
    table = Table(
        "Iterations of one step to 1e-9 of the forces",
        ["beam", "law", "E [Pa]", *COUNTED],
        notes=[
            "1 x 0.25 x 0.25 m, Poisson's ratio 0.45, held at one end. The authors' C++ code, corrected, on its own "
            "beam and to a step below 1e-6: mixed 7, Newton 24 at 1e8 Pa; 7 and 8 at 1e5 Pa (quoted)."
        ],
    )
    worst = 0.0
    for (kind, law, modulus), outcome in results.counts.items():
        variants = _variants(outcome)
        if not variants:
            continue
        worst = max(worst, *(variant["difference"] for variant in variants.values() if variant["converged"]))
        cells = [
            str(variant["iterations"]) if variant["converged"] else variant["reason"] for variant in variants.values()
        ]
        table.rows.append([_PROBLEMS[kind], law, f"{modulus:.0e}", *cells])
    table.notes.append(f"All converged answers agree within {worst:.0e} of the displacement.")
    add_reasons(table, {f"{kind}, {law}, {E:g} Pa": outcome for (kind, law, E), outcome in results.counts.items()})
    return table


def _aims(results: Results) -> Table:
    """What the project set out to reach, beside what was found; nothing depends on it."""
    table = Table("Aims", ["", "aim", "found"])
    for row in results.rows:
        if row.reference is not None:
            best = _fastest(results.table.get(row.body.name))
            theirs = _quoted(1e-3 * sum(row.reference))
            found = "-" if best is None else ratio(theirs, best[1]["sum"])
            table.rows.append([f"substep, {row.body.name}, against C++", "2 x", found])
    for body, outcomes in results.iterations.items():
        newton, mixed = (fastest_iteration(outcomes.get(method)) for method in METHODS)
        if newton is None or mixed is None:
            continue
        reference = _reference(results, body, 0)
        if reference is not None:
            found = ratio(reference, newton[1]["whole"])
            table.rows.append([f"Newton iteration, {body}, against C++", "2.5 x", found])
        share = mixed[1]["whole"]["median"] / newton[1]["whole"]["median"]
        table.rows.append([f"mixed iteration over Newton's, {body}", "at most 1.3", f"{share:.2f}"])
    for (kind, law, modulus), outcome in results.counts.items():
        variants = _variants(outcome)
        if kind == "twist" and modulus >= 1e8:
            other, aim = "projected", "at most 0.5"
        elif kind == "sag":
            other, aim = "adaptive", "at most 1.5"
        else:
            continue
        label = f"iterations over Newton's ({other}), {_PROBLEMS[kind]}, {law}, {modulus:.0e} Pa"
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
                "mesh": _mesh(row),
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
