"""From a checked scene and its meshes to everything a run needs: the wiring, and nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from femdeform import registry
from femdeform.contact.weak_constraints import WeakConstraints
from femdeform.errors import InputError, MissingDependencyError
from femdeform.fem.conditions import Conditions
from femdeform.fem.discretization import BodyInput, Discretization, discretize
from femdeform.fem.incremental_potential import IncrementalPotential, State
from femdeform.fem.thin_constraints import ThinConstraints, make_constraints
from femdeform.materials import law_for, supports_codimension
from femdeform.mpm.embedded_potential import EmbeddedPotential
from femdeform.run.contacts import make_contacts, make_weak_contact
from femdeform.run.embedding import embed
from femdeform.run.links import make_links
from femdeform.run.muscles import muscle_inputs
from femdeform.scene import schema
from femdeform.scene.constraint_schema import CELL_SWEEPS
from femdeform.scene.position_schema import PBNGSolver
from femdeform.step_problem import StepSolver
from femdeform.types import IntArray, Mesh


@dataclass
class Simulation:
    """A scene, ready to step.

    Attributes
    ----------
    scene : DeformableScene
    meshes : dict of str to Mesh
    discretization : Discretization
    conditions : Conditions
    problem : IncrementalPotential or EmbeddedPotential
    solver : StepSolver
    linear_solver : LinearSolver
    state : State
        Initial state.
    notices : list of str
        What the user should be told.
    """

    scene: schema.DeformableScene
    meshes: dict[str, Mesh]
    discretization: Discretization
    conditions: Conditions
    problem: IncrementalPotential | EmbeddedPotential
    solver: StepSolver
    linear_solver: Any
    state: State
    notices: list[str] = field(default_factory=list)

    def reset(self) -> None:
        """Let the solvers forget what they learnt: the next step depends on its state alone."""
        self.solver.reset()
        self.linear_solver.reset()

    def destroy(self) -> None:
        """Free what the solvers hold."""
        self.solver.destroy()
        self.linear_solver.destroy()


def body_input(name: str, body: Any, meshes: Mapping[str, Mesh]) -> BodyInput:
    """Collect what the discretization needs of one body of a scene.

    Raises
    ------
    InputError
        If the regions do not cover the mesh, a law cannot be used for this kind of body, or a muscle has no direction.
    """
    mesh = meshes[name]
    left = np.ones(mesh.n_cells, dtype=bool)
    regions: list[tuple[IntArray, Any, float]] = []
    materials = [(mesh.cell_groups[group], material) for group, material in body.regions.items()]
    for cells, material in materials:
        chosen = cells[left[cells]]
        left[cells] = False
        regions.append((np.sort(chosen), law_for(material, mesh.dim), material.density))
    rest = np.flatnonzero(left)
    if rest.size:
        if body.material is None:
            raise InputError(f"bodies.{name}.regions: {rest.size} cells have no material; give `material` for the rest")
        regions.append((rest, law_for(body.material, mesh.dim), body.material.density))
    measure = 1.0
    if body.kind != "solid":
        measure = body.thickness if body.kind == "membrane" else body.cross_section
        if any(not supports_codimension(law) for _, law, _ in regions):
            raise InputError(f"bodies.{name}: the linear law turns with the body only in solids; choose another law")
    regions = [region for region in regions if region[0].size]
    muscles = muscle_inputs(name, body, meshes)
    return BodyInput(mesh, body.kind, body.element_order, body.mass == "consistent", measure, regions, muscles)


def _thin_constraints(
    scene: schema.DeformableScene, discretization: Discretization, conditions: Conditions
) -> dict[str, ThinConstraints]:
    """Constraints of the membranes and rods that have some."""
    made = {}
    for name, body in scene.bodies.items():
        if body.kind == "solid" or body.constraints is None or body.material is None:
            continue
        place = discretization.bodies[name]
        tether = body.constraints.tether
        made[name] = make_constraints(
            name,
            body.constraints,
            discretization.all_points,
            place.first + place.connectivity,
            body.thickness if body.kind == "membrane" else body.cross_section,
            body.material.youngs_modulus,
            None if tether is None else conditions.nodes(f"{name}.{tether.to}"),
        )
    return made


def make_linear_solver(options: schema.LinearSolver, ranks: int, notices: list[str]) -> Any:
    """Make the linear solver a scene asks for, or SciPy's with a notice where PETSc cannot be had.

    Raises
    ------
    MissingDependencyError
        If PETSc is missing in a run on several ranks.
    """
    if isinstance(options, schema.SciPyDirectLinearSolver):
        if ranks > 1:
            raise InputError("linear_solver: scipy_direct is serial; use ksp on several ranks")
        return registry.resolve(registry.LINEAR_SOLVERS["scipy_direct"])()
    try:
        return registry.resolve(registry.LINEAR_SOLVERS["ksp"])(options.preset, options.options)
    except MissingDependencyError as error:
        if ranks > 1:
            raise MissingDependencyError(f"a run on {ranks} ranks needs PETSc: {error}") from None
        notices.append(f"PETSc is not usable here ({error}): SciPy's direct solver takes the place of {options.preset}")
        return registry.resolve(registry.LINEAR_SOLVERS["scipy_direct"])()


def build_simulation(scene: schema.DeformableScene, meshes: Mapping[str, Mesh], comm: Any | None = None) -> Simulation:
    """Wire a scene.

    Parameters
    ----------
    scene : DeformableScene
        Checked by `femdeform.scene.checks.check_scene`.
    meshes : mapping of str to Mesh
        Checked meshes by body.
    comm : mpi4py communicator or None
        Every rank calls with the same scene and meshes.

    Returns
    -------
    Simulation
    """
    notices: list[str] = []
    for name, body in scene.bodies.items():
        words = [material.law for material in [body.material, *body.regions.values()] if material is not None]
        if meshes[name].dim == 2 and "stable_neo_hookean" in words:
            notices.append(
                f"bodies.{name}: stable_neo_hookean in 2D is a two-dimensional law; it agrees with the 3D law in plane "
                "strain at small strain only (docs/methods/materials.md)"
            )
    bodies = {name: body_input(name, body, meshes) for name, body in scene.bodies.items()}
    ranks = 1 if comm is None else comm.Get_size()
    cell_rank = None
    if comm is not None:
        cell_rank = registry.resolve(registry.PARTITIONER)(meshes, comm)
    if ranks > 1 and isinstance(scene.solver, (PBNGSolver, *CELL_SWEEPS)):
        page = "pbng" if isinstance(scene.solver, PBNGSolver) else "xpbd"
        raise InputError(
            f"solver.method: {scene.solver.method} runs on one rank, with threads (docs/methods/{page}.md)"
        )
    if ranks > 1 and scene.grid is not None:
        raise InputError("grid: bodies in a grid run on one rank, with threads (docs/methods/grid-embedded.md)")
    rows = make_links(scene, meshes, notices)
    discretization = discretize(bodies, cell_rank, comm, None if rows is None else rows.coupled())
    conditions = Conditions(scene, meshes, discretization)
    notices += conditions.notices
    links = None
    if rows is not None:
        links = WeakConstraints(rows.local(discretization.local_numbers, discretization.partition.n_owned))
        links.begin_step(discretization.points, 0.0)
    quasistatic = scene.time.scheme == "quasistatic"
    problem: IncrementalPotential | EmbeddedPotential
    if scene.grid is not None:
        problem = embed(scene, meshes, discretization, conditions, notices)
    else:
        contacts, couplings = make_contacts(scene, meshes, discretization, notices)
        problem = IncrementalPotential(
            discretization,
            conditions,
            quasistatic,
            contacts,
            couplings=couplings,
            links=links,
            weak_contact=make_weak_contact(scene, meshes, discretization, notices),
            constraints=_thin_constraints(scene, discretization, conditions),
        )
    linear_solver = make_linear_solver(scene.linear_solver, ranks, notices)
    solver = registry.resolve(registry.SOLVERS[scene.solver.method])(scene.solver, linear_solver)
    velocity = np.zeros_like(discretization.points) if quasistatic else conditions.initial_velocity.copy()
    state = State(discretization.points.copy(), velocity)
    if isinstance(problem, EmbeddedPotential):
        state = problem.initial_state(state.x, state.v)
    return Simulation(scene, dict(meshes), discretization, conditions, problem, solver, linear_solver, state, notices)
