"""Nodes and facets of a selection, on a block whose node numbers are known by their positions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from femdeform import registry
from femdeform.errors import InputError
from femdeform.scene.mesh_schema import BlockMesh, ClothMesh, SphereSurfaceMesh
from femdeform.scene.selection_schema import (
    BoxSelection,
    NodeSelection,
    PlaneRegion,
    PlaneSelection,
    SphereRegion,
    SphereSelection,
)
from femdeform.scene.selections import select_facets, select_nodes, split_name
from femdeform.types import FloatArray, IntArray, Mesh


def block(**settings: object) -> Mesh:
    mesh: Mesh = registry.resolve(registry.MESH["build"])(BlockMesh(recipe="block", **settings), Path())
    return mesh


@pytest.fixture(scope="module")
def meshes() -> dict[str, Mesh]:
    """Two blocks of 4 x 2 x 2 cells, side by side: x from 0 to 2 and from 3 to 5."""
    settings = {"size": (2.0, 1.0, 1.0), "cells": (4, 2, 2)}
    return {"a": block(**settings), "b": block(**settings, translate=(3.0, 0.0, 0.0))}


def places(mesh: Mesh, nodes: IntArray) -> set[tuple[float, ...]]:
    return {tuple(point) for point in mesh.points[nodes].tolist()}


def area(mesh: Mesh, facets: IntArray) -> float:
    corners = mesh.points[facets]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return float(0.5 * np.linalg.norm(normals, axis=1).sum())


def mean_normal(mesh: Mesh, facets: IntArray) -> FloatArray:
    corners = mesh.points[facets]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
    return np.asarray(normals / np.linalg.norm(normals))


def test_a_body_is_all_its_nodes(meshes: dict[str, Mesh]) -> None:
    selected = select_nodes("b", meshes)
    assert list(selected) == ["b"]
    assert np.array_equal(selected["b"], np.arange(45))


def test_a_group_of_facets(meshes: dict[str, Mesh]) -> None:
    nodes = select_nodes("a.right", meshes)["a"]
    assert places(meshes["a"], nodes) == {(2.0, y, z) for y in (0.0, 0.5, 1.0) for z in (0.0, 0.5, 1.0)}
    facets = select_facets("a.right", meshes)["a"]
    assert np.array_equal(facets, meshes["a"].facet_groups["right"])


def test_a_group_of_nodes_has_the_facets_it_holds_whole(meshes: dict[str, Mesh]) -> None:
    assert select_facets("a.left_bottom_back", meshes) == {}
    assert places(meshes["a"], select_nodes("a.left_bottom_back", meshes)["a"]) == {(0.0, 0.0, 0.0)}


def test_a_whole_body_has_its_whole_boundary(meshes: dict[str, Mesh]) -> None:
    facets = select_facets("a", meshes)["a"]
    assert area(meshes["a"], facets) == pytest.approx(10.0)


def test_a_box_includes_its_border(meshes: dict[str, Mesh]) -> None:
    selected = select_nodes(BoxSelection(box=((-1.0, -1.0, -1.0), (0.5, 2.0, 2.0))), meshes)
    assert list(selected) == ["a"]
    assert len(selected["a"]) == 18
    assert meshes["a"].points[selected["a"]][:, 0].max() == 0.5


def test_a_box_forgives_rounding(meshes: dict[str, Mesh]) -> None:
    corner = 0.5 - 1e-12
    selected = select_nodes(BoxSelection(box=((-1.0, -1.0, -1.0), (corner, 2.0, 2.0))), meshes)
    assert len(selected["a"]) == 18


def test_a_box_over_both_bodies_and_restricted_to_one(meshes: dict[str, Mesh]) -> None:
    box = ((1.5, -1.0, -1.0), (3.5, 2.0, 2.0))
    assert {name: len(nodes) for name, nodes in select_nodes(BoxSelection(box=box), meshes).items()} == {
        "a": 18,
        "b": 18,
    }
    assert list(select_nodes(BoxSelection(box=box, body="b"), meshes)) == ["b"]


def test_facets_on_a_plane_point_outward(meshes: dict[str, Mesh]) -> None:
    top = PlaneSelection(plane=PlaneRegion(point=(7.0, 1.0, -3.0), normal=(0.0, 5.0, 0.0)))
    facets = select_facets(top, meshes)
    assert {name: area(meshes[name], found) for name, found in facets.items()} == pytest.approx({"a": 2.0, "b": 2.0})
    assert mean_normal(meshes["a"], facets["a"]) == pytest.approx([0.0, 1.0, 0.0])


def test_a_plane_inside_a_body_has_nodes_but_no_facets(meshes: dict[str, Mesh]) -> None:
    middle = PlaneSelection(plane=PlaneRegion(point=(1.0, 0.0, 0.0), normal=(1.0, 0.0, 0.0)), body="a")
    assert len(select_nodes(middle, meshes)["a"]) == 9
    assert select_facets(middle, meshes) == {}


def test_the_tolerance_of_a_plane(meshes: dict[str, Mesh]) -> None:
    def count(**settings: float) -> int:
        plane = PlaneRegion(point=(0.1, 0.0, 0.0), normal=(1.0, 0.0, 0.0), **settings)
        return sum(map(len, select_nodes(PlaneSelection(plane=plane), meshes).values()))

    assert count() == 0
    assert count(tolerance=0.11) == 9
    assert count(tolerance=0.41) == 18


def test_a_ball(meshes: dict[str, Mesh]) -> None:
    sphere = SphereSelection(sphere=SphereRegion(center=(0.0, 0.0, 0.0), radius=0.5))
    assert places(meshes["a"], select_nodes(sphere, meshes)["a"]) == {
        (0.0, 0.0, 0.0),
        (0.5, 0.0, 0.0),
        (0.0, 0.5, 0.0),
        (0.0, 0.0, 0.5),
    }


def test_nodes_by_number(meshes: dict[str, Mesh]) -> None:
    selected = select_nodes(NodeSelection(nodes=[7, 3, 7], body="b"), meshes)
    assert selected["b"].tolist() == [3, 7]
    assert select_nodes(NodeSelection(nodes=[44]), {"a": meshes["a"]})["a"].tolist() == [44]


def test_facets_of_a_surface_are_its_cells() -> None:
    source = SphereSurfaceMesh(recipe="sphere_surface", element_size=0.3)
    ball = registry.resolve(registry.MESH["build"])(source, Path())
    np.testing.assert_array_equal(select_facets("ball", {"ball": ball})["ball"], ball.cells)
    cloth = registry.resolve(registry.MESH["build"])(ClothMesh(recipe="cloth", cells=(2, 1)), Path())
    assert select_facets("cloth.left", {"cloth": cloth}) == {}  # a line
    half = BoxSelection(box=((-1.0, -1.0, -1.0), (0.0, 1.0, 1.0)))
    facets = select_facets(half, {"cloth": cloth})["cloth"]
    assert len(facets) == 2
    assert cloth.points[facets][..., 0].max() <= 0.0


@pytest.mark.parametrize(
    ("selection", "message"),
    [
        ("c", "there is no body `c`"),
        ("a.front_door", "body `a` has no group `front_door`"),
        (BoxSelection(box=((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), body="c"), "there is no body `c`"),
        (NodeSelection(nodes=[0]), "`nodes` needs `body`, because there are several bodies"),
        (NodeSelection(nodes=[45], body="a"), "node 45 is out of range; body `a` has 45 nodes, from 0"),
    ],
)
def test_what_cannot_be_selected(selection: object, message: str, meshes: dict[str, Mesh]) -> None:
    with pytest.raises(InputError, match=f"^{message}$"):
        select_nodes(selection, meshes)  # type: ignore[arg-type]


def test_names_with_dots_in_the_group(meshes: dict[str, Mesh]) -> None:
    dotted = Mesh(meshes["a"].points, meshes["a"].cells, "tetra", {}, {}, {"x.y": np.array([1])})
    assert split_name("d.x.y", {"d": dotted}) == ("d", "x.y")
