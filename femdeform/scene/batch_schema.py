"""The study file of `femdeform batch`: which keys of one scene are varied, and how."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from femdeform.errors import Fault, InputError
from femdeform.scene.document import read_document
from femdeform.scene.key_path import KeyPath, format_key
from femdeform.scene.load import Source, schema_faults, sort_faults
from femdeform.scene.overrides import parse_override
from femdeform.scene.quantity_schema import ExpectedValue
from femdeform.scene.scene_model import Finite, SceneModel
from femdeform.scene.validation import Finding
from femdeform.scene.wording import did_you_mean, shown

MAX_RUNS = 10_000


def scene_key(text: str) -> KeyPath | None:
    """Path that a key of ``--set`` names, None if it is no key; ``a.0`` and ``a[0]`` are the same."""
    override, _ = parse_override(f"{text}=0") if "=" not in text else (None, [])
    if override is None:
        return None
    return tuple(int(part) if isinstance(part, str) and _is_index(part) else part for part in override.path)


def _is_index(part: str) -> bool:
    return part.isascii() and part.isdigit() and len(part) < 10


def _check_key(text: str) -> str:
    if scene_key(text) is None:
        raise ValueError("is not a key of a scene; keys look like time.dt or conditions[0].rate")
    return text


def check_mapping(value: Any) -> Any:
    """Refuse what is no mapping, before pydantic says it in other words."""
    if not isinstance(value, dict):
        raise ValueError(f"must be a mapping (`key: value`), not {shown(value)}")
    return value


Key = Annotated[str, AfterValidator(_check_key)]
Values = Annotated[list[Any], Field(min_length=1)]
# Named here, because the block below has keys called `list`, `set` and `zip`.
_Row = Annotated[dict[Key, Any], BeforeValidator(check_mapping), Field(min_length=1)]
_Rows = Annotated[list[_Row], Field(min_length=1)]
_Columns = Annotated[dict[Key, Values], Field(min_length=1)]
_Model = TypeVar("_Model", bound=SceneModel)
_Names = Annotated[list[str], Field(min_length=1)]


class Range(SceneModel):
    """Values that a key may take in a random sample."""

    min: Finite = Field(description="lowest value, in the unit of the key")
    max: Finite = Field(description="highest value, in the unit of the key")
    scale: Literal["linear", "log"] = Field(
        default="linear", description="linear: every value as likely as another; log: every ratio"
    )
    integer: bool = Field(default=False, description="whole numbers only, both ends included")

    @model_validator(mode="after")
    def _consistent(self) -> Range:
        if self.max <= self.min:
            raise ValueError(f"max: must exceed min, {self.min:g}, not {self.max:g}")
        if self.scale == "log" and self.min <= 0.0:
            raise ValueError(f"min: a logarithmic scale needs a positive number, not {self.min:g}")
        if not math.isfinite(self.max - self.min):
            raise ValueError("max: the range is wider than numbers go")
        if self.integer and (not self.min.is_integer() or not self.max.is_integer()):
            raise ValueError("integer: needs whole numbers as min and max")
        if self.integer and max(abs(self.min), abs(self.max)) > 2**53:
            raise ValueError("integer: whole numbers beyond 2^53 are not exact")
        return self


class LatinHypercube(SceneModel):
    """A random sample that is spread evenly over the range of every key."""

    samples: int = Field(ge=1, le=MAX_RUNS, description="number of points")
    seed: int = Field(
        default=0, ge=0, le=2**63 - 1, description="start of the random numbers; the same seed, the same points"
    )
    ranges: Annotated[dict[Key, Range], Field(min_length=1)] = Field(description="range of each key")


class Sweep(SceneModel):
    """What is varied; several parts combine as a product, the last one varying fastest."""

    grid: _Columns | None = Field(default=None, description="every combination of the values of each key")
    zip: _Columns | None = Field(default=None, description="values of several keys, taken together one by one")
    list: _Rows | None = Field(default=None, description="sets of values, each written out")
    latin_hypercube: LatinHypercube | None = Field(default=None, description="random points, evenly spread")

    @model_validator(mode="after")
    def _has_part(self) -> Sweep:
        if all(part is None for part in (self.grid, self.zip, self.list, self.latin_hypercube)):
            raise ValueError("needs at least one of `grid`, `zip`, `list` and `latin_hypercube`")
        return self


class ExpectedOverRuns(ExpectedValue):
    """A number made of one scalar of all runs."""

    scalar: str = Field(description="one of `scalars`")
    statistic: Literal["mean", "smallest", "largest", "standard_error"] = Field(
        default="mean", description="over the runs; standard_error: of their mean"
    )


class Study(SceneModel):
    """A study file."""

    schema_version: Literal[1] = Field(default=1, description="version of this schema")
    title: str = Field(default="", description="one line for the index")
    scene: Annotated[str, Field(min_length=1)] = Field(description="scene file, relative to the study file")
    set: dict[Key, Any] = Field(default_factory=dict, description="values of keys of the scene, the same in every run")
    sweep: Sweep = Field(description="what is varied: grid, zip, list, latin_hypercube")
    scalars: _Names | None = Field(
        default=None, description="numbers of result.json to list; default: steps, seconds and all quantities"
    )
    expect: list[ExpectedOverRuns] = Field(
        default_factory=list, description="means and bounds over all runs, judged when they are finished"
    )
    out: Annotated[str, Field(min_length=1)] | None = Field(
        default=None, description="folder of the results, relative to the study file; default results/<study>"
    )


@dataclass(frozen=True)
class LoadedStudy:
    """A study that passed the schema.

    Attributes
    ----------
    study : Study
        The validated study.
    path : Path
        The file it was read from.
    source : Source
        Lines of its keys.
    """

    study: Study
    path: Path
    source: Source

    @property
    def scene_path(self) -> Path:
        """The scene file."""
        return self.path.parent / self.study.scene

    def fault(self, key: KeyPath, message: str) -> Fault:
        """Return a fault at a key of the study file."""
        return self.source.fault(key, message)


def load_study(path: Path) -> LoadedStudy:
    """Read a study file and validate it.

    Parameters
    ----------
    path : Path
        The YAML file.

    Returns
    -------
    LoadedStudy
        The study. The scenes it leads to are not yet checked, see `femdeform.run.batch_plan`.

    Raises
    ------
    InputError
        With every fault of the text and of the schema, sorted by line.
    """
    study, source = read_checked(Study, path, "study")
    loaded = LoadedStudy(study, path, source)
    faults = [loaded.fault(found.path, found.message) for found in _study_findings(loaded)]
    if faults:
        raise InputError(sort_faults(faults))
    return loaded


def read_checked(model: type[_Model], path: Path, kind: str) -> tuple[_Model, Source]:
    """Read a file of one model.

    Parameters
    ----------
    model : type
        What it has to be.
    path : Path
        The YAML file.
    kind : str
        What it is a file of, for messages.

    Raises
    ------
    InputError
        With every fault of the text and of the schema, sorted by line.
    """
    document = read_document(path, kind)
    file = str(path)
    source = Source(file, document.lines)
    faults = [Fault(file, found.line, format_key(found.path), found.message) for found in document.faults]
    if document.readable:
        faults += schema_faults(model, document, document.data, source)
    if faults:
        raise InputError(sort_faults(faults))
    return model.model_validate(document.data), source


def varied_keys(sweep: Sweep) -> dict[str, KeyPath]:
    """Keys that a sweep varies, in the order of its runs' columns, with the first place each is written at."""
    places: dict[str, KeyPath] = {}
    for key, place in _places(sweep):
        places.setdefault(key, place)
    return places


def _places(sweep: Sweep) -> Iterator[tuple[str, KeyPath]]:
    """Every place of every varied key; a key of `list` has one in each row."""
    for part, columns in (("grid", sweep.grid), ("zip", sweep.zip)):
        yield from ((key, ("sweep", part, key)) for key in columns or {})
    for index, row in enumerate(sweep.list or []):
        yield from ((key, ("sweep", "list", index, key)) for key in row)
    if sweep.latin_hypercube is not None:
        yield from ((key, ("sweep", "latin_hypercube", "ranges", key)) for key in sweep.latin_hypercube.ranges)


def _study_findings(loaded: LoadedStudy) -> Iterator[Finding]:
    study = loaded.study
    yield from scene_file_findings(loaded.scene_path, study.scene)
    yield from _repeated_keys(loaded)
    lengths = {key: len(values) for key, values in (study.sweep.zip or {}).items()}
    first = next(iter(lengths), "")
    for key, length in lengths.items():
        if length != lengths[first]:
            message = f"has {length} values, but {first} has {lengths[first]}; zip takes one of each at a time"
            yield Finding(("sweep", "zip", key), message)
    n_runs = count_runs(study.sweep)
    if n_runs > MAX_RUNS:
        yield Finding(("sweep",), f"makes {n_runs} runs; a study may have {MAX_RUNS}")


def count_runs(sweep: Sweep) -> int:
    """Number of runs that a sweep makes: the product over its parts."""
    count = math.prod(len(values) for values in (sweep.grid or {}).values())
    if sweep.zip is not None:
        count *= len(next(iter(sweep.zip.values())))
    if sweep.list is not None:
        count *= len(sweep.list)
    if sweep.latin_hypercube is not None:
        count *= sweep.latin_hypercube.samples
    return count


def scene_file_findings(path: Path, written: str) -> Iterator[Finding]:
    """What is wrong with the scene file that a study names under `scene`, as it is `written` there."""
    try:
        if path.is_file():
            return
        beside = [item.name for item in path.parent.iterdir()] if path.parent.is_dir() else []
    except (OSError, ValueError) as error:
        yield Finding(("scene",), f"cannot be read: {getattr(error, 'strerror', None) or error}")
        return
    if path.is_dir():
        yield Finding(("scene",), f"{written} is a folder, not a scene file")
        return
    hint = did_you_mean(path.name, beside)
    message = f"there is no file {written} (relative to the study file)"
    yield Finding(("scene",), message + (f"; {hint}" if hint.startswith("did") else ""))


def _repeated_keys(loaded: LoadedStudy) -> Iterator[Finding]:
    """Keys that more than one part of the study gives a value; rows of `list` are one part."""
    study = loaded.study
    first: dict[KeyPath | None, KeyPath] = {}
    given: list[tuple[str, KeyPath]] = [(key, ("set", key)) for key in study.set]
    for key, place in [*given, *_places(study.sweep)]:
        path = scene_key(key)
        earlier = first.setdefault(path, place)
        if earlier == place or _in_other_rows(earlier, place):
            continue
        line = loaded.source.line(earlier)
        yield Finding(place, f"is given a value already in line {line}, at {format_key(earlier[:2])}")


def _in_other_rows(a: KeyPath, b: KeyPath) -> bool:
    return a[:2] == b[:2] == ("sweep", "list") and a[2] != b[2]
