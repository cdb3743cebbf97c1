"""Light in smoke: against what can be worked out, and pictures of it."""

from __future__ import annotations

import numpy as np
import pytest

from femdeform.post.smoke_rays import DENSITY, INSIDE, LIGHT, light_voxels, trace

N = 20
UP = np.array([0.0, 1.0, 0.0])
COLOURS = np.array([[0.8, 0.6, 0.4], [0.1, 0.2, 0.3], [0.5, 0.5, 0.5], [0.1, 0.1, 0.1]])
LOW, HIGH = np.full(3, -0.5), np.full(3, N - 0.5)


def look(voxels: np.ndarray, thickness: float, x: float = 9.5, y: float = 9.5) -> tuple[np.ndarray, bool]:
    """What a ray along z picks up."""
    seen, hit = np.zeros((1, 4), dtype=np.float32), np.zeros(1, dtype=np.bool_)
    ray, eye = np.array([[0.0, 0.0, -1.0]]), np.array([x, y, 60.0])
    trace(voxels, eye, ray, LOW, HIGH, thickness, UP, COLOURS, seen, hit)
    return seen[0], bool(hit[0])


def test_light_falls_off_with_the_smoke_above() -> None:
    voxels = np.zeros((N, N, N, 3), dtype=np.float32)
    voxels[..., DENSITY] = 0.5
    light_voxels(voxels, UP, 0.2)
    # Voxels above each one, 0.1 of optical thickness each.
    expected = np.exp(-0.1 * np.arange(N - 1, -1, -1))
    np.testing.assert_allclose(voxels[5, :, 7, LIGHT], expected, rtol=0.02)
    light_voxels(voxels, np.array([1.0, 0.0, 0.0]), 0.2)
    np.testing.assert_allclose(voxels[:, 3, 7, LIGHT], expected, rtol=0.02)


@pytest.mark.parametrize("thickness", [0.01, 0.1, 0.3])
def test_what_is_seen_through_even_smoke(thickness: float) -> None:
    voxels = np.zeros((N, N, N, 3), dtype=np.float32)
    voxels[..., DENSITY] = 1.0
    voxels[..., LIGHT] = 0.5
    seen, hit = look(voxels, thickness)
    left = np.exp(-thickness * N)
    assert not hit
    assert seen[3] == pytest.approx(left, abs=0.005)
    np.testing.assert_allclose(seen[:3], (1.0 - seen[3]) * (0.5 * COLOURS[0] + COLOURS[1]), rtol=1e-5)


def test_without_smoke_or_beside_the_box_all_behind_is_seen() -> None:
    voxels = np.zeros((N, N, N, 3), dtype=np.float32)
    np.testing.assert_array_equal(look(voxels, 0.5)[0], [0.0, 0.0, 0.0, 1.0])
    voxels[..., DENSITY] = 1.0
    np.testing.assert_array_equal(look(voxels, 0.5, x=25.0)[0], [0.0, 0.0, 0.0, 1.0])


def test_a_solid_ends_the_ray_and_casts_a_shadow() -> None:
    voxels = np.zeros((N, N, N, 3), dtype=np.float32)
    voxels[6:14, 8:12, 6:14, INSIDE] = 1.0
    light_voxels(voxels, UP, 0.1)
    assert voxels[10, 15, 10, LIGHT] == pytest.approx(1.0)
    assert voxels[10, 3, 10, LIGHT] < 0.02
    assert voxels[2, 3, 10, LIGHT] == pytest.approx(1.0)
    seen, hit = look(voxels, 0.1)
    assert hit
    # Seen from the front, lit from above: the light from everywhere alone.
    np.testing.assert_allclose(seen, [0.1, 0.1, 0.1, 0.0], atol=0.02)
    assert not look(voxels, 0.1, y=16.0)[1]


def test_smoke_before_a_solid_hides_it() -> None:
    voxels = np.zeros((N, N, N, 3), dtype=np.float32)
    voxels[..., :6, INSIDE] = 1.0
    voxels[..., 10:, DENSITY] = 1.0
    voxels[..., LIGHT] = 1.0
    thin, thick = look(voxels, 0.02)[0], look(voxels, 1.0)[0]
    assert look(voxels, 0.02)[1]
    np.testing.assert_allclose(thick[:3], COLOURS[0] + COLOURS[1], rtol=0.02)
    assert np.abs(thin[:3] - thick[:3]).max() > 0.3
