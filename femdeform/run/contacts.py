"""The contact terms of a scene."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from femdeform.contact.facing import FacetShares, FacingStiffness
from femdeform.contact.ipc import IPCContact, body_pairs
from femdeform.contact.ipc_setup import ContactNumbers, contact_numbers, initial_findings, surface_facets
from femdeform.contact.near_pairs import NearPairSearch
from femdeform.contact.obstacle_barrier import ObstacleBarrier
from femdeform.contact.obstacles import make_shape, smooth_parts
from femdeform.contact.penalty import PenaltyContact
from femdeform.contact.surface import CollisionSurface, SurfacePart, collision_surface
from femdeform.contact.terms import CouplingContact, NodeContact
from femdeform.contact.weak_contact import WeakContact
from femdeform.errors import InputError
from femdeform.fem.discretization import Discretization
from femdeform.fem.node_sets import NodeSets, facet_measure, holds_facets
from femdeform.scene import schema
from femdeform.scene.contact_schema import IPCMethod, WeakConstraintMethod
from femdeform.types import FloatArray, IntArray, Mesh

# Slip velocity up to which friction sticks, as a part of the scene's size per second.
_STICK_VELOCITY = 1e-3
# Default stiffness per area, in Young's moduli over the mean edge length of the surface.
_OF_MODULUS = 10.0
# Distance up to which weak constraints look for contact, in mean edge lengths.
_MARGIN = 0.5
# Overlaps at the start up to this part of the size of the bodies are none.
_ROUNDING = 1e-9


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
    contacts: list[NodeContact] = []
    for obstacle in scene.obstacles:
        nodes, weigh = _surface(scene, meshes, discretization, obstacle.stiffness)
        velocity = _velocity(obstacle, discretization.dim)
        contacts.append(
            PenaltyContact(make_shape(obstacle), nodes, weigh, obstacle.friction, velocity, _STICK_VELOCITY * size)
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


# ------------------------------------------------------------------------------------------------ weak constraints


def make_weak_contact(
    scene: schema.DeformableScene, meshes: Mapping[str, Mesh], discretization: Discretization, notices: list[str]
) -> WeakContact | None:
    """Contact between bodies by weak constraints, if the scene asks for it.

    Raises
    ------
    InputError
        If it is asked for on several ranks.
    """
    method = scene.contact
    if not isinstance(method, WeakConstraintMethod):
        return None
    if discretization.partition.comm is not None:
        raise InputError("contact: method weak_constraints is serial; run on one rank, or use method penalty")
    may_touch = body_pairs(list(meshes), method.self_contact, method.between)
    if not may_touch.any():
        return None
    sets = NodeSets(meshes, discretization.bodies)
    parts, edges, defaults = [], [], []
    for name, mesh in meshes.items():
        body = scene.bodies[name]
        facets = surface_facets(body, mesh)
        length = _mean_edge(mesh.points, facets) / body.element_order
        edges.append(length)
        defaults.append(_OF_MODULUS * _largest_modulus(body) / length)
        parts.append(SurfacePart(name, sets.facet_nodes(name, facets), facets.shape[1], 1.0, 0.0, 1.0))
    surface = collision_surface(parts, discretization.points)
    areas = surface.vertex_weight
    shares = areas if method.per == "area" else np.ones_like(areas)
    normal = np.array(defaults)[surface.body] * areas if method.stiffness is None else method.stiffness * shares
    margin = _MARGIN * min(edges) if method.margin is None else method.margin
    search = NearPairSearch(surface, may_touch, method.thickness + margin)
    contact = WeakContact(search, normal, method.tangential_stiffness * shares, method.thickness)
    notices += _overlap(contact, surface, discretization.points)
    return contact


def _overlap(contact: WeakContact, surface: CollisionSurface, points: FloatArray) -> list[str]:
    """What to tell the user of bodies that overlap at the start."""
    contact.begin_step(points, points)
    depth = contact.penetration(points)
    if depth <= _ROUNDING * float(np.ptp(surface.rest, axis=0).max()):
        return []
    worst = int(np.argmin(contact.gaps(points)))
    vertex, facet = np.searchsorted(surface.nodes, contact.cells[worst, :2])
    first, second = (surface.bodies[surface.body[i]] for i in (vertex, facet))
    other = "itself" if first == second else f"`{second}`"
    place = "(" + ", ".join(f"{c:.4g}" for c in surface.rest[vertex]) + ")"
    force = depth * contact.normal_stiffness[worst]
    return [
        f"contact: `{first}` starts inside {other}, or nearer to it than `thickness`, by {depth:.3g} m near {place}; "
        f"contact throws it out with up to {force:.3g} N a node"
    ]


def _mean_edge(points: FloatArray, facets: IntArray) -> float:
    """Mean length of the edges of facets, their nodes taken in turn [m]."""
    corners = points[facets]
    return float(np.mean(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)))


def _largest_modulus(body: schema.Body) -> float:
    return max(material.youngs_modulus for material in (body.material, *body.regions.values()) if material is not None)


# ------------------------------------------------------------------------------------------------------ penalty


def _surface(
    scene: schema.DeformableScene, meshes: Mapping[str, Mesh], discretization: Discretization, stiffness: float | None
) -> tuple[IntArray, FacingStiffness]:
    """Owned nodes on the surface, and their stiffness against an obstacle of a stiffness per area [Pa/m] or none."""
    sets = NodeSets(meshes, discretization.bodies)
    on_surface = []
    parts = []
    for name, mesh in meshes.items():
        body = scene.bodies[name]
        facets = surface_facets(body, mesh)
        measure = facet_measure(mesh.points, facets)
        if body.kind == "rod":
            measure = measure * np.sqrt(body.cross_section)
        nodes = sets.facet_nodes(name, facets)
        on_surface.append(np.unique(nodes))
        default = _OF_MODULUS * _largest_modulus(body) / _mean_edge(mesh.points, facets)
        per_area = default if stiffness is None else stiffness
        held = holds_facets(discretization, name, mesh, facets)
        local = discretization.local_numbers[nodes[held]]
        # Equal shares: the corners of a quadratic facet carry no load in the energy, but they must not fall through.
        share = per_area * measure[held] / nodes.shape[1]
        parts.append(FacetShares(local, facets.shape[1], share, body.kind == "solid"))
    local = discretization.local_numbers[np.concatenate(on_surface)]
    owned = local[(local >= 0) & (local < discretization.partition.n_owned)]
    return owned, FacingStiffness(parts, owned, discretization.partition)
