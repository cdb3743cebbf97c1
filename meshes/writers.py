"""Writing a `Mesh`, with its named groups where the format has a place for them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from femdeform.types import FloatArray, IntArray, Mesh
from meshes.boundary import boundary_facets, row_keys
from meshes.gmsh_session import gmsh_session
from meshes.grid_formats import GROUP_PREFIX
from meshes.parts import fault

# Rebuilt whenever a mesh is read, so it need not be written.
_REBUILT = "boundary"

_GMSH_TYPES = {1: 15, 2: 1, 3: 2, 4: 4}
_CELL_NAMES = {1: "vertex", 2: "line", 3: "triangle", 4: "tetra"}
_MEDIT_NAMES = {2: "Edges", 3: "Triangles", 4: "Tetrahedra"}


def write_mesh(mesh: Mesh, path: Path) -> list[str]:
    """Write a mesh; the extension says the format.

    ``.msh`` (gmsh 4.1, binary) and ``.vtu`` keep every group by name; ``.mesh`` keeps groups as reference
    numbers; ``.stl`` and ``.obj`` hold the triangles of a surface or a solid's boundary, ``.obj`` also lines.

    Parameters
    ----------
    mesh : Mesh
        The mesh.
    path : Path
        File to write; its folder is made if it is missing.

    Returns
    -------
    list of str
        What the format could not keep.

    Raises
    ------
    MeshError
        If the format is unknown, cannot hold the mesh, or the file cannot be written.
    """
    check_writable(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return WRITERS[path.suffix.lower()](mesh, path)
    except OSError as error:
        raise fault(str(path), f"cannot be written: {error.strerror or error}") from None


def check_writable(path: Path) -> None:
    """Raise a MeshError if the extension is not one that `write_mesh` knows."""
    if path.suffix.lower() not in WRITERS:
        known = " ".join(sorted(WRITERS))
        raise fault(str(path), f"meshes cannot be written as `{path.suffix}`; known: {known}")


def _points_3d(mesh: Mesh) -> FloatArray:
    if mesh.dim == 3:
        return mesh.points
    return np.concatenate([mesh.points, np.zeros((mesh.n_points, 1))], axis=1)


def _facets_of_groups(mesh: Mesh) -> tuple[IntArray, dict[str, IntArray]]:
    """Every facet of a named group once, and the rows of each group in it."""
    groups = {name: facets for name, facets in mesh.facet_groups.items() if name != _REBUILT and len(facets)}
    if not groups:
        return np.empty((0, mesh.cells.shape[1] - 1), dtype=np.int64), {}
    stacked = np.concatenate(list(groups.values()))
    _, first, inverse = np.unique(row_keys(stacked)[0], return_index=True, return_inverse=True)
    ends = np.cumsum([len(facets) for facets in groups.values()])[:-1]
    return stacked[first], dict(zip(groups, np.split(inverse.astype(np.int64), ends), strict=True))


def _nodes_of_groups(mesh: Mesh) -> tuple[IntArray, dict[str, IntArray]]:
    """Every node of a named group once, (n, 1), and the rows of each group in it."""
    groups = {name: nodes for name, nodes in mesh.node_groups.items() if len(nodes)}
    if not groups:
        return np.empty((0, 1), dtype=np.int64), {}
    used = np.unique(np.concatenate(list(groups.values())))
    return used[:, None], {name: np.searchsorted(used, nodes) for name, nodes in groups.items()}


def _write_msh(mesh: Mesh, path: Path) -> list[str]:
    """One discrete entity for each combination of groups, so that a cell can be in several of them."""
    facets, facet_groups = _facets_of_groups(mesh)
    nodes, node_groups = _nodes_of_groups(mesh)
    if mesh.cell_type == "line" and node_groups:
        # Ends and other nodes of rods are both points: they go into one table.
        for name, rows in node_groups.items():
            ends = facet_groups.get(name, rows[:0])
            facet_groups[name] = np.concatenate([ends, len(facets) + rows])
        facets, nodes, node_groups = np.concatenate([facets, nodes]), nodes[:0], {}
    with gmsh_session(str(path)) as gmsh:
        next_cell = 1
        cell_groups = {name: rows for name, rows in mesh.cell_groups.items() if len(rows)}
        tables = [(mesh.cells, cell_groups), (facets, facet_groups), (nodes, node_groups)]
        for table, groups in tables:
            next_cell = _add_entities(gmsh, table, groups, mesh if table is mesh.cells else None, next_cell)
        # Without any physical group gmsh saves everything; with some, only what they hold unless told.
        gmsh.option.setNumber("Mesh.SaveAll", 1)
        gmsh.option.setNumber("Mesh.MshFileVersion", 4.1)
        # Text would round coordinates to 16 digits.
        gmsh.option.setNumber("Mesh.Binary", 1)
        gmsh.write(str(path))
    return []


def _add_entities(gmsh: Any, table: IntArray, groups: dict[str, IntArray], mesh: Mesh | None, next_cell: int) -> int:
    """Add the cells of a table to the model; the first entity of the mesh's cells takes all points."""
    if not len(table):
        return next_cell
    dim = table.shape[1] - 1
    members = np.zeros((len(table), max(len(groups), 1)), dtype=np.bool_)
    for column, rows in enumerate(groups.values()):
        members[rows, column] = True
    patterns, entity_of = np.unique(members, axis=0, return_inverse=True)
    tags = [gmsh.model.addDiscreteEntity(dim) for _ in patterns]
    if mesh is not None:
        numbers = np.arange(1, mesh.n_points + 1)
        gmsh.model.mesh.addNodes(dim, tags[0], numbers, _points_3d(mesh).ravel())
    for index, tag in enumerate(tags):
        rows = np.flatnonzero(entity_of.ravel() == index)
        gmsh.model.mesh.addElementsByType(tag, _GMSH_TYPES[dim + 1], next_cell + rows, (table[rows] + 1).ravel())
    for column, name in enumerate(groups):
        inside = [tag for tag, pattern in zip(tags, patterns, strict=True) if pattern[column]]
        gmsh.model.addPhysicalGroup(dim, inside, name=name)
    return next_cell + len(table)


def _write_vtu(mesh: Mesh, path: Path) -> list[str]:
    import meshio

    facets, facet_groups = _facets_of_groups(mesh)
    nodes, node_groups = _nodes_of_groups(mesh)
    blocks = [(mesh.cells, mesh.cell_groups), (facets, facet_groups), (nodes, node_groups)]
    blocks = [block for block in blocks if len(block[0])]
    cell_data: dict[str, list[IntArray]] = {}
    for position, (_, groups) in enumerate(blocks):
        for name, rows in groups.items():
            masks = cell_data.setdefault(
                GROUP_PREFIX + name, [np.zeros(len(table), dtype=np.int8) for table, _ in blocks]
            )
            masks[position][rows] = 1
    cells = [(_CELL_NAMES[table.shape[1]], table) for table, _ in blocks]
    meshio.vtu.write(str(path), meshio.Mesh(_points_3d(mesh), cells, cell_data=cell_data), binary=True)
    return []


def _write_medit(mesh: Mesh, path: Path) -> list[str]:
    facets, facet_groups = _facets_of_groups(mesh)
    notices = ["node groups not written, the format has none"] if mesh.node_groups else []
    tables = [(mesh.cells, mesh.cell_groups)]
    if facets.shape[1] > 1:
        tables.append((facets, facet_groups))
    elif len(facets):
        notices.append("groups of end points not written, the format has none")
    with path.open("w", encoding="utf-8") as file:
        file.write(f"MeshVersionFormatted 2\nDimension {mesh.dim}\nVertices\n{mesh.n_points}\n")
        vertices = np.column_stack([mesh.points, np.zeros(mesh.n_points)])
        np.savetxt(file, vertices, fmt=["%.17g"] * mesh.dim + ["%d"])
        for table, groups in tables:
            if not len(table):
                continue
            numbers = np.zeros(len(table), dtype=np.int64)
            for number, (name, rows) in enumerate(groups.items(), start=1):
                if np.any(numbers[rows]):
                    notices.append(f"group `{name}` takes cells from another one: a cell has one number only")
                numbers[rows] = number
                notices.append(f"group `{name}` written as number {number}")
            file.write(f"{_MEDIT_NAMES[table.shape[1]]}\n{len(table)}\n")
            np.savetxt(file, np.column_stack([table + 1, numbers]), fmt="%d")
        file.write("End\n")
    return notices


def _surface_of(mesh: Mesh, path: Path) -> tuple[FloatArray, IntArray]:
    """Triangles of a surface, or of a solid's boundary, with only their own points."""
    if mesh.cell_type == "line":
        raise fault(str(path), "the format holds surfaces, not lines")
    triangles = mesh.cells if mesh.cell_type == "triangle" else boundary_facets(mesh.cells, mesh.points)
    used = np.unique(triangles)
    new = np.full(mesh.n_points, -1, dtype=np.int64)
    new[used] = np.arange(len(used))
    return _points_3d(mesh)[used], new[triangles]


def _lost(mesh: Mesh) -> list[str]:
    names = [name for name in mesh.group_names() if name != _REBUILT]
    lost = [f"groups not written, the format has none: {', '.join(names)}"] if names else []
    return lost + (["only the surface of the solid written"] if mesh.cell_type == "tetra" else [])


def _write_stl(mesh: Mesh, path: Path) -> list[str]:
    points, triangles = _surface_of(mesh, path)
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    records = np.zeros(len(triangles), dtype=record)
    corners = points[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    records["normal"] = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0.0)
    records["corners"] = corners
    header = b"binary STL, lengths in metres".ljust(80)
    path.write_bytes(header + np.uint32(len(triangles)).astype("<u4").tobytes() + records.tobytes())
    return _lost(mesh)


def _write_obj(mesh: Mesh, path: Path) -> list[str]:
    if mesh.cell_type == "line":
        points, cells, letter = _points_3d(mesh), mesh.cells, "l"
    else:
        points, cells = _surface_of(mesh, path)
        letter = "f"
    with path.open("w", encoding="utf-8") as file:
        np.savetxt(file, points, fmt="v %.17g %.17g %.17g")
        np.savetxt(file, cells + 1, fmt=letter + " %d" * cells.shape[1])
    return _lost(mesh)


WRITERS: dict[str, Callable[[Mesh, Path], list[str]]] = {
    ".msh": _write_msh,
    ".vtu": _write_vtu,
    ".mesh": _write_medit,
    ".stl": _write_stl,
    ".obj": _write_obj,
}
