"""The mesh block of a scene: what is accepted, and how a wrong one is reported."""

from __future__ import annotations

import re
from typing import Any, get_args

import pytest
from pydantic import TypeAdapter, ValidationError

from femdeform.scene.mesh_schema import RECIPE_NAMES, BlockMesh, FileMesh, MeshSource, Recipe

SOURCE: TypeAdapter[Any] = TypeAdapter(MeshSource)


def test_block_example() -> None:
    source = SOURCE.validate_python({"recipe": "block", "size": [1.0, 0.2, 0.2], "cells": [40, 8, 8]})
    assert isinstance(source, BlockMesh)
    assert source.size == (1.0, 0.2, 0.2)
    assert source.cells == (40, 8, 8)
    assert SOURCE.validate_python(source) is source


def test_file_example() -> None:
    source = SOURCE.validate_python({"file": "bunny.mesh", "scale": 0.1})
    assert isinstance(source, FileMesh)
    assert source.scale == 0.1


@pytest.mark.parametrize("name", RECIPE_NAMES)
def test_every_recipe_has_defaults(name: str) -> None:
    assert SOURCE.validate_python({"recipe": name}).recipe == name


@pytest.mark.parametrize("model", [*get_args(Recipe), FileMesh], ids=lambda model: model.__name__)
def test_every_length_says_its_unit(model: Any) -> None:
    lengths = ("size", "radius", "length", "thickness", "height", "translate", "inset")
    for name, field in model.model_fields.items():
        assert field.description, name
        if any(word in name for word in lengths):
            assert re.search(r"\[m\]", field.description), name


def _errors(block: Any) -> list[Any]:
    with pytest.raises(ValidationError) as caught:
        SOURCE.validate_python(block)
    return list(caught.value.errors())


def test_unknown_recipe_is_one_error_with_the_names() -> None:
    (error,) = _errors({"recipe": "blok", "size": [1.0]})
    assert error["type"] == "union_tag_invalid"
    assert error["ctx"]["tag"] == "blok"
    assert "'block'" in error["ctx"]["expected_tags"]


def test_errors_are_reported_against_the_recipe_meant() -> None:
    errors = _errors({"recipe": "sphere", "radius": -1.0, "sides": 3})
    assert {error["loc"] for error in errors} == {("sphere", "radius"), ("sphere", "sides")}


def test_neither_recipe_nor_file() -> None:
    for block in ({}, {"size": [1.0]}, "bunny.mesh", 3, None):
        (error,) = _errors(block)
        assert "{recipe: NAME, ...} or {file: PATH, ...}" in error["msg"]


@pytest.mark.parametrize(
    ("block", "message"),
    [
        ({"recipe": "block", "size": [1.0, 1.0], "cells": [2, 2, 2]}, "size has 2 entries but cells has 3"),
        ({"recipe": "block", "dim": 2}, "3 sizes do not fit into 2 dimensions"),
        ({"recipe": "block", "cells": [10_000, 10_000, 10_000]}, "too many"),
        ({"recipe": "block", "cells": [2.0, 2, 2]}, "valid integer"),
        ({"recipe": "block", "size": ["1", 1, 1]}, "valid number"),
        ({"recipe": "block", "split": 4}, "5 or 6"),
        ({"recipe": "sphere", "radius": float("inf")}, "finite"),
        ({"recipe": "cylinder", "hole_radius": 0.5}, "smaller than radius"),
        ({"recipe": "torus", "tube_radius": 0.6}, "smaller than radius"),
        ({"recipe": "spherical_shell", "thickness": 0.5}, "smaller than radius"),
        ({"recipe": "plate_with_hole", "radius": 1.0}, "does not fit into the plate"),
        ({"recipe": "plate_with_hole", "hole_element_size": 1e-9}, "less than a hundredth"),
        ({"recipe": "sphere", "radius": 1e300}, "less than or equal to"),
        ({"recipe": "sphere", "element_size": 11.0}, "radius: element_size 11 is too coarse for it (at most 10)"),
        ({"recipe": "cylinder", "radius": 1e-4}, "radius: element_size 0.15 is too coarse"),
        ({"recipe": "cylinder", "hole_radius": 1e-6}, "hole_radius: element_size 0.15 is too coarse"),
        ({"recipe": "cylinder", "hole_radius": 0.4999999}, "hole_radius: element_size 0.15 is too coarse"),
        ({"recipe": "torus", "tube_radius": 1e-3}, "tube_radius: element_size 0.1 is too coarse"),
        ({"recipe": "ellipsoid", "semi_axes": [1.0, 1.0, 1e-3]}, "semi_axes: element_size 0.15 is too coarse"),
        ({"recipe": "spherical_shell", "thickness": 1e-4}, "thickness: element_size 0.08 is too coarse"),
        ({"recipe": "beam", "size": [1.0, 1.0, 1e-6]}, "size: element_size 0.05 is too coarse"),
        ({"recipe": "rubber_mount", "bolt_hole_radius": 1e-7}, "bolt_hole_radius: element_size 0.01 is too"),
        ({"recipe": "cook", "cells": [4, 4, 4]}, "2 entries are needed"),
        ({"recipe": "flag", "cells": [10, 3]}, "even number"),
        ({"recipe": "flag", "thickness": 0.1}, "thinner than the cylinder"),
        ({"recipe": "rod", "end": [0, 0, 0]}, "coincide"),
        ({"recipe": "sphere_surface", "element_size": 1e-5}, "more than 300"),
        ({"recipe": "rubber_mount", "bore_radius": 0.03}, "narrower than the rubber"),
        ({"recipe": "rubber_mount", "plate_size": 0.06}, "wider than the rubber"),
        ({"recipe": "rubber_mount", "bolt_hole_inset": 0.003}, "cut through the plates' edges"),
        ({"recipe": "rubber_mount", "bolt_hole_inset": 0.025}, "run into the rubber"),
        ({"recipe": "sphere", "rotate": {"axis": [0, 0, 0], "angle": 1.0}}, "no direction"),
        ({"file": "a.step", "fill": True}, "filled anyway"),
        ({"file": "a.obj", "element_size": 0.1}, "only for STEP solids"),
        ({"file": "a.obj", "fill": True, "cell_type": "edges"}, "a filled surface has tetrahedra"),
        ({"file": "a.obj", "scale": 0.0}, "greater than 0"),
        ({"file": "a.obj", "fil": True}, "Extra inputs"),
    ],
)
def test_wrong_values(block: dict[str, Any], message: str) -> None:
    assert any(message in error["msg"] for error in _errors(block))
