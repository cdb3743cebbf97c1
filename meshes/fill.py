"""Filling closed triangle surfaces with tetrahedra."""

from __future__ import annotations

import contextlib
import math
from typing import Any

import numpy as np

from femdeform.errors import MeshError
from femdeform.types import BoolArray, FloatArray, IntArray
from meshes.boundary import (
    all_facets,
    area_vectors,
    boundary_facets,
    connected_parts,
    edge_lengths_squared,
    measures,
    row_keys,
)
from meshes.gmsh_session import gmsh_session, guard_cell_count, read_parts
from meshes.parts import MeshParts, fault
from meshes.quality import cell_quality

# Before a surface is meshed anew it is split along edges sharper than this [rad]; rough ones may need the
# later entries, which keep fewer edges.
_SHARP = tuple(map(math.radians, (40.0, 80.0, 180.0)))
# A new surface counts only if its triangles are no worse, its volume is no farther from the old one, and no
# old point is farther from a new one than this many element sizes.
_WORST_QUALITY = 0.05
_VOLUME_CHANGE = 0.1
_DISTANCE = 2.5
# So many points of a shell say whether it lies inside another one.
_PROBES = 200


def fill_surface(surface: MeshParts, name: str, element_size: float | None = None) -> MeshParts:
    """Fill a closed triangle surface with tetrahedra.

    Shells inside shells are cavities, shells beside each other separate bodies. Without an element size the
    surface's own triangles stay, with their named parts; with one the surface is meshed anew and loses them
    (where that fails its own triangles stay, with a notice).

    Parameters
    ----------
    surface : MeshParts
        With triangles in 3D.
    name : str
        Name for messages.
    element_size : float, optional
        Edge length aimed at [m].

    Raises
    ------
    MeshError
        If the surface is not closed, or gmsh cannot fill it (it crosses itself, say).
    """
    triangles = surface.cells.get("triangle")
    if triangles is None or not len(triangles):
        raise fault(name, "fill: no triangles in it whose inside could be filled")
    if "tetra" in surface.cells:
        raise fault(name, "fill: it holds tetrahedra already")
    if surface.points.shape[1] != 3:
        raise fault(name, "fill: the surface must lie in three dimensions")
    if not np.all(np.isfinite(surface.points)):
        raise fault(name, "fill: the surface has points that are not finite")
    used = np.unique(triangles)
    new = np.full(len(surface.points), -1, dtype=np.int64)
    new[used] = np.arange(len(used))
    # Near size 1 the tolerances of gmsh fit; a power of two leaves every coordinate exact.
    points = surface.points[used]
    extent = float(np.ptp(points, axis=0).max())
    if not extent > 0.0:
        raise fault(name, "fill: all points coincide")
    factor = 2.0 ** -round(math.log2(extent))
    points, triangles = points * factor, new[triangles]
    _check_closed(triangles, used, name)
    named = [part for part in surface.named if part.kind == "triangle"]
    notices = list(surface.notices)
    size = None
    if element_size is not None:
        size = element_size * factor
        extents = {2: float(measures(points, triangles).sum()), 3: _volume(points, triangles)}
        guard_cell_count(name, extents, size, element_size)
        remeshed = _remesh(points, triangles, name, size)
        if remeshed is None:
            notices.append(f"fill: the surface is kept, meshing it with element_size {element_size:g} fails")
        else:
            points, triangles = remeshed
            named = []
    points, tets = _tetrahedralise(points, triangles, name, size)
    return MeshParts(points / factor, {"triangle": triangles, "tetra": tets}, named, notices)


def _volume(points: FloatArray, triangles: IntArray) -> float:
    """Volume inside a closed surface of consistent orientation."""
    heights = np.einsum("ni,ni->n", area_vectors(points, triangles), points[triangles[:, 0]])
    return abs(float(heights.sum())) / 3.0


def _check_closed(triangles: IntArray, numbers: IntArray, name: str) -> None:
    """Every edge must belong to two triangles; `numbers` are the file's own point numbers."""
    edges = all_facets(triangles)
    _, first, counts = np.unique(row_keys(edges)[0], return_index=True, return_counts=True)
    for wrong, what in ((counts == 1, "open edges"), (counts > 2, "edges with more than two triangles")):
        if np.any(wrong):
            shown = ", ".join(f"{a}-{b}" for a, b in numbers[edges[np.sort(first[wrong])[:5]]])
            count = np.count_nonzero(wrong)
            more = ", ..." if count > 5 else ""
            message = f"fill: the surface is not closed: {count} {what}, between points {shown}{more}"
            raise fault(name, message)


def _remesh(
    points: FloatArray, triangles: IntArray, name: str, element_size: float
) -> tuple[FloatArray, IntArray] | None:
    """Mesh the surface anew, keeping its sharp edges; None if no attempt gives a sound surface."""
    from scipy.spatial import cKDTree

    volume = _volume(points, triangles)
    for angle in _SHARP:
        # A surface that cannot be unrolled is no fault of the user's: the next attempt may do.
        with contextlib.suppress(MeshError):
            new_points, cells = _remesh_once(points, triangles, name, element_size, angle)
            if (
                not len(boundary_facets(cells))
                and cell_quality(new_points, cells).min() > _WORST_QUALITY
                and abs(_volume(new_points, cells) - volume) <= _VOLUME_CHANGE * volume
                and cKDTree(new_points).query(points)[0].max() <= _DISTANCE * element_size
            ):
                return new_points, cells
    return None


def _remesh_once(
    points: FloatArray, triangles: IntArray, name: str, element_size: float, angle: float
) -> tuple[FloatArray, IntArray]:
    with gmsh_session(name) as gmsh:
        gmsh.model.addDiscreteEntity(2, 1)
        _add_triangles(gmsh, 1, points, triangles, first_node=1)
        gmsh.model.mesh.classifySurfaces(angle, True, True, math.pi)
        gmsh.model.mesh.createGeometry()
        gmsh.model.geo.synchronize()
        gmsh.option.setNumber("Mesh.MeshSizeMin", element_size)
        gmsh.option.setNumber("Mesh.MeshSizeMax", element_size)
        gmsh.model.mesh.generate(2)
        parts = read_parts(gmsh, name)
    cells = parts.cells["triangle"]
    used = np.unique(cells)
    new = np.full(len(parts.points), -1, dtype=np.int64)
    new[used] = np.arange(len(used))
    return parts.points[used], new[cells]


def _add_triangles(gmsh: Any, tag: int, points: FloatArray, triangles: IntArray, first_node: int) -> None:
    """Put triangles, and those points that are theirs alone, into a discrete surface."""
    nodes = np.unique(triangles)
    gmsh.model.mesh.addNodes(2, tag, nodes + first_node, points[nodes].ravel())
    gmsh.model.mesh.addElementsByType(tag, 2, [], (triangles + first_node).ravel())


def _tetrahedralise(
    points: FloatArray, triangles: IntArray, name: str, element_size: float | None
) -> tuple[FloatArray, IntArray]:
    """Fill the surface; its points come first and keep their order."""
    n_shells, shell_of = connected_parts(triangles, len(points))
    shells = [triangles[shell_of == shell] for shell in range(n_shells)]
    inside = _nesting(points, shells, name)
    depth = inside.sum(axis=1)
    with gmsh_session(name) as gmsh:
        for tag, shell in enumerate(shells, start=1):
            gmsh.model.addDiscreteEntity(2, tag)
            _add_triangles(gmsh, tag, points, shell, first_node=1)
        loops = [gmsh.model.geo.addSurfaceLoop([tag]) for tag in range(1, n_shells + 1)]
        for shell in np.flatnonzero(depth % 2 == 0):
            cavities = np.flatnonzero(inside[:, shell] & (depth == depth[shell] + 1))
            gmsh.model.geo.addVolume([loops[shell], *(loops[cavity] for cavity in cavities)])
        gmsh.model.geo.synchronize()
        if element_size is None:
            # Between the surface's triangles and the middle cells may grow, but not without bound.
            longest = float(np.sqrt(edge_lengths_squared(points, triangles).max()))
            gmsh.option.setNumber("Mesh.MeshSizeMax", longest)
        else:
            gmsh.option.setNumber("Mesh.MeshSizeMax", element_size)
        gmsh.option.setNumber("Mesh.OptimizeNetgen", 1)
        gmsh.model.mesh.generate(3)
        parts = read_parts(gmsh, name)
    if "tetra" not in parts.cells:
        raise fault(name, "fill: gmsh made no tetrahedra; does the surface cross itself?")
    return parts.points, parts.cells["tetra"]


def _nesting(points: FloatArray, shells: list[IntArray], name: str) -> BoolArray:
    """Matrix (n_shells, n_shells): whether shell i lies inside shell j; shells that cross are an error."""
    inside = np.zeros((len(shells), len(shells)), dtype=np.bool_)
    boxes = [(points[shell].min(axis=(0, 1)), points[shell].max(axis=(0, 1))) for shell in shells]
    for i, shell in enumerate(shells):
        nodes = np.unique(shell)
        probes = points[nodes[:: -(-len(nodes) // _PROBES)]]
        for j, other in enumerate(shells):
            if i == j:
                continue
            in_box = np.all((probes >= boxes[j][0]) & (probes <= boxes[j][1]), axis=1)
            found = [abs(_winding_number(points[other] - probe)) > 0.5 for probe in probes[in_box]]
            if any(found) and not (all(found) and np.all(in_box)):
                raise fault(name, "fill: parts of the surface cross each other")
            inside[i, j] = any(found)
    return inside


def _winding_number(corners: FloatArray) -> float:
    """How often triangles (n, 3, 3) wind around the origin: the sum of their solid angles over 4 pi.

    Reference: van Oosterom and Strackee, The solid angle of a plane triangle, 1983.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    triple = np.einsum("ni,ni->n", a, np.cross(b, c))
    dots = [np.einsum("ni,ni->n", u, v) for u, v in ((a, b), (b, c), (c, a))]
    angle = 2.0 * np.arctan2(triple, la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb)
    return float(angle.sum()) / (4.0 * math.pi)
