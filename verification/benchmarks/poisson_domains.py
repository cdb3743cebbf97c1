"""Pressure systems of the Poisson benchmark: right-hand sides out of flows, and domains that are hard."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.flow.mac_grid import MACGrid, PressureSolver, sides
from femdeform.flow.pressure_system import FLUID, SOLID, GridArray, PressureSystem
from femdeform.flow.smoke import MovingSolid, SmokeFlow, Source
from femdeform.types import FloatArray
from solvers.linear.poisson.conjugate_gradients import ConjugateGradients
from solvers.linear.poisson.interface import PoissonResult
from solvers.linear.poisson.multigrid import Multigrid

Labels = NDArray[np.uint8]

# Steps of a flow whose pressures are solved for, and what a step lasts [s], in a box of 1 m.
FRAMES = (5, 10, 20, 40)
DT = 0.025
# Of the pressures between the frames.
_TOLERANCE = 1e-6
# The blob: centres and half axes of its body, head, ears, feet and tail [m].
_BLOB = (
    ((0.50, 0.47, 0.50), (0.14, 0.11, 0.10)),
    ((0.61, 0.60, 0.50), (0.08, 0.08, 0.07)),
    ((0.60, 0.72, 0.46), (0.025, 0.08, 0.02)),
    ((0.60, 0.72, 0.54), (0.025, 0.08, 0.02)),
    ((0.57, 0.37, 0.44), (0.07, 0.03, 0.03)),
    ((0.57, 0.37, 0.56), (0.07, 0.03, 0.03)),
    ((0.36, 0.49, 0.50), (0.04, 0.04, 0.04)),
)
_HALF_BOX, _RATE = 0.12, 2.0
# Random right-hand sides of a hard domain.
_N_RANDOM = 4


def rooms(n: int, dim: int = 3) -> Labels:
    """Rooms between walls one voxel thick, four along each side; a hole of a voxel joins two of them."""
    labels = np.full((n,) * dim, FLUID, dtype=np.uint8)
    size = max(4, n // 4)
    walls = np.arange(size - 1, n - 1, size)
    middles = np.arange(size // 2 - 1, n, size)
    for axis in range(dim):
        np.moveaxis(labels, axis, 0)[walls] = SOLID
    for axis in range(dim):
        across = np.moveaxis(labels, axis, 0)
        for wall in walls:
            across[np.ix_([wall], *[middles] * (dim - 1))] = FLUID
    return labels


def plates(n: int, dim: int = 3) -> Labels:
    """A channel of three voxels between plates of one, each open at the end where its neighbours are closed."""
    labels = np.full((n,) * dim, FLUID, dtype=np.uint8)
    for number, at in enumerate(range(3, n - 1, 4)):
        labels[at, 3:] = SOLID
        if number % 2:
            labels[at] = SOLID
            labels[at, :-3] = SOLID
            labels[at, -3:] = FLUID
    return labels


def random_solids(n: int, part: float, dim: int = 3) -> Labels:
    """Voxels that are solid by chance; of the fluid the largest connected component stays."""
    from scipy.ndimage import label

    fluid = np.random.default_rng(0).random((n,) * dim) >= part
    number, _ = label(fluid)
    largest = np.argmax(np.bincount(number[fluid]))
    return np.where(number == largest, FLUID, SOLID).astype(np.uint8)


# By voxels along an edge and dimension. In the plane half of all voxels do not hang together.
HARD: dict[str, Callable[[int, int], Labels]] = {
    "30 % solids": lambda n, dim: random_solids(n, 0.3, dim),
    "50 % solids": lambda n, dim: random_solids(n, 0.5, dim),
    "rooms": rooms,
    "plates": plates,
}


class _Recorder:
    """A solver that remembers the last right-hand side."""

    def __init__(self, system: PressureSystem) -> None:
        self.inner = ConjugateGradients(system, Multigrid(system))
        self.b: GridArray | None = None

    def solve(self, b: GridArray, tolerance: float, max_iterations: int, x: GridArray | None = None) -> PoissonResult:
        self.b = b.copy()
        return self.inner.solve(b, tolerance, max_iterations, x)

    def destroy(self) -> None:
        """Nothing to free."""


def make_flow(
    scene: str,
    is_open: bool,
    n: int,
    make_solver: Callable[[PressureSystem], PressureSolver] = _Recorder,
    dim: int = 3,
) -> SmokeFlow:
    """Smoke from a ball, in the plane a disc, at the bottom of a box of n^dim voxels and 1 m.

    Parameters
    ----------
    scene : str
        ``plume``, ``blob`` or ``spinning box``: what the smoke meets.
    is_open : bool
        Whether the topmost layer is air.
    n : int
        Voxels along an edge.
    make_solver : callable
        See `SmokeFlow`.
    dim : int
        3, or 2 for the middle plane of all that.
    """
    grid = MACGrid((n,) * dim, 1.0 / n)
    centres = grid.centres()
    air = np.zeros(grid.shape, dtype=bool)
    air[:, -1] = is_open
    solid = np.zeros(grid.shape, dtype=bool)
    moving = []
    if scene == "blob":
        for middle, axes in _BLOB:
            solid |= (((centres - middle[:dim]) / axes[:dim]) ** 2).sum(axis=-1) < 1.0
    elif scene == "spinning box":
        moving = [MovingSolid(lambda time: _in_box(centres, time), _turn)]
    source = Source(((centres - (0.5, 0.15, 0.5)[:dim]) ** 2).sum(axis=-1) <= 0.12**2)
    return SmokeFlow(grid, solid, air, make_solver, sources=[source], moving=moving, tolerance=_TOLERANCE)


def _in_box(centres: FloatArray, time: float) -> NDArray[np.bool_]:
    x, y, *rest = np.moveaxis(centres - 0.5, -1, 0)
    c, s = np.cos(_RATE * time), np.sin(_RATE * time)
    sizes = (c * x + s * y, c * y - s * x, *rest)
    return np.asarray(np.max(np.abs(np.stack(sizes)), axis=0) < _HALF_BOX)


def _turn(time: float, points: FloatArray) -> FloatArray:
    out = np.zeros_like(points)
    out[..., 0], out[..., 1] = _RATE * (0.5 - points[..., 1]), _RATE * (points[..., 0] - 0.5)
    return out


def record(scene: str, is_open: bool, n: int, frames: Sequence[int], dim: int = 3) -> list[tuple[Labels, GridArray]]:
    """Labels and right-hand sides of the pressure at some steps of a flow; where a step has parts, of the last one.

    Raises
    ------
    RuntimeError
        If a pressure on the way was not found.
    """
    flow = make_flow(scene, is_open, n, dim=dim)
    found = []
    for step in range(1, max(frames) + 1):
        reports = flow.step(DT)
        if not all(report.converged for report in reports):
            raise RuntimeError(f"{scene}: step {step}: {reports[-1].reason}")
        if step in frames:
            solver: Any = flow._solver
            found.append((flow.system.labels[1:-1, 1:-1, 1:-1].copy(), solver.b))
    return found


def random_sides(labels: Labels, count: int = _N_RANDOM) -> list[tuple[Labels, GridArray]]:
    """Divergences of random smooth velocities that rest at solids, on one domain."""
    from scipy.ndimage import gaussian_filter

    system = PressureSystem(labels)
    grid = MACGrid(labels.shape, 1.0)
    found = []
    for seed in range(count):
        rng = np.random.default_rng(seed)
        for axis in range(grid.dim):
            noise = rng.standard_normal(grid.velocity[axis].shape)
            grid.velocity[axis][...] = gaussian_filter(noise, max(1.0, labels.shape[0] / 32))
            between = np.logical_and(*sides(system.unknown, axis))
            grid.velocity[axis][~between] = 0.0
        b = -grid.divergence(system)
        system.project(b)
        found.append((labels, b))
    return found
