"""Faults of selections and points: names, places and numbers that mean nothing on the meshes of a scene."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
from pydantic import BaseModel

from femdeform.errors import InputError
from femdeform.scene import schema
from femdeform.scene.key_path import KeyPath
from femdeform.scene.point_location import locate_point
from femdeform.scene.selection_schema import NodeSelection, Selection
from femdeform.scene.selections import select_facets, select_nodes
from femdeform.scene.validation import Finding
from femdeform.scene.wording import did_you_mean
from femdeform.types import Mesh

COMPONENTS = "xyz"


def vectors_inside(
    value: Any, path: KeyPath, leave_out: tuple[str, ...] = ()
) -> Iterator[tuple[KeyPath, tuple[float, ...]]]:
    """Vectors inside a block, with their keys; selections and lists of vectors are looked into."""
    if isinstance(value, BaseModel):
        for name in type(value).model_fields:
            if name not in leave_out:
                yield from vectors_inside(getattr(value, name), (*path, name))
    elif isinstance(value, tuple) and value and all(isinstance(entry, float) for entry in value):
        yield path, value
    elif isinstance(value, (tuple, list)):
        for index, entry in enumerate(value):
            if isinstance(entry, tuple):
                yield from vectors_inside(entry, (*path, index))


def judge_selection(
    selection: Selection,
    path: KeyPath,
    scene: schema.DeformableScene,
    meshes: Mapping[str, Mesh],
    coarse: frozenset[str],
    needs_facets: bool = False,
) -> Iterator[Finding]:
    """Faults of one `on:`: unknown names, places and numbers without a node, nodes without a facet.

    Parameters
    ----------
    selection : str or selection model
        The `on:`.
    path : tuple of str or int
        Its key.
    scene : DeformableScene
        A scene that passed the schema.
    meshes : mapping of str to Mesh
        Meshes by body, as far as there are any.
    coarse : frozenset of str
        Bodies whose mesh is a stand-in on which places and numbers cannot be judged.
    needs_facets : bool
        A load that acts on facets.
    """
    if isinstance(selection, str):
        yield from _judge_name(selection, path, scene, meshes, needs_facets)
        return
    if selection.body is not None and selection.body not in scene.bodies:
        yield unknown_body(selection.body, (*path, "body"), scene)
        return
    concerned = [selection.body] if selection.body is not None else list(scene.bodies)
    if isinstance(selection, NodeSelection) and len(concerned) > 1:
        message = f"with several bodies, `body` has to say whose nodes are meant; {did_you_mean('', scene.bodies)}"
        yield Finding((*path, "body"), f"missing; {message}")
        return
    judged = {name: meshes[name] for name in concerned if name in meshes and name not in coarse}
    dims = {mesh.dim for mesh in meshes.values()}
    if len(judged) < len(concerned) or len(dims) > 1:
        return  # no mesh to judge it by, or a fault that is reported already
    if any(len(vector) not in dims for _, vector in vectors_inside(selection, ())):
        return
    try:
        found = select_nodes(selection, judged)
    except InputError as error:
        yield Finding((*path, "nodes"), error.faults[0].message)
        return
    yield from _judge_extent(found, selection, path, scene, judged, needs_facets, "the place")


def _judge_name(
    name: str, path: KeyPath, scene: schema.DeformableScene, meshes: Mapping[str, Mesh], needs_facets: bool
) -> Iterator[Finding]:
    body, dot, group = name.partition(".")
    if body not in scene.bodies:
        owners = [f"{owner}.{name}" for owner, mesh in meshes.items() if name in mesh.group_names()]
        if owners:
            yield Finding(path, f"`{name}` is a group, not a body; did you mean `{owners[0]}`?")
        else:
            yield unknown_body(body, path, scene)
        return
    if body not in meshes:
        return
    known = meshes[body].group_names()
    if dot and group not in known:
        hint = did_you_mean(group, known)
        listed = f" (groups: {', '.join(known)})" if hint.startswith("did") else ""
        yield Finding(path, f"body `{body}` has no group `{group}`; {hint}{listed}")
        return
    yield from _judge_extent(select_nodes(name, meshes), name, path, scene, meshes, needs_facets, f"`{name}`")


def _judge_extent(
    nodes: Mapping[str, Any],
    selection: Selection,
    path: KeyPath,
    scene: schema.DeformableScene,
    meshes: Mapping[str, Mesh],
    needs_facets: bool,
    subject: str,
) -> Iterator[Finding]:
    if not nodes:
        yield Finding(path, f"selects nothing: no node lies there ({_extent(meshes)})")
    elif needs_facets:
        # The end of a rod is a point: it has no area, nor a normal.
        others = [body for body in nodes if scene.bodies[body].kind == "rod"]
        if others:
            message = f"body `{others[0]}` is a rod, but this load acts on areas; use point_load"
            yield Finding(path, message)
        elif not select_facets(selection, meshes):
            what = "facet of the boundary"
            if all(scene.bodies[body].kind == "membrane" for body in nodes):
                what = "whole cell of the membrane"
            yield Finding(path, f"{subject} holds nodes, but no {what} for the load to act on")


def unknown_body(name: str, path: KeyPath, scene: schema.DeformableScene) -> Finding:
    """Fault of a name that no body of the scene has."""
    return Finding(path, f"there is no body `{name}`; {did_you_mean(name, scene.bodies)}")


def judge_point(
    point: tuple[float, ...], path: KeyPath, meshes: Mapping[str, Mesh], n_bodies: int, coarse: frozenset[str]
) -> Iterator[Finding]:
    """Fault of a point that lies in no cell; not judged where a mesh is missing or a stand-in."""
    dims = {mesh.dim for mesh in meshes.values()}
    if coarse or len(meshes) < n_bodies or dims != {len(point)}:
        return
    if all(locate_point(mesh, np.array(point)) is None for mesh in meshes.values()):
        yield Finding(path, f"the point lies in no cell ({_extent(meshes)})")


def _extent(meshes: Mapping[str, Mesh]) -> str:
    low = np.min([mesh.points.min(axis=0) for mesh in meshes.values()], axis=0)
    high = np.max([mesh.points.max(axis=0) for mesh in meshes.values()], axis=0)
    ranges = [f"{axis} {a:.4g} to {b:.4g}" for axis, a, b in zip(COMPONENTS, low, high, strict=False)]
    return f"the nodes span {', '.join(ranges)} [m]"


def hint_of(word: str, known: Iterable[str]) -> str:
    """Hint at a group of cells."""
    names = sorted(known)
    return did_you_mean(word, names) if names else "the mesh names no groups of cells"
