"""The Poisson benchmark: solvers of the pressure on right-hand sides out of flows, and on domains that are hard."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from femdeform import jit
from verification.benchmarks import child_process
from verification.benchmarks.child_process import Outcome, skipped
from verification.benchmarks.environment import chosen_cells, has_petsc, is_wanted
from verification.benchmarks.machine import available_memory
from verification.benchmarks.run import Findings

SIZES = (32, 64, 128, 256)
TOLERANCES = (1e-4, 1e-6)
FLOWS = ("plume", "blob", "spinning box")
# By name: the scene, and whether it is open at the top.
SCENES: dict[str, tuple[str, bool]] = {
    f"{scene}, {'open' if is_open else 'closed'}": (scene, is_open) for scene in FLOWS for is_open in (False, True)
} | {scene: (scene, False) for scene in ("30 % solids", "50 % solids", "rooms", "plates")}
# Of grids as large as this multigrid alone is asked, about the first frame.
_LARGE = 256
# Vectors of a solver beside those of the flow and the frames, as many as it has unknowns, in double precision.
_VECTORS = {"deflated cg": 240.0, "petsc gamg": 130.0, "petsc hypre": 130.0, "petsc icc": 60.0}
_VECTORS_OF_OTHERS = 40.0

_CASE = "verification.benchmarks.poisson_case"


@dataclass
class Results:
    """Outcomes of all cases; `poisson_tables` makes tables of them.

    Attributes
    ----------
    sizes : list of int
        Voxels along an edge.
    records : dict
        By size and scene.
    solves : dict
        By size, scene and solver.
    """

    sizes: list[int]
    records: dict[tuple[int, str], Outcome] = field(default_factory=dict)
    solves: dict[tuple[int, str, str], Outcome] = field(default_factory=dict)


def run_poisson(say: Callable[[str], None]) -> Findings:
    """Run all cases, one after the other, each in a process of its own.

    Parameters
    ----------
    say : callable
        Gets a line of text before each case.

    Returns
    -------
    Findings
    """
    from verification.benchmarks import poisson_tables
    from verification.benchmarks.poisson_case import SOLVERS

    chosen = chosen_cells()
    results = Results(list(SIZES) if chosen is None else [chosen])
    for n in results.sizes:
        names = [name for name in SOLVERS if n < _LARGE or name.startswith("mg")]
        for scene in SCENES:
            wanted = [name for name in names if is_wanted(case_name(n, scene, name))]
            if wanted:
                _scene(results, n, scene, wanted, say)
    return poisson_tables.findings(results)


def case_name(n: int, scene: str, solver: str) -> str:
    """How FEMDEFORM_BENCH_ONLY knows a case."""
    return f"{n}^3, {scene}: {solver}"


def _scene(results: Results, n: int, scene: str, solvers: Sequence[str], say: Callable[[str], None]) -> None:
    from verification.benchmarks.poisson_domains import FRAMES

    kind, is_open = SCENES[scene]
    threads = jit.default_threads()
    reason = _too_large(n, "")
    if reason:
        results.solves |= {(n, scene, name): skipped(reason) for name in solvers}
        return
    with tempfile.TemporaryDirectory(prefix="femdeform-bench-") as folder:
        file = str(Path(folder, "frames.npz"))
        say(f"{n}^3, {scene}")
        frames = FRAMES if n < _LARGE else FRAMES[:1]
        case = {"kind": "record", "scene": kind, "open": is_open, "cells": n, "frames": frames, "file": file}
        recorded = child_process.run_module(_CASE, case, threads)
        results.records[n, scene] = recorded
        for name in solvers:
            reason = _too_large(n, name) if recorded.done else "there is nothing to solve"
            if name.startswith("petsc") and not has_petsc():
                reason = "petsc4py is not installed"
            if reason:
                results.solves[n, scene, name] = skipped(reason)
                continue
            say(case_name(n, scene, name))
            case = {"kind": "solve", "solver": name, "file": file, "tolerances": TOLERANCES}
            results.solves[n, scene, name] = child_process.run_module(_CASE, case, threads)


def _too_large(n: int, solver: str) -> str:
    """Why there is no room for a solver; an empty text if there is."""
    need, free = 8.0 * n**3 * _VECTORS.get(solver, _VECTORS_OF_OTHERS), available_memory()
    return f"needs about {need / 1e9:.0f} GB" if free is not None and need > 0.8 * free else ""
