"""Runs one problem of a study to its end, in this process and without a result folder."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from femdeform import registry
from femdeform.errors import InputError, NotConvergedError
from femdeform.fem.discretization import Discretization
from femdeform.fem.incremental_potential import IncrementalPotential, State
from femdeform.run.quantities import Meter
from femdeform.run.setup import Simulation, build_simulation
from femdeform.run.threads import use_threads
from femdeform.run.time_loop import SolverStepper, StepControl, default_min_dt, run_time_loop
from femdeform.scene.checks import check_scene
from femdeform.scene.meshing import load_meshes
from femdeform.step_problem import StepResult
from femdeform.types import FloatArray, Mesh
from verification.expressions import VectorField
from verification.manufactured import ManufacturedSolution
from verification.norms import ErrorNorms, ShapeTable, error_norms
from verification.plan import FieldSet, Problem
from verification.prescribed_field import PrescribedField, body_table, manufactured_load
from verification.trapezoidal import TrapezoidalPotential

# Degree of the rules for norms and manufactured loads: their own error must not be seen in that of the elements.
_DEGREE = 6


@dataclass(frozen=True)
class Outcome:
    """What a run left.

    Attributes
    ----------
    n_dofs : int
    dt : float
        Time step asked for [s].
    seconds : float
        Wall time, meshes and first compilation included [s].
    iterations : int
        Nonlinear iterations of all accepted steps.
    n_halved : int
        Steps that had to be tried again with half the size.
    reason : str
        Why the run did not reach its end; empty if it did.
    times : (n,) float64
        0 and the end of every accepted step [s].
    history : dict of str to (n,) float64
        Measured quantities at these times.
    displacement : (n_nodes, dim) float64
        At the end [m].
    discretization : Discretization
    """

    n_dofs: int
    dt: float
    seconds: float
    iterations: int
    n_halved: int
    reason: str
    times: FloatArray
    history: dict[str, FloatArray]
    displacement: FloatArray
    discretization: Discretization

    def table(self) -> ShapeTable:
        """Shape functions of the only body."""
        return body_table(self.discretization, _DEGREE)

    def distance_from(self, exact: VectorField) -> ErrorNorms:
        """Norms of the displacement's distance from an exact one."""
        return error_norms(self.table(), self.displacement, exact, exact.gradient)

    def distance_to(self, other: Outcome) -> ErrorNorms:
        """Norms of the difference between two displacements on the same mesh.

        Raises
        ------
        ValueError
            If the meshes differ.
        """
        same = self.displacement.shape == other.displacement.shape
        if not same or not np.array_equal(self.discretization.points, other.discretization.points):
            raise ValueError("the two runs are on different meshes")
        table, dim = self.table(), self.displacement.shape[1]
        return error_norms(
            table,
            self.displacement - other.displacement,
            lambda points: np.zeros_like(points),
            lambda points: np.zeros((len(points), dim, dim)),
        )


class _Record:
    """What is kept of every accepted step."""

    def __init__(self, simulation: Simulation, advance: Callable[[float], None]) -> None:
        self._meter = Meter(simulation)
        self._end = simulation.scene.time.end
        self._advance = advance
        self.last = simulation.state
        self.times = [simulation.state.time]
        self.courses = [self._meter.evaluate(simulation.state, is_start=True)]
        self.iterations = 0
        self.n_halved = 0

    def on_accept(self, state: State, result: StepResult, _: float) -> None:
        self.last = state
        self.times.append(state.time)
        self.courses.append(self._meter.evaluate(state))
        self.iterations += result.iterations
        self._advance(state.time / self._end)

    def on_failure(self, _state: State, _result: StepResult, _dt: float, retry: bool) -> None:
        self.n_halved += retry


def run_problem(problem: Problem, advance: Callable[[float], None] = lambda _: None) -> Outcome:
    """Run a problem to its end, or to where it does not converge any more.

    Parameters
    ----------
    problem : Problem
        Checked.
    advance : callable
        Told the part of the run that is done, from 0 to 1.

    Returns
    -------
    Outcome

    Raises
    ------
    InputError
        If a mesh cannot be built, or a field does not fit it.
    """
    begin = time.perf_counter()
    scene = problem.loaded.deformable
    meshes = _meshes(problem)
    use_threads(None, sum(mesh.n_cells for mesh in meshes.values()))
    simulation = _with_fields(build_simulation(scene, meshes), problem)
    record = _Record(simulation, advance)
    try:
        outcome = run_time_loop(
            SolverStepper(simulation.problem, simulation.solver),
            StepControl(
                scene.time.dt,
                scene.time.end,
                default_min_dt(scene.time.dt, scene.on_failure.min_dt),
                halve=scene.on_failure.action == "halve_dt",
            ),
            simulation.state,
            on_accept=record.on_accept,
            on_failure=record.on_failure,
            observe=lambda _: None,
        )
        reason = outcome.reason
    except NotConvergedError as error:
        reason = str(error)
    finally:
        simulation.destroy()
        problem.loaded.meshes.clear()  # a study has many levels, and the finest are large
    return Outcome(
        n_dofs=simulation.discretization.n_dofs,
        dt=scene.time.dt,
        seconds=time.perf_counter() - begin,
        iterations=record.iterations,
        n_halved=record.n_halved,
        reason=reason,
        times=np.array(record.times),
        history={name: np.array([course[name] for course in record.courses]) for name in scene.measure},
        displacement=record.last.x - simulation.discretization.points,
        discretization=simulation.discretization,
    )


def _meshes(problem: Problem) -> dict[str, Mesh]:
    """Meshes of the scene, moved if the study says so, and checked."""
    loaded, fields = problem.loaded, problem.fields
    meshes = load_meshes(loaded)
    if fields.move_mesh is not None:
        for name, mesh in meshes.items():
            shift = _finite(fields.move_mesh(mesh.points), fields, "move_mesh")
            try:
                moved, _ = registry.resolve(registry.MESH["check"])(
                    replace(mesh, points=mesh.points + shift), f"body {name}"
                )
            except InputError as error:
                raise fields.error("move_mesh", error.faults[0].message) from None
            if not np.array_equal(moved.cells, mesh.cells):
                # The check turns inverted cells around, which here would hide that the mesh folds over itself.
                raise fields.error("move_mesh", f"turns cells of body {name} inside out")
            meshes[name] = moved
    faults = check_scene(loaded, meshes)
    if faults:
        raise InputError(faults)
    return meshes


def _with_fields(simulation: Simulation, problem: Problem) -> Simulation:
    """The simulation with the study's fields and time integration in place of the scene's."""
    fields, scene = problem.fields, simulation.scene
    discretization = simulation.discretization
    conditions = simulation.conditions
    if fields.displacement is not None:
        prescribed = PrescribedField(scene, simulation.meshes, discretization, fields.displacement)
        _finite(fields.displacement(discretization.points), fields, "displacement")
        if fields.manufactured:
            load = manufactured_load(
                discretization, simulation.meshes, prescribed.free, _solution(problem, fields.displacement), _DEGREE
            )
            prescribed.add_load(_finite(load, fields, "body_force"))
        conditions = prescribed
    trapezoidal = problem.integrator == "trapezoidal"
    if conditions is not simulation.conditions or trapezoidal:
        if not isinstance(simulation.problem, IncrementalPotential):
            raise InputError("grid: studies that prescribe fields do not know it")
        kind = TrapezoidalPotential if trapezoidal else IncrementalPotential
        step = kind(discretization, conditions, simulation.problem.quasistatic, simulation.problem.contacts)
        simulation = replace(simulation, conditions=conditions, problem=step)
    if fields.initial_velocity is not None:
        velocity = _finite(fields.initial_velocity(discretization.points), fields, "initial_velocity")
        state = simulation.state
        moving = np.where(simulation.problem.free, state.v + velocity, state.v)
        simulation = replace(simulation, state=State(state.x, moving, state.time, state.step))
    return simulation


def _solution(problem: Problem, displacement: VectorField) -> ManufacturedSolution:
    (body,) = problem.loaded.deformable.bodies.values()
    material = body.material
    assert material is not None  # judged with the study
    try:
        return ManufacturedSolution(
            material.law, material.youngs_modulus, material.poisson_ratio, displacement.components
        )
    except ValueError as error:
        raise problem.fields.error("body_force", str(error)) from None


def _finite(values: FloatArray, fields: FieldSet, name: str) -> FloatArray:
    if not np.isfinite(values).all():
        raise fields.error(name, "is not finite everywhere in the mesh")
    return values
