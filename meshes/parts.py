"""From points, cells of several kinds and named parts, as files and generators have them, to one `Mesh`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from femdeform.errors import Fault, MeshError
from femdeform.types import CELL_SIZES, CellType, FloatArray, IntArray, Mesh
from meshes.boundary import boundary_facets, facet_counts, find_rows, unique_edges, used_nodes

PartKind = Literal["vertex", "line", "triangle", "tetra"]
PART_SIZES: dict[PartKind, int] = {"vertex": 1, "line": 2, "triangle": 3, "tetra": 4}
BY_DIMENSION: tuple[CellType, ...] = ("tetra", "triangle", "line")

Wanted = Literal["line", "triangle", "tetra", "surface", "edges"]


@dataclass(frozen=True)
class NamedPart:
    """Some cells of one kind under a name; `rows` indexes ``MeshParts.cells[kind]``."""

    name: str
    kind: PartKind
    rows: IntArray


@dataclass(frozen=True)
class MeshParts:
    """All that was read, before it is decided which cells make up the body.

    Attributes
    ----------
    points : (n_points, dim) float64
        Positions [m].
    cells : dict of str to (n, k) int64
        Nodes of the vertices, lines, triangles and tetrahedra that are there.
    named : list of NamedPart
        Named parts; several may share a name and a kind.
    notices : list of str
        What had to be changed while reading.
    vectors : dict of (str, str) to (n, k) float64
        Vectors of the cells by name and kind, a row for each of ``cells[kind]``.
    """

    points: FloatArray
    cells: dict[PartKind, IntArray]
    named: list[NamedPart] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)
    vectors: dict[tuple[str, PartKind], FloatArray] = field(default_factory=dict)


def fault(name: str, message: str) -> MeshError:
    """One fault of a mesh, under the name (a path, a body) the user knows it by."""
    return MeshError([Fault(name, 0, "", message)])


def assemble(parts: MeshParts, name: str, wanted: Wanted | None = None, drop_unreferenced: bool = False) -> Mesh:
    """Build the mesh of one kind of cells, with its boundary and its named groups.

    A named part of the cells' own kind becomes a cell group; one of their facets becomes a facet group as far
    as it lies on the boundary, oriented outward, and a node group where it lies inside (``NAME_interior`` if
    it has both); a part of lower dimension becomes a node group. Points that only cells of another kind use
    are left out.

    Parameters
    ----------
    parts : MeshParts
        What was read or generated.
    name : str
        Name for messages.
    wanted : str, optional
        Kind of cells to take; ``surface`` is the boundary of the tetrahedra, ``edges`` all edges of the cells
        of highest dimension. Default: the cells of highest dimension.
    drop_unreferenced : bool
        Remove points that nothing uses instead of keeping them (`check_mesh` calls them an error).

    Raises
    ------
    MeshError
        If there are no such cells, nodes out of range, or a named facet that belongs to no cell.
    """
    _check_ranges(parts, name)
    cell_type, cells = _choose(parts, name, wanted)
    keep = used_nodes(cells, len(parts.points))
    if not drop_unreferenced:
        other = np.zeros(len(parts.points), dtype=np.bool_)
        for kind, nodes in parts.cells.items():
            if kind != "vertex":
                other[nodes] = True
        keep |= ~other
    kept = np.flatnonzero(keep)
    new = np.full(len(parts.points), -1, dtype=np.int64)
    new[kept] = np.arange(len(kept))
    points = parts.points[kept]
    cells = new[cells]

    boundary = boundary_facets(cells, points)
    groups = _Groups()
    k = CELL_SIZES[cell_type]
    # Of a part of a file (its lines, say) it is no concern what else the file names.
    strict = wanted is None
    for part in _merged(parts.named):
        rows = new[parts.cells[part.kind][part.rows]]
        if rows.shape[1] == k:
            found = find_rows(cells, rows)
            if np.any(found >= 0):
                groups.cells[part.name] = np.unique(found[found >= 0])
        elif rows.shape[1] == k - 1:
            loose = _add_facets(groups, part.name, rows, cells, boundary)
            if strict and loose:
                message = f"group `{part.name}`: {loose} of its {len(rows)} facets belong to no cell"
                raise fault(name, message)
        elif rows.shape[1] < k:
            inside = np.unique(rows[rows >= 0])
            if len(inside):
                groups.nodes.setdefault(part.name, inside)
    if len(boundary):
        groups.facets["boundary"] = boundary
    vectors = {}
    if wanted not in ("surface", "edges"):
        vectors = {key: rows for (key, kind), rows in parts.vectors.items() if kind == cell_type}
    return Mesh(points, cells, cell_type, groups.facets, groups.cells, groups.nodes, vectors)


@dataclass(frozen=True)
class _Groups:
    facets: dict[str, IntArray] = field(default_factory=dict)
    cells: dict[str, IntArray] = field(default_factory=dict)
    nodes: dict[str, IntArray] = field(default_factory=dict)


def _check_ranges(parts: MeshParts, name: str) -> None:
    n = len(parts.points)
    for kind, nodes in parts.cells.items():
        outside = np.flatnonzero(np.any((nodes < 0) | (nodes >= n), axis=1)) if len(nodes) else nodes[:, 0]
        if len(outside):
            message = f"{kind} {outside[0]} has a node outside 0..{n - 1} ({len(outside)} such cells)"
            raise fault(name, message)


def _choose(parts: MeshParts, name: str, wanted: Wanted | None) -> tuple[CellType, IntArray]:
    present: list[CellType] = [kind for kind in BY_DIMENSION if len(parts.cells.get(kind, ()))]
    if not present:
        raise fault(name, "no lines, triangles or tetrahedra in it")
    if wanted is None:
        return present[0], parts.cells[present[0]]
    if wanted == "edges":
        return "line", unique_edges(parts.cells[present[0]])
    if wanted == "surface":
        if "tetra" not in present:
            raise fault(name, "no tetrahedra whose surface could be taken; use `cell_type: triangle`")
        return "triangle", boundary_facets(parts.cells["tetra"], parts.points)
    if wanted not in present:
        hint = "; all edges of its cells are `cell_type: edges`" if wanted == "line" else ""
        if wanted == "triangle" and "tetra" in present:
            hint = "; the surface of its tetrahedra is `cell_type: surface`"
        if wanted == "tetra" and "triangle" in present:
            hint = "; a closed surface is filled with `fill: true`"
        raise fault(name, f"no {wanted} cells in it, only {' and '.join(present)} cells{hint}")
    return wanted, parts.cells[wanted]


def _merged(named: list[NamedPart]) -> list[NamedPart]:
    """One part for each name and kind, highest dimension first."""
    rows: dict[tuple[str, PartKind], list[IntArray]] = {}
    for part in named:
        rows.setdefault((part.name, part.kind), []).append(part.rows)
    merged = [NamedPart(name, kind, np.unique(np.concatenate(found))) for (name, kind), found in rows.items()]
    return sorted(merged, key=lambda part: -PART_SIZES[part.kind])


def _add_facets(groups: _Groups, group: str, rows: IntArray, cells: IntArray, boundary: IntArray) -> int:
    """Sort facets into boundary and interior ones; return how many belong to no cell."""
    of_boundary = find_rows(boundary, rows)
    inner = rows[of_boundary < 0]
    outer = np.unique(of_boundary[of_boundary >= 0])
    loose = facet_counts(cells, inner) == 0
    inner = np.unique(inner[~loose])
    if len(outer):
        groups.facets[group] = boundary[outer]
    if len(inner):
        groups.nodes[f"{group}_interior" if len(outer) else group] = inner
    return int(np.count_nonzero(loose))
