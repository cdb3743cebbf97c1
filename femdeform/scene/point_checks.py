"""What the schema alone cannot judge about material points: dimensions, places, what does not go together."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from femdeform.scene import point_body_schema as schema
from femdeform.scene.filled_mesh_checks import why_nothing_is_inside
from femdeform.scene.key_path import KeyPath
from femdeform.scene.measured_checks import unmeasured_findings
from femdeform.scene.point_quantity_schema import ContactAngleQuantity
from femdeform.scene.point_schema import PointScene, PointVectorQuantity
from femdeform.scene.point_start_checks import start_findings
from femdeform.scene.validation import Finding
from femdeform.scene.wording import did_you_mean
from femdeform.types import Mesh


def point_findings(scene: PointScene, meshes: Mapping[str, Mesh]) -> Iterator[Finding]:
    """Findings about a scene that passed the schema.

    Parameters
    ----------
    scene : PointScene
        The scene.
    meshes : mapping of str to Mesh
        Meshes of bodies and walls.
    """
    wrong = list(_dimension_findings(scene))
    yield from wrong
    if not wrong:
        yield from start_findings(scene, meshes)
    yield from _mesh_findings(scene, meshes)
    yield from _heat_findings(scene)
    yield from _scheme_findings(scene)
    yield from _measure_findings(scene)


def _heated_places(scene: PointScene) -> Iterator[tuple[KeyPath, schema.HeatedPlace]]:
    for name, body in scene.bodies.items():
        for key in ("flux_within", "source_within"):
            place = None if body.heat is None else getattr(body.heat, key)
            if place is not None:
                yield ("bodies", name, "heat", key), place


def _vectors(scene: PointScene) -> Iterator[tuple[KeyPath, Sequence[Any]]]:
    if scene.gravity is not None:
        yield ("gravity",), scene.gravity
    for name, quantity in scene.measure.items():
        region = getattr(quantity, "within", None)
        for key in ("center", "min", "max"):
            vector = getattr(region, key, None)
            if vector is not None:
                yield ("measure", name, "within", key), vector
    shapes: list[tuple[KeyPath, Any]] = [(("bodies", name, "shape"), body.shape) for name, body in scene.bodies.items()]
    for name, body in scene.bodies.items():
        shapes += [(("bodies", name, "without", index), shape) for index, shape in enumerate(body.without)]
    places = list(_heated_places(scene))
    shapes += places
    shapes += [(("walls", number, "shape"), wall.shape) for number, wall in enumerate(scene.walls)]
    for path, shape in shapes:
        for key in ("center", "semi_axes", "min", "max", "point", "normal", "velocity"):
            vector = getattr(shape, key, None)
            if vector is not None:
                yield (*path, key), vector
    for path, place in places:
        if isinstance(place, schema.Wick):
            for index, point in enumerate(place.path):
                yield (*path, "path", index), point
    for number, wall in enumerate(scene.walls):
        if wall.velocity is not None:
            yield ("walls", number, "velocity"), wall.velocity
    for name, body in scene.bodies.items():
        if body.velocity is not None:
            yield ("bodies", name, "velocity"), body.velocity
        if body.velocity_gradient is not None:
            yield ("bodies", name, "velocity_gradient"), body.velocity_gradient
            for index, row in enumerate(body.velocity_gradient):
                yield ("bodies", name, "velocity_gradient", index), row
        if isinstance(body.temperature, schema.TemperatureStart):
            yield ("bodies", name, "temperature", "gradient"), body.temperature.gradient
            yield ("bodies", name, "temperature", "at"), body.temperature.at
        if body.surface_tension is not None:
            for index, region in enumerate(body.surface_tension.regions):
                yield ("bodies", name, "surface_tension", "regions", index, "box", 0), region.box[0]
                yield ("bodies", name, "surface_tension", "regions", index, "box", 1), region.box[1]


def _dimension_findings(scene: PointScene) -> Iterator[Finding]:
    for path, vector in _vectors(scene):
        if len(vector) != scene.dim:
            yield Finding(path, f"needs {scene.dim} numbers in a domain of {scene.dim} dimensions, not {len(vector)}")
    for name, body in scene.bodies.items():
        rate = body.angular_velocity
        if rate is not None and isinstance(rate, float) != (scene.dim == 2):
            wanted = "a number in 2D" if scene.dim == 2 else "a vector in 3D"
            yield Finding(("bodies", name, "angular_velocity"), f"is {wanted}")
        elif isinstance(rate, tuple) and len(rate) != 3:
            yield Finding(("bodies", name, "angular_velocity"), "needs 3 numbers")


def _mesh_findings(scene: PointScene, meshes: Mapping[str, Mesh]) -> Iterator[Finding]:
    for name, (path, _) in scene.mesh_sources().items():
        mesh = meshes.get(name)
        fault = "" if mesh is None else why_nothing_is_inside(mesh, scene.dim, "domain")
        if fault:
            yield Finding(path, fault)


def _heat_findings(scene: PointScene) -> Iterator[Finding]:
    having = [name for name, body in scene.bodies.items() if body.heat is not None]
    if having and len(having) < len(scene.bodies):
        lacking = next(name for name in scene.bodies if name not in having)
        yield Finding(("bodies", lacking), f"needs `heat`, as `{having[0]}` has it: all bodies conduct it, or none")
    for number, wall in enumerate(scene.walls):
        if wall.temperature is not None and not having:
            yield Finding(("walls", number, "temperature"), "needs bodies that conduct heat: give them `heat`")


def _scheme_findings(scene: PointScene) -> Iterator[Finding]:
    for name, body in scene.bodies.items():
        liquid = body.liquid
        if body.surface_tension is not None and liquid is None and not body.surface_tension.on_solid:
            yield Finding(("bodies", name, "surface_tension"), "acts on liquid only; give `liquid`, or on_solid: true")
    if scene.time.scheme == "explicit" and scene.surface.symmetric:
        yield Finding(("surface", "symmetric"), "is for implicit steps: explicit ones keep the angular momentum anyway")


def _measure_findings(scene: PointScene) -> Iterator[Finding]:
    for name, quantity in scene.measure.items():
        if quantity.body is not None and quantity.body not in scene.bodies:
            hint = did_you_mean(quantity.body, scene.bodies)
            yield Finding(("measure", name, "body"), f"there is no body `{quantity.body}`; {hint}")
        if isinstance(quantity, ContactAngleQuantity) and not (
            quantity.wall < len(scene.walls) and scene.walls[quantity.wall].shape.kind == "plane"
        ):
            yield Finding(("measure", name, "wall"), f"wall {quantity.wall} is not one of `walls` that is a plane")
        if not isinstance(quantity, PointVectorQuantity):
            continue
        is_spin = quantity.kind == "angular_momentum"
        if scene.dim == 2 and quantity.component in (("x", "y") if is_spin else ("z",)):
            yield Finding(("measure", name, "component"), f"there is no {quantity.component} in the plane")
    yield from unmeasured_findings(scene)
    for index, wanted in enumerate(scene.expect.over_time):
        path = ("expect", "over_time", index)
        if wanted.quantity not in scene.measure:
            hint = did_you_mean(wanted.quantity, scene.measure)
            yield Finding((*path, "quantity"), f"`{wanted.quantity}` is not measured; {hint}")
        if wanted.after >= scene.time.end:
            yield Finding((*path, "after"), f"must be before the end of the run, {scene.time.end:g} [s]")
