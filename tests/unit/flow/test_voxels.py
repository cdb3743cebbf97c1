"""Voxels inside of closed surfaces."""

from __future__ import annotations

import numpy as np
import pytest

from femdeform.flow.mac_grid import MACGrid
from femdeform.flow.voxels import voxels_inside


def test_a_circle() -> None:
    grid = MACGrid((40, 30), 0.05, (-1.0, -0.75))
    angle = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    points = 0.6 * np.column_stack([np.cos(angle), np.sin(angle)])
    edges = np.column_stack([np.arange(400), np.roll(np.arange(400), -1)])
    inside = voxels_inside(grid, points, edges)
    assert inside.shape == grid.shape
    np.testing.assert_array_equal(inside, np.linalg.norm(grid.centres(), axis=-1) < 0.6)


@pytest.mark.parametrize("spacing", [0.1, 0.13])
def test_a_box_with_a_hole(spacing: float) -> None:
    """Faces at the voxels' own planes, and a second surface inside."""
    shape = tuple(int(np.ceil(2.0 / spacing)) for _ in range(3))
    grid = MACGrid(shape, spacing, (-1.0, -1.0, -1.0))
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    points = np.vstack([0.7 * corners, 0.3 * corners])
    inside = voxels_inside(grid, points, np.vstack([triangles, triangles + 8]))
    size = np.abs(grid.centres()).max(axis=-1)
    clear = (np.abs(size - 0.7) > 1e-6) & (np.abs(size - 0.3) > 1e-6)
    np.testing.assert_array_equal(inside[clear], ((size < 0.7) & (size > 0.3))[clear])


def test_a_surface_outside_of_the_grid() -> None:
    grid = MACGrid((5, 5), 0.2)
    points = np.array([[3.0, 3.0], [4.0, 3.0], [3.5, 4.0]])
    assert not voxels_inside(grid, points, np.array([[0, 1], [1, 2], [2, 0]])).any()
    whole = 20.0 * (points - [3.5, 3.3]) + 0.5
    assert voxels_inside(grid, whole, np.array([[0, 1], [1, 2], [2, 0]])).all()
