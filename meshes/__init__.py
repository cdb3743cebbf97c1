"""Meshes: recipes, import and export, quality. `build_mesh` is the way in from a scene."""

from meshes.build import build_mesh
from meshes.quality import check_mesh

__all__ = ["build_mesh", "check_mesh"]
