"""What an implicit step of material points must keep: momentum, free fall, and the same answer on any threads."""

from __future__ import annotations

import numpy as np
import point_drop
import pytest
from numpy.typing import NDArray

from femdeform.jit import set_threads
from femdeform.mpm.grid import Grid
from femdeform.mpm.implicit_step import solve_step
from femdeform.mpm.particles import LIQUID, SOLID, Particles
from femdeform.mpm.point_potential import PointPotential
from femdeform.mpm.point_terms import PointMaterials
from femdeform.mpm.transfers import momentum_to_grid, velocity_to_points
from femdeform.scene.schema import ProjectedNewtonSolver
from solvers.linear.block_cg import BlockCG
from solvers.linear.scipy_direct import SciPyDirect
from solvers.projected_newton import ProjectedNewton

Array = NDArray[np.float64]
DT = 0.01


def newton(tolerance: float, linear: object = None) -> ProjectedNewton:
    return ProjectedNewton(ProjectedNewtonSolver(tolerance=tolerance), linear or SciPyDirect())  # type: ignore[arg-type]


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("liquid", ["mixed", "all"])
def test_linear_momentum_is_exact_however_inexact_the_solve(dim: int, liquid: str) -> None:
    gravity = [0.3, -9.81, 1.0][:dim]
    drop = point_drop.drop(dim, liquid=liquid, gravity=gravity)
    before, _ = drop.momentum(drop.velocity)
    expected = before + DT * drop.mass.sum() * np.array(gravity)
    rough = BlockCG(tolerance=1e-2)
    found = solve_step(drop.begun(DT), newton(1e-4, rough), 1e-4)
    assert found.converged
    assert np.abs(found.momentum_shift).max() > 1e-12  # it was needed
    after, _ = drop.momentum(found.velocity)
    assert np.abs(after - expected).max() < 1e-15
    # The shift costs no energy: deformations do not see it.
    problem = drop.begun(DT)
    with_shift, without = (
        problem.energies(problem.unknowns(DT * v)) for v in (found.velocity, found.velocity - found.momentum_shift)
    )
    for name, energy in without.items():
        assert with_shift[name] == pytest.approx(energy, rel=1e-12)


@pytest.mark.parametrize("dim", [2, 3])
def test_angular_momentum_of_liquid_drops_is_kept_by_the_symmetric_surface(dim: int) -> None:
    drop = point_drop.drop(dim, liquid="all", symmetric=True)
    _, before = drop.momentum(drop.velocity)
    found = solve_step(drop.begun(DT), newton(1e-13), 1e-13)
    assert found.converged
    assert found.iterations >= 2
    _, after = drop.momentum(found.velocity)
    assert np.abs(after - before).max() < 1e-13 * np.abs(before).max()


@pytest.mark.parametrize("dim", [2, 3])
def test_angular_momentum_is_lost_by_what_the_torque_of_moved_nodes_says(dim: int) -> None:
    drop = point_drop.drop(dim)
    problem = drop.begun(DT)
    _, before = drop.momentum(drop.velocity)
    found = solve_step(problem, newton(1e-13), 1e-13)
    _, after = drop.momentum(found.velocity)
    lost = after - before
    assert np.abs(lost).max() > 1e-6 * np.abs(before).max()
    # Forces are objective at y = x + h v: about x their torque is -h v x f. Liquids have none: all may be counted.
    x = problem.unknowns(DT * found.velocity)
    forces = problem.full_gradient(x, elastic=False) - problem.full_gradient(x)
    torque = problem.points.T @ forces
    np.testing.assert_allclose(lost, DT * (torque - torque.T), atol=1e-12 * np.abs(before).max())


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("phase", [SOLID, LIQUID])
def test_falling_block(dim: int, phase: int) -> None:
    """y_n = y_0 + v_0 t + g dt^2 n (n + 1) / 2, over many steps."""
    rng = np.random.default_rng(1)
    axes = [np.arange(0.31, 0.6, 0.05)] * dim
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, dim)
    points = Particles.at(x, np.full(len(x), 0.1), np.full(len(x), 0.05**dim))
    points.phase[:] = phase
    v0, g = np.array([0.4, 1.0, -0.3])[:dim], np.array([0.5, -9.81, 2.0])[:dim]
    points.v[:] = v0
    materials = PointMaterials({0: point_drop.LAW}, np.full(len(x), 80.0), np.full(len(x), 0.3))
    problem, grid, solver = PointPotential(g), Grid(0.1, "quadratic"), newton(1e-10)
    del rng
    n, dt = 25, 0.013
    for _ in range(n):
        stencils = grid.stencils(points.x)
        mass, velocity = momentum_to_grid(stencils, points.x, points.mass, points.v, points.affine)
        problem.begin_step(stencils, mass, velocity, points, materials, dt)
        found = solve_step(problem, solver, 1e-10)
        assert found.converged
        v, affine = velocity_to_points(stencils, points.x, found.velocity)
        points.v[:], points.affine[:] = v, affine
        points.x += dt * v
    expected = x + v0 * n * dt + 0.5 * g * dt**2 * n * (n + 1)
    np.testing.assert_allclose(points.x, expected, atol=1e-11)


@pytest.mark.parametrize("dim", [2, 3])
def test_results_do_not_depend_on_threads(dim: int) -> None:
    drop = point_drop.drop(dim, n=60, n_samples=40)
    answers = []
    most = set_threads()
    for threads in (1, most):
        set_threads(threads)
        problem = drop.begun(DT)
        found = solve_step(problem, newton(1e-10, BlockCG()), 1e-10)
        K = problem.hessian(problem.unknowns(DT * found.velocity), project=False)
        answers.append((found.velocity, K.values.copy(), K.diagonal_blocks()))
    set_threads(most)
    for a, b in zip(*answers, strict=True):
        np.testing.assert_array_equal(a, b)


def test_pattern_is_kept_while_the_active_nodes_are() -> None:
    drop = point_drop.drop(2)
    problem = drop.begun(DT)
    first = problem.node_pattern()
    drop.points.v += 1.0
    drop.begin(problem, DT)
    assert problem.node_pattern() is first
    other = point_drop.drop(2, seed=5)
    other.begin(problem, DT)
    assert problem.node_pattern() is not first
