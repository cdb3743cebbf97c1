"""Points are found in their cells, in solids, on surfaces and on lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from femdeform.scene.mesh_schema import BlockMesh
from femdeform.scene.point_location import locate_point
from femdeform.types import Mesh
from meshes.build import build_mesh


def block(*cells: int) -> Mesh:
    size = [1.0] * len(cells)
    return build_mesh(BlockMesh.model_validate({"recipe": "block", "size": size, "cells": list(cells)}), Path())


@pytest.mark.parametrize("mesh", [block(3, 4), block(3, 2, 4)], ids=["2D", "3D"])
def test_every_point_inside_is_the_mean_of_its_corners(mesh: Mesh) -> None:
    for point in np.random.default_rng(0).uniform(0.0, 1.0, (50, mesh.dim)):
        found = locate_point(mesh, point)
        assert found is not None
        assert found.barycentric.min() >= 0.0
        assert found.barycentric.sum() == pytest.approx(1.0)
        np.testing.assert_allclose(found.barycentric @ mesh.points[mesh.cells[found.cell]], point, atol=1e-12)


def test_points_on_the_border_belong_and_points_outside_do_not() -> None:
    mesh = block(3, 3, 3)
    for corner in ([0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [1.0 + 1e-9, 0.5, 1.0 / 3.0]):
        assert locate_point(mesh, np.array(corner)) is not None
    assert locate_point(mesh, np.array([1.0 + 1e-4, 0.5, 0.5])) is None
    assert locate_point(mesh, np.array([7.0, 0.5, 0.5])) is None


def test_surface_and_line_in_space() -> None:
    points = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    surface = Mesh(points, np.array([[0, 1, 2]]), "triangle")
    found = locate_point(surface, np.array([0.25, 0.25, 0.25]))
    assert found is not None
    np.testing.assert_allclose(found.barycentric, [0.5, 0.25, 0.25])
    assert locate_point(surface, np.array([0.25, 0.25, 0.2])) is None
    line = Mesh(points, np.array([[0, 1], [0, 2]]), "line")
    found = locate_point(line, np.array([0.0, 0.75, 0.0]))
    assert found is not None
    assert found.cell == 1
    np.testing.assert_allclose(found.barycentric, [0.25, 0.75])
