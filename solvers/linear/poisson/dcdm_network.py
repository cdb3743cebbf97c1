"""The convolutional network of deep conjugate directions, compiled; training evaluates the same text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from femdeform.flow.pressure_system import AIR, GridArray, PressureSystem
from solvers.linear.poisson.dcdm_operations import CompiledOperations, framed, prepare


@dataclass(frozen=True)
class Architecture:
    """Shape of the network.

    A linear convolution, blocks at full resolution, blocks at half of it, their sum with what was there before, blocks
    at full resolution, one number a voxel. A block is ``x <- relu(C relu(C x)) + x`` with convolutions C over 3^dim
    voxels. The defaults are the source's network for 64^3, with 97,457 parameters; ``left=2, low=5, up=3`` is the one
    for 128^3, with 152,881.

    Attributes
    ----------
    dim : int
    left, low, up : int
        Blocks before halving, at half resolution, and after it.
    channels : int
        16; 8 is the source's smaller network of 24,537 parameters.
    bias : bool
        Without biases f(c r) = c f(r) for c > 0.
    masks : bool
        Whether the network sees fluid and air, as two more inputs; the source's does not.
    residual : bool
        False leaves out the sums of blocks: the source's model without residual connections.
    pooled : bool
        False keeps full resolution everywhere: a plain sequence of convolutions.
    skip : bool
        False leaves out the sum of both resolutions: simple down- and upsampling.

    Notes
    -----
    The source names its ablation models and the numbers of their parameters, and shows them in figures. `residual` and
    `channels` follow from the text and the numbers; `pooled` and `skip` are a reading of "minimal CNN" and of "simple
    downsampling and upsampling", whose numbers of parameters agree.
    """

    dim: int = 3
    left: int = 1
    low: int = 3
    up: int = 2
    channels: int = 16
    bias: bool = True
    masks: bool = False
    residual: bool = True
    pooled: bool = True
    skip: bool = True

    @property
    def inputs(self) -> int:
        """Numbers a voxel that go in."""
        return 3 if self.masks else 1

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the parameters by name: kernels (3, .., 3, in, out) and biases (out,)."""
        layers = ["first", "last_left", *(f"{part}{i}{c}" for part, i, c in self._convolutions())]
        window = (3,) * self.dim
        kernels: dict[str, tuple[int, ...]] = {"input": (*window, self.inputs, self.channels)}
        kernels |= dict.fromkeys(layers, (*window, self.channels, self.channels))
        kernels["output"] = (1,) * self.dim + (self.channels, 1)
        found: dict[str, tuple[int, ...]] = {}
        for name, shape in kernels.items():
            found[f"{name}.kernel"] = shape
            if self.bias:
                found[f"{name}.bias"] = shape[-1:]
        return found

    def _convolutions(self) -> list[tuple[str, int, str]]:
        blocks = [("left", self.left), ("low", self.low), ("up", self.up)]
        return [(part, i, c) for part, n in blocks for i in range(n) for c in "ab"]

    @property
    def n_parameters(self) -> int:
        """Number of trained numbers."""
        return sum(int(np.prod(shape)) for shape in self.shapes().values())

    @property
    def reach(self) -> int:
        """Voxels to one side that a value can come from; one more to one of the sides, as halving rounds."""
        fine = 3 + 2 * self.left + 2 * self.up
        return fine + (4 if self.pooled else 2) * self.low


class Operations(Protocol):
    """What a network is made of, on arrays of some library."""

    def convolve(self, x: Any, kernel: Any, bias: Any | None, is_cut: bool, plus: Any | None) -> Any:
        """Convolution with zeros outside of the grid, its positive part if `is_cut`, and then the sum with `plus`."""

    def halve(self, x: Any) -> Any:
        """Means of 2^dim voxels."""

    def double(self, x: Any, plus: Any | None) -> Any:
        """The nearest value on the finer grid, and the sum with `plus`."""


def evaluate(architecture: Architecture, parameters: Mapping[str, Any], x: Any, operations: Operations) -> Any:
    """Run the network.

    Parameters
    ----------
    architecture : Architecture
        What to run.
    parameters : mapping of str to array
        As `Architecture.shapes` has them, in the order of axes that `operations` wants.
    x : array
        Inputs; even numbers of voxels along each axis.
    operations : Operations
        Of the library whose arrays these are.
    """

    def layer(name: str, x: Any, is_cut: bool = True, plus: Any | None = None) -> Any:
        kernel, bias = parameters[f"{name}.kernel"], parameters.get(f"{name}.bias")
        return operations.convolve(x, kernel, bias, is_cut, plus)

    def blocks(part: str, n: int, x: Any) -> Any:
        for i in range(n):
            x = layer(f"{part}{i}b", layer(f"{part}{i}a", x), plus=x if architecture.residual else None)
        return x

    x = layer("first", layer("input", x, is_cut=False))
    kept = layer("last_left", blocks("left", architecture.left, x))
    added = kept if architecture.skip else None
    if architecture.pooled:
        high = operations.double(blocks("low", architecture.low, operations.halve(kept)), added)
    else:
        low = blocks("low", architecture.low, kept)
        high = low if added is None else low + added
    return layer("output", blocks("up", architecture.up, high), is_cut=False)


def zero_parameters(architecture: Architecture) -> dict[str, NDArray[Any]]:
    """A network that answers zero."""
    return {name: np.zeros(shape, dtype=np.float32) for name, shape in architecture.shapes().items()}


def glorot_parameters(architecture: Architecture, rng: np.random.Generator) -> dict[str, NDArray[Any]]:
    """Uniformly distributed kernels as Glorot and Bengio (2010) have them; biases are zero."""
    parameters = zero_parameters(architecture)
    for name, values in parameters.items():
        if name.endswith(".kernel"):
            window = int(np.prod(values.shape[:-2]))
            bound = np.sqrt(6.0 / (window * (values.shape[-2] + values.shape[-1])))
            values[...] = rng.uniform(-bound, bound, values.shape)
    return parameters


def network_masks(system: PressureSystem) -> NDArray[np.float32]:
    """Fluid and air of a system, (2, n, ..), on a grid of even size."""
    inner = system.labels[1:-1, 1:-1, 1:-1]
    unknown = system.unknown[1:-1, 1:-1, 1:-1]
    return _even(np.stack([unknown, inner == AIR]).astype(np.float32), system.dim)


def _even(values: NDArray[Any], dim: int) -> NDArray[Any]:
    """Fields (c, nx, ny, nz) as (c, nx, ny, [nz]), filled up with zeros to even sizes."""
    flat = values[..., 0] if dim == 2 else values
    return np.pad(flat, [(0, 0)] + [(0, n % 2) for n in flat.shape[1:]])


class NetworkDirections:
    """Search directions that a network finds for residuals.

    Parameters
    ----------
    system : PressureSystem
    architecture : Architecture
    parameters : mapping of str to array
    """

    def __init__(
        self, system: PressureSystem, architecture: Architecture, parameters: Mapping[str, NDArray[Any]]
    ) -> None:
        if architecture.dim != system.dim:
            raise ValueError(f"a network of dimension {architecture.dim} on a grid of dimension {system.dim}")
        self._system, self._architecture = system, architecture
        self._operations = CompiledOperations()
        self._parameters = prepare(parameters)
        self._masks = network_masks(system) if architecture.masks else None

    def __call__(self, r: GridArray) -> GridArray:
        """Answer of the network to `r`, scaled so that its root mean square is one; zero where there is no unknown."""
        system = self._system
        norm = system.norm(r)
        out = system.new_field()
        if norm == 0.0:
            return out
        scaled = (r[1:-1, 1:-1, 1:-1] * (np.sqrt(system.n_unknowns) / norm)).astype(np.float32)
        x = _even(scaled[None], system.dim)
        if self._masks is not None:
            x = np.concatenate([x, self._masks])
        answer = evaluate(self._architecture, self._parameters, framed(x), self._operations)
        nx, ny, nz = system.shape
        inner = answer[0, 1:-1, 1:-1][:nx, :ny]
        out[1:-1, 1:-1, 1:-1] = inner[..., None] if system.dim == 2 else inner[..., 1 : nz + 1]
        out[~system.unknown] = 0.0
        return out
