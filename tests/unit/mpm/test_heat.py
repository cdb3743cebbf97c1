"""One step of conduction: conservation, budget, the matrix, what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from femdeform.jit import set_threads
from femdeform.mpm.grid import Grid
from femdeform.mpm.heat import QUADRATURES, HeatBoundary, HeatConduction
from femdeform.mpm.particles import LIQUID, Particles, current_volumes
from femdeform.mpm.surface_samples import SurfaceSamples
from femdeform.mpm.surface_sampling import SurfaceSampler

Array = NDArray[np.float64]
DX = 0.1
OFFSET = {2: 0.56 * DX, 3: 0.7 * DX}
CASES = [(dim, quadrature) for dim in (2, 3) for quadrature in QUADRATURES]


def body(dim: int, seed: int = 0, n: int = 150) -> tuple[Particles, SurfaceSamples]:
    """Solid and liquid points of all sizes, stretched, with any temperatures, and samples around them."""
    rng = np.random.default_rng(seed)
    particles = Particles.at(rng.uniform(-0.2, 0.2, (n, dim)), 1.0 + rng.random(n), DX**dim * (0.1 + rng.random(n)))
    particles.phase[::2] = LIQUID
    particles.J = 1.0 + 0.1 * rng.standard_normal(n)
    particles.F = np.eye(dim) + 0.05 * rng.standard_normal((n, dim, dim))
    particles.temperature = 300.0 + 30.0 * rng.standard_normal(n)
    particles.temperature_gradient = 50.0 * rng.standard_normal((n, dim))
    return particles, SurfaceSampler(DX).sample(particles.x, seed)


def conduction(dim: int, quadrature: str, **arguments: Any) -> HeatConduction:
    """Steps with an offset where one is needed."""
    return HeatConduction(
        Grid(DX, "quadratic"), quadrature, OFFSET[dim] if quadrature == "shifted" else None, **arguments
    )


@pytest.mark.parametrize(("dim", "quadrature"), CASES)
def test_heat_is_kept_without_exchange(dim: int, quadrature: str) -> None:
    particles, samples = body(dim)
    capacity = np.where(particles.phase == LIQUID, 3.0, 1.0)
    heat = (particles.mass * capacity * particles.temperature).sum()
    step = conduction(dim, quadrature)
    for conductivity in (0.0, 2.0):
        for _ in range(5):
            report = step.step(particles, samples, 0.01, 0.0, capacity, conductivity)
            assert report.converged
        after = (particles.mass * capacity * particles.temperature).sum()
        assert after == pytest.approx(heat, rel=1e-13)
    # Conduction has evened temperatures out.
    assert np.std(particles.temperature) < 15.0


@pytest.mark.parametrize(("dim", "quadrature"), CASES)
def test_linear_temperatures_survive_the_transfer(dim: int, quadrature: str) -> None:
    particles, samples = body(dim)
    slope = np.arange(1.0, dim + 1.0)
    expected = 290.0 + particles.x @ slope
    particles.temperature = expected.copy()
    particles.temperature_gradient[:] = slope
    conduction(dim, quadrature).step(particles, samples, 0.01, 0.0, 1.0, 0.0)
    np.testing.assert_allclose(particles.temperature, expected, atol=1e-11)
    np.testing.assert_allclose(particles.temperature_gradient - slope, 0.0, atol=1e-8)


@pytest.mark.parametrize(("dim", "quadrature"), CASES)
def test_ambient_temperature_is_a_fixed_point(dim: int, quadrature: str) -> None:
    particles, samples = body(dim)
    particles.temperature[:] = 295.0
    particles.temperature_gradient[:] = 0.0
    step = conduction(dim, quadrature)
    for _ in range(3):
        assert step.step(particles, samples, 0.1, 0.0, 2.0, 1.0, HeatBoundary(10.0, 295.0)).converged
    np.testing.assert_allclose(particles.temperature, 295.0, rtol=1e-13)


@pytest.mark.parametrize(("dim", "quadrature"), CASES)
def test_budget_of_heat_is_exact(dim: int, quadrature: str) -> None:
    particles, samples = body(dim)
    rng = np.random.default_rng(3)
    capacity, conductivity = 1.0 + rng.random(particles.n), rng.random(particles.n)
    boundary = HeatBoundary(rng.random(samples.n), 300.0 + 20.0 * rng.random(samples.n), 30.0 * rng.random(samples.n))
    # Rows of nodes without mass are nearly dependent in space: thousands of iterations.
    step = conduction(dim, quadrature, tolerance=1e-4, max_iterations=20000)
    for k in range(4):
        before = (particles.mass * capacity * particles.temperature).sum()
        report = step.step(
            particles, samples, 0.05, 0.05 * k, capacity, conductivity, boundary, source=lambda x, t: x[:, 0]
        )
        assert report.converged
        balance = 0.05 * (report.boundary_power + report.source_power - report.lost_power)
        assert report.stored == pytest.approx(balance, rel=1e-10)
        after = (particles.mass * capacity * particles.temperature).sum()
        assert after - before == pytest.approx(balance, abs=1e-12 * before)
        assert report.source_power == pytest.approx((particles.x[:, 0] * current_volumes(particles)).sum(), rel=1e-13)
        assert report.lost_power == 0.0


@pytest.mark.parametrize("dim", [2, 3])
def test_step_solves_the_dense_system(dim: int) -> None:
    """The owners' quadrature against matrices of every pair of nodes, from the weights of the grid."""
    particles, samples = body(dim, n=40)
    rng = np.random.default_rng(1)
    capacity, conductivity = 1.0 + rng.random(particles.n), rng.random(particles.n)
    h, ambient, flux = 10.0 * rng.random(samples.n), 280.0 + 40.0 * rng.random(samples.n), rng.random(samples.n)
    s = Grid(DX, "quadratic").stencils(particles.x)
    N, G = np.zeros((particles.n, s.n_nodes)), np.zeros((particles.n, s.n_nodes, dim))
    rows = np.arange(particles.n)[:, None]
    np.add.at(N, (rows, s.nodes), s.weights)
    np.add.at(G, (rows, s.nodes), np.where((s.weights > 0.0)[:, :, None], s.gradients, 0.0))
    heat = particles.mass * capacity
    apart = s.positions[None] - particles.x[:, None]
    C = heat @ N
    T = (
        (heat[:, None] * N)
        * (particles.temperature[:, None] + np.einsum("pia,pa->pi", apart, particles.temperature_gradient))
    ).sum(axis=0) / C
    volume = np.where(particles.phase == LIQUID, particles.J, np.linalg.det(particles.F)) * particles.volume
    at = N[samples.owner]
    K = np.einsum("p,pia,pja->ij", conductivity * volume, G, G)
    R = (at.T * (h * samples.measure)) @ at
    assert np.linalg.eigvalsh(np.diag(C) / 0.02 + K + R).min() > 0.0
    load = at.T @ ((h * ambient + flux) * samples.measure) + N.T @ (2.0 * volume)
    new = np.linalg.solve(np.diag(C) / 0.02 + K + R, C / 0.02 * T + load)
    report = conduction(dim, "owner", tolerance=1e-13).step(
        particles, samples, 0.02, 0.0, capacity, conductivity, HeatBoundary(h, ambient, flux), source=2.0
    )
    assert report.converged
    np.testing.assert_allclose(particles.temperature, N @ new, rtol=1e-10)
    np.testing.assert_allclose(particles.temperature_gradient, np.einsum("pia,i->pa", G, new), rtol=1e-6, atol=1e-4)


@pytest.mark.parametrize("dim", [2, 3])
def test_flux_onto_nodes_without_mass_is_lost_at_the_samples_only(dim: int) -> None:
    found = {}
    for quadrature in QUADRATURES:
        particles, samples = body(dim)
        report = conduction(dim, quadrature).step(
            particles, samples, 0.01, 0.0, 1.0, 1.0, HeatBoundary(flux=1.0), area_scale=0.5
        )
        assert report.boundary_power == pytest.approx(0.5 * samples.measure.sum(), rel=1e-12)
        found[quadrature] = report.lost_power / report.boundary_power
    assert found["owner"] == 0.0
    assert found["literal"] > 1e-3
    assert found["shifted"] < 1e-12


def test_fields_may_be_functions_of_place_and_time() -> None:
    particles, samples = body(2)
    again = particles.take(np.arange(particles.n))
    boundary = HeatBoundary(lambda x, t: 1.0 + x[:, 0] ** 2, lambda x, t: 300.0 + t, lambda x, t: t * x[:, 1])
    arrays = HeatBoundary(1.0 + samples.points[:, 0] ** 2, 307.0, 7.0 * samples.points[:, 1])
    conduction(2, "owner").step(particles, samples, 0.1, 7.0, 1.0, 1.0, boundary, source=lambda x, t: t * x[:, 1])
    conduction(2, "owner").step(again, samples, 0.1, 7.0, 1.0, 1.0, arrays, source=7.0 * again.x[:, 1])
    np.testing.assert_array_equal(particles.temperature, again.temperature)


def test_given_stencils_and_threads_change_nothing() -> None:
    results = []
    try:
        for threads, given in ((1, False), (2, False), (2, True)):
            set_threads(threads)
            particles, samples = body(3, n=400)
            stencils = Grid(DX, "quadratic").stencils(particles.x) if given else None
            conduction(3, "owner").step(
                particles, samples, 0.1, 0.0, 1.0, 1.0, HeatBoundary(1.0, 280.0), stencils=stencils
            )
            results.append(particles.temperature)
    finally:
        set_threads(None)
    np.testing.assert_array_equal(results[0], results[1])
    np.testing.assert_array_equal(results[0], results[2])


def test_unconverged_solve_is_reported_and_changes_nothing() -> None:
    particles, samples = body(2)
    before = particles.temperature.copy()
    report = conduction(2, "owner", max_iterations=2).step(
        particles, samples, 10.0, 0.0, 1.0, 1.0, HeatBoundary(10.0, 280.0)
    )
    assert not report.converged
    assert report.residual > 1e-10
    np.testing.assert_array_equal(particles.temperature, before)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"dt": 0.0}, "time step"),
        ({"capacity": 0.0}, "heat capacity"),
        ({"conductivity": -1.0}, "conductivity"),
        ({"conductivity": np.ones(3)}, "values of shape"),
        ({"capacity": np.nan}, "not finite"),
        ({"boundary": HeatBoundary(-1.0)}, "negative"),
        ({"boundary": HeatBoundary(1.0, np.ones(2))}, "ambient temperature"),
        ({"source": lambda x, t: x}, "source"),
    ],
)
def test_bad_input(change: dict[str, Any], message: str) -> None:
    particles, samples = body(2)
    arguments: dict[str, Any] = {"dt": 0.1, "time": 0.0, "capacity": 1.0, "conductivity": 1.0}
    with pytest.raises(ValueError, match=message):
        conduction(2, "owner").step(particles, samples, **{**arguments, **change})


def test_bad_options() -> None:
    with pytest.raises(ValueError, match="quadratic"):
        HeatConduction(Grid(DX, "linear"))
    with pytest.raises(ValueError, match="none of"):
        HeatConduction(Grid(DX, "quadratic"), "nearest")
    for quadrature, offset in (("shifted", None), ("owner", 0.1)):
        with pytest.raises(ValueError, match="offset"):
            HeatConduction(Grid(DX, "quadratic"), quadrature, offset)
