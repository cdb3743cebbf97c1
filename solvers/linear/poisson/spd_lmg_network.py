"""What the learned multigrid cycle knows of a voxel's surroundings, and the network that reads it."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.flow.pressure_system import shifted

CHANNELS = 16
LEVELS = 12
NETWORKS = ("finest", "coarser")
# Relaxation stays inside of (0, 2) in single precision too: 2 sigmoid(-8) = 0.0007.
LARGEST_LOGIT = 8.0
# Voxels whose surroundings are gathered at a time.
_CHUNK = 32768


def n_features(dim: int) -> int:
    """Numbers a voxel that the network sees."""
    return 3 * dim + 2


def n_heads(dim: int) -> int:
    """Numbers a voxel that it answers: relaxation of either colour, and a weight for each parent."""
    return 2 + (1 << dim)


def parameter_shapes(dim: int) -> dict[str, tuple[int, ...]]:
    """Shapes of the parameters by name: for the finest level, for all others, and one factor for each level."""
    shapes: dict[str, tuple[int, ...]] = {}
    for net in NETWORKS:
        shapes[f"{net}.kernel"] = ((3,) * dim) + (n_features(dim), CHANNELS)
        shapes[f"{net}.bias"] = (CHANNELS,)
        shapes[f"{net}.inner.kernel"] = (CHANNELS, CHANNELS)
        shapes[f"{net}.inner.bias"] = (CHANNELS,)
        shapes[f"{net}.heads.kernel"] = (CHANNELS, n_heads(dim))
        shapes[f"{net}.heads.bias"] = (n_heads(dim),)
    shapes["factors"] = (LEVELS,)
    return shapes


def start_parameters(dim: int, rng: np.random.Generator) -> dict[str, NDArray[Any]]:
    """Random kernels with heads of zero: the classical cycle."""
    parameters = {}
    for name, shape in parameter_shapes(dim).items():
        parameters[name] = np.zeros(shape, dtype=np.float32)
        if name.endswith("kernel") and ".heads." not in name:
            parameters[name][...] = rng.standard_normal(shape) * np.sqrt(2.0 / np.prod(shape[:-1]))
    return parameters


def features(diagonal: NDArray[Any], weights: Any, dim: int) -> NDArray[np.float32]:
    """What there is around each voxel of a level, (nx + 2, ny + 2, nz + 2, 3 dim + 2), zero where there is no unknown.

    Couplings to both sides along each axis and the part of air, all over the diagonal; one; and on which side of its
    aggregate the voxel lies along each axis, -1 or 1.

    Parameters
    ----------
    diagonal : (nx + 2, ny + 2, nz + 2) float
        Of the level's matrix.
    weights : sequence of three (nx + 2, ny + 2, nz + 2) float
        Coupling to the next voxel along each axis.
    dim : int
        Of the grid.
    """
    unknown = diagonal > 0
    sides = [side for axis in range(dim) for side in (weights[axis], shifted(weights[axis], axis, -1))]
    air = diagonal - sum(sides)
    parity = [1.0 - 2.0 * (np.indices(diagonal.shape, sparse=True)[axis] % 2) for axis in range(dim)]
    scale = np.where(unknown, 1.0 / np.where(unknown, diagonal, 1.0), 0.0)
    found = [side * scale for side in sides] + [air * scale, unknown] + [p * unknown for p in parity]
    return np.stack(found, axis=-1).astype(np.float32)


def heads(parameters: Mapping[str, NDArray[Any]], net: str, values: NDArray[Any], dim: int) -> NDArray[np.float32]:
    """Answers of a network, (nx + 2, ny + 2, nz + 2, 2 + 2^dim), zero where there is no unknown.

    Voxels with nothing but open fluid around them differ only in their place in the aggregate: those are answered once
    for each place.
    """
    unknown = values[..., 2 * dim + 1] > 0.0
    out = np.zeros((*unknown.shape, n_heads(dim)), dtype=np.float32)
    is_plain = unknown & np.isclose(values[..., : 2 * dim], 0.5 / dim, atol=1e-6).all(axis=-1)
    for axis in range(dim):
        is_plain &= shifted(is_plain, axis, 1) & shifted(is_plain, axis, -1)
    place = np.zeros(unknown.shape, dtype=np.int8)
    for axis in range(dim):
        place += (values[..., 2 * dim + 2 + axis] > 0.0).astype(np.int8) << axis
    asked = np.flatnonzero(unknown & ~is_plain)
    samples = [np.flatnonzero(is_plain & (place == p)) for p in range(2**dim)]
    first = np.array([cells[0] for cells in samples if cells.size], dtype=asked.dtype)
    flat = out.reshape(-1, out.shape[-1])
    for cells in np.array_split(np.concatenate([asked, first]), (asked.size + first.size) // _CHUNK + 1):
        flat[cells] = _answer(parameters, net, values, cells, dim)
    for cells in samples:
        if cells.size:
            flat[cells] = flat[cells[0]]
    return out


def _answer(
    parameters: Mapping[str, NDArray[Any]], net: str, values: NDArray[Any], cells: NDArray[Any], dim: int
) -> NDArray[Any]:
    _, ny, nz, n = values.shape
    flat = values.reshape(-1, n)
    strides = (ny * nz, nz, 1)
    steps = [sum(o * s for o, s in zip(offset, strides, strict=False)) for offset in offsets(dim)]
    patches = flat[cells[:, None] + np.array(steps)].reshape(cells.size, -1)
    kernel = parameters[f"{net}.kernel"].reshape(-1, CHANNELS)
    hidden = np.maximum(patches @ kernel + parameters[f"{net}.bias"], 0.0)
    hidden = np.maximum(hidden @ parameters[f"{net}.inner.kernel"] + parameters[f"{net}.inner.bias"], 0.0)
    return np.asarray(hidden @ parameters[f"{net}.heads.kernel"] + parameters[f"{net}.heads.bias"])


def offsets(dim: int) -> list[tuple[int, ...]]:
    """Places of a kernel's window, in the order of its entries."""
    return list(itertools.product((-1, 0, 1), repeat=dim))


def parent_shares(diagonal: NDArray[Any], weights: Any, coarse: NDArray[Any], dim: int) -> NDArray[np.float32]:
    """Shares of linear interpolation, (2^dim, nx + 2, ny + 2, nz + 2), over parents that can be reached.

    A parent beside a voxel's own aggregate counts where neighbours with couplings lead to it, one step along each axis,
    so that nothing is interpolated through thin plates. The shares sum to one, or to zero where there is no parent.

    Parameters
    ----------
    diagonal, weights
        As `features` has them.
    coarse : (mx + 2, my + 2, mz + 2) float
        Diagonal of the next level's matrix.
    dim : int
        Of the grid.
    """
    index = [np.arange(n) for n in diagonal.shape]
    near = [(i + 1) // 2 for i in index]
    beside = [p - 2 * (i % 2) + 1 for i, p in zip(index, near, strict=True)]
    # The neighbour in the aggregate beside, and whether there is a coupling to it.
    outer = [np.clip(i - 2 * (i % 2) + 1, 0, i.size - 1) for i in index]
    is_open = [np.take(weights[a] > 0, index[a] - index[a] % 2, axis=a) for a in range(dim)]
    shares = np.zeros((2**dim, *diagonal.shape), dtype=np.float32)
    is_reached = [diagonal > 0]
    for slot in range(2**dim):
        axes = [a for a in range(dim) if slot >> a & 1]
        if slot:
            # Take the last step along any of the axes.
            ways = [is_reached[slot ^ 1 << a] & _after(is_open[a], outer, axes, a) for a in axes]
            is_reached.append(np.logical_or.reduce(ways))
        at = [beside[a] if a in axes else near[a] for a in range(3)]
        at = [np.clip(each, 0, n - 1) for each, n in zip(at, coarse.shape, strict=True)]
        shares[slot] = 0.25 ** len(axes) * 0.75 ** (dim - len(axes)) * (is_reached[slot] & (coarse[np.ix_(*at)] > 0))
    total = shares.sum(axis=0)
    return np.asarray(shares / np.where(total > 0.0, total, 1.0), dtype=np.float32)


def _after(values: NDArray[Any], outer: list[NDArray[Any]], axes: list[int], last: int) -> NDArray[Any]:
    """Values at the voxel that steps along all axes but the last one lead to."""
    for axis in axes:
        if axis != last:
            values = np.take(values, outer[axis], axis=axis)
    return values


def colours(shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Whether a voxel belongs to colour 1: the parity of i + j + k."""
    i, j, k = np.indices(shape, sparse=True)
    return np.asarray((i + j + k) % 2 == 1)
