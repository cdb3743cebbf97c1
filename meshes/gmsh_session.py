"""The one door to gmsh: a session that is silent, repeatable and leaves nothing behind."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from femdeform.errors import MeshError, MissingDependencyError
from femdeform.types import IntArray
from meshes.boundary import row_keys
from meshes.parts import PART_SIZES, MeshParts, NamedPart, PartKind, fault

# gmsh is one global object and knows no threads: whoever uses it has to be alone with it.
_LOCK = threading.RLock()

_MODEL = "femdeform"

_OPTIONS: dict[str, float] = {
    "General.Terminal": 0,
    "General.NumThreads": 1,
    "Mesh.RandomSeed": 1,
    "Mesh.RandomFactor": 1e-9,
    "Mesh.Algorithm": 6,  # frontal Delaunay
    "Mesh.Algorithm3D": 1,  # Delaunay
    "Mesh.Optimize": 1,
    "Mesh.OptimizeNetgen": 0,
    "Mesh.ElementOrder": 1,
    "Mesh.MeshSizeMin": 0.0,
    "Mesh.MeshSizeMax": 1e22,
    "Mesh.MeshSizeFactor": 1.0,
    "Mesh.MeshSizeFromCurvature": 0,
    "Mesh.MeshSizeFromPoints": 1,
    "Mesh.MeshSizeExtendFromBoundary": 1,
    "Mesh.ScalingFactor": 1.0,
    "Mesh.SaveAll": 0,
    "Mesh.Binary": 0,
    "Geometry.Tolerance": 1e-8,
    "Geometry.ToleranceBoolean": 0.0,
}

_ELEMENTS: dict[int, PartKind] = {15: "vertex", 1: "line", 2: "triangle", 4: "tetra"}
# Measure of a regular simplex of edge 1: what a cell takes on average.
_SIMPLEX = {1: 1.0, 2: 0.433, 3: 0.118}
MAX_CELLS = 2_000_000
# Small radii are meshed finer than asked for, but not beyond this part of the element size.
FINEST = 0.02

_DIMENSION_WORDS = ("point", "curve", "surface", "volume")


@contextmanager
def gmsh_session(name: str) -> Iterator[Any]:
    """Give the gmsh module with an empty model of its own; restore everything afterwards.

    Works in any thread (one at a time) and inside a program that uses gmsh itself. No signal handler is
    installed and no configuration file is read; one thread and a fixed seed make every result repeatable.

    Parameters
    ----------
    name : str
        What is being meshed, for messages.

    Raises
    ------
    MissingDependencyError
        If gmsh, or a system library it needs, is not there.
    MeshError
        For whatever gmsh itself raises inside the block.
    """
    try:
        import gmsh
    except (ImportError, OSError) as error:
        message = f"gmsh is needed for `{name}` but cannot be loaded: {error}"
        raise MissingDependencyError(message) from None
    with _LOCK:
        foreign = bool(gmsh.isInitialized())
        if not foreign:
            gmsh.initialize(readConfigFiles=False, interruptible=False)
            _restore_signals()
        before = {option: gmsh.option.getNumber(option) for option in _OPTIONS} if foreign else {}
        current = gmsh.model.getCurrent() if foreign else ""
        _set_options(gmsh, _OPTIONS)
        gmsh.model.add(_MODEL)
        try:
            yield gmsh
        except (MeshError, MissingDependencyError):
            raise
        except Exception as error:
            # The interface of gmsh raises bare Exceptions; any other class is a bug here.
            if type(error) is not Exception:
                raise
            raise fault(name, f"gmsh failed: {_one_line(error)}") from None
        finally:
            if foreign:
                gmsh.model.setCurrent(_MODEL)
                gmsh.model.remove()
                if current:
                    gmsh.model.setCurrent(current)
                _set_options(gmsh, before)
            else:
                gmsh.finalize()


def _restore_signals() -> None:
    """Install Python's handlers again: gmsh resets some, and Python does not notice.

    Without this a run under nohup would end with the terminal, and a broken pipe end it without a word.
    """
    if threading.current_thread() is not threading.main_thread():
        return  # only the main thread may
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGPIPE):
        handler = signal.getsignal(number)
        if handler is not None:
            signal.signal(number, handler)


def _set_options(gmsh: Any, options: dict[str, float]) -> None:
    for option, value in options.items():
        gmsh.option.setNumber(option, value)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or "no reason given"


def read_parts(gmsh: Any, name: str, unnamed: bool = False) -> MeshParts:
    """Take points, cells and physical groups out of the current model.

    Parameters
    ----------
    gmsh : module
        As given by `gmsh_session`.
    name : str
        Name for messages.
    unnamed : bool
        Also name every surface and volume of the model, ``surface_1``, ``volume_1``, ... by its tag.

    Raises
    ------
    MeshError
        If there are cells other than points, lines, triangles and tetrahedra with straight edges.
    """
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    order = np.argsort(tags)
    tags = np.asarray(tags)[order].astype(np.int64)
    points = np.asarray(coordinates).reshape(-1, 3)[order]
    number = np.full(int(tags.max(initial=0)) + 1, -1, dtype=np.int64)
    number[tags] = np.arange(len(tags))

    chunks: dict[PartKind, list[IntArray]] = {}
    numbers: dict[PartKind, list[IntArray]] = {}
    of_entity: dict[tuple[int, int], list[tuple[PartKind, int]]] = {}
    for dim, tag in gmsh.model.getEntities():
        for element, ids, nodes in zip(*gmsh.model.mesh.getElements(dim, tag), strict=True):
            if element not in _ELEMENTS:
                kind_name = gmsh.model.mesh.getElementProperties(element)[0]
                message = (
                    f"{len(ids)} cells of type `{kind_name}`: only lines, triangles and tetrahedra of first "
                    "order can be read"
                )
                raise fault(name, message)
            kind = _ELEMENTS[element]
            table = number[np.asarray(nodes, dtype=np.int64)].reshape(-1, PART_SIZES[kind])
            rows_kept = np.arange(len(table))
            if len(gmsh.model.getPhysicalGroupsForEntity(dim, tag)) > 1:
                # Versions 1 and 2 of the file format repeat a cell for every physical group it is in.
                rows_kept = np.sort(np.unique(row_keys(table)[0], return_index=True)[1])
            of_entity.setdefault((dim, tag), []).append((kind, len(chunks.setdefault(kind, []))))
            chunks[kind].append(table[rows_kept])
            numbers.setdefault(kind, []).append(np.asarray(ids, dtype=np.int64)[rows_kept])

    cells: dict[PartKind, IntArray] = {}
    rows: dict[tuple[PartKind, int], IntArray] = {}
    for kind, blocks in chunks.items():
        order = np.argsort(np.concatenate(numbers[kind]), kind="stable")
        cells[kind] = np.concatenate(blocks)[order]
        place = np.empty(len(order), dtype=np.int64)
        place[order] = np.arange(len(order))
        starts = np.cumsum([0, *[len(block) for block in blocks]])
        for index in range(len(blocks)):
            rows[kind, index] = place[starts[index] : starts[index + 1]]

    named: list[NamedPart] = []
    for dim, physical in gmsh.model.getPhysicalGroups():
        label = gmsh.model.getPhysicalName(dim, physical) or f"{_DIMENSION_WORDS[dim]}_{physical}"
        for tag in gmsh.model.getEntitiesForPhysicalGroup(dim, physical):
            for kind, index in of_entity.get((dim, int(tag)), []):
                named.append(NamedPart(label, kind, rows[kind, index]))
    if unnamed:
        for (dim, tag), blocks_of in of_entity.items():
            if dim >= 2:
                label = f"{_DIMENSION_WORDS[dim]}_{tag}"
                named += [NamedPart(label, kind, rows[kind, index]) for kind, index in blocks_of]
    return MeshParts(points, cells, named)


def guard_cell_count(name: str, measures: dict[int, float], size: float, shown: float) -> None:
    """Refuse an element size that would give more cells than can be made in minutes.

    Parameters
    ----------
    name : str
        Name for messages.
    measures : dict of int to float
        Total length (1), area (2) and volume (3) of what will be meshed, in any unit of length.
    size : float
        Element size in the same unit.
    shown : float
        Element size as the user gave it [m].

    Raises
    ------
    MeshError
        If lines, triangles or tetrahedra would be more than `MAX_CELLS`.
    """
    count = max(measure / (_SIMPLEX[dim] * size**dim) for dim, measure in measures.items())
    if count > MAX_CELLS:
        message = f"element_size {shown:g} m would give about {count:.1e} cells (at most {MAX_CELLS:.0e})"
        raise fault(name, message)


def model_measures(gmsh: Any) -> dict[int, float]:
    """Total length, area and volume of the CAD model, for `guard_cell_count`."""
    return {
        dim: float(sum(gmsh.model.occ.getMass(*entity) for entity in gmsh.model.getEntities(dim))) for dim in (1, 2, 3)
    }
