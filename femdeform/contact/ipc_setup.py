"""From a scene to the numbers of incremental potential contact, and whether its bodies start where they may."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.contact.ipc import body_pairs, make_collision_mesh
from femdeform.contact.obstacles import smooth_parts
from femdeform.contact.surface import CollisionSurface, SurfacePart, collision_surface
from femdeform.scene import schema
from femdeform.scene.contact_schema import IPCMethod
from femdeform.scene.key_path import KeyPath
from femdeform.types import BoolArray, FloatArray, IntArray, Mesh

# Gap at which the barrier starts, in mean edge lengths of the surface.
_REACH = 0.1
# Thickest surface that is taken as it is, in shortest edges: vertices two edges apart must not count as touching.
_THICKEST = 0.3


@dataclass(frozen=True)
class ContactNumbers:
    """Lengths of a scene's contact.

    Attributes
    ----------
    reach : float
        Gap at which the barrier starts, d_hat [m].
    offset : float
        Smallest distance between surfaces of bodies, d_min [m].
    half_thickness : dict of str to float
        Half a membrane's thickness, a rod's radius, 0 for solids, by body [m].
    edge : dict of str to float
        Mean length of the edges of each body's surface [m].
    may_touch : (n_bodies, n_bodies) bool
        In the order of the scene's bodies.
    thinned : bool
        Whether `offset` is less than the bodies' thickness because their meshes are too fine for it.
    """

    reach: float
    offset: float
    half_thickness: dict[str, float]
    edge: dict[str, float]
    may_touch: BoolArray
    thinned: bool


def surface_facets(body: schema.Body, mesh: Mesh) -> IntArray:
    """Facets of a body that may touch, by points of its mesh: the boundary of a solid, else every cell."""
    return mesh.facet_groups["boundary"] if body.kind == "solid" else mesh.cells


def contact_numbers(scene: schema.DeformableScene, meshes: Mapping[str, Mesh]) -> ContactNumbers:
    """Lengths and pairs of a scene with incremental potential contact."""
    method = scene.contact
    assert isinstance(method, IPCMethod)
    half, mean, shortest = {}, {}, {}
    for name, mesh in meshes.items():
        body = scene.bodies[name]
        half[name] = 0.0
        if isinstance(body, schema.MembraneBody):
            half[name] = 0.5 * body.thickness
        elif isinstance(body, schema.RodBody):
            # In the plane a section is a height, as thick as it is for a unit depth.
            half[name] = 0.5 * body.cross_section if mesh.dim == 2 else float(np.sqrt(body.cross_section / np.pi))
        corners = mesh.points[surface_facets(body, mesh)]
        lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
        # Quadratic facets are split at the middles of their edges.
        mean[name] = float(lengths.mean()) / body.element_order
        shortest[name] = float(lengths.min()) / body.element_order
    names = list(meshes)
    may_touch = body_pairs(names, method.self_contact, method.between)
    pairs = [(half[names[i]] + half[names[j]]) for i, j in np.argwhere(may_touch)]
    offset = min(pairs, default=0.0)
    limit = _THICKEST * min(shortest.values())
    reach = method.distance if method.distance is not None else _REACH * min(mean.values())
    return ContactNumbers(reach, min(offset, limit), half, mean, may_touch, offset > limit)


# ------------------------------------------------------------------------------------------------ where they start


@dataclass(frozen=True)
class InitialFinding:
    """Something about where bodies start, with the key to blame; a notice does not keep a scene from running."""

    path: KeyPath
    message: str
    is_notice: bool = False


def initial_findings(scene: schema.DeformableScene, meshes: Mapping[str, Mesh]) -> list[InitialFinding]:
    """What is wrong or odd about the initial positions of a scene with incremental potential contact.

    Parameters
    ----------
    scene : DeformableScene
        With ``contact.method: ipc``.
    meshes : mapping of str to Mesh
        The meshes of all bodies.

    Raises
    ------
    MissingDependencyError
        If bodies may touch one another and ipctk cannot be imported.
    """
    numbers = contact_numbers(scene, meshes)
    parts, points, first = [], [], 0
    for name, mesh in meshes.items():
        facets = surface_facets(scene.bodies[name], mesh)
        parts.append(SurfacePart(name, first + facets, facets.shape[1], 1.0, numbers.half_thickness[name], 1.0))
        points.append(mesh.points)
        first += mesh.n_points
    surface = collision_surface(parts, np.concatenate(points))
    findings = [*_obstacle_findings(scene, surface)]
    if numbers.may_touch.any():
        findings += _body_findings(surface, numbers)
    if numbers.thinned:
        message = f"bodies are thicker than their meshes are wide: contact takes them {numbers.offset:.3g} m thick"
        findings.append(InitialFinding(("contact",), message, True))
    return findings


def _at(point: FloatArray) -> str:
    return "(" + ", ".join(f"{c:.4g}" for c in point) + ")"


def _obstacle_findings(scene: schema.DeformableScene, surface: CollisionSurface) -> Iterator[InitialFinding]:
    for index, obstacle in enumerate(scene.obstacles):
        if len(next(v for k, v in obstacle if k in ("point", "center", "min"))) != surface.dim:
            continue  # a fault of its own
        gap = np.min([shape.distance(surface.rest)[0] for shape in smooth_parts(obstacle)], axis=0)
        gap = gap - surface.half_thickness
        worst = int(np.argmin(gap))
        if gap[worst] <= 0.0:
            body = surface.bodies[surface.body[worst]]
            how = "touches it" if gap[worst] == 0.0 else f"reaches {-gap[worst]:.3g} m into it"
            message = f"`{body}` {how} at {_at(surface.rest[worst])}; with method ipc a body has to start with a gap"
            yield InitialFinding(("obstacles", index), message)


def _body_findings(surface: CollisionSurface, numbers: ContactNumbers) -> list[InitialFinding]:
    mesh = make_collision_mesh(surface, numbers.may_touch)
    import ipctk

    vertices = np.asfortranarray(surface.rest)
    if ipctk.has_intersections(mesh, vertices):
        first, second, point = _intersection(ipctk, mesh, surface)
        return [_between(surface, first, second, f"touches or intersects {{}} near {_at(point)}")]
    collisions = ipctk.NormalCollisions()
    collisions.build(mesh, vertices, numbers.reach, numbers.offset)
    if collisions.empty():
        return []
    ids, gap = _nearest(mesh, collisions, vertices)
    where = _at(vertices[ids].mean(axis=0))
    # The first vertex is of one side, the last of the other.
    if gap <= numbers.offset:
        thick = f", less than their thickness of {numbers.offset:.3g} m" if gap > 0.0 else ""
        how = f"is {gap:.3g} m from {{}} near {where}{thick}"
        return [_between(surface, ids[0], ids[-1], how if gap > 0.0 else f"touches {{}} near {where}")]
    if surface.body[ids[0]] == surface.body[ids[-1]]:
        message = (
            f"the barrier acts inside `{surface.bodies[surface.body[ids[0]]]}` at rest: parts of its surface near "
            f"{where} are {gap:.3g} m apart, the barrier reaches {numbers.reach + numbers.offset:.3g} m; a smaller "
            "`distance` avoids that"
        )
        return [InitialFinding(("contact", "distance"), message, True)]
    return []


def _nearest(mesh: Any, collisions: Any, vertices: FloatArray) -> tuple[list[int], float]:
    """Vertices and distance of the closest pair.

    ipctk's single collisions point into the set they are of: none of them may outlive it, so none leaves this function.
    """
    edges, faces = mesh.edges, mesh.faces
    distances = [collisions[k].compute_distance(vertices, edges, faces) for k in range(len(collisions))]
    closest = int(np.argmin(distances))
    ids = [i for i in collisions[closest].vertex_ids(edges, faces) if i >= 0]
    return ids, float(np.sqrt(distances[closest]))


def _between(surface: CollisionSurface, first: int, second: int, how: str) -> InitialFinding:
    a, b = sorted((int(surface.body[first]), int(surface.body[second])))
    name = surface.bodies[b]
    other = "itself" if a == b else f"`{surface.bodies[a]}`"
    message = f"`{name}` {how.format(other)}; with contact.method ipc surfaces have to start apart"
    return InitialFinding(("bodies", name, "mesh"), message)


def _intersection(ipctk: Any, mesh: Any, surface: CollisionSurface) -> tuple[int, int, FloatArray]:
    """A vertex of each of two surfaces that intersect, and a point there."""
    broad_phase = ipctk.LBVH()
    broad_phase.can_vertices_collide = mesh.can_collide
    vertices = np.asfortranarray(surface.rest)
    broad_phase.build(vertices, mesh.edges, mesh.faces)
    x = surface.rest
    if surface.dim == 2:
        for pair in broad_phase.detect_edge_edge_candidates():
            a, b = mesh.edges[pair.edge0_id], mesh.edges[pair.edge1_id]
            if ipctk.segment_segment_intersect(x[a[0]], x[a[1]], x[b[0]], x[b[1]]):
                return int(a[0]), int(b[0]), surface.rest[[*a, *b]].mean(axis=0)
    for pair in broad_phase.detect_edge_face_candidates():
        a, b = mesh.edges[pair.edge_id], mesh.faces[pair.face_id]
        if ipctk.is_edge_intersecting_triangle(x[a[0]], x[a[1]], x[b[0]], x[b[1]], x[b[2]]):
            return int(a[0]), int(b[0]), surface.rest[[*a, *b]].mean(axis=0)
    raise AssertionError("surfaces intersect, but no pair of their parts does")
