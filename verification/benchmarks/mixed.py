"""The mixed benchmark: a substep of the published scheme, an iteration of the converged one, growth with the mesh."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any

from solvers.linear.ksp import load_preset
from verification.benchmarks.cases import Cases
from verification.benchmarks.child_process import Outcome
from verification.benchmarks.environment import chosen_cells, has_petsc, is_wanted
from verification.benchmarks.mixed_bodies import (
    BEAM_DT,
    ITERATION_BODIES,
    SADDLE_BODY,
    TABLE,
    Body,
    TableRow,
    block,
)
from verification.benchmarks.newton import newton_presets
from verification.benchmarks.tables import Findings

DT = 0.01  # [s], that of Table 1
# 1,715 to 98,415 tetrahedra.
BLOCKS = (7, 10, 14, 19, 27)
BEAM = (12, 4, 4)
METHODS: dict[str, dict[str, Any]] = {
    "newton": {"method": "projected_newton", "hessian": "projected"},
    "mixed": {"method": "mixed_fem"},
}
COUNTED: dict[str, dict[str, Any]] = {
    "Newton, projected": {"method": "projected_newton", "hessian": "projected"},
    "Newton, adaptive": {"method": "projected_newton", "hessian": "adaptive"},
    "mixed": {"method": "mixed_fem"},
}
# Kind of problem, law, Young's modulus [Pa].
PROBLEMS = (
    ("twist", "neo_hookean", 1e5),
    ("twist", "neo_hookean", 1e8),
    ("twist", "corotated", 1e5),
    ("twist", "corotated", 1e8),
    ("sag", "neo_hookean", 1e4),
    ("sag", "corotated", 1e4),
)

_CASE = "verification.benchmarks.mixed_case"
# Of conjugate gradients; the loosest that solves the saddle system is measured.
_TOLERANCES = ("1e-3", "3e-4", "1e-4", "1e-6")
# hypre's multigrid is the faster of the two wherever both are measured; the growth with the mesh shows this one.
_ALL_BUT = ("newton-gamg",)
_GROWTH_PRESETS = ("newton-mumps", "newton-ssor", "newton-hypre", "newton-gamg")
_KKT_TOLERANCE = 1e-3
# The paper's regularisation, without which the nine multipliers of its saddle system are singular.
_PRINTED = {"tikhonov": {"per": "density", "value": 1e-6}}


@dataclass
class Results:
    """Outcomes of all cases; `mixed_tables` makes tables of them.

    Attributes
    ----------
    rows : list of TableRow
        The rows of Table 1 as they were run.
    table : dict
        By name of the row.
    saddle : Outcome or None
        One body with every way to solve the saddle system.
    iterations : dict
        By body and method.
    references : dict
        Seconds of an iteration of Newton's and of the mixed method by body, of the authors' code, where they apply.
    growth : dict
        By cells along an edge and preset.
    counts : dict
        By problem, law and modulus.
    """

    rows: list[TableRow]
    table: dict[str, Outcome] = field(default_factory=dict)
    saddle: Outcome | None = None
    iterations: dict[str, dict[str, Outcome]] = field(default_factory=dict)
    references: dict[str, tuple[float, float]] = field(default_factory=dict)
    growth: dict[int, dict[str, Outcome]] = field(default_factory=dict)
    counts: dict[tuple[str, str, float], Outcome] = field(default_factory=dict)

    def cases(self) -> dict[str, Outcome]:
        """Every case by a name for people."""
        cases = {f"Table 1, {name}": outcome for name, outcome in self.table.items()}
        if self.saddle is not None:
            cases["saddle systems"] = self.saddle
        for body, methods in self.iterations.items():
            cases |= {f"iteration, {body}, {method}": outcome for method, outcome in methods.items()}
        for cells, presets in self.growth.items():
            cases |= {f"{cells}^3 cells, {preset}": outcome for preset, outcome in presets.items()}
        return cases | {f"{kind}, {law}, {E:g} Pa": outcome for (kind, law, E), outcome in self.counts.items()}


def run_mixed(cases: Cases) -> Findings:
    """Substeps of Table 1, saddle systems, iterations, growth, counts of iterations; see `Benchmark`."""
    from verification.benchmarks import mixed_tables

    cells = chosen_cells()
    # Published figures say nothing beside bodies of another size.
    rows = list(TABLE) if cells is None else [TableRow(row.body.small(cells)) for row in TABLE]
    results = Results(rows)
    cases.begin(partial(mixed_tables.findings, results))
    for row in rows:
        case = _substep(row.body, linear_solvers(_ALL_BUT))
        cases.run(results.table, row.body.name, f"Table 1: {row.body.name}", _CASE, case)
    saddle_body = SADDLE_BODY if cells is None else SADDLE_BODY.small(cells)
    if is_wanted(name := f"saddle systems: {saddle_body.name}"):
        case = _substep(saddle_body, linear_solvers(_ALL_BUT) | saddle_solvers())
        results.saddle = cases.outcome(name, _CASE, case)
        cases.keep()
    _iterations(results, cells, cases)
    _growth(results, BLOCKS if cells is None else (cells, cells + 1, cells + 2), cases)
    _counts(results, BEAM if cells is None else (2 * cells, 2, 2), cases)
    return mixed_tables.findings(results)


def linear_solvers(without: tuple[str, ...] = ()) -> dict[str, dict[str, Any]]:
    """Variants of a case, one a linear solver, by preset."""
    if not has_petsc():
        return {"scipy_direct": {"solver": {}, "linear_solver": {"method": "scipy_direct"}}}
    return {preset: _variant(preset) for preset in newton_presets() if preset not in without}


def _variant(preset: str) -> dict[str, Any]:
    is_iterative = "ksp_rtol" in load_preset(preset).options
    return {
        "solver": {},
        "linear_solver": {"method": "ksp", "preset": preset},
        "tolerances": list(_TOLERANCES) if is_iterative else [],
    }


def saddle_solvers() -> dict[str, dict[str, Any]]:
    """Variants of a case, one a way to solve the saddle system with its multipliers."""
    if not has_petsc():
        return {"kkt_direct": {"solver": {"global_solve": "kkt_direct"}, "linear_solver": {"method": "scipy_direct"}}}
    more: dict[str, dict[str, Any]] = {"kkt_direct": {}, "kkt_minres": {}, "kkt_cg": _PRINTED}
    return {
        method: {
            "solver": {"global_solve": method, "kkt_tolerance": _KKT_TOLERANCE, **options},
            "linear_solver": {"method": "ksp"},
        }
        for method, options in more.items()
    }


def _substep(body: Body, variants: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """The case of one substep."""
    return {"kind": "substep", "body": body.case(), "dt": DT, "variants": variants}


def _iterations(results: Results, cells: int | None, cases: Cases) -> None:
    for name, (body, reference) in ITERATION_BODIES.items():
        if cells is None:
            results.references[name] = reference
        chosen = body if cells is None else body.small(cells)
        outcomes = results.iterations.setdefault(name, {})
        for method, solver in METHODS.items():
            variants = {preset: {**variant, "solver": solver} for preset, variant in linear_solvers().items()}
            case = {"kind": "iteration", "body": chosen.case(), "dt": BEAM_DT, "variants": variants}
            cases.run(outcomes, method, f"one iteration: {name}, {method}", _CASE, case)


def _growth(results: Results, blocks: tuple[int, ...], cases: Cases) -> None:
    variants = linear_solvers()
    presets = [preset for preset in _GROWTH_PRESETS if preset in variants] or list(variants)
    for cells in blocks:
        outcomes = results.growth.setdefault(cells, {})
        for preset in presets:
            # A process for each: its memory is the factors' or the preconditioner's.
            variant = {**variants[preset], "tolerances": variants[preset].get("tolerances", [])[-1:]}
            name = f"growth: {5 * cells**3:,} tetrahedra, {preset}"
            cases.run(outcomes, preset, name, _CASE, _substep(block(cells), {preset: variant}))


def _counts(results: Results, beam: tuple[int, int, int], cases: Cases) -> None:
    linear_solver = {"method": "ksp", "preset": "newton-mumps"} if has_petsc() else {"method": "scipy_direct"}
    variants = {name: {**solver, "tolerance": 1e-9, "max_iterations": 300} for name, solver in COUNTED.items()}
    for kind, law, modulus in PROBLEMS:
        case = {
            "kind": "counts",
            "problem": kind,
            "law": law,
            "modulus": modulus,
            "cells": beam,
            "linear_solver": linear_solver,
            "variants": variants,
        }
        name = f"iterations: {kind}, {law}, {modulus:g} Pa"
        cases.run(results.counts, (kind, law, modulus), name, _CASE, case)
