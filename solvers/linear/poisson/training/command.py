"""`femdeform train`."""

from __future__ import annotations

import math
import os
from collections.abc import Collection
from pathlib import Path
from typing import Any

from femdeform.errors import InputError, NotConvergedError
from femdeform.run.terminal import Bar
from solvers.linear.poisson.training.settings import MODELS, TrainingSettings

# Options of the networks of dcdm, and of its route of Ritz vectors.
_DCDM = ("route", "model", "precision", "lanczos", "samples")
_RITZ = ("lanczos", "samples")


def train_command(
    settings: TrainingSettings, name: str, command: str, resume: bool, quiet: bool, given: Collection[str] = ()
) -> list[Path]:
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
    given : collection of str
        Names of the settings that were asked for, and are not defaults.

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
    NotConvergedError
        If the loss left the finite numbers; the files hold the best weights before.
    """
    # OpenMP's threads would spin beside those of the kernels.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    from femdeform import registry

    run_training = registry.resolve("solvers.linear.poisson.training.loop:run_training")
    learners = {"spd_lmg": "learn_lmg:LMGLearner", "dcdm": "learn_dcdm:DCDMLearner"}
    make = registry.resolve(f"solvers.linear.poisson.training.{learners[settings.kind]}")
    _check(settings, resume, given)
    settings.out.mkdir(parents=True, exist_ok=True)
    learner = make(settings)
    with _Progress(settings, quiet) as bar:
        progress = run_training(settings, learner, resume, bar.tell)
    from solvers.linear.poisson.training.report import write_results

    written = write_results(settings, learner, progress, command, name)
    if progress.fault:
        raise NotConvergedError(
            f"training ended: {progress.fault}; {written[0]} holds the best weights until then, those of step "
            f"{progress.best_step}. A lower --rate may help"
        )
    return written


def _check(settings: TrainingSettings, resume: bool, given: Collection[str]) -> None:
    import torch

    from solvers.linear.poisson.training.loop import CHECKPOINT

    for name in _DCDM:
        if name in given and settings.kind != "dcdm":
            raise InputError(f"--{name}: is for dcdm, not for {settings.kind}")
        if name in given and name in _RITZ and settings.route != "ritz":
            raise InputError(f"--{name}: is for --route ritz")
    if not (math.isfinite(settings.rate) and settings.rate > 0.0):
        raise InputError(f"--rate: must be a positive number, not {settings.rate:g}")
    if settings.minutes is not None and not (math.isfinite(settings.minutes) and settings.minutes > 0.0):
        raise InputError(f"--minutes: must be a positive number [min], not {settings.minutes:g}")
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


class _Progress(Bar):
    """How far it is: a bar on a terminal, elsewhere a line for each validation."""

    def __init__(self, settings: TrainingSettings, quiet: bool) -> None:
        super().__init__(not quiet, "{task.completed}/{task.total}, {task.fields[numbers]}")
        self._steps, self._validations = settings.steps, 0

    def _first_task(self, bar: Any) -> Any:
        return bar.add_task("training", total=self._steps, numbers="")

    def tell(self, progress: Any) -> None:
        """After a step."""
        from solvers.linear.poisson.training.loop import told_iterations

        count = told_iterations(progress.validations[-1][1])
        numbers = f"loss {progress.losses[-1]:.3f}, validation {count} iterations"
        self._update(completed=progress.step, numbers=numbers)
        if len(progress.validations) > self._validations and self._live is None:
            self.notice(f"step {progress.step} of {self._steps}: {numbers}")
        self._validations = len(progress.validations)
