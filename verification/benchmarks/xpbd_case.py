"""What the child processes of the XPBD benchmark do: one case each.

``python -m verification.benchmarks.xpbd_case CASE RESULT``: CASE is a JSON file with ``kind`` and the case's own keys.
"""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from femdeform import jit
from solvers.position_based.cell_sweep import CellSweep
from solvers.position_based.constraint_sweeps import BlendedSweep, ConstraintSweep
from solvers.position_based.piola_sweep import PiolaSweep
from verification.benchmarks import child_process
from verification.benchmarks.block import DENSITY, YOUNGS_MODULUS
from verification.benchmarks.measure import measure, peak_memory, time_once
from verification.benchmarks.pbng_case import block

# Seconds of sweeps that are timed.
_ENOUGH = 0.6


def make_sweep(method: str, problem: Any) -> CellSweep:
    """The sweep of a method of `xpbd.METHODS`."""
    if method == "xpbd":
        return ConstraintSweep(problem)
    if method == "pbd":
        return ConstraintSweep(problem, 0.0, rigid=True)
    if method == "b_pxpbd":
        return BlendedSweep(problem)
    return PiolaSweep(problem, {"fp_pxpbd, 1 local": 1, "fp_pxpbd, 3 local": 3}[method])


def time_step(kappa: float, cells: int) -> float:
    """The time step that makes h^2 E / (rho dx^2) of the block `kappa` [s]."""
    return math.sqrt(kappa * DENSITY / YOUNGS_MODULUS) / cells


def sweeps(case: dict[str, Any]) -> dict[str, Any]:
    """Time sweeps of a step from the stretched block, and follow the residual of steps of given stiffness numbers.

    Parameters
    ----------
    case : dict
        ``cells``, ``law``, ``method``; ``kappas``, and ``looks``: numbers of sweeps after which to look, ascending.

    Returns
    -------
    dict
        ``time``: summary of seconds of a sweep at the smallest stiffness number, where no method diverges. ``reached``:
        for each stiffness number the residual at each look over that of free flight, None where it is not finite.
        ``colors``, ``n_cells``, ``set_up`` [s] and ``memory`` [bytes].
    """
    make_sweep(case["method"], block(2, case["law"], "stretch", {"method": "xpbd"}, None).problem)
    simulation = block(case["cells"], case["law"], "stretch", {"method": "xpbd"}, None)
    problem: Any = simulation.problem
    begin = time.perf_counter()
    sweep = make_sweep(case["method"], problem)
    set_up = time.perf_counter() - begin
    x = np.empty_like(simulation.state.x)

    def start(kappa: float) -> float:
        dt = time_step(kappa, case["cells"])
        problem.begin_step(simulation.state, dt)
        flight = problem.predictor(simulation.state)
        sweep.begin(problem, flight, dt)
        return float(problem.residual_norm(problem.gradient(flight)))

    start(min(case["kappas"]))
    sweep.sweep()
    repetitions = int(min(60, max(5, _ENOUGH / time_once(sweep.sweep))))
    taken = measure(sweep.sweep, repetitions, warm_up=0)
    reached = []
    for kappa in case["kappas"]:
        first, done, row = start(kappa), 0, []
        for look in case["looks"]:
            for _ in range(look - done):
                sweep.sweep()
            done = look
            sweep.read(x)
            left = problem.residual_norm(problem.gradient(x)) / first
            row.append(float(left) if math.isfinite(left) else None)
        reached.append(row)
    return {
        "threads": jit.set_threads(),
        "n_cells": sum(len(batch.volumes) for batch in sweep.batches),
        "colors": sweep.n_colors,
        "set_up": set_up,
        "time": taken,
        "reached": reached,
        "memory": peak_memory(),
    }


def dump(case: dict[str, Any]) -> dict[str, Any]:
    """Write the block, stretched and at rest, for the peers."""
    simulation = block(case["cells"], "neo_hookean", "stretch", {"method": "xpbd"}, None)
    law = simulation.discretization.groups[0].law
    np.savez(
        case["dump"],
        points=simulation.discretization.points,
        cells=simulation.meshes["block"].cells,
        positions=simulation.state.x,
        density=DENSITY,
        dt=case["dt"],
        time_steps=[time_step(kappa, case["cells"]) for kappa in case["kappas"]],
        looks=case["looks"],
        mu=law.mu,
        lmbda=law.lmbda,
    )
    return {}


if __name__ == "__main__":
    child_process.serve({"sweeps": sweeps, "dump": dump})
