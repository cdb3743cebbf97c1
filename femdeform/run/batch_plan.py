"""From a study to its runs: every combination of values, as overrides of the scene."""

from __future__ import annotations

import inspect
import itertools
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from femdeform.scene.batch_schema import LatinHypercube, LoadedStudy, Range, Study, Sweep, scene_key
from femdeform.scene.key_path import KeyPath
from femdeform.scene.overrides import shortened
from femdeform.types import FloatArray

# Sampled values are rounded to this many digits: they stay readable, and the same on every machine.
_DIGITS = 8
_NAME_LENGTH = 12


def short_keys(keys: Sequence[str]) -> dict[str, str]:
    """Each key by as many of its last parts as tell it from the others: ``rate`` for ``conditions[0].rate``."""
    parts = {key: key.split(".") for key in keys}

    def shortened(key: str) -> str:
        for count in range(1, len(parts[key])):
            if all(parts[other][-count:] != parts[key][-count:] for other in keys if other != key):
                return ".".join(parts[key][-count:])
        return key

    return {key: shortened(key) for key in keys}


class Choice(NamedTuple):
    """A key of the scene, the value it gets, and the place in the study that says so."""

    key: str
    value: Any
    place: KeyPath

    @property
    def override(self) -> str:
        """The choice as ``--set`` takes it; JSON is YAML."""
        return f"{self.key}={json.dumps(self.value, ensure_ascii=False, allow_nan=False)}"

    def __str__(self) -> str:
        return shortened(f"{self.key}={shown_value(self.value)}")


def shown_value(value: Any) -> str:
    """A value of a scene on one line: text as it is, everything else as JSON."""
    text = " ".join(value.split()) if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
    return "".join(c if c.isprintable() else json.dumps(c)[1:-1] for c in text)


@dataclass(frozen=True)
class PlannedRun:
    """One run of a study.

    Attributes
    ----------
    number : int
        Place in the study, from 1.
    varied : tuple of Choice
        What this run has of its own.
    fixed : tuple of Choice
        What all runs of the study have.
    hash : str
        SHA-256 of the scene's data after the overrides and of the mesh files it names, in hexadecimal.
    """

    number: int
    varied: tuple[Choice, ...]
    fixed: tuple[Choice, ...] = ()
    hash: str = ""

    @property
    def name(self) -> str:
        """Name of the run's folder."""
        return self.hash[:_NAME_LENGTH]

    @property
    def choices(self) -> tuple[Choice, ...]:
        """All choices in the order in which they are applied: a block before the keys inside it."""
        return tuple(sorted((*self.fixed, *self.varied), key=lambda choice: len(scene_key(choice.key) or ())))

    @property
    def overrides(self) -> tuple[str, ...]:
        """The run's ``--set`` values."""
        return tuple(choice.override for choice in self.choices)

    @property
    def label(self) -> str:
        """What this run has of its own, on one line."""
        return ", ".join(map(str, self.varied))


@dataclass(frozen=True)
class Plan:
    """All runs of a study, each with its hash.

    Attributes
    ----------
    study : LoadedStudy
        Where they come from.
    keys : tuple of str
        The keys that are varied, in the order of their columns.
    runs : tuple of PlannedRun
        In the order of the study; two may have the same hash.
    scalars : tuple of str
        Numbers of ``result.json`` to list for each run; those of its `quantities` without that prefix.
    expected : tuple of str
        The one of them that each entry of the study's `expect` is about.
    """

    study: LoadedStudy
    keys: tuple[str, ...]
    runs: tuple[PlannedRun, ...]
    scalars: tuple[str, ...]
    expected: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """Title of the study, or the name of its file."""
        return self.study.study.title or self.study.path.stem

    @cached_property
    def short_keys(self) -> dict[str, str]:
        """Names of the keys for messages."""
        return short_keys(self.keys)

    def label(self, run: PlannedRun) -> str:
        """What tells a run from the others, on one line."""
        return ", ".join(str(choice._replace(key=self.short_keys[choice.key])) for choice in run.varied)

    @cached_property
    def distinct(self) -> dict[str, PlannedRun]:
        """The first run of every name."""
        found: dict[str, PlannedRun] = {}
        for run in self.runs:
            found.setdefault(run.name, run)
        return found


def expand(study: Study) -> list[PlannedRun]:
    """All runs of a study, in order, still without hashes.

    The parts of the sweep combine as a product, in the order grid, zip, list, latin_hypercube; the last one
    varies fastest, as does the last key of a grid.
    """
    parts = [rows for rows in _parts(study.sweep) if rows is not None]
    fixed = tuple(Choice(key, value, ("set", key)) for key, value in study.set.items())
    return [
        PlannedRun(number, tuple(itertools.chain.from_iterable(rows)), fixed)
        for number, rows in enumerate(itertools.product(*parts), start=1)
    ]


_Row = tuple[Choice, ...]


def _parts(sweep: Sweep) -> Iterator[list[_Row] | None]:
    def column(part: str, key: str, values: Sequence[Any]) -> list[Choice]:
        return [Choice(key, value, ("sweep", part, key, index)) for index, value in enumerate(values)]

    if sweep.grid is not None:
        yield list(itertools.product(*(column("grid", *item) for item in sweep.grid.items())))
    if sweep.zip is not None:
        yield list(zip(*(column("zip", *item) for item in sweep.zip.items()), strict=True))
    if sweep.list is not None:
        yield [
            tuple(Choice(key, value, ("sweep", "list", index, key)) for key, value in row.items())
            for index, row in enumerate(sweep.list)
        ]
    if sweep.latin_hypercube is not None:
        yield _sampled(sweep.latin_hypercube)


def _sampled(wanted: LatinHypercube) -> list[_Row]:
    points = latin_hypercube(len(wanted.ranges), wanted.samples, wanted.seed)
    columns = []
    for (key, limits), column in zip(wanted.ranges.items(), points.T, strict=True):
        place: KeyPath = ("sweep", "latin_hypercube", "ranges", key)
        columns.append([Choice(key, in_range(limits, float(u)), place) for u in column])
    return list(zip(*columns, strict=True))


def latin_hypercube(dim: int, samples: int, seed: int) -> FloatArray:
    """Points of the unit cube, (samples, dim): one in each of `samples` equal slices of every axis."""
    from scipy.stats import qmc

    # SciPy renames the argument.
    name = "rng" if "rng" in inspect.signature(qmc.LatinHypercube.__init__).parameters else "seed"
    points = qmc.LatinHypercube(dim, **{name: np.random.default_rng(seed)}).random(samples)
    return np.asarray(points, dtype=np.float64)


def in_range(limits: Range, u: float) -> float | int:
    """Value of a range at a position `u` in [0, 1)."""
    # Of whole numbers each takes an interval of its own.
    low, high = limits.min, limits.max + (1.0 if limits.integer else 0.0)
    value = low * (high / low) ** u if limits.scale == "log" else low + u * (high - low)
    if limits.integer:
        return int(min(np.floor(value), limits.max))
    return float(min(max(float(f"{value:.{_DIGITS}g}"), limits.min), limits.max))
