"""Inlets: what they drive in, what leaves, and what advection takes from beyond them."""

from __future__ import annotations

import numpy as np
import pytest

from femdeform.errors import NotConvergedError
from femdeform.flow.inlets import Inlet, surrounded
from femdeform.flow.mac_grid import MACGrid
from femdeform.flow.pressure_system import PressureSystem
from femdeform.flow.smoke import MOST_PARTS, MovingSolid, SmokeFlow, Source
from femdeform.types import FloatArray
from solvers.linear.poisson.conjugate_gradients import ConjugateGradients
from solvers.linear.poisson.multigrid import Multigrid

SPEED = 0.7


def multigrid(system: PressureSystem) -> ConjugateGradients:
    return ConjugateGradients(system, Multigrid(system))


def channel(cells: tuple[int, ...], *inlets: Inlet, **more: object) -> SmokeFlow:
    """A box of voxels of 0.1 m, open at the right, without buoyancy."""
    grid = MACGrid(cells, 0.1)
    air = np.zeros(grid.shape, dtype=bool)
    air[-1] = True
    solid = more.pop("solid", np.zeros(grid.shape, dtype=bool))
    options = {"buoyancy": 0.0, "inlets": inlets, "tolerance": 1e-10, **more}
    return SmokeFlow(grid, solid, air, multigrid, **options)  # type: ignore[arg-type]


def left(cells: tuple[int, ...], density: float = 1.0, velocity: tuple[float, ...] | None = None) -> Inlet:
    """The whole left side."""
    faces = np.ones((*cells[1:], 1)[:2], dtype=bool)
    return Inlet(0, 0, faces, velocity or (SPEED, 0.0, 0.0)[: len(cells)], density)


def flux_in(flow: SmokeFlow) -> float:
    """Through the left side [voxel faces m/s]."""
    return float(flow.grid.velocity[0][0].sum())


def flux_out(flow: SmokeFlow) -> float:
    """Through the faces between the last fluid and the air of the right side [voxel faces m/s]."""
    return float(flow.grid.velocity[0][-2].sum())


@pytest.mark.parametrize("cells", [(16, 8), (12, 6, 5)], ids=str)
def test_plug_flow_through_a_channel(cells: tuple[int, ...]) -> None:
    """Between slip walls the flow is that of the inlet, everywhere, and stays so to rounding."""
    flow = channel(cells, left(cells))
    for _ in range(3):
        (report,) = flow.step(0.05)
        assert report.converged
    # The outermost faces, beyond the air of the open side, are of the grid's end.
    np.testing.assert_allclose(flow.grid.velocity[0][:-1], SPEED, atol=1e-7)
    assert flux_out(flow) == pytest.approx(flux_in(flow), rel=1e-8)
    flow.grid.velocity[0][...] = SPEED
    for component in flow.grid.velocity[1:]:
        component[...] = 0.0
    for _ in range(20):
        flow.step(0.05)
    np.testing.assert_allclose(flow.grid.velocity[0][:-1], SPEED, rtol=1e-13)
    for component in flow.grid.velocity[1:]:
        np.testing.assert_allclose(component, 0.0, atol=1e-13)
    assert flux_out(flow) == pytest.approx(flux_in(flow), rel=1e-13)


@pytest.mark.parametrize("courant", [0.2, 1.0, 2.5])
def test_smoke_enters_with_the_flow(courant: float) -> None:
    """As much as the inlet brings: its density times its flux, up to what linear interpolation makes of a front."""
    cells = (60, 4)
    flow = channel(cells, left(cells, 0.8))
    flow.grid.velocity[0][...] = SPEED
    dt = courant * 0.1 / SPEED
    n = int(30 / courant)
    for _ in range(n):
        assert len(flow.step(dt)) == 1
    smoke = float(flow.density.sum()) * 0.1**2
    assert smoke == pytest.approx(0.8 * SPEED * n * dt * 0.4, rel=0.03)
    assert flow.density.min() >= 0.0
    assert flow.density.max() <= 0.8 + 1e-12
    np.testing.assert_allclose(flow.density[:10], 0.8, rtol=1e-3)
    assert float(flow.density[50:].max()) < 1e-3


def test_an_oblique_inlet_brings_its_velocity_along_the_side() -> None:
    cells = (16, 16)
    slanted = (SPEED, 0.2 * SPEED)
    flow = channel(cells, left(cells, velocity=slanted))
    flow.grid.velocity[0][...] = SPEED
    flow.grid.advect(0.1, flow.inlets)
    v = flow.grid.velocity[1][:, :, 0]
    # 0.7 voxels have come in: the first faces, half a voxel behind the side, hold what was beyond it.
    np.testing.assert_allclose(v[0], slanted[1], rtol=1e-12)
    assert np.all(v[1:] == 0.0)


def test_what_lies_beyond_an_inlet() -> None:
    """Halfway between the layer and the first values is what the inlet gives; beside it, and at its rim, no jump."""
    values = np.arange(12.0).reshape(4, 3, 1)
    faces = np.array([[True], [True], [False]])
    around = surrounded(values, 2, None, [Inlet(0, 0, faces, (1.0, 0.0), 9.0)])
    assert around.shape == (6, 5, 1)
    np.testing.assert_allclose(0.5 * (around[0, 1:-1] + values[0])[:, 0], [9.0, 9.0, values[0, 2, 0]])
    np.testing.assert_array_equal(around[0, 0], around[0, 1])
    np.testing.assert_array_equal(around[1:-1, 1:-1], values)
    # Where fluid is drawn out nothing comes from beyond.
    drawn = surrounded(values, 2, None, [Inlet(0, 0, faces, (-1.0, 0.0), 9.0)])
    np.testing.assert_array_equal(drawn, np.pad(values, [(1, 1), (1, 1), (0, 0)], mode="edge"))


@pytest.mark.parametrize("cells", [(40, 20), (16, 10, 10)], ids=str)
def test_flow_around_an_obstacle_balances(cells: tuple[int, ...]) -> None:
    """What comes in leaves, without divergence, and the inlet keeps its velocity. A part of it lies behind a solid."""
    solid = np.zeros((*cells, 1)[:3], dtype=bool)
    solid[6:9, 3:6] = True
    solid[0, :2] = True
    flow = channel(cells, left(cells), solid=solid)
    for _ in range(30):
        for report in flow.step(0.1):
            assert report.converged
            assert report.imbalance == 0.0
            assert report.divergence_after < 1e-7 * SPEED / 0.1
    u = flow.grid.velocity[0][0]
    assert np.all(u[:2] == 0.0)
    assert np.all(u[2:] == SPEED)
    assert flux_out(flow) == pytest.approx(flux_in(flow), rel=1e-8)
    assert np.all(flow.grid.velocity[0][6:10, 3:6] == 0.0)
    # It goes faster beside the obstacle than before it.
    assert flow.grid.velocity[0][7].max() > 1.1 * SPEED
    assert flow.density[15:].max() > 0.5
    assert flow.density.min() >= 0.0


def test_a_closed_box_says_how_much_is_too_much() -> None:
    """The mean divergence that an inlet forces on it; an outlet of the same flux takes it away."""
    cells = (8, 8)
    faces = np.zeros((8, 1), dtype=bool)
    faces[2:4] = True
    into = Inlet(0, 0, faces, (SPEED, 0.0), 1.0)
    out = Inlet(1, -1, faces[::-1], (0.0, SPEED))
    for inlets, imbalance in (([into], SPEED * 2 * 0.1 / (64 * 0.1**2)), ([into, out], 0.0)):
        flow = channel(cells, *inlets)
        flow.air[...] = False
        flow._take_labels()
        flow.step(0.01)
        (report,) = flow.step(0.01)
        assert report.converged
        assert report.imbalance == pytest.approx(imbalance, rel=1e-6, abs=1e-12)


# -------------------------------------------------------------------------------------------------- parts of a step


def blowing(speed: float) -> SmokeFlow:
    flow = channel((16, 16))
    voxels = np.zeros(flow.grid.shape, dtype=bool)
    voxels[4:6, 4:6] = True
    flow.sources = [Source(voxels, velocity=(speed, 0.0), end=1.0)]
    return flow


def driven(speed: float) -> SmokeFlow:
    return channel((16, 16), left((16, 16), velocity=(speed, 0.0)))


def pushed(speed: float) -> SmokeFlow:
    flow = channel((16, 16))
    voxels = np.zeros(flow.grid.shape, dtype=bool)
    voxels[4:6, 4:6] = True

    def velocity(time: float, points: FloatArray) -> FloatArray:
        return np.full_like(points, speed)

    flow.moving = [MovingSolid(lambda time: voxels, velocity)]
    return flow


@pytest.mark.parametrize(("make", "what"), [(blowing, "a source"), (driven, "an inlet"), (pushed, "a solid")])
def test_what_is_given_counts_from_the_first_step(make: object, what: str) -> None:
    """The fluid still rests, but 30 voxels would be crossed in the step: ten parts."""
    assert callable(make)
    assert make(30.0).n_substeps(0.1) == 10
    with pytest.raises(NotConvergedError, match=f"{what} moves with 1e\\+07 m/s"):
        make(1e7).step(0.1)


def test_sources_that_have_ended_and_inlets_without_faces_do_not_count() -> None:
    flow = blowing(30.0)
    flow.time = 1.0
    assert flow.n_substeps(0.1) == 1
    flow.inlets = [Inlet(0, 0, np.zeros((16, 1), dtype=bool), (30.0, 0.0))]
    assert flow.n_substeps(0.1) == 1


def test_a_flow_that_has_burst_is_refused() -> None:
    flow = channel((16, 16))
    flow.grid.velocity[1][3, 3] = np.nan
    with pytest.raises(NotConvergedError, match="the flow moves with nan"):
        flow.n_substeps(0.1)
    flow.grid.velocity[1][3, 3] = 300.0 * 0.1 / 0.1
    assert flow.n_substeps(0.1) == MOST_PARTS
    with pytest.raises(NotConvergedError, match="300 is the most, in 100 parts"):
        flow.n_substeps(0.1001)
