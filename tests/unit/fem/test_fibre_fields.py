"""Fibre directions: constant, from cell data, harmonic; and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import TypeAdapter

from femdeform.errors import InputError
from femdeform.fem.discretization import harmonic_values
from femdeform.fem.fibre_fields import constant_directions, harmonic_directions, stored_directions
from femdeform.scene.mesh_schema import MeshSource
from femdeform.types import Mesh
from meshes import build_mesh

SOURCE: TypeAdapter[Any] = TypeAdapter(MeshSource)


def build(**block: Any) -> Mesh:
    return build_mesh(SOURCE.validate_python(block), Path())


def everything(mesh: Mesh) -> Any:
    return np.arange(mesh.n_cells)


def test_constant() -> None:
    assert constant_directions((3.0, 4.0), 2) == pytest.approx(np.array([[0.6, 0.8]] * 2))


@pytest.mark.parametrize(("size", "cells"), [([2.0, 1.0], [4, 3]), ([2.0, 1.0, 1.0], [4, 3, 2])])
def test_harmonic_in_a_block_is_constant(size: list[float], cells: list[int]) -> None:
    mesh = build(recipe="block", size=size, cells=cells)
    found = harmonic_directions(mesh, everything(mesh), mesh.group_nodes("left"), mesh.group_nodes("right"))
    assert found == pytest.approx(np.tile([1.0, 0.0, 0.0][: len(size)], (mesh.n_cells, 1)), abs=1e-9)


def test_harmonic_in_a_ring_goes_round() -> None:
    """Between the straight ends of a quarter ring the harmonic function is the angle."""
    errors = []
    for n in (8, 16):
        mesh = build(recipe="ring", cells=[n, 4 * n])
        names = mesh.facet_groups
        ends = [name for name in names if name not in ("boundary", "inner", "outer")]
        assert len(ends) == 2, names.keys()
        nodes = [mesh.group_nodes(name) for name in ends]
        found = harmonic_directions(mesh, everything(mesh), *nodes)
        middle = mesh.points[mesh.cells].mean(axis=1)
        around = np.stack([-middle[:, 1], middle[:, 0]], axis=1)
        around /= np.linalg.norm(around, axis=1, keepdims=True)
        along = np.abs(np.einsum("ni,ni->n", found, around))
        errors.append(float(np.degrees(np.arccos(np.clip(along, -1.0, 1.0))).max()))
    assert errors[1] < 3.0
    assert errors[1] < 0.6 * errors[0]


def test_harmonic_in_a_spindle_is_tangential() -> None:
    mesh = build(recipe="muscle")
    cells = mesh.cell_groups["muscle"]
    ends = [mesh.group_nodes(name) for name in ("origin_bone", "insertion_bone")]
    found = harmonic_directions(mesh, cells, *ends)
    assert np.linalg.norm(found, axis=1) == pytest.approx(1.0)
    assert found[:, 0].min() > 0.5
    # They spread towards the belly and come together behind it.
    middle = mesh.points[mesh.cells[cells]].mean(axis=1)
    outward = np.einsum("ni,ni->n", found[:, 1:], middle[:, 1:])
    off_axis = np.linalg.norm(middle[:, 1:], axis=1) > 0.005
    rising = off_axis & (middle[:, 0] > 0.05) & (middle[:, 0] < 0.08)
    falling = off_axis & (middle[:, 0] > 0.12) & (middle[:, 0] < 0.15)
    assert outward[rising].min() > 0.0 > outward[falling].max()


def test_harmonic_values_are_between_the_ends() -> None:
    mesh = build(recipe="block", size=[3.0, 1.0, 1.0], cells=[6, 2, 2])
    low, high = (np.isin(np.arange(mesh.n_points), mesh.group_nodes(name)) for name in ("left", "right"))
    values = harmonic_values(1e-6 * mesh.points, mesh.cells, low, high)
    assert values == pytest.approx(mesh.points[:, 0] / 3.0, abs=1e-10)


def test_cells_inside_an_end_take_what_is_around_them() -> None:
    """All nodes of some cells belong to the origin: the function is 0 there."""
    mesh = build(recipe="block", size=[3.0, 1.0], cells=[6, 2])
    origin = np.flatnonzero(mesh.points[:, 0] < 1.1)
    found = harmonic_directions(mesh, everything(mesh), origin, mesh.group_nodes("right"))
    assert found == pytest.approx(np.tile([1.0, 0.0], (mesh.n_cells, 1)), abs=1e-9)


def test_refused() -> None:
    mesh = build(recipe="block", size=[3.0, 1.0], cells=[6, 2])
    left, right, all_cells = mesh.group_nodes("left"), mesh.group_nodes("right"), everything(mesh)
    part = np.flatnonzero(mesh.points[mesh.cells].mean(axis=1)[:, 0] < 1.0)
    with pytest.raises(InputError, match="insertion: none of its nodes belongs"):
        harmonic_directions(mesh, part, left, right)
    with pytest.raises(InputError, match="shares 3 nodes"):
        harmonic_directions(mesh, all_cells, left, np.arange(mesh.n_points))
    middle = mesh.points[mesh.cells].mean(axis=1)[:, 0]
    ends = np.flatnonzero((middle < 1.0) | (middle > 2.0))
    with pytest.raises(InputError, match="origin: 1 of 2 unconnected parts"):
        harmonic_directions(mesh, ends, left, right)
    # A dead end: nothing flows through a strip that only its root holds.
    points = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0], [0.5, 2.0]])
    cells = np.array([[0, 1, 3], [0, 3, 2], [2, 3, 4]])
    strip = Mesh(points, cells, "triangle")
    with pytest.raises(InputError, match=r"vanishes in 1 cells, the first is cell 2"):
        harmonic_directions(strip, np.arange(3), np.array([0, 1]), np.array([2, 3]))


def test_stored() -> None:
    mesh = build(recipe="block", size=[1.0, 1.0], cells=[1, 1])
    held = replace(mesh, cell_data={"v": np.array([[0.0, 2.0], [3.0, 4.0]]), "w": np.array([[0.0, 0.0], [1.0, 0.0]])})
    assert stored_directions(held, "v", np.array([1])) == pytest.approx(np.array([[0.6, 0.8]]))
    with pytest.raises(InputError, match=r"no cell data `x` \(there are: v, w\)"):
        stored_directions(held, "x", np.array([0]))
    with pytest.raises(InputError, match="no direction in 1 cells, the first is cell 0"):
        stored_directions(held, "w", np.array([0, 1]))
