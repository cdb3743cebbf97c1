"""The learned cycle: symmetric and positive definite whatever was learned, classical where nothing was."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from femdeform.flow.pressure_system import AIR, FLUID, SOLID, GridArray, PressureSystem
from solvers.linear.poisson import spd_lmg_network as network
from solvers.linear.poisson.conjugate_gradients import ConjugateGradients
from solvers.linear.poisson.interface import Preconditioner
from solvers.linear.poisson.multigrid import Multigrid
from solvers.linear.poisson.multigrid_levels import EvenSurface, make_levels
from solvers.linear.poisson.spd_lmg import LearnedMultigrid, finest_weights


def ball(n: int, dim: int, is_open: bool) -> NDArray[np.uint8]:
    labels: NDArray[np.uint8] = np.full((n,) * dim, FLUID, dtype=np.uint8)
    labels[((np.indices(labels.shape) + 0.5 - 0.45 * n) ** 2).sum(axis=0) < (0.2 * n) ** 2] = SOLID
    if is_open:
        labels[:, -2:] = AIR
    return labels


def porous(shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Three tenths of it random solids: many components, voxels between solids, aggregates without a neighbour."""
    return np.where(np.random.default_rng(4).random(shape) < 0.3, SOLID, FLUID).astype(np.uint8)


DOMAINS: dict[str, Callable[[], NDArray[np.uint8]]] = {
    "2D": lambda: ball(16, 2, False),
    "2D open": lambda: ball(16, 2, True),
    "2D odd": lambda: ball(15, 2, True)[:, :11],
    "2D porous": lambda: porous((14, 17)),
    "3D": lambda: ball(8, 3, False),
    "3D open": lambda: ball(8, 3, True),
    "3D odd": lambda: porous((7, 9, 6)),
    "tiny": lambda: ball(4, 2, False),
}


def random_parameters(dim: int, seed: int, size: float = 1.0) -> dict[str, NDArray[Any]]:
    """Far from anything trained: heads of the size of one and more."""
    rng = np.random.default_rng(seed)
    parameters = network.start_parameters(dim, rng)
    for name, values in parameters.items():
        if ".heads." in name or name == "factors":
            values[...] = size * rng.standard_normal(values.shape)
    return parameters


def as_matrix(system: PressureSystem, preconditioner: Preconditioner) -> NDArray[Any]:
    columns = []
    z = system.new_field()
    for e in np.eye(system.n_unknowns):
        preconditioner.apply(system.extend(e), z)
        assert np.all(z[~system.unknown] == 0.0)
        columns.append(system.restrict(z))
    return np.array(columns).T


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("domain", DOMAINS)
def test_it_is_symmetric_and_positive_definite_for_any_parameters(domain: str, seed: int) -> None:
    """On fields without mean on closed components, where conjugate gradients work."""
    system = PressureSystem(DOMAINS[domain]())
    B = as_matrix(system, LearnedMultigrid(system, random_parameters(system.dim, seed), 1 + seed % 2, np.float64))
    scale = np.abs(B).max()
    np.testing.assert_allclose(B, B.T, atol=1e-11 * scale)
    closed = np.zeros((system.n_closed, system.n_unknowns))
    component = system.component[system.unknown]
    for c in range(system.n_closed):
        closed[c, component == c] = 1.0 / np.sqrt(np.count_nonzero(component == c))
    free = np.linalg.svd(closed)[2][system.n_closed :] if system.n_closed else np.eye(system.n_unknowns)
    values = np.linalg.eigvalsh(free @ (0.5 * (B + B.T)) @ free.T)
    assert values[0] > 1e-12 * scale


@pytest.mark.parametrize("dim", [2, 3])
def test_levels_without_unknowns(dim: int) -> None:
    """Pairs of fluid voxels, each inside of a coarse voxel, which has no unknown then; and solids all over."""
    labels = np.full([8] * dim, SOLID, dtype=np.uint8)
    labels[(slice(0, None, 4), *[slice(0, None, 4)] * (dim - 1))] = FLUID
    labels[(slice(1, None, 4), *[slice(0, None, 4)] * (dim - 1))] = FLUID
    system = PressureSystem(labels)
    assert system.n_closed == 2**dim
    b = system.extend(np.random.default_rng(0).standard_normal(system.n_unknowns))
    system.project(b)
    cycle = LearnedMultigrid(system, random_parameters(dim, 0), 1, np.float64)
    answer = ConjugateGradients(system, cycle, "spd_lmg").solve(b, 1e-10, 50)
    assert answer.converged, answer.reason
    nothing = PressureSystem(np.full([8] * dim, SOLID, dtype=np.uint8))
    cycle = LearnedMultigrid(nothing, random_parameters(dim, 0))
    z = nothing.new_field()
    cycle.apply(nothing.new_field(), z)
    assert np.all(z == 0.0)


@pytest.mark.parametrize("domain", DOMAINS)
def test_symmetry_in_single_precision(domain: str) -> None:
    system = PressureSystem(DOMAINS[domain]())
    cycle = LearnedMultigrid(system, random_parameters(system.dim, 5))
    rng = np.random.default_rng(2)
    x, y = (system.extend(rng.standard_normal(system.n_unknowns)) for _ in range(2))
    system.project(x)
    system.project(y)
    Bx, By = system.new_field(), system.new_field()
    cycle.apply(x, Bx)
    cycle.apply(y, By)
    assert abs(system.dot(y, Bx) - system.dot(x, By)) < 1e-5 * system.norm(y) * system.norm(Bx)
    assert system.dot(x, Bx) > 0.0


@pytest.mark.parametrize("dim", [2, 3])
def test_heads_of_zero_are_the_classical_cycle(dim: int) -> None:
    """On a grid of one coarser level, by hand: Gauss-Seidel, linear interpolation, twice the coarse solution."""
    system = PressureSystem(ball(8, dim, True))
    parameters = network.start_parameters(dim, np.random.default_rng(0))
    B = as_matrix(system, LearnedMultigrid(system, parameters, 1, np.float64))
    A = system.matrix().toarray()
    coarse = make_levels(system, EvenSurface(system), np.float64)[1]
    shares = network.parent_shares(system.diagonal, finest_weights(system, np.float64), coarse.diagonal, dim)
    P = np.zeros((system.n_unknowns, coarse.x.size))
    for row, (i, j, k) in enumerate(np.argwhere(system.unknown)):
        for slot in range(2**dim):
            at = [
                (c + 1) // 2 + ((1 if c % 2 == 0 else -1) if slot >> axis & 1 else 0)
                for axis, c in enumerate((i, j, k))
            ]
            P[row, np.ravel_multi_index(at, coarse.x.shape)] += shares[slot, i, j, k]
    np.testing.assert_allclose(P.sum(axis=1), 1.0)
    red = network.colours(system.padded_shape)[system.unknown]
    # Parity 0 is the first colour of a sweep from colour 0, in padded indices.
    S = np.zeros_like(A)
    for colour in (False, True):
        D = np.diag((red == colour) / np.diag(A))
        S = S + D @ (np.eye(len(A)) - A @ S)
    M = np.zeros((coarse.x.size,) * 2)
    flat_b, flat_x = coarse.b.reshape(-1), coarse.x.reshape(-1)
    for column in np.flatnonzero(coarse.diagonal.reshape(-1) > 0):
        flat_b[...] = 0.0
        flat_b[column] = 1.0
        flat_x[...] = 0.0
        for first in (0, 1):
            for _ in range(20):
                coarse.sweep(first)
        M[:, column] = flat_x
    E = np.eye(len(A)) - S.T @ A
    by_hand = S + S.T - S.T @ A @ S + 2.0 * E @ P @ M @ P.T @ E.T
    np.testing.assert_allclose(B, by_hand, atol=1e-6 * np.abs(by_hand).max())


@pytest.mark.parametrize("dim", [2, 3])
def test_nothing_is_interpolated_through_a_plate(dim: int) -> None:
    """Parents of voxels beside a plate are those on their side, and at its edge one that a way around leads to."""
    labels: NDArray[np.uint8] = np.full((12, 16, 8)[:dim], FLUID, dtype=np.uint8)
    labels[5, :10] = SOLID  # with the frame place 6, the second of its aggregate
    system = PressureSystem(labels)
    coarse = make_levels(system, EvenSurface(system), np.float64)[1]
    shares = network.parent_shares(system.diagonal, finest_weights(system, np.float64), coarse.diagonal, dim)
    np.testing.assert_allclose(shares.sum(axis=0)[system.unknown], 1.0, rtol=1e-6)
    across = [slot for slot in range(2**dim) if slot & 1]
    z = 4 if dim == 3 else 1
    assert not np.any(shares[across][:, 7, 3:10, z])
    assert np.all(shares[:, 9, 3:10, z] > 0.0)
    assert shares[1, 7, 10, z] == 0.0
    assert shares[3, 7, 10, z] > 0.0


@pytest.mark.parametrize("n", [16, 32, 64])
def test_the_start_is_as_good_as_classical_multigrid(n: int) -> None:
    for dim, size in ((2, 4 * n), (3, n)):
        parameters = network.start_parameters(dim, np.random.default_rng(1))
        for is_open in (False, True):
            system = PressureSystem(ball(size, dim, is_open))
            b = system.extend(np.random.default_rng(3).standard_normal(system.n_unknowns))
            system.project(b)
            answer = ConjugateGradients(system, LearnedMultigrid(system, parameters)).solve(b, 1e-4, 20)
            assert answer.converged
            assert answer.iterations <= 8


@pytest.mark.parametrize("dim", [2, 3])
def test_heads_are_those_of_every_voxel(dim: int) -> None:
    """Open fluid is answered once for each place in an aggregate: the same as everywhere on its own."""
    system = PressureSystem(ball(16, dim, True))
    multigrid = Multigrid(system, 1)
    level = multigrid.levels[1]
    values = network.features(level.diagonal, level.weights, dim)
    parameters = random_parameters(dim, 3)
    found = network.heads(parameters, "coarser", values, dim)
    for cell in np.argwhere(level.diagonal > 0):
        patch = [values[tuple(cell + np.array((*o, 0, 0)[:3]))] for o in network.offsets(dim)]
        hidden = np.maximum(np.concatenate(patch) @ parameters["coarser.kernel"].reshape(-1, network.CHANNELS), 0.0)
        hidden = np.maximum(hidden @ parameters["coarser.inner.kernel"], 0.0)
        expected = hidden @ parameters["coarser.heads.kernel"] + parameters["coarser.heads.bias"]
        np.testing.assert_allclose(found[tuple(cell)], expected, rtol=1e-4, atol=1e-4)


def test_weights_of_another_dimension() -> None:
    with pytest.raises(ValueError, match="of another dimension"):
        LearnedMultigrid(PressureSystem(ball(8, 2, False)), network.start_parameters(3, np.random.default_rng(0)))


def test_it_solves_to_small_tolerances() -> None:
    for domain in ("2D", "2D odd", "3D open"):
        system = PressureSystem(DOMAINS[domain]())
        b: GridArray = system.extend(np.random.default_rng(3).standard_normal(system.n_unknowns))
        system.project(b)
        for seed in range(2):
            cycle = LearnedMultigrid(system, random_parameters(system.dim, seed, 0.05))
            answer = ConjugateGradients(system, cycle).solve(b, 1e-9, 500)
            assert answer.converged, answer.reason
