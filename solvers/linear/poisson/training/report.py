"""What a training run leaves: weights, a model card, a loss curve."""

from __future__ import annotations

import hashlib
import platform
from pathlib import Path
from typing import Any

import numpy as np

from femdeform.flow.pressure_system import FLUID, PressureSystem
from solvers.linear.poisson.conjugate_gradients import ConjugateGradients
from solvers.linear.poisson.interface import PoissonSolver
from solvers.linear.poisson.multigrid import Multigrid
from solvers.linear.poisson.trained_range import TrainedRange
from solvers.linear.poisson.training.domains import (
    LEAST_FLUID,
    blob_labels,
    plate_labels,
    porous_labels,
    smooth_divergence,
)
from solvers.linear.poisson.training.loop import (
    MOST_ITERATIONS,
    TOLERANCE,
    Learner,
    Progress,
    told_iterations,
    validation_systems,
)
from solvers.linear.poisson.training.settings import TrainingSettings
from solvers.linear.poisson.weights_file import Weights, save_weights

# Iterations after which a solver is given up: the guard stops deep conjugate directions earlier than that.
_MOST = {"dcdm": 40, "spd_lmg": 200}
# Voxels of a grid from which on deep conjugate directions are tried on the easier systems alone.
_DEAR = 100_000
# Right-hand sides that neither training nor validation has.
_SEED = 4321

_LIMITS = {
    "spd_lmg": """\
Symmetric and positive definite for any weights and any domain, so conjugate gradients always converge; how fast is
measured above and nowhere else. Trained with one sweep before and after each correction. The set-up evaluates the
network once for each domain and costs more than a solve.""",
    "dcdm": """\
There is no bound on iterations: a guard stops the solver where it is slow and lets multigrid go on. The network sees
as far as its reach and knows nothing of the domain as a whole, so iterations grow with the grid. One evaluation costs
as much as several whole solves with multigrid. Larger grids than those above are not validated.""",
}


def write_results(
    settings: TrainingSettings, learner: Learner, progress: Progress, command: str, name: str
) -> list[Path]:
    """Write ``NAME.npz``, its sum, ``NAME.md`` and ``NAME-loss.png``; their paths."""
    weights = settings.out / f"{name}.npz"
    meta = learner.meta() | trained_range(settings).as_meta()
    digest = save_weights(weights, Weights(meta, progress.best))
    picture = settings.out / f"{name}-loss.png"
    _draw(progress, picture)
    card = settings.out / f"{name}.md"
    card.write_text(_card(settings, learner, progress, command, name, digest))
    return [weights, card, picture]


def _card(
    settings: TrainingSettings, learner: Learner, progress: Progress, command: str, name: str, digest: str
) -> str:
    import torch

    facts = "\n".join(f"| {key} | {value} |" for key, value in _facts(settings, progress, command, digest).items())
    rows = "\n".join(_row(label, system, learner, progress, settings) for label, system in _test_systems(settings))
    return f"""\
# {name}

Weights of `{settings.kind}` in {settings.dim} dimensions.

| | |
|---|---|
{facts}
| made with | Python {platform.python_version()}, PyTorch {torch.__version__}, {settings.device} |

## Iterations

To a residual of 1e-4 of the right-hand side, on domains of the kinds that were trained on, but other ones than were
used for training or for choosing the step; "start" is the same solver before this training.

| system | start | trained | multigrid V(1,1) | multigrid V(2,2) |
|---|---|---|---|---|
{rows}

## Limits

{_LIMITS[settings.kind]}
"""


def _facts(settings: TrainingSettings, progress: Progress, command: str, digest: str) -> dict[str, Any]:
    tail = progress.losses[-max(1, len(progress.losses) // 20) :]
    head = progress.losses[: len(tail)]
    data = {
        "spd_lmg": "random ellipsoids, turned boxes, air layers and wavy surfaces, "
        f"{settings.hard_part:.0%} porous solids and plates; errors left by the cycle itself",
        "dcdm": "empty boxes and random domains with solids and air, "
        f"{settings.hard_part:.0%} of the latter porous or with plates; errors left by the solver itself"
        if settings.route == "on_policy"
        else f"{settings.samples} right-hand sides of Ritz vectors of the empty box, {settings.lanczos} Lanczos steps",
    }[settings.kind]
    return {
        "command": f"`{command}`",
        "seed": settings.seed,
        "commit": progress.commit,
        "start": _start(settings.start),
        "data": data,
        "grid": " x ".join(map(str, settings.shape)),
        "steps": f"{progress.step} of {settings.steps}, {settings.batch} samples each, {settings.precision}, "
        f"{progress.seconds:.0f} s",
        "loss": (f"{np.mean(head):.3f} at the start, {np.mean(tail):.3f} at the end" if tail else "of no step")
        + (f"; ended early: {progress.fault}" if progress.fault else ""),
        "validation": f"{told_iterations(progress.validations[0][1])} iterations at the start, "
        f"{told_iterations(min(v for _, v in progress.validations))} at step {progress.best_step}, whose weights these "
        "are",
        "parameters": sum(values.size for values in progress.best.values()),
        "sha256": f"`{digest}`",
    }


def trained_range(settings: TrainingSettings) -> TrainedRange:
    """What weights of such a run are for.

    On the route of Ritz vectors, which trains on the empty box, solids count as far as the validation has some; it does
    not train on air.
    """
    largest = max(_test_cells(settings))
    if settings.kind == "dcdm" and settings.route == "ritz":
        closed = [system for system in validation_systems(settings) if system.n_closed]
        return TrainedRange(largest, False, min(s.n_unknowns for s in closed) / float(np.prod(settings.shape)))
    return TrainedRange(largest, True, LEAST_FLUID)


def _test_cells(settings: TrainingSettings) -> tuple[int, int]:
    return settings.cells, 2 * settings.cells


def _test_systems(settings: TrainingSettings) -> list[tuple[str, PressureSystem]]:
    found = []
    for cells in _test_cells(settings):
        shape = (cells,) * settings.dim
        labels = {
            "empty box": np.full(shape, FLUID, dtype=np.uint8),
            "seven ellipsoids": blob_labels(shape, False),
            "seven ellipsoids, open": blob_labels(shape, True),
            "30 % random solids": porous_labels(shape, 0.3),
            "plates with slits": plate_labels(shape),
        }
        size = "^".join(map(str, (cells, settings.dim)))
        if settings.kind == "dcdm" and labels["empty box"].size > _DEAR:
            labels = dict(list(labels.items())[:3])
        found += [(f"{name}, {size}", PressureSystem(each)) for name, each in labels.items()]
    return found


def _row(label: str, system: PressureSystem, learner: Learner, progress: Progress, settings: TrainingSettings) -> str:
    b = smooth_divergence(system, _SEED)
    most = _MOST[settings.kind]
    # What a network costs in three dimensions allows no more than this.
    is_dear = settings.kind == "dcdm" and system.n_unknowns > _DEAR
    solvers: list[PoissonSolver | None] = [
        None if is_dear else learner.solver(system, progress.start),
        learner.solver(system, progress.best),
        ConjugateGradients(system, Multigrid(system, 1)),
        ConjugateGradients(system, Multigrid(system, 2)),
    ]
    counts = []
    for solver in solvers:
        if solver is None:
            counts.append("-")
            continue
        answer = solver.solve(b, TOLERANCE, most)
        counts.append(str(answer.iterations) if answer.converged else f"over {answer.iterations}")
    return f"| {label} | {' | '.join(counts)} |"


def _start(path: Path | None) -> str:
    """What the parameters were before the first step."""
    if path is None:
        return "random"
    return f"`{path.name}`, SHA-256 `{hashlib.sha256(path.read_bytes()).hexdigest()}`"


def _draw(progress: Progress, path: Path) -> None:
    from matplotlib.figure import Figure
    from matplotlib.ticker import ScalarFormatter

    figure = Figure(figsize=(7.0, 3.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    losses = np.array(progress.losses)
    left.plot(np.arange(1, losses.size + 1), losses, color="0.8", linewidth=0.6, label="step")
    width = max(1, losses.size // 50)
    if losses.size >= width > 1:
        smooth = np.convolve(losses, np.full(width, 1.0 / width), mode="valid")
        left.plot(np.arange(width, losses.size + 1), smooth, color="C0", label=f"mean of {width}")
    left.set(xlabel="step", ylabel="loss")
    left.legend()
    steps, iterations = np.array(progress.validations).T
    right.plot(steps, np.minimum(iterations, MOST_ITERATIONS), "o-", color="C1", markersize=3)
    right.set(xlabel="step", ylabel=f"iterations, validation, {MOST_ITERATIONS} at most", yscale="log")
    for axis in (right.yaxis.set_major_formatter, right.yaxis.set_minor_formatter):
        axis(ScalarFormatter())  # 12, and not 1.2 x 10^1
    figure.savefig(path, dpi=120)
