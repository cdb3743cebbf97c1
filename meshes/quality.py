"""Judging a mesh before it is computed on: faults, repairs, and the quality of its cells.

The quality of a cell is its normalised mean ratio: 1 for a regular simplex, 0 for a flat one,
``12 (3 V)^(2/3) / sum l^2`` for tetrahedra and ``4 sqrt(3) A / sum l^2`` for triangles with edges l.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from femdeform.errors import Fault, MeshError
from femdeform.types import BoolArray, FloatArray, IntArray, Mesh
from meshes.boundary import (
    all_facets,
    edge_lengths_squared,
    measures,
    row_keys,
    signed_measures,
    unique_edges,
)

# A cell counts as flat when its measure is below this part of its longest edge's power (the worst slivers of
# meshes in use are six digits above it), or below what
# the rounding of its coordinates can make of an exactly flat one.
ZERO_MEASURE = 1e-13
_ROUNDING = 8.0 * float(np.finfo(np.float64).eps)
# Farther away is no place [m], and the volumes of cells there are out of range.
LARGEST = 1e30
# Cells below this quality are reported, not refused.
POOR_QUALITY = 1e-2

_SHOWN = 5
_WORDS = {"line": "lines", "triangle": "triangles", "tetra": "tetrahedra"}


@dataclass(frozen=True)
class EdgeStatistics:
    """Lengths of all edges of a mesh, each counted once [m]."""

    shortest: float
    mean: float
    longest: float


def cell_quality(points: FloatArray, cells: IntArray) -> FloatArray:
    """Normalised mean ratio of triangles or tetrahedra, in [0, 1], independent of orientation, (n_cells,)."""
    squares = edge_lengths_squared(points, cells).sum(axis=1)
    size = measures(points, cells)
    shape = 12.0 * np.cbrt(3.0 * size) ** 2 if cells.shape[1] == 4 else 4.0 * np.sqrt(3.0) * size
    quality = np.divide(shape, squares, out=np.zeros_like(shape), where=squares > 0.0)
    return np.asarray(quality, dtype=np.float64)


def quality_histogram(quality: FloatArray, n_bins: int = 10) -> tuple[IntArray, FloatArray]:
    """Counts of cells and bin edges over [0, 1]."""
    counts, edges = np.histogram(np.clip(quality, 0.0, 1.0), bins=n_bins, range=(0.0, 1.0))
    return counts.astype(np.int64), edges


def edge_statistics(mesh: Mesh) -> EdgeStatistics:
    """Shortest, mean and longest edge of a mesh."""
    lengths = np.sqrt(edge_lengths_squared(mesh.points, unique_edges(mesh.cells)))
    return EdgeStatistics(float(lengths.min()), float(lengths.mean()), float(lengths.max()))


def check_points(points: FloatArray, name: str) -> None:
    """Make sure that points can be computed with, before anything is.

    Parameters
    ----------
    points : (n, dim) float64
        Positions [m].
    name : str
        Name of the file, for messages.

    Raises
    ------
    MeshError
        Naming the first points, counted from 0, with a coordinate that is NaN, infinite or beyond `LARGEST`.
    """
    faults = _Faults(name)
    _check_coordinates(points, faults)
    faults.raise_if_any()


def check_mesh(mesh: Mesh, name: str) -> tuple[Mesh, list[str]]:
    """Check a mesh for everything that would spoil a computation, and turn inverted cells around.

    Parameters
    ----------
    mesh : Mesh
        The mesh.
    name : str
        Name of the body or file, for messages.

    Returns
    -------
    mesh : Mesh
        The same mesh, with inverted tetrahedra (3D) and triangles (2D) reoriented.
    notices : list of str
        Reoriented cells, slivers, coinciding points.

    Raises
    ------
    MeshError
        With one fault for each kind of defect, naming the first offenders and the total: nodes out of range,
        points that are not finite, zero-volume cells (below `ZERO_MEASURE` relative to the longest edge),
        duplicate cells, facets of more than two cells, unreferenced points, empty groups, group members that
        do not exist.
    """
    faults = _Faults(name)
    word = _WORDS[mesh.cell_type]
    if not mesh.n_cells:
        faults.add("no cells in it")
    if mesh.n_cells and (mesh.cells.min() < 0 or mesh.cells.max() >= mesh.n_points):
        wrong = np.any((mesh.cells < 0) | (mesh.cells >= mesh.n_points), axis=1)
        faults.list(wrong, f"{word} with nodes outside 0..{mesh.n_points - 1}", mesh.cells)
    _check_groups(mesh, faults)
    # What follows indexes by nodes and computes with points.
    faults.raise_if_any()

    _check_coordinates(mesh.points, faults)
    sound = not faults.found
    used = np.zeros(mesh.n_points, dtype=np.bool_)
    used[mesh.cells] = True
    hint = "; `drop_unreferenced: true` in the mesh block removes them"
    faults.list(~used, "unreferenced points (no cell uses them)", hint=hint)
    repeated = np.any(np.diff(np.sort(mesh.cells, axis=1), axis=1) == 0, axis=1)
    faults.list(repeated, f"{word} that use a node twice", mesh.cells)
    duplicate = _duplicates(mesh.cells)
    faults.list(duplicate, f"duplicate {word} (same nodes as an earlier one)", mesh.cells)
    if sound:
        flat = _flat(mesh) & ~repeated
        faults.list(flat, f"{_zero_word(mesh)} {word}", mesh.cells)
    if mesh.cells.shape[1] == mesh.dim + 1 and not np.any(duplicate):
        _check_shared_facets(mesh, faults)
    faults.raise_if_any()

    notices: list[str] = []
    mesh = _reoriented(mesh, word, notices)
    _notice_slivers(mesh, word, notices)
    _notice_coinciding(mesh, notices)
    return mesh, notices


class _Faults:
    def __init__(self, name: str) -> None:
        self.name = name
        self.found: list[Fault] = []

    def add(self, message: str) -> None:
        self.found.append(Fault(self.name, 0, "", message))

    def list(self, wrong: BoolArray, what: str, rows_of: IntArray | FloatArray | None = None, hint: str = "") -> None:
        """Add a fault for the marked cells or points, naming the first of them with their nodes or coordinates."""
        rows = np.flatnonzero(wrong)
        if not len(rows):
            return
        if rows_of is None:
            shown = ", ".join(str(row) for row in rows[:_SHOWN])
        else:
            word = "nodes" if np.issubdtype(rows_of.dtype, np.integer) else "at"
            shown = ", ".join(f"{row} ({word} {' '.join(map(str, rows_of[row]))})" for row in rows[:_SHOWN])
        more = ", ..." if len(rows) > _SHOWN else ""
        self.add(f"{len(rows)} {what}: {shown}{more}{hint}")

    def raise_if_any(self) -> None:
        if self.found:
            raise MeshError(self.found)


def _check_coordinates(points: FloatArray, faults: _Faults) -> None:
    finite = np.all(np.isfinite(points), axis=1)
    faults.list(~finite, "points (counted from 0) that are not finite", points)
    far = finite & ~np.all(np.abs(points) <= LARGEST, axis=1)
    faults.list(far, f"points (counted from 0) farther away than {LARGEST:g} m", points)


def _check_groups(mesh: Mesh, faults: _Faults) -> None:
    kinds = (
        ("facet", mesh.facet_groups, mesh.n_points),
        ("cell", mesh.cell_groups, mesh.n_cells),
        ("node", mesh.node_groups, mesh.n_points),
    )
    for kind, groups, limit in kinds:
        for group, members in groups.items():
            if not len(members):
                faults.add(f"{kind} group `{group}` is empty")
            elif members.min() < 0 or members.max() >= limit:
                faults.add(f"{kind} group `{group}` has members outside 0..{limit - 1}")


def _duplicates(cells: IntArray) -> BoolArray:
    """Cells with the same nodes as an earlier one."""
    _, first = np.unique(row_keys(cells)[0], return_index=True)
    wrong = np.ones(len(cells), dtype=np.bool_)
    wrong[first] = False
    return wrong


def _zero_word(mesh: Mesh) -> str:
    return {"line": "zero-length", "triangle": "zero-area", "tetra": "zero-volume"}[mesh.cell_type]


def _flat(mesh: Mesh) -> BoolArray:
    longest = np.sqrt(edge_lengths_squared(mesh.points, mesh.cells).max(axis=1))
    rounding = _ROUNDING * np.abs(mesh.points).max(axis=1)[mesh.cells].max(axis=1)
    limit = longest ** (mesh.cells.shape[1] - 2) * (ZERO_MEASURE * longest + rounding)
    return np.asarray(measures(mesh.points, mesh.cells) <= limit, dtype=np.bool_)


def _check_shared_facets(mesh: Mesh, faults: _Faults) -> None:
    facets = all_facets(mesh.cells)
    _, first, counts = np.unique(row_keys(facets)[0], return_index=True, return_counts=True)
    rows = np.sort(first[counts > 2])
    if len(rows):
        shown = ", ".join(" ".join(map(str, facets[row])) for row in rows[:_SHOWN])
        more = ", ..." if len(rows) > _SHOWN else ""
        faults.add(f"{len(rows)} facets belong to more than two cells, which overlap: nodes {shown}{more}")


def _reoriented(mesh: Mesh, word: str, notices: list[str]) -> Mesh:
    if mesh.cells.shape[1] != mesh.dim + 1:
        return mesh
    inverted = signed_measures(mesh.points, mesh.cells) < 0.0
    count = int(np.count_nonzero(inverted))
    if not count:
        return mesh
    cells = mesh.cells.copy()
    cells[inverted, -2:] = cells[inverted][:, [-1, -2]]
    notices.append(f"{count} of {mesh.n_cells} {word} were inverted and have been reoriented")
    return replace(mesh, cells=cells)


def _notice_slivers(mesh: Mesh, word: str, notices: list[str]) -> None:
    if mesh.cell_type == "line":
        return
    quality = cell_quality(mesh.points, mesh.cells)
    poor = int(np.count_nonzero(quality < POOR_QUALITY))
    if poor:
        worst = int(np.argmin(quality))
        notices.append(
            f"{poor} of {mesh.n_cells} {word} are slivers of quality below {POOR_QUALITY:g} "
            f"(smallest {quality[worst]:.1e}, {mesh.cell_type} {worst}): expect slow convergence there"
        )


def _notice_coinciding(mesh: Mesh, notices: list[str]) -> None:
    order = np.lexsort(mesh.points.T)
    ordered = mesh.points[order]
    same = int(np.count_nonzero(np.all(ordered[1:] == ordered[:-1], axis=1)))
    if same:
        notices.append(f"{same} points coincide with another one: the cells there are not connected")
