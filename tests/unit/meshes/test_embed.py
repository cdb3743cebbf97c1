"""Points bound to cells follow every linear motion of the body, inside and a little outside of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from femdeform.scene.mesh_schema import BlockMesh, SphereMesh, SphereSurfaceMesh
from femdeform.types import Mesh
from meshes.build import build_mesh
from meshes.embed import embed_points


def block(*cells: int) -> Mesh:
    size = [1.0] * len(cells)
    return build_mesh(BlockMesh.model_validate({"recipe": "block", "size": size, "cells": list(cells)}), Path())


@pytest.mark.parametrize("mesh", [block(4, 3), block(3, 4, 2)], ids=["2D", "3D"])
def test_points_inside_lie_in_their_cell(mesh: Mesh) -> None:
    points = np.random.default_rng(0).uniform(0.0, 1.0, (500, mesh.dim))
    bound = embed_points(mesh, points)
    assert bound.weights.min() > -1e-12
    np.testing.assert_allclose(bound.distance, 0.0, atol=1e-12)
    place = np.einsum("nk,nkj->nj", bound.weights, mesh.points[mesh.cells[bound.cells]])
    np.testing.assert_allclose(place, points, atol=1e-12)


def test_points_outside_follow_the_nearest_cell() -> None:
    mesh = block(4, 4, 4)
    points = np.array([[1.2, 0.5, 0.5], [-0.1, -0.1, 0.4], [0.3, 0.3, 1.05]])
    bound = embed_points(mesh, points)
    np.testing.assert_allclose(bound.distance, [0.2, np.sqrt(0.02), 0.05], rtol=0.2)
    place = np.einsum("nk,nkj->nj", bound.weights, mesh.points[mesh.cells[bound.cells]])
    np.testing.assert_allclose(place, points, atol=1e-12)


def test_a_large_cell_among_small_ones_is_found() -> None:
    """Its centroid is far away and its corners are not the nearest points either way."""
    fine = block(12, 12, 12)
    n = fine.n_points
    apex = np.array([[0.5, 0.5, 9.0], [0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.5, 1.0, 1.0]])
    points = np.concatenate([fine.points, apex])
    mesh = Mesh(points, np.concatenate([fine.cells, [[n + 1, n + 2, n + 3, n]]]), "tetra")
    bound = embed_points(mesh, np.array([[0.5, 0.3, 1.4], [0.5, 0.3, 3.0], [0.5, 0.3, 0.5]]))
    assert bound.cells[0] == bound.cells[1] == fine.n_cells
    assert bound.cells[2] < fine.n_cells


def test_a_fine_sphere_on_a_coarse_one() -> None:
    coarse = build_mesh(SphereMesh.model_validate({"recipe": "sphere", "radius": 1.0, "element_size": 0.7}), Path())
    fine = build_mesh(SphereSurfaceMesh.model_validate({"recipe": "sphere_surface", "radius": 1.0}), Path())
    bound = embed_points(coarse, fine.points)
    assert 0.01 < bound.distance.max() < 0.2
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.3]])
    followed = np.einsum("nk,nkj->nj", bound.weights, (coarse.points @ turn.T)[coarse.cells[bound.cells]])
    np.testing.assert_allclose(followed, fine.points @ turn.T, atol=1e-9)


def test_a_surface_holds_no_points() -> None:
    surface = build_mesh(SphereSurfaceMesh.model_validate({"recipe": "sphere_surface", "radius": 1.0}), Path())
    with pytest.raises(ValueError, match="do not fill"):
        embed_points(surface, np.zeros((1, 3)))
