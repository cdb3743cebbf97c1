"""Faults of `links:` that only the rest of the scene and the meshes show."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from femdeform import registry
from femdeform.scene import schema
from femdeform.scene.key_path import KeyPath
from femdeform.scene.link_schema import AttachmentLink, BindingLink, LinkEnd, PairLink, SpringLink, TieLink
from femdeform.scene.selection_checks import judge_selection, unknown_body, vectors_inside
from femdeform.scene.selection_schema import Selection
from femdeform.scene.validation import Finding
from femdeform.types import Mesh


def link_findings(
    scene: schema.DeformableScene, meshes: Mapping[str, Mesh], coarse: frozenset[str]
) -> Iterator[Finding]:
    """Faults of references, and of links whose points are not where they have to be.

    Parameters
    ----------
    scene : DeformableScene
        A scene that passed the schema.
    meshes : mapping of str to Mesh
        Meshes by body, as far as there are any.
    coarse : frozenset of str
        Bodies whose mesh is a stand-in; where points lie is judged on real meshes of all bodies only.
    """
    findings: list[Finding] = []
    for name, link in scene.links.items():
        path: KeyPath = ("links", name)
        if isinstance(link, (PairLink, SpringLink)):
            for place, end in enumerate(link.ends):
                findings += _end_findings(end, (*path, "ends", place), scene)
        else:
            for key, selection in _selections(link):
                findings += judge_selection(selection, (*path, key), scene, meshes, coarse)
        if isinstance(link, AttachmentLink):
            findings += _obstacle_findings(link.obstacle, path, scene)
    yield from findings
    complete = set(meshes) == set(scene.bodies) and not coarse
    # Vectors of another dimension have faults of their own.
    dims = {mesh.dim for mesh in meshes.values()}
    if scene.links and complete and not findings and len(dims) == 1 and _fits(scene, *dims):
        yield from registry.resolve(registry.LINK_GEOMETRY)(scene, meshes)


def _selections(link: AttachmentLink | TieLink | BindingLink) -> Iterator[tuple[str, Selection]]:
    yield "on", link.on
    if not isinstance(link, AttachmentLink):
        yield "to", link.to


def _end_findings(end: LinkEnd, path: KeyPath, scene: schema.DeformableScene) -> Iterator[Finding]:
    if end.body is not None and end.body not in scene.bodies:
        yield unknown_body(end.body, (*path, "body"), scene)
    yield from _obstacle_findings(end.obstacle, path, scene)


def _obstacle_findings(number: int | None, path: KeyPath, scene: schema.DeformableScene) -> Iterator[Finding]:
    n = len(scene.obstacles)
    if number is not None and number >= n:
        known = f"there are {n}, from 0" if n else "there are none"
        yield Finding((*path, "obstacle"), f"there is no obstacle {number}; {known}")


def _fits(scene: schema.DeformableScene, dim: int) -> bool:

    vectors = [v for name, link in scene.links.items() for _, v in vectors_inside(link, ("links", name))]
    vectors += [obstacle.velocity for obstacle in scene.obstacles if obstacle.velocity is not None]
    return all(len(vector) == dim for vector in vectors)
