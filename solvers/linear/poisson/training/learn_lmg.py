"""What a training run of the learned multigrid cycle does in a step."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from femdeform.flow.pressure_system import PressureSystem
from solvers.linear.poisson import spd_lmg_network as network
from solvers.linear.poisson.conjugate_gradients import ConjugateGradients
from solvers.linear.poisson.interface import PoissonSolver
from solvers.linear.poisson.spd_lmg import LearnedMultigrid
from solvers.linear.poisson.training.domains import random_labels
from solvers.linear.poisson.training.settings import TrainingSettings
from solvers.linear.poisson.training.torch_cycle import BatchCycle, domain_levels
from solvers.linear.poisson.weights_file import load_weights

# Batches of domains that take turns, and steps until one is made anew.
_GROUPS = 3
_LIFETIME = (4, 13)
_TINY = 1e-20


class _Group:
    """A batch of domains and the errors that are left on them."""

    def __init__(self, labels: list[NDArray[np.uint8]], errors: Tensor | None, steps: int, device: str) -> None:
        self.labels, self.steps = labels, steps
        systems = [PressureSystem(each) for each in labels]
        self.cycle = BatchCycle([domain_levels(s) for s in systems], systems[0].dim, device)
        closed = torch.tensor([s.n_closed > 0 for s in systems], device=device)
        # Domains have one component: its mean, where it is closed.
        counts = self.cycle.unknown.flatten(1).sum(dim=1)
        shape = (-1, *(1,) * systems[0].dim)
        self._inverse_counts = torch.where(closed, 1.0 / counts, torch.zeros(())).reshape(shape)
        self.errors = torch.zeros_like(self.cycle.levels[0].diagonal) if errors is None else errors

    def project(self, x: Tensor) -> Tensor:
        x = torch.where(self.cycle.unknown, x, torch.zeros(()))
        mean = x.flatten(1).sum(dim=1).reshape(self._inverse_counts.shape) * self._inverse_counts
        return torch.where(self.cycle.unknown, x - mean, torch.zeros(()))


class LMGLearner:
    """Random domains, errors that the cycle itself has left, and the factor by which a step shortens them.

    The loss is ``sqrt(1 - (r.z)^2/((z.A z)(e.r)))``, the factor of the energy norm of e by a line search along z = B r;
    after some steps e holds what the cycle is worst at, and the loss tends to (kappa - 1)/(kappa + 1).
    """

    def __init__(self, settings: TrainingSettings) -> None:
        self._settings = settings
        self._rng = np.random.default_rng(settings.seed)
        start = network.start_parameters(settings.dim, self._rng)
        if settings.start is not None:
            start = load_weights(str(settings.start), "spd_lmg", settings.dim).parameters
        self.parameters = {name: torch.tensor(v, device=settings.device) for name, v in start.items()}
        self._groups = [self._new_group() for _ in range(_GROUPS)]
        self._turn = 0

    def _new_group(self) -> _Group:
        settings = self._settings
        labels = [random_labels(settings.shape, self._rng, settings.hard_part) for _ in range(settings.batch)]
        group = _Group(labels, None, int(self._rng.integers(*_LIFETIME)), settings.device)
        noise = self._rng.standard_normal(group.errors.shape).astype(np.float32)
        group.errors = group.project(torch.as_tensor(noise, device=settings.device))
        return group

    def loss(self) -> Tensor:
        """Mean factor over a batch; takes the step in the errors."""
        self._turn = (self._turn + 1) % _GROUPS
        group = self._groups[self._turn]
        if group.steps == 0:
            group = self._groups[self._turn] = self._new_group()
        group.steps -= 1
        finest = group.cycle.levels[0]
        e = group.errors
        r = finest.times(e)
        size = dots(e, r).clamp(min=_TINY).rsqrt()
        e, r = e * over(size, e), r * over(size, r)
        z = group.project(group.cycle.apply(group.cycle.prepare(self.parameters), r))
        Az = finest.times(z)
        rz, zAz = dots(r, z), dots(z, Az).clamp(min=_TINY)
        group.errors = (e - over(rz / zAz, z) * z).detach()
        return (1.0 - rz**2 / zAz).clamp(min=1e-6).sqrt().mean()

    def solver(self, system: PressureSystem, parameters: dict[str, NDArray[Any]]) -> PoissonSolver:
        """What the parameters are for."""
        return ConjugateGradients(system, LearnedMultigrid(system, parameters), "spd_lmg")

    def meta(self) -> dict[str, Any]:
        """What a weights file says of the network."""
        return {"kind": "spd_lmg", "dim": self._settings.dim}

    def state(self) -> dict[str, Any]:
        """All that a resumed run needs beside the parameters."""
        groups = [(g.labels, g.errors.cpu(), g.steps) for g in self._groups]
        return {"groups": groups, "turn": self._turn, "rng": self._rng.bit_generator.state}

    def restore(self, state: dict[str, Any]) -> None:
        """Take what `state` returned."""
        device = self._settings.device
        self._groups = [_Group(labels, e.to(device), steps, device) for labels, e, steps in state["groups"]]
        self._turn = state["turn"]
        self._rng.bit_generator.state = state["rng"]


def dots(x: Tensor, y: Tensor) -> Tensor:
    """Inner product of each sample."""
    return (x * y).flatten(1).sum(dim=1)


def over(values: Tensor, like: Tensor) -> Tensor:
    """One number a sample, for products with fields."""
    return values.reshape(-1, *(1,) * (like.dim() - 1))
