"""What a training run of deep conjugate directions does in a step, on either route."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from femdeform.errors import InputError
from femdeform.flow.pressure_system import FLUID, GridArray, PressureSystem
from solvers.linear.poisson.conjugate_gradients import ConjugateGradients
from solvers.linear.poisson.dcdm import DeepConjugateDirections
from solvers.linear.poisson.dcdm_network import (
    Architecture,
    NetworkDirections,
    evaluate,
    glorot_parameters,
    network_masks,
)
from solvers.linear.poisson.interface import PoissonSolver
from solvers.linear.poisson.multigrid import Multigrid
from solvers.linear.poisson.training.domains import random_labels
from solvers.linear.poisson.training.learn_lmg import dots, over
from solvers.linear.poisson.training.ritz import ritz_pairs, ritz_right_sides
from solvers.linear.poisson.training.settings import MODELS, TrainingSettings
from solvers.linear.poisson.weights_file import load_weights

_POOL = 48
_FRESH = 0.03
# An error that has become so small in the energy norm is replaced.
_REDUCED = 3e-5
_OBSTACLES = 0.6
# Domains with solids whose air, if any, is not at the top.
_TURNED = 0.25
# Multigrid finds the first error of a sample to this part of its residual.
_EXACT, _MOST = 1e-6, 200
_TINY = 1e-20


class TorchOperations:
    """Operations on (batch, channels, ..) tensors; kernels are stored as NumPy has them, (3, .., in, out)."""

    def convolve(self, x: Tensor, kernel: Tensor, bias: Tensor | None, is_cut: bool, plus: Tensor | None) -> Tensor:
        """Convolution with zeros outside of the grid, its positive part if `is_cut`, and then the sum with `plus`."""
        flat = x.dim() == 4
        convolve = torch.nn.functional.conv2d if flat else torch.nn.functional.conv3d
        # Channels last is the faster order for few channels; what follows keeps it.
        x = x.contiguous(memory_format=torch.channels_last if flat else torch.channels_last_3d)
        out = convolve(x, kernel.movedim((-1, -2), (0, 1)), bias, padding=kernel.shape[0] // 2)
        out = torch.relu(out) if is_cut else out
        return out if plus is None else out + plus

    def halve(self, x: Tensor) -> Tensor:
        """Means of 2^dim voxels."""
        pool = torch.nn.functional.avg_pool2d if x.dim() == 4 else torch.nn.functional.avg_pool3d
        return pool(x, 2)

    def double(self, x: Tensor, plus: Tensor | None) -> Tensor:
        """The nearest value on the finer grid, and the sum with `plus`."""
        out = torch.nn.functional.interpolate(x, scale_factor=2, mode="nearest")
        return out if plus is None else out + plus


class _Domains:
    """Matrix and masks of a number of domains, without padding: (n, ..)."""

    def __init__(self, n: int, shape: tuple[int, ...], device: str) -> None:
        self.diagonal = torch.zeros((n, *shape), device=device)
        self.masks = torch.zeros((n, 2, *shape), device=device)
        self.inverse_counts = torch.zeros(n, device=device)

    def put(self, slot: int, labels: NDArray[np.uint8]) -> None:
        system = PressureSystem(labels)
        device = self.diagonal.device
        inner = system.diagonal[1:-1, 1:-1, 1:-1].reshape(labels.shape)
        self.diagonal[slot] = torch.as_tensor(inner.astype(np.float32), device=device)
        self.masks[slot] = torch.as_tensor(network_masks(system), device=device)
        self.inverse_counts[slot] = 1.0 / system.n_unknowns if system.n_closed else 0.0

    def times(self, slots: Tensor, x: Tensor) -> Tensor:
        """A x for x that is zero where there is no unknown."""
        out = self.diagonal[slots] * x
        for axis in range(1, x.dim()):
            n = x.shape[axis]
            zeros = torch.zeros_like(x.narrow(axis, 0, 1))
            out = out - torch.cat([x.narrow(axis, 1, n - 1), zeros], axis)
            out = out - torch.cat([zeros, x.narrow(axis, 0, n - 1)], axis)
        return out * (self.diagonal[slots] > 0)

    def project(self, slots: Tensor, x: Tensor) -> Tensor:
        unknown = self.diagonal[slots] > 0
        x = x * unknown
        return (x - over(x.flatten(1).sum(dim=1) * self.inverse_counts[slots], x)) * unknown


def _start(settings: TrainingSettings, architecture: Architecture) -> dict[str, NDArray[np.float32]]:
    """Weights of a file for this network."""
    weights = load_weights(str(settings.start), "dcdm", settings.dim)
    if Architecture(settings.dim, **weights.meta["architecture"]) != architecture:
        raise InputError(f"--start: {settings.start} holds weights of another network than --model {settings.model}")
    return weights.parameters


def _turned(labels: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    """The domain with its axes permuted and mirrored: air on any side."""
    turned = np.transpose(labels, rng.permutation(labels.ndim))
    return np.ascontiguousarray(turned[tuple(slice(None, None, int(rng.choice((-1, 1)))) for _ in labels.shape)])


def _right_side(system: PressureSystem, rng: np.random.Generator) -> GridArray:
    """Random cosine coefficients of random decay, from rough to smooth, half of them under a window."""
    from scipy.fft import idctn

    shape = system.shape[: system.dim]
    waves = np.indices(shape)
    value = sum(2.0 - 2.0 * np.cos(np.pi * waves[axis] / shape[axis]) for axis in range(len(shape)))
    value.flat[0] = 1.0
    coefficients = rng.standard_normal(shape) * value ** -rng.uniform(-0.2, 0.8)
    coefficients.flat[0] = 0.0
    values = idctn(coefficients, norm="ortho")
    if rng.random() < 0.5:
        places = np.moveaxis(waves, 0, -1) - rng.random(len(shape)) * shape
        width = rng.uniform(0.08, 0.4) * shape[0]
        values *= np.exp(-0.5 * (places**2).sum(axis=-1) / width**2)
    b = system.new_field()
    b[1:-1, 1:-1, 1:-1] = values.reshape(system.shape)
    b[~system.unknown] = 0.0
    system.project(b)
    return b


class DCDMLearner:
    """Both routes of training deep conjugate directions.

    *On policy*: each sample of a pool is a domain, an error e, its residual r = A e and the last direction. A step
    finds a direction q from r, makes it A-orthogonal to the last one, and the loss is the factor of the energy norm of
    e, ``sqrt(1 - (r.q)^2/((q.A q)(e.r)))``; then e moves on by that very step. A sample starts with a right-hand side
    of random cosine coefficients of random decay, half of them under a window, in the empty box or in a domain with
    solids and air, whose error multigrid finds.

    *Ritz*, the source's: right-hand sides b that are random sums of Ritz vectors of the empty box, loss
    ``|b - alpha A f(b)|`` with b of unit length.
    """

    def __init__(self, settings: TrainingSettings) -> None:
        if settings.cells % 2:
            raise ValueError("the network needs an even number of cells")
        self._settings = settings
        self._rng = np.random.default_rng(settings.seed)
        self._generator = torch.Generator().manual_seed(settings.seed)
        self.architecture = Architecture(settings.dim, **MODELS[settings.model])
        start = glorot_parameters(self.architecture, self._rng)
        if settings.start is not None:
            start = _start(settings, self.architecture)
        self.parameters = {name: torch.tensor(v, device=settings.device) for name, v in start.items()}
        self._operations = TorchOperations()
        if settings.route == "ritz":
            self._domains = _Domains(1, settings.shape, settings.device)
            self._domains.put(0, np.full(settings.shape, FLUID, dtype=np.uint8))
            system = PressureSystem(np.full(settings.shape, FLUID, dtype=np.uint8))
            vectors = ritz_pairs(system, settings.lanczos, self._rng)[1]
            self._right_sides = ritz_right_sides(vectors, settings.samples, self._rng).reshape(-1, *settings.shape)
            return
        self._domains = _Domains(_POOL, settings.shape, settings.device)
        fields = torch.zeros((3, _POOL, *settings.shape), device=settings.device)
        self._errors, self._directions, self._products = fields.unbind(0)
        self._energy = torch.ones(_POOL, device=settings.device)
        self._labels: list[NDArray[np.uint8]] = [np.zeros(settings.shape, np.uint8)] * _POOL
        for slot in range(_POOL):
            self._renew(slot)

    def loss(self) -> Tensor:
        """Mean loss of a batch."""
        return self._ritz_loss() if self._settings.route == "ritz" else self._policy_loss()

    def _network(self, slots: Tensor, r: Tensor) -> Tensor:
        counts = (self._domains.diagonal[slots] > 0).flatten(1).sum(dim=1)
        scale = (counts / dots(r, r).clamp(min=_TINY)).sqrt()
        x = (r * over(scale, r)).unsqueeze(1)
        if self.architecture.masks:
            x = torch.cat([x, self._domains.masks[slots]], 1)
        kind = torch.device(self._settings.device).type
        with torch.autocast(kind, torch.bfloat16, enabled=self._settings.precision == "bfloat16"):
            answer = evaluate(self.architecture, self.parameters, x, self._operations)
        return self._domains.project(slots, answer[:, 0].float())

    def _policy_loss(self) -> Tensor:
        slots = torch.randperm(_POOL, generator=self._generator)[: self._settings.batch].to(self._settings.device)
        domains, e = self._domains, self._errors[slots]
        r = domains.times(slots, e)
        size = dots(e, r).clamp(min=_TINY).rsqrt()
        e, r = e * over(size, e), r * over(size, r)
        d, Ad = self._directions[slots], self._products[slots]
        q = self._network(slots, r)
        dAd = dots(d, Ad)
        part = torch.where(dAd > 0.0, dots(q, Ad) / dAd.clamp(min=_TINY), torch.zeros(()))
        q = q - over(part, d) * d
        Aq = domains.times(slots, q)
        rq, qAq = dots(r, q), dots(q, Aq).clamp(min=_TINY)
        left = (1.0 - rq**2 / qAq).clamp(min=1e-6)
        with torch.no_grad():
            unit = over(qAq.rsqrt(), q)
            self._errors[slots] = domains.project(slots, e - over(rq / qAq, q) * q)
            self._directions[slots], self._products[slots] = q * unit, Aq * unit
            self._energy[slots] *= left.sqrt()
        for slot in slots.tolist():
            if self._rng.random() < _FRESH or float(self._energy[slot]) < _REDUCED:
                self._renew(slot)
        return left.sqrt().mean()

    def _renew(self, slot: int) -> None:
        """A new domain and a new error."""
        shape, rng = self._settings.shape, self._rng
        labels = np.full(shape, FLUID, dtype=np.uint8)
        if rng.random() < _OBSTACLES:
            labels = random_labels(shape, rng, self._settings.hard_part)
            if rng.random() < _TURNED:
                labels = _turned(labels, rng)
        self._labels[slot] = labels
        self._domains.put(slot, labels)
        system = PressureSystem(labels)
        b = _right_side(system, rng)
        e = ConjugateGradients(system, Multigrid(system)).solve(b, _EXACT, _MOST).x[1:-1, 1:-1, 1:-1].reshape(shape)
        start = torch.as_tensor((e / max(np.abs(e).max(), _TINY)).astype(np.float32), device=self._settings.device)
        self._errors[slot] = start
        self._directions[slot], self._products[slot], self._energy[slot] = 0.0, 0.0, 1.0

    def _ritz_loss(self) -> Tensor:
        chosen = self._rng.integers(0, len(self._right_sides), self._settings.batch)
        r = torch.as_tensor(self._right_sides[chosen], device=self._settings.device)
        slots = torch.zeros(len(chosen), dtype=torch.long, device=r.device)
        f = self._network(slots, r)
        Af = self._domains.times(slots, f)
        alpha = dots(r, f) / dots(f, Af).clamp(min=_TINY)
        rest = r - over(alpha, Af) * Af
        return dots(rest, rest).clamp(min=1e-12).sqrt().mean()

    def solver(self, system: PressureSystem, parameters: dict[str, NDArray[Any]]) -> PoissonSolver:
        """What the parameters are for."""
        return DeepConjugateDirections(system, NetworkDirections(system, self.architecture, parameters))

    def meta(self) -> dict[str, Any]:
        """What a weights file says of the network."""
        return {"kind": "dcdm", "dim": self._settings.dim, "architecture": MODELS[self._settings.model]}

    def state(self) -> dict[str, Any]:
        """All that a resumed run needs beside the parameters."""
        state: dict[str, Any] = {
            "rng": self._rng.bit_generator.state,
            "generator": self._generator.get_state(),
        }
        if self._settings.route == "on_policy":
            fields = [self._errors, self._directions, self._products, self._energy]
            state |= {"labels": self._labels, "fields": [f.cpu() for f in fields]}
        return state

    def restore(self, state: dict[str, Any]) -> None:
        """Take what `state` returned."""
        self._rng.bit_generator.state = state["rng"]
        self._generator.set_state(state["generator"])
        if self._settings.route == "on_policy":
            self._labels = list(state["labels"])
            for slot, labels in enumerate(self._labels):
                self._domains.put(slot, labels)
            fields = [f.to(self._settings.device) for f in state["fields"]]
            self._errors, self._directions, self._products, self._energy = fields
