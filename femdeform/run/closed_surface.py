"""The closed surface that a mesh of a scene stands for."""

from __future__ import annotations

from femdeform import registry
from femdeform.types import FloatArray, IntArray, Mesh


def closed_surface(mesh: Mesh) -> tuple[FloatArray, IntArray]:
    """Points and facets of a mesh's boundary, or of the mesh itself where it is a surface already."""
    if mesh.cells.shape[1] == mesh.dim:
        return mesh.points, mesh.cells
    return mesh.points, registry.resolve(registry.MESH["boundary"])(mesh.cells, mesh.points)
