"""From the `links` of a scene to weak constraints between nodes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from femdeform.contact.weak_constraints import ConstraintRows
from femdeform.errors import InputError
from femdeform.fem.discretization import number_nodes
from femdeform.fem.interpolation import nodal_weights
from femdeform.fem.node_sets import NodeSets
from femdeform.run.link_rows import Held, Side, assemble, joined
from femdeform.run.link_surfaces import (
    Found,
    HoldingSurface,
    LinkError,
    SurfaceBody,
    facet_samples,
    node_areas,
    place_in_words,
)
from femdeform.scene import schema
from femdeform.scene.key_path import KeyPath, format_key
from femdeform.scene.link_schema import (
    AttachmentLink,
    BindingLink,
    LinkEnd,
    PairLink,
    SpringLink,
    TieLink,
)
from femdeform.scene.point_location import locate_point
from femdeform.scene.selection_schema import Selection
from femdeform.scene.selections import select_nodes
from femdeform.scene.validation import Finding
from femdeform.types import BoolArray, FloatArray, IntArray, Mesh

# A tie reaches so far, in mean edge lengths of the surface that holds.
_REACH = 0.1
# Gaps up to this part of the size of the bodies are none.
_ROUNDING = 1e-9
_NO_AREA = "holds nodes, but no facet of a surface whose area they could share"


def make_links(scene: schema.DeformableScene, meshes: Mapping[str, Mesh], notices: list[str]) -> ConstraintRows | None:
    """Weak constraints of a scene over the nodes of the whole problem; None if it has no links.

    Raises
    ------
    InputError
        If a point lies in no cell, a node too far from the surface that is to hold it, and the like.
    """
    if not scene.links:
        return None
    builder = LinkBuilder(scene, meshes)
    try:
        parts = [builder.rows(number, name) for number, name in enumerate(scene.links)]
    except LinkError as fault:
        raise InputError(f"{format_key(fault.path)}: {fault.message}") from None
    notices += builder.notices
    return joined(parts)


def link_lines(scene: schema.DeformableScene, meshes: Mapping[str, Mesh]) -> list[list[dict[str, Any]]]:
    """The lines between the two ends of springs and pairs, as plain data for pictures.

    Returns
    -------
    list of [end, end]
        An end has `nodes` of the whole problem and `weights`, or a `place` at time 0 [m] and its `velocity` [m/s].
    """
    ends = {name: link.ends for name, link in scene.links.items() if isinstance(link, (SpringLink, PairLink))}
    if not ends:
        return []
    builder = LinkBuilder(scene, meshes)
    return [[side.as_data() for side in builder.ends(pair, ("links", name))] for name, pair in ends.items()]


def link_findings(scene: schema.DeformableScene, meshes: Mapping[str, Mesh]) -> Iterator[Finding]:
    """Faults of links that only their geometry shows, the first of each.

    Parameters
    ----------
    scene : DeformableScene
        Its links name bodies, groups and obstacles that there are.
    meshes : mapping of str to Mesh
        The meshes of all bodies.
    """
    builder = LinkBuilder(scene, meshes)
    for number, name in enumerate(scene.links):
        try:
            builder.rows(number, name)
        except LinkError as fault:
            yield Finding(fault.path, fault.message)


class LinkBuilder:
    """Makes the rows of the links of a scene, one link at a time.

    Parameters
    ----------
    scene : DeformableScene
    meshes : mapping of str to Mesh

    Attributes
    ----------
    notices : list of str
        What the user should know.
    """

    def __init__(self, scene: schema.DeformableScene, meshes: Mapping[str, Mesh]) -> None:
        self._scene = scene
        self._meshes = meshes
        orders = {name: (mesh, scene.bodies[name].element_order) for name, mesh in meshes.items()}
        self._bodies, self._points = number_nodes(orders)
        self._sets = NodeSets(meshes, self._bodies)
        self._dim = int(self._points.shape[1])
        self.notices: list[str] = []

    def rows(self, number: int, name: str) -> ConstraintRows:
        """Rows of one link.

        Raises
        ------
        LinkError
            If its geometry does not allow it.
        """
        link, path = self._scene.links[name], ("links", name)
        if isinstance(link, SpringLink):
            return self._spring(link, number, path)
        if isinstance(link, PairLink):
            return self._pair(link, number, path)
        if isinstance(link, AttachmentLink):
            return self._attachment(link, number, path)
        return self._surfaces(link, number, path)

    # ------------------------------------------------------------------------------------------ two points

    def _spring(self, link: SpringLink, number: int, path: KeyPath) -> ConstraintRows:
        first, second = self.ends(link.ends, path)
        length = float(np.linalg.norm(first.place - second.place)) if link.length is None else link.length
        stiffness = np.array([link.stiffness])
        rows = assemble(number, len(self._points), first, second, np.zeros((1, self._dim)), stiffness, stiffness)
        _refuse_empty(rows, path)
        return ConstraintRows(**{**vars(rows), "length": np.array([length])})

    def _pair(self, link: PairLink, number: int, path: KeyPath) -> ConstraintRows:
        first, second = self.ends(link.ends, path)
        target = np.zeros((1, self._dim)) if link.offset is None else np.array([link.offset])
        if link.gap == "kept":
            target = first.place - second.place
        rows = self._rows(number, first, second, target, np.ones(1), link)
        _refuse_empty(rows, path)
        return rows

    def ends(self, ends: list[LinkEnd], path: KeyPath) -> tuple[Side, Side]:
        """Both points of a spring or pair, each of one row.

        Raises
        ------
        LinkError
            If a point lies in no cell, or in cells of several bodies.
        """
        first, second = (self._end(end, (*path, "ends", place)) for place, end in enumerate(ends))
        return first, second

    def _end(self, end: LinkEnd, path: KeyPath) -> Side:
        point = np.array(end.at)
        if end.is_in_space:
            return Side.in_space(point[None], self._velocity_of(end.obstacle))
        names = list(self._meshes) if end.body is None else [end.body]
        found = {name: locate_point(self._meshes[name], point) for name in names}
        held = {name: place for name, place in found.items() if place is not None}
        if not held:
            where = f"body `{end.body}`" if end.body is not None else "any body"
            message = f"{place_in_words(point)} lies in no cell of {where}; `fixed: true` makes it a point of space"
            raise LinkError((*path, "at"), message)
        if len(held) > 1:
            listed = ", ".join(f"`{name}`" for name in held)
            raise LinkError((*path, "body"), f"missing; several bodies hold {place_in_words(point)}: {listed}")
        ((name, place),) = held.items()
        nodes, weights = self._interpolation(name, np.array([place.cell]), place.barycentric[None])
        return Side.of_nodes(nodes, weights, self._points)

    def _velocity_of(self, obstacle: int | None) -> FloatArray:
        velocity = None if obstacle is None else self._scene.obstacles[obstacle].velocity
        return np.zeros(self._dim) if velocity is None else np.array(velocity)

    def _interpolation(self, body: str, cells: IntArray, barycentric: FloatArray) -> tuple[IntArray, FloatArray]:
        """Nodes of the whole problem (n, k) and weights (n, k) of points in cells of a body."""
        # What is zero up to rounding would couple nodes for nothing; sums stay exactly one.
        cut = np.where(np.abs(barycentric) < 1e-10, 0.0, barycentric)
        cut /= cut.sum(axis=1, keepdims=True)
        held = self._bodies[body]
        nodes = held.first + held.connectivity[cells]
        return nodes, nodal_weights(cut, self._meshes[body].cell_type, nodes.shape[1])

    # -------------------------------------------------------------------------------------- nodes of bodies

    def _nodes(self, selection: Selection) -> IntArray:
        """Nodes of the whole problem, increasing."""
        if isinstance(selection, str) and "." in selection:
            body, group = selection.split(".", 1)
            if group in self._meshes[body].facet_groups:
                return self._sets.from_facets(body, self._meshes[body].facet_groups[group])
        chosen = select_nodes(selection, self._meshes)
        return np.sort(np.concatenate([self._sets.from_points(body, n) for body, n in chosen.items()]))

    def _held_nodes(self, link: TieLink | AttachmentLink, path: KeyPath) -> Held:
        """Nodes of `on`, increasing; the factor of their stiffness is 1, or their share of the surface [m^2]."""
        nodes = self._nodes(link.on)
        if link.per == "node":
            return self._held(nodes, np.ones(nodes.size))
        return self._sharing(link.on, np.ones(len(self._points), dtype=bool), (*path, "on"), _NO_AREA)

    def _held(self, nodes: IntArray, factors: FloatArray) -> Held:
        return Held(Side.of_nodes(nodes[:, None], np.ones((nodes.size, 1)), self._points), factors)

    def _sharing(self, on: Selection, counted: BoolArray, path: KeyPath, otherwise: str) -> Held:
        """Nodes with a share of the surface of the facets all of whose nodes count."""
        shares = node_areas(on, self._scene, self._meshes, self._sets, counted)
        nodes = np.flatnonzero(shares > 0.0)
        if not nodes.size:
            raise LinkError(path, otherwise)
        return self._held(nodes, shares[nodes])

    def _held_points(self, link: TieLink | BindingLink, surface: HoldingSurface, path: KeyPath) -> list[Held]:
        """What a surface holds: nodes, or for a tie by area the quadrature points of facets."""
        if isinstance(link, BindingLink):
            nodes = self._nodes(link.on)
            distance = surface.closest(self._points[nodes]).distance
            near = np.zeros(len(self._points), dtype=bool)
            near[nodes[distance <= link.within]] = True
            message = f"no facet of `on` is that near with all its nodes; the closest node is at {distance.min():.4g} m"
            return [self._sharing(link.on, near, (*path, "within"), message)]
        if link.per == "node":
            return [self._held_nodes(link, path)]
        samples = facet_samples(link.on, self._scene, self._meshes, self._sets)
        if not samples:
            raise LinkError((*path, "on"), _NO_AREA)
        return [Held(Side.of_nodes(nodes, weights, self._points), areas) for nodes, weights, areas in samples]

    def _attachment(self, link: AttachmentLink, number: int, path: KeyPath) -> ConstraintRows:
        held = self._held_nodes(link, path)
        own = held.side.place
        place = own if link.to is None else np.tile(np.array(link.to), (len(own), 1))
        velocity = self._velocity_of(link.obstacle) if link.velocity is None else np.array(link.velocity)
        second = Side.in_space(place, velocity)
        return self._rows(number, held.side, second, np.zeros_like(place), held.factors, link)

    def _surfaces(self, link: TieLink | BindingLink, number: int, path: KeyPath) -> ConstraintRows:
        surface = HoldingSurface(link.to, self._scene, self._meshes, self._bodies, (*path, "to"))
        shared = np.intersect1d(self._nodes(link.on), surface.nodes)
        if shared.size:
            where = place_in_words(self._points[shared[0]])
            message = f"holds nodes of `on` as well, {shared.size} of them ({where} first): they would hold themselves"
            raise LinkError((*path, "to"), message)
        every = self._held_points(link, surface, path)
        found = [surface.closest(held.side.place) for held in every]
        if isinstance(link, TieLink):
            self._refuse_far(link, every, np.concatenate([some.distance for some in found]), surface, path)
        parts = []
        for held, some in zip(every, found, strict=True):
            for body in surface.bodies:
                mine = np.flatnonzero(some.body == body.number)
                if mine.size:
                    parts.append(self._held_by(link, number, held.select(mine), some.select(mine), surface, body, path))
        return joined(parts)

    def _held_by(
        self,
        link: TieLink | BindingLink,
        number: int,
        held: Held,
        found: Found,
        surface: HoldingSurface,
        body: SurfaceBody,
        path: KeyPath,
    ) -> ConstraintRows:
        """Rows of points that one body holds."""
        first = held.side
        cells, barycentric = body.in_cells(found, first.place, link.gap == "kept")
        second = Side.of_nodes(*self._interpolation(body.name, cells, barycentric), self._points)
        target = np.zeros_like(first.place)
        if link.gap == "kept" and body.is_thin:
            target = first.place - second.place
            if np.linalg.norm(target, axis=1).max() > _ROUNDING * surface.size:
                notice = f"{format_key(path)}: `{body.name}` is thin: the gap that is kept does not turn with it"
                self.notices.append(notice)
        facets = None
        if link.tangential_stiffness is not None and link.direction is None:
            facets = body.oriented_facets(found, path)
        return self._rows(number, first, second, target, held.factors, link, facets)

    def _refuse_far(
        self, link: TieLink, every: list[Held], distance: FloatArray, surface: HoldingSurface, path: KeyPath
    ) -> None:
        reach = _REACH * surface.mean_edge if link.max_distance is None else link.max_distance
        far = int(np.count_nonzero(distance > reach))
        if far:
            worst = int(np.argmax(distance))
            points = np.concatenate([held.side.place for held in every])
            given = "" if link.max_distance is not None else " (a tenth of its mean edge)"
            message = (
                f"{far} of {distance.size} {link.points_in_words} are farther than {reach:.4g} m{given} from the "
                f"surface that is to hold them; the farthest, at {place_in_words(points[worst])}, by "
                f"{distance[worst]:.4g} m"
            )
            raise LinkError((*path, "max_distance") if link.max_distance is not None else path, message)

    def _rows(
        self,
        number: int,
        first: Side,
        second: Side,
        target: FloatArray,
        factors: FloatArray,
        link: PairLink | AttachmentLink | TieLink | BindingLink,
        facets: IntArray | None = None,
    ) -> ConstraintRows:
        """Rows of C = first - second - target with the stiffness of a link times factors."""
        across = link.stiffness if link.tangential_stiffness is None else link.tangential_stiffness
        direction = np.zeros_like(target)
        if link.direction is not None:
            direction[:] = np.array(link.direction) / np.linalg.norm(link.direction)
        return assemble(
            number,
            len(self._points),
            first,
            second,
            target,
            link.stiffness * factors,
            across * factors,
            direction,
            facets,
        )


def _refuse_empty(rows: ConstraintRows, path: KeyPath) -> None:
    if rows.nodes.size == 0:
        raise LinkError((*path, "ends"), "are the same point of the same body")
