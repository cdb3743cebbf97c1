"""Mass, momenta and centre of mass of material points through split, transfers, explicit steps and merge."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from point_drop import spin, turning

from femdeform.materials.fixed_corotated import FixedCorotated
from femdeform.mpm.explicit import ExplicitPoints
from femdeform.mpm.explicit_laws import Liquid
from femdeform.mpm.grid import Grid
from femdeform.mpm.group_step import explicit_step
from femdeform.mpm.groups import Groups
from femdeform.mpm.particles import LIQUID, Particles
from femdeform.mpm.surface_forces import surface_forces
from femdeform.mpm.surface_samples import SurfaceSamples
from femdeform.mpm.transfers import momentum_to_grid

Array = NDArray[np.float64]
DX = 0.1
GRID = Grid(DX, "quadratic")


def drop(dim: int, n: int = 60, seed: int = 0) -> tuple[Particles, SurfaceSamples]:
    """Points at random, with zero to five samples each, up to a cell away, and any velocities."""
    rng = np.random.default_rng(seed)
    particles = Particles.at(rng.uniform(-0.3, 0.3, (n, dim)), rng.uniform(0.5, 1.5, n), np.full(n, 0.3 * DX**dim))
    particles.v[:] = rng.standard_normal((n, dim)) + 1.0
    particles.affine[:] = 10.0 * rng.standard_normal((n, dim, dim))
    owner = np.repeat(np.arange(n), rng.integers(0, 6, n))
    normals = rng.standard_normal((owner.size, dim))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    points = particles.x[owner] + DX * rng.uniform(0.4, 1.0, (owner.size, 1)) * normals
    return particles, SurfaceSamples(points, normals, np.full(owner.size, DX ** (dim - 1)), owner)


def same(a: Any, b: Any, scale: float = 1.0) -> None:
    np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-12 * max(scale, float(np.abs(b).max())))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("group_apic", [False, True])
def test_split_and_transfer_to_the_grid(dim: int, group_apic: bool) -> None:
    particles, samples = drop(dim)
    groups = Groups.split(particles.x, particles.mass, samples, GRID)
    same(groups.mean(groups.positions), particles.x)
    mass, velocity = groups.to_grid(particles.v, particles.affine, group_apic)
    nodes = groups.stencils.positions
    momentum = mass[:, None] * velocity
    same(mass.sum(), particles.mass.sum())
    same(mass @ nodes, particles.mass @ particles.x)
    same(momentum.sum(axis=0), particles.mass @ particles.v)
    same(turning(nodes, momentum), spin(particles, DX))


@pytest.mark.parametrize("dim", [2, 3])
def test_merge(dim: int) -> None:
    particles, samples = drop(dim)
    groups = Groups.split(particles.x, particles.mass, samples, GRID)
    mass, _ = groups.to_grid(particles.v, particles.affine)
    velocity = np.random.default_rng(5).standard_normal((mass.size, dim)) + 2.0
    momentum = mass[:, None] * velocity
    particles.v, particles.affine = groups.to_points(velocity)
    same(particles.mass @ particles.v, momentum.sum(axis=0))
    expected = turning(groups.stencils.positions, momentum)
    same(spin(particles, DX), expected)
    center = particles.mass @ particles.x
    particles.x += 0.01 * particles.v
    same(spin(particles, DX), expected)
    same(particles.mass @ particles.x - center, 0.01 * momentum.sum(axis=0))


@pytest.mark.parametrize("dim", [2, 3])
def test_variants_that_do_not_conserve(dim: int) -> None:
    """Offsets from x_p for all members lose angular momentum; reading the grid at x_p alone loses the linear one."""
    particles, samples = drop(dim)
    groups = Groups.split(particles.x, particles.mass, samples, GRID)
    share = (particles.mass / groups.sizes)[groups.owner]
    shifted = particles.v[groups.owner] + np.einsum("kab,kb->ka", particles.affine[groups.owner], groups.arms())
    mass, velocity = momentum_to_grid(groups.stencils, groups.positions, share, shifted, particles.affine[groups.owner])
    momentum = mass[:, None] * velocity
    same(momentum.sum(axis=0), particles.mass @ particles.v)
    lost = turning(groups.stencils.positions, momentum) - spin(particles, DX)
    assert np.abs(lost).max() > 1e-2
    velocity = np.random.default_rng(5).standard_normal((mass.size, dim))
    alone = groups.stencils.to_points(velocity)[groups.points]
    assert np.abs(particles.mass @ alone - mass @ velocity).max() > 1e-3


@pytest.mark.parametrize("dim", [2, 3])
def test_an_affine_velocity_comes_back_from_group_apic_alone(dim: int) -> None:
    particles, samples = drop(dim)
    gradient = np.random.default_rng(2).standard_normal((dim, dim))
    groups = Groups.split(particles.x, particles.mass, samples, GRID)
    velocity = groups.stencils.positions @ gradient.T
    v, affine = groups.to_points(velocity)
    same(v, particles.x @ gradient.T)
    rates = 0.25 * DX**2 * affine @ np.linalg.inv(groups.moments())
    np.testing.assert_allclose(rates, np.broadcast_to(gradient, rates.shape), atol=1e-11)
    inflated = np.abs(affine - gradient).max(axis=(1, 2)) / np.abs(gradient).max()
    assert inflated[groups.sizes > 1].min() > 0.05
    assert inflated[groups.sizes == 1].max() < 1e-11
    # And the grid gets it back as it was.
    same(groups.to_grid(v, affine, True)[1], velocity)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("transfer", ["apic", "group_apic"])
@pytest.mark.parametrize("is_liquid", [False, True])
@pytest.mark.parametrize("motion", ["field", "group"])
def test_steps_with_samples(dim: int, transfer: Any, is_liquid: bool, motion: Any) -> None:
    """Explicit steps with stress: linear momentum, angular momentum and the centre of mass, step after step."""
    particles, samples = drop(dim)
    particles.affine *= 0.1
    particles.phase[:] = LIQUID if is_liquid else 0
    law = Liquid(50.0, 0.5) if is_liquid else FixedCorotated.from_lame(50.0, 80.0, dim)
    linear, angular = particles.mass @ particles.v, spin(particles, DX)
    center, now, dt = particles.mass @ particles.x, particles, 1e-4
    for _ in range(20):
        moved = SurfaceSamples(
            samples.points + (now.x - particles.x)[samples.owner], samples.normals, samples.measure, samples.owner
        )
        laws = {(0, int(is_liquid)): law}
        now = explicit_step(now, laws, GRID, dt, samples=moved, transfer=transfer, motion=motion).particles
    same(now.mass @ now.v, linear)
    same(spin(now, DX), angular)
    same(now.mass @ now.x, center + 20 * dt * linear)
    assert np.abs(now.v - particles.v).max() > 0.1


@pytest.mark.parametrize("dim", [2, 3])
def test_forces_at_the_edge_of_a_stencil_add_up_to_nothing(dim: int) -> None:
    """Weights of 1e-16 are left out as rounding; their gradients are 1e-8 of the others, and forces go with those."""
    particles, samples = drop(dim)
    knots = (np.floor(samples.points / DX) + 0.5) * DX
    samples = replace(samples, points=knots + 1.5e-8 * DX)
    groups = Groups.split(particles.x, particles.mass, samples, GRID)
    rows = groups.samples
    assert ((groups.stencils.weights[rows] == 0.0) & (np.abs(groups.stencils.gradients[rows]).max(axis=2) > 1e-9)).any()
    forces = surface_forces(groups, samples, np.full(samples.n, 0.2))
    same(forces.sum(axis=0), 0.0, scale=float(np.abs(forces).max()))
    torque = turning(groups.stencils.positions, forces)
    same(torque, 0.0, scale=float(np.abs(forces).max()))


@pytest.mark.parametrize("dim", [2, 3])
def test_samples_without_mass(dim: int) -> None:
    """Their transfers keep everything; nodes that only they reach are not there, and forces on those are lost."""
    particles, samples = drop(dim)
    whole = Groups.split(particles.x, particles.mass, samples, GRID)
    groups = Groups.split(particles.x, particles.mass, samples, GRID, massless=True)
    assert groups.stencils.n_nodes < whole.stencils.n_nodes
    np.testing.assert_array_equal(groups.stencils.positions, GRID.stencils(particles.x).positions)
    mass, velocity = groups.to_grid(particles.v, particles.affine)
    assert (mass > 0.0).all()
    momentum = mass[:, None] * velocity
    same(momentum.sum(axis=0), particles.mass @ particles.v)
    same(turning(groups.stencils.positions, momentum), spin(particles, DX))
    v, affine = groups.to_points(velocity)
    same(particles.mass @ v, momentum.sum(axis=0))
    moved = replace(particles, v=v, affine=affine)
    same(spin(moved, DX), spin(particles, DX))
    same(groups.to_grid(particles.v, particles.affine, True)[1], velocity)
    k = np.full(samples.n, 0.2)
    whole_forces, forces = (surface_forces(each, samples, k) for each in (whole, groups))
    same(whole_forces.sum(axis=0), 0.0)
    assert np.abs(forces.sum(axis=0)).max() > 0.02 * np.abs(whole_forces).max()
    # On the nodes that are there, forces are those of samples with mass.
    there = np.flatnonzero(
        (whole.stencils.positions[:, None] == groups.stencils.positions[None]).all(axis=2).any(axis=1)
    )
    np.testing.assert_allclose(forces, whole_forces[there], rtol=0.0, atol=1e-6 * np.abs(forces).max())


@pytest.mark.parametrize("dim", [2, 3])
def test_samples_without_mass_among_points_lose_nothing(dim: int) -> None:
    """Where every node has mass, momenta are kept: the loss is that of the nodes without."""
    particles, _ = drop(dim, 4000)
    rng = np.random.default_rng(3)
    owner = np.sort(rng.integers(0, particles.n, 60))
    owner = owner[np.abs(particles.x[owner]).max(axis=1) < 0.1]
    normals = np.tile(np.eye(dim)[0], (owner.size, 1))
    samples = SurfaceSamples(
        particles.x[owner] + 0.3 * DX * normals, normals, np.full(owner.size, DX ** (dim - 1)), owner
    )
    law = {(0, 0): FixedCorotated.from_lame(50.0, 80.0, dim)}
    steps = [
        explicit_step(
            particles,
            law,
            GRID,
            1e-4,
            samples=samples,
            forces=lambda groups: surface_forces(groups, samples, np.full(samples.n, 5.0)),
            massless=massless,
        ).particles
        for massless in (True, False)
    ]
    for now in steps:
        same(now.mass @ now.v, particles.mass @ particles.v)
        same(spin(now, DX), spin(particles, DX), scale=float(particles.mass.sum()))
    assert np.abs(steps[0].v - steps[1].v).max() > 1e-6


@pytest.mark.parametrize("dim", [2, 3])
def test_further_forces_act_on_the_nodes(dim: int) -> None:
    particles, samples = drop(dim)
    pull = np.arange(1.0, dim + 1)

    def forces(groups: Groups) -> Array:
        return np.broadcast_to(pull, groups.stencils.positions.shape)

    law = {(0, 0): FixedCorotated.from_lame(50.0, 80.0, dim)}
    step = explicit_step(particles, law, GRID, 1e-3, samples=samples, forces=forces)
    gained = particles.mass @ (step.particles.v - particles.v)
    same(gained, 1e-3 * step.mass.size * pull, scale=100.0)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("transfer", ["apic", "flip", "pic"])
def test_steps_on_blocks(dim: int, transfer: Any) -> None:
    """Linear momentum with all transfers, angular momentum with APIC."""
    particles, _ = drop(dim, 800)
    particles.affine *= 0.1 if transfer == "apic" else 0.0
    law = {(0, 0): FixedCorotated.from_lame(50.0, 80.0, dim)}
    explicit = ExplicitPoints(particles, law, DX, np.full(dim, -2.0), np.full(dim, 2.0), transfer=transfer)
    for _ in range(50):
        explicit.step(2e-4)
    now = explicit.particles()
    linear = particles.mass @ particles.v
    same(now.mass @ now.v, linear)
    if transfer == "apic":
        same(spin(now, DX), spin(particles, DX))
    if transfer != "flip":
        same(now.mass @ now.x, particles.mass @ particles.x + 50 * 2e-4 * linear)
    assert np.abs(now.v - particles.v).max() > 0.1
