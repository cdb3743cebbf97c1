"""The Poisson benchmark: solvers of the pressure on right-hand sides out of flows, and on domains that are hard."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from verification.benchmarks.cases import Cases
from verification.benchmarks.child_process import Outcome, skipped
from verification.benchmarks.environment import chosen_cells, has_petsc, is_wanted
from verification.benchmarks.machine import available_memory
from verification.benchmarks.tables import Findings


class Grid(NamedTuple):
    """Voxels along an edge, and the dimension."""

    cells: int
    dim: int

    def __str__(self) -> str:
        return f"{self.cells}^{self.dim}"

    @property
    def n_voxels(self) -> int:
        """All of them."""
        return int(self.cells**self.dim)


GRIDS = (Grid(64, 2), Grid(256, 2), Grid(32, 3), Grid(64, 3), Grid(128, 3), Grid(256, 3))
TOLERANCES = (1e-4, 1e-6)
FLOWS = ("plume", "blob", "spinning box")
# By name: the scene, and whether it is open at the top.
SCENES: dict[str, tuple[str, bool]] = {
    f"{scene}, {'open' if is_open else 'closed'}": (scene, is_open) for scene in FLOWS for is_open in (False, True)
} | {scene: (scene, False) for scene in ("30 % solids", "50 % solids", "rooms", "plates")}
# Of grids as large as this multigrid alone is asked, about the first frame.
_LARGE = 256**3
# Vectors of a solver beside those of the flow and the frames, as many as it has unknowns, in double precision.
_VECTORS = {
    "deflated cg": 240.0,
    "petsc gamg": 130.0,
    "petsc hypre": 130.0,
    "petsc icc": 60.0,
    "dcdm": 120.0,
    "spd_lmg": 80.0,
    "spd_lmg v(2,2)": 80.0,
}
_VECTORS_OF_OTHERS = 40.0

# In the plane half of all voxels do not hang together.
_SPACE_ONLY = ("50 % solids",)

_CASE = "verification.benchmarks.poisson_case"


@dataclass
class Results:
    """Outcomes of all cases; `poisson_tables` makes tables of them.

    Attributes
    ----------
    grids : list of Grid
    records : dict
        By grid and scene.
    solves : dict
        By grid, scene and solver.
    """

    grids: list[Grid]
    records: dict[tuple[Grid, str], Outcome] = field(default_factory=dict)
    solves: dict[tuple[Grid, str, str], Outcome] = field(default_factory=dict)


def chosen_grids(grids: Sequence[Grid]) -> list[Grid]:
    """These grids, or one of each dimension as FEMDEFORM_BENCH_CELLS has it."""
    chosen = chosen_cells()
    return list(grids) if chosen is None else [Grid(chosen, dim) for dim in (2, 3)]


def run_poisson(cases: Cases) -> Findings:
    """All solvers on each scene and grid; see `Benchmark`."""
    from verification.benchmarks import poisson_tables
    from verification.benchmarks.poisson_case import SOLVERS

    results = Results(chosen_grids(GRIDS))
    cases.begin(partial(poisson_tables.findings, results))
    for grid in results.grids:
        names = [name for name in SOLVERS if grid.n_voxels < _LARGE or name.startswith("mg")]
        for scene in SCENES:
            wanted = [name for name in names if is_wanted(case_name(grid, scene, name))]
            if wanted and not (grid.dim == 2 and scene in _SPACE_ONLY):
                _scene(results, grid, scene, wanted, cases)
    return poisson_tables.findings(results)


def case_name(grid: Grid, scene: str, solver: str) -> str:
    """How FEMDEFORM_BENCH_ONLY knows a case."""
    return f"{grid}, {scene}: {solver}"


def _scene(results: Results, grid: Grid, scene: str, solvers: Sequence[str], cases: Cases) -> None:
    from verification.benchmarks.poisson_domains import FRAMES

    kind, is_open = SCENES[scene]
    reason = _too_large(grid, "")
    if reason:
        results.solves |= {(grid, scene, name): skipped(reason) for name in solvers}
        return
    with tempfile.TemporaryDirectory(prefix="femdeform-bench-") as folder:
        file = str(Path(folder, "frames.npz"))
        frames = FRAMES if grid.n_voxels < _LARGE else FRAMES[:1]
        case: dict[str, Any] = {"kind": "record", "scene": kind, "open": is_open, "frames": frames, **grid._asdict()}
        recorded = cases.outcome(f"{grid}, {scene}", _CASE, case | {"file": file})
        results.records[grid, scene] = recorded
        cases.keep()
        for name in solvers:
            reason = _absent(grid, name) if recorded.done else "there is nothing to solve"
            case = {"kind": "solve", "solver": name, "file": file, "tolerances": TOLERANCES}
            key = (grid, scene, name)
            cases.run(results.solves, key, case_name(*key), _CASE, case, reason=reason)


def _absent(grid: Grid, solver: str) -> str:
    """Why a solver cannot be run; an empty text if it can."""
    if solver.startswith("petsc") and not has_petsc():
        return "petsc4py is not installed"
    if solver.startswith(("dcdm", "spd_lmg")):
        from verification.benchmarks.learned_weights import missing_weights

        return missing_weights(solver.split()[0], grid.dim) or _too_large(grid, solver)
    return _too_large(grid, solver)


def _too_large(grid: Grid, solver: str) -> str:
    """Why there is no room for a solver; an empty text if there is."""
    need, free = 8.0 * grid.n_voxels * _VECTORS.get(solver, _VECTORS_OF_OTHERS), available_memory()
    return f"needs about {need / 1e9:.0f} GB" if free is not None and need > 0.8 * free else ""
