"""Points with samples that move with the grid where they are, as their J sees it; momenta are kept all the same."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from point_drop import spin, turning

from femdeform.mpm.explicit_laws import Liquid
from femdeform.mpm.grid import Grid
from femdeform.mpm.group_step import Motion, advance
from femdeform.mpm.groups import Groups
from femdeform.mpm.particles import LIQUID, Particles
from femdeform.mpm.surface_samples import SurfaceSamples

Array = NDArray[np.float64]
DX = 0.1
GRID = Grid(DX, "quadratic")
MOTIONS: tuple[Motion, ...] = ("field", "group")
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
    """Both motions are the same then, and J is the volume of the points' image, not 1 + dt tr L."""
    points, samples = drop(dim, clustered)
    L = np.random.default_rng(1).standard_normal((dim, dim))
    turn = np.eye(dim) + 0.05 * L
    groups = Groups.split(points.x, points.mass, samples, GRID)
    for motion in MOTIONS:
        after, n_bounded = advance(points, LAWS, groups, groups.stencils.positions @ L.T, 0.05, motion=motion)
        assert n_bounded == 0
        np.testing.assert_allclose(after.J, points.J * np.linalg.det(turn), rtol=1e-7)
        np.testing.assert_allclose(after.x, points.x @ turn.T, atol=1e-13)
    assert abs(np.linalg.det(turn) - 1.0 - 0.05 * np.trace(L)) > 1e-4


@pytest.mark.parametrize("clustered", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_points_move_with_the_grid_where_they_are(dim: int, clustered: bool) -> None:
    """Up to one velocity of all; what J sees is the gradient of that motion. The mean of a group is another one."""
    points, samples = drop(dim, clustered)
    groups = Groups.split(points.x, points.mass, samples, GRID)
    velocity = np.random.default_rng(3).standard_normal(groups.stencils.positions.shape)
    v, affine = groups.to_points(velocity)
    dt = 0.01
    x, _ = groups.displaced(velocity, v, affine, dt)
    here = groups.stencils.to_points(velocity)[: points.n]
    common = (x - points.x) / dt - here
    np.testing.assert_allclose(common, np.broadcast_to(common[0], common.shape), atol=1e-12)
    np.testing.assert_allclose(points.mass @ x, points.mass @ (points.x + dt * v), atol=1e-13)
    alone = groups.sizes == 1
    np.testing.assert_allclose(v[alone], here[alone], atol=1e-13)
    assert np.abs(v - here)[~alone].max() > 0.1


@pytest.mark.parametrize("clustered", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_momenta_of_the_nodes_are_those_of_the_points(dim: int, clustered: bool) -> None:
    points, samples = drop(dim, clustered)
    groups = Groups.split(points.x, points.mass, samples, GRID)
    nodes = groups.stencils.positions
    rng = np.random.default_rng(4)
    velocity = rng.standard_normal(nodes.shape) + 3.0
    mass, _ = groups.to_grid(points.v, points.affine)
    before = turning(nodes, mass[:, None] * velocity)
    after, _ = advance(points, LAWS, groups, velocity, 0.01, motion="field")
    scale = np.abs(before).max()
    np.testing.assert_allclose(spin(after, DX), before, atol=1e-13 * scale)
    np.testing.assert_allclose(after.mass @ after.v, mass @ velocity, rtol=1e-13)
    # Shifted points without what they take along have another angular momentum.
    after.affine[:] = groups.to_points(velocity)[1]
    assert np.abs(spin(after, DX) - before).max() > 1e-5 * scale
    # A velocity that all have in common turns nothing.
    common = rng.standard_normal(dim) * 10.0
    faster, _ = advance(points, LAWS, groups, velocity + common, 0.01, motion="field")
    slower, _ = advance(points, LAWS, groups, velocity, 0.01, motion="field")
    np.testing.assert_allclose(faster.x, slower.x + 0.01 * common, atol=1e-13)
    np.testing.assert_allclose(faster.affine, slower.affine, atol=1e-11 / DX)


def test_without_samples_both_motions_are_the_same_to_the_bit() -> None:
    points, _ = drop(2, True)
    groups = Groups.split(points.x, points.mass, None, GRID)
    velocity = np.random.default_rng(5).standard_normal(groups.stencils.positions.shape)
    field, group = (advance(points, LAWS, groups, velocity, 0.01, motion=name)[0] for name in MOTIONS)
    np.testing.assert_array_equal(field.x, group.x)
    np.testing.assert_array_equal(field.affine, group.affine)
