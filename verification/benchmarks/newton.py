"""The Newton benchmark: assembly, and one Newton iteration with each preset, on one rank, on two, and beside peers."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from femdeform import jit, registry
from verification.benchmarks import child_process
from verification.benchmarks.child_process import Outcome, skipped
from verification.benchmarks.environment import chosen_cells, has_petsc
from verification.benchmarks.run import Findings

PEERS_VARIABLE = "FEMDEFORM_PEERS"
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


def run_newton(say: Callable[[str], None]) -> Findings:
    """Run all cases, one after the other, each in a process of its own.

    Parameters
    ----------
    say : callable
        Gets a line of text before each case.

    Returns
    -------
    Findings
    """
    from verification.benchmarks import newton_tables

    cells, peer_cells = block_sizes()
    results = Results(cells, peer_cells)
    _assembly(results, say)
    _presets(results, say)
    _two_ranks(results, say)
    _comparison(results, say)
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


def _assembly(results: Results, say: Callable[[str], None]) -> None:
    case = {"kind": "assembly", "cells": results.cells}
    say(f"assembly, {results.cells}^3 cells")
    results.assembly["threads"] = child_process.run_module(_CASE, case, jit.default_threads())
    if jit.default_threads() > 1:
        say(f"assembly, {results.cells}^3 cells, one thread")
        results.assembly["single"] = child_process.run_module(_CASE, case, 1)


def _presets(results: Results, say: Callable[[str], None]) -> None:
    for mode, quasistatic in _MODES.items():
        outcomes = results.iterations.setdefault(mode, {})
        for preset in newton_presets():
            reason = reason_to_skip(preset, results.cells)
            if reason:
                outcomes[preset] = skipped(reason)
                continue
            say(f"{preset}, {mode}")
            outcomes[preset] = _iteration(results.cells, quasistatic, _ksp(preset), jit.default_threads())
        if not has_petsc():
            if results.cells > _SCIPY_CELLS:
                outcomes["scipy_direct"] = skipped(f"only up to {_SCIPY_CELLS}^3 cells: its factors fill memory")
            else:
                say(f"scipy_direct, {mode}")
                direct = {"method": "scipy_direct"}
                outcomes["scipy_direct"] = _iteration(results.cells, quasistatic, direct, jit.default_threads())
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


def _iteration(cells: int, quasistatic: bool, linear_solver: dict[str, Any], threads: int, ranks: int = 1) -> Outcome:
    case = {"kind": "iteration", "cells": cells, "quasistatic": quasistatic, "linear_solver": linear_solver}
    launcher = ["mpiexec", "-n", str(ranks)] if ranks > 1 else []
    return child_process.run_module(_CASE, case, threads, launcher)


def _two_ranks(results: Results, say: Callable[[str], None]) -> None:
    reason = reason_against_ranks()
    for mode, quasistatic in _MODES.items():
        best = results.best.get(mode)
        if reason or best is None:
            results.ranks[mode] = {2: skipped(reason or "no preset converged on one rank")}
            continue
        outcomes = results.ranks.setdefault(mode, {})
        for ranks in (1, 2):
            say(f"{best}, {mode}, {ranks} rank{'s' if ranks > 1 else ''} of one thread")
            outcomes[ranks] = _iteration(results.cells, quasistatic, _ksp(best), 1, ranks)


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


def _comparison(results: Results, say: Callable[[str], None]) -> None:
    cells = results.peer_cells
    with tempfile.TemporaryDirectory(prefix="femdeform-bench-") as folder:
        dump = str(Path(folder, "block.npz"))
        say(f"assembly, {cells}^3 cells, for the comparison")
        case = {"kind": "assembly", "cells": cells}
        results.own["assembly"] = child_process.run_module(_CASE, case | {"dump": dump}, jit.default_threads())
        if jit.default_threads() > 1:
            say(f"assembly, {cells}^3 cells, one thread")
            results.own["single"] = child_process.run_module(_CASE, case, 1)
        best = results.best.get("statics")
        if best is not None:
            say(f"{best}, statics, {cells}^3 cells")
            solver = {"method": "scipy_direct"} if best == "scipy_direct" else _ksp(best)
            results.own["iteration"] = _iteration(cells, True, solver, jit.default_threads())
        python, reason = peers_python()
        for name, script in PEERS.items():
            if python is None:
                results.peers[name] = skipped(reason)
            elif not results.own["assembly"].done:
                results.peers[name] = skipped("there is no state to compare at")
            else:
                say(f"{name}, {cells}^3 cells")
                path = Path(__file__).parent / "peers" / script
                results.peers[name] = child_process.run_script(python, path, {"block": dump})


def peers_python() -> tuple[Path | None, str]:
    """Return the Python of the environment with the peers, or None and the reason.

    FEMDEFORM_PEERS names the environment's folder or its Python; default: ``.venv-peers`` in the source tree or in
    the current folder, as `make peers` leaves it.
    """
    named = os.environ.get(PEERS_VARIABLE, "").strip()
    folders = [Path(named)] if named else [Path(__file__).resolve().parents[2] / ".venv-peers", Path(".venv-peers")]
    for folder in folders:
        for candidate in (folder / "bin" / "python", folder):
            if candidate.is_file() and os.access(candidate, os.X_OK):
                return candidate.absolute(), ""
    if named:
        return None, f"there is no Python at {named} ({PEERS_VARIABLE})"
    return None, "no environment with peers: make one with `make peers`"
