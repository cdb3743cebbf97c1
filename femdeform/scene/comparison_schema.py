"""The file of `femdeform compare`: a scene, the variants that solve it, and their budget."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from femdeform.errors import InputError
from femdeform.scene.batch_schema import Key, check_mapping, read_checked, scene_file_findings
from femdeform.scene.document import read_document
from femdeform.scene.load import Source, sort_faults
from femdeform.scene.scene_model import Positive, SceneModel
from femdeform.scene.validation import Finding

# What a comparison has and a scene has not.
_MARK = "variants"
_Options = Annotated[dict[Key, Any], BeforeValidator(check_mapping), Field(min_length=1)]


class ComparisonFile(SceneModel):
    """A comparison file."""

    schema_version: Literal[1] = Field(default=1, description="version of this schema")
    title: str = Field(default="", description="one line for the page; default: the title of the scene")
    scene: Annotated[str, Field(min_length=1)] = Field(description="scene file, relative to the comparison file")
    set: dict[Key, Any] = Field(default_factory=dict, description="values of keys of the scene, for all variants")
    variants: Annotated[dict[str, _Options], Field(min_length=1)] = Field(
        description="by label, the keys of `solver` and `linear_solver` that make the variant"
    )
    iterations: Annotated[int, Field(ge=1)] | None = Field(default=None, description="budget of a step in iterations")
    seconds: Positive | None = Field(default=None, description="budget of a step in seconds [s]")
    steps: int = Field(default=1, ge=1, description="steps to compare")
    start_step: int = Field(default=0, ge=0, description="step of the reference that all start from")
    repeat: int = Field(default=1, ge=1, description="runs of each variant; the one of median length is reported")

    @model_validator(mode="after")
    def _one_budget(self) -> ComparisonFile:
        if (self.iterations is None) == (self.seconds is None):
            raise ValueError("needs a budget: either `iterations` or `seconds`")
        return self


@dataclass(frozen=True)
class LoadedComparison:
    """A comparison file that passed the schema.

    Attributes
    ----------
    file : ComparisonFile
        What it says.
    path : Path
        Where it was read from.
    source : Source
        Lines of its keys.
    """

    file: ComparisonFile
    path: Path
    source: Source

    @property
    def scene_path(self) -> Path:
        """The scene file."""
        return self.path.parent / self.file.scene

    @property
    def overrides(self) -> list[str]:
        """``key=value`` for all variants."""
        return [_override(key, value) for key, value in self.file.set.items()]

    def variants(self) -> Iterator[tuple[str, tuple[str, ...]]]:
        """Label and ``key=value`` of each variant."""
        for label, options in self.file.variants.items():
            yield label, tuple(_override(key, value) for key, value in options.items())


def _override(key: str, value: Any) -> str:
    return f"{key}={json.dumps(value, ensure_ascii=False, allow_nan=False)}"


def is_comparison(path: Path) -> bool:
    """Whether a file is a comparison, not a scene; False for what cannot be read."""
    document = read_document(path, "scene or comparison")
    return isinstance(document.data, dict) and _MARK in document.data


def load_comparison(path: Path) -> LoadedComparison:
    """Read a comparison file and validate it.

    Raises
    ------
    InputError
        With every fault of the text and of the schema, sorted by line. The scene is not checked.
    """
    file, source = read_checked(ComparisonFile, path, "comparison")
    loaded = LoadedComparison(file, path, source)
    findings: list[Finding] = list(scene_file_findings(loaded.scene_path, file.scene))
    if findings:
        raise InputError(sort_faults([source.fault(found.path, found.message) for found in findings]))
    return loaded
