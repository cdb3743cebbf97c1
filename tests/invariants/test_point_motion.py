"""Motions of material points that are known: free fall, translation, spin, a bar that vibrates."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from femdeform.contact.obstacles import Box, Sphere
from femdeform.materials.fixed_corotated import FixedCorotated
from femdeform.mpm.explicit import ExplicitPoints
from femdeform.mpm.explicit_laws import Liquid
from femdeform.mpm.particle_sampling import sample_particles
from femdeform.mpm.particles import LIQUID, Particles

DX = 1.0 / 32.0
NOTHING = Liquid(0.0, 0.0)


def disc(dim: int = 2, radius: float = 0.2) -> Particles:
    return sample_particles(Sphere(np.full(dim, 0.5), radius, False), DX, 3, 1.0)


def run(particles: Particles, law: Any, dt: float, n: int, **more: Any) -> ExplicitPoints:
    phase = int(particles.phase[0])
    dim = particles.dim
    explicit = ExplicitPoints(particles, {(0, phase): law}, DX, np.full(dim, -1.0), np.full(dim, 2.0), **more)
    for _ in range(n):
        explicit.step(dt)
    return explicit


@pytest.mark.parametrize("transfer", ["pic", "flip", "apic"])
@pytest.mark.parametrize("is_liquid", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_falling_body(dim: int, is_liquid: bool, transfer: Any) -> None:
    """``y_n = y_0 + v_0 t + g dt^2 n (n + 1) / 2`` for each point, and nothing deforms."""
    particles = disc(dim, 0.2 if dim == 2 else 0.06)
    particles.v[:] = v0 = np.array([0.4, 0.3, -0.2])[:dim]
    particles.phase[:] = LIQUID if is_liquid else 0
    law = Liquid(400.0, 0.1) if is_liquid else FixedCorotated.from_lame(50.0, 30.0, dim)
    g, dt, n = np.array([0.0, -9.81, 1.0])[:dim], 1e-3, 100
    now = run(particles, law, dt, n, gravity=g, transfer=transfer).particles()
    expected = particles.x + v0 * n * dt + g * dt**2 * n * (n + 1) / 2
    np.testing.assert_allclose(now.x, expected, rtol=0.0, atol=1e-11)
    np.testing.assert_allclose(now.F, particles.F, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(now.J, 1.0, rtol=0.0, atol=1e-9)


def test_a_pulsating_drop_that_flies() -> None:
    """The centre of mass moves evenly, whatever happens inside."""
    particles = disc()
    particles.phase[:] = LIQUID
    particles.v[:] = [0.2, 0.1] + 1.0 * (particles.x - 0.5)
    linear = particles.mass @ particles.v / particles.mass.sum()
    center = particles.mass @ particles.x / particles.mass.sum()
    explicit = run(particles, Liquid(40.0, 0.0), 2e-3, 400)
    now = explicit.particles()
    assert np.abs(now.J - 1.0).max() > 0.01
    found = now.mass @ now.x / now.mass.sum()
    np.testing.assert_allclose(found, center + explicit.time * linear, rtol=0.0, atol=1e-12)


def spin(transfer: Any, n: int) -> NDArray[np.float64]:
    """Angular momentum of a disc that turns rigidly, without stress, after each step, over that at the start."""
    particles = disc()
    particles.v[:] = np.column_stack([-(particles.x - 0.5)[:, 1], (particles.x - 0.5)[:, 0]])
    if transfer == "apic":
        particles.affine[:] = [[0.0, -1.0], [1.0, 0.0]]
    particles.phase[:] = LIQUID
    explicit = ExplicitPoints(
        particles, {(0, LIQUID): NOTHING}, DX, np.full(2, 0.0), np.full(2, 1.0), transfer=transfer
    )

    def momentum() -> float:
        p = explicit.particles()
        own = 0.25 * DX**2 * p.mass @ (p.affine[:, 1, 0] - p.affine[:, 0, 1])
        return float(p.mass @ (p.x[:, 0] * p.v[:, 1] - p.x[:, 1] * p.v[:, 0]) + own)

    out = [momentum()]
    for _ in range(n):
        explicit.step(0.002)
        out.append(momentum())
    return np.array(out[1:]) / out[0]


def test_apic_keeps_a_spin_and_pic_loses_it() -> None:
    np.testing.assert_allclose(spin("apic", 30), 1.0, rtol=0.0, atol=1e-12)
    pic = spin("pic", 30)
    # In the first step dx^2 / R^2; nodes at the rim lose less.
    assert 1.0 - pic[0] == pytest.approx(DX**2 / 0.2**2, rel=0.1)
    assert (1.0 - DX**2 / 0.2**2) ** 30 < pic[-1] < 0.6


def test_an_elastic_bar_vibrates_with_its_period() -> None:
    """Free ends, no lateral stiffness: ``T = 2 L sqrt(rho / (2 mu))``; looked for at three quarters of it."""
    length, height, mu, amplitude = 0.5, 0.125, 50.0, 0.002
    c = np.sqrt(2.0 * mu)
    low = np.array([0.25, 0.4375])
    particles = sample_particles(Box(low, low + np.array([length, height]), False), DX, 3, 1.0)
    s = np.pi * (particles.x[:, 0] - 0.5) / length
    mode = np.sin(s)
    particles.v[:, 0] = amplitude * c * mode
    particles.affine[:, 0, 0] = amplitude * c * np.pi / length * np.cos(s)
    law = FixedCorotated.from_lame(mu, 0.0, 2)
    explicit = ExplicitPoints(particles, {(0, 0): law}, DX, np.zeros(2), np.ones(2))
    dt = 0.2 * DX / c
    swing, times = [], []
    while explicit.time < 1.4 * length / c * 2.0:
        explicit.step(dt)
        swing.append(float(np.mean(explicit.particles().v[:, 0] * mode)))
        times.append(explicit.time)
    a, t = np.array(swing), np.array(times)
    k = int(np.flatnonzero((a[:-1] < 0.0) & (a[1:] >= 0.0))[0])
    crossing = t[k] - a[k] * (t[k + 1] - t[k]) / (a[k + 1] - a[k])
    assert crossing / 0.75 == pytest.approx(2.0 * length / c, rel=0.03)
