"""The JSON schema judges scenes as editors do, and describes every key."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from femdeform.scene.document import read_document
from femdeform.scene.export import json_schema

GALLERY = sorted((Path(__file__).parents[3] / "scenes").glob("*.yaml"))


@pytest.fixture(scope="module")
def validator() -> Any:
    schema = json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


def test_it_names_its_dialect() -> None:
    assert json_schema()["$schema"] == "https://json-schema.org/draft/2020-12/schema"


def test_a_sound_scene_is_valid(validator: Any, scene_file: Callable[..., Path]) -> None:
    validator.validate(read_document(scene_file()).data)


@pytest.mark.parametrize("path", GALLERY, ids=lambda path: path.stem)
def test_the_gallery_is_valid(validator: Any, path: Path) -> None:
    validator.validate(read_document(path).data)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("title: Twisted", "titel: Twisted"),
        ("law: neo_hookean", "law: rubber"),
        ("density: 1000.0", "density: heavy"),
        ("density: 1000.0", "density: -1"),
        ("axis: [1, 0, 0]", "axis: [1]"),
        ("axis: [1, 0, 0]", "axis: [1, 0, 0, 0]"),
        ("recipe: block", "recipe: brick"),
        ("  beam:\n", "  my beam:\n"),
        ("time: {scheme: backward_euler, dt: 0.01, end: 1.0}", ""),
    ],
)
def test_a_bad_scene_is_not_valid(
    validator: Any, scene_file: Callable[..., Path], scene_text: str, old: str, new: str
) -> None:
    data = read_document(scene_file(scene_text, (old, new))).data
    assert not validator.is_valid(data)


def keys_without_description(node: Any, path: str = "") -> Iterator[str]:
    if isinstance(node, dict):
        for name, value in node.get("properties", {}).items():
            if "description" not in value:
                yield f"{path}.{name}"
        for name, value in node.items():
            yield from keys_without_description(value, f"{path}.{name}")
    elif isinstance(node, list):
        for item in node:
            yield from keys_without_description(item, path)


def test_every_key_is_described() -> None:
    assert list(keys_without_description(json_schema())) == []


def numbers_without_unit(node: Any, path: str = "") -> Iterator[str]:
    """Properties that are plain numbers (not counts) and whose description has no ``[unit]``."""
    if isinstance(node, dict):
        for name, value in node.get("properties", {}).items():
            kinds = [value.get("type"), *(member.get("type") for member in value.get("anyOf", []))]
            if "number" in kinds and "[" not in value.get("description", ""):
                yield f"{path}.{name}"
        for name, value in node.items():
            yield from numbers_without_unit(value, f"{path}.{name}")
    elif isinstance(node, list):
        for item in node:
            yield from numbers_without_unit(item, path)


def test_every_number_has_a_unit() -> None:
    # The unit of an expected value, of its bounds, of a level and of a limit is that of the quantity they belong to.
    allowed = {"value", "atol", "at_least", "at_most", "level", "toward"}
    for path in numbers_without_unit(json_schema()):
        model, key = path.split(".")[-2:]
        assert model.startswith("Expected"), path
        assert key in allowed, path
