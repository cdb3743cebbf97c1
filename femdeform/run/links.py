"""From the `links` of a scene to weak constraints between nodes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields

import numpy as np

from femdeform.contact.weak_constraints import ConstraintRows
from femdeform.errors import InputError
from femdeform.fem.discretization import number_nodes
from femdeform.fem.interpolation import nodal_weights
from femdeform.fem.node_sets import NodeSets
from femdeform.run.link_surfaces import HoldingSurface, LinkError, node_areas, place_in_words
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
from femdeform.types import FloatArray, IntArray, Mesh

# A tie reaches so far, in mean edge lengths of the surface that holds.
_REACH = 0.1


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
    return _joined(parts)


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


def _joined(parts: list[ConstraintRows]) -> ConstraintRows:
    arrays = {
        entry.name: np.concatenate([getattr(part, entry.name) for part in parts])
        for entry in fields(ConstraintRows)
        if entry.name != "offsets"
    }
    counts = np.concatenate([np.diff(part.offsets) for part in parts])
    return ConstraintRows(np.concatenate([[0], np.cumsum(counts)]).astype(np.int64), **arrays)


@dataclass(frozen=True)
class _Side:
    """One point of each of n rows: nodes (n, k) and weights (n, k), or a place in space with its velocity (n, dim)."""

    nodes: IntArray
    weights: FloatArray
    place: FloatArray
    velocity: FloatArray

    @classmethod
    def in_space(cls, place: FloatArray, velocity: FloatArray) -> _Side:
        none = np.empty((len(place), 0))
        return cls(none.astype(np.int64), none, place, np.broadcast_to(velocity, place.shape))

    @classmethod
    def of_nodes(cls, nodes: IntArray, weights: FloatArray, points: FloatArray) -> _Side:
        place = np.einsum("nk,nkc->nc", weights, points[nodes])
        return cls(nodes, weights, place, np.zeros_like(place))

    @property
    def is_in_space(self) -> bool:
        return self.nodes.size == 0


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
        first, second = self._ends(link.ends, path)
        length = float(np.linalg.norm(first.place - second.place)) if link.length is None else link.length
        rows = self._assemble(number, first, second, np.zeros((1, self._dim)), np.array([link.stiffness]), None)
        _refuse_empty(rows, path)
        return ConstraintRows(**{**vars(rows), "length": np.array([length])})

    def _pair(self, link: PairLink, number: int, path: KeyPath) -> ConstraintRows:
        first, second = self._ends(link.ends, path)
        target = np.zeros((1, self._dim)) if link.offset is None else np.array([link.offset])
        if link.gap == "kept":
            target = first.place - second.place
        rows = self._assemble(number, first, second, target, np.ones(1), link)
        _refuse_empty(rows, path)
        return rows

    def _ends(self, ends: list[LinkEnd], path: KeyPath) -> tuple[_Side, _Side]:
        first, second = (self._end(end, (*path, "ends", place)) for place, end in enumerate(ends))
        return first, second

    def _end(self, end: LinkEnd, path: KeyPath) -> _Side:
        point = np.array(end.at)
        if end.is_in_space:
            return _Side.in_space(point[None], self._velocity_of(end.obstacle))
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
        return _Side.of_nodes(nodes, weights, self._points)

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

    def _held_nodes(self, link: TieLink | BindingLink | AttachmentLink, path: KeyPath) -> tuple[IntArray, FloatArray]:
        """Nodes of `on`, increasing, and the factor of their stiffness: 1, or their share of the surface [m^2]."""
        nodes = self._nodes(link.on)
        if not isinstance(link, BindingLink) and link.per == "node":
            return nodes, np.ones(nodes.size)
        areas = node_areas(link.on, self._scene, self._meshes, self._sets, len(self._points))[nodes]
        if not areas.any():
            raise LinkError((*path, "on"), "holds nodes, but no facet of a surface whose area they could share")
        return nodes[areas > 0.0], areas[areas > 0.0]

    def _attachment(self, link: AttachmentLink, number: int, path: KeyPath) -> ConstraintRows:
        nodes, factors = self._held_nodes(link, path)
        place = self._points[nodes] if link.to is None else np.tile(np.array(link.to), (nodes.size, 1))
        velocity = self._velocity_of(link.obstacle) if link.velocity is None else np.array(link.velocity)
        first = _Side.of_nodes(nodes[:, None], np.ones((nodes.size, 1)), self._points)
        return self._assemble(number, first, _Side.in_space(place, velocity), np.zeros_like(place), factors, link)

    def _surfaces(self, link: TieLink | BindingLink, number: int, path: KeyPath) -> ConstraintRows:
        nodes, factors = self._held_nodes(link, path)
        surface = HoldingSurface(link.to, self._scene, self._meshes, self._bodies, (*path, "to"))
        shared = np.intersect1d(nodes, surface.nodes)
        if shared.size:
            where = place_in_words(self._points[shared[0]])
            message = f"holds nodes of `on` as well, {shared.size} of them ({where} first): they would hold themselves"
            raise LinkError((*path, "to"), message)
        points = self._points[nodes]
        found = surface.closest(points)
        if isinstance(link, TieLink):
            self._refuse_far(link, points, found.distance, surface, path)
        else:
            near = found.distance <= link.within
            if not near.any():
                message = f"no node is that near: the closest is {found.distance.min():.4g} m from the surface"
                raise LinkError((*path, "within"), message)
            nodes, factors, points = nodes[near], factors[near], points[near]
            found = found.select(np.flatnonzero(near))
        facets = np.full((nodes.size, self._dim), -1, dtype=np.int64)
        if link.tangential_stiffness is not None and link.direction is None:
            facets = surface.facets_of(found, path)
        parts = []
        for body in surface.bodies:
            mine = np.flatnonzero(found.body == body.number)
            if not mine.size:
                continue
            cells, barycentric = body.in_cells(found.select(mine), points[mine], link.gap == "kept")
            held, weights = self._interpolation(body.name, cells, barycentric)
            first = _Side.of_nodes(nodes[mine, None], np.ones((mine.size, 1)), self._points)
            second = _Side.of_nodes(held, weights, self._points)
            target = np.zeros((mine.size, self._dim))
            if link.gap == "kept" and body.is_thin:
                target = first.place - second.place
                if np.linalg.norm(target, axis=1).max(initial=0.0) > 1e-9 * surface.size:
                    self.notices.append(
                        f"{format_key(path)}: `{body.name}` is thin: the gap that is kept does not turn with it"
                    )
            parts.append(self._assemble(number, first, second, target, factors[mine], link, facets[mine]))
        return _joined(parts)

    def _refuse_far(
        self, link: TieLink, points: FloatArray, distance: FloatArray, surface: HoldingSurface, path: KeyPath
    ) -> None:
        reach = _REACH * surface.mean_edge if link.max_distance is None else link.max_distance
        far = np.flatnonzero(distance > reach)
        if far.size:
            worst = int(np.argmax(distance))
            given = "" if link.max_distance is not None else ", a tenth of its mean edge"
            message = (
                f"{far.size} of {distance.size} nodes are farther than {reach:.4g} m{given} from the surface that is "
                f"to hold them; the farthest, at {place_in_words(points[worst])}, by {distance[worst]:.4g} m"
            )
            raise LinkError((*path, "max_distance") if link.max_distance is not None else path, message)

    # --------------------------------------------------------------------------------------------- the rows

    def _assemble(
        self,
        number: int,
        first: _Side,
        second: _Side,
        target: FloatArray,
        factors: FloatArray,
        link: PairLink | AttachmentLink | TieLink | BindingLink | None,
        facets: IntArray | None = None,
    ) -> ConstraintRows:
        """Rows of C = first - second - target, with the stiffness of a link times factors, or the factors alone."""
        n = len(factors)
        for sign, side in ((1.0, first), (-1.0, second)):
            if side.is_in_space:
                target = target - sign * side.place
        velocity = (second.velocity if second.is_in_space else 0.0) - (first.velocity if first.is_in_space else 0.0)
        nodes = np.concatenate([first.nodes, second.nodes], axis=1)
        weights = np.concatenate([first.weights, -second.weights], axis=1)
        # A node that both points depend on enters once.
        key = (np.arange(n)[:, None] * len(self._points) + nodes).ravel()
        unique, inverse = np.unique(key, return_inverse=True)
        total = np.bincount(inverse.ravel(), weights=weights.ravel(), minlength=unique.size)
        unique, total = unique[total != 0.0], total[total != 0.0]
        counts = np.bincount(unique // len(self._points), minlength=n)
        across = along = 1.0
        direction = np.zeros((n, self._dim))
        if link is not None:
            along = link.stiffness
            across = along if link.tangential_stiffness is None else link.tangential_stiffness
            if link.direction is not None:
                direction[:] = np.array(link.direction) / np.linalg.norm(link.direction)
        return ConstraintRows(
            np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
            unique % len(self._points),
            total,
            target,
            np.broadcast_to(velocity, target.shape).copy(),
            np.zeros(n),
            along * factors,
            across * factors,
            direction,
            np.full((n, self._dim), -1, dtype=np.int64) if facets is None else facets,
            np.full(n, number, dtype=np.int64),
        )


def _refuse_empty(rows: ConstraintRows, path: KeyPath) -> None:
    if rows.nodes.size == 0:
        raise LinkError((*path, "ends"), "are the same point of the same body")
