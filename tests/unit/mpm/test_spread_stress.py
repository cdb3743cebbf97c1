"""Stress and deformation spread over the groups of points with samples: what a point's J sees is how it moves."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from femdeform.mpm.explicit_laws import Liquid
from femdeform.mpm.grid import Grid
from femdeform.mpm.group_step import advance
from femdeform.mpm.groups import Groups
from femdeform.mpm.particles import LIQUID, Particles
from femdeform.mpm.surface_samples import SurfaceSamples

Array = NDArray[np.float64]
DX = 0.1
GRID = Grid(DX, "quadratic")
LAWS = {(0, LIQUID): Liquid(50.0, 0.0)}


def drop(dim: int, clustered: bool, seed: int = 0) -> tuple[Particles, SurfaceSamples]:
    """Liquid points on a lattice or crowded together, and zero to three samples of each."""
    rng = np.random.default_rng(seed)
    axis = (np.arange(5) + 0.5) * 0.5 * DX + 0.013
    x = np.stack(np.meshgrid(*[axis] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    if clustered:
        x = x.mean(axis=0) + 0.4 * (x - x.mean(axis=0)) + 0.01 * rng.standard_normal(x.shape)
    points = Particles.at(x, rng.uniform(0.5, 1.5, len(x)), np.full(len(x), (0.5 * DX) ** dim))
    points.phase[:] = LIQUID
    points.J[:] = rng.uniform(0.9, 1.1, len(x))
    owner = np.repeat(np.arange(len(x)), rng.integers(0, 4, len(x)))
    normals = rng.standard_normal((owner.size, dim))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    places = x[owner] + DX * rng.uniform(0.3, 0.7, (owner.size, 1)) * normals
    return points, SurfaceSamples(places, normals, np.full(owner.size, DX ** (dim - 1)), owner)


@pytest.mark.parametrize("clustered", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_an_affine_motion_changes_J_by_its_determinant(dim: int, clustered: bool) -> None:
    points, samples = drop(dim, clustered)
    L = np.random.default_rng(1).standard_normal((dim, dim))
    for spreads in (False, True):
        groups = Groups.split(points.x, points.mass, samples, GRID, spreads)
        after, n_bounded = advance(points, LAWS, groups, groups.stencils.positions @ L.T, 0.05)
        assert n_bounded == 0
        np.testing.assert_allclose(after.J, points.J * np.linalg.det(np.eye(dim) + 0.05 * L), rtol=1e-7)
        np.testing.assert_allclose(after.x, points.x @ (np.eye(dim) + 0.05 * L).T, atol=1e-13)


@pytest.mark.parametrize("clustered", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_the_gradient_of_a_point_is_that_of_the_motion_it_makes(dim: int, clustered: bool) -> None:
    """Move a group: what changes of its velocity is the gradient it has seen; without spreading it is another."""
    points, samples = drop(dim, clustered)
    groups = Groups.split(points.x, points.mass, samples, GRID)
    nodes = np.rint(groups.stencils.positions / DX)

    def field(at: Array) -> Array:
        """Any velocities of the nodes, whichever of them are active."""
        i = np.rint(at / DX)
        return np.sin(i @ np.arange(1.0, dim**2 + 1).reshape(dim, dim) + 0.3)

    assert np.abs(field(groups.stencils.positions)).max() > 0.9
    assert len(np.unique(nodes, axis=0)) == len(nodes)
    seen = groups.gradients(field(groups.stencils.positions))
    h = 1e-6 * DX
    for axis in range(dim):
        moved = []
        for sign in (1.0, -1.0):
            shift = sign * h * np.eye(dim)[axis]
            there = SurfaceSamples(samples.points + shift, samples.normals, samples.measure, samples.owner)
            other = Groups.split(points.x + shift, points.mass, there, GRID)
            moved.append(other.to_points(field(other.stencils.positions))[0])
        np.testing.assert_allclose(seen[:, :, axis], (moved[0] - moved[1]) / (2.0 * h), atol=2e-5 / DX)
    alone = Groups.split(points.x, points.mass, samples, GRID, False).gradients(field(groups.stencils.positions))
    with_samples = groups.sizes > 1
    assert np.abs(alone - seen)[with_samples].max() > 0.1 / DX
    np.testing.assert_allclose(alone[~with_samples], seen[~with_samples], atol=1e-12 / DX)


@pytest.mark.parametrize("spreads", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_forces_do_the_work_of_the_stress(dim: int, spreads: bool) -> None:
    """``sum f_i . v_i = -sum V0 P F^T : grad v`` with the gradients that deform the points, and no resultant."""
    points, samples = drop(dim, False)
    groups = Groups.split(points.x, points.mass, samples, GRID, spreads)
    rng = np.random.default_rng(2)
    pairs = {2: [(0, 0), (1, 1), (0, 1)], 3: [(0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1)]}[dim]
    stress = rng.standard_normal((points.n, len(pairs)))
    force = groups.forces(stress)
    velocity = rng.standard_normal(force.shape)
    rates = groups.gradients(velocity)
    work = sum(
        stress[:, c] * (rates[:, a, b] if a == b else rates[:, a, b] + rates[:, b, a]) for c, (a, b) in enumerate(pairs)
    )
    assert float(np.vdot(force, velocity)) == pytest.approx(-float(np.sum(work)), rel=1e-7)
    x = groups.stencils.positions
    torque = x.T @ force
    assert np.abs(force.sum(axis=0)).max() < 1e-13 * np.abs(force).sum()
    assert np.abs(torque - torque.T).max() < 1e-13 * np.abs(x).max() * np.abs(force).sum()
