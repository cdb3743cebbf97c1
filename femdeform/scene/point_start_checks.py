"""Whether material points can start: in a domain, with a surface that holds together, in a phase that is theirs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from femdeform.scene import point_body_schema as schema
from femdeform.scene.point_schema import PointScene
from femdeform.scene.validation import Finding
from femdeform.types import FloatArray, Mesh

# A quadratic spline is not zero over three cells.
_SUPPORT = 3.0
# Of the cell size: what rounding may do to a body that fills the domain.
_ROUNDING = 1e-9
# Temperatures between those at the ends of a body at which its tension is looked at.
_SAMPLES = 65


def start_findings(scene: PointScene, meshes: Mapping[str, Mesh]) -> Iterator[Finding]:
    """Findings about the domain, places, tensions and phases at the start.

    Parameters
    ----------
    scene : PointScene
        A scene whose vectors have the components of its domain.
    meshes : mapping of str to Mesh
        Meshes of bodies.
    """
    yield from _domain_findings(scene)
    yield from _place_findings(scene, meshes)
    for name, body in scene.bodies.items():
        if body.surface_tension is not None:
            found = list(_tension_findings(name, body.surface_tension))
            yield from found or _start_tension_findings(name, body, body.surface_tension, meshes.get(name))
        if body.melting is not None:
            yield from _phase_findings(name, body, body.melting)
            yield from _density_findings(name, body)
    radius, least = scene.surface.radius, math.sqrt(scene.dim) / 2.0
    if radius is not None and not least < radius < 1.0:
        reason = "smaller spheres leave gaps between points" if radius <= least else "larger ones reach too far"
        yield Finding(("surface", "radius"), f"must be between {least:.3f} and 1, not {radius:g}: {reason}")


def _domain_findings(scene: PointScene) -> Iterator[Finding]:
    grid = scene.grid
    for axis, low, high in zip("xyz", grid.low, grid.high, strict=False):
        cells = (high - low) / grid.cell_size
        if cells < _SUPPORT - _ROUNDING:
            message = f"leaves {cells:.3g} cells along {axis}, fewer than the three of a spline; take smaller cells"
            yield Finding(("grid", "high"), message)


def _bounds(shape: schema.Shape, mesh: Mesh | None) -> tuple[FloatArray, FloatArray] | None:
    """Lowest and highest corner of what a shape fills [m]; None where its mesh cannot be read."""
    if isinstance(shape, schema.BoxShape):
        return np.array(shape.min), np.array(shape.max)
    if isinstance(shape, schema.MeshShape):
        if mesh is None or not len(mesh.points):
            return None
        return mesh.points.min(axis=0), mesh.points.max(axis=0)
    center = np.array(shape.center)
    half = shape.radius if isinstance(shape, schema.SphereShape) else np.array(shape.semi_axes)
    return center - half, center + half


def _place_findings(scene: PointScene, meshes: Mapping[str, Mesh]) -> Iterator[Finding]:
    low, high = np.array(scene.grid.low), np.array(scene.grid.high)
    slack = _ROUNDING * scene.grid.cell_size
    for name, body in scene.bodies.items():
        # What sticks out may be cut off; the points are looked at when they are made.
        found = None if body.without else _bounds(body.shape, meshes.get(name))
        if found is None or not all(len(bound) == scene.dim for bound in found):
            continue
        outside = (found[0] < low - slack) | (found[1] > high + slack)
        for axis in np.flatnonzero(outside):
            span = f"{found[0][axis]:.6g} to {found[1][axis]:.6g} m"
            domain = f"{low[axis]:g} to {high[axis]:g} m"
            yield Finding(
                ("bodies", name, "shape"),
                f"reaches from {span} along {'xyz'[axis]}, out of the domain, {domain} (grid.low, grid.high)",
            )


def _least(function: schema.TemperatureLaw) -> float | None:
    """Smallest value that a function of temperature takes; None where that depends on the temperatures."""
    if isinstance(function, schema.TableFunction):
        return min(function.values)
    if isinstance(function, schema.LinearFunction):
        return function.lowest if function.slope != 0.0 else function.value
    return function


def _tension_findings(name: str, tension: schema.SurfaceTensionBlock) -> Iterator[Finding]:
    path = ("bodies", name, "surface_tension")
    given: list[tuple[tuple[str | int, ...], Any]] = [((*path, "liquid_gas"), tension.liquid_gas)]
    given += [((*path, "regions", i, "liquid_gas"), each.liquid_gas) for i, each in enumerate(tension.regions)]
    for key, function in given:
        least = _least(function)
        if least is not None and least < 0.0:
            yield Finding(key, f"must not be negative, {least:g} [N/m]: such a surface grows without bounds")
    wet, free = tension.solid_liquid, tension.liquid_gas
    if isinstance(wet, float) and isinstance(free, float) and free >= 0.0 and wet + free < 0.0:
        limit = f"must not be below -liquid_gas, {-free:g} [N/m], not {wet:g}"
        yield Finding((*path, "solid_liquid"), f"{limit}: a film on the wall grows without bounds")


def _start_temperatures(body: schema.PointBody, mesh: Mesh | None) -> FloatArray:
    """Temperatures from the lowest to the highest that a body starts with [K]; none where these are not known."""
    start, shape = body.temperature, body.shape
    if isinstance(start, float):
        return np.array([start])
    slope = np.array(start.gradient)
    # What is cut out may have been the hottest or the coldest part.
    if body.without or (isinstance(shape, schema.MeshShape) and (mesh is None or mesh.dim != slope.size)):
        return np.empty(0)
    if isinstance(shape, schema.MeshShape):
        assert mesh is not None
        along = mesh.points @ slope
    elif isinstance(shape, schema.BoxShape):
        corners = np.array([shape.min, shape.max])
        along = np.array([(corners * slope).min(axis=0).sum(), (corners * slope).max(axis=0).sum()])
    else:
        reach = np.linalg.norm(slope * (shape.radius if isinstance(shape, schema.SphereShape) else shape.semi_axes))
        along = np.array(shape.center) @ slope + np.array([-reach, reach])
    found = start.value + along - np.array(start.at) @ slope
    return np.linspace(found.min(), found.max(), _SAMPLES)


def _at(function: schema.TemperatureLaw, temperatures: FloatArray) -> FloatArray:
    """Values of a function of temperature."""
    if isinstance(function, schema.TableFunction):
        return np.asarray(np.interp(temperatures, function.temperatures, function.values))
    if isinstance(function, schema.LinearFunction):
        values = function.value + function.slope * (temperatures - function.reference)
        return np.asarray(np.clip(values, *schema.limits(function)))
    return np.full(temperatures.shape, function)


def _start_tension_findings(
    name: str, body: schema.PointBody, tension: schema.SurfaceTensionBlock, mesh: Mesh | None
) -> Iterator[Finding]:
    """Tensions that are negative at the temperatures of the start, where the surface has them from the first step."""
    if not (body.starts_liquid or tension.on_solid):
        return
    temperatures = _start_temperatures(body, mesh)
    if temperatures.size == 0:
        return
    path = ("bodies", name, "surface_tension")
    free = _at(tension.liquid_gas, temperatures)
    given = [("liquid_gas", free, "must not be negative", "such a surface grows without bounds")]
    if tension.solid_liquid is not None:
        total = _at(tension.solid_liquid, temperatures) + free
        given.append(
            ("solid_liquid", total, "plus liquid_gas must not be negative", "a film on the wall grows without bounds")
        )
    for key, values, rule, why in given:
        worst = int(np.argmin(values))
        if values[worst] < 0.0:
            at = f"{values[worst]:g} [N/m] at {temperatures[worst]:g} [K], a temperature of the start"
            yield Finding((*path, key), f"{rule}, {at}: {why}")
            return


def _density_findings(name: str, body: schema.PointBody) -> Iterator[Finding]:
    solid, liquid = body.solid, body.liquid
    if solid is None or liquid is None or solid.density == liquid.density:
        return
    message = f"must be that of `solid`, {solid.density:g} [kg/m^3], not {liquid.density:g}"
    keeps = "what melts or freezes keeps its mass and its volume at rest"
    yield Finding(("bodies", name, "liquid", "density"), f"{message}: {keeps}")


def _phase_findings(name: str, body: schema.PointBody, melting: schema.MeltingBlock) -> Iterator[Finding]:
    temperature = body.temperature
    if not isinstance(temperature, float):
        return
    if body.starts_liquid and temperature < melting.solidus:
        limit = f"below solidus, {melting.solidus:g} [K]"
    elif not body.starts_liquid and temperature > melting.liquidus:
        limit = f"above liquidus, {melting.liquidus:g} [K]"
    else:
        return
    phase = "liquid" if body.starts_liquid else "solid"
    yield Finding(("bodies", name, "phase"), f"is {phase} at {temperature:g} [K], {limit}: give the other phase")
