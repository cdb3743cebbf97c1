"""Faults of `contact:` that only the rest of the scene and the meshes show."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from femdeform import registry
from femdeform.scene import schema
from femdeform.scene.contact_schema import IPCMethod, WeakConstraintMethod
from femdeform.scene.selection_checks import unknown_body
from femdeform.scene.validation import Finding
from femdeform.types import Mesh


def contact_findings(
    scene: schema.DeformableScene, meshes: Mapping[str, Mesh], coarse: frozenset[str]
) -> Iterator[Finding]:
    """Faults of references, keys of another method, and bodies that start where they may not.

    Parameters
    ----------
    scene : DeformableScene
        A scene that passed the schema.
    meshes : mapping of str to Mesh
        Meshes by body, as far as there are any.
    coarse : frozenset of str
        Bodies whose mesh is a stand-in; where bodies start is judged on real meshes of all bodies only.
    """
    method = scene.contact
    if not isinstance(method, IPCMethod | WeakConstraintMethod):
        return
    for place, pair in enumerate(method.between or []):
        for entry, name in enumerate(pair):
            if name not in scene.bodies:
                yield unknown_body(name, ("contact", "between", place, entry), scene)
    if isinstance(method, WeakConstraintMethod):
        for name, body in scene.bodies.items():
            if not isinstance(body, schema.SolidBody):
                message = f"contact.method weak_constraints knows solids only, not a {body.kind}; use ipc"
                yield Finding(("bodies", name, "kind"), message)
        return
    for index, obstacle in enumerate(scene.obstacles):
        if obstacle.stiffness is not None:
            message = "belongs to the penalty; with contact.method ipc obstacles obey `contact.stiffness`"
            yield Finding(("obstacles", index, "stiffness"), message)
    known = all(name in scene.bodies for pair in method.between or [] for name in pair)
    complete = set(meshes) == set(scene.bodies) and not coarse
    # Bodies of two dimensions, or of a kind that is not that of their cells, have faults of their own.
    fitting = len({mesh.dim for mesh in meshes.values()}) == 1 and all(
        (scene.bodies[name].kind == "rod") == (mesh.cell_type == "line") for name, mesh in meshes.items()
    )
    if known and complete and fitting:
        for found in registry.resolve(registry.INITIAL_CONTACT)(scene, meshes):
            if not found.is_notice:
                yield Finding(found.path, found.message)
