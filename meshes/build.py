"""The single entry: from a `mesh:` block of a scene to a `Mesh`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from femdeform.errors import InputError
from femdeform.scene.mesh_schema import (
    BlockMesh,
    ClothMesh,
    CookMesh,
    FileMesh,
    FlagMesh,
    MuscleMesh,
    PlacedMesh,
    RingMesh,
    RodMesh,
    RodNetMesh,
    Rotation,
    SphereSurfaceMesh,
)
from femdeform.types import FloatArray, Mesh
from meshes import structured


def build_mesh(source: PlacedMesh | FileMesh, base_dir: Path, notices: list[str] | None = None) -> Mesh:
    """Make or read the mesh that a block describes, turned and shifted to its place.

    The mesh is not judged here: `meshes.quality.check_mesh` does that.

    Parameters
    ----------
    source : MeshSource
        A validated `mesh:` block.
    base_dir : Path
        Folder that relative paths of files start from.
    notices : list of str, optional
        Gets a line for everything that had to be changed while reading a file.

    Returns
    -------
    Mesh
        With named boundaries, among them ``boundary``, all of it.

    Raises
    ------
    MeshError
        If a file cannot be read, or a recipe or a surface cannot be meshed.
    InputError
        If the placement does not fit the dimension of the mesh.
    """
    if isinstance(source, FileMesh):
        from meshes.import_export import import_mesh

        mesh, found = import_mesh(source, base_dir)
        if notices is not None:
            notices += found
    else:
        mesh = _build_recipe(source)
    if source.rotate is None and source.translate is None:
        return mesh
    turned = {name: _placed(vectors, source.rotate, None) for name, vectors in mesh.cell_data.items()}
    return replace(mesh, points=_placed(mesh.points, source.rotate, source.translate), cell_data=turned)


def _build_recipe(source: PlacedMesh) -> Mesh:
    if isinstance(source, BlockMesh):
        return structured.block(source)
    if isinstance(source, MuscleMesh):
        return structured.muscle(source)
    if isinstance(source, ClothMesh):
        return structured.cloth(source)
    if isinstance(source, CookMesh):
        return structured.cook(source)
    if isinstance(source, FlagMesh):
        return structured.flag(source)
    if isinstance(source, RingMesh):
        return structured.ring(source)
    if isinstance(source, RodMesh):
        return structured.rod(source)
    if isinstance(source, RodNetMesh):
        return structured.rod_net(source)
    if isinstance(source, SphereSurfaceMesh):
        return structured.sphere_surface(source)
    from meshes.recipes import gmsh_recipe

    return gmsh_recipe(source)


def _placed(points: FloatArray, rotate: Rotation | None, translate: tuple[float, ...] | None) -> FloatArray:
    dim = points.shape[1]
    if rotate is not None:
        if dim == 2 and any(rotate.axis[:2]):
            raise InputError("mesh: rotate: in two dimensions the axis can only be z")
        points = points @ _rotation_matrix(rotate)[:dim, :dim].T
    if translate is not None:
        if len(translate) != dim:
            raise InputError(f"mesh: translate: {len(translate)} components for a mesh in {dim} dimensions")
        points = points + np.array(translate)
    return points


def _rotation_matrix(rotate: Rotation) -> FloatArray:
    """Rodrigues' formula."""
    axis = np.array(rotate.axis)
    axis = axis / np.abs(axis).max()  # first, as squares of tiny numbers vanish
    x, y, z = axis / np.linalg.norm(axis)
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned = np.eye(3) + np.sin(rotate.angle) * skew + (1.0 - np.cos(rotate.angle)) * (skew @ skew)
    return np.asarray(turned, dtype=np.float64)
