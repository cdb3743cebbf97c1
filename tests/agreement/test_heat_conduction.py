"""Heat in slabs and discs of material points against series, decay rates and budgets."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from femdeform.mpm.grid import Grid
from femdeform.mpm.heat import HeatBoundary, HeatConduction, HeatReport
from femdeform.mpm.heat_content import HeatContent
from femdeform.mpm.particles import Particles
from femdeform.mpm.phase_change import Melting
from femdeform.mpm.surface_samples import SurfaceSamples
from femdeform.mpm.surface_sampling import SurfaceSampler
from femdeform.mpm.temperature_functions import Constant, Table
from verification.analytic.heat import (
    cooling_ball,
    cooling_disc,
    cooling_slab,
    disc_roots,
    slowest_odd_disc_root,
    stefan_front,
)

Array = NDArray[np.float64]
PER_CELL = 3


def lattice(low: Array, high: Array, dx: float) -> Particles:
    """Points of density one in a box, `PER_CELL` an axis in each cell."""
    axes = [np.arange(round(a / dx * PER_CELL), round(b / dx * PER_CELL)) for a, b in zip(low, high, strict=True)]
    x = (np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, len(low)) + 0.5) * dx / PER_CELL
    volume = np.full(len(x), (dx / PER_CELL) ** len(low))
    return Particles.at(x, volume, volume)


def disc(centre: tuple[float, float], radius: float, dx: float) -> Particles:
    """Points of density one in a disc."""
    c = np.array(centre)
    box = lattice(c - radius - dx, c + radius + dx, dx)
    return box.take(np.flatnonzero(((box.x - c) ** 2).sum(axis=1) < radius**2))


def rate(times: Array, values: Array, dt: float) -> float:
    """Decay rate of the equation that backward Euler with steps dt solves: its own is log(1 + rate dt) / dt."""
    return float(np.expm1(-np.polyfit(times, np.log(np.abs(values)), 1)[0] * dt) / dt)


def cooled_disc(n: int, biot: float, quadrature: str, steps: int = 50) -> float:
    """Mean temperature at Fo = 0.5 of a disc of temperature 1 in surroundings of 0."""
    radius, dx = 0.2, 1.0 / (n - 1)
    particles = disc((0.5, 0.5), radius, dx)
    particles.temperature[:] = 1.0
    conduction = HeatConduction(Grid(dx, "quadratic"), quadrature, 0.56 * dx if quadrature == "shifted" else None)
    dt = 0.5 * radius**2 / steps
    for k in range(steps):
        samples = SurfaceSampler(dx).sample(particles.x, k)
        scale = 2.0 * np.pi * radius / samples.measure.sum()
        boundary = HeatBoundary(transfer=biot / radius)
        assert conduction.step(particles, samples, dt, 0.0, 1.0, 1.0, boundary, area_scale=scale).converged
    return float(particles.temperature.mean())


@pytest.mark.parametrize(("biot", "tolerance"), [(0.1, 0.02), (1.0, 0.02), (10.0, 0.06)])
def test_cooling_disc(biot: float, tolerance: float) -> None:
    assert cooled_disc(65, biot, "owner", 100) == pytest.approx(float(cooling_disc(biot, 0.5)), rel=tolerance)


@pytest.mark.parametrize("biot", [1.0, 10.0])
def test_error_of_the_cooling_disc_is_halved_with_the_grid(biot: float) -> None:
    """Without that of the time step: what is left is where heat is exchanged, half a gap inside the hull."""
    exact = float(cooling_disc(biot, 0.5, steps=50))
    coarse, fine = (cooled_disc(n, biot, "owner") / exact - 1.0 for n in (33, 65))
    assert -0.15 < coarse < 0.0
    assert -0.08 < fine < 0.0
    assert fine / coarse == pytest.approx(0.5, abs=0.15)


def test_exchange_at_the_samples_insulates_the_disc() -> None:
    """As in the dissertation: nodes outside of all mass take the ambient temperature. Refinement does not help."""
    exact = float(cooling_disc(1.0, 0.5, steps=50))
    coarse, fine = (cooled_disc(n, 1.0, "literal") for n in (33, 65))
    assert coarse > 1.7 * exact
    assert fine > coarse
    assert cooled_disc(33, 1.0, "shifted") == pytest.approx(exact, rel=0.02)


@pytest.mark.parametrize(("biot", "tolerance"), [(0.1, 0.005), (1.0, 0.03)])
def test_cooling_ball(biot: float, tolerance: float) -> None:
    radius, dx, steps = 0.3, 1.0 / 16, 20
    box = lattice(np.full(3, 0.125), np.full(3, 0.875), dx)
    particles = box.take(np.flatnonzero(((box.x - 0.5) ** 2).sum(axis=1) < radius**2))
    particles.temperature[:] = 1.0
    conduction, dt = HeatConduction(Grid(dx, "quadratic")), 0.5 * radius**2 / steps
    for k in range(steps):
        samples = SurfaceSampler(dx).sample(particles.x, k)
        scale = 4.0 * np.pi * radius**2 / samples.measure.sum()
        boundary = HeatBoundary(transfer=biot / radius)
        assert conduction.step(particles, samples, dt, 0.0, 1.0, 1.0, boundary, area_scale=scale).converged
    exact = cooling_ball(biot, 0.5, steps=steps)
    assert particles.temperature.mean() == pytest.approx(exact, rel=tolerance)


def test_cooling_slab() -> None:
    """Two faces of a strip lose heat, its ends do not."""
    half, dx, steps, biot = 0.25, 1.0 / 64, 50, 1.0
    particles = lattice(np.array([0.25, 0.25]), np.array([0.75, 0.375]), dx)
    particles.temperature[:] = 1.0
    conduction = HeatConduction(Grid(dx, "quadratic"))
    dt = 0.5 * half**2 / steps
    for k in range(steps):
        samples = SurfaceSampler(dx).sample(particles.x, k)
        face = (np.abs(samples.points[:, 0] - 0.5) > half) & (np.abs(samples.points[:, 1] - 0.3125) < 0.0625)
        scale = 2.0 * 0.125 / samples.measure[face].sum()
        boundary = HeatBoundary(transfer=np.where(face, biot / half, 0.0))
        assert conduction.step(particles, samples, dt, 0.0, 1.0, 1.0, boundary, area_scale=scale).converged
    middle = np.abs(particles.x[:, 0] - 0.5) < dx
    assert particles.temperature[middle].mean() == pytest.approx(
        float(cooling_slab(biot, 0.5, np.zeros(1))[0]), rel=0.02
    )
    assert particles.temperature.mean() == pytest.approx(float(cooling_slab(biot, 0.5)), rel=0.02)


def two_discs(n: int, transfer: float, conductivity: float, dt: float, steps: int) -> tuple[Array, HeatReport, float]:
    """The dissertation's two discs: time, mean temperatures, and the odd part of the left one, in each step."""
    radius, dx = 0.15, 1.0 / (n - 1)
    left, right = disc((0.3, 0.5), radius, dx), disc((0.7, 0.5), radius, dx)
    left.temperature = 265.0 + 30.0 * (left.x[:, 0] - 0.15) / 0.3
    right.temperature = 295.0 + 30.0 * (right.x[:, 0] - 0.55) / 0.3
    particles = Particles.joined([left, right])
    particles.temperature_gradient[:, 0] = 100.0
    conduction, history = HeatConduction(Grid(dx, "quadratic")), []
    discrete = 0.0
    for k in range(steps):
        samples = SurfaceSampler(dx).sample(particles.x, k)
        scale = 4.0 * np.pi * radius / samples.measure.sum()
        report = conduction.step(
            particles, samples, dt, 0.0, 1.0, conductivity, HeatBoundary(transfer, 295.0), area_scale=scale
        )
        assert report.converged
        T = particles.temperature[: left.n]
        odd = ((T - T.mean()) * (left.x[:, 0] - 0.3)).mean()
        history.append((dt * (k + 1), T.mean(), particles.temperature[left.n :].mean(), odd))
        discrete = transfer * scale * samples.measure.sum() / particles.mass.sum()
    return np.array(history), report, discrete


def test_two_discs_that_lose_heat() -> None:
    biot = 600.0
    history, _, _ = two_discs(65, 10.0, 0.0025, 0.1, 30)
    alpha = 0.0025 / 0.15**2
    late = history[:, 0] > 1.0
    mean = alpha * disc_roots(biot)[0] ** 2
    assert rate(history[late, 0], history[late, 1] - 295.0, 0.1) == pytest.approx(mean, rel=0.06)
    assert rate(history[late, 0], history[late, 2] - 295.0, 0.1) == pytest.approx(mean, rel=0.06)
    early = (history[:, 0] > 0.5) & (history[:, 0] < 1.6)
    odd = alpha * slowest_odd_disc_root(biot) ** 2
    assert rate(history[early, 0], history[early, 3], 0.1) == pytest.approx(odd, rel=0.06)


def test_two_discs_without_exchange() -> None:
    history, report, _ = two_discs(65, 0.0, 0.0025, 0.1, 40)
    first = history[0]
    assert np.abs(history[:, 1:3] / first[1:3] - 1.0).max() < 1e-12
    np.testing.assert_allclose(history[-1, 1:3], [280.0, 310.0], atol=0.05)
    assert report.boundary_power == 0.0
    late = history[:, 0] > 1.0
    odd = 0.0025 * (slowest_odd_disc_root(0.0) / 0.15) ** 2
    assert rate(history[late, 0], history[late, 3], 0.1) == pytest.approx(odd, rel=0.03)


def test_two_discs_of_high_conductivity_cool_as_lumps() -> None:
    biot, transfer = 0.01, 0.1
    history, _, discrete = two_discs(33, transfer, transfer * 0.15 / biot, 0.05, 40)
    late = history[:, 0] > 0.5
    found = rate(history[late, 0], history[late, 1] - 295.0, 0.05)
    assert found == pytest.approx(discrete, rel=0.01)
    assert found == pytest.approx(2.0 * transfer / 0.15, rel=0.02)


@pytest.mark.parametrize("transfer", [0.0, 0.1])
def test_rotating_flux(transfer: float) -> None:
    """The dissertation's disc, heated on an arc of 30 degrees that turns once a second."""
    radius, dx, dt, steps, half, heating = 0.15, 1.0 / 32, 0.02, 150, np.pi / 12, 5.0
    particles = disc((0.5, 0.5), radius, dx)
    particles.temperature[:] = 295.0

    def flux(points: Array, time: float) -> Array:
        angle = np.arctan2(points[:, 1] - 0.5, points[:, 0] - 0.5) - 2.0 * np.pi * time
        return np.where(np.abs((angle + np.pi) % (2.0 * np.pi) - np.pi) < half, heating, 0.0)

    conduction, means, spots = HeatConduction(Grid(dx, "quadratic")), [], []
    for k in range(steps):
        samples = SurfaceSampler(dx).sample(particles.x, k)
        scale = 2.0 * np.pi * radius / samples.measure.sum()
        time = dt * (k + 1)
        boundary = HeatBoundary(transfer, 295.0, flux)
        assert conduction.step(particles, samples, dt, time, 1.0, 0.01, boundary, area_scale=scale).converged
        means.append(particles.temperature.mean())
        hottest = particles.x[np.argmax(particles.temperature)] - 0.5
        spots.append(np.arctan2(hottest[1], hottest[0]) - 2.0 * np.pi * time)
    # The hot spot follows the arc, a little behind it.
    behind = np.angle(np.exp(1j * np.array(spots[50:])))
    assert np.abs(behind).max() < 0.6
    assert behind.mean() < 0.0
    power = heating * 2.0 * half * radius
    if transfer == 0.0:
        assert (means[-1] - 295.0) / (dt * steps) == pytest.approx(power / particles.mass.sum(), rel=0.03)
    else:
        # Approach to the steady mean at the rate of the slowest mode of Bi = 1.5.
        steady, decay = power / (transfer * 2.0 * np.pi * radius), 0.01 * (disc_roots(1.5)[0] / radius) ** 2
        periods = np.array(means) - 295.0
        whole = round(1.0 / dt)
        gaps = steady - np.array([periods[i * whole : (i + 1) * whole].mean() for i in range(3)])
        assert np.log(gaps[0] / gaps[1]) == pytest.approx(decay, rel=0.06)
        assert periods[-1] == pytest.approx(steady * (1.0 - np.exp(-decay * dt * steps)), rel=0.05)


def test_melting_front() -> None:
    """A solid at its melting point melts from a hot face: Neumann's front, and every joule is there."""
    n, dt, band, rows = 32, 1e-3, 0.02, 3
    dx = 1.0 / n
    particles = lattice(np.zeros(2), np.array([1.0, rows * dx]), dx)
    content = HeatContent(Constant(1.0), melting=Melting(-band / 2, band / 2, latent_heat=1.0))
    particles.temperature[:] = -band / 2
    first = np.flatnonzero(particles.x[:, 0] < dx / PER_CELL)
    side = dx / PER_CELL
    face = SurfaceSamples(
        particles.x[first] - [side / 2, 0.0], np.tile([-1.0, 0.0], (first.size, 1)), np.full(first.size, side), first
    )
    conduction = HeatConduction(Grid(dx, "quadratic"))
    start = (particles.mass * content.enthalpy(particles.temperature)).sum()
    brought, front = 0.0, []
    for _ in range(100):
        before = particles.temperature.copy()
        capacity = content.capacity(before)
        report = conduction.step(particles, face, dt, 0.0, capacity, 1.0, HeatBoundary(1e4, 1.0))
        brought += dt * report.boundary_power
        particles.temperature = content.recovered(before, particles.temperature, capacity)
        liquid = np.clip(particles.temperature / band + 0.5, 0.0, 1.0)
        front.append((particles.mass * liquid).sum() / (rows * dx))
    assert (particles.mass * content.enthalpy(particles.temperature)).sum() - start == pytest.approx(brought, rel=1e-11)
    exact = 2.0 * stefan_front(1.0) * np.sqrt(dt * np.arange(1, 101))
    np.testing.assert_allclose(front[49:], exact[49:], rtol=0.05)


def bar_by_finite_volumes(capacity: Table, end: float, n: int = 400) -> tuple[Array, Array]:
    """Places and temperatures of an insulated bar of length and conductivity 1 that starts at 300 + 100 x."""
    x = (np.arange(n) + 0.5) / n

    def rate(time: float, T: Array) -> Array:
        flux = np.concatenate(([0.0], np.diff(T) * n, [0.0]))
        return np.asarray(np.diff(flux) * n / capacity(T))

    solution = solve_ivp(rate, (0.0, end), 300.0 + 100.0 * x, "BDF", rtol=1e-9, atol=1e-7)
    return x, np.asarray(solution.y[:, -1])


def test_specific_heat_that_follows_the_temperature() -> None:
    """A bar comes to rest within: heat spreads as the equation says, to first order in time, and none is lost."""
    n, rows, end = 64, 3, 0.05
    dx = 1.0 / n
    capacity = Table((310.0, 390.0), (1.0, 4.0))
    content = HeatContent(capacity)
    found = []
    for steps in (25, 50, 100):
        particles = lattice(np.zeros(2), np.array([1.0, rows * dx]), dx)
        particles.temperature[:] = 300.0 + 100.0 * particles.x[:, 0]
        particles.temperature_gradient[:] = [100.0, 0.0]
        conduction = HeatConduction(Grid(dx, "quadratic"))
        start = particles.mass @ content.enthalpy(particles.temperature)
        for _ in range(steps):
            before = particles.temperature.copy()
            now = content.capacity(before)
            assert conduction.step(particles, None, end / steps, 0.0, now, 1.0).converged
            particles.temperature = content.recovered(before, particles.temperature, now)
        assert particles.mass @ content.enthalpy(particles.temperature) == pytest.approx(start, rel=1e-13)
        found.append(particles.temperature)
    exact = np.interp(particles.x[:, 0], *bar_by_finite_volumes(capacity, end))
    error = np.abs(found[-1] - exact).max()
    assert error < 0.05
    # A constant one, the mean of it, is off by many times as much.
    mean = np.interp(particles.x[:, 0], *bar_by_finite_volumes(Table((0.0,), (2.5,)), end))
    assert np.abs(mean - exact).max() > 20.0 * error
    coarse, fine = (np.abs(b - a).max() for a, b in itertools.pairwise(found))
    assert coarse / fine == pytest.approx(2.0, abs=0.15)
