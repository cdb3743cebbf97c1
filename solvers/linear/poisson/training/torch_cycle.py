"""The learned multigrid cycle on batches of domains, differentiable."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from femdeform.flow.pressure_system import PressureSystem
from solvers.linear.poisson import spd_lmg_network as network
from solvers.linear.poisson.multigrid import COARSEST_SWEEPS, OVERCORRECTION
from solvers.linear.poisson.multigrid_levels import EvenSurface, make_levels
from solvers.linear.poisson.spd_lmg import finest_weights


@dataclass
class LevelArrays:
    """One level of one domain as NumPy has it: padded, in two dimensions without the third axis."""

    diagonal: Any
    weights: Any
    values: Any
    shares: Any


def domain_levels(system: PressureSystem) -> list[LevelArrays]:
    """All levels of a domain, the coarsest without features."""
    levels = make_levels(system, EvenSurface(system), np.float32)
    found = []
    for k, level in enumerate(levels):
        weights = level.weights or finest_weights(system, np.float32)
        diagonal = level.diagonal.astype(np.float32)
        values = shares = None
        if k + 1 < len(levels):
            values = np.moveaxis(network.features(diagonal, weights, system.dim), -1, 0)
            shares = network.parent_shares(diagonal, weights, levels[k + 1].diagonal, system.dim)
        arrays = [diagonal, np.stack(weights[: system.dim]), values, shares]
        if system.dim == 2:
            arrays = [None if a is None else a[..., 1] for a in arrays]
        found.append(LevelArrays(*arrays))
    return found


class BatchLevel:
    """One level of a batch: matrix, colours, features and where parents are."""

    def __init__(self, arrays: list[LevelArrays], coarse_shape: tuple[int, ...] | None, dim: int, device: str) -> None:
        def stacked(name: str) -> Tensor:
            return torch.as_tensor(np.stack([getattr(a, name) for a in arrays]), device=device)

        self.dim = dim
        self.diagonal, weights = stacked("diagonal"), stacked("weights")
        self.weights = [weights[:, axis] for axis in range(dim)]
        self.inverse = torch.where(self.diagonal > 0, 1.0 / self.diagonal.clamp(min=1e-30), torch.zeros(()))
        shape = arrays[0].diagonal.shape
        colours = network.colours((*shape, 3)[:3])
        colours = colours[..., 1] if dim == 2 else colours
        self.colours = [torch.as_tensor(colours == c, device=device) for c in (False, True)]
        if coarse_shape is None:
            return
        self.shares = stacked("shares")
        self.valid = (self.shares > 0).float()
        self.values = stacked("values")[(slice(None), slice(None), *(slice(1, -1),) * dim)].contiguous()
        self.parents = [torch.as_tensor(index, device=device) for index in parent_indices(shape, coarse_shape)]
        self.coarse_shape = coarse_shape

    def times(self, x: Tensor) -> Tensor:
        """A x."""
        out = self.diagonal * x
        for axis, w in enumerate(self.weights):
            out = out - w * torch.roll(x, -1, axis + 1) - torch.roll(w * x, 1, axis + 1)
        return out

    def sweep(self, omega: Tensor, b: Tensor, x: Tensor | None, first: int) -> Tensor:
        """One relaxed red-black sweep; None is zero."""
        for colour in (first, 1 - first):
            r = b if x is None else b - self.times(x)
            step = torch.where(self.colours[colour], omega * self.inverse * r, torch.zeros(()))
            x = step if x is None else x + step
        assert x is not None
        return x

    def restrict(self, weights: Tensor, fine: Tensor) -> Tensor:
        """To the next level, with the transpose of `prolong`."""
        n = fine.shape[0]
        out = fine.new_zeros((n, int(np.prod(self.coarse_shape))))
        for slot, index in enumerate(self.parents):
            out = out.index_add(1, index, (weights[:, slot] * fine).reshape(n, -1))
        return out.reshape(n, *self.coarse_shape)

    def prolong(self, weights: Tensor, coarse: Tensor) -> Tensor:
        """From the next level."""
        n = coarse.shape[0]
        flat = coarse.reshape(n, -1)
        parts = [
            weights[:, slot] * flat.index_select(1, index).reshape(self.diagonal.shape)
            for slot, index in enumerate(self.parents)
        ]
        return torch.stack(parts).sum(dim=0)


def parent_indices(shape: tuple[int, ...], coarse: tuple[int, ...]) -> list[Any]:
    """Flat index of each voxel's parents, one array a slot; those outside of the grid are clipped."""
    near = [(np.arange(n) + 1) // 2 for n in shape]
    beside = [p - 2 * (np.arange(n) % 2) + 1 for p, n in zip(near, shape, strict=True)]
    found = []
    for slot in range(2 ** len(shape)):
        at = [beside[a] if slot >> a & 1 else near[a] for a in range(len(shape))]
        at = [np.clip(a, 0, n - 1) for a, n in zip(at, coarse, strict=True)]
        found.append(np.ravel_multi_index(tuple(np.ix_(*at)), coarse).reshape(-1))
    return found


class BatchCycle:
    """The cycle of `LearnedMultigrid` on a batch of domains of one size.

    Parameters
    ----------
    domains : list of list of LevelArrays
    dim : int
    device : str
    """

    def __init__(self, domains: list[list[LevelArrays]], dim: int, device: str) -> None:
        self.dim = dim
        self.levels = []
        for k in range(len(domains[0])):
            coarse = domains[0][k + 1].diagonal.shape if k + 1 < len(domains[0]) else None
            self.levels.append(BatchLevel([d[k] for d in domains], coarse, dim, device))
        self.unknown = self.levels[0].diagonal > 0

    def prepare(self, parameters: dict[str, Tensor]) -> list[tuple[Tensor, Tensor, Tensor]]:
        """Relaxation, weights of parents and factor of each level: once for a step."""
        found = []
        for k, level in enumerate(self.levels[:-1]):
            answer = _heads(parameters, network.NETWORKS[min(k, 1)], level.values, self.dim)
            answer = torch.nn.functional.pad(answer, (1,) * (2 * self.dim))
            logit = torch.where(level.colours[1], answer[:, 1], answer[:, 0])
            omega = 2.0 * torch.sigmoid(logit.clamp(-network.LARGEST_LOGIT, network.LARGEST_LOGIT))
            raw = answer[:, 2:]
            mean = (raw * level.valid).sum(dim=1, keepdim=True) / level.valid.sum(dim=1, keepdim=True).clamp(min=1.0)
            factor = OVERCORRECTION * torch.exp(parameters["factors"][min(k, network.LEVELS - 1)])
            found.append((omega, level.shares + (raw - mean) * level.valid, factor))
        return found

    def apply(self, learned: list[tuple[Tensor, Tensor, Tensor]], r: Tensor, k: int = 0) -> Tensor:
        """One V-cycle."""
        level = self.levels[k]
        if k == len(learned):
            x = None
            one = torch.ones_like(r)
            for first in (0, 1):
                for _ in range(COARSEST_SWEEPS):
                    x = level.sweep(one, r, x, first)
            assert x is not None
            return x
        omega, weights, factor = learned[k]
        x = level.sweep(omega, r, None, 0)
        coarse = self.apply(learned, level.restrict(weights, r - level.times(x)), k + 1)
        return level.sweep(omega, r, x + factor * level.prolong(weights, coarse), 1)


def _heads(parameters: dict[str, Tensor], net: str, values: Tensor, dim: int) -> Tensor:
    convolve = torch.nn.functional.conv2d if dim == 2 else torch.nn.functional.conv3d
    kernel = parameters[f"{net}.kernel"].movedim((-1, -2), (0, 1))
    hidden = torch.relu(convolve(values, kernel, parameters[f"{net}.bias"], padding=1))
    for layer in ("inner", "heads"):
        dense = parameters[f"{net}.{layer}.kernel"].T.reshape(-1, network.CHANNELS, *(1,) * dim)
        hidden = convolve(hidden, dense, parameters[f"{net}.{layer}.bias"])
        if layer == "inner":
            hidden = torch.relu(hidden)
    return hidden
