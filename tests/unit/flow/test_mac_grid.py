"""Advection, projection and smoke on a staggered grid, against flows that are known."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from femdeform.flow.mac_grid import MACGrid
from femdeform.flow.pressure_system import AIR, FLUID, SOLID, PressureSystem
from femdeform.flow.smoke import LARGEST_COURANT, MovingSolid, SmokeFlow, Source
from femdeform.jit import set_threads
from femdeform.types import FloatArray
from solvers.linear.poisson.conjugate_gradients import ConjugateGradients
from solvers.linear.poisson.multigrid import Multigrid


def multigrid(system: PressureSystem) -> ConjugateGradients:
    return ConjugateGradients(system, Multigrid(system))


def set_velocity(grid: MACGrid, flow: object) -> None:
    """Give the faces the velocity of a function of points (..., dim)."""
    for axis in range(grid.dim):
        grid.velocity[axis][...] = flow(grid.face_centres(axis))[..., axis]  # type: ignore[operator]


def rigid_turn(points: FloatArray) -> FloatArray:
    """One radian a second about (0.5, 0.5)."""
    out = np.zeros_like(points)
    out[..., 0], out[..., 1] = 0.5 - points[..., 1], points[..., 0] - 0.5
    return out


# -------------------------------------------------------------------------------------------------- the grid


def test_places_of_faces_and_centres() -> None:
    grid = MACGrid((3, 2), 0.5, (1.0, 2.0))
    assert grid.shape == (3, 2, 1)
    np.testing.assert_allclose(grid.centres()[1, 0, 0], [1.75, 2.25])
    np.testing.assert_allclose(grid.face_centres(0)[3, 1, 0], [2.5, 2.75])
    np.testing.assert_allclose(grid.face_centres(1)[0, 2, 0], [1.25, 3.0])
    assert [component.shape for component in grid.velocity] == [(4, 2, 1), (3, 3, 1), (3, 2, 2)]
    for shape, spacing in (((3,), 1.0), ((3, 3), 0.0), ((3, 0), 1.0)):
        with pytest.raises(ValueError, match="a grid has"):
            MACGrid(shape, spacing)


# -------------------------------------------------------------------------------------------------- advection


@pytest.mark.parametrize("dim", [2, 3])
def test_a_uniform_flow_carries_by_whole_voxels_exactly(dim: int) -> None:
    grid = MACGrid([12] * dim, 0.1)
    for axis, speed in zip(range(dim), (2.0, -1.0, 1.0), strict=False):
        grid.velocity[axis][...] = speed
    density = np.zeros(grid.shape)
    density[5, 6, 4 if dim == 3 else 0] = 1.0
    moved = grid.carry(density, np.zeros(grid.shape, dtype=bool), 0.1)
    assert moved[7, 5, 5 if dim == 3 else 0] == pytest.approx(1.0, abs=1e-12)
    assert moved.sum() == pytest.approx(1.0, abs=1e-12)
    before = [component.copy() for component in grid.velocity]
    grid.advect(0.1)
    for axis in range(dim):
        np.testing.assert_allclose(grid.velocity[axis], before[axis], atol=1e-14)


def test_a_linear_field_in_a_turning_flow() -> None:
    """Interpolation is exact for both, so what is left is the midpoint rule: third order in the step."""
    errors = []
    for dt in (0.2, 0.1):
        grid = MACGrid((40, 40), 1.0 / 40)
        set_velocity(grid, rigid_turn)
        x = grid.centres()[..., 0]
        moved = grid.carry(x, np.zeros(grid.shape, dtype=bool), dt)
        points = grid.centres() - 0.5
        exact = 0.5 + np.cos(dt) * points[..., 0] + np.sin(dt) * points[..., 1]
        errors.append(np.abs(moved - exact)[10:30, 10:30].max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(3.0, abs=0.1)


def test_solids_lend_no_smoke() -> None:
    """Beside a solid the values outside of it count alone: a constant stays one."""
    grid = MACGrid((10, 10), 0.1)
    grid.velocity[0][...] = 0.37
    solid = np.zeros(grid.shape, dtype=bool)
    solid[4:6, 4:6] = True
    density = np.where(solid, 0.0, 3.0)
    moved = grid.carry(density, solid, 0.1)
    np.testing.assert_allclose(moved, density, atol=1e-13)


# -------------------------------------------------------------------------------------------------- projection


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("is_open", [False, True])
def test_projection_to_rounding(dim: int, is_open: bool) -> None:
    """No divergence is left, and what is taken away is a gradient: it does no work on flow without divergence."""
    grid = MACGrid([16] * dim, 0.25)
    labels = np.full([16] * dim, FLUID, dtype=np.uint8)
    labels[4:7, 5:9] = SOLID
    if is_open:
        labels[:, -1] = AIR
    system = PressureSystem(labels)
    rng = np.random.default_rng(0)
    for axis in range(dim):
        grid.velocity[axis][...] = rng.standard_normal(grid.velocity[axis].shape)
    grid.hold_at_solids(system)
    before = [component.copy() for component in grid.velocity]
    report = grid.project(system, multigrid(system), 1e-13, 100)
    assert report.converged, report.reason
    assert report.divergence_before > 1.0
    assert report.divergence_after < 1e-11 * report.divergence_before
    assert report.imbalance < 1e-13 * report.divergence_before
    work = sum(float(np.sum((old - new) * new)) for old, new in zip(before, grid.velocity, strict=True))
    assert abs(work) < 1e-10 * sum(float(np.sum(old**2)) for old in before) or is_open
    # Walls and solids stay at rest, and a second projection changes nothing.
    assert np.all(grid.velocity[0][4:8, 5:9] == 0.0)
    assert np.all(grid.velocity[0][[0, -1]] == 0.0)
    again = [component.copy() for component in grid.velocity]
    grid.project(system, multigrid(system), 1e-8, 100)
    for old, new in zip(again, grid.velocity, strict=True):
        np.testing.assert_allclose(new, old, atol=1e-12)


def test_an_inlet_without_an_outlet_is_reported() -> None:
    grid = MACGrid((8, 8), 0.5)
    system = PressureSystem(np.full((8, 8), FLUID, dtype=np.uint8))
    grid.velocity[0][0, 3:5] = 2.0
    report = grid.project(system, multigrid(system), 1e-12, 100)
    assert report.converged
    assert report.imbalance == pytest.approx(2 * 2.0 * 0.5 / (64 * 0.25))
    assert report.divergence_after == pytest.approx(report.imbalance, rel=1e-8)


def energy_lost(n: int, n_steps: int) -> float:
    """Part of their energy that vortices which should stay lose in 0.16 s, in n^2 voxels of a square of 1 m."""

    def vortices(points: FloatArray) -> FloatArray:
        x, y = 2.0 * np.pi * points[..., 0], 2.0 * np.pi * points[..., 1]
        return np.stack([np.sin(x) * np.cos(y), -np.cos(x) * np.sin(y)], axis=-1)

    grid = MACGrid((n, n), 1.0 / n)
    system = PressureSystem(np.full((n, n), FLUID, dtype=np.uint8))
    solver = multigrid(system)
    set_velocity(grid, vortices)
    energy = sum(float(np.sum(component**2)) for component in grid.velocity)
    for _ in range(n_steps):
        grid.advect(0.16 / n_steps)
        grid.hold_at_solids(system)
        grid.project(system, solver, 1e-10, 100)
    return 1.0 - sum(float(np.sum(component**2)) for component in grid.velocity) / energy


def test_taylor_green_vortices_lose_less_on_finer_grids() -> None:
    """With dt = 0.64 h step and voxel are of order h, and so is the loss."""
    losses = [energy_lost(n, n // 4) for n in (16, 32, 64)]
    assert all(loss > 0.0 for loss in losses)
    assert np.log2(losses[0] / losses[1]) == pytest.approx(1.0, abs=0.2)
    assert np.log2(losses[1] / losses[2]) == pytest.approx(1.0, abs=0.2)


def test_what_taylor_green_vortices_lose_is_of_second_order_in_the_voxel() -> None:
    """With one step for all grids: each adds an error of interpolation of h^2."""
    losses = [energy_lost(n, 2) for n in (32, 64, 128)]
    assert losses[0] > losses[1] > losses[2] > 0.0
    assert np.log2((losses[0] - losses[1]) / (losses[1] - losses[2])) == pytest.approx(2.0, abs=0.1)


def test_what_taylor_green_vortices_lose_is_of_first_order_in_the_step() -> None:
    """With the part of h^2 taken away by extrapolation from two grids."""
    limits = [(4.0 * energy_lost(128, steps) - energy_lost(64, steps)) / 3.0 for steps in (2, 4, 8)]
    for coarse, fine in itertools.pairwise(limits):
        assert np.log2(coarse / fine) == pytest.approx(1.0, abs=0.15)


def test_steps_far_shorter_than_a_voxel_do_not_pay() -> None:
    """Interpolation is done once a step: on one grid more steps than it takes to cross a voxel lose no less."""
    assert energy_lost(64, 32) > energy_lost(64, 16)


# -------------------------------------------------------------------------------------------------- smoke


def plume(n: int = 24, is_open: bool = False, **more: object) -> SmokeFlow:
    grid = MACGrid((n, n), 1.0 / n)
    centres = grid.centres()
    source = (centres[..., 0] - 0.5) ** 2 + (centres[..., 1] - 0.1) ** 2 < 0.1**2
    air = np.zeros(grid.shape, dtype=bool)
    air[:, -1] = is_open
    flow = SmokeFlow(grid, np.zeros(grid.shape, dtype=bool), air, multigrid, sources=[Source(source)], tolerance=1e-8)
    for name, value in more.items():
        setattr(flow, name, value)
    return flow


@pytest.mark.parametrize("is_open", [False, True])
def test_smoke_rises_and_stays_between_its_bounds(is_open: bool) -> None:
    flow = plume(is_open=is_open)
    heights = []
    for _ in range(15):
        for report in flow.step(0.05):
            assert report.converged
            assert report.divergence_after < 1e-6 * max(1.0, report.divergence_before)
        heights.append(float(np.sum(flow.density * flow.grid.centres()[..., 1]) / np.sum(flow.density)))
    assert heights[-1] > heights[0] + 0.05
    assert flow.density.min() >= 0.0
    assert flow.density.max() <= 1.0
    # The scene is symmetric, and so is what becomes of it.
    np.testing.assert_allclose(flow.density, flow.density[::-1], atol=1e-6)
    assert flow.time == pytest.approx(0.75)


def test_fast_flow_is_taken_in_parts() -> None:
    flow = plume()
    flow.grid.velocity[0][...] = 4.0
    assert flow.n_substeps(0.05) == int(np.ceil(0.05 * 4.0 * 24 / LARGEST_COURANT))
    assert len(flow.step(0.05)) == flow.n_substeps(0.0) * 2


def test_a_source_may_blow() -> None:
    """The faces around its voxels get its velocity before the projection."""
    flow = plume(buoyancy=0.0)
    (source,) = flow.sources
    flow.sources = [Source(source.voxels, velocity=(0.0, 0.5))]
    flow._apply(flow.sources[0], flow.is_solid)
    v = flow.grid.velocity[1]
    blown = np.zeros(v.shape, dtype=bool)
    blown[:, :-1] |= source.voxels
    blown[:, 1:] |= source.voxels
    np.testing.assert_array_equal(v, np.where(blown, 0.5, 0.0))
    assert np.all(flow.grid.velocity[0] == 0.0)
    flow.step(0.02)
    assert flow.grid.largest_speed() > 0.1


def test_a_turning_solid_drags_the_fluid() -> None:
    def voxels(time: float) -> np.ndarray:
        points = flow.grid.centres() - 0.5
        c, s = np.cos(2.0 * time), np.sin(2.0 * time)
        along, across = c * points[..., 0] + s * points[..., 1], -s * points[..., 0] + c * points[..., 1]
        return np.asarray((np.abs(along) < 0.2) & (np.abs(across) < 0.1))

    flow = plume(buoyancy=0.0)
    flow.moving = [MovingSolid(voxels, lambda time, points: 2.0 * rigid_turn(points))]
    for _ in range(5):
        (report,) = flow.step(0.05)
        assert report.converged
        assert report.imbalance < 1e-12
        assert report.divergence_after < 1e-6 * report.divergence_before
    centres = flow.grid.centres() - 0.5
    u = 0.5 * (flow.grid.velocity[0][1:] + flow.grid.velocity[0][:-1])
    v = 0.5 * (flow.grid.velocity[1][:, 1:] + flow.grid.velocity[1][:, :-1])
    spin = centres[..., 0] * v - centres[..., 1] * u
    assert spin[~flow.is_solid].sum() > 0.0
    assert not np.array_equal(voxels(0.0), voxels(flow.time))


def test_threads_do_not_matter() -> None:
    found = []
    for threads in (1, 2):
        set_threads(threads)
        flow = plume()
        for _ in range(4):
            flow.step(0.05)
        found.append(flow.density)
    set_threads()
    assert np.array_equal(found[0], found[1])
