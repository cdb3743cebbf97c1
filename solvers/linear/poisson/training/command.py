"""`femdeform train`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from femdeform.errors import InputError
from solvers.linear.poisson.training.settings import MODELS, TrainingSettings


def train_command(settings: TrainingSettings, name: str, command: str, resume: bool, quiet: bool) -> list[Path]:
    """Train weights and write them with their card.

    Parameters
    ----------
    settings : TrainingSettings
        What to do.
    name : str
        Of the files.
    command : str
        What was typed, for the card.
    resume : bool
        Go on from the folder's checkpoint.
    quiet : bool
        No progress.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    MissingDependencyError
        If there is no PyTorch.
    InputError
        If settings do not fit together, or the folder does not fit them.
    """
    # OpenMP's threads would spin beside those of the kernels.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    from femdeform import registry

    run_training = registry.resolve("solvers.linear.poisson.training.loop:run_training")
    learners = {"spd_lmg": "learn_lmg:LMGLearner", "dcdm": "learn_dcdm:DCDMLearner"}
    make = registry.resolve(f"solvers.linear.poisson.training.{learners[settings.kind]}")
    _check(settings, resume)
    settings.out.mkdir(parents=True, exist_ok=True)
    learner = make(settings)
    with _Bar(settings, quiet) as bar:
        progress = run_training(settings, learner, resume, bar.tell)
    from solvers.linear.poisson.training.report import write_results

    return write_results(settings, learner, progress, command, name)


def _check(settings: TrainingSettings, resume: bool) -> None:
    import torch

    from solvers.linear.poisson.training.loop import CHECKPOINT

    if settings.model not in MODELS:
        raise InputError(f"--model: there is no {settings.model}; there are {', '.join(MODELS)}")
    if settings.kind == "dcdm" and settings.cells % 2:
        raise InputError("--cells: the network needs an even number")
    if settings.hard is not None and not 0.0 <= settings.hard <= 1.0:
        raise InputError("--hard: a part lies between 0 and 1")
    if settings.device == "cuda" and not torch.cuda.is_available():
        raise InputError("--device: PyTorch finds no CUDA device")
    if (settings.out / CHECKPOINT).exists() and not resume:
        raise InputError(f"{settings.out}: holds a run already; go on with --resume, or name another folder")


class _Bar:
    """A line that says how far it is."""

    def __init__(self, settings: TrainingSettings, quiet: bool) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        columns = [BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), TextColumn("{task.description}")]
        self._rich = Progress(*columns, console=Console(stderr=True), disable=quiet)
        self._task = self._rich.add_task("", total=settings.steps)

    def __enter__(self) -> _Bar:
        self._rich.start()
        return self

    def __exit__(self, *_: Any) -> None:
        self._rich.stop()

    def tell(self, progress: Any) -> None:
        """After a step."""
        text = f"loss {progress.losses[-1]:.3f}, validation {progress.validations[-1][1]:.1f} iterations"
        self._rich.update(self._task, completed=progress.step, description=text)
