"""Tables of the mixed benchmark: iterations and growth with the mesh."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from verification.benchmarks.child_process import Outcome
from verification.benchmarks.mixed import COUNTED, DT, METHODS, Results
from verification.benchmarks.mixed_bodies import BEAM_DT
from verification.benchmarks.mixed_outcomes import reference_of, variants_of
from verification.benchmarks.tables import Cell, Table, add_reasons, megabytes, ratio, seconds

PROBLEM_NAMES = {"twist": "quarter turn in 1/30 s", "sag": "sag under its own weight"}
_FACTORS = "newton-mumps"
# Exponents come from the largest meshes: small ones are all overhead.
_FITTED = 3


def fastest_iteration(outcome: Outcome | None) -> tuple[str, dict[str, Any]] | None:
    """The linear solver with the shortest iteration, and what was measured with it."""
    found = {name: variant for name, variant in variants_of(outcome).items() if "whole" in variant}
    if not found:
        return None
    name = min(found, key=lambda name: float(found[name]["whole"]["median"]))
    return name, found[name]


def iterations(results: Results) -> Table:
    """One iteration of either method with its best linear solver."""
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
            reference = reference_of(results, body, k)
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


def presets(results: Results) -> Table:
    """One iteration with every linear solver."""
    outcomes = {
        f"{body}, {method}": outcome
        for body, methods in results.iterations.items()
        for method, outcome in methods.items()
    }
    names = list(dict.fromkeys(name for outcome in outcomes.values() for name in variants_of(outcome)))
    table = Table("One iteration by linear solver (linear steps)", ["", *names])
    for label, outcome in outcomes.items():
        cells = [label]
        for name in names:
            variant = variants_of(outcome).get(name, {})
            if "whole" in variant:
                cells.append(f"{1e3 * variant['whole']['median']:.3g} ms ({_range(variant['linear_iterations'])})")
            else:
                cells.append(variant.get("reason", "-"))
        table.rows.append([*cells])
    return table


# ------------------------------------------------------------------------------------------- growth


def growth(results: Results) -> Table:
    """A substep on larger and larger meshes."""
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
        found = {name: variants_of(outcome).get(name, {}) for name, outcome in outcomes.items()}
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


def counts(results: Results) -> Table:
    """Iterations of steps of beams."""
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
        variants = variants_of(outcome)
        if not variants:
            continue
        worst = max([worst, *(variant["difference"] for variant in variants.values() if variant["converged"])])
        cells = [
            str(variant["iterations"]) if variant["converged"] else variant["reason"] for variant in variants.values()
        ]
        table.rows.append([PROBLEM_NAMES[kind], law, f"{modulus:.0e}", *cells])
    table.notes.append(f"All converged answers agree within {worst:.0e} of the displacement.")
    add_reasons(table, {f"{kind}, {law}, {E:g} Pa": outcome for (kind, law, E), outcome in results.counts.items()})
    return table
