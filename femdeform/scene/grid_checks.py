"""Faults of `grid:` that only the rest of the scene shows: what bodies embedded in a grid do not know."""

from __future__ import annotations

from collections.abc import Iterator

from femdeform.scene import schema
from femdeform.scene.constraint_schema import XPBDQSSolver
from femdeform.scene.contact_schema import IPCMethod, WeakConstraintMethod
from femdeform.scene.mixed_schema import MixedFEMSolver
from femdeform.scene.position_schema import PBNGSolver
from femdeform.scene.quantity_schema import MomentQuantity, ReactionQuantity
from femdeform.scene.validation import Finding


def grid_findings(scene: schema.DeformableScene) -> Iterator[Finding]:
    """Everything that does not go with a grid.

    Parameters
    ----------
    scene : DeformableScene
        A scene that passed the schema.
    """
    grid = scene.grid
    if grid is None:
        return
    if scene.time.scheme == "quasistatic":
        message = "a grid-embedded body has no statics, too little of it is at the outer grid nodes; use backward_euler"
        yield Finding(("time", "scheme"), message)
    if isinstance(scene.solver, (MixedFEMSolver, XPBDQSSolver)):
        known = "projected_newton, pbng, pbd, xpbd, b_pxpbd or fp_pxpbd"
        yield Finding(("solver", "method"), f"{scene.solver.method} does not know `grid`; use {known}")
    if isinstance(scene.solver, PBNGSolver) and scene.solver.precision == "float32":
        message = "grid nodes at the edge of a body have too little mass for it; use float64"
        yield Finding(("solver", "precision"), message)
    if isinstance(scene.contact, IPCMethod | WeakConstraintMethod):
        message = "bodies in one grid touch through it; remove `contact`, or `grid`"
        yield Finding(("contact", "method"), message)
    for name in scene.links:
        yield Finding(("links", name), "a grid-embedded body knows no links; remove `grid`")
    yield from _body_findings(scene)
    for index, condition in enumerate(scene.conditions):
        if isinstance(condition, schema.Rotate) and condition.components is not None:
            message = "grid nodes turn with all their components; leave it out, or remove `grid`"
            yield Finding(("conditions", index, "components"), message)
    for index, obstacle in enumerate(scene.obstacles):
        if obstacle.stiffness is not None:
            message = "belongs to the penalty on nodes of meshes; obstacles act on the nodes of the grid"
            yield Finding(("obstacles", index, "stiffness"), message)
        if obstacle.friction > 0.0 and grid.obstacles != "separating":
            message = f"needs grid.obstacles: separating; {grid.obstacles} has no normal force to rub with"
            yield Finding(("obstacles", index, "friction"), message)
    yield from _output_findings(scene)


def _body_findings(scene: schema.DeformableScene) -> Iterator[Finding]:
    for name, body in scene.bodies.items():
        if not isinstance(body, schema.SolidBody):
            yield Finding(("bodies", name, "kind"), f"only solids are embedded in a grid, not a {body.kind}")
        elif body.element_order != 1:
            yield Finding(("bodies", name, "element_order"), "only linear elements are embedded in a grid")
        if isinstance(body, schema.SolidBody) and body.all_muscles and scene.solver.method != "projected_newton":
            message = f"{scene.solver.method} knows no muscles in a grid; use projected_newton"
            yield Finding(("bodies", name, "muscles" if body.muscles else "muscle"), message)
        if body.mass == "consistent":
            yield Finding(("bodies", name, "mass"), "the grid takes its mass from nodes; use lumped")


def _output_findings(scene: schema.DeformableScene) -> Iterator[Finding]:
    message = "supports hold grid nodes: there are no reactions of the nodes of a mesh"
    for index, field in enumerate(scene.output.fields):
        if field == "reaction":
            yield Finding(("output", "fields", index), message)
        if field == "contact":
            yield Finding(("output", "fields", index), "bodies in one grid touch through it, not at nodes of a mesh")
    for name, quantity in scene.measure.items():
        if isinstance(quantity, (ReactionQuantity, MomentQuantity)):
            yield Finding(("measure", name, "kind"), message)
    if scene.expect.reaction:
        yield Finding(("expect", "reaction"), message)
