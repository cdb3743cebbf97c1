"""Builds the meshes of a scene once, and reports what is wrong with them at the line of their key.

A check of a scene should take less than a second, and mostly needs the names of a mesh's groups only. Where
the mesh itself would take longer, a coarse one of the same recipe stands for it.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from femdeform import registry
from femdeform.errors import Fault, InputError
from femdeform.scene.key_path import KeyPath
from femdeform.scene.load import LoadedScene, sort_faults
from femdeform.scene.mesh_schema import FileMesh, MeshSource
from femdeform.scene.wording import did_you_mean
from femdeform.types import Mesh

# Above these a recipe takes longer than a check may: cells of a structured one, and elements along the
# longest edge of one that is meshed by gmsh.
_QUICK_CELLS = 50_000
_QUICK_ALONG = 25.0
_COARSE_ALONG = 12.0
# Selections by place need the real nodes; for them a check takes its time, up to this factor.
_PATIENCE = 20.0

# What the meshes under a key of a scene are of, in messages.
_SUBJECTS = {"bodies": "body", "solids": "solid", "walls": "wall"}

_SIZES = ("element_size", "hole_element_size", "plate_element_size")
_NOT_LENGTHS = (*_SIZES, "recipe", "translate", "rotate", "scale")


@dataclass(frozen=True)
class MeshSurvey:
    """Meshes for a check.

    Attributes
    ----------
    meshes : dict of str to Mesh
        By body; a body without a mesh has a fault.
    coarse : frozenset of str
        Bodies with a coarse mesh in place of the one a run would build.
    faults : list of Fault
        What keeps bodies from having a mesh.
    """

    meshes: dict[str, Mesh]
    coarse: frozenset[str]
    faults: list[Fault]


def load_meshes(loaded: LoadedScene) -> dict[str, Mesh]:
    """Build and check every mesh that a scene names, or return what was built before.

    Parameters
    ----------
    loaded : LoadedScene
        The scene; its `meshes` are filled, its `notices` get a line for all that was changed or is odd.

    Returns
    -------
    dict of str to Mesh
        By body, or by what else they are of, in the order of the scene.

    Raises
    ------
    InputError
        With one fault for everything that keeps one of them from being built.
    MissingDependencyError
        If a mesh needs a library that is not installed.
    """
    faults: list[Fault] = []
    sources = loaded.scene.mesh_sources()
    for name, (key, source) in sources.items():
        if name not in loaded.meshes:
            faults += _build(loaded, name, key, source)
    if faults:
        raise InputError(sort_faults(faults))
    return {name: loaded.meshes[name] for name in sources}


def survey_meshes(loaded: LoadedScene) -> MeshSurvey:
    """Build what a check needs: real meshes where that is quick or unavoidable, coarse ones elsewhere."""
    meshes: dict[str, Mesh] = {}
    faults: list[Fault] = []
    coarse: set[str] = set()
    needed = _needed_as_they_are(loaded)
    for name, (key, source) in loaded.scene.mesh_sources().items():
        substitute = _coarsened(source, _PATIENCE if needed(name) else 1.0)
        if substitute is not None and name not in loaded.meshes:
            try:
                meshes[name] = registry.resolve(registry.MESH["build"])(substitute, loaded.base_dir)
                coarse.add(name)
                continue
            except InputError:
                pass  # whether the mesh itself is at fault only the mesh itself can tell
        found = [] if name in loaded.meshes else _build(loaded, name, key, source)
        faults += found
        if not found:
            meshes[name] = loaded.meshes[name]
        elif source.rotate is not None or source.translate is not None:
            # If only its placement is at fault, the rest of the scene can still be judged.
            with contextlib.suppress(InputError, MemoryError):
                unplaced = source.model_copy(update={"rotate": None, "translate": None})
                meshes[name] = registry.resolve(registry.MESH["build"])(unplaced, loaded.base_dir)
                coarse.add(name)
    return MeshSurvey(meshes, frozenset(coarse), sort_faults(faults))


def _needed_as_they_are(loaded: LoadedScene) -> Callable[[str], bool]:
    """Whether places are selected in a body, so that a check needs the nodes that a run will have."""
    if loaded.scene.simulation != "deformable":
        return lambda name: False
    scene = loaded.scene
    placed: list[Any] = [*scene.conditions, *scene.measure.values(), *scene.expect.displacement, *scene.expect.reaction]
    selections = [block.on for block in placed if getattr(block, "on", None) is not None]
    by_point = any(getattr(block, "at", None) is not None for block in placed)
    return lambda name: by_point or any(not isinstance(on, str) and on.body in (None, name) for on in selections)


def _build(loaded: LoadedScene, name: str, key: KeyPath, source: MeshSource) -> list[Fault]:
    """Build, check and keep a mesh; returns the faults that prevent it."""
    subject = f"{_SUBJECTS[str(key[0])]} {name}"
    try:
        mesh, notices = build_source(loaded, key, source, subject)
    except InputError as error:
        return list(error.faults)
    loaded.meshes[name] = mesh
    loaded.notices.extend(f"{subject}: {text}" for text in notices)
    return []


def build_source(loaded: LoadedScene, key: KeyPath, source: MeshSource, subject: str) -> tuple[Mesh, list[str]]:
    """Build and check the mesh that a block of a scene describes.

    Parameters
    ----------
    loaded : LoadedScene
        The scene.
    key : tuple of str or int
        Where the block stands.
    source : MeshSource
        The block.
    subject : str
        What the mesh is of, for messages.

    Returns
    -------
    mesh : Mesh
    notices : list of str
        What had to be changed, and what is odd about it.

    Raises
    ------
    InputError
        With the line of the block, or of the key that is to blame.
    """
    if isinstance(source, FileMesh):
        problem = _missing_file(loaded, source)
        if problem:
            raise InputError([loaded.fault((*key, "file"), problem)])
    notices: list[str] = []
    try:
        mesh = registry.resolve(registry.MESH["build"])(source, loaded.base_dir, notices)
        mesh, found = registry.resolve(registry.MESH["check"])(mesh, subject)
    except InputError as error:
        raise InputError([_located(loaded, key, source, fault.message) for fault in error.faults]) from None
    except MemoryError:
        raise InputError([loaded.fault(key, "the mesh does not fit into memory")]) from None
    return mesh, [*notices, *found]


def _located(loaded: LoadedScene, key: KeyPath, source: MeshSource, message: str) -> Fault:
    """Return a fault at the key of the mesh block that a message starts with, else at the block or file."""
    word, colon, rest = message.removeprefix("mesh: ").partition(": ")
    if colon and word in type(source).model_fields:
        return loaded.fault((*key, word), rest)
    if isinstance(source, FileMesh):
        return loaded.fault((*key, "file"), f"{source.file}: {message}")
    return loaded.fault(key, message)


def _missing_file(loaded: LoadedScene, source: FileMesh) -> str:
    """Why the mesh file cannot be there, or an empty text."""
    path = loaded.base_dir / source.file
    try:
        if path.is_file():
            return ""
        if path.is_dir():
            return f"{source.file} is a folder, not a mesh file"
        beside = [item.name for item in path.parent.iterdir() if item.is_file()] if path.parent.is_dir() else []
    except (OSError, ValueError) as error:
        return f"cannot be read: {getattr(error, 'strerror', None) or error}"
    hint = did_you_mean(path.name, beside)
    return f"there is no file {source.file} beside the scene" + (f"; {hint}" if hint.startswith("did") else "")


def _coarsened(source: MeshSource, patience: float) -> MeshSource | None:
    """Return the same recipe with few cells and the same groups; None if the recipe is quick as it is."""
    if isinstance(source, FileMesh):
        return None
    values = {str(key): value for key, value in source}
    # A net of rods is cut out of a grid with `segments` squared cells an opening.
    counts = [values[key] for key in ("cells", "meshes", "segments", "segments") if key in values]
    if counts:
        cells = math.prod(math.prod(count) if isinstance(count, tuple) else count for count in counts)
        if cells <= patience * _QUICK_CELLS:
            return None
        update: dict[str, Any] = {
            # Four cells keep the middle node that an even number has.
            key: tuple(min(n, 4) for n in values[key]) if isinstance(values[key], tuple) else min(values[key], 4)
            for key in ("cells", "meshes", "segments")
            if key in values
        }
        return source.model_copy(update=update)
    longest = max(_lengths(values), default=0.0)
    finest = min(values[key] for key in _SIZES if values.get(key) is not None)
    along = _QUICK_ALONG * patience ** (1.0 / 3.0)
    if longest <= along * finest:
        return None
    smallest = longest / _COARSE_ALONG
    update = {key: max(values[key], smallest) for key in _SIZES if values.get(key) is not None}
    return source.model_copy(update=update)


def _lengths(values: dict[str, Any]) -> list[float]:
    """Every number of a recipe that measures the body."""
    numbers: list[float] = []
    for key, value in values.items():
        if key not in _NOT_LENGTHS:
            entries = value if isinstance(value, tuple) else (value,)
            numbers += [entry for entry in entries if isinstance(entry, float)]
    return numbers
