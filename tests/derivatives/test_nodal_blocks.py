"""Forces and matrices of nodes in sweeps: against the step problem, the published formula and finite differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenario import block, body, build, difference_gradient, material, quasistatic, random_state, scene

from femdeform.fem.incremental_potential import IncrementalPotential
from femdeform.materials import LAWS
from femdeform.run.setup import Simulation
from solvers.position_based.nodal_blocks import is_bounded, nodal_block
from solvers.position_based.node_sweep import NodeSweep, _LawCells

Array = NDArray[np.float64]
PUBLISHED = ["arap", "fixed_corotated", "neo_hookean", "stable_neo_hookean"]
RNG = np.random.default_rng(5)


def cube(law: str, dim: int = 3, nu: float = 0.3) -> Simulation:
    size = [1.0, 0.8, 0.6][:dim]
    return build(
        scene(
            {"b": body(block(size, [3, 2, 2][:dim]), material(law, E=1e4, nu=nu))},
            {"kind": "fixed", "on": "b.left"},
            time=quasistatic(),
        )
    )


def summed(sweep: NodeSweep, x: Array, parts: list[Any] | None = None) -> tuple[Array, Array]:
    """Forces (n, 3) and matrices (n, 3, 3) at all nodes by the numbers of the problem."""
    n = len(x)
    acc = np.zeros(9 * n)
    for c in range(sweep.n_colors):
        for part in sweep._parts if parts is None else parts:
            part.add(c, sweep.flat(x), acc)
    rows = acc.reshape(n, 9)[sweep.numbering.place]
    A = np.empty((n, 3, 3))
    for k, (a, b) in enumerate([(0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)]):
        A[:, a, b] = A[:, b, a] = rows[:, 3 + k]
    return rows[:, :3], A


def states(points: Array, law: str) -> list[Array]:
    """Near rest, stretched and turned, and (where the law stands it) crushed with inverted cells."""
    dim = points.shape[1]
    turned = points @ (np.eye(dim) + 0.4 * RNG.uniform(-1, 1, (dim, dim)))
    found = [random_state(points, 1e-6), random_state(turned, 0.03)]
    if law != "logarithmic_neo_hookean":
        found.append(random_state(points, 0.35))
    return found


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", list(LAWS))
def test_forces_are_those_of_the_step_problem(law: str, dim: int) -> None:
    simulation = cube(law, dim)
    problem: IncrementalPotential = simulation.problem
    sweep = NodeSweep(problem)
    for x in states(simulation.discretization.points, law):
        force, _ = summed(sweep, x)
        expected = -problem.internal_forces(x)
        free = problem.free.all(axis=1)
        scale = 1e4 * np.abs(x - x.mean(axis=0)).max()
        np.testing.assert_allclose(force[free, :dim], expected[free], rtol=1e-10, atol=1e-13 * scale)
        np.testing.assert_array_equal(force[~free], 0.0)
        np.testing.assert_array_equal(force[:, dim:], 0.0)


@pytest.mark.parametrize("law", PUBLISHED)
def test_matrices_are_the_published_ones(law: str) -> None:
    """Sum of V (2 mu |n|^2 I + lambda c c^T), c = cof(F) n, cell by cell."""
    simulation = cube(law)
    sweep = NodeSweep(simulation.problem)
    (cells,) = simulation.problem.local_cells()
    mu, lmbda = cells.law.mu, cells.law.lmbda
    for x in states(simulation.discretization.points, law):
        expected = np.zeros((len(x), 3, 3))
        for corners, G, V in zip(cells.cells, cells.gradients, cells.volumes, strict=True):
            F = x[corners].T @ G
            cofactor = np.array([np.cross(F[1], F[2]), np.cross(F[2], F[0]), np.cross(F[0], F[1])])
            for i, n in zip(corners, G, strict=True):
                c = cofactor @ n
                expected[i] += V * (2.0 * mu * n @ n * np.eye(3) + lmbda * np.outer(c, c))
        _, A = summed(sweep, x)
        free = simulation.problem.free.all(axis=1)
        np.testing.assert_allclose(A[free], expected[free], rtol=1e-10, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("law", ["fixed_corotated", "arap", "neo_hookean"])
def test_vectorised_kernels_agree_with_the_one_for_any_law(law: str) -> None:
    simulation = cube(law, nu=0.45)
    sweep = NodeSweep(simulation.problem)
    assert type(sweep._parts[0]) is not _LawCells
    plain = [_LawCells(cells, sweep.numbering, np.float64) for cells in simulation.problem.local_cells()]
    points = simulation.discretization.points
    flat = points.copy()
    flat[:, 2] *= 1e-9  # R is about to jump
    line = points.copy()
    line[:, 1:] *= 1e-12
    mirrored = points * np.array([1.0, 1.0, -1.0])
    for x in [*states(points, law), points, 3.0 * points, flat, line, mirrored, 1e-3 * points]:
        if law != "neo_hookean" and (x is line or x is mirrored):
            # R is not unique: only matrices can be compared.
            A, B = summed(sweep, x)[1], summed(sweep, x, plain)[1]
            np.testing.assert_allclose(A, B, rtol=1e-10, atol=1e-10 * np.abs(B).max())
            continue
        for a, b in zip(summed(sweep, x), summed(sweep, x, plain), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-10, atol=1e-12 * max(np.abs(b).max(), 1e3))


def exact_block(law: Any, F: Array, n: Array) -> Array:
    """Second derivative of the energy density with respect to s in F + s n^T, by differences."""
    from femdeform.materials.dispatch import pk1

    d = n.size

    def slope(s: Array) -> Array:
        P = pk1(tuple((F + np.outer(s, n)).ravel()), law)
        return np.reshape(P, (d, d)) @ n

    return np.stack([(slope(1e-6 * e) - slope(-1e-6 * e)) / 2e-6 for e in np.eye(d)], axis=1)


def full(block_: Any) -> Array:
    if len(block_) == 3:
        return np.array([[block_[0], block_[2]], [block_[2], block_[1]]])
    a, b, c, d, e, f = block_
    return np.array([[a, f, e], [f, b, d], [e, d, c]])


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("nu", [0.0, 0.45])
@pytest.mark.parametrize("law", list(LAWS))
def test_blocks_are_definite_and_bound_the_exact_ones(law: str, nu: float, dim: int) -> None:
    """Half of the exact nodal Hessian at most: then a step cannot raise the energy of its quadratic model."""
    simulation = cube(law, dim, nu)
    (cells,) = simulation.problem.local_cells()
    bounded = is_bounded(cells.law)
    rng = np.random.default_rng(0)
    for _ in range(200):
        stretch = np.diag(rng.uniform(0.4, 2.5, dim))
        U, _ = np.linalg.qr(rng.standard_normal((dim, dim)))
        V, _ = np.linalg.qr(rng.standard_normal((dim, dim)))
        F = U @ stretch @ V.T
        if np.linalg.det(F) < 0.0:
            F[:, 0] *= -1.0
        n = rng.standard_normal(dim)
        A = full(nodal_block(tuple(F.ravel()), tuple(n), cells.law))
        assert np.linalg.eigvalsh(A)[0] > 0.0
        H = exact_block(cells.law, F, n)
        lowest = np.linalg.eigvalsh(A - 0.5 * H)[0]
        if bounded or law in ("corotated", "saint_venant_kirchhoff", "logarithmic_neo_hookean"):
            assert lowest >= -1e-6 * np.abs(H).max()


@pytest.mark.parametrize("dim", [2, 3])
def test_saint_venant_kirchhoff_under_tension_is_exact(dim: int) -> None:
    simulation = cube("saint_venant_kirchhoff", dim)
    (cells,) = simulation.problem.local_cells()
    F = np.diag([1.5, 1.3, 1.4][:dim]) @ (np.eye(dim) + 0.05 * RNG.standard_normal((dim, dim)))
    n = RNG.standard_normal(dim)
    A = full(nodal_block(tuple(F.ravel()), tuple(n), cells.law))
    np.testing.assert_allclose(A, exact_block(cells.law, F, n), rtol=1e-6, atol=1.0)


def test_forces_are_the_slope_of_the_energy() -> None:
    """The same by differences of the energy, once for a fast kernel: nothing but the energy itself is trusted here."""
    simulation = cube("fixed_corotated")
    problem = simulation.problem
    x = states(simulation.discretization.points, "fixed_corotated")[1]
    force, _ = summed(NodeSweep(problem), x)
    slope = difference_gradient(problem.elastic_energy, x, 1e-6)
    free = problem.free.all(axis=1)
    np.testing.assert_allclose(force[free], -slope[free], atol=1e-5 * np.abs(slope).max())
