"""Explicit steps on blocks: against the formulas written out densely, threads, types of numbers, bad input."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from femdeform.errors import InputError
from femdeform.jit import set_threads
from femdeform.materials.dispatch import pk1
from femdeform.materials.fixed_corotated import FixedCorotated
from femdeform.materials.neo_hookean import NeoHookean
from femdeform.mpm.block_grid import PointsOutsideError
from femdeform.mpm.explicit import ExplicitPoints
from femdeform.mpm.explicit_laws import Liquid
from femdeform.mpm.grid import Grid
from femdeform.mpm.group_step import explicit_step
from femdeform.mpm.particles import LIQUID, Particles

Array = NDArray[np.float64]
DX = 0.1


def cloud(dim: int, n: int = 200, seed: int = 0) -> Particles:
    """Points of two bodies at random, solid and liquid, moving and deformed, around the origin and across blocks."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-0.45, 0.55, (n, dim))
    particles = Particles.at(x, rng.uniform(0.5, 1.5, n), rng.uniform(0.5, 1.5, n) * DX**dim)
    particles.v[:] = rng.standard_normal((n, dim))
    particles.affine[:] = 3.0 * rng.standard_normal((n, dim, dim))
    particles.F += 0.1 * rng.standard_normal((n, dim, dim))
    particles.J[:] = rng.uniform(0.9, 1.1, n)
    particles.body[::3] = 1
    particles.phase[1::2] = LIQUID
    return particles


def laws(dim: int) -> dict[tuple[int, int], Any]:
    return {
        (0, 0): NeoHookean.from_lame(200.0, 300.0, dim),
        (1, 0): FixedCorotated.from_lame(100.0, 150.0, dim),
        (0, LIQUID): Liquid(500.0, 2.0),
        (1, LIQUID): Liquid(300.0, 0.0),
    }


def splines(x: Array, n: int, low: int) -> tuple[Array, Array, Array]:
    """Dense weights (P, N), gradients (P, N, dim) and positions of the nodes low..low + n - 1 an axis."""
    P, dim = x.shape
    base = np.floor(x / DX - 0.5).astype(int)
    f = x / DX - base
    w = np.stack([0.5 * (1.5 - f) ** 2, 0.75 - (f - 1) ** 2, 0.5 * (f - 0.5) ** 2], 1)
    g = np.stack([f - 1.5, -2 * (f - 1), f - 0.5], 1) / DX
    W, G = np.zeros((P, n**dim)), np.zeros((P, n**dim, dim))
    rows = np.arange(P)
    for o in np.ndindex(*([3] * dim)):
        at, ww, gg = np.zeros(P, int), np.ones(P), np.ones((P, dim))
        for a in range(dim):
            at = at * n + base[:, a] - low + o[a]
            ww = ww * w[:, o[a], a]
            for b in range(dim):
                gg[:, b] *= (g if a == b else w)[:, o[a], a]
        W[rows, at] += ww
        G[rows, at] += gg
    X = np.stack(np.meshgrid(*([(np.arange(n) + low) * DX] * dim), indexing="ij"), -1).reshape(-1, dim)
    return W, G, X


def dense_step(p: Particles, dt: float, gravity: Array, transfer: str, flip: float) -> Particles:
    """One step by the formulas, with matrices over all nodes."""
    dim = p.dim
    W, G, X = splines(p.x, 20, -8)
    R = X[None] - p.x[:, None]
    A = p.affine if transfer == "apic" else 0.0 * p.affine
    mass = p.mass @ W
    inverse = np.divide(1.0, mass, out=np.zeros_like(mass), where=mass > 0.0)[:, None]
    before = inverse * np.einsum("p,pi,pia->ia", p.mass, W, p.v[:, None] + np.einsum("pab,pib->pia", A, R))
    L = np.einsum("ia,pib->pab", before, G)
    force = np.zeros_like(before)
    materials = laws(dim)
    for k in range(p.n):
        law = materials[int(p.body[k]), int(p.phase[k])]
        if p.phase[k] == LIQUID:
            eps = 0.5 * (L[k] + L[k].T)
            tau = p.J[k] * (law.bulk_modulus * (p.J[k] - 1.0) * np.eye(dim) + 2.0 * law.viscosity * eps)
        else:
            tau = np.array(pk1(tuple(p.F[k].ravel()), law)).reshape(dim, dim) @ p.F[k].T
        force -= p.volume[k] * G[k] @ tau.T
    after = np.where(mass[:, None] > 0.0, before + dt * (force * inverse + gravity), 0.0)
    out = p.take(np.arange(p.n))
    v = W @ after
    out.x += dt * v
    out.v[:] = v if transfer != "flip" else (1 - flip) * v + flip * (p.v + W @ (after - before))
    B = np.einsum("pi,ia,pib->pab", W, after, R)
    out.affine[:] = 4.0 / DX**2 * B if transfer == "apic" else 0.0
    rate = np.einsum("ia,pib->pab", after, G)
    liquid = p.phase == LIQUID
    out.F[~liquid] = ((np.eye(dim) + dt * rate) @ p.F)[~liquid]
    out.J[liquid] *= np.linalg.det(np.eye(dim) + dt * rate)[liquid]
    return out


def close(a: Particles, b: Particles, tolerance: float) -> None:
    for name in ("x", "v", "affine", "F", "J"):
        scale = np.abs(getattr(b, name)).max()
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=0.0, atol=tolerance * max(scale, 1e-30))


def points(particles: Particles, dim: int, **more: Any) -> ExplicitPoints:
    return ExplicitPoints(particles, laws(dim), DX, np.full(dim, -0.7), np.full(dim, 0.8), **more)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("transfer", ["pic", "flip", "apic"])
def test_a_step_is_that_of_the_formulas(dim: int, transfer: str) -> None:
    gravity = np.array([0.5, -9.0, 2.0])[:dim]
    particles = cloud(dim)
    explicit = points(particles, dim, transfer=transfer, flip=0.7, gravity=gravity)
    expected = particles
    for _ in range(2):
        explicit.step(2e-4)
        expected = dense_step(expected, 2e-4, gravity, transfer, 0.7)
    close(explicit.particles(), expected, 1e-10)
    assert explicit.time == pytest.approx(4e-4)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("transfer", ["pic", "flip", "apic", "group_apic"])
def test_groups_of_single_points_take_the_same_step(dim: int, transfer: Any) -> None:
    gravity = np.array([0.5, -9.0, 2.0])[:dim]
    particles = cloud(dim, seed=1)
    found = explicit_step(
        particles, laws(dim), Grid(DX, "quadratic"), 2e-4, gravity=gravity, transfer=transfer, flip=0.7
    )
    expected = dense_step(particles, 2e-4, gravity, transfer.replace("group_", ""), 0.7)
    close(found.particles, expected, 1e-10)


@pytest.mark.parametrize("dim", [2, 3])
def test_any_number_of_threads_gives_the_same_bits(dim: int) -> None:
    results = []
    for threads in (1, 2):
        set_threads(threads)
        explicit = points(cloud(dim, 3000), dim)
        for _ in range(5):
            explicit.step(1e-4)
        results.append(explicit.particles())
    set_threads()
    for name in ("x", "v", "affine", "F", "J"):
        np.testing.assert_array_equal(getattr(results[0], name), getattr(results[1], name))


@pytest.mark.parametrize("dim", [2, 3])
def test_sorting_keeps_each_point_what_it_was(dim: int) -> None:
    """Points that are shuffled move as before: those of `particles` come in the order in which they were given."""
    particles = cloud(dim, 2000)
    order = np.random.default_rng(3).permutation(particles.n)
    straight, shuffled = points(particles, dim), points(particles.take(order), dim)
    for _ in range(3):
        straight.step(1e-4)
        shuffled.step(1e-4)
    close(shuffled.particles(), straight.particles().take(order), 1e-10)
    for each in shuffled.sets:
        np.testing.assert_array_equal(each.order, np.arange(each.n))


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_going_on_from_a_copy_gives_the_same_bits(dtype: Any) -> None:
    """Points are moved in memory by then, and have changed their blocks: neither has a part in the sums."""
    explicit = points(cloud(2, 3000), 2, dtype=dtype)
    for _ in range(10):
        explicit.step(5e-4)
    other = points(explicit.particles(), 2, dtype=dtype)
    for _ in range(10):
        explicit.step(5e-4)
        other.step(5e-4)
    assert any(np.any(np.diff(each.numbers) < 0) for each in explicit.sets)
    for name in ("x", "v", "affine", "F", "J"):
        np.testing.assert_array_equal(getattr(explicit.particles(), name), getattr(other.particles(), name))


@pytest.mark.parametrize("dim", [2, 3])
def test_float32_is_close_to_float64(dim: int) -> None:
    # Two points a cell and axis: nodes of almost no mass, whose velocity is a quotient of rounding, are rare.
    side = np.arange(12) * 0.5 * DX - 0.3
    x = np.stack(np.meshgrid(*[side] * dim, indexing="ij"), -1).reshape(-1, dim)
    particles = Particles.at(x, np.full(len(x), 2.0), np.full(len(x), (0.5 * DX) ** dim))
    particles.v[:] = np.sin(7.0 * x)
    results = []
    for dtype in (np.float64, np.float32):
        explicit = points(particles, dim, dtype=dtype)
        for _ in range(20):
            explicit.step(2e-4)
        assert explicit.grid.velocity.dtype == dtype
        results.append(explicit.particles())
    close(results[1], results[0], 1e-4)
    assert np.abs(results[0].F - np.eye(dim)).max() > 1e-3


def test_liquid_volumes_are_kept_in_bounds_and_counted() -> None:
    particles = Particles.at(np.array([[0.0, 0.0]]), np.ones(1), np.full(1, DX**2))
    particles.phase[:] = LIQUID
    particles.affine[0] = np.eye(2) * -1000.0
    explicit = ExplicitPoints(particles, {(0, LIQUID): Liquid(0.0, 0.0)}, DX, np.full(2, -1.0), np.full(2, 1.0))
    explicit.step(1e-2)
    assert explicit.particles().J[0] == 0.1
    assert explicit.n_bounded == 1


def test_points_outside_are_an_error_and_nothing_changes() -> None:
    particles = cloud(2)
    particles.x[17] = [0.9, 0.0]
    explicit = points(particles, 2)
    with pytest.raises(PointsOutsideError, match=r"1 material points are outside.*\[0\.9, 0\.0\]"):
        explicit.step(1e-3)
    np.testing.assert_array_equal(explicit.particles().x, particles.x)
    particles.x[17] = [np.nan, 0.0]
    with pytest.raises(PointsOutsideError):
        points(particles, 2).step(1e-3)


def test_bad_input_is_refused() -> None:
    some = laws(2)
    del some[1, LIQUID]
    with pytest.raises(InputError, match="body 1 has no material for liquid points"):
        ExplicitPoints(cloud(2), some, DX, np.full(2, -1.0), np.full(2, 1.0))
    with pytest.raises(InputError, match="Liquid is no material of solid points"):
        ExplicitPoints(cloud(2), laws(2) | {(0, 0): Liquid(1.0, 0.0)}, DX, np.full(2, -1.0), np.full(2, 1.0))
    with pytest.raises(InputError, match="`pic`, `flip` or `apic`"):
        points(cloud(2), 2, transfer="mls")
    with pytest.raises(InputError, match="domain is empty"):
        ExplicitPoints(cloud(2), laws(2), DX, np.zeros(2), np.zeros(2))
    with pytest.raises(InputError, match="too small"):
        ExplicitPoints(cloud(3), laws(3), 1e-6, np.full(3, -1.0), np.full(3, 1.0))
