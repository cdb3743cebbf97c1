"""Equal budgets: what PBNG, limited Newton, XPBD and PBD make of the same time; run as `pbng_case` is."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform import jit
from femdeform.run.setup import Simulation
from femdeform.step_problem import Budget
from femdeform.types import FloatArray
from solvers.position_based.constraint_sweeps import ConstraintSweep
from verification.benchmarks import child_process
from verification.benchmarks.pbng_case import block

# More sweeps than any budget has time for.
_ENDLESS = 1_000_000
# Pseudo-time steps of XPBD-QS [s]: h^2 E / (rho dx^2) of 10 and 1000 on 32^3 nodes.
_PSEUDO_STEPS = (1e-3, 1e-2)


@dataclass
class _Found:
    """What a method made of its budget: seconds, iterations and positions; why it failed, or empty."""

    seconds: float
    iterations: int
    x: FloatArray
    failure: str = ""


def budgets(case: dict[str, Any]) -> dict[str, Any]:
    """Give other methods the time that some sweeps of PBNG take.

    Parameters
    ----------
    case : dict
        ``cells``, ``law``, ``problem`` (see `block`), ``sweeps`` with the number of CG iterations beside each,
        ``linear_solver`` of limited Newton; without it that is left out.

    Returns
    -------
    dict
        ``rows``: for each number of sweeps and method seconds, iterations, relative residual and the part of the energy
        to be lost that is still there, None where a material is not defined. ``notes``: methods that failed.
    """
    cells, law, twist = case["cells"], case["law"], case["problem"] == "twist"
    reference = block(cells, law, case["problem"], {"method": "pbng", "tolerance": 1e-9}, None)
    end = _take(reference)
    problem: Any = reference.problem
    least, most = problem.value(end.x), problem.value(problem.initial_guess(reference.state))
    rows, notes = [], []
    for sweeps, linear in case["sweeps"]:
        plain = {"method": "pbng", "acceleration": "none", "iterations": sweeps, "check_every": sweeps}
        own = _take(block(cells, law, case["problem"], plain, None))
        found = {f"PBNG, {sweeps} sweeps": own}
        if case["linear_solver"] is not None:
            found[f"Newton, {linear} CG each"] = _limited_newton(case, linear, own.seconds)
        others: dict[str, dict[str, Any]]
        if twist:
            found["PBD"] = _static_pbd(block(cells, law, "twist", {"method": "pbng"}, None), own.seconds)
            others = {
                f"XPBD-QS, h = {h:g} s": {"method": "xpbd_qs", "pseudo_step": h, "max_pseudo_steps": _ENDLESS}
                for h in _PSEUDO_STEPS
            }
        else:
            fixed = {"iterations": _ENDLESS, "check_every": _ENDLESS}
            others = {"PBD": {"method": "pbd", **fixed}, "XPBD": {"method": "xpbd", **fixed}}
        for name, solver in others.items():
            found[name] = _take(block(cells, law, case["problem"], solver, None), own.seconds)
        for name, answer in found.items():
            left = (problem.value(answer.x) - least) / (most - least)
            rows.append(
                {
                    "name": name,
                    "seconds": answer.seconds,
                    "iterations": answer.iterations,
                    "residual": problem.residual_norm(problem.gradient(answer.x)) / problem.force_scale,
                    "energy": float(left) if math.isfinite(left) else None,
                }
            )
            if answer.failure:
                notes.append(f"{name}: {answer.failure}.")
    return {"threads": jit.set_threads(), "rows": rows, "notes": notes}


def _take(simulation: Simulation, seconds: float | None = None) -> _Found:
    """Take the first step twice, the second time counts: layouts and patterns exist then."""
    problem: Any = simulation.problem
    taken = 0.0
    for _ in range(2):
        simulation.solver.reset()
        problem.begin_step(simulation.state, simulation.scene.time.dt)
        budget = Budget(seconds=seconds)
        budget.start()
        answer = simulation.solver.step(problem, simulation.state, None, budget)
        taken = budget.elapsed()
    is_expected = answer.converged or answer.is_fixed_work or (seconds is not None and "budget" in answer.reason)
    return _Found(taken, answer.iterations, answer.x, "" if is_expected else answer.reason)


def _limited_newton(case: dict[str, Any], linear: int, seconds: float) -> _Found:
    options = {**case["linear_solver"].get("options", {}), "ksp_max_it": linear, "ksp_convergence_test": "skip"}
    limited = {**case["linear_solver"], "options": options}
    newton = {"method": "projected_newton", "hessian": "projected", "tolerance": 1e-9}
    return _take(block(case["cells"], case["law"], case["problem"], newton, limited), seconds)


def _static_pbd(simulation: Simulation, seconds: float) -> _Found:
    """Sweeps over infinitely stiff constraints from the first iterate of a static step."""
    problem: Any = simulation.problem
    guess = problem.initial_guess(simulation.state)
    sweep = ConstraintSweep(problem, 0.0, rigid=True)
    x, count, taken = np.empty_like(guess), 0, 0.0
    for _ in range(2):
        sweep.begin(problem, guess, 1.0)
        count, begin = 0, time.perf_counter()
        while count == 0 or taken < seconds:
            sweep.sweep()
            count += 1
            taken = time.perf_counter() - begin
        sweep.read(x)
    return _Found(taken, count, x)


if __name__ == "__main__":
    child_process.serve({"budgets": budgets})
