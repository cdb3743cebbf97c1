"""Reading mesh files by their extension into `MeshParts`, and CAD solids by meshing them."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from femdeform.errors import FemdeformError
from femdeform.types import FloatArray, IntArray
from meshes.gmsh_session import FINEST, gmsh_session, guard_cell_count, model_measures, read_parts
from meshes.grid_formats import numbered_parts, read_grid
from meshes.parts import PART_SIZES, MeshParts, NamedPart, PartKind, fault
from meshes.text_formats import read_medit, read_obj


def _read_msh(path: Path, name: str) -> MeshParts:
    with gmsh_session(name) as gmsh:
        gmsh.merge(str(path))
        return read_parts(gmsh, name)


def read_step(path: Path, name: str, element_size: float | None, scale: float) -> MeshParts:
    """Tetrahedralise the solids of a STEP file; the file's own length unit is converted to metres.

    Parameters
    ----------
    path : Path
        The file.
    name : str
        Name for messages.
    element_size : float, optional
        Edge length aimed at, after scaling [m]; default a twentieth of the bounding box's diagonal.
    scale : float
        Factor that will be applied to the points.

    Returns
    -------
    MeshParts
        With parts ``surface_1``, ... and ``volume_1``, ... for every CAD surface and solid; solids that touch
        share their nodes.
    """
    millimetre = 1e-3
    text = path.read_bytes()
    # Told here because the geometry kernel prints its complaints instead of returning them.
    if not text.lstrip().startswith(b"ISO-10303-21") or b"END-ISO-10303-21" not in text[-4096:]:
        raise fault(name, "not a STEP file, or cut off")
    with gmsh_session(name) as gmsh:
        # Millimetres are what CAD programs work in, and what the geometry kernel's tolerances are made for.
        gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
        gmsh.model.occ.importShapes(str(path))
        gmsh.model.occ.synchronize()
        solids = gmsh.model.getEntities(3)
        if not solids:
            raise fault(name, "no solids in it; only solids can be filled with tetrahedra")
        if len(solids) > 1:
            gmsh.model.occ.fragment(solids, [])
            gmsh.model.occ.synchronize()
        box = np.array(gmsh.model.getBoundingBox(-1, -1)).reshape(2, 3)
        size = float(np.linalg.norm(box[1] - box[0])) / 20.0
        if element_size is not None:
            size = element_size / scale / millimetre
        guard_cell_count(name, model_measures(gmsh), size, size * scale * millimetre)
        gmsh.option.setNumber("Mesh.MeshSizeMin", FINEST * size)
        gmsh.option.setNumber("Mesh.MeshSizeMax", size)
        gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 8)
        gmsh.model.mesh.generate(3)
        parts = read_parts(gmsh, name, unnamed=True)
    return MeshParts(parts.points * millimetre, parts.cells, parts.named, parts.notices)


def _read_npz(path: Path, name: str) -> MeshParts:
    kinds: dict[str, PartKind] = {
        "tets": "tetra",
        "tetra": "tetra",
        "triangles": "triangle",
        "lines": "line",
        "edges": "line",
    }
    with np.load(path, allow_pickle=False) as archive:
        arrays = {key: archive[key] for key in archive.files}
    if "points" not in arrays:
        raise fault(name, f"no array `points` in it, only {', '.join(sorted(arrays)) or 'nothing'}")
    points = np.asarray(arrays.pop("points"), dtype=np.float64)
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise fault(name, f"array `points` has the shape {points.shape}, not (n, 2) or (n, 3)")
    cells: dict[PartKind, IntArray] = {}
    for key in list(arrays):
        if key == "cells" and arrays[key].ndim == 2:
            sizes = {size: kind for kind, size in PART_SIZES.items()}
            kind = sizes.get(arrays[key].shape[1])
        else:
            kind = kinds.get(key)
        if kind is None:
            continue
        array = arrays.pop(key)
        if not np.issubdtype(array.dtype, np.integer) or array.shape[1:] != (PART_SIZES[kind],):
            raise fault(name, f"array `{key}` is not an integer array of shape (n, {PART_SIZES[kind]})")
        cells[kind] = array.astype(np.int64)
    if not cells:
        raise fault(name, "no array `tets`, `triangles`, `lines` or `cells` in it")
    highest = max(cells, key=lambda kind: PART_SIZES[kind])
    named: list[NamedPart] = []
    vectors: dict[tuple[str, PartKind], FloatArray] = {}
    for key, array in arrays.items():
        if np.issubdtype(array.dtype, np.floating) and array.shape in [(len(cells[highest]), k) for k in (2, 3)]:
            vectors[key, highest] = array.astype(np.float64)
        if array.ndim != 1 or not np.issubdtype(array.dtype, np.integer):
            continue
        rows = array.astype(np.int64)
        if len(rows) and (rows.min() < 0 or rows.max() >= len(cells[highest])):
            raise fault(name, f"array `{key}` has indices outside 0..{len(cells[highest]) - 1}")
        named.append(NamedPart(key, highest, rows))
    return MeshParts(points, cells, named, vectors=vectors)


def _read_obj(path: Path, name: str) -> MeshParts:
    return read_obj(path.read_text(encoding="utf-8", errors="replace"), name)


def _read_medit(path: Path, name: str) -> MeshParts:
    points, cells, references = read_medit(path.read_text(encoding="utf-8", errors="replace"), name)
    named = [part for kind in cells for part in numbered_parts(kind, references[kind])]
    return MeshParts(points, cells, named)


READERS: dict[str, Callable[[Path, str], MeshParts]] = {
    ".msh": _read_msh,
    ".mesh": _read_medit,
    ".vtk": read_grid,
    ".vtu": read_grid,
    ".stl": read_grid,
    ".ply": read_grid,
    ".obj": _read_obj,
    ".npz": _read_npz,
}

STEP_SUFFIXES = (".step", ".stp")


def read_parts_of(path: Path, name: str) -> MeshParts:
    """Read a mesh file by its extension.

    Parameters
    ----------
    path : Path
        The file.
    name : str
        Name for messages, usually the path as the user gave it.

    Raises
    ------
    MeshError
        If the file is missing, of an unknown format, or not what its extension says.
    """
    suffix = path.suffix.lower()
    if suffix not in READERS:
        known = " ".join(sorted([*READERS, *STEP_SUFFIXES]))
        raise fault(name, f"unknown mesh format `{suffix}`; known: {known}")
    check_exists(path, name)
    try:
        return READERS[suffix](path, name)
    except FemdeformError:
        raise
    except (MemoryError, zipfile.BadZipFile, OSError) as error:
        raise fault(name, f"cannot be read: {error}") from None
    except Exception as error:
        # Readers of broken files fail with whatever they stumble over: a missing key, a short array, bad XML.
        reason = " ".join(str(error).split()) or type(error).__name__
        raise fault(name, f"cannot be read as {suffix} file: {reason}") from None


def check_exists(path: Path, name: str) -> None:
    """Raise a MeshError if there is no such file."""
    try:
        found, folder = path.is_file(), path.is_dir()
    except (OSError, ValueError) as error:  # a name too long, or with characters no name can have
        raise fault(name, f"not a file name: {error}") from None
    if not found:
        raise fault(name, "is a directory, not a file" if folder else "no such file")


def as_plane(points: FloatArray, name: str) -> FloatArray:
    """Drop the z coordinate of points that all have the same one.

    Raises
    ------
    MeshError
        If z is not constant.
    """
    if points.shape[1] == 2:
        return points
    z = points[:, 2]
    spread = float(np.ptp(z)) if len(z) else 0.0
    if not spread <= 1e-9 * float(np.ptp(points, axis=0).max(initial=0.0)):
        raise fault(name, f"dim: 2 needs a flat mesh, but z ranges over {spread:g} m")
    return np.ascontiguousarray(points[:, :2])


def in_space(vectors: FloatArray, dim: int) -> FloatArray:
    """Vectors (n, k) with as many components as the points have: the last ones dropped, or zero."""
    out = np.zeros((len(vectors), dim))
    k = min(dim, vectors.shape[1])
    out[:, :k] = vectors[:, :k]
    return out
