"""From a checked scene and its meshes to everything a run needs: the wiring, and nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from femdeform import registry
from femdeform.contact.obstacles import make_shape
from femdeform.contact.penalty import PenaltyContact
from femdeform.errors import InputError, MissingDependencyError
from femdeform.fem.conditions import Conditions
from femdeform.fem.discretization import BodyInput, Discretization, discretize
from femdeform.fem.incremental_potential import IncrementalPotential, State
from femdeform.fem.node_sets import NodeSets, facet_measure
from femdeform.materials import law_for, supports_codimension
from femdeform.scene import schema
from femdeform.step_problem import StepSolver
from femdeform.types import FloatArray, IntArray, Mesh

# Slip velocity up to which friction sticks, as a part of the scene's size per second.
_STICK_VELOCITY = 1e-3


@dataclass
class Simulation:
    """A scene, ready to step.

    Attributes
    ----------
    scene : DeformableScene
    meshes : dict of str to Mesh
    discretization : Discretization
    conditions : Conditions
    problem : IncrementalPotential
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
    problem: IncrementalPotential
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


def body_input(name: str, body: Any, mesh: Mesh) -> BodyInput:
    """Collect what the discretization needs of one body of a scene.

    Raises
    ------
    InputError
        If the regions do not cover the mesh, or a law cannot be used for this kind of body.
    """
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
    return BodyInput(mesh, body.kind, body.element_order, body.mass == "consistent", measure, regions)


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
    bodies = {name: body_input(name, body, meshes[name]) for name, body in scene.bodies.items()}
    ranks = 1 if comm is None else comm.Get_size()
    cell_rank = None
    if comm is not None:
        cell_rank = registry.resolve(registry.PARTITIONER)(meshes, comm)
    discretization = discretize(bodies, cell_rank, comm)
    conditions = Conditions(scene, meshes, discretization)
    notices += conditions.notices
    contacts = make_contacts(scene, meshes, discretization)
    quasistatic = scene.time.scheme == "quasistatic"
    problem = IncrementalPotential(discretization, conditions, quasistatic, contacts)
    linear_solver = make_linear_solver(scene.linear_solver, ranks, notices)
    solver = registry.resolve(registry.SOLVERS[scene.solver.method])(scene.solver, linear_solver)
    velocity = np.zeros_like(discretization.points) if quasistatic else conditions.initial_velocity.copy()
    state = State(discretization.points.copy(), velocity)
    return Simulation(
        scene, dict(meshes), discretization, conditions, problem, solver, linear_solver, state, notices
    )


def make_contacts(
    scene: schema.DeformableScene, meshes: Mapping[str, Mesh], discretization: Discretization
) -> list[PenaltyContact]:
    """Contact of every obstacle with the surface nodes this rank owns."""
    if not scene.obstacles:
        return []
    nodes, areas, default = _surface(scene, meshes, discretization)
    size = max(float(np.linalg.norm(np.ptp(mesh.points, axis=0))) for mesh in meshes.values())
    contacts = []
    for obstacle in scene.obstacles:
        stiffness = areas * (default if obstacle.stiffness is None else obstacle.stiffness)
        velocity = np.zeros(discretization.dim) if obstacle.velocity is None else np.array(obstacle.velocity)
        contacts.append(
            PenaltyContact(
                make_shape(obstacle), nodes, stiffness, obstacle.friction, velocity, _STICK_VELOCITY * size
            )
        )
    return contacts


def _surface(
    scene: schema.DeformableScene, meshes: Mapping[str, Mesh], discretization: Discretization
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Owned surface nodes, the area around each [m^2], and the default stiffness per area there [Pa/m]."""
    sets = NodeSets(meshes, discretization.bodies)
    area = np.zeros(discretization.partition.n_global)
    default = np.zeros_like(area)
    for name, mesh in meshes.items():
        body = scene.bodies[name]
        facets = mesh.facet_groups["boundary"] if body.kind == "solid" else mesh.cells
        measure = facet_measure(mesh.points, facets)
        if body.kind == "rod":
            measure = measure * np.sqrt(body.cross_section)
        numbers = sets.facet_nodes(name, facets)
        # Equal shares: the corners of a quadratic facet carry no load in the energy, but they must not fall through.
        np.add.at(area, numbers, np.repeat((measure / numbers.shape[1])[:, None], numbers.shape[1], axis=1))
        materials = [body.material, *body.regions.values()]
        modulus = max(material.youngs_modulus for material in materials if material is not None)
        edges = mesh.points[facets]
        length = float(np.mean(np.linalg.norm(edges - np.roll(edges, 1, axis=1), axis=2)))
        default[np.unique(numbers)] = 10.0 * modulus / length
    chosen = np.flatnonzero(area > 0.0)
    local = discretization.local_numbers[chosen]
    owned = (local >= 0) & (local < discretization.partition.n_owned)
    return local[owned], area[chosen[owned]], default[chosen[owned]]
