"""Coarse matrices of multigrid: what they make of air, wherever in the grid it begins."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from femdeform.flow.pressure_system import AIR, FLUID, SOLID, GridArray, PressureSystem
from solvers.linear.poisson.conjugate_gradients import ConjugateGradients
from solvers.linear.poisson.multigrid import Multigrid
from solvers.linear.poisson.multigrid_levels import EvenSurface, Level, MeasuredSurface, make_levels


def pool(shape: tuple[int, ...], depth: int) -> NDArray[np.uint8]:
    """Fluid in the lowest layers, air above it."""
    labels = np.full(shape, FLUID, dtype=np.uint8)
    labels[:, depth:] = AIR
    return labels


def bubbles(n: int, dim: int) -> NDArray[np.uint8]:
    """Random voxels of air, balls of it, and a ball of solid."""
    rng = np.random.default_rng(0)
    labels = np.full((n,) * dim, FLUID, dtype=np.uint8)
    labels[rng.random(labels.shape) < 0.002] = AIR
    centres = (np.indices(labels.shape) + 0.5) / n
    for number, place in enumerate(rng.random((8, dim))):
        near = sum((centres[d] - place[d]) ** 2 for d in range(dim)) < 0.1**2
        labels[near] = AIR if number else SOLID
    return labels


def open_solids(n: int) -> NDArray[np.uint8]:
    """Voxels that are solid by chance, below air."""
    labels = (np.random.default_rng(1).random((n, n, n)) < 0.2).astype(np.uint8) * SOLID
    labels[:, -1] = AIR
    return labels


def rough(system: PressureSystem, seed: int = 0) -> GridArray:
    """Divergence of a random velocity, smooth over a few voxels."""
    from scipy.ndimage import gaussian_filter

    rng = np.random.default_rng(seed)
    b = system.new_field()
    for axis in range(system.dim):
        u = gaussian_filter(rng.standard_normal(system.padded_shape), [2.0] * system.dim + [0.0] * (3 - system.dim))
        b += u - np.roll(u, 1, axis)
    b[~system.unknown] = 0.0
    system.project(b)
    return b


def iterations(labels: NDArray[np.uint8], sweeps: int, reaction: float = 0.0) -> int:
    system = PressureSystem(labels, reaction)
    answer = ConjugateGradients(system, Multigrid(system, sweeps)).solve(rough(system), 1e-4, 50)
    assert answer.converged, answer.reason
    return answer.iterations


def levels_of(labels: NDArray[np.uint8], surface: type[MeasuredSurface] | type[EvenSurface]) -> list[Level]:
    system = PressureSystem(labels)
    return make_levels(system, surface(system), np.float64)


@pytest.mark.parametrize("depth", range(24, 33))
def test_iterations_do_not_depend_on_where_air_begins(depth: int) -> None:
    """All places in aggregates of eight voxels; 32 is the closed box."""
    assert iterations(pool((32, 32, 32), depth), 2) <= 4
    assert iterations(pool((32, 32, 32), depth), 1) <= 8
    assert iterations(pool((128, 128), 4 * depth - 5), 2) <= 4


@pytest.mark.parametrize("labels", [bubbles(32, 3), bubbles(64, 2)], ids=["3D", "2D"])
def test_bubbles(labels: NDArray[np.uint8]) -> None:
    assert iterations(labels, 2) <= 4


@pytest.mark.parametrize("reaction", [1e-3, 0.1, 1.0, 10.0, 1e3])
@pytest.mark.parametrize("labels", [pool((32, 32, 32), 32), pool((32, 32, 32), 27), bubbles(64, 2)])
def test_a_reaction_costs_no_iterations(labels: NDArray[np.uint8], reaction: float) -> None:
    """From the pressure's matrix to what is all but a multiple of the identity."""
    assert iterations(labels, 2, reaction) <= 4
    assert iterations(labels, 1, reaction) <= 8


@pytest.mark.parametrize("surface", [EvenSurface, MeasuredSurface])
def test_a_reaction_on_coarse_levels(surface: type[MeasuredSurface] | type[EvenSurface]) -> None:
    """It keeps its part of the matrix, whose couplings are twice too stiff on each level."""
    labels = bubbles(13, 3)
    system = PressureSystem(labels, 0.3)
    for k, (level, plain) in enumerate(
        zip(make_levels(system, surface(system), np.float64), levels_of(labels, surface), strict=True)
    ):
        added = level.diagonal - plain.diagonal
        assert added.sum() == pytest.approx(2**k * 0.3 * system.n_unknowns, rel=1e-12)
        assert np.all(added[plain.diagonal == 0.0] == 0.0)


@pytest.mark.parametrize("make", [lambda: bubbles(13, 3), lambda: open_solids(12), lambda: bubbles(29, 2)])
def test_distances_of_the_levels(make: Callable[[], NDArray[np.uint8]]) -> None:
    """Against sums over all pairs of neighbours, one by one."""
    system = PressureSystem(make())
    unknown, padded = system.unknown, system.labels
    for k, level in enumerate(make_levels(system, MeasuredSurface(system), np.float64)[1:], 1):
        size = 2**k
        groups: dict[tuple[int, ...], list[NDArray[np.int64]]] = {}
        for at in np.argwhere(unknown):
            groups.setdefault(tuple((at - 1) // size + 1), []).append(at)
        centres = {group: np.mean(cells, axis=0) for group, cells in groups.items()}
        air = np.zeros(level.diagonal.shape)
        faces = np.zeros((3, *level.diagonal.shape))
        for group, cells in groups.items():
            for at in cells:
                for axis in range(3):
                    for side in (-1, 1):
                        beside = at.copy()
                        beside[axis] += side
                        other = tuple((beside - 1) // size + 1)
                        if padded[tuple(beside)] == AIR:
                            air[group] += size / max(1.0, side * (beside[axis] - centres[group][axis]))
                        elif unknown[tuple(beside)] and side > 0 and other != group:
                            faces[(axis, *group)] += 1.0
        diagonal = air.copy()
        for axis, *cell in np.argwhere(faces):
            group = tuple(cell)
            after = tuple(c + (d == axis) for d, c in enumerate(cell))
            if air[group] > 0.0 or air[after] > 0.0:
                faces[(axis, *group)] *= size / (centres[after][axis] - centres[group][axis])
            diagonal[group] += faces[(axis, *group)]
            diagonal[after] += faces[(axis, *group)]
        np.testing.assert_allclose(np.stack(level.weights), faces, rtol=1e-13)
        np.testing.assert_allclose(level.diagonal, diagonal, rtol=1e-13)


def test_where_aggregates_end_both_surfaces_are_the_same() -> None:
    """16 layers of fluid are whole aggregates of 2, 4, 8 and 16; one layer less or more is not."""
    shape = (32, 32, 16)
    for even, measured in zip(
        levels_of(pool(shape, 16), EvenSurface), levels_of(pool(shape, 16), MeasuredSurface), strict=True
    ):
        np.testing.assert_allclose(measured.diagonal, even.diagonal, rtol=1e-14)
        for a, b in zip(measured.weights, even.weights, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-14)
    for depth in (15, 17):
        even, measured = (levels_of(pool(shape, depth), surface)[1] for surface in (EvenSurface, MeasuredSurface))
        assert not np.allclose(even.diagonal, measured.diagonal)


def test_without_air_couplings_count_faces() -> None:
    labels = np.where(bubbles(13, 3) == FLUID, FLUID, SOLID).astype(np.uint8)
    system = PressureSystem(labels)
    u = system.unknown[1:-1, 1:-1, 1:-1]
    for surface in (EvenSurface, MeasuredSurface):
        level = levels_of(labels, surface)[1]
        wx = level.weights[0][1:-1, 1:-1, 1:-1]
        i, j, k = 2, 3, 1
        both = u[2 * i + 1, 2 * j : 2 * j + 2, 2 * k : 2 * k + 2] & u[2 * i + 2, 2 * j : 2 * j + 2, 2 * k : 2 * k + 2]
        assert wx[i, j, k] == both.sum()
        ones = level.diagonal - sum(w + np.roll(w, 1, axis) for axis, w in enumerate(level.weights))
        assert np.all(ones == 0.0)


@pytest.mark.parametrize("sweeps", [1, 2])
@pytest.mark.parametrize("reaction", [0.0, 0.5])
@pytest.mark.parametrize("labels", [bubbles(8, 3), pool((8, 8, 8), 5), pool((6, 9, 7), 7), open_solids(8)])
def test_the_whole_cycle_is_symmetric_positive_definite(
    labels: NDArray[np.uint8], sweeps: int, reaction: float
) -> None:
    """Its matrix, column by column; of closed parts, where the pressure has a constant, what is left of it."""
    system = PressureSystem(labels, reaction)
    cycle = Multigrid(system, sweeps, np.float64)
    columns = []
    for unit in np.eye(system.n_unknowns):
        b, z = system.extend(unit), system.new_field()
        system.project(b)
        cycle.apply(b, z)
        system.project(z)
        columns.append(system.restrict(z))
    B = np.array(columns)
    np.testing.assert_allclose(B, B.T, atol=1e-12 * np.abs(B).max())
    values = np.linalg.eigvalsh(B)
    assert np.count_nonzero(values < 1e-6 * values[-1]) == system.n_closed
    assert values[0] > -1e-12 * values[-1]
