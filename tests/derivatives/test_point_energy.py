"""Energies of material points and surface samples: values, derivatives, clamped tangents."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import point_drop
import pytest
import scenario
from numpy.typing import NDArray

from femdeform.materials.neo_hookean import NeoHookean
from femdeform.mpm.grid import Grid
from femdeform.mpm.point_potential import PointPotential
from femdeform.mpm.point_quadrature import consistent_gradients
from femdeform.mpm.point_terms import PointMaterials, SurfaceTension, SurfaceTerm, surface_tangents
from femdeform.mpm.surface_samples import SurfaceSamples

Array = NDArray[np.float64]
DT = 0.01
CASES = [(dim, symmetric) for dim in (2, 3) for symmetric in (False, True)]


def displaced(problem: PointPotential, size: float = 0.01) -> Array:
    return size * np.random.default_rng(1).standard_normal(problem.points.shape)


def directions(shape: tuple[int, ...]) -> Iterator[Array]:
    rng = np.random.default_rng(2)
    for _ in range(3):
        yield rng.standard_normal(shape)


@pytest.mark.parametrize(("dim", "symmetric"), CASES)
def test_value_is_that_of_the_formulas(dim: int, symmetric: bool) -> None:
    drop = point_drop.drop(dim, symmetric=symmetric, gravity=[1.0, -9.81, 2.0][:dim])
    problem = drop.begun(DT)
    for size in (0.0, 0.002, 0.02):
        u = displaced(problem, size)
        x = problem.unknowns(u)
        assert problem.value(x) == pytest.approx(drop.objective(u, DT), rel=1e-13)
        parts = problem.energies(x)
        assert parts["liquid"] == pytest.approx(drop.energy(u, DT, "lv"), rel=1e-12)
        assert parts["solid"] == pytest.approx(drop.energy(u, DT, "h"), rel=1e-12)
        assert parts["surface"] == pytest.approx(drop.energy(u, DT, "s"), rel=1e-12)


@pytest.mark.parametrize("parts", ["l", "v", "h", "s"])
@pytest.mark.parametrize(("dim", "symmetric"), CASES)
def test_forces_of_each_energy_are_derivatives_of_its_formula(dim: int, symmetric: bool, parts: str) -> None:
    drop = point_drop.drop(dim, symmetric=symmetric)
    # What is left of the problem is one energy.
    n = drop.points.n
    zero, some = np.zeros(n), drop.materials
    drop.materials = PointMaterials(
        some.solids,
        some.bulk_modulus if parts == "l" else zero,
        some.viscosity if parts == "v" else zero,
        np.full(n, float(parts == "h")),
    )
    drop.tension = SurfaceTension(drop.tension.samples, drop.tension.coefficient * float(parts == "s"))
    problem = drop.begun(DT)
    u = displaced(problem)
    gradient = problem.full_gradient(problem.unknowns(u)) - problem.full_gradient(problem.unknowns(u), elastic=False)
    drop.materials = some
    assert np.abs(gradient.sum(axis=0)).max() < 1e-14 * np.abs(gradient).sum()  # no resultant
    for d in directions(u.shape):
        h = 1e-6
        slope = (drop.energy(u + h * d, DT, parts) - drop.energy(u - h * d, DT, parts)) / (2.0 * h)
        assert slope == pytest.approx(float(np.vdot(gradient, d)), rel=2e-7)


@pytest.mark.parametrize("dim", [2, 3])
def test_virial_identity(dim: int) -> None:
    """A dilation does work ``dim sum p J V0`` against the pressure and gains ``(dim - 1) sum k |dA|`` of surface."""
    drop = point_drop.drop(dim, liquid="all", viscosity=0.0)
    problem = drop.begun(DT)
    rest = np.zeros_like(problem.points)
    dilation = problem.points - 0.37
    liquid, surface = (problem._term_gradient(term, rest) for term in problem.terms)
    points, bulk = drop.points, drop.materials.bulk_modulus
    pressure = -bulk * (points.J - 1.0)
    work = -dim * float(np.sum(pressure * points.J * points.volume))
    assert float(np.vdot(liquid, dilation)) == pytest.approx(work, rel=1e-12)
    gain = (dim - 1.0) * float(np.sum(drop.tension.coefficient * drop.tension.samples.measure))
    assert float(np.vdot(surface, dilation)) == pytest.approx(gain, rel=1e-12)


@pytest.mark.parametrize(("dim", "symmetric"), CASES)
def test_hessian(dim: int, symmetric: bool) -> None:
    drop = point_drop.drop(dim, symmetric=symmetric)
    drop.points.F *= 0.7  # compressed solids are unstable
    problem = drop.begun(0.1)  # little inertia: it hides nothing
    u = displaced(problem)
    x = problem.unknowns(u)
    K = scenario.dense_hessian(problem, x, project=False, everything=True)
    np.testing.assert_allclose(K, K.T, atol=1e-14 * np.abs(K).max())
    for d in directions(x.shape):
        numeric = (problem.full_gradient(x + 1e-6 * d) - problem.full_gradient(x - 1e-6 * d)) / 2e-6
        product = (K @ d.ravel()).reshape(x.shape)
        np.testing.assert_allclose(product, numeric, atol=1e-7 * np.abs(numeric).max())
    projected = scenario.dense_hessian(problem, x, project=True, everything=True)
    values = np.linalg.eigvalsh(projected - np.diag(np.repeat(drop.mass / 0.1**2, dim)))
    assert values.min() > -1e-13 * values.max()
    exact = np.linalg.eigvalsh(K - np.diag(np.repeat(drop.mass / 0.1**2, dim)))
    assert exact.min() < -1e-4 * exact.max()


@pytest.mark.parametrize("project", [False, True])
@pytest.mark.parametrize(("dim", "symmetric"), CASES)
def test_products_and_diagonal_blocks_are_those_of_the_matrix(dim: int, symmetric: bool, project: bool) -> None:
    drop = point_drop.drop(dim, symmetric=symmetric)
    problem = drop.begun(DT)
    x = problem.unknowns(displaced(problem))
    # Some unknowns are prescribed, as walls would have it.
    problem.free = np.random.default_rng(3).random(x.shape) < 0.8
    for free in (None, np.ones_like(problem.free)):
        K = problem.hessian(x, project, free)
        n = x.size
        matrix = scenario.dense_hessian(problem, x, project, everything=free is not None)
        for d in directions(x.shape):
            product = matrix @ d.ravel()
            np.testing.assert_allclose(K.times(d).ravel(), product, atol=1e-14 * n * np.abs(product).max())
        nodes = np.arange(len(x))
        blocks = matrix.reshape(len(x), dim, len(x), dim)[nodes, :, nodes]
        np.testing.assert_allclose(K.diagonal_blocks(), blocks, atol=1e-14 * np.abs(blocks).max())
    held = ~problem.free.ravel()
    matrix = scenario.dense_hessian(problem, x, project)
    assert np.count_nonzero(matrix[held]) == np.count_nonzero(matrix[:, held]) == held.sum()


@pytest.mark.parametrize("dim", [2, 3])
def test_other_laws(dim: int) -> None:
    drop = point_drop.drop(dim, liquid="none")
    law = NeoHookean.from_lame(30.0, 50.0, dim)
    factor = np.random.default_rng(4).uniform(0.5, 2.0, drop.points.n)
    drop.materials = PointMaterials({0: law}, np.zeros(0), np.zeros(0), factor)
    problem = drop.begun(DT)
    u = displaced(problem, 0.002)
    x = problem.unknowns(u)
    gradient = problem.full_gradient(x)
    K = scenario.dense_hessian(problem, x, project=False, everything=True)
    for d in directions(x.shape):
        slope = (problem.value(x + 1e-6 * d) - problem.value(x - 1e-6 * d)) / 2e-6
        assert slope == pytest.approx(float(np.vdot(gradient, d)), rel=1e-6)
        numeric = (problem.full_gradient(x + 1e-6 * d) - problem.full_gradient(x - 1e-6 * d)) / 2e-6
        np.testing.assert_allclose((K @ d.ravel()).reshape(x.shape), numeric, atol=1e-6 * np.abs(numeric).max())
    drop.materials = PointMaterials({1: law}, np.zeros(0), np.zeros(0))
    with pytest.raises(ValueError, match="no law"):
        drop.begun(DT)


def surface_matrices(D: Array, normals: Array, k: Array, symmetric: bool, project: bool) -> Array:
    n, dim = normals.shape
    samples = SurfaceSamples(np.zeros((n, dim)), normals, np.ones(n), np.arange(n))
    term = SurfaceTerm(SurfaceTension(samples, k), 0, symmetric, np.arange(n))
    out = np.empty((n, dim * dim, dim * dim))
    term.tangents(D.reshape(n, -1), project, out)
    return out


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("dim", [2, 3])
def test_clamped_surface_tangents_are_the_closest_semidefinite_ones(dim: int, sign: float) -> None:
    rng = np.random.default_rng(5)
    n = 50
    normals = rng.standard_normal((n, dim))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    D = 0.4 * rng.standard_normal((n, dim, dim))
    k = sign * rng.uniform(0.5, 2.0, n)
    exact = surface_matrices(D, normals, k, False, False)
    values, vectors = np.linalg.eigh(exact)
    clamped = (vectors * np.maximum(values, 0.0)[:, None]) @ np.swapaxes(vectors, 1, 2)
    found = surface_matrices(D, normals, k, False, True)
    np.testing.assert_allclose(found, clamped, atol=1e-11 * np.abs(values).max())
    if dim == 3:
        # 1, 1, -1, -1, s1/s2, s2/s1, 0, 0, 0 with the singular values of [m1 m2].
        frames = surface_tangents(normals)
        s = np.linalg.svd((np.eye(3) + D) @ np.swapaxes(frames, 1, 2), compute_uv=False)
        ones = np.ones(n)
        spectrum = np.stack([ones, ones, -ones, -ones, s[:, 0] / s[:, 1], s[:, 1] / s[:, 0], *np.zeros((3, n))], axis=1)
        expected = np.sort(k[:, None] * spectrum, axis=1)
        np.testing.assert_allclose(values, expected, atol=1e-10 * np.abs(values).max())
    else:
        assert (values.min() < -0.1) == (sign < 0.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("dim", [2, 3])
def test_clamped_symmetric_surface_tangents_are_semidefinite(dim: int, sign: float) -> None:
    rng = np.random.default_rng(6)
    normals = rng.standard_normal((50, dim))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    D = 0.15 * rng.standard_normal((50, dim, dim))
    values = np.linalg.eigvalsh(surface_matrices(D, normals, np.full(50, sign), True, True))
    assert values.min() > -1e-13


@pytest.mark.parametrize("dim", [2, 3])
def test_tangents_are_right_handed(dim: int) -> None:
    normals = np.concatenate([np.eye(dim), -np.eye(dim), np.random.default_rng(7).standard_normal((9, dim))])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    t = surface_tangents(normals)
    frame = np.concatenate([t, normals[:, None]], axis=1)
    np.testing.assert_allclose(frame @ np.swapaxes(frame, 1, 2), np.broadcast_to(np.eye(dim), frame.shape), atol=1e-14)
    if dim == 3:
        np.testing.assert_allclose(np.cross(t[:, 0], t[:, 1]), normals, atol=1e-14)


@pytest.mark.parametrize("dim", [2, 3])
def test_gradients_at_knots_lose_nothing(dim: int) -> None:
    rng = np.random.default_rng(8)
    points = rng.uniform(0.0, 1.0, (40, dim))
    points[:20, 0] = 0.25 + 1e-9 * rng.random(20)  # weights of 1e-17 there are left out, gradients of 1e-8 are not
    points[:3, 1] = 0.35
    s = Grid(0.1, "quadratic").stencils(points)
    G = consistent_gradients(s, len(points))
    assert np.abs(np.where(s.weights[..., None] == 0.0, G, 0.0)).max() == 0.0
    x = s.positions[s.nodes]
    plain = np.where(s.weights[..., None] > 0.0, s.gradients, 0.0)
    assert np.abs(plain.sum(axis=1)).max() > 1e-9  # as they come from the grid
    np.testing.assert_allclose(G.sum(axis=1), 0.0, atol=1e-13)
    unit = np.einsum("pki,pkj->pij", x, G)
    np.testing.assert_allclose(unit, np.broadcast_to(np.eye(dim), unit.shape), atol=1e-13)
    with pytest.raises(ValueError, match="quadratic"):
        consistent_gradients(Grid(0.1, "linear").stencils(points), 3)
