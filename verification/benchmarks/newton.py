"""The Newton benchmark: assembly, and one Newton iteration with each preset, on one rank, on two, and beside peers."""

from __future__ import annotations

import shutil
import tempfile
from dataclasses import dataclass, field
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from femdeform import jit, registry
from verification.benchmarks.cases import Cases
from verification.benchmarks.child_process import Outcome, skipped
from verification.benchmarks.environment import chosen_cells, has_petsc
from verification.benchmarks.tables import Findings

# 32 nodes along an edge: the block of the position-based literature; 32 cells: the one the peers were measured on.
NODES_BLOCK = 31
CELLS_BLOCK = 32
PEERS = {"FElupe": "felupe_block.py", "scikit-fem": "scikit_fem_block.py"}

_CASE = "verification.benchmarks.newton_case"
_MODES = {"statics": True, "dynamics": False}
# SuperLU's fill grows so fast that the fallback without PETSc is measured on small blocks only.
_SCIPY_CELLS = 20
# Measured growth of nested dissection on this block: factors of 143 bytes n^(4/3) and 5e-10 s n^2 on one core.
_FACTOR_BYTES, _FACTOR_SECONDS = 143.0, 5e-10
_MOST_BYTES, _MOST_SECONDS = 6e9, 60.0


@dataclass
class Results:
    """Outcomes of all cases; `newton_tables` makes tables of them.

    Attributes
    ----------
    cells, peer_cells : int
        Grid cells along an edge of the block, and of that of the comparison.
    assembly : dict
        By ``threads`` (all) and ``single`` (one).
    iterations : dict
        By mode and preset.
    ranks : dict
        By mode and ``1`` or ``2`` ranks, one thread each.
    best : dict of str to str
        Fastest preset by mode; absent where none converged.
    own : dict
        femdeform on the block of the comparison: ``assembly``, ``single`` (one thread), ``iteration``.
    peers : dict
        By name.
    """

    cells: int
    peer_cells: int
    assembly: dict[str, Outcome] = field(default_factory=dict)
    iterations: dict[str, dict[str, Outcome]] = field(default_factory=dict)
    ranks: dict[str, dict[int, Outcome]] = field(default_factory=dict)
    best: dict[str, str] = field(default_factory=dict)
    own: dict[str, Outcome] = field(default_factory=dict)
    peers: dict[str, Outcome] = field(default_factory=dict)

    def own_cases(self) -> dict[str, Outcome]:
        """Every case of femdeform's own, by a name for people."""
        cases = {f"assembly, {name}": outcome for name, outcome in self.assembly.items()}
        for mode, by_preset in self.iterations.items():
            cases |= {f"{preset}, {mode}": outcome for preset, outcome in by_preset.items()}
        for mode, by_ranks in self.ranks.items():
            cases |= {f"{mode} on {n} ranks": outcome for n, outcome in by_ranks.items()}
        return cases | {f"comparison, {name}": outcome for name, outcome in self.own.items()}


def run_newton(cases: Cases) -> Findings:
    """Assembly, presets, two ranks, then peers; see `Benchmark`."""
    from verification.benchmarks import newton_tables

    results = Results(*block_sizes())
    cases.begin(partial(newton_tables.findings, results))
    _assembly(results.assembly, "threads", f"assembly, {results.cells}^3 cells", results.cells, cases)
    _presets(results, cases)
    _two_ranks(results, cases)
    _comparison(results, cases)
    return newton_tables.findings(results)


def block_sizes() -> tuple[int, int]:
    """Grid cells along an edge of the block and of the comparison's; both from FEMDEFORM_BENCH_CELLS if set.

    Raises
    ------
    InputError
        If the variable is not a number of at least 2.
    """
    cells = chosen_cells()
    return (NODES_BLOCK, CELLS_BLOCK) if cells is None else (cells, cells)


def newton_presets() -> list[str]:
    """Presets for the linear systems of Newton's method."""
    return [name for name in registry.preset_names() if name.startswith("newton-")]


def _assembly(into: dict[str, Outcome], key: str, name: str, cells: int, cases: Cases, **more: str) -> None:
    """On all threads, and as ``single`` on one; `more` is for the former only."""
    case = {"kind": "assembly", "cells": cells}
    cases.run(into, key, name, _CASE, case | more)
    if jit.default_threads() > 1:
        cases.run(into, "single", f"{name}, one thread", _CASE, case, 1)


def _presets(results: Results, cases: Cases) -> None:
    for mode, quasistatic in _MODES.items():
        outcomes = results.iterations.setdefault(mode, {})
        for preset in newton_presets():
            case = _iteration(results.cells, quasistatic, _ksp(preset))
            reason = reason_to_skip(preset, results.cells)
            cases.run(outcomes, preset, f"{preset}, {mode}", _CASE, case, reason=reason)
        if not has_petsc():
            case = _iteration(results.cells, quasistatic, {"method": "scipy_direct"})
            is_small = results.cells <= _SCIPY_CELLS
            reason = "" if is_small else f"only up to {_SCIPY_CELLS}^3 cells: its factors fill memory"
            cases.run(outcomes, "scipy_direct", f"scipy_direct, {mode}", _CASE, case, reason=reason)
        best = fastest(outcomes)
        if best is not None:
            results.best[mode] = best


def reason_to_skip(preset: str, cells: int) -> str:
    """Why a preset is not measured on a block of that size; empty if it is."""
    if not has_petsc():
        return "petsc4py is not installed"
    if preset == "newton-mumps":
        n = 3.0 * (cells + 1) ** 3
        needed, takes = _FACTOR_BYTES * n ** (4.0 / 3.0), _FACTOR_SECONDS * n**2
        if needed > _MOST_BYTES or takes > _MOST_SECONDS:
            return f"would need about {needed / 1e9:.0f} GB and {takes:.0f} s for each factorisation"
    return ""


def fastest(outcomes: dict[str, Outcome]) -> str | None:
    """The preset with the shortest repeated iteration among those that converged; None if none did."""
    times = {
        preset: outcome.data["repeated"]["whole"]["median"]
        for preset, outcome in outcomes.items()
        if outcome.done and outcome.data["converged"] and outcome.data["repeated"] is not None
    }
    return min(times, key=lambda preset: times[preset]) if times else None


def _ksp(preset: str) -> dict[str, Any]:
    return {"method": "ksp", "preset": preset}


def _iteration(cells: int, quasistatic: bool, linear_solver: dict[str, Any]) -> dict[str, Any]:
    """The case of one Newton iteration."""
    return {"kind": "iteration", "cells": cells, "quasistatic": quasistatic, "linear_solver": linear_solver}


def _two_ranks(results: Results, cases: Cases) -> None:
    reason = reason_against_ranks()
    for mode, quasistatic in _MODES.items():
        best = results.best.get(mode)
        if reason or best is None:
            results.ranks[mode] = {2: skipped(reason or "no preset converged on one rank")}
            continue
        outcomes = results.ranks.setdefault(mode, {})
        case = _iteration(results.cells, quasistatic, _ksp(best))
        for ranks in (1, 2):
            name = f"{best}, {mode}, {ranks} rank{'s' if ranks > 1 else ''} of one thread"
            launcher = ["mpiexec", "-n", str(ranks)] if ranks > 1 else []
            cases.run(outcomes, ranks, name, _CASE, case, 1, launcher)


def reason_against_ranks() -> str:
    """Why two ranks are not measured here; empty if they are."""
    missing = [name for name in ("petsc4py", "mpi4py") if find_spec(name) is None]
    if missing:
        return f"{' and '.join(missing)} not installed"
    if shutil.which("mpiexec") is None:
        return "mpiexec not found"
    if jit.n_available_cores() < 2:
        return "one core only"
    return ""


def _comparison(results: Results, cases: Cases) -> None:
    cells = results.peer_cells
    with tempfile.TemporaryDirectory(prefix="femdeform-bench-") as folder:
        dump = str(Path(folder, "block.npz"))
        _assembly(results.own, "assembly", f"comparison: assembly, {cells}^3 cells", cells, cases, dump=dump)
        best = results.best.get("statics")
        if best is not None:
            solver = {"method": "scipy_direct"} if best == "scipy_direct" else _ksp(best)
            name = f"comparison: {best}, statics, {cells}^3 cells"
            cases.run(results.own, "iteration", name, _CASE, _iteration(cells, True, solver))
        state = results.own.get("assembly", skipped("not asked for"))
        for name, script in PEERS.items():
            cases.peer(results.peers, name, f"comparison: {name}, {cells}^3 cells", script, {"block": dump}, state)
