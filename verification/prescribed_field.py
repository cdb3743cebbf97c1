"""Problems whose prescribed degrees of freedom follow a given displacement field, which a scene cannot describe.

A scene's `fixed` conditions say which nodes, and which of their components, are held; a `PrescribedField` moves them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.errors import NotConvergedError
from femdeform.fem.conditions import Conditions
from femdeform.fem.discretization import Discretization
from femdeform.fem.incremental_potential import IncrementalPotential, State
from femdeform.run.setup import Simulation, build_simulation
from femdeform.run.time_loop import StepControl, run_time_loop
from femdeform.scene import schema
from femdeform.types import FloatArray, IntArray, Mesh
from verification.norms import Field, ShapeTable, tabulate


class PrescribedField(Conditions):
    """Conditions of a scene whose held degrees of freedom are displaced by a field, growing linearly over the run.

    Parameters
    ----------
    scene : DeformableScene
        Its `fixed` conditions choose the degrees of freedom.
    meshes : mapping of str to Mesh
    discretization : Discretization
    displacement : callable
        Displacement (n, dim) at reference positions (n, dim) at the end of the run [m].
    """

    def __init__(
        self,
        scene: schema.DeformableScene,
        meshes: Mapping[str, Mesh],
        discretization: Discretization,
        displacement: Field,
    ) -> None:
        super().__init__(scene, meshes, discretization)
        self._points = discretization.points
        self._target = displacement(discretization.points)

    def set_prescribed(self, time: float, x: FloatArray) -> None:
        """Write the prescribed positions at a time into `x` (n_local, dim)."""
        x[~self.free] = (self._points + time / self._end * self._target)[~self.free]


@dataclass(frozen=True)
class SolvedField:
    """A quasistatic problem at its end.

    Attributes
    ----------
    simulation : Simulation
        The scene, wired; its own problem is the one of `problem`.
    problem : IncrementalPotential
        With the loads of the end.
    state : State
    """

    simulation: Simulation
    problem: IncrementalPotential
    state: State

    @property
    def displacement(self) -> FloatArray:
        """Nodal displacements (n_nodes, dim) [m]."""
        return np.asarray(self.state.x - self.simulation.discretization.points)

    def table(self, degree: int) -> ShapeTable:
        """Shape functions of the only body of the scene at the points of a rule."""
        return body_table(self.simulation.discretization, degree)

    def reaction(self, nodes: IntArray) -> FloatArray:
        """Total force that the supports exert on some nodes, (dim,) [N]."""
        return np.asarray(self.problem.full_gradient(self.state.x)[nodes].sum(axis=0))


def body_table(discretization: Discretization, degree: int) -> ShapeTable:
    """Shape functions of a problem of one body at the points of a rule of a degree."""
    (body,) = discretization.bodies.values()
    return tabulate(discretization.points, body.connectivity, degree)


def parse_scene(data: Mapping[str, Any]) -> schema.DeformableScene:
    """Validate a scene given as plain data, as a YAML file would hold it."""
    return schema.DeformableScene.model_validate(dict(data))


def solve_prescribed(
    scene: schema.DeformableScene,
    meshes: Mapping[str, Mesh],
    displacement: Field,
    body_force: Field | None = None,
    degree: int = 6,
) -> SolvedField:
    """Solve a quasistatic scene of one body with a field on its held degrees of freedom.

    Parameters
    ----------
    scene : DeformableScene
        Quasistatic, with one body and `fixed` conditions.
    meshes : mapping of str to Mesh
        The body's mesh, in place of the one that the scene names.
    displacement : callable
        See `PrescribedField`.
    body_force : callable, optional
        Force per reference volume (n, dim) at points (n, dim) [N/m^dim], at full size in every step.
    degree : int
        Degree of the rule that integrates the body force.

    Returns
    -------
    SolvedField

    Raises
    ------
    NotConvergedError
        If a step does not converge.
    """
    simulation = build_simulation(scene, meshes)
    discretization = simulation.discretization
    conditions = PrescribedField(scene, meshes, discretization, displacement)
    load = None
    if body_force is not None:
        load = body_table(discretization, degree).integrate_load(body_force, discretization.n_nodes)
    problem = IncrementalPotential(discretization, conditions, True, (), load)
    outcome = run_time_loop(
        problem,
        simulation.solver,
        StepControl(scene.time.dt, scene.time.end, scene.time.dt, halve=False),
        simulation.state,
        on_accept=lambda *_: None,
        on_failure=lambda *_: None,
        observe=lambda _: None,
    )
    if not outcome.finished:
        raise NotConvergedError(outcome.reason)
    simulation.linear_solver.destroy()
    return SolvedField(simulation, problem, outcome.state)
