"""The PBNG benchmark: sweeps, their growth with the mesh, and the way to a tolerance beside Newton's method."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

from solvers.linear.ksp import load_preset
from verification.benchmarks.cases import Cases
from verification.benchmarks.child_process import Outcome, skipped
from verification.benchmarks.environment import chosen_cells, has_petsc, is_wanted, thread_counts
from verification.benchmarks.machine import available_memory
from verification.benchmarks.newton import CELLS_BLOCK, NODES_BLOCK, newton_presets, reason_to_skip
from verification.benchmarks.tables import Findings, threads_text

LAWS = ("neo_hookean", "fixed_corotated")
PRECISIONS = ("float64", "float32")
# Grid cells along an edge: 16, 32, 64 and 128 nodes.
GROWTH = (15, 31, 63, 127)
LEVELS = (1e-2, 1e-4, 1e-8)
PROBLEMS = {"stretch": "released from the 10 % stretch, dt = 0.01 s", "twist": "twisted block, statics"}
# Sweeps of the budgets, those published for the twisted block, and CG iterations of the Newton steps beside them.
BUDGETS = ((6, 7), (40, 10))
PEER = "newton_vbd.py"

_CASE = "verification.benchmarks.pbng_case"
_BUDGETS = "verification.benchmarks.pbng_budgets"
# Peak of the process per tetrahedron, beside half a gigabyte, measured on 64^3 and 128^3 nodes.
_BYTES_A_CELL, _BYTES = 900.0, 5e8
# A step that has not converged by then is a row with dashes.
_PATIENCE = 120.0
# Tolerances of the linear systems of Newton's method, and of the finish of PBNG.
_TOLERANCES, _FINISH_TOLERANCES = ("1e-6", "1e-4", "1e-3", "1e-2"), ("1e-3", "1e-2")


@dataclass
class Results:
    """Outcomes of all cases; `pbng_tables` makes tables of them.

    Attributes
    ----------
    cells, peer_cells : int
        Grid cells along an edge of the block, and of that of the comparison.
    bandwidth : Outcome
        Copies of large arrays by all threads.
    sweeps : dict
        By law, precision and number of threads.
    growth : dict
        By law and grid cells.
    convergence : dict
        By problem and name of the method.
    budgets : dict
        Equal budgets by problem.
    own, single, peer : Outcome
        Our sweeps on the peer's block, on all threads and on one; the peer.
    """

    cells: int
    peer_cells: int
    bandwidth: Outcome
    sweeps: dict[tuple[str, str, int], Outcome] = field(default_factory=dict)
    growth: dict[tuple[str, int], Outcome] = field(default_factory=dict)
    convergence: dict[str, dict[str, Outcome]] = field(default_factory=dict)
    budgets: dict[str, Outcome] = field(default_factory=dict)
    own: Outcome = field(default_factory=lambda: skipped("not run"))
    single: Outcome = field(default_factory=lambda: skipped("not run"))
    peer: Outcome = field(default_factory=lambda: skipped("not run"))

    def own_cases(self) -> dict[str, Outcome]:
        """Every case of femdeform's own, by a name for people."""
        cases = {"bandwidth": self.bandwidth, "comparison": self.own}
        cases |= {f"budgets, {problem}": outcome for problem, outcome in self.budgets.items()}
        cases |= {f"{law}, {kind}, {n} threads": outcome for (law, kind, n), outcome in self.sweeps.items()}
        cases |= {f"{law}, {cells}^3 cells": outcome for (law, cells), outcome in self.growth.items()}
        for problem, outcomes in self.convergence.items():
            cases |= {f"{problem}, {method}": outcome for method, outcome in outcomes.items()}
        return cases | {"comparison, one thread": self.single}


def run_pbng(cases: Cases) -> Findings:
    """Sweeps, growth, ways to a tolerance, equal budgets, then a peer; see `Benchmark`."""
    from verification.benchmarks import pbng_tables

    chosen = chosen_cells()
    cells, peer_cells = (NODES_BLOCK, CELLS_BLOCK) if chosen is None else (chosen, chosen)
    results = Results(cells, peer_cells, skipped("not asked for"))
    cases.begin(partial(pbng_tables.findings, results))
    if is_wanted("bandwidth"):
        short = {} if chosen is None else {"bytes": 1 << 20}
        results.bandwidth = cases.outcome("bandwidth", _CASE, {"kind": "bandwidth", **short})
        cases.keep()
    for law, precision, threads in product(LAWS, PRECISIONS, thread_counts()):
        name = f"sweeps: {law}, {precision}, {threads_text(threads)}"
        cases.run(results.sweeps, (law, precision, threads), name, _CASE, _sweep(cells, law, precision), threads)
    for law, size in product(LAWS, GROWTH if chosen is None else (chosen, 2 * chosen)):
        name = f"growth: {law}, {(size + 1) ** 3:,} nodes"
        cases.run(results.growth, (law, size), name, _CASE, _sweep(size, law), reason=reason_against_size(size))
    _convergence(results, cases)
    _budgets(results, cases)
    _comparison(results, cases)
    return pbng_tables.findings(results)


def _sweep(cells: int, law: str, precision: str = "float64") -> dict[str, Any]:
    """The case of a sweep. Constraint colours are a figure of the tables only, and slow on the largest block."""
    return {"kind": "sweep", "cells": cells, "law": law, "precision": precision, "constraints": cells < GROWTH[-1]}


def reason_against_size(cells: int) -> str:
    """Why a block is not measured here; empty if it is."""
    needed, there = 5.0 * cells**3 * _BYTES_A_CELL + _BYTES, available_memory()
    if there is not None and needed > there:
        return f"{(cells + 1) ** 3:,} nodes need about {needed / 1e9:.0f} GB, {there / 1e9:.0f} GB are free"
    return ""


def methods(cells: int) -> dict[str, tuple[dict[str, Any], dict[str, Any] | None, str]]:
    """Ways to solve a step: block of the solver, of the linear solver, and why it is not measured, else empty."""
    pbng = {"method": "pbng", "tolerance": 1e-8, "max_iterations": 20_000}
    found: dict[str, tuple[dict[str, Any], dict[str, Any] | None, str]] = {
        "pbng, plain": ({**pbng, "acceleration": "none"}, None, ""),
        "pbng, relaxation 1.7": ({**pbng, "acceleration": "none", "relaxation": 1.7}, None, ""),
        "pbng, chebyshev": ({**pbng, "acceleration": "chebyshev"}, None, ""),
        "pbng, anderson": (pbng, None, ""),
        "pbng, anderson 12, relaxation 1.7": ({**pbng, "window": 12, "relaxation": 1.7}, None, ""),
    }
    newton = {"method": "projected_newton", "tolerance": 1e-8, "max_iterations": 100}
    if not has_petsc():
        direct = {"method": "scipy_direct"}
        reason = "petsc4py is not installed, and SciPy's factors fill memory" if cells > 12 else ""
        return found | {
            "pbng, newton_krylov, scipy": ({**pbng, "finish": "newton_krylov"}, direct, reason),
            "newton, scipy": (newton, direct, reason),
        }
    finish = {**pbng, "finish": "newton_krylov"}
    for name, solver, tolerances in (
        ("pbng, newton_krylov", finish, _FINISH_TOLERANCES),
        ("newton", newton, _TOLERANCES),
    ):
        for preset in newton_presets():
            reason = reason_to_skip(preset, cells)
            if "ksp_rtol" not in load_preset(preset).options:
                linear: dict[str, Any] = {"method": "ksp", "preset": preset}
                found[f"{name}, {preset.removeprefix('newton-')}"] = (solver, linear, reason)
                continue
            for rtol in tolerances:
                linear = {"method": "ksp", "preset": preset, "options": {"ksp_rtol": rtol}}
                found[f"{name}, {preset.removeprefix('newton-')} {rtol}"] = (solver, linear, reason)
    return found


def _convergence(results: Results, cases: Cases) -> None:
    for problem in PROBLEMS:
        outcomes = results.convergence.setdefault(problem, {})
        for name, (solver, linear, reason) in methods(results.cells).items():
            case = {
                "kind": "convergence",
                "cells": results.cells,
                "law": LAWS[0],
                "problem": problem,
                "solver": solver,
                "linear_solver": linear,
                "levels": LEVELS,
                "seconds": _PATIENCE,
            }
            cases.run(outcomes, name, f"to a tolerance: {problem}, {name}", _CASE, case, reason=reason)


def _budgets(results: Results, cases: Cases) -> None:
    linear = {"method": "ksp", "preset": "newton-icc"} if has_petsc() else None
    for problem in PROBLEMS:
        # PBD knows laws whose constraints vanish at rest.
        case = {"kind": "budgets", "cells": results.cells, "law": LAWS[1], "problem": problem, "sweeps": BUDGETS}
        name = f"equal budgets: {problem}"
        cases.run(results.budgets, problem, name, _BUDGETS, {**case, "linear_solver": linear})


def _comparison(results: Results, cases: Cases) -> None:
    if not is_wanted("comparison"):
        return
    with tempfile.TemporaryDirectory(prefix="femdeform-bench-") as folder:
        dump = str(Path(folder, "block.npz"))
        case = {"kind": "dump", "cells": results.peer_cells, "dump": dump}
        results.own = cases.outcome(f"comparison: sweeps, {results.peer_cells}^3 cells", _CASE, case)
        cases.keep()
        results.single = cases.outcome("comparison: one thread", _CASE, case, 1)
        cases.keep()
        results.peer = cases.peer_outcome("comparison: Newton's VBD", PEER, {"block": dump}, results.own)
