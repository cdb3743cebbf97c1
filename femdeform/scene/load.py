"""YAML file to scene: text, overrides, schema; every fault at once, each with its line."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from femdeform.errors import Fault, InputError
from femdeform.scene.document import Document, read_document
from femdeform.scene.key_path import KeyPath, format_key
from femdeform.scene.overrides import Override, apply_overrides
from femdeform.types import Mesh

if TYPE_CHECKING:
    from femdeform.scene.kinds import AnyScene
    from femdeform.scene.schema import DeformableScene


@dataclass(frozen=True)
class Source:
    """Where each key of a scene came from: a line of its file, or an override.

    Attributes
    ----------
    file : str
        Path of the file as the user gave it.
    lines : mapping of path to int
        1-based line of every key of the file.
    origins : mapping of path to Override
        Values that were set on the command line.
    """

    file: str
    lines: Mapping[KeyPath, int]
    origins: Mapping[KeyPath, Override] = field(default_factory=dict)

    def line(self, key: KeyPath) -> int:
        """Line of a key, or of the closest key around it that the file holds; 1 for the whole file."""
        for length in range(len(key), 0, -1):
            if key[:length] in self.lines:
                return self.lines[key[:length]]
        return 1

    def fault(self, key: KeyPath, message: str) -> Fault:
        """Return a fault at a key, with the line or the override that it came from."""
        for length in range(len(key), 0, -1):
            # What an override has replaced had lines of its own, further in: they say nothing any more.
            if key[:length] in self.origins:
                return Fault(self.origins[key[:length]].source, 0, format_key(key), message)
        return Fault(self.file, self.line(key), format_key(key), message)


@dataclass(frozen=True)
class LoadedScene:
    """A scene that passed the schema.

    Attributes
    ----------
    scene : DeformableScene or another one of `femdeform.scene.kinds`
        The validated scene.
    path : Path
        The file it was read from.
    base_dir : Path
        Folder that the paths inside the scene are relative to.
    data : dict
        Plain data as given, after the overrides, without defaults: what ``resolved.yaml`` holds.
    hash : str
        SHA-256 of the canonical JSON of `data`, in hexadecimal.
    source : Source
        Lines of the keys.
    meshes : dict of str to Mesh
        Cache of `femdeform.scene.meshing.load_meshes`: meshes by body, as far as they were built.
    notices : list of str
        What had to be changed in the meshes, and what is odd about them.
    """

    scene: AnyScene
    path: Path
    base_dir: Path
    data: dict[str, Any]
    hash: str
    source: Source
    meshes: dict[str, Mesh] = field(default_factory=dict, compare=False, repr=False)
    notices: list[str] = field(default_factory=list, compare=False, repr=False)

    @property
    def deformable(self) -> DeformableScene:
        """The scene, where it is one of deformable bodies.

        Raises
        ------
        InputError
            If it is one of another kind.
        """
        if self.scene.simulation != "deformable":
            message = f"is for deformable bodies only, not for {self.scene.simulation}"
            raise InputError([self.fault(("simulation",), f"what was asked for {message}")])
        return self.scene

    def line(self, key: KeyPath) -> int:
        """Line of a key such as ``("bodies", "beam", "mesh")``."""
        return self.source.line(key)

    def fault(self, key: KeyPath, message: str) -> Fault:
        """Return a fault at a key, with its place in the file or on the command line."""
        return self.source.fault(key, message)


def load_scene(path: Path, overrides: Sequence[str] = ()) -> LoadedScene:
    """Read a scene file, apply overrides, validate.

    Parameters
    ----------
    path : Path
        The YAML file.
    overrides : sequence of str
        Each ``key=value``, as on the command line; later ones win.

    Returns
    -------
    LoadedScene
        The scene with the lines of its keys. What needs the meshes is not yet checked, see
        `femdeform.scene.checks.check_scene`.

    Raises
    ------
    InputError
        With every fault of the text, the overrides and the schema, sorted by line.
    """
    document = read_document(path)
    file = str(path)
    faults = [Fault(file, found.line, format_key(found.path), found.message) for found in document.faults]
    if not document.readable:
        raise InputError(sort_faults(faults))
    data, origins, problems = apply_overrides(document.data, overrides)
    from pydantic import TypeAdapter

    from femdeform.scene.kinds import Scene

    source = Source(file, document.lines, origins)
    faults += problems
    faults += schema_faults(Scene, document, data, source)
    if faults:
        raise InputError(sort_faults(faults))
    return LoadedScene(
        scene=TypeAdapter(Scene).validate_python(data),
        path=path,
        base_dir=path.parent,
        data=data,
        hash=scene_hash(data),
        source=source,
    )


def scene_hash(data: Any) -> str:
    """SHA-256 of plain data in canonical JSON: sorted keys, no spaces, ASCII."""
    text = json.dumps(data, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return hashlib.sha256(text.encode("ascii")).hexdigest()


def sort_faults(faults: Iterable[Fault]) -> list[Fault]:
    """Faults by file and line, without repetitions; what has no line (overrides) comes last."""
    return sorted(set(faults), key=lambda fault: (fault.line == 0, fault.file, fault.line, fault.key, fault.message))


def schema_faults(model: Any, document: Document, data: Any, source: Source) -> list[Fault]:
    """Everything about `data` that keeps it from being a `model`, where the text of the document is sound."""
    from femdeform.scene.validation import find_faults

    # Nothing is said about a placeholder, nor about a block as a whole that has one inside.
    hidden = [found.path for found in document.faults if found.hides]
    return [
        source.fault(found.path, found.message)
        for found in find_faults(model, data)
        if not any(_is_inside(found.path, path) or _is_inside(path, found.path) for path in hidden)
    ]


def _is_inside(path: KeyPath, block: KeyPath) -> bool:
    return path[: len(block)] == block
