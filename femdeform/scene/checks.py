"""What the schema alone cannot judge: references, dimensions, selections, regions, times, presets."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from femdeform import registry
from femdeform.errors import Fault, InputError
from femdeform.scene import schema
from femdeform.scene.contact_checks import contact_findings
from femdeform.scene.contact_schema import IPCMethod, WeakConstraintMethod
from femdeform.scene.flow_checks import flow_findings
from femdeform.scene.grid_checks import grid_findings
from femdeform.scene.key_path import KeyPath
from femdeform.scene.link_checks import link_findings
from femdeform.scene.load import LoadedScene, load_scene, sort_faults
from femdeform.scene.meshing import survey_meshes
from femdeform.scene.mixed_schema import MixedFEMSolver
from femdeform.scene.muscle_checks import muscle_findings
from femdeform.scene.partial import sound_part
from femdeform.scene.point_checks import point_findings
from femdeform.scene.quantity_checks import quantity_findings
from femdeform.scene.selection_checks import COMPONENTS, hint_of, judge_selection, vectors_inside
from femdeform.scene.skins import load_skins
from femdeform.scene.sweep_checks import sweep_findings
from femdeform.scene.validation import Finding
from femdeform.scene.wording import did_you_mean
from femdeform.types import Mesh

_NEEDS_FACETS = (schema.Traction, schema.Pressure)


def check_loaded(loaded: LoadedScene, meshes: Mapping[str, Mesh], coarse: Iterable[str] = ()) -> list[Fault]:
    """Return everything wrong with a scene of any kind that passed the schema; parameters as for `check_scene`.

    The notices of the scene get a line for each thing about its places at the start that is odd.
    """
    if loaded.scene.simulation == "incompressible_flow":
        findings = flow_findings(loaded.scene, meshes, loaded.base_dir)
        return sort_faults(loaded.fault(finding.path, finding.message) for finding in findings)
    if loaded.scene.simulation == "material_points":
        wrong = [loaded.fault(finding.path, finding.message) for finding in point_findings(loaded.scene, meshes)]
        # Places cannot be judged on meshes that only stand for those of a run.
        if not wrong and set(loaded.scene.mesh_sources()) <= set(meshes) - set(coarse):
            for found in registry.resolve(registry.POINT_PLACES)(loaded.scene, meshes):
                fault = loaded.fault(found.path, found.message)
                if found.is_notice:
                    loaded.notices.append(f"{fault.key}: {fault.message}")
                else:
                    wrong.append(fault)
        return sort_faults(wrong)
    return check_scene(loaded, meshes, coarse)


def check_scene(loaded: LoadedScene, meshes: Mapping[str, Mesh], coarse: Iterable[str] = ()) -> list[Fault]:
    """Return everything wrong with a scene of deformable bodies that passed the schema.

    Parameters
    ----------
    loaded : LoadedScene
        The scene with the lines of its keys.
    meshes : mapping of str to Mesh
        Meshes by body; what concerns a body without one is left out.
    coarse : iterable of str
        Bodies whose mesh only stands for the one that a run would build: its dimension and groups are right,
        its nodes are not. Selections by place or by number are not judged on it.

    Returns
    -------
    list of Fault
        Sorted by line; empty if the scene can be run.
    """
    findings = [
        *_body_findings(loaded.deformable, meshes),
        *_dimension_findings(loaded.deformable, meshes),
        *_selection_findings(loaded.deformable, meshes, frozenset(coarse)),
        *quantity_findings(loaded.deformable, meshes, frozenset(coarse)),
        *contact_findings(loaded.deformable, meshes, frozenset(coarse)),
        *link_findings(loaded.deformable, meshes, frozenset(coarse)),
        *muscle_findings(loaded.deformable, meshes, frozenset(coarse)),
        *grid_findings(loaded.deformable),
        *_time_findings(loaded.deformable),
        *_solver_findings(loaded.deformable),
        *sweep_findings(loaded.deformable, meshes, frozenset(coarse)),
    ]
    return sort_faults(loaded.fault(finding.path, finding.message) for finding in findings)


# ---------------------------------------------------------------------------------------------------- bodies


def _body_findings(scene: schema.DeformableScene, meshes: Mapping[str, Mesh]) -> Iterator[Finding]:
    for name, mesh in meshes.items():
        body = scene.bodies[name]
        path: KeyPath = ("bodies", name)
        fitting = _fitting_kind(mesh)
        if body.kind != fitting:
            cells = {"line": "lines", "triangle": "triangles", "tetra": "tetrahedra"}[mesh.cell_type]
            message = f"a {body.kind} cannot be made of {cells} in {mesh.dim}D; they make a {fitting}"
            yield Finding((*path, "kind"), message)
        if getattr(body, "skin", None) is not None and mesh.cell_type != "tetra":
            yield Finding((*path, "skin"), "only bodies of tetrahedra can have a skin")
        if body.kind != "solid":
            message = "the linear law turns with the body in solids only; choose another law"
            if isinstance(body.material, schema.LinearMaterial):
                yield Finding((*path, "material", "law"), message)
            for region, material in body.regions.items():
                if isinstance(material, schema.LinearMaterial):
                    yield Finding((*path, "regions", region, "law"), message)
        yield from _region_findings(body, mesh, (*path, "regions"))


def _fitting_kind(mesh: Mesh) -> str:
    if mesh.cell_type == "line":
        return "rod"
    return "membrane" if (mesh.cell_type, mesh.dim) == ("triangle", 3) else "solid"


def _region_findings(body: schema.Body, mesh: Mesh, path: KeyPath) -> Iterator[Finding]:
    count = np.zeros(mesh.n_cells, dtype=np.int64)
    unknown = False
    for region in body.regions:
        if region in mesh.cell_groups:
            count[mesh.cell_groups[region]] += 1
            continue
        unknown = True
        if region in mesh.group_names():
            yield Finding((*path, region), f"`{region}` is a group of the boundary, not of cells")
        else:
            hint = hint_of(region, mesh.cell_groups)
            yield Finding((*path, region), f"there is no group of cells `{region}`; {hint}")
    if unknown:
        return
    if (count > 1).any():
        shared = [name for name in body.regions if (count[mesh.cell_groups[name]] > 1).any()]
        listed = ", ".join(f"`{name}`" for name in shared)
        yield Finding(path, f"share cells, whose material is then not clear: {listed}")
    if body.material is None and (count == 0).any():
        rest = sorted(set(mesh.cell_groups) - set(body.regions))
        others = f" (further groups of cells: {', '.join(rest)})" if rest else ""
        yield Finding(path, f"leave cells without a material; add `material` for the rest{others}")


# ------------------------------------------------------------------------------------------------ dimensions


def _dimension_findings(scene: schema.DeformableScene, meshes: Mapping[str, Mesh]) -> Iterator[Finding]:
    if not meshes:
        return
    first = next(iter(meshes))
    dim = meshes[first].dim
    for name, mesh in meshes.items():
        if mesh.dim != dim:
            message = f"the body is {mesh.dim}D, but `{first}` is {dim}D; all bodies share one space"
            yield Finding(("bodies", name, "mesh"), message)
    for path, vector in _vectors(scene):
        if len(vector) != dim:
            yield Finding(path, f"needs {dim} entries in a {dim}D scene, not {len(vector)}")
    for index, condition in enumerate(scene.conditions):
        yield from _rotation_findings(condition, dim, ("conditions", index))
        if isinstance(condition, schema.SUPPORTS) and condition.components:
            for place, component in enumerate(condition.components):
                if component not in COMPONENTS[:dim]:
                    path = ("conditions", index, "components", place)
                    yield Finding(path, f"there is no {component} in a {dim}D scene")


def _rotation_findings(condition: schema.Condition, dim: int, path: KeyPath) -> Iterator[Finding]:
    if isinstance(condition, schema.Twist) and dim == 2:
        yield Finding((*path, "kind"), "a twist needs a 3D scene; use `rotate` in 2D")
    elif isinstance(condition, schema.Rotate):
        if dim == 3 and condition.axis is None:
            yield Finding((*path, "axis"), "missing; a rotation in 3D needs its axis")
        elif dim == 2 and condition.axis is not None:
            yield Finding((*path, "axis"), "not allowed in a 2D scene, where every rotation is about z")
        elif condition.axis is not None and len(condition.axis) != dim:
            yield Finding((*path, "axis"), f"needs {dim} entries in a {dim}D scene, not {len(condition.axis)}")
    elif isinstance(condition, schema.InitialVelocity) and condition.angular_velocity is not None:
        spin = condition.angular_velocity
        if dim == 3 and not isinstance(spin, tuple):
            yield Finding((*path, "angular_velocity"), "must be a vector of 3 numbers in a 3D scene")
        elif dim == 3 and isinstance(spin, tuple) and len(spin) != 3:
            yield Finding((*path, "angular_velocity"), f"needs 3 entries in a 3D scene, not {len(spin)}")
        elif dim == 2 and isinstance(spin, tuple):
            yield Finding((*path, "angular_velocity"), "must be one number in a 2D scene, about z")


def _vectors(scene: schema.DeformableScene) -> Iterator[tuple[KeyPath, tuple[float, ...]]]:
    """Every vector of the scene whose length is the dimension."""
    if scene.gravity is not None:
        yield ("gravity",), scene.gravity
    for index, condition in enumerate(scene.conditions):
        # Axes and angular velocities have rules of their own.
        yield from vectors_inside(condition, ("conditions", index), leave_out=("axis", "angular_velocity"))
    for index, obstacle in enumerate(scene.obstacles):
        yield from vectors_inside(obstacle, ("obstacles", index))
    for name, link in scene.links.items():
        yield from vectors_inside(link, ("links", name))


# ------------------------------------------------------------------------------------------------ selections


def _selection_findings(
    scene: schema.DeformableScene, meshes: Mapping[str, Mesh], coarse: frozenset[str]
) -> Iterator[Finding]:
    for index, condition in enumerate(scene.conditions):
        needs_facets = isinstance(condition, _NEEDS_FACETS)
        yield from judge_selection(condition.on, ("conditions", index, "on"), scene, meshes, coarse, needs_facets)


# ------------------------------------------------------------------------------------------- time and solver


def _time_findings(scene: schema.DeformableScene) -> Iterator[Finding]:
    smallest = scene.on_failure.min_dt
    if smallest is not None and smallest > scene.time.dt:
        message = f"must not exceed time.dt, {scene.time.dt:g} [s], not {smallest:g}"
        yield Finding(("on_failure", "min_dt"), message)
    if scene.time.scheme == "quasistatic":
        for index, condition in enumerate(scene.conditions):
            if isinstance(condition, schema.InitialVelocity):
                path: KeyPath = ("conditions", index, "kind")
                yield Finding(path, "a quasistatic run has no velocities; remove it, or use backward_euler")


def _solver_findings(scene: schema.DeformableScene) -> Iterator[Finding]:
    chosen = scene.linear_solver
    if isinstance(scene.solver, MixedFEMSolver):
        yield from _mixed_findings(scene, scene.solver)
    if isinstance(chosen, schema.KSPLinearSolver):
        known = registry.preset_names()
        if chosen.preset not in known:
            message = f"there is no preset `{chosen.preset}`; {did_you_mean(chosen.preset, known)}"
            yield Finding(("linear_solver", "preset"), message)
        word = registry.saddle_preset(chosen.preset)
        if word and not (isinstance(scene.solver, MixedFEMSolver) and scene.solver.global_solve == word):
            message = f"{chosen.preset} is for the saddle systems of solver mixed_fem with global_solve {word}"
            yield Finding(("linear_solver", "preset"), message)
        elif word == "kkt_minres" and chosen.options:
            message = "kkt-minres takes no options of PETSc; see solver.kkt_tolerance and solver.kkt_max_iterations"
            yield Finding(("linear_solver", "options"), message)


def _mixed_findings(scene: schema.DeformableScene, solver: MixedFEMSolver) -> Iterator[Finding]:
    for name, body in scene.bodies.items():
        places: dict[KeyPath, schema.Material | None] = {("material",): body.material}
        places |= {("regions", region): material for region, material in body.regions.items()}
        for place, material in places.items():
            if isinstance(material, schema.LinearMaterial):
                message = "mixed_fem needs a law of the principal stretches, which `linear` is not; corotated is close"
                yield Finding(("bodies", name, *place, "law"), message)
    if solver.global_solve == "kkt_cg" and scene.time.scheme == "quasistatic":
        yield Finding(("solver", "global_solve"), "kkt_cg needs inertia; use condensed or kkt_direct in statics")
    if solver.scheme == "alternating" and isinstance(scene.contact, IPCMethod):
        message = "alternating starts from free flight, which may end inside a barrier; use converged with contact ipc"
        yield Finding(("solver", "scheme"), message)
    if solver.scheme == "alternating" and isinstance(scene.contact, WeakConstraintMethod):
        message = "alternating knows obstacles only; use converged with contact weak_constraints"
        yield Finding(("solver", "scheme"), message)


# ----------------------------------------------------------------------------------------------- whole files


def check_file(path: Path, overrides: Sequence[str] = (), notices: list[str] | None = None) -> list[Fault]:
    """Everything wrong with a scene file, sorted by line; empty if it can be run.

    Parameters
    ----------
    path : Path
        The YAML file.
    overrides : sequence of str
        Each ``key=value``, as on the command line.
    notices : list of str, optional
        Gets a line for all that is odd without being wrong.
    """
    try:
        loaded = load_scene(path, overrides)
    except InputError as error:
        faults = list(error.faults)
        rest = sound_part(path, overrides)
        if rest is None:
            return faults
        loaded = rest
    else:
        faults = []
    survey = survey_meshes(loaded)
    try:
        load_skins(loaded)
    except InputError as error:
        faults += error.faults
    faults = sort_faults([*faults, *survey.faults, *check_loaded(loaded, survey.meshes, survey.coarse)])
    if notices is not None:
        notices += loaded.notices
    return faults
