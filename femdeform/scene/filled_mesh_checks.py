"""Meshes of which the inside is meant: of solids in flows, of bodies and walls of material points."""

from __future__ import annotations

from femdeform import registry
from femdeform.types import Mesh


def why_nothing_is_inside(mesh: Mesh, dim: int, place: str) -> str:
    """What keeps a mesh from having an inside in a grid or domain (`place`) of some dimension, or an empty text."""
    if mesh.dim != dim:
        return f"is {mesh.dim}D, the {place} is {dim}D"
    if mesh.cells.shape[1] < dim:
        return "is no surface: nothing is inside of it"
    if mesh.cells.shape[1] == dim and len(registry.resolve(registry.MESH["boundary"])(mesh.cells)):
        return "is a surface that does not close: nothing is inside of it"
    return ""
