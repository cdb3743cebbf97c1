"""Areas of shapes over those of the contours around their points."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from femdeform.run.hull_areas import area_scales
from femdeform.run.point_setup import make_points
from femdeform.scene.point_schema import PointScene

CELL = 1.0 / 64


def scene(*shapes: dict[str, Any], cell: float = CELL, **more: Any) -> PointScene:
    dim = len(shapes[0].get("center", shapes[0].get("min", [0, 0])))
    body = {"points_per_axis": 3, "liquid": {"density": 1.0, "bulk_modulus": 1.0}}
    heat = {"capacity": 1.0, "conductivity": 1.0, "transfer": 1.0}
    return PointScene.model_validate(
        {
            "simulation": "material_points",
            "grid": {"cell_size": cell, "low": [0.0] * dim, "high": [1.0] * dim},
            "bodies": {f"b{k}": {"shape": shape, "heat": heat, **body} for k, shape in enumerate(shapes)},
            "time": {"dt": 0.01, "end": 0.1},
            **more,
        }
    )


def scales(given: PointScene) -> list[float]:
    return [float(each) for each in area_scales(given, {}, make_points(given, {}))]


def disc(radius: float, x: float = 0.5) -> dict[str, Any]:
    return {"kind": "sphere", "center": [x, 0.5], "radius": radius}


@pytest.mark.parametrize("radius", [0.1, 0.15, 0.2, 0.3])
def test_of_a_disc(radius: float) -> None:
    """The contour is a circle whose radius is larger by 0.56 cells less its ripple and the lattice, 0.4 to 0.7."""
    (found,) = scales(scene(disc(radius)))
    assert 0.4 < (radius / found - radius) / CELL < 0.75


def test_of_the_verified_scenes() -> None:
    """Factors that were set by hand: the circle over the mean of many contours."""
    assert scales(scene(disc(0.2)))[0] == pytest.approx(0.9547, abs=1e-4)
    square = {"kind": "box", "min": [0.296875] * 2, "max": [0.703125] * 2}
    assert scales(scene(square))[0] == pytest.approx(0.9723, abs=1e-4)


def test_of_a_ball_and_an_ellipsoid() -> None:
    ball = {"kind": "sphere", "center": [0.5] * 3, "radius": 0.25}
    (found,) = scales(scene(ball, cell=1 / 32))
    assert 0.45 < 32 * (0.25 / np.sqrt(found) - 0.25) < 0.8
    # An ellipsoid that is a ball has the area of one; a long one that of a revolved ellipse.
    same = {"kind": "ellipsoid", "center": [0.5] * 3, "semi_axes": [0.25] * 3}
    assert scales(scene(same, cell=1 / 32))[0] == pytest.approx(found, rel=1e-6)
    a, c = 0.15, 0.4
    e = np.sqrt(1.0 - (a / c) ** 2)
    area = 2.0 * np.pi * a**2 * (1.0 + c / (a * e) * np.arcsin(e))
    long = scene({"kind": "ellipsoid", "center": [0.5] * 3, "semi_axes": [a, c, a]}, cell=1 / 32)
    from femdeform.run.hull_areas import _contour

    points = make_points(long, {})
    assert scales(long)[0] == pytest.approx(area / _contour(long, points.x), rel=1e-9)


def test_of_an_ellipse() -> None:
    """Its length: that of a fine polygon."""
    t = np.linspace(0.0, 2.0 * np.pi, 200001)
    length = np.hypot(np.diff(0.3 * np.cos(t)), np.diff(0.1 * np.sin(t))).sum()
    from femdeform.run.hull_areas import _hull

    given = scene({"kind": "ellipsoid", "center": [0.5] * 2, "semi_axes": [0.1, 0.3]})
    assert _hull(given.bodies["b0"].shape, None) == pytest.approx(length, rel=1e-8)


def test_bodies_have_their_own() -> None:
    alone = [scales(scene(disc(0.1, 0.25)))[0], scales(scene(disc(0.2, 0.7)))[0]]
    assert scales(scene(disc(0.1, 0.25), disc(0.2, 0.7))) == pytest.approx(alone)
    assert alone[0] < alone[1] - 0.02


def test_where_it_is_not_known() -> None:
    touching = scene(disc(0.15, 0.3), disc(0.15, 0.6))
    assert scales(touching) == [1.0, 1.0]
    cut = scene(disc(0.2)).model_dump()
    cut["bodies"]["b0"]["without"] = [disc(0.1)]
    assert scales(PointScene.model_validate(cut)) == [1.0]
    assert scales(scene(disc(0.2), heat={"area_scale": 0.9})) == [0.9]
