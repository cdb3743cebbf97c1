"""The camera sees the whole box, from the side one expects."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from femdeform.post.camera import VIEW_ANGLE, place_camera, vertical_axis


def projected(box: np.ndarray, dim: int, vertical: int, aspect: float) -> np.ndarray:
    """Corners of the box in the picture, where -1 to 1 is what may be filled, from top to bottom and side to side."""
    camera = place_camera(box, dim=dim, vertical=vertical, aspect=aspect)
    corners = np.array(list(product(*box.T)))
    back = camera.position - camera.focal_point
    depth = np.linalg.norm(back)
    back = back / depth
    right = np.cross(camera.up, back)
    right = right / np.linalg.norm(right)
    up = np.cross(back, right)
    relative = corners - camera.focal_point
    if camera.parallel_scale is not None:
        half = np.full(len(corners), camera.parallel_scale)
    else:
        half = (depth - relative @ back) * np.tan(np.radians(VIEW_ANGLE / 2))
    return np.stack([relative @ right / (half * aspect), relative @ up / half], axis=1)


@pytest.mark.parametrize("size", [(1.0, 0.2, 0.2), (0.2, 1, 0.2), (0.1, 0.1, 5), (1e-6, 2e-6, 1e-6), (1, 1, 0)])
@pytest.mark.parametrize("vertical", [0, 1, 2])
@pytest.mark.parametrize("aspect", [0.5, 1.5])
def test_every_corner_is_in_the_picture_and_one_touches_its_frame(
    size: tuple[float, float, float], vertical: int, aspect: float
) -> None:
    box = np.array([[5.0, -3.0, 1.0], np.add([5.0, -3.0, 1.0], size)])
    seen = projected(box, 3, vertical, aspect)
    assert np.abs(seen).max() == pytest.approx(1.0, rel=1e-6)


def test_2d_scenes_are_seen_from_above() -> None:
    box = np.array([[0.0, 0.0, 0.0], [4.0, 1.0, 0.0]])
    camera = place_camera(box, dim=2, vertical=1, aspect=2.0)
    assert camera.parallel_scale == pytest.approx(1.0)
    np.testing.assert_allclose(camera.position - camera.focal_point, [0, 0, 2 * np.sqrt(17.0)])
    seen = projected(box, 2, 1, 2.0)
    assert np.abs(seen[:, 0]).max() == pytest.approx(1.0)
    assert seen[-1, 0] > 0 > seen[0, 0]  # x runs to the right


@pytest.mark.parametrize("vertical", [0, 1, 2])
def test_the_longer_side_runs_across(vertical: int) -> None:
    for long in {0, 1, 2} - {vertical}:
        size = np.full(3, 0.2)
        size[long] = 1.0
        seen = projected(np.stack([np.zeros(3), size]), 3, vertical, 1.5)
        assert np.ptp(seen[:, 0]) > np.ptp(seen[:, 1])


def test_a_single_point_is_no_division_by_zero() -> None:
    for dim in (2, 3):
        camera = place_camera(np.zeros((2, 3)), dim=dim, vertical=1, aspect=1.5)
        assert np.all(np.isfinite(camera.position))
        assert np.linalg.norm(camera.position) > 0


@pytest.mark.parametrize(
    ("resolved", "axis"),
    [
        ({}, 1),
        ({"gravity": [0.0, -9.81, 0.0]}, 1),
        ({"gravity": [0, 0, -9.81]}, 2),
        ({"gravity": [0, 0, 0], "obstacles": [{"kind": "sphere"}, {"kind": "plane", "normal": [0, 0, 1]}]}, 2),
        ({"gravity": [0.0, -9.81]}, 1),
        ({"gravity": None, "obstacles": None}, 1),
    ],
)
def test_up_is_against_gravity(resolved: dict[str, object], axis: int) -> None:
    assert vertical_axis(resolved) == axis
