"""Faults of scenes whose method sweeps over nodes, cells or constraints."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from femdeform.scene import schema
from femdeform.scene.constraint_schema import CELL_SWEEPS, FPPXPBDSolver, PBDSolver, XPBDQSSolver, XPBDSolver
from femdeform.scene.contact_schema import IPCMethod, PenaltyMethod
from femdeform.scene.key_path import KeyPath
from femdeform.scene.position_schema import PBNGSolver
from femdeform.scene.selection_checks import judge_selection
from femdeform.scene.validation import Finding
from femdeform.types import Mesh


def sweep_findings(
    scene: schema.DeformableScene, meshes: Mapping[str, Mesh], coarse: frozenset[str]
) -> Iterator[Finding]:
    """Faults of such methods, and of constraints that only they know.

    Parameters
    ----------
    scene : DeformableScene
        A scene that passed the schema.
    meshes : mapping of str to Mesh
        Meshes by body, as far as there are any.
    coarse : frozenset of str
        Bodies whose mesh is a stand-in.
    """
    if isinstance(scene.solver, (PBNGSolver, *CELL_SWEEPS)):
        yield from _cell_findings(scene)
    if isinstance(scene.solver, CELL_SWEEPS):
        yield from _constraint_findings(scene)
    yield from _thin_findings(scene, meshes, coarse)


def _has_constraints(body: schema.SolidBody | schema.MembraneBody | schema.RodBody) -> bool:
    return not isinstance(body, schema.SolidBody) and body.constraints is not None


def _thin_findings(
    scene: schema.DeformableScene, meshes: Mapping[str, Mesh], coarse: frozenset[str]
) -> Iterator[Finding]:
    """Constraints of membranes and rods."""
    solver = scene.solver
    knows = isinstance(solver, PBDSolver) or (isinstance(solver, XPBDSolver) and not solver.keep_primary_residual)
    for name, body in scene.bodies.items():
        if isinstance(body, schema.SolidBody) or body.constraints is None:
            continue
        path: KeyPath = ("bodies", name, "constraints")
        if not knows:
            yield Finding(path, "are for the methods xpbd and pbd, without keep_primary_residual")
        if body.regions:
            yield Finding(("bodies", name, "regions"), "a body with constraints has one material")
        if body.constraints.tether is not None:
            anchors = f"{name}.{body.constraints.tether.to}"
            yield from judge_selection(anchors, (*path, "tether", "to"), scene, meshes, coarse)


def _cell_findings(scene: schema.DeformableScene) -> Iterator[Finding]:
    """What sweeps over nodes and cells do not know."""
    method = scene.solver.method
    for name, body in scene.bodies.items():
        if not isinstance(body, schema.SolidBody):
            if body.constraints is None or not isinstance(scene.solver, (XPBDSolver, PBDSolver)):
                hint = "solids, and bodies with `constraints`, only" if method in ("xpbd", "pbd") else "solids only"
                yield Finding(("bodies", name, "kind"), f"{method} knows {hint}, not a {body.kind}")
        elif body.element_order != 1:
            yield Finding(("bodies", name, "element_order"), f"{method} knows linear elements only")
        if body.mass == "consistent" and scene.time.scheme != "quasistatic":
            yield Finding(("bodies", name, "mass"), f"{method} needs a mass at each node by itself; use lumped")
    if isinstance(scene.solver, PBNGSolver):
        if isinstance(scene.contact, IPCMethod):
            yield Finding(("contact", "method"), "pbng knows penalty and weak_constraints only")
    elif not isinstance(scene.contact, PenaltyMethod):
        yield Finding(("contact", "method"), f"{method} knows obstacles by penalty only")


def _constraint_findings(scene: schema.DeformableScene) -> Iterator[Finding]:
    """What constraints of cells do not know."""
    solver = scene.solver
    statics = scene.time.scheme == "quasistatic"
    if isinstance(solver, PBDSolver):
        if solver.pseudo_step is not None and not statics:
            yield Finding(("solver", "pseudo_step"), "is for statics (time.scheme: quasistatic); remove it")
    elif statics != isinstance(solver, XPBDQSSolver):
        advice = "for statics there is xpbd_qs" if statics else "for dynamics there is xpbd"
        yield Finding(("solver", "method"), f"{solver.method} does not go with {scene.time.scheme}; {advice}")
    known = ("fixed_corotated", "arap") if isinstance(solver, PBDSolver) else ("fixed_corotated", "arap", "neo_hookean")
    if isinstance(solver, FPPXPBDSolver) or (isinstance(solver, XPBDSolver) and solver.constraints == "root"):
        return
    for name, body in scene.bodies.items():
        if _has_constraints(body):
            continue
        materials = [(("material",), body.material)] + [(("regions", key), m) for key, m in body.regions.items()]
        for where, material in materials:
            if material is not None and material.law not in known:
                message = f"{solver.method} knows constraints of {', '.join(known)} only"
                yield Finding(("bodies", name, *where, "law"), message)
