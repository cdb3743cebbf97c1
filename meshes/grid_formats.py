"""Grids and surfaces in the formats that meshio and VTK read: .vtk .vtu .stl .ply."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from femdeform.types import FloatArray, IntArray
from meshes.parts import MeshParts, NamedPart, PartKind, fault

# Cell data of other programs that number regions; only these become groups, by their distinct values.
_REGION_ARRAYS = {"medit:ref", "gmsh:physical", "CellEntityIds", "MaterialIds", "material", "region"}
# Cell data of `meshes.writers`: 1 where a cell belongs to the group.
GROUP_PREFIX = "group:"

_REGION_WORDS: dict[PartKind, str] = {
    "vertex": "point",
    "line": "curve",
    "triangle": "surface",
    "tetra": "region",
}


def read_grid(path: Path, name: str) -> MeshParts:
    """Read a .vtk, .vtu, .stl or .ply file.

    Raises
    ------
    MeshError
        If it holds other cells than points, lines, triangles, quadrilaterals and tetrahedra.
    """
    import meshio

    suffix = path.suffix.lower()
    if suffix == ".vtk" and b"POLYDATA" in path.read_bytes()[:1024]:
        return _read_polydata(path)
    module = {".vtk": "vtk", ".vtu": "vtu", ".stl": "stl", ".ply": "ply"}[suffix]
    # The reader of the format itself: meshio.read() ends the process when a file cannot be read.
    reader: Callable[[str], Any] = getattr(meshio, module).read
    # Its guess at the flavour of a file may overflow harmlessly.
    with contextlib.redirect_stdout(io.StringIO()), np.errstate(all="ignore"):
        content = reader(str(path))
    return _parts_of(content, name)


def _read_polydata(path: Path) -> MeshParts:
    """Lines and polygons of a legacy VTK surface, which meshio does not read."""
    import pyvista

    surface = pyvista.read(str(path))
    cells: dict[PartKind, IntArray] = {}
    strips = surface.GetLines()
    if strips.GetNumberOfCells():
        nodes = np.asarray(pyvista.convert_array(strips.GetConnectivityArray()), dtype=np.int64)
        offsets = np.asarray(pyvista.convert_array(strips.GetOffsetsArray()), dtype=np.int64)
        within = np.ones(len(nodes), dtype=np.bool_)
        within[offsets[1:] - 1] = False  # the last node of a polyline starts no segment
        first = np.flatnonzero(within)
        cells["line"] = np.stack([nodes[first], nodes[first + 1]], axis=1)
    if surface.GetPolys().GetNumberOfCells() or surface.GetStrips().GetNumberOfCells():
        triangles = surface.triangulate().GetPolys().GetConnectivityArray()
        cells["triangle"] = np.asarray(pyvista.convert_array(triangles), dtype=np.int64).reshape(-1, 3)
    return MeshParts(np.asarray(surface.points, dtype=np.float64), cells)


def _parts_of(content: Any, name: str) -> MeshParts:
    """Take points, cells, quadrilaterals cut in two, and groups out of a ``meshio.Mesh``."""
    points = np.asarray(content.points, dtype=np.float64)
    chunks: dict[PartKind, list[IntArray]] = {}
    # For each chunk, the row of its block that every cell came from.
    origins: list[tuple[PartKind, int, IntArray]] = []
    notices: list[str] = []
    for block in content.cells:
        nodes = np.asarray(block.data, dtype=np.int64)
        kind: PartKind
        if block.type == "quad":
            rows = np.repeat(np.arange(len(nodes)), 2)
            nodes = nodes[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
            kind = "triangle"
            notices.append(f"{len(rows) // 2} quadrilaterals cut into two triangles each")
        elif block.type in _REGION_WORDS:
            kind = block.type
            rows = np.arange(len(nodes))
        else:
            message = f"{len(nodes)} cells of type `{block.type}`"
            raise fault(name, f"{message}: only lines, triangles and tetrahedra can be read")
        chunks.setdefault(kind, [])
        start = sum(len(chunk) for chunk in chunks[kind])
        origins.append((kind, start, rows))
        chunks[kind].append(nodes)
    cells = {kind: np.concatenate(blocks) for kind, blocks in chunks.items()}
    named: list[NamedPart] = []
    vectors = _vectors(content, origins)
    for key, per_block in content.cell_data.items():
        for values, (kind, start, rows) in zip(per_block, origins, strict=True):
            array = np.asarray(values)
            if array.ndim != 1 or not np.issubdtype(array.dtype, np.integer):
                continue
            of_cells = array[rows]
            if key.startswith(GROUP_PREFIX):
                members = start + np.flatnonzero(of_cells)
                if len(members):
                    named.append(NamedPart(key.removeprefix(GROUP_PREFIX), kind, members))
            elif key in _REGION_ARRAYS:
                named += numbered_parts(kind, of_cells, start)
    return MeshParts(points, cells, named, notices, vectors)


def _vectors(content: Any, origins: list[tuple[PartKind, int, IntArray]]) -> dict[tuple[str, PartKind], FloatArray]:
    """Cell data with two or three components, where all cells of a kind have it."""
    found: dict[tuple[str, PartKind], FloatArray] = {}
    for key, per_block in content.cell_data.items():
        for wanted in {kind for kind, _, _ in origins}:
            arrays = [
                np.asarray(values, dtype=np.float64)[rows]
                for values, (kind, _, rows) in zip(per_block, origins, strict=True)
                if kind == wanted and np.ndim(values) == 2 and np.shape(values)[1] in (2, 3)
            ]
            if len(arrays) == sum(kind == wanted for kind, _, _ in origins):
                found[key, wanted] = np.concatenate(arrays)
    return found


def numbered_parts(kind: PartKind, numbers: IntArray, start: int = 0) -> list[NamedPart]:
    """Name cells by their reference numbers: ``region_1`` (tetrahedra), ``surface_2`` (triangles), ...

    Zero is the number of cells without one and names nothing.
    """
    return [
        NamedPart(f"{_REGION_WORDS[kind]}_{number}", kind, start + np.flatnonzero(numbers == number))
        for number in np.unique(numbers)
        if number != 0
    ]
