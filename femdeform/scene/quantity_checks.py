"""Faults of `measure:` and `expect:` that only the meshes and the rest of the scene show."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from femdeform.scene import schema
from femdeform.scene.contact_schema import WeakConstraintMethod
from femdeform.scene.key_path import KeyPath
from femdeform.scene.quantity_schema import (
    CellQuantity,
    ContactQuantity,
    LinkForceQuantity,
    LinkQuantity,
    MomentQuantity,
    MomentumQuantity,
)
from femdeform.scene.selection_checks import COMPONENTS, judge_point, judge_selection, unknown_body, vectors_inside
from femdeform.scene.validation import Finding
from femdeform.scene.wording import did_you_mean
from femdeform.types import Mesh


def quantity_findings(
    scene: schema.DeformableScene, meshes: Mapping[str, Mesh], coarse: frozenset[str]
) -> Iterator[Finding]:
    """Faults of places, components, bodies and references to quantities.

    Parameters
    ----------
    scene : DeformableScene
        A scene that passed the schema.
    meshes : mapping of str to Mesh
        Meshes by body, as far as there are any.
    coarse : frozenset of str
        Bodies whose mesh is a stand-in on which places and numbers cannot be judged.
    """
    dims = {mesh.dim for mesh in meshes.values()}
    for path, block in _placed_blocks(scene):
        on, at = getattr(block, "on", None), getattr(block, "at", None)
        if on is not None:
            yield from judge_selection(on, (*path, "on"), scene, meshes, coarse)
        if at is not None:
            yield from judge_point(at, (*path, "at"), meshes, len(scene.bodies), coarse)
        if len(dims) == 1:
            yield from _dimension_findings(block, path, *dims)
        if isinstance(block, CellQuantity) and block.body is not None and block.body not in scene.bodies:
            yield unknown_body(block.body, (*path, "body"), scene)
        if isinstance(block, (LinkQuantity, LinkForceQuantity)):
            yield from _link_findings(block.link, path, scene)
        if isinstance(block, ContactQuantity) and not isinstance(scene.contact, WeakConstraintMethod):
            yield Finding((*path, "kind"), f"{block.kind} is known with contact.method weak_constraints only")
    for name in scene.expect.measured:
        if name not in scene.measure:
            yield Finding(("expect", "measured", name), _unknown(name, scene))
    for index, expected in enumerate(scene.expect.time_to_reach):
        if expected.quantity not in scene.measure:
            yield Finding(("expect", "time_to_reach", index, "quantity"), _unknown(expected.quantity, scene))


def _link_findings(name: str | None, path: KeyPath, scene: schema.DeformableScene) -> Iterator[Finding]:
    if not scene.links:
        yield Finding((*path, "kind"), "the scene has no `links`")
    elif name is not None and name not in scene.links:
        yield Finding((*path, "link"), f"there is no link `{name}`; {did_you_mean(name, scene.links)}")


def _placed_blocks(scene: schema.DeformableScene) -> Iterator[tuple[KeyPath, Any]]:
    for name, quantity in scene.measure.items():
        yield ("measure", name), quantity
    for key in ("displacement", "reaction"):
        for index, expected in enumerate(getattr(scene.expect, key)):
            yield ("expect", key, index), expected


def _dimension_findings(block: Any, path: KeyPath, dim: int) -> Iterator[Finding]:
    for inner, vector in vectors_inside(block, path, leave_out=("axis",)):
        if len(vector) != dim:
            yield Finding(inner, f"needs {dim} entries in a {dim}D scene, not {len(vector)}")
    component = getattr(block, "component", "norm")
    if isinstance(block, MomentumQuantity) and block.kind == "angular_momentum" and dim == 2:
        if component in ("x", "y"):
            yield Finding((*path, "component"), "in a 2D scene angular momentum has z only")
    elif component != "norm" and component not in COMPONENTS[:dim]:
        yield Finding((*path, "component"), f"there is no {component} in a {dim}D scene")
    if isinstance(block, MomentQuantity):
        if dim == 3 and block.axis is None:
            yield Finding((*path, "axis"), "missing; a moment in 3D needs its axis")
        elif dim == 2 and block.axis is not None:
            yield Finding((*path, "axis"), "not allowed in a 2D scene, where every moment is about z")
        elif block.axis is not None and len(block.axis) != dim:
            yield Finding((*path, "axis"), f"needs {dim} entries in a {dim}D scene, not {len(block.axis)}")


def _unknown(name: str, scene: schema.DeformableScene) -> str:
    if not scene.measure:
        return f"the scene measures no `{name}`; there is no `measure` block"
    return f"the scene measures no `{name}`; {did_you_mean(name, scene.measure)}"
