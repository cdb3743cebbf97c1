"""What the child processes of the benchmark of deep conjugate directions do: one case each."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from femdeform.flow.pressure_system import GridArray, PressureSystem
from solvers.linear.poisson.conjugate_gradients import ConjugateGradients
from solvers.linear.poisson.incomplete_cholesky import IncompleteCholesky
from solvers.linear.poisson.interface import PoissonSolver
from solvers.linear.poisson.multigrid import Multigrid
from solvers.linear.poisson.weights_file import Weights
from verification.benchmarks import child_process, poisson_domains
from verification.benchmarks.heat_system import HeatSystem
from verification.benchmarks.learned_weights import bench_weights, dcdm_solver, learned_solver, missing_weights

# Directions that are kept, by name: i_start = k, k - 1 and 1 as the source counts them.
KEPT: dict[str, int | None] = {"1": 1, "2": 2, "all": None}
TOLERANCE = 1e-6
_MOST, _MOST_CLASSICAL = 120, 5000

Facts = dict[str, Any]


def compare(case: dict[str, Any]) -> dict[str, Any]:
    """Solve pressures of a flow past the blob with networks and without.

    Parameters
    ----------
    case : dict
        ``cells`` along an edge; ``dim``; ``frames``; ``open``.

    Returns
    -------
    dict
        ``curves``: by solver, for each frame, the residual over the right-hand side after each iteration.
    """
    found = poisson_domains.record("blob", case["open"], case["cells"], case["frames"], case["dim"])
    system = PressureSystem(found[0][0])  # the blob rests
    sides = [b for _, b in found]
    weights = bench_weights("dcdm", case["dim"])
    solvers = {f"dcdm, kept {name}": dcdm_solver(system, weights, kept) for name, kept in KEPT.items()}
    if not missing_weights("spd_lmg", case["dim"]):
        solvers["spd_lmg"] = learned_solver("spd_lmg", system)
    return {"curves": {name: _curves(system, each, sides) for name, each in (solvers | _classical(system)).items()}}


def heat(case: dict[str, Any]) -> dict[str, Any]:
    """Solve steps of the heat equation with a network that was trained on pressures.

    Parameters
    ----------
    case : dict
        ``cells``; ``dim``; ``numbers``: diffusion numbers of the steps.

    Returns
    -------
    dict
        ``curves``: by diffusion number (as text) and solver, as those of `compare`.
    """
    weights = bench_weights("dcdm", case["dim"])
    curves: dict[str, dict[str, list[list[float]]]] = {}
    for number in case["numbers"]:
        system = HeatSystem(case["cells"], case["dim"], number)
        b = system.hot_ball(number)
        solvers = {"dcdm": dcdm_solver(system, weights)} | _classical(system)
        curves[f"{number:g}"] = {name: _curves(system, solver, [b]) for name, solver in solvers.items()}
    return {"curves": curves}


def train(case: dict[str, Any]) -> dict[str, Any]:
    """Train a network for a short while, and solve a pressure of a flow past the blob with it.

    Parameters
    ----------
    case : dict
        ``model``, ``route``, ``steps`` and ``cells``, all for the training in the plane; ``test_cells``: of the flow;
        ``frames``, of which the last one is solved.

    Returns
    -------
    dict
        ``curves`` as those of `compare`, by directions kept; ``n_parameters``; ``loss`` of the last twentieth of the
        steps; ``seconds`` of training.
    """
    trained = _trained(case, case["model"], case["route"])
    if isinstance(trained, str):
        return {"skipped": trained}
    weights, facts = trained
    system, b = _test_system(case["test_cells"], case["frames"])
    curves = {name: _curves(system, dcdm_solver(system, weights, kept), [b]) for name, kept in KEPT.items()}
    return {"curves": curves, **facts}


def transfer(case: dict[str, Any]) -> dict[str, Any]:
    """Train the source's network on grids of one size, and solve a pressure of a flow past the blob on several.

    Parameters
    ----------
    case : dict
        ``cells`` and ``steps`` of the training; ``tests``: voxels along an edge of the flows; ``frames``, of which the
        last one is solved.

    Returns
    -------
    dict
        As that of `train`; ``curves`` by voxels along an edge (as text), two directions kept.
    """
    trained = _trained(case, "source-64", "on_policy")
    if isinstance(trained, str):
        return {"skipped": trained}
    weights, facts = trained
    curves = {}
    for cells in case["tests"]:
        system, b = _test_system(cells, case["frames"])
        curves[str(cells)] = _curves(system, dcdm_solver(system, weights), [b])
    return {"curves": curves, **facts}


def _trained(case: dict[str, Any], model: str, route: Literal["on_policy", "ritz"]) -> tuple[Weights, Facts] | str:
    """Weights, and what there is to say of the training; or why there are none."""
    try:
        from solvers.linear.poisson.training.learn_dcdm import DCDMLearner
        from solvers.linear.poisson.training.loop import run_training
    except ImportError:
        return "PyTorch is not installed"
    import tempfile

    from solvers.linear.poisson.training.settings import TrainingSettings

    with tempfile.TemporaryDirectory(prefix="femdeform-bench-") as folder:
        settings = TrainingSettings(
            "dcdm",
            Path(folder),
            cells=case["cells"],
            steps=case["steps"],
            model=model,
            route=route,
            lanczos=case["cells"] ** 2 // 4,
            samples=2000,
        )
        begin = time.perf_counter()
        learner = DCDMLearner(settings)
        progress = run_training(settings, learner, False, lambda _: None)
        seconds = time.perf_counter() - begin
    tail = progress.losses[-max(1, len(progress.losses) // 20) :]
    facts = {
        "n_parameters": learner.architecture.n_parameters,
        "loss": float(np.mean(tail)),
        "seconds": seconds,
    }
    return Weights(learner.meta(), progress.best), facts


def _test_system(cells: int, frames: Sequence[int]) -> tuple[PressureSystem, GridArray]:
    """The last pressure of a flow past the blob in a closed box, in the plane."""
    labels, b = poisson_domains.record("blob", False, cells, frames, 2)[-1]
    return PressureSystem(labels), b


def _classical(system: PressureSystem) -> dict[str, PoissonSolver]:
    return {
        "mg v(2,2)": ConjugateGradients(system, Multigrid(system)),
        "ic(0)": ConjugateGradients(system, IncompleteCholesky(system)),
        "cg": ConjugateGradients(system),
    }


def _curves(system: PressureSystem, solver: PoissonSolver, sides: list[GridArray]) -> list[list[float]]:
    most = _MOST if solver.name == "dcdm" else _MOST_CLASSICAL
    found = []
    for b in sides:
        norm = system.norm(b)
        found.append([value / norm for value in solver.solve(b, TOLERANCE, most).residuals])
    return found


if __name__ == "__main__":
    child_process.serve({"compare": compare, "heat": heat, "train": train, "transfer": transfer})
