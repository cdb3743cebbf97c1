"""Deformable bodies as a course that a run drives."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from femdeform.errors import InputError
from femdeform.fem.incremental_potential import State
from femdeform.run.checkpoint import START_ANEW
from femdeform.run.course import Columns, Fields, FrameData
from femdeform.run.expectations import check_expectations
from femdeform.run.inputs import RunInput
from femdeform.run.links import link_lines
from femdeform.run.output import FrameSource
from femdeform.run.quantities import Meter, Snapshot, standard_quantities
from femdeform.run.setup import build_simulation
from femdeform.run.skin import bind_skins, write_skins
from femdeform.run.time_loop import SolverStepper
from femdeform.run.vtu import VTUWriter
from femdeform.scene.mesh_files import with_absolute_paths
from femdeform.step_problem import IterationObserver, StepResult
from femdeform.types import FloatArray

COLUMNS = (
    "step",
    "time",
    "dt",
    "iterations",
    "linear_iterations",
    "residual_norm",
    "relative_residual",
    "kinetic_energy",
    "elastic_energy",
    "potential_energy",
    "contact_energy",
    "seconds",
)


class DeformableCourse:
    """A scene of deformable bodies; see `femdeform.run.course.Course`.

    Parameters
    ----------
    given : RunInput
        The checked scene and its meshes.
    comm : mpi4py communicator or None
        Every rank calls.
    """

    columns = COLUMNS
    limited_by = SolverStepper.limited_by
    growth: float | None = None

    def __init__(self, given: RunInput, comm: Any | None) -> None:
        self._given = given
        self.simulation = build_simulation(given.loaded.deformable, given.meshes, comm)
        self._stepper = SolverStepper(self.simulation.problem, self.simulation.solver)
        self._frames = FrameSource(self.simulation)
        self._meter = Meter(self.simulation)
        self._measured: dict[str, float] = {}
        # Forces of the supports at the last state [N]; before the first step nothing tells them.
        self._reactions: FloatArray | None = None
        self.start = self.simulation.state
        self.notices = self.simulation.notices
        self.writer = VTUWriter(self._frames.mesh)

    def step_limit(self, state: State) -> float:
        """Longest step that may be taken from a state [s]."""
        return self._stepper.step_limit(state)

    def attempt(self, state: State, dt: float, observe: IterationObserver | None) -> tuple[State, StepResult]:
        """Try a step."""
        return self._stepper.attempt(state, dt, observe)

    def row(self, state: State, report: StepResult) -> dict[str, float | int | str]:
        """Energies, residuals and what the scene measures."""
        problem = self.simulation.problem
        row: dict[str, float | int | str] = {
            "linear_iterations": report.linear_iterations,
            "residual_norm": report.residual_norm,
            "kinetic_energy": problem.kinetic_energy(state.v),
            "elastic_energy": problem.elastic_energy(state.x),
            "potential_energy": problem.load_potential(state.x),
            "contact_energy": problem.contact_energy(state.x),
            "force_scale": problem.force_scale,
        }
        if problem.links is not None:
            row["link_energy"] = problem.link_energy(state.x)
        self._measured = {f"measure.{name}": value for name, value in self._meter.evaluate(state).items()}
        if "reaction" in self.simulation.scene.output.fields:
            self._reactions = Snapshot(self.simulation, state).reactions
        return row | self._measured

    def frame(self, state: State) -> FrameData | None:
        """Fields at the nodes and in the cells; None off rank 0."""
        points = self._frames.point_data(state, self._reactions)
        cells = self._frames.cell_data(state)
        return None if points is None else (points, cells or {})

    def fields(self, state: State) -> Fields | None:
        """Positions and velocities of all nodes; None off rank 0."""
        partition = self.simulation.discretization.partition
        held = {"x": state.x, "v": state.v}
        if state.affine is not None:
            held["affine"] = state.affine
        gathered = {name: partition.gather(values) for name, values in held.items()}
        return {name: values for name, values in gathered.items() if values is not None} or None

    def restored(self, fields: Fields, time: float, step: int) -> State:
        """The state of a checkpoint.

        Raises
        ------
        InputError
            If it is one of another mesh.
        """
        partition = self.simulation.discretization.partition
        if fields["x"].shape != (partition.n_global, self.simulation.discretization.dim):
            raise InputError(f"{self._given.folder}: the checkpoint is of another mesh; {START_ANEW}")
        local = {name: partition.restrict(np.asarray(values)) for name, values in fields.items()}
        return State(local["x"], local["v"], time, step, local.get("affine"))

    def quantities(self, state: State) -> dict[str, float]:
        """Standard quantities, and what was measured after the last step."""
        return standard_quantities(self.simulation, state) | self._measured

    def verdicts(self, state: State, history: Columns | None) -> list[dict[str, Any]]:
        """What became of `expect`."""
        return check_expectations(self.simulation, state, history)

    def facts(self) -> dict[str, Any]:
        """Solver, sizes, and what pictures show beside the bodies."""
        simulation, scene = self.simulation, self.simulation.scene
        return {
            "method": scene.solver.method,
            "linear_solver": simulation.linear_solver.name,
            "residual_tolerance": scene.solver.accuracy,
            "n_dofs": simulation.discretization.n_dofs,
            "n_cells": sum(mesh.n_cells for mesh in simulation.meshes.values()),
            "bodies": list(scene.bodies),
            "obstacles": [obstacle.model_dump(mode="json") for obstacle in scene.obstacles],
            "link_lines": link_lines(scene, simulation.meshes),
        }

    def resolve(self, resolved: dict[str, Any]) -> None:
        """Make the paths of mesh files absolute."""
        with_absolute_paths(self._given.loaded, resolved)
        for body in resolved["bodies"].values():
            if "file" in body.get("skin", {}):
                body["skin"]["file"] = str((self._given.loaded.base_dir / body["skin"]["file"]).resolve())

    def write_beside(self, folder: Path) -> list[str]:
        """Write the skins, bound to their bodies."""
        skins, loose = bind_skins(self.simulation, self._given.skins)
        write_skins(folder, skins)
        return loose

    def reset(self) -> None:
        """Let the solvers forget."""
        self.simulation.reset()

    def destroy(self) -> None:
        """Free what the solvers hold."""
        self.simulation.destroy()
