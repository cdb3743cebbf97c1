"""The contact terms of a scene."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from femdeform.contact.ipc import IPCContact
from femdeform.contact.ipc_setup import ContactNumbers, contact_numbers, initial_findings, surface_facets
from femdeform.contact.obstacle_barrier import ObstacleBarrier
from femdeform.contact.obstacles import make_shape, smooth_parts
from femdeform.contact.penalty import PenaltyContact
from femdeform.contact.surface import CollisionSurface, SurfacePart, collision_surface
from femdeform.contact.terms import CouplingContact, NodeContact
from femdeform.errors import InputError
from femdeform.fem.discretization import Discretization
from femdeform.fem.node_sets import NodeSets, facet_measure
from femdeform.scene import schema
from femdeform.scene.contact_schema import IPCMethod
from femdeform.types import FloatArray, IntArray, Mesh

# Slip velocity up to which friction sticks, as a part of the scene's size per second.
_STICK_VELOCITY = 1e-3


def make_contacts(
    scene: schema.DeformableScene,
    meshes: Mapping[str, Mesh],
    discretization: Discretization,
    notices: list[str],
) -> tuple[list[NodeContact], list[CouplingContact]]:
    """Contact with obstacles on the surface nodes this rank owns, and contact between bodies.

    Raises
    ------
    InputError
        If contact between bodies is asked for on several ranks.
    """
    size = max(float(np.linalg.norm(np.ptp(mesh.points, axis=0))) for mesh in meshes.values())
    if isinstance(scene.contact, IPCMethod):
        if discretization.partition.comm is not None:
            raise InputError("contact: method ipc is serial; run on one rank, or use method penalty")
        return _barriers(scene, scene.contact, meshes, discretization, notices, _STICK_VELOCITY * size)
    if not scene.obstacles:
        return [], []
    nodes, areas, default = _surface(scene, meshes, discretization)
    contacts: list[NodeContact] = []
    for obstacle in scene.obstacles:
        stiffness = areas * (default if obstacle.stiffness is None else obstacle.stiffness)
        velocity = _velocity(obstacle, discretization.dim)
        contacts.append(
            PenaltyContact(make_shape(obstacle), nodes, stiffness, obstacle.friction, velocity, _STICK_VELOCITY * size)
        )
    return contacts, []


def _velocity(obstacle: schema.Obstacle, dim: int) -> FloatArray:
    return np.zeros(dim) if obstacle.velocity is None else np.array(obstacle.velocity)


# --------------------------------------------------------------------------------- incremental potential contact


def _barriers(
    scene: schema.DeformableScene,
    method: IPCMethod,
    meshes: Mapping[str, Mesh],
    discretization: Discretization,
    notices: list[str],
    stick_velocity: float,
) -> tuple[list[NodeContact], list[CouplingContact]]:
    numbers = contact_numbers(scene, meshes)
    notices += [f"contact: {found.message}" for found in initial_findings(scene, meshes) if found.is_notice]
    surface = _collision_surface(scene, method, meshes, discretization, numbers)
    contacts: list[NodeContact] = [
        ObstacleBarrier(
            shape,
            surface.nodes,
            surface.vertex_weight,
            surface.half_thickness,
            numbers.reach,
            obstacle.friction,
            _velocity(obstacle, discretization.dim),
            stick_velocity if method.friction_velocity is None else method.friction_velocity,
        )
        for obstacle in scene.obstacles
        for shape in smooth_parts(obstacle)
    ]
    couplings: list[CouplingContact] = []
    if numbers.may_touch.any():
        couplings.append(
            IPCContact(
                surface,
                numbers.may_touch,
                numbers.reach,
                numbers.offset,
                method.friction,
                stick_velocity if method.friction_velocity is None else method.friction_velocity,
            )
        )
    return contacts, couplings


def _collision_surface(
    scene: schema.DeformableScene,
    method: IPCMethod,
    meshes: Mapping[str, Mesh],
    discretization: Discretization,
    numbers: ContactNumbers,
) -> CollisionSurface:
    sets = NodeSets(meshes, discretization.bodies)
    parts = []
    for name, mesh in meshes.items():
        body = scene.bodies[name]
        facets = surface_facets(body, mesh)
        width = 1.0
        if body.kind == "rod" and mesh.dim == 3:
            width = 2.0 * numbers.half_thickness[name]
        area = width * float(facet_measure(mesh.points, facets).sum())
        if method.stiffness == "auto":
            held = discretization.bodies[name]
            mass = float(discretization.lumped_mass[held.first : held.first + held.n_nodes].sum())
            inertia = 0.0 if scene.time.scheme == "quasistatic" else mass / (area * scene.time.dt**2)
            stiffness = numbers.reach * max(_elastic_resistance(body, numbers, name), inertia)
        else:
            stiffness = method.stiffness
        parts.append(
            SurfacePart(
                name,
                sets.facet_nodes(name, facets),
                facets.shape[1],
                width,
                numbers.half_thickness[name],
                stiffness,
            )
        )
    return collision_surface(parts, discretization.points)


def _elastic_resistance(body: schema.Body, numbers: ContactNumbers, name: str) -> float:
    """Pressure per displacement that one layer of elements answers with [Pa/m]; E over the element size in solids."""
    materials = [material for material in (body.material, *body.regions.values()) if material is not None]
    size = numbers.edge[name]
    slender = min(1.0, 2.0 * numbers.half_thickness[name] / size) if body.kind != "solid" else 1.0
    return min(material.youngs_modulus for material in materials) / size * slender


# ------------------------------------------------------------------------------------------------------ penalty


def _surface(
    scene: schema.DeformableScene, meshes: Mapping[str, Mesh], discretization: Discretization
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Owned surface nodes, the area around each [m^2], and the default stiffness per area there [Pa/m]."""
    sets = NodeSets(meshes, discretization.bodies)
    area = np.zeros(discretization.partition.n_global)
    default = np.zeros_like(area)
    for name, mesh in meshes.items():
        body = scene.bodies[name]
        facets = mesh.facet_groups["boundary"] if body.kind == "solid" else mesh.cells
        measure = facet_measure(mesh.points, facets)
        if body.kind == "rod":
            measure = measure * np.sqrt(body.cross_section)
        numbers = sets.facet_nodes(name, facets)
        # Equal shares: the corners of a quadratic facet carry no load in the energy, but they must not fall through.
        np.add.at(area, numbers, np.repeat((measure / numbers.shape[1])[:, None], numbers.shape[1], axis=1))
        materials = [body.material, *body.regions.values()]
        modulus = max(material.youngs_modulus for material in materials if material is not None)
        edges = mesh.points[facets]
        length = float(np.mean(np.linalg.norm(edges - np.roll(edges, 1, axis=1), axis=2)))
        default[np.unique(numbers)] = 10.0 * modulus / length
    chosen = np.flatnonzero(area > 0.0)
    local = discretization.local_numbers[chosen]
    owned = (local >= 0) & (local < discretization.partition.n_owned)
    return local[owned], area[chosen[owned]], default[chosen[owned]]
