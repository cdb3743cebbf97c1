"""The rubber mount: a turned rubber body bonded between two drilled steel plates, one conforming mesh."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

from femdeform.scene.mesh_schema import RubberMountMesh

_FLAT = 1e-5


def rubber_mount(gmsh: Any, source: RubberMountMesh) -> None:
    """Draw the mount around the y axis, standing on y = 0, and name its parts, faces and bonds."""
    occ = gmsh.model.occ
    low, high = source.plate_thickness, source.plate_thickness + source.rubber_height
    rubber = [(3, _rubber(occ, source, low, high))]
    bottom = _plate(occ, source, 0.0)
    top = _plate(occ, source, high)
    # Fragments share their common faces, so that the mesh is continuous across the bonds.
    _, pieces = occ.fragment(rubber, [*bottom, *top])
    occ.synchronize()
    volumes = {
        name: [tag for _, tag in piece]
        for name, piece in zip(("rubber", "bottom_plate", "top_plate"), pieces, strict=True)
    }
    for name, tags in volumes.items():
        gmsh.model.addPhysicalGroup(3, tags, name=name)
    _name_faces(gmsh, source, volumes)
    _set_sizes(gmsh, source, volumes)


def _rubber(occ: Any, source: RubberMountMesh, low: float, high: float) -> int:
    """Turn the profile: axis or bore, two flat ends, and the arc through the three radii."""
    radii = (source.bottom_radius, source.waist_radius, source.top_radius)
    middle = 0.5 * (low + high)
    inner_low = occ.addPoint(source.bore_radius, low, 0)
    inner_high = occ.addPoint(source.bore_radius, high, 0)
    outer_low, outer_high = occ.addPoint(radii[0], low, 0), occ.addPoint(radii[2], high, 0)
    center = _circle_center((radii[0], low), (radii[1], middle), (radii[2], high))
    if center is None:
        outline = occ.addLine(outer_low, outer_high)
    else:
        outline = occ.addCircleArc(outer_low, occ.addPoint(*center, 0), outer_high)
    sides = [
        occ.addLine(inner_low, outer_low),
        outline,
        occ.addLine(outer_high, inner_high),
        occ.addLine(inner_high, inner_low),
    ]
    profile = occ.addPlaneSurface([occ.addCurveLoop(sides)])
    turned = occ.revolve([(2, profile)], 0, 0, 0, 0, 1, 0, 2.0 * math.pi)
    return int(next(tag for dim, tag in turned if dim == 3))


def _circle_center(
    a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]
) -> tuple[float, float] | None:
    """Centre of the circle through three points; None if they are (nearly) on one line."""
    (ax, ay), (bx, by), (cx, cy) = a, b, c
    twice = 2.0 * (ax * (by - cy) + bx * (cy - ay) + cx * (ay - by))
    if abs(twice) < 1e-6 * (cy - ay) ** 2:
        return None
    a2, b2, c2 = ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy
    x = (a2 * (by - cy) + b2 * (cy - ay) + c2 * (ay - by)) / twice
    y = (a2 * (cx - bx) + b2 * (ax - cx) + c2 * (bx - ax)) / twice
    return x, y


def _plate(occ: Any, source: RubberMountMesh, y: float) -> list[tuple[int, int]]:
    half = 0.5 * source.plate_size
    plate = [(3, occ.addBox(-half, y, -half, source.plate_size, source.plate_thickness, source.plate_size))]
    along = (0.0, source.plate_thickness, 0.0)
    drills = []
    if source.bore_radius > 0.0:
        drills.append((3, occ.addCylinder(0, y, 0, *along, source.bore_radius)))
    if source.bolt_hole_radius > 0.0:
        reach = half - source.bolt_hole_inset
        for x, z in itertools.product((-reach, reach), repeat=2):
            drills.append((3, occ.addCylinder(x, y, z, *along, source.bolt_hole_radius)))
    if drills:
        plate, _ = occ.cut(plate, drills)
    return list(plate)


def _name_faces(gmsh: Any, source: RubberMountMesh, volumes: dict[str, list[int]]) -> None:
    half, thickness = 0.5 * source.plate_size, source.plate_thickness
    low, high = thickness, thickness + source.rubber_height
    flat = {"bottom_plate": {0.0: "bottom", low: "bottom_plate_inside"}}
    flat["top_plate"] = {high + thickness: "top", high: "top_plate_inside"}
    groups: dict[str, list[int]] = {}
    for part, tags in volumes.items():
        for _, face in gmsh.model.getBoundary([(3, tag) for tag in tags], oriented=False):
            neighbours = gmsh.model.getAdjacencies(2, face)[0]
            box = np.array(gmsh.model.getBoundingBox(2, face)).reshape(2, 3)
            reach = float(np.max(np.abs(box[:, [0, 2]])))
            level = flat.get(part, {}).items()
            heights = [name for y, name in level if np.all(np.abs(box[:, 1] - y) < _FLAT)]
            if len(neighbours) > 1:
                name = "bottom_bond" if box[1, 1] < 0.5 * (low + high) else "top_bond"
            elif heights:
                name = heights[0]
            elif reach < source.bore_radius + _FLAT:
                name = "bore"
            elif part == "rubber":
                name = "rubber_side"
            elif reach > half - _FLAT:
                name = f"{part}_edge"
            else:
                name = f"{part}_bolt_holes"
            groups.setdefault(name, []).append(face)
    for name, faces in groups.items():
        gmsh.model.addPhysicalGroup(2, sorted(set(faces)), name=name)


def _set_sizes(gmsh: Any, source: RubberMountMesh, volumes: dict[str, list[int]]) -> None:
    """Coarser plates: steel hardly deforms, and its thin plates would otherwise take most of the cells."""
    coarse = source.plate_element_size
    coarse = 2.0 * source.element_size if coarse is None else coarse
    sizes = {"bottom_plate": coarse, "top_plate": coarse, "rubber": source.element_size}
    gmsh.option.setNumber("Mesh.MeshSizeMax", max(sizes.values()))
    # Eight elements around a bolt hole are enough where nothing is measured.
    gmsh.option.setNumber("Mesh.MeshSizeFromCurvature", 8)
    for part, size in sizes.items():
        # The rubber last: where it touches a plate its own size counts.
        corners = gmsh.model.getBoundary([(3, tag) for tag in volumes[part]], oriented=False, recursive=True)
        gmsh.model.mesh.setSize([corner for corner in corners if corner[0] == 0], size)
