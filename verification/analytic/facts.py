"""What the formulas need to know, read from the scene they are compared with: a study cannot drift from its scene."""

from __future__ import annotations

from typing import Any

from femdeform.errors import InputError
from femdeform.scene import schema
from femdeform.scene.mesh_schema import BlockMesh


def only_body(scene: schema.DeformableScene) -> Any:
    """Return the body of a scene of one body.

    Raises
    ------
    InputError
        If there are several.
    """
    if len(scene.bodies) != 1:
        raise InputError(f"bodies: this formula needs one body, not {len(scene.bodies)}")
    return next(iter(scene.bodies.values()))


def only_material(scene: schema.DeformableScene) -> Any:
    """Return the material of the only body.

    Raises
    ------
    InputError
        If the body has regions of other materials.
    """
    body = only_body(scene)
    if body.material is None or body.regions:
        raise InputError("bodies: this formula needs a body of one material")
    return body.material


def block_size(scene: schema.DeformableScene) -> tuple[float, ...]:
    """Return the edge lengths of the only body, a block [m].

    Raises
    ------
    InputError
        If it is none, or turned.
    """
    mesh = only_body(scene).mesh
    if not isinstance(mesh, BlockMesh) or mesh.rotate is not None:
        raise InputError("bodies: this formula needs the recipe `block`, not turned")
    return tuple(mesh.size)


def only_condition(scene: schema.DeformableScene, kind: str) -> Any:
    """Return the only condition of a kind.

    Raises
    ------
    InputError
        If there is none, or several.
    """
    found = [condition for condition in scene.conditions if condition.kind == kind]
    if len(found) != 1:
        raise InputError(f"conditions: this formula needs one condition `{kind}`, not {len(found)}")
    return found[0]


def elapsed(scene: schema.DeformableScene, motion: Any) -> float:
    """Return for how long a motion has gone on at the end of the run [s]."""
    end = scene.time.end if motion.stop is None else min(motion.stop, scene.time.end)
    return max(float(end) - float(motion.start), 0.0)


def step_count(scene: schema.DeformableScene) -> int:
    """Return the number of equal time steps of the run.

    Raises
    ------
    InputError
        If the step does not divide the run.
    """
    count = round(scene.time.end / scene.time.dt)
    if abs(count * scene.time.dt - scene.time.end) > 1e-9 * scene.time.end:
        raise InputError("time.dt: this formula needs a step that divides the run")
    return count
