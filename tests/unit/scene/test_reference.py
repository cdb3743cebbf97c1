"""The reference is complete, its links lead somewhere, and its examples are what the schema takes."""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Callable
from typing import Annotated, Any, Literal

import pytest
from pydantic import BaseModel, Field, create_model
from ruamel.yaml import YAML

from femdeform.scene.export import json_schema
from femdeform.scene.reference import Section, scene_markdown, scene_pages, scene_sections, schema_markdown, sections
from femdeform.scene.reference_examples import given_examples
from femdeform.scene.reference_words import block_in_yaml, cell, value_in_yaml
from femdeform.scene.scene_model import Name, Positive, SceneModel, Vector
from femdeform.scene.validation import find_faults

WRITTEN = scene_sections()
WITH_EXAMPLE = [section for section in WRITTEN if section.model is not None]


def in_its_place(section: Section) -> type[BaseModel]:
    """A model with the key that the example stands under, as the schema has it."""
    assert section.block is not None
    owner, key = next(place for place in section.block.owners if place[1] == section.block.key)
    info = owner.model_fields[key]
    return create_model("Place", __base__=SceneModel, **{key: (info.annotation, info)})


@pytest.mark.parametrize("section", WITH_EXAMPLE, ids=lambda section: section.anchor)
def test_the_example_is_valid_where_it_stands(section: Section) -> None:
    (text,) = re.findall(r"```yaml\n(.*?)```", section.text, re.DOTALL)
    data = YAML(typ="safe", pure=True).load(text)
    assert find_faults(in_its_place(section), data) == []
    # The example has to be one of this very form, not of a neighbour.
    assert section.model is not None
    assert find_faults(section.model, section.example) == []


def test_no_example_is_left_over() -> None:
    assert set(given_examples()) <= {section.anchor for section in WITH_EXAMPLE}


def test_anchors_are_unique_and_links_lead_to_them() -> None:
    anchors = [section.anchor for section in WRITTEN]
    assert len(set(anchors)) == len(anchors)
    for section in WRITTEN:
        assert set(re.findall(r"\]\(#([^)]+)\)", section.text)) <= set(anchors)


def test_pages_link_to_the_page_an_anchor_is_on() -> None:
    pages = scene_pages()
    assert next(iter(pages)) == "index"
    links = [
        (page, *link) for page, text in pages.items() for link in re.findall(r"\]\((?:(\w+)\.md)?#([^)]+)\)", text)
    ]
    assert ("conditions", "on", "on") in links
    for page, other, anchor in links:
        assert f"{{#{anchor}}}" in pages[other or page]


def described_keys(schema: dict[str, Any]) -> set[tuple[str, str]]:
    """Keys of all blocks of the JSON schema, each with its description."""
    blocks = [schema, *schema["$defs"].values()]
    return {
        (key, " ".join(value["description"].split()))
        for block in blocks
        for key, value in block.get("properties", {}).items()
    }


def test_every_key_of_the_json_schema_is_described() -> None:
    """Another way through the same models: pydantic's own."""
    text = scene_markdown()
    keys = described_keys(json_schema())
    assert len(keys) > 150
    for key, description in keys:
        is_row = re.search(rf"\| `{key}` \|[^\n]*\| {re.escape(cell(description))} \|", text) is not None
        is_form = cell(description)[1:] in text and re.search(rf"`{key}: |`{key}`", text) is not None
        assert is_row or is_form, f"{key}: {description}"


def test_a_row_says_type_bounds_default_and_unit() -> None:
    text = scene_markdown()
    for row in (
        "| `poisson_ratio` | number > -1 and < 0.5 | **required** | Poisson's ratio at small strain [-] |",
        "| `density` | number > 0 | **required** | mass density in the reference state [kg/m^3] |",
        "| `tolerance` | number > 0 and < 1 | `1.0e-8` | residual over the forces of the problem [-] |",
        "| `size` | list of 1 to 3 numbers > 0 | `[1.0, 1.0, 1.0]` | edge lengths in x, y, z [m] |",
        "| `velocity` | list of 2 or 3 numbers | **required** | velocity of the group [m/s] |",
        "| `components` | non-empty list of `x`, `y` or `z` | none |",
        "| `regions` | mapping, name to [`material`](#material) block | none |",
        "| `on` | [`on`](#on) | **required** |",
        "| `angular_velocity` | list of 2 or 3 numbers or number | none |",
    ):
        assert row in text, row


def test_the_command_prints_it(cli: Callable[..., subprocess.CompletedProcess[str]]) -> None:
    finished = cli("schema", "--markdown")
    assert finished.returncode == 0, finished.stderr
    assert finished.stdout == scene_markdown() + "\n"
    json.loads(cli("schema").stdout)


# ------------------------------------------------------------------------------------------------ other schemas


class Copper(SceneModel):
    metal: Literal["copper"] = Field(description="red")
    density: Positive = Field(description="mass density [kg/m^3]")


class Silver(SceneModel):
    """Costly | precious."""

    metal: Literal["silver", "sterling"] = Field(description="grey")
    density: Positive = Field(description="mass density [kg/m^3]")
    purity: float = Field(gt=0.0, lt=0.5, description="part of silver [-]")
    direction: Vector = Field(description="rolling direction [-]")


class Coin(SceneModel):
    name: Name = Field(description="name")
    metal: Annotated[Copper | Silver, Field(discriminator="metal")] = Field(description="what it is made of")
    count: int = Field(default=3, ge=2, le=9, description="how many")


def test_what_is_added_to_a_schema_is_in_its_reference() -> None:
    written = {section.anchor: section for section in sections(Coin, "Coins", {"metal-copper": {"density": 8960.0}})}
    assert list(written) == ["keys", "metal", "metal-copper", "metal-silver"]
    assert "| `name` | name | **required** | name |" in written["keys"].text
    assert "| `count` | whole number >= 2 and <= 9 | `3` | how many |" in written["keys"].text
    silver = written["metal-silver"]
    assert silver.title == "`metal: silver`, `sterling`"
    assert "Costly \\| precious." in silver.text
    # Made up: the neighbour's density, else the simplest values within bounds.
    assert silver.example == {"metal": "silver", "density": 8960.0, "purity": 0.25, "direction": [0, 1.0]}
    assert find_faults(Silver, silver.example) == []


def test_a_reference_may_do_without_examples() -> None:
    text = schema_markdown(Coin, "Coins")
    assert text.startswith("# Coins {#keys}\n")
    assert "```" not in text


def test_values_are_written_as_yaml() -> None:
    value = {"a": [1, 2.5e6, 1.0e-9, 0.1], "b": True, "c": None, "d": "no: text", "e": 12345678.0}
    text = value_in_yaml(value)
    assert text == '{a: [1, 2.5e+6, 1.0e-9, 0.1], b: true, c: null, d: "no: text", e: 1.2345678e+7}'
    assert YAML(typ="safe", pure=True).load(text) == value


@pytest.mark.parametrize("holder", ["", "list", "dict"])
@pytest.mark.parametrize("width", [20, 200])
def test_blocks_are_written_as_yaml(holder: str, width: int) -> None:
    value = {"kind": "fixed", "on": "beam.left", "nested": {"x": [1, 2]}}
    data = YAML(typ="safe", pure=True).load(block_in_yaml("key", holder, value, width))
    assert data == {"key": {"": value, "list": [value], "dict": {"NAME": value}}[holder]}
