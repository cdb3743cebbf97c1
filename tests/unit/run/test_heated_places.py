"""Where surfaces are heated, and bodies with parts cut out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from femdeform.errors import InputError
from femdeform.mpm.particles import Particles
from femdeform.mpm.surface_samples import SurfaceSamples
from femdeform.mpm.surface_sampling import SurfaceSampler
from femdeform.run.heated_places import heat_boundary, heat_source, wick_end
from femdeform.run.point_quantities import PointMeter, PointState
from femdeform.run.point_setup import make_materials, make_points
from femdeform.scene.point_body_schema import Wick
from femdeform.scene.point_schema import PointScene

CELL = 0.0625
BOX = {"kind": "box", "min": [0.25, 0.25], "max": [0.75, 0.5]}


def scene(within: dict[str, Any] | None = None, **more: Any) -> PointScene:
    heat = {"capacity": 1.0, "conductivity": 0.1, "transfer": 2.0, "ambient": 290.0, "flux": 7.0}
    if within is not None:
        heat["flux_within"] = within  # type: ignore[assignment]
    body = {"shape": BOX, "liquid": {"density": 10.0, "bulk_modulus": 100.0}, "heat": heat}
    return PointScene.model_validate(
        {
            "simulation": "material_points",
            "grid": {"cell_size": CELL, "low": [0.0, 0.0], "high": [1.0, 1.0]},
            "bodies": {"slab": {**body, **more}},
            "time": {"dt": 0.01, "end": 0.1},
            "measure": {"width": {"kind": "extent", "component": "x"}},
        }
    )


def heated(given: PointScene, points: Particles) -> tuple[SurfaceSamples, np.ndarray[Any, Any]]:
    """Samples of the surface, and which of them are heated."""
    samples = SurfaceSampler(CELL).sample(points.x, 0)
    boundary = heat_boundary(given, points, samples)
    np.testing.assert_array_equal(boundary.transfer, 2.0)
    np.testing.assert_array_equal(boundary.ambient, 290.0)
    assert callable(boundary.flux)
    flux = boundary.flux(samples.points, 0.05)
    assert set(flux) <= {0.0, 7.0}
    return samples, flux > 0.0


def test_a_box_is_heated_and_nothing_else() -> None:
    given = scene({"kind": "box", "min": [0.0, 0.0], "max": [0.5, 1.0]})
    samples, is_heated = heated(given, make_points(given, {}))
    assert 0.4 < is_heated.mean() < 0.6
    np.testing.assert_array_equal(is_heated, samples.points[:, 0] <= 0.5)


@pytest.mark.parametrize(
    ("place", "expected"),
    [
        ({"kind": "ball", "center": [0.3, 0.4], "radius": 0.1, "velocity": [1.0, 0.0]}, [0.4, 0.4, 0.1]),
        ({"kind": "ball", "center": [0.3, 0.4], "radius": 0.1}, [0.3, 0.4, 0.1]),
    ],
)
def test_a_ball_may_move(place: dict[str, Any], expected: list[float]) -> None:
    """As a source in the volume and for flux through the surface alike, at a time of 0.1 s."""
    *center, radius = expected
    heat = {"capacity": 1.0, "conductivity": 0.1, "source": 3.0, "source_within": place}
    given = scene(None, heat=heat)
    points = make_points(given, {})
    values = heat_source(given, points)
    assert callable(values)
    inside = ((points.x - center) ** 2).sum(axis=1) <= radius**2
    assert 10 < inside.sum() < points.n
    np.testing.assert_array_equal(values(points.x, 0.1), np.where(inside, 3.0, 0.0))


def test_a_source_begins_and_ends() -> None:
    heat = {"capacity": 1.0, "conductivity": 0.1, "source": 3.0, "source_start": 0.02, "source_end": 0.04}
    given = scene(None, heat=heat)
    points = make_points(given, {})
    values = heat_source(given, points)
    assert callable(values)
    means = [float(np.mean(values(points.x, time))) for time in (0.02, 0.03, 0.04, 0.05)]
    assert means == [0.0, 3.0, 3.0, 0.0]


def test_flux_begins_and_ends() -> None:
    heat = {"capacity": 1.0, "conductivity": 0.1, "flux": 7.0, "flux_start": 0.02, "flux_end": 0.04}
    given = scene(heat=heat)
    points = make_points(given, {})
    samples = SurfaceSampler(CELL).sample(points.x, 0)
    flux = heat_boundary(given, points, samples).flux
    assert callable(flux)
    for time, expected in ((0.02, 0.0), (0.03, 7.0), (0.04, 7.0), (0.041, 0.0)):
        np.testing.assert_array_equal(flux(samples.points, time), expected)
    with pytest.raises(ValueError, match=r"flux_end: must be later than flux_start, 0.02 \[s\], not 0.02"):
        scene(heat={**heat, "flux_end": 0.02})


def test_a_wick_burns_down_with_its_body() -> None:
    given = scene({"kind": "wick", "path": [[0.5, 0.2], [0.5, 0.4], [0.5, 0.9]], "radius": 0.1})
    points = make_points(given, {})
    ends = []
    while points.n:
        wick = given.bodies["slab"].heat.flux_within  # type: ignore[union-attr]
        assert isinstance(wick, Wick)
        end = wick_end(wick, points.x, CELL)
        assert end is not None
        # It stands out of the highest point by less than a cell.
        assert 0.0 < end[1] - points.x[:, 1].max() < CELL
        samples, is_heated = heated(given, points)
        np.testing.assert_array_equal(is_heated, np.linalg.norm(samples.points - end, axis=1) <= 0.1)
        assert is_heated.any()
        ends.append(end[1])
        points = points.take(np.flatnonzero(points.x[:, 1] < points.x[:, 1].max() - 1e-9))
    assert len(ends) > 4
    assert (np.diff(ends) < 0.0).all()


def test_a_wick_outside_of_all_bodies_heats_nothing() -> None:
    given = scene({"kind": "wick", "path": [[0.5, 0.7], [0.6, 0.9]], "radius": 0.4})
    assert not heated(given, make_points(given, {}))[1].any()


def test_a_bent_wick_follows_its_spline() -> None:
    wick = Wick.model_validate({"kind": "wick", "path": [[0.0, 0.0], [0.3, 0.3], [0.0, 0.6]], "radius": 0.1})
    end = wick_end(wick, np.array([[0.3, 0.3], [0.3, 0.35]]), 0.02)
    assert end is not None
    np.testing.assert_allclose(end, [0.29, 0.36], atol=0.02)


def test_parts_are_cut_out() -> None:
    whole, cut = scene(), scene(without=[{"kind": "sphere", "center": [0.5, 0.5], "radius": 0.1}])
    points, left = make_points(whole, {}), make_points(cut, {})
    assert left.mass.sum() == pytest.approx(points.mass.sum() - 10.0 * 0.5 * np.pi * 0.1**2, rel=0.03)
    assert (np.linalg.norm(left.x - 0.5, axis=1) >= 0.1).all()


def test_nothing_left_is_an_error() -> None:
    with pytest.raises(InputError, match="nothing is left of the body"):
        make_points(scene(without=[BOX]), {})


def test_points_outside_of_the_domain_are_an_error() -> None:
    """Also where something is cut out, which a check of the file cannot judge."""
    ball = {"kind": "sphere", "center": [0.95, 0.5], "radius": 0.1}
    dot = {"kind": "sphere", "center": [0.5, 0.5], "radius": 0.01}
    with pytest.raises(InputError, match=r"bodies\.slab\.shape: \d+ points are outside of the domain"):
        make_points(scene(shape=ball, without=[dot]), {})
    with pytest.raises(InputError, match=r"bodies\.slab\.shape: no point of the lattice is inside"):
        make_points(scene(shape={"kind": "sphere", "center": [0.5, 0.5], "radius": 1e-6}), {})


def test_extent() -> None:
    given = scene()
    value = PointMeter(given, make_materials(given)).evaluate(PointState(make_points(given, {})))["width"]
    assert value == pytest.approx(0.5 - CELL / 2)


@pytest.mark.parametrize(
    ("within", "message"),
    [
        ({"kind": "box", "min": [0.0, 0.0], "max": [-1.0, 1.0]}, "max"),
        ({"kind": "wick", "path": [[0.0, 0.0], [0.0, 0.0]], "radius": 0.1}, "consecutive points must differ"),
        ({"kind": "wick", "path": [[0.0, 0.0], [0.0, 0.0, 1.0]], "radius": 0.1}, "as many coordinates"),
    ],
)
def test_faults(within: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        scene(within)
