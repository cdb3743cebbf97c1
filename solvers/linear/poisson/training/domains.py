"""Random domains to train and to validate on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from femdeform.flow.pressure_system import AIR, FLUID, SOLID, GridArray, PressureSystem

# Fewer fluid voxels than this part of the grid make no domain.
LEAST_FLUID = 0.2
HARD = 0.3
_AIR_LAYER = 0.35
_WAVY_SURFACE = 0.15


def random_labels(shape: tuple[int, ...], rng: np.random.Generator, hard: float = HARD) -> NDArray[np.uint8]:
    """Labels of a box with solids, below air at times; only its largest component is fluid.

    Up to eight ellipsoids and turned boxes, down to a voxel thin; in a part `hard` of all instead random solid voxels,
    up to 45 of 100 in two dimensions and 55 in three, or as often thin plates with slits; in 35 of 100 a layer of air
    at the top, in 15 of 100 a wavy surface.
    """
    most_solids = 0.45 if len(shape) == 2 else 0.55
    while True:
        labels = np.full(shape, FLUID, dtype=np.uint8)
        of_hard = rng.random() / max(hard, 1e-9)
        if of_hard < 0.5:
            labels[rng.random(shape) < rng.uniform(0.05, most_solids)] = SOLID
        elif of_hard < 1.0:
            _put_plates(labels, rng)
        else:
            for _ in range(int(rng.integers(0, 9))):
                labels[_solid(shape, rng)] = SOLID
        kind = rng.random()
        height = np.indices(shape)[1] + 0.5
        if kind < _AIR_LAYER:
            labels[height > shape[1] - rng.integers(1, 4)] = AIR
        elif kind < _AIR_LAYER + _WAVY_SURFACE:
            labels[(height > _surface(shape, rng)) & (labels == FLUID)] = AIR
        largest = _largest_component(labels)
        if np.count_nonzero(largest == FLUID) > LEAST_FLUID * largest.size:
            return largest


def blob_labels(shape: tuple[int, ...], is_open: bool, seed: int = 20) -> NDArray[np.uint8]:
    """Seven ellipsoids, always the same ones for a seed; air at the top if it is open."""
    rng = np.random.default_rng(seed)
    labels = np.full(shape, FLUID, dtype=np.uint8)
    places = _places(shape)
    for _ in range(7):
        center = (0.5 + 0.12 * rng.standard_normal(len(shape))) * shape
        radii = (0.05 + 0.08 * rng.random(len(shape))) * shape
        labels[(((places - center) / radii) ** 2).sum(axis=-1) < 1.0] = SOLID
    if is_open:
        labels[:, -2:] = AIR
    return _largest_component(labels)


def porous_labels(shape: tuple[int, ...], part: float, seed: int = 0) -> NDArray[np.uint8]:
    """Random solids, a part of all voxels; only the largest component is fluid."""
    solid = np.random.default_rng(seed).random(shape) < part
    return _largest_component(np.where(solid, SOLID, FLUID).astype(np.uint8))


def plate_labels(shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Plates a voxel thin that leave a slit at alternating ends."""
    labels = np.full(shape, FLUID, dtype=np.uint8)
    gap = max(4, shape[0] // 8)
    for n, x in enumerate(range(gap, shape[0] - 1, gap)):
        labels[x] = SOLID
        slit = slice(0, 2) if n % 2 else slice(shape[1] - 2, None)
        labels[x, slit] = FLUID
    return labels


def _put_plates(labels: NDArray[np.uint8], rng: np.random.Generator) -> None:
    """Plates across a random axis at random places, each with a slit at a random place."""
    axis = int(rng.integers(labels.ndim))
    across = (axis + 1) % labels.ndim
    view = np.moveaxis(labels, (axis, across), (0, 1))
    for _ in range(int(rng.integers(1, max(2, labels.shape[axis] // 5)))):
        place, slit = int(rng.integers(1, view.shape[0] - 1)), int(rng.integers(0, view.shape[1] - 1))
        view[place] = SOLID
        view[place, slit : slit + int(rng.integers(1, 5))] = FLUID


def _places(shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Centres of the voxels, (.., dim)."""
    return np.moveaxis(np.indices(shape).astype(np.float64) + 0.5, 0, -1)


def _solid(shape: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.bool_]:
    dim = len(shape)
    turn = np.linalg.qr(rng.standard_normal((dim, dim)))[0]
    places = _places(shape) - rng.random(dim) * shape
    half = np.maximum(0.5, np.exp(rng.uniform(np.log(0.5 / min(shape)), np.log(0.25), dim)) * np.array(shape))
    local = np.abs(places @ turn) / half
    return np.asarray((local**2).sum(axis=-1) < 1.0 if rng.random() < 0.5 else local.max(axis=-1) < 1.0)


def _surface(shape: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.float64]:
    phase = sum(
        rng.uniform(1.0, 3.0) * 2.0 * np.pi * np.indices(shape)[axis] / shape[axis] + rng.uniform(0.0, 6.3)
        for axis in range(len(shape))
        if axis != 1
    )
    return np.asarray(shape[1] * (rng.uniform(0.5, 0.9) + 0.1 * np.sin(phase)))


def _largest_component(labels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    from scipy.ndimage import label

    unknown = PressureSystem(labels).unknown[1:-1, 1:-1, 1:-1].reshape(labels.shape)
    number, n = label(unknown)
    if n == 0:
        return labels
    largest = 1 + int(np.argmax(np.bincount(number[number > 0])[1:]))
    return np.where((labels == FLUID) & (number != largest), SOLID, labels).astype(np.uint8)


def smooth_divergence(system: PressureSystem, seed: int) -> GridArray:
    """Right-hand side like that of smoke: the derivative of smooth noise along y, as far as the fluid goes."""
    from scipy.ndimage import gaussian_filter

    noise = np.random.default_rng(seed).standard_normal(system.padded_shape)
    u = gaussian_filter(noise, (3.0, 3.0, 3.0 * (system.dim - 2)))
    b = system.new_field()
    b[system.unknown] = (u - np.roll(u, 1, 1))[system.unknown]
    system.project(b)
    return b
