"""The loop of a training run: steps, validation, checkpoints."""

from __future__ import annotations

import math
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from femdeform.errors import InputError
from femdeform.flow.pressure_system import FLUID, PressureSystem
from solvers.linear.poisson.interface import PoissonSolver
from solvers.linear.poisson.training.domains import blob_labels, random_labels, smooth_divergence
from solvers.linear.poisson.training.settings import TrainingSettings

CHECKPOINT = "checkpoint.pt"
TOLERANCE = 1e-4
MOST_ITERATIONS = 80
_CLIP = 1.0
_WARM_UP = 0.02


class Learner(Protocol):
    """What is trained."""

    parameters: dict[str, Tensor]

    def loss(self) -> Tensor:
        """Loss of the next batch."""

    def solver(self, system: PressureSystem, parameters: dict[str, NDArray[Any]]) -> PoissonSolver:
        """What the parameters are for."""

    def meta(self) -> dict[str, Any]:
        """What a weights file says of the network."""

    def state(self) -> dict[str, Any]:
        """All that a resumed run needs beside the parameters."""

    def restore(self, state: dict[str, Any]) -> None:
        """Take what `state` returned."""


def _commit() -> str:
    """Of the source, where it lies in a repository."""
    folder = Path(__file__).parent
    try:
        run = subprocess.run(
            ["git", "-C", str(folder), "describe", "--always", "--dirty", "--abbrev=12"],
            capture_output=True,
            text=True,
            check=True,
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return run.stdout.strip()


@dataclass
class Progress:
    """How far a run has come.

    Attributes
    ----------
    step : int
    seconds : float
    losses : list of float
        One a step.
    validations : list of (step, iterations)
        Mean iterations on the validation systems, with a fraction for the last one.
    start, best : dict of str to array
        Parameters at the start, and those of the validation with the fewest iterations.
    commit : str
        Of the source that began to train, where it lies in a repository.
    fault : str
        Why it ended before its time, if something went wrong.
    """

    step: int = 0
    seconds: float = 0.0
    losses: list[float] = field(default_factory=list)
    validations: list[tuple[int, float]] = field(default_factory=list)
    start: dict[str, NDArray[Any]] = field(default_factory=dict)
    best: dict[str, NDArray[Any]] = field(default_factory=dict)
    commit: str = field(default_factory=_commit)
    fault: str = ""

    @property
    def best_step(self) -> int:
        """Step of `best`."""
        return min(self.validations, key=lambda each: each[1])[0]


def run_training(
    settings: TrainingSettings, learner: Learner, resume: bool, tell: Callable[[Progress], None]
) -> Progress:
    """Train; what came of it.

    Parameters
    ----------
    settings : TrainingSettings
        What to do.
    learner : Learner
        What is trained.
    resume : bool
        Go on from the checkpoint in the folder.
    tell : callable
        Called after each step.

    Returns
    -------
    Progress
        With a `fault` where a loss or its gradient was no finite number; that step is not taken.

    Raises
    ------
    InputError
        If there is no checkpoint to go on from, or it is one of other settings.
    """
    torch.manual_seed(settings.seed)
    for values in learner.parameters.values():
        values.requires_grad_(True)
    optimizer = torch.optim.Adam(list(learner.parameters.values()), lr=settings.rate)
    schedule = torch.optim.lr_scheduler.LambdaLR(optimizer, lambda step: _rate(step, settings.steps))
    progress = Progress()
    if resume:
        progress = _restore(settings, learner, optimizer, schedule)
    systems = validation_systems(settings)
    every = max(1, settings.steps // settings.validations)
    if not progress.validations:
        progress.start = arrays(learner)
        _validate(learner, systems, progress)
    begin = time.perf_counter() - progress.seconds
    while progress.step < settings.steps and not _is_late(settings, progress):
        loss = learner.loss()
        optimizer.zero_grad()
        loss.backward()
        size = float(torch.nn.utils.clip_grad_norm_(list(learner.parameters.values()), _CLIP))
        if not (math.isfinite(float(loss.detach())) and math.isfinite(size)):
            what = "the gradient of the loss" if math.isfinite(float(loss.detach())) else "the loss"
            progress.fault = f"{what} was no finite number in step {progress.step + 1}"
            break
        optimizer.step()
        schedule.step()
        progress.step += 1
        progress.losses.append(float(loss.detach()))
        progress.seconds = time.perf_counter() - begin
        if progress.step % every == 0 or progress.step == settings.steps or _is_late(settings, progress):
            _validate(learner, systems, progress)
            _save(settings, learner, optimizer, schedule, progress)
        tell(progress)
    return progress


def _rate(step: int, steps: int) -> float:
    """Part of the learning rate: it rises for a fiftieth of the steps, as first gradients say little, then falls."""
    return min(1.0, (step + 1) / (_WARM_UP * steps)) * 0.5 * (1.0 + math.cos(math.pi * step / steps))


def _is_late(settings: TrainingSettings, progress: Progress) -> bool:
    return settings.minutes is not None and progress.seconds > 60.0 * settings.minutes


def arrays(learner: Learner) -> dict[str, NDArray[Any]]:
    """Parameters as NumPy has them."""
    return {name: values.detach().cpu().numpy().copy() for name, values in learner.parameters.items()}


def validation_systems(settings: TrainingSettings) -> list[PressureSystem]:
    """The empty box, ellipsoids, closed and open, and four random domains: none of them is trained on."""
    rng = np.random.default_rng(987_654)
    labels = [np.full(settings.shape, FLUID, dtype=np.uint8)]
    labels += [blob_labels(settings.shape, is_open, seed=21) for is_open in (False, True)]
    labels += [random_labels(settings.shape, rng, settings.hard_part) for _ in range(4)]
    return [PressureSystem(each) for each in labels]


def fractional_iterations(residuals: list[float], tolerance: float) -> float:
    """Iterations until the residual meets the tolerance, the last one in part; more than all if it never does."""
    logs = np.log(np.maximum(residuals, 1e-300)) - np.log(residuals[0])
    target = np.log(tolerance)
    below = np.flatnonzero(logs <= target)
    if below.size == 0:
        slope = min(logs[-1] / max(len(logs) - 1, 1), -1e-3)
        return float(target / slope) if np.isfinite(slope) else float(1e3 * MOST_ITERATIONS)
    k = int(below[0])
    return float(k - 1 + (target - logs[k - 1]) / (logs[k] - logs[k - 1])) if k else 0.0


def told_iterations(iterations: float) -> str:
    """Iterations of a validation, which ends at some number of them: what lies beyond was not measured."""
    return f"over {MOST_ITERATIONS}" if iterations > MOST_ITERATIONS else f"{iterations:.2f}"


def _validate(learner: Learner, systems: list[PressureSystem], progress: Progress) -> None:
    parameters = arrays(learner)
    counts = []
    for seed, system in enumerate(systems):
        answer = learner.solver(system, parameters).solve(smooth_divergence(system, seed), TOLERANCE, MOST_ITERATIONS)
        counts.append(fractional_iterations(answer.residuals, TOLERANCE))
    mean = float(np.mean(counts))
    if not progress.validations or mean < min(each[1] for each in progress.validations):
        progress.best = parameters
    progress.validations.append((progress.step, mean))


def _save(settings: TrainingSettings, learner: Learner, optimizer: Any, schedule: Any, progress: Progress) -> None:
    held = {
        "settings": settings.facts(),
        "parameters": arrays(learner),
        "optimizer": optimizer.state_dict(),
        "schedule": schedule.state_dict(),
        "learner": learner.state(),
        "progress": vars(progress),
    }
    partial = settings.out / f"{CHECKPOINT}.part"
    torch.save(held, partial)
    partial.replace(settings.out / CHECKPOINT)


def _restore(settings: TrainingSettings, learner: Learner, optimizer: Any, schedule: Any) -> Progress:
    path: Path = settings.out / CHECKPOINT
    if not path.is_file():
        raise InputError(f"{path}: there is no checkpoint to go on from")
    # Arrays of NumPy are in it: only files of one's own should be read.
    held = torch.load(path, weights_only=False)
    told, asked = (dict(facts, minutes=None) for facts in (held["settings"], settings.facts()))
    if told != asked:
        other = ", ".join(key for key in asked if asked[key] != told.get(key))
        raise InputError(f"{path}: the checkpoint has another {other}")
    with torch.no_grad():
        for name, values in learner.parameters.items():
            values.copy_(torch.as_tensor(held["parameters"][name]))
    optimizer.load_state_dict(held["optimizer"])
    schedule.load_state_dict(held["schedule"])
    learner.restore(held["learner"])
    return Progress(**held["progress"])
