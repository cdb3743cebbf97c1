"""From a checked scene of material points to its points, materials, walls and surfaces."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.contact.obstacles import Box, Plane, Sphere
from femdeform.errors import InputError
from femdeform.materials import law_for
from femdeform.mpm.explicit_laws import Laws, Liquid
from femdeform.mpm.heat_content import HeatContent
from femdeform.mpm.particle_sampling import sample_particles
from femdeform.mpm.particles import LIQUID, SOLID, Particles
from femdeform.mpm.phase_change import Melting
from femdeform.mpm.point_terms import PointMaterials
from femdeform.mpm.rigid_walls import RigidWall
from femdeform.mpm.shapes import ClosedSurface, Ellipsoid
from femdeform.mpm.surface_coefficient import SurfaceTension, solid_liquid_coefficient
from femdeform.mpm.temperature_functions import Constant, Linear, Table, TemperatureFunction
from femdeform.run.closed_surface import closed_surface
from femdeform.scene import point_body_schema as schema
from femdeform.scene.point_schema import PointScene
from femdeform.types import BoolArray, FloatArray, Mesh


def temperature_function(block: schema.TemperatureLaw) -> TemperatureFunction:
    """The function that a scene gives."""
    if isinstance(block, schema.LinearFunction):
        low = -np.inf if block.lowest is None else block.lowest
        high = np.inf if block.highest is None else block.highest
        return Linear(block.value, block.slope, block.reference, low, high)
    if isinstance(block, schema.TableFunction):
        return Table(tuple(block.temperatures), tuple(block.values))
    return Constant(block)


def _shape(shape: Any, inside: bool, meshes: Mapping[str, Mesh], key: str) -> Any:
    if shape.kind == "box":
        return Box(np.array(shape.min), np.array(shape.max), inside)
    if shape.kind == "sphere":
        return Sphere(np.array(shape.center), shape.radius, inside)
    if shape.kind == "ellipsoid":
        return Ellipsoid(np.array(shape.center), np.array(shape.semi_axes), inside)
    if shape.kind == "plane":
        return Plane(np.array(shape.point), np.array(shape.normal))
    return ClosedSurface(*closed_surface(meshes[key]), inside)


def make_points(scene: PointScene, meshes: Mapping[str, Mesh]) -> Particles:
    """Points of all bodies as they start.

    Raises
    ------
    InputError
        If a body has no points, or some outside of the domain.
    """
    parts = []
    for number, (name, body) in enumerate(scene.bodies.items()):
        shape = _shape(body.shape, False, meshes, name)
        try:
            points = sample_particles(
                shape, scene.grid.cell_size, body.points_per_axis, body.density, body.jitter, body.seed
            )
        except InputError as error:
            raise InputError(f"bodies.{name}.shape: {error}") from None
        for cut in body.without:
            inside = _shape(cut, True, meshes, name).distance(points.x)[0] > 0.0
            points = points.take(np.flatnonzero(~inside))
        if points.n == 0:
            raise InputError(f"bodies.{name}.without: nothing is left of the body")
        outside = int(np.any((points.x < scene.grid.low) | (points.x > scene.grid.high), axis=1).sum())
        if outside:
            raise InputError(f"bodies.{name}.shape: {outside} points are outside of the domain (grid.low, grid.high)")
        points.body[:] = number
        points.phase[:] = LIQUID if body.starts_liquid else SOLID
        if body.velocity is not None:
            points.v[:] = body.velocity
        if body.angular_velocity is not None:
            _move(points, _turning(body.angular_velocity, points.dim))
        if body.velocity_gradient is not None:
            _move(points, np.array(body.velocity_gradient))
        if isinstance(body.temperature, schema.TemperatureStart):
            slope = np.array(body.temperature.gradient)
            points.temperature[:] = body.temperature.value + (points.x - np.array(body.temperature.at)) @ slope
            points.temperature_gradient[:] = slope
        else:
            points.temperature[:] = body.temperature
        if scene.transfer.scheme in ("pic", "flip"):
            points.affine[:] = 0.0  # these have none, nor the angular momentum that goes with it
        parts.append(points)
    return Particles.joined(parts)


def inside_body(body: schema.PointBody, name: str, meshes: Mapping[str, Mesh], x: FloatArray) -> BoolArray:
    """Which positions (n, dim) are inside of a body as it starts; what is cut out of its shape is outside."""
    inside = _shape(body.shape, False, meshes, name).distance(x)[0] < 0.0
    for cut in body.without:
        inside &= _shape(cut, False, meshes, name).distance(x)[0] >= 0.0
    return np.asarray(inside)


def _turning(rate: float | tuple[float, ...], dim: int) -> FloatArray:
    """Velocity gradient (dim, dim) of a rigid rotation [1/s]."""
    x, y, z = (0.0, 0.0, rate) if isinstance(rate, float) else rate
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])[:dim, :dim]


def _move(points: Particles, gradient: FloatArray) -> None:
    """Add a velocity that is linear about the centre of mass, to velocities and their gradients."""
    center = points.mass @ points.x / points.mass.sum()
    points.v += (points.x - center) @ gradient.T
    points.affine += gradient


def make_walls(scene: PointScene, meshes: Mapping[str, Mesh]) -> list[RigidWall]:
    """Walls; a container is the planes of its sides, which have smooth distances."""
    walls = []
    for number, wall in enumerate(scene.walls):
        velocity = np.zeros(scene.dim) if wall.velocity is None else np.array(wall.velocity)
        if wall.shape.kind == "box" and wall.inside:
            inward = np.eye(scene.dim)
            shapes: list[Any] = [Plane(np.array(wall.shape.min), normal) for normal in inward]
            shapes += [Plane(np.array(wall.shape.max), -normal) for normal in inward]
        else:
            shapes = [_shape(wall.shape, wall.inside, meshes, f"walls-{number}")]
        walls += [RigidWall(shape, wall.kind, velocity, wall.friction, wall.temperature) for shape in shapes]
    return walls


@dataclass(frozen=True)
class Materials:
    """What the bodies are made of.

    Attributes
    ----------
    laws : mapping
        By ``(body, phase)``, see `femdeform.mpm.explicit_laws`; liquids with their values at the first temperature.
    bulk_modulus, viscosity : list of TemperatureFunction
        Of the liquid phase of each body.
    moduli : list of (TemperatureFunction, TemperatureFunction) or None
        Young's modulus and Poisson's ratio of solids in which they follow the temperature.
    tensions : list of SurfaceTension or None
    heat : list of HeatContent, or None without heat
    conductivity : list of TemperatureFunction, or None without heat
    melting : list of Melting or None
    """

    laws: Laws
    bulk_modulus: list[TemperatureFunction]
    viscosity: list[TemperatureFunction]
    moduli: list[tuple[TemperatureFunction, TemperatureFunction] | None]
    tensions: list[SurfaceTension | None]
    heat: list[HeatContent] | None
    conductivity: list[TemperatureFunction] | None
    melting: list[Melting | None]

    @property
    def varies(self) -> bool:
        """Whether moduli, bulk modulus or viscosity of a body follow the temperature."""
        functions = [*self.bulk_modulus, *self.viscosity]
        return any(each is not None for each in self.moduli) or not all(isinstance(f, Constant) for f in functions)

    def stiffest(self, particles: Particles) -> Laws:
        """Laws with the largest constants that points of their bodies have, for the limits of explicit steps."""
        if not self.varies:
            return self.laws
        at, found = self.at(particles), dict(self.laws)
        for (number, phase), law in self.laws.items():
            mine = particles.body == number
            if phase == LIQUID:
                found[number, phase] = Liquid(at.bulk_modulus[mine].max(), at.viscosity[mine].max())
            elif at.moduli is not None and self.moduli[number] is not None:
                mu, lmbda = at.moduli[mine].max(axis=0)
                found[number, phase] = type(law).from_lame(mu, lmbda, particles.dim)
        return found

    def at(self, particles: Particles) -> PointMaterials:
        """Constants of all points at their temperatures."""
        solids = {body: law for (body, phase), law in self.laws.items() if phase == SOLID}
        bulk, viscosity = np.zeros(particles.n), np.zeros(particles.n)
        moduli = np.full((particles.n, 2), np.nan) if any(each is not None for each in self.moduli) else None
        for number, (stiff, viscous) in enumerate(zip(self.bulk_modulus, self.viscosity, strict=True)):
            mine = np.flatnonzero(particles.body == number)
            bulk[mine] = stiff(particles.temperature[mine])
            viscosity[mine] = viscous(particles.temperature[mine])
            functions = self.moduli[number]
            if moduli is not None and functions is not None:
                E, nu = (function(particles.temperature[mine]) for function in functions)
                moduli[mine, 0] = E / (2.0 * (1.0 + nu))
                moduli[mine, 1] = E * nu / ((1.0 + nu) * (1.0 - 2.0 * nu))
        return PointMaterials(solids, bulk, viscosity, moduli)

    def capacities(self, particles: Particles) -> FloatArray:
        """Specific heats (n,) at the temperatures of the points, without latent heat [J/(kg K)]."""
        assert self.heat is not None
        return _at_temperatures([each.capacity for each in self.heat], particles)

    def enthalpies(self, particles: Particles) -> FloatArray:
        """Heat (n,) that points hold above 0 K, latent heat included [J/kg]."""
        assert self.heat is not None
        return _at_temperatures([each.enthalpy for each in self.heat], particles)

    def recover_temperatures(self, particles: Particles, before: FloatArray, capacity: FloatArray) -> None:
        """Temperatures after a step of conduction with specific heats that are those of the temperatures before it."""
        assert self.heat is not None
        for number, content in enumerate(self.heat):
            if not content.is_proportional:
                mine = np.flatnonzero(particles.body == number)
                after = particles.temperature[mine]
                particles.temperature[mine] = content.recovered(before[mine], after, capacity[mine])

    def conductivities(self, particles: Particles) -> FloatArray:
        """Thermal conductivities (n,) at the temperatures of the points [W/(m K)]."""
        assert self.conductivity is not None
        return _at_temperatures(self.conductivity, particles)


def _at_temperatures(functions: Sequence[Callable[[FloatArray], FloatArray]], particles: Particles) -> FloatArray:
    """Values (n,) of the functions of each body at the temperatures of its points."""
    out = np.empty(particles.n)
    for number, function in enumerate(functions):
        mine = np.flatnonzero(particles.body == number)
        out[mine] = function(particles.temperature[mine])
    return out


def make_materials(scene: PointScene) -> Materials:
    """Materials of all bodies."""
    laws: dict[tuple[int, int], Any] = {}
    zero = Constant(0.0)
    bulk: list[TemperatureFunction] = []
    viscosity: list[TemperatureFunction] = []
    tensions: list[SurfaceTension | None] = []
    melting: list[Melting | None] = []
    moduli: list[tuple[TemperatureFunction, TemperatureFunction] | None] = []
    for number, body in enumerate(scene.bodies.values()):
        if body.solid is not None:
            laws[number, SOLID] = law_for(body.solid, scene.dim)
        moduli.append(None if body.moduli is None else _moduli(body))
        liquid = body.liquid
        bulk.append(zero if liquid is None else temperature_function(liquid.bulk_modulus))
        viscosity.append(zero if liquid is None else temperature_function(liquid.viscosity))
        if liquid is not None:
            first = (
                body.temperature.value if isinstance(body.temperature, schema.TemperatureStart) else body.temperature
            )
            values = (float(function(np.array([first]))[0]) for function in (bulk[-1], viscosity[-1]))
            laws[number, LIQUID] = Liquid(*values)
        tensions.append(None if body.surface_tension is None else _tension(body.surface_tension))
        melts = body.melting
        melting.append(None if melts is None else Melting(melts.solidus, melts.liquidus, melts.latent_heat))
    heats = [body.heat for body in scene.bodies.values()]
    known = [heat for heat in heats if heat is not None]
    has_heat = len(known) == len(heats)
    bands = zip(known, scene.bodies.values(), melting, strict=True) if has_heat else ()
    return Materials(
        laws,
        bulk,
        viscosity,
        moduli,
        tensions,
        [_heat_content(heat, body.melting, melts) for heat, body, melts in bands] if has_heat else None,
        [temperature_function(heat.conductivity) for heat in known] if has_heat else None,
        melting,
    )


def _moduli(body: schema.PointBody) -> tuple[TemperatureFunction, TemperatureFunction]:
    assert body.solid is not None
    assert body.moduli is not None
    given = body.moduli
    E = body.solid.youngs_modulus if given.youngs_modulus is None else given.youngs_modulus
    nu = body.solid.poisson_ratio if given.poisson_ratio is None else given.poisson_ratio
    return temperature_function(E), temperature_function(nu)


def _heat_content(heat: schema.HeatBlock, block: schema.MeltingBlock | None, melting: Melting | None) -> HeatContent:
    liquid = None if block is None or block.liquid_capacity is None else temperature_function(block.liquid_capacity)
    return HeatContent(temperature_function(heat.capacity), liquid, melting)


def _tension(block: schema.SurfaceTensionBlock) -> SurfaceTension:
    solid_liquid = None if block.solid_liquid is None else temperature_function(block.solid_liquid)
    if block.contact_angle is not None:
        assert isinstance(block.liquid_gas, float)
        solid_liquid = Constant(solid_liquid_coefficient(np.deg2rad(block.contact_angle), block.liquid_gas))
    regions = tuple((_inside(region.box), temperature_function(region.liquid_gas)) for region in block.regions)
    return SurfaceTension(temperature_function(block.liquid_gas), solid_liquid, regions, block.on_solid)


def _inside(box: tuple[tuple[float, ...], tuple[float, ...]]) -> Callable[[FloatArray], BoolArray]:
    low, high = (np.array(corner) for corner in box)
    return lambda points: np.asarray(((points >= low) & (points <= high)).all(axis=1))
