"""What the child processes of the Poisson benchmark do: one case each.

``python -m verification.benchmarks.poisson_case CASE RESULT``: CASE is a JSON file with ``kind`` and the case's own
keys.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from femdeform import jit
from femdeform.flow.pressure_system import FLUID, PressureSystem
from solvers.linear.poisson.conjugate_gradients import ConjugateGradients
from solvers.linear.poisson.deflation import DeflatedConjugateGradients
from solvers.linear.poisson.incomplete_cholesky import MODIFIED, IncompleteCholesky
from solvers.linear.poisson.interface import PoissonSolver
from solvers.linear.poisson.multigrid import Multigrid
from solvers.linear.poisson.petsc_pressure import PETScPressure
from verification.benchmarks import child_process, poisson_domains
from verification.benchmarks.learned_weights import learned_solver
from verification.benchmarks.measure import peak_memory, summary

# A further solver of the table is a further line.
SOLVERS: dict[str, Callable[[PressureSystem], PoissonSolver]] = {
    "cg": ConjugateGradients,
    "ic(0)": lambda system: ConjugateGradients(system, IncompleteCholesky(system)),
    "mic(0)": lambda system: ConjugateGradients(system, IncompleteCholesky(system, MODIFIED)),
    "deflated cg": DeflatedConjugateGradients,
    "mg v(1,1)": lambda system: ConjugateGradients(system, Multigrid(system, 1)),
    "mg v(2,2)": lambda system: ConjugateGradients(system, Multigrid(system, 2)),
    "spd_lmg": lambda system: learned_solver("spd_lmg", system),
    "spd_lmg v(2,2)": lambda system: learned_solver("spd_lmg", system, 2),
    "dcdm": lambda system: learned_solver("dcdm", system),
    "petsc icc": lambda system: PETScPressure(system, "icc"),
    "petsc gamg": lambda system: PETScPressure(system, "gamg"),
    "petsc hypre": lambda system: PETScPressure(system, "hypre"),
}
# Solves of one right-hand side that count, of which the shortest is taken; one only where it is longer than this [s].
_REPETITIONS, _LONG = 3, 0.5
_MAX_ITERATIONS = 5000
# An iteration of these is long, and no solve with so many of them is worth waiting for.
_FEWER = {"dcdm": 120}


def record(case: dict[str, Any]) -> dict[str, Any]:
    """Write labels and right-hand sides of a scene to a file.

    Parameters
    ----------
    case : dict
        ``scene``: one of `poisson_domains.HARD`, or a flow with ``open``; ``cells`` along an edge; ``dim``; ``frames``;
        ``file`` (.npz) to write.

    Returns
    -------
    dict
        ``n_unknowns``, ``n_closed`` of the first system.
    """
    make = poisson_domains.HARD.get(case["scene"])
    if make is not None:
        found = poisson_domains.random_sides(make(case["cells"], case["dim"]), len(case["frames"]))
    else:
        found = poisson_domains.record(case["scene"], case["open"], case["cells"], case["frames"], case["dim"])
    np.savez(case["file"], labels=np.stack([each for each, _ in found]), b=np.stack([b for _, b in found]))
    system = PressureSystem(found[0][0])
    return {"n_unknowns": system.n_unknowns, "n_closed": system.n_closed}


def solve(case: dict[str, Any]) -> dict[str, Any]:
    """Solve all right-hand sides of a file with one solver.

    Parameters
    ----------
    case : dict
        ``solver``: one of `SOLVERS`; ``file``; ``tolerances``.

    Returns
    -------
    dict
        By tolerance (as text) ``iterations`` of each frame (None if it failed) and a summary ``seconds`` of solves;
        ``set_up``: summary of seconds, of a domain that has changed since the frame before; ``residuals``: those of
        the last frame to the last tolerance, over the right-hand side; ``reasons``; ``memory`` [bytes].
    """
    make = SOLVERS[case["solver"]]
    most = _FEWER.get(case["solver"], _MAX_ITERATIONS)
    data = np.load(case["file"])
    _warm_up(make, PressureSystem(data["labels"][0]).dim)
    set_up: list[float] = []
    found: dict[str, Any] = {f"{t:g}": {"iterations": [], "seconds": []} for t in case["tolerances"]}
    reasons: list[str] = []
    residuals: list[float] = []
    system: PressureSystem | None = None
    solver: PoissonSolver | None = None
    before = np.empty(0, dtype=np.uint8)
    for labels, b in zip(data["labels"], data["b"], strict=True):
        if system is None or solver is None or not np.array_equal(labels, before):
            if solver is not None:
                solver.destroy()
            system = PressureSystem(labels)
            system.project(b.copy())  # finds the components, which every solver needs
            begin = time.perf_counter()
            solver = make(system)
            set_up.append(time.perf_counter() - begin)
            before = labels
        for tolerance in case["tolerances"]:
            row = found[f"{tolerance:g}"]
            taken: list[float] = []
            while len(taken) < _REPETITIONS and (not taken or min(taken) < _LONG):
                begin = time.perf_counter()
                answer = solver.solve(b, tolerance, most)
                taken.append(time.perf_counter() - begin)
            row["iterations"].append(answer.iterations if answer.converged else None)
            row["seconds"].append(min(taken))
            if not answer.converged:
                reasons.append(answer.reason)
            residuals = [value / system.norm(b) for value in answer.residuals]
    if solver is not None:
        solver.destroy()
    for row in found.values():
        row["seconds"] = summary(row["seconds"])
    return {
        "tolerances": found,
        "set_up": summary(set_up),
        "residuals": residuals,
        "reasons": sorted(set(reasons)),
        "threads": jit.set_threads(),
        "memory": peak_memory(),
    }


def _warm_up(make: Callable[[PressureSystem], PoissonSolver], dim: int) -> None:
    """Load what a first call loads, kernels and libraries, on a few voxels."""
    labels = np.full((6,) * dim, FLUID, dtype=np.uint8)
    system = PressureSystem(labels)
    b = system.extend(np.random.default_rng(0).standard_normal(system.n_unknowns))
    system.project(b)
    solver = make(system)
    solver.solve(b, 1e-6, 100)
    solver.destroy()


if __name__ == "__main__":
    child_process.serve({"record": record, "solve": solve})
