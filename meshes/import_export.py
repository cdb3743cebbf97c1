"""A `mesh: {file: ...}` block to a `Mesh`; writing is `meshes.writers.write_mesh`, offered here as well."""

from __future__ import annotations

import contextlib
from pathlib import Path

import numpy as np

from femdeform.scene.mesh_schema import FileMesh
from femdeform.types import Mesh
from meshes.fill import fill_surface
from meshes.parts import MeshParts, assemble
from meshes.quality import check_points
from meshes.readers import STEP_SUFFIXES, as_plane, check_exists, in_space, read_parts_of, read_step
from meshes.writers import write_mesh

__all__ = ["import_mesh", "write_mesh"]


def import_mesh(source: FileMesh, base_dir: Path) -> tuple[Mesh, list[str]]:
    """Read the mesh of a file block, scaled but not yet turned and shifted.

    Parameters
    ----------
    source : FileMesh
        The block.
    base_dir : Path
        Folder that a relative path starts from, the scene's.

    Returns
    -------
    mesh : Mesh
        With the facet group ``boundary`` and the groups of the file.
    notices : list of str
        What was changed while reading.

    Raises
    ------
    MeshError
        If the file is missing or cannot be read, filled, or reduced to two dimensions.
    """
    name = source.file
    path = base_dir / name
    if name.startswith("~"):
        with contextlib.suppress(RuntimeError):  # a home that is not known: just a name
            path = Path(name).expanduser()
    if path.suffix.lower() in STEP_SUFFIXES:
        check_exists(path, name)
        parts = read_step(path, name, source.element_size, source.scale)
    else:
        parts = read_parts_of(path, name)
    with np.errstate(over="ignore"):  # what is then infinite is reported
        points = parts.points * source.scale
    check_points(points, name)
    if source.dim == 2:
        points = as_plane(points, name)
    elif source.dim == 3 and points.shape[1] == 2:
        points = np.concatenate([points, np.zeros((len(points), 1))], axis=1)
    dim = points.shape[1]
    vectors = {key: in_space(rows, dim) for key, rows in parts.vectors.items()}
    parts = MeshParts(points, parts.cells, parts.named, parts.notices, vectors)
    if source.fill:
        parts = fill_surface(parts, name, source.element_size)
    mesh = assemble(parts, name, source.cell_type, source.drop_unreferenced)
    return mesh, parts.notices
