"""Liquid points that crowd get a lower J, and with it a pressure that parts them; momenta do not notice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from point_drop import spin

from femdeform.mpm.crowding import CROWDED, filling, uncrowded
from femdeform.mpm.explicit_laws import LOWEST_J, Liquid
from femdeform.mpm.grid import Grid
from femdeform.mpm.group_step import explicit_step
from femdeform.mpm.particles import LIQUID, SOLID, Particles

DX = 0.1
GRID = Grid(DX, "quadratic")
LAWS = {(0, LIQUID): Liquid(50.0, 0.0)}


def lattice(dim: int, spacing: float = 0.5 * DX, n: int = 12) -> Particles:
    """A block of liquid points with the volumes of half a cell an edge, as far from each other as is said."""
    axis = (np.arange(n) + 0.5) * spacing
    x = np.stack(np.meshgrid(*[axis] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    points = Particles.at(x, np.full(len(x), 0.3), np.full(len(x), (0.5 * DX) ** dim))
    points.phase[:] = LIQUID
    return points


def inside(points: Particles, layer: float = 3.0 * DX) -> np.ndarray:
    """Points whose surroundings are full."""
    low, high = points.x.min(axis=0) + layer, points.x.max(axis=0) - layer
    return np.asarray(((points.x > low) & (points.x < high)).all(axis=1))


@pytest.mark.parametrize("dim", [2, 3])
def test_a_full_lattice_fills_its_room_exactly(dim: int) -> None:
    points = lattice(dim, n=16)
    theta = filling(points, GRID.stencils(points.x))
    np.testing.assert_allclose(theta[inside(points)], 1.0, rtol=1e-13)
    assert inside(points).any()
    assert theta.max() < 1.0 + 1e-12
    assert theta.min() < 0.7


def test_solids_fill_by_their_deformation_and_are_left_alone() -> None:
    points = lattice(2, 0.35 * DX, 20)
    points.phase[::2] = SOLID
    points.J[:] = 0.9
    points.F[:] = np.diag([1.2, 0.75])
    stencils = GRID.stencils(points.x)
    assert filling(points, stencils)[inside(points)].mean() == pytest.approx(0.9 / 0.7**2, rel=0.02)
    J = uncrowded(points, stencils, 0.1)
    assert (J[::2] == 0.9).all()
    assert (J[1::2][inside(points)[1::2]] < 0.85).all()


@pytest.mark.parametrize("dim", [2, 3])
def test_only_crowded_points_are_changed(dim: int) -> None:
    loose = lattice(dim)
    assert (uncrowded(loose, GRID.stencils(loose.x), 1.0) == 1.0).all()
    crowded = lattice(dim, 0.4 * DX)
    stencils = GRID.stencils(crowded.x)
    theta, J = filling(crowded, stencils), uncrowded(crowded, stencils, 0.1)
    is_crowded = theta > CROWDED
    assert is_crowded.any()
    assert not is_crowded.all()
    np.testing.assert_allclose(J[is_crowded], 1.0 - 0.1 * (theta[is_crowded] - CROWDED), rtol=1e-14)
    assert (J[~is_crowded] == 1.0).all()
    crushed = lattice(dim, 0.1 * DX)
    assert uncrowded(crushed, GRID.stencils(crushed.x), 1.0).min() == LOWEST_J


@pytest.mark.parametrize("dim", [2, 3])
def test_crowded_points_part_and_keep_their_momenta(dim: int) -> None:
    """J says one although they have half the room: without the correction nothing ever happens."""
    start = lattice(dim, 0.5 * DX * 0.5 ** (1.0 / dim), 8)
    start.v[:] = np.random.default_rng(0).standard_normal(start.v.shape) * 1e-3
    kept = {}
    for strength in (0.0, 0.1):
        now = start
        for _ in range(60):
            if strength:
                now = replace(now, J=uncrowded(now, GRID.stencils(now.x), strength))
            now = explicit_step(now, LAWS, GRID, 4e-3).particles
        np.testing.assert_allclose(now.mass @ now.v, start.mass @ start.v, atol=1e-13 * now.mass.sum())
        np.testing.assert_allclose(spin(now, DX), spin(start, DX), atol=1e-12 * now.mass.sum() * DX)
        kept[strength] = float(filling(now, GRID.stencils(now.x)).max())
    assert kept[0.1] < 1.3
    assert kept[0.0] > 1.6
