"""The implicit step of material points against a general minimiser, and with every linear solver."""

from __future__ import annotations

from typing import Any

import numpy as np
import point_drop
import pytest
import scenario
import scipy.optimize
from numpy.typing import NDArray

from femdeform.mpm.implicit_step import GridSolution, solve_step
from femdeform.mpm.point_potential import SMALLEST_J, PointPotential
from femdeform.registry import preset_names
from femdeform.scene.schema import ProjectedNewtonSolver
from solvers.linear.block_cg import BlockCG
from solvers.linear.scipy_direct import SciPyDirect
from solvers.projected_newton import ProjectedNewton

Array = NDArray[np.float64]
TOLERANCE = 1e-10
NEWTON_PRESETS = [name for name in preset_names() if name.startswith("newton-")]


def solve(problem: PointPotential, linear: Any = None, tolerance: float = TOLERANCE, **options: Any) -> GridSolution:
    newton = ProjectedNewton(ProjectedNewtonSolver(tolerance=tolerance, **options), linear or SciPyDirect())
    return solve_step(problem, newton, tolerance)


def rms(mass: Array, velocity: Array) -> float:
    return float(np.sqrt(np.sum(mass[:, None] * velocity**2) / mass.sum()))


@pytest.mark.parametrize("symmetric", [False, True])
def test_minimiser_is_that_of_the_formulas(symmetric: bool) -> None:
    dt = 0.01
    drop = point_drop.drop(2, n=6, n_samples=4, symmetric=symmetric, gravity=[0.0, -9.81])
    found = solve(drop.begun(dt))
    assert found.converged
    u = dt * found.velocity
    root = np.sqrt(drop.mass)[:, None] / dt  # in these unknowns inertia is the identity

    def objective(w: Array) -> float:
        return drop.objective(w.reshape(u.shape) / root, dt)

    start = (root * dt * drop.velocity).ravel()
    reference = scipy.optimize.minimize(objective, start, method="BFGS", jac="3-point", options={"gtol": 1e-8})
    apart = reference.x.reshape(u.shape) / root / dt - found.velocity
    # Differences of the objective resolve no more than the root of rounding.
    assert rms(drop.mass, apart) < 2e-6 * rms(drop.mass, found.velocity)
    assert objective((root * u).ravel()) <= reference.fun + 1e-12 * abs(reference.fun)


@pytest.mark.parametrize(("dim", "symmetric"), [(2, False), (2, True), (3, False), (3, True)])
def test_minimiser_among_some_motions_is_that_of_the_formulas(dim: int, symmetric: bool) -> None:
    """The same on a few random motions through the solution, for drops of some hundred unknowns."""
    dt = 0.01
    drop = point_drop.drop(dim, symmetric=symmetric, gravity=[0.0, -9.81, 1.0][:dim])
    found = solve(drop.begun(dt))
    assert found.converged
    rng = np.random.default_rng(6)
    motions = rng.standard_normal((8, *drop.velocity.shape)) / np.sqrt(drop.mass)[:, None]
    motions *= (
        0.1 * rms(drop.mass, found.velocity) / np.array([rms(drop.mass, each) for each in motions])[:, None, None]
    )

    def objective(c: Array) -> float:
        return drop.objective(dt * (found.velocity + np.tensordot(c, motions, 1)), dt)

    start = 0.5 * rng.standard_normal(8)
    reference = scipy.optimize.minimize(objective, start, method="BFGS", jac="3-point", options={"gtol": 1e-9})
    assert np.abs(reference.x).max() < 1e-5
    assert objective(np.zeros(8)) <= reference.fun + 1e-12 * abs(reference.fun)
    assert objective(start) > reference.fun + 1e-5 * abs(reference.fun)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("liquid", ["mixed", "all", "none"])
def test_newton_converges_quadratically(dim: int, liquid: str) -> None:
    drop = point_drop.drop(dim, liquid=liquid, n=20)
    problem = drop.begun(0.01)
    norms: list[float] = []
    newton = ProjectedNewton(ProjectedNewtonSolver(tolerance=1e-13), SciPyDirect())
    found = solve_step(problem, newton, 1e-13, lambda row, x: norms.append(float(row["relative_residual"])))
    assert found.converged
    assert found.iterations <= 8
    assert norms[-1] < 1e-11
    # The last iteration that rounding does not end squares the residual, times a constant.
    last = max(k for k, norm in enumerate(norms) if norm > 1e-12)
    assert norms[last] < 50.0 * norms[last - 1] ** 2 or norms[last + 1] < 50.0 * norms[last] ** 2


@pytest.mark.petsc
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("preset", NEWTON_PRESETS)
def test_presets_agree(preset: str, dim: int) -> None:
    ksp = pytest.importorskip("solvers.linear.ksp", exc_type=ImportError)
    drop = point_drop.drop(dim)
    expected = solve(drop.begun(0.01))
    linear = ksp.KSP(preset)
    problem = drop.begun(0.01)
    for _ in range(2):  # the pattern is kept
        found = solve(problem, linear)
        assert found.converged
        assert rms(drop.mass, found.velocity - expected.velocity) <= expected.velocity_error + found.velocity_error
        drop.begin(problem, 0.01)
    linear.destroy()


@pytest.mark.parametrize("dim", [2, 3])
def test_solving_without_a_matrix(dim: int) -> None:
    drop = point_drop.drop(dim)
    expected = solve(drop.begun(0.01))
    problem = drop.begun(0.01)
    found = solve(problem, BlockCG())
    assert found.converged
    assert found.linear_iterations > found.iterations
    assert problem._pattern is None  # nobody has asked for a matrix
    assert rms(drop.mass, found.velocity - expected.velocity) <= expected.velocity_error + found.velocity_error


@pytest.mark.parametrize("dim", [2, 3])
def test_measure_bounds_the_step_that_is_left(dim: int) -> None:
    drop = point_drop.drop(dim)
    problem = drop.begun(0.05)
    assert drop.mass.min() < 1e-5 * drop.mass.max()
    rng = np.random.default_rng(3)
    for size in (0.0, 1e-6, 1e-3):
        x = problem.unknowns(0.05 * drop.velocity + size * rng.standard_normal(problem.points.shape))
        r = problem.gradient(x)
        step = np.linalg.solve(scenario.dense_hessian(problem, x, project=True), -r.ravel()).reshape(r.shape)
        error = problem.velocity_error(problem.residual_norm(r))
        assert rms(drop.mass, step / problem.dt) <= error * (1.0 + 1e-12)
    # It is the Euclidean norm of equal masses, and sees a wrong velocity of a node whatever its mass.
    lightest = int(np.argmin(drop.mass))
    r = np.zeros_like(problem.points)
    r[lightest, 0] = drop.mass[lightest] * 1.0 / problem.dt  # 1 m/s
    n = len(r)
    expected = np.sqrt(drop.mass[lightest] / drop.mass.sum())
    assert problem.velocity_error(problem.residual_norm(r)) == pytest.approx(expected, rel=1e-12)
    problem._measure = np.ones((n, 1))
    assert problem.residual_norm(r) < 1e-2 * expected * drop.mass.mean() * n**0.5 / problem.dt


@pytest.mark.parametrize(("dim", "symmetric"), [(2, False), (2, True), (3, False), (3, True)])
def test_no_point_is_crushed_in_a_step(dim: int, symmetric: bool) -> None:
    drop = point_drop.drop(dim, symmetric=symmetric)
    problem = drop.begun(0.01)
    rng = np.random.default_rng(4)
    n = drop.points.n
    for k in range(20):
        u = 0.003 * rng.standard_normal(problem.points.shape)
        step = 10.0 ** rng.uniform(-3.0, 0.0) * rng.standard_normal(problem.points.shape)
        x = problem.unknowns(u)
        part = problem.max_step(x, step)

        def ratios(t: float, x: Array = x, step: Array = step) -> Array:
            D = problem._deform(problem.displacement(x + t * step), problem._D).reshape(-1, dim, dim)
            D[n:] = 0.5 * (D[n:] + np.swapaxes(D[n:], 1, 2)) if symmetric else D[n:]
            F = np.array(D)
            F[: n // 1] += problem.quadrature.base.reshape(-1, dim, dim)[:n]
            F[n:] += np.eye(dim)
            before = np.ones(len(F))
            before[:n] = np.linalg.det(problem.quadrature.base.reshape(-1, dim, dim)[:n])
            return np.asarray(np.linalg.det(F) / before)

        along = np.array([ratios(t).min() for t in np.linspace(0.0, part, 200)])
        assert along.min() > SMALLEST_J, k
        if part < 1.0:
            ahead = np.array([ratios(t).min() for t in np.linspace(part, part / 0.9, 50)])
            assert ahead.min() == pytest.approx(SMALLEST_J, abs=1e-9)
    assert problem.max_step(problem.unknowns(np.zeros_like(step)), np.ones_like(step)) == 1.0


def test_a_step_too_long_for_the_surface_is_not_a_success() -> None:
    drop = point_drop.drop(2, liquid="all", n=30, n_samples=20)
    drop.tension.coefficient[:] *= 1e4
    found = solve(drop.begun(0.1), max_iterations=30)
    assert not found.converged
    assert "samples of the surface shrink" in found.reason
    assert "smaller time step" in found.reason


def test_bad_input_is_refused() -> None:
    drop = point_drop.drop(2)
    problem = PointPotential(drop.gravity)
    mass = drop.mass.copy()
    mass[3] = 0.0
    with pytest.raises(ValueError, match="no mass"):
        problem.begin_step(drop.stencils, mass, drop.velocity, drop.points, drop.materials, 0.01)
    few = point_drop.drop(2, n_samples=0).stencils
    with pytest.raises(ValueError, match="all samples"):
        problem.begin_step(few, drop.mass, drop.velocity, drop.points, drop.materials, 0.01, drop.tension)
