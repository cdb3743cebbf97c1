"""Recipes meshed by gmsh from a CAD description, every boundary named."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from femdeform.errors import MeshError
from femdeform.scene.mesh_schema import (
    BeamMesh,
    CylinderMesh,
    EllipsoidMesh,
    PlacedMesh,
    PlateWithHoleMesh,
    RubberMountMesh,
    SphereMesh,
    SphericalShellMesh,
    TorusMesh,
)
from femdeform.types import FloatArray, Mesh
from meshes.boundary import signed_measures
from meshes.gmsh_session import FINEST, gmsh_session, guard_cell_count, model_measures, read_parts
from meshes.parts import MeshParts, PartKind, assemble, fault
from meshes.quality import cell_quality
from meshes.recipe_mount import rubber_mount
from meshes.structured import SIDES

# Bodies are meshed at a size near 1, where gmsh's absolute tolerances fit; flatness is judged with this one.
_FLAT = 1e-5
# At least so many elements around a full turn, whatever the element size asked for.
_AROUND = 10
# Worse cells are no mesh but a failure.
_WORST_QUALITY = 1e-3


def _box(gmsh: Any, dim: int, tag: int) -> FloatArray:
    """Bounding box of an entity, (2, 3): lowest and highest corner."""
    return np.array(gmsh.model.getBoundingBox(dim, tag)).reshape(2, 3)


def _at(box: FloatArray, axis: int, value: float) -> bool:
    """Whether an entity with this bounding box lies in the plane where coordinate `axis` is `value`."""
    return bool(np.all(np.abs(box[:, axis] - value) < _FLAT))


def _name_boundary(gmsh: Any, dim: int, name_of: Callable[[FloatArray], str]) -> None:
    """Put every outer surface (curve in 2D) into the physical group that `name_of` its bounding box says."""
    gmsh.model.occ.synchronize()
    cells = gmsh.model.getEntities(dim)
    groups: dict[str, list[int]] = {}
    for _, tag in gmsh.model.getBoundary(cells, combined=True, oriented=False):
        groups.setdefault(name_of(_box(gmsh, dim - 1, tag)), []).append(tag)
    for name, tags in groups.items():
        gmsh.model.addPhysicalGroup(dim - 1, tags, name=name)


def _side(box: FloatArray, low: tuple[float, ...], high: tuple[float, ...], otherwise: str) -> str:
    """Name of the side of a box [low, high] that a bounding box lies in."""
    for axis, ends in enumerate(zip(low, high, strict=True)):
        for name, value in zip(SIDES[axis], ends, strict=True):
            if _at(box, axis, value):
                return name
    return otherwise


def _beam(gmsh: Any, source: BeamMesh) -> None:
    gmsh.model.occ.addBox(0, 0, 0, *source.size)
    _name_boundary(gmsh, 3, lambda box: _side(box, (0.0, 0.0, 0.0), source.size, "side"))
    for _, tag in gmsh.model.getEntities(0):
        low = _box(gmsh, 0, tag)[0]
        ends = [int(low[axis] > 0.5 * source.size[axis]) for axis in range(3)]
        name = "_".join(SIDES[axis][end] for axis, end in enumerate(ends))
        gmsh.model.addPhysicalGroup(0, [tag], name=name)


def _cylinder(gmsh: Any, source: CylinderMesh) -> None:
    axis = "xyz".index(source.axis)
    along = [0.0, 0.0, 0.0]
    along[axis] = source.length
    body = [(3, gmsh.model.occ.addCylinder(0, 0, 0, *along, source.radius))]
    if source.hole_radius > 0.0:
        hole = [(3, gmsh.model.occ.addCylinder(0, 0, 0, *along, source.hole_radius))]
        gmsh.model.occ.cut(body, hole)

    def name_of(box: FloatArray) -> str:
        for name, value in zip(SIDES[axis], (0.0, source.length), strict=True):
            if _at(box, axis, value):
                return name
        reach = float(np.max(np.abs(np.delete(box, axis, axis=1))))
        return "side" if reach > 0.5 * (source.radius + source.hole_radius) else "hole"

    _name_boundary(gmsh, 3, name_of)


def _sphere(gmsh: Any, source: SphereMesh) -> None:
    gmsh.model.occ.addSphere(0, 0, 0, source.radius)
    _name_boundary(gmsh, 3, lambda box: "surface")


def _ellipsoid(gmsh: Any, source: EllipsoidMesh, attempt: int) -> None:
    # A stretched sphere keeps the two poles of its parametrisation, where gmsh may stumble. They are best at the
    # ends of the axis that differs most from the other two; should that fail, the others are tried.
    short, middle, long = (int(axis) for axis in np.argsort(source.semi_axes))
    lengths = source.semi_axes
    prolate = lengths[long] * lengths[short] >= lengths[middle] ** 2
    pole = ((long, short, middle) if prolate else (short, long, middle))[attempt]
    body = [(3, gmsh.model.occ.addSphere(0, 0, 0, 1.0))]
    if pole < 2:
        turn = (0.0, 1.0, 0.0) if pole == 0 else (1.0, 0.0, 0.0)
        gmsh.model.occ.rotate(body, 0, 0, 0, *turn, 0.5 * math.pi)
    gmsh.model.occ.dilate(body, 0, 0, 0, *lengths)
    # The curvature gmsh finds at such a pole is of no use either.
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 0)
    gmsh.option.setNumber("Mesh.MeshSizeMin", 0.5 * source.element_size)
    _name_boundary(gmsh, 3, lambda box: "surface")


def _torus(gmsh: Any, source: TorusMesh) -> None:
    body = gmsh.model.occ.addTorus(0, 0, 0, source.radius, source.tube_radius)
    gmsh.model.occ.rotate([(3, body)], 0, 0, 0, 1, 0, 0, -0.5 * math.pi)
    _name_boundary(gmsh, 3, lambda box: "surface")


def _spherical_shell(gmsh: Any, source: SphericalShellMesh) -> None:
    radius, inner = source.radius, source.radius - source.thickness
    outside = [(3, gmsh.model.occ.addSphere(0, 0, 0, radius))]
    hollow = [(3, gmsh.model.occ.addSphere(0, 0, 0, inner))]
    shell, _ = gmsh.model.occ.cut(outside, hollow)
    cut = {"full": (), "half": (1,), "eighth": (0, 1, 2)}[source.part]
    if cut:
        low = [0.0 if axis in cut else -radius for axis in range(3)]
        keep = gmsh.model.occ.addBox(*low, *(radius - start for start in low))
        gmsh.model.occ.intersect(shell, [(3, keep)])

    def name_of(box: FloatArray) -> str:
        for axis in cut:
            if _at(box, axis, 0.0):
                return SIDES[axis][0]
        return "outer" if float(np.max(np.abs(box))) > radius - 0.5 * source.thickness else "inner"

    _name_boundary(gmsh, 3, name_of)


def _plate_with_hole(gmsh: Any, source: PlateWithHoleMesh) -> None:
    width, height = source.size
    high = (0.5 * width, 0.5 * height)
    low = (0.0, 0.0) if source.quarter else (-high[0], -high[1])
    plate = [(2, gmsh.model.occ.addRectangle(*low, 0, high[0] - low[0], high[1] - low[1]))]
    hole = [(2, gmsh.model.occ.addDisk(0, 0, 0, source.radius, source.radius))]
    plate, _ = gmsh.model.occ.cut(plate, hole)
    thickness = source.thickness
    if thickness is None:
        _name_boundary(gmsh, 2, lambda box: _side(box, low, high, "hole"))
    else:
        gmsh.model.occ.extrude(plate, 0, 0, thickness)
        _name_boundary(gmsh, 3, lambda box: _side(box, (*low, 0.0), (*high, thickness), "hole"))
    fine = source.element_size / 2.0 if source.hole_element_size is None else source.hole_element_size
    corners = [
        point
        for point in gmsh.model.getEntities(0)
        if math.hypot(*_box(gmsh, *point)[0, :2]) < source.radius * (1.0 + _FLAT)
    ]
    gmsh.model.mesh.setSize(corners, fine)
    gmsh.option.setNumber("Mesh.MeshSizeMin", min(fine, FINEST * source.element_size))


@dataclass(frozen=True)
class _Builder:
    """How a recipe is built: what draws it, and which of its parameters are lengths."""

    draw: Callable[..., None]
    lengths: tuple[str, ...]
    curved_all_over: str = ""  # radius of a body so slender that its curvature sets the size of all its cells
    attempts: int = 0  # ways to draw it, passed on as a third argument; 0: only one


_BUILDERS: dict[type[PlacedMesh], _Builder] = {
    BeamMesh: _Builder(_beam, ("size", "element_size")),
    CylinderMesh: _Builder(_cylinder, ("radius", "hole_radius", "length", "element_size"), "radius"),
    SphereMesh: _Builder(_sphere, ("radius", "element_size")),
    EllipsoidMesh: _Builder(_ellipsoid, ("semi_axes", "element_size"), attempts=3),
    TorusMesh: _Builder(_torus, ("radius", "tube_radius", "element_size"), "tube_radius"),
    SphericalShellMesh: _Builder(_spherical_shell, ("radius", "thickness", "element_size")),
    PlateWithHoleMesh: _Builder(_plate_with_hole, ("size", "radius", "thickness", "element_size", "hole_element_size")),
    RubberMountMesh: _Builder(
        rubber_mount,
        (
            "rubber_height",
            "bottom_radius",
            "top_radius",
            "waist_radius",
            "bore_radius",
            "plate_size",
            "plate_thickness",
            "bolt_hole_radius",
            "bolt_hole_inset",
            "element_size",
            "plate_element_size",
        ),
    ),
}


def is_gmsh_recipe(source: object) -> bool:
    """Whether a mesh source is one of the recipes of this module."""
    return type(source) in _BUILDERS


def gmsh_recipe(source: PlacedMesh) -> Mesh:
    """Mesh one of this module's recipes.

    Parameters
    ----------
    source : BeamMesh, CylinderMesh, ... , RubberMountMesh
        The recipe with its parameters.

    Returns
    -------
    Mesh
        Positively oriented, with its boundary in named facet groups. The same parameters give the same mesh.

    Raises
    ------
    MeshError
        If gmsh cannot mesh it, or the element size would give more cells than `MAX_CELLS`.
    """
    builder = _BUILDERS[type(source)]
    name = f"recipe {getattr(source, 'recipe')}"  # noqa: B009 - the base class of all recipes has none
    factor = _power_of_two(source, builder.lengths)
    scaled = source.model_copy(update={key: _times(getattr(source, key), factor) for key in builder.lengths})
    attempts = range(builder.attempts) if builder.attempts else (None,)
    for attempt in attempts:
        try:
            parts = _upright(_generate(builder, scaled, attempt, name, factor), factor, name)
            break
        except MeshError:
            if attempt in (None, attempts[-1]):
                raise
    return assemble(parts, name, drop_unreferenced=True)


def _generate(builder: _Builder, source: PlacedMesh, attempt: int | None, name: str, factor: float) -> MeshParts:
    sizes = [getattr(source, key, None) for key in ("element_size", "plate_element_size")]
    size: float = min(value for value in sizes if value is not None)
    with gmsh_session(name) as gmsh:
        gmsh.option.setNumber("Mesh.MeshSizeMin", FINEST * size)
        gmsh.option.setNumber("Mesh.MeshSizeMax", size)
        gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", _AROUND)
        builder.draw(gmsh, source, *(() if attempt is None else (attempt,)))
        dim = max((entity for entity, _ in gmsh.model.getEntities()), default=0)
        if dim < 2:
            raise fault(name, "nothing is left of the body: a part of it is too thin")
        finest = size
        if builder.curved_all_over:
            finest = min(size, 2.0 * math.pi / _AROUND * getattr(source, builder.curved_all_over))
        guard_cell_count(name, model_measures(gmsh), finest, size / factor)
        gmsh.model.mesh.generate(dim)
        parts = read_parts(gmsh, name)
    return parts if dim == 3 else replace(parts, points=parts.points[:, :2])


def _upright(parts: MeshParts, factor: float, name: str) -> MeshParts:
    """Undo the scaling and orient all cells positively; a mesh that gmsh gave up half-way is an error."""
    kind: PartKind = "tetra" if parts.points.shape[1] == 3 else "triangle"
    if kind not in parts.cells:
        raise fault(name, "gmsh made no cells; another element_size may help")
    cells = parts.cells[kind]
    if cell_quality(parts.points, cells).min() < _WORST_QUALITY:
        raise fault(name, "gmsh made flat cells only a smaller element_size can avoid")
    points = parts.points / factor
    inverted = signed_measures(points, cells) < 0.0
    cells[inverted, -2:] = cells[inverted, :-3:-1]
    return MeshParts(points, parts.cells, parts.named)


def _times(value: Any, factor: float) -> Any:
    if isinstance(value, tuple):
        return tuple(factor * entry for entry in value)
    return None if value is None else factor * value


def _power_of_two(source: PlacedMesh, lengths: tuple[str, ...]) -> float:
    """Factor that brings the largest length near 1, exact in floating point."""
    values = [getattr(source, key) for key in lengths]
    flat = itertools.chain.from_iterable(value if isinstance(value, tuple) else (value,) for value in values)
    largest = max(value for value in flat if value is not None)
    return float(2.0 ** -round(math.log2(largest)))
