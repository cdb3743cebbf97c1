"""Material points as a course that a run drives."""

from __future__ import annotations

from dataclasses import fields as fields_of
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform import registry
from femdeform.errors import InputError
from femdeform.mpm.explicit_laws import HIGHEST_J, LOWEST_J
from femdeform.mpm.particles import Particles
from femdeform.mpm.surface_coefficient import largest_coefficient
from femdeform.mpm.time_step import capillary_limit, explicit_limit
from femdeform.run.checkpoint import START_ANEW
from femdeform.run.course import Columns, Fields, FrameData
from femdeform.run.expectations import crossing_verdicts, largest_of, measured_verdicts, verdict
from femdeform.run.inputs import RunInput
from femdeform.run.over_time import over_time_verdicts
from femdeform.run.point_quantities import PointMeter, PointState, kinetic_energy, pressures, volume_ratios
from femdeform.run.point_setup import make_points
from femdeform.run.point_step import PointReport, PointStep, law_densities
from femdeform.run.setup import make_linear_solver
from femdeform.run.vtp import VTPWriter
from femdeform.scene.mesh_files import with_absolute_paths
from femdeform.scene.point_body_schema import PointWall
from femdeform.scene.point_schema import BlockCGLinearSolver
from femdeform.step_problem import IterationObserver

# Part of the points that may be at a bound of their volume ratio before it is told.
_BOUNDED = 0.02

COLUMNS = (
    "step",
    "time",
    "dt",
    "iterations",
    "linear_iterations",
    "residual_norm",
    "relative_residual",
    "kinetic_energy",
    "nodes",
    "samples",
    "seconds",
)


class PointCourse:
    """A scene of material points; see `femdeform.run.course.Course`.

    Parameters
    ----------
    given : RunInput
        The checked scene and the meshes of its bodies and walls.
    comm : mpi4py communicator or None
        Ranks share the grid solve of an implicit step; each has all material points, and does all else.
    """

    columns = COLUMNS
    limited_by = "time.cfl, or waves that a step has to resolve"

    def __init__(self, given: RunInput, comm: Any | None) -> None:
        scene = given.loaded.scene
        assert scene.simulation == "material_points"
        self._given, self._scene = given, scene
        self.growth = scene.time.growth
        self.notices: list[str] = []
        self._linear_solver: Any = None
        solver = None
        if scene.time.scheme == "backward_euler":
            options = scene.linear_solver
            if isinstance(options, BlockCGLinearSolver):
                make = registry.resolve(registry.LINEAR_SOLVERS["block_cg"])
                self._linear_solver = make(options.tolerance, options.max_iterations)
            else:
                self._linear_solver = make_linear_solver(options, 1 if comm is None else comm.Get_size(), self.notices)
            solver = registry.resolve(registry.SOLVERS["projected_newton"])(scene.solver, self._linear_solver)
        self._solver = solver
        self.start = PointState(make_points(scene, given.meshes))
        self._step = PointStep(scene, given.meshes, solver, comm, self.start.particles)
        self._meter = PointMeter(scene, self._step.materials)
        self._measured: dict[str, float] = {}
        self._told_bounded = False
        self.writer = VTPWriter()
        if scene.surface.comparison is not None:
            self.notices.append("surface.comparison: a scheme to compare with, which loses momentum")
        self._lightest = min(density for _, density in law_densities(self._step.materials.laws, scene))
        limit = self._wave_limit(self.start.particles)
        if limit < scene.time.dt:
            what = "explicit steps" if solver is None else "steps with surface tension"
            self.notices.append(f"{what} may not be longer than {limit:.3g} s at first: they are shorter than dt")

    def _wave_limit(self, particles: Particles) -> float:
        """What sound and capillary waves allow [s] at the temperatures; the latter bind implicit steps too."""
        spacing, materials = self._scene.grid.cell_size, self._step.materials
        sound = np.inf
        if self._solver is None:
            sound = explicit_limit(spacing, law_densities(materials.stiffest(particles), self._scene))
        # Samples lie as far from their owners as the radius of the level set, less than a cell.
        strongest = largest_coefficient(particles, materials.tensions, spacing)
        return min(sound, capillary_limit(spacing, self._lightest, strongest))

    # ------------------------------------------------------------------------------------------------- stepping

    def step_limit(self, state: PointState) -> float:
        """Longest step by the speed of points and walls, by capillary waves, and by sound where it is explicit [s].

        What gravity or forces add to the speeds within the step is left to `PointStep`, which refuses jumps.
        """
        fastest = float(np.sqrt((state.particles.v**2).sum(axis=1).max(initial=0.0)))
        fastest = max([fastest, *(float(np.linalg.norm(wall.velocity)) for wall in self._step.walls)])
        courant = self._scene.time.cfl * self._scene.grid.cell_size / fastest if fastest > 0.0 else np.inf
        return min(courant, self._wave_limit(state.particles))

    def attempt(
        self, state: PointState, dt: float, observe: IterationObserver | None
    ) -> tuple[PointState, PointReport]:
        """Try a step."""
        particles, report = self._step.take(state.particles, state.time, state.step, dt, observe)
        new = PointState(particles, state.time + dt, state.step + 1, report.surface_area, report.surface_energy)
        return new, report

    # -------------------------------------------------------------------------------------------------- telling

    def row(self, state: PointState, report: PointReport) -> dict[str, float | int | str]:
        """Solver, sizes, heat, and what the scene measures."""
        self._note_bounded(state, report)
        self._measured = {f"measure.{name}": value for name, value in self._meter.evaluate(state).items()}
        row: dict[str, float | int | str] = {
            "linear_iterations": report.linear_iterations,
            "residual_norm": report.residual_norm,
            "kinetic_energy": kinetic_energy(state.particles),
            "nodes": report.n_nodes,
            "samples": report.n_samples,
            "bounded": report.n_bounded,
        }
        if report.heat is not None:
            row |= {
                "heat_iterations": report.heat.iterations,
                "boundary_power": report.heat.boundary_power,
                "source_power": report.heat.source_power,
                "wall_power": report.heat.wall_power,
                "melted": report.n_melted,
                "frozen": report.n_frozen,
            }
        return row | self._measured

    def _note_bounded(self, state: PointState, report: PointReport) -> None:
        """Tell once of many points that resist no more: the liquid then shows less volume than it has."""
        if not self._told_bounded and report.n_bounded > _BOUNDED * state.particles.n:
            self._told_bounded = True
            self.notices.append(
                f"step {state.step}: {report.n_bounded} liquid points are as small or as large as points may be "
                f"(J = {LOWEST_J:g} or {HIGHEST_J:g}) and resist no more: the liquid loses visible volume; a larger "
                "bulk modulus helps"
            )

    def frame(self, state: PointState) -> FrameData | None:
        """Positions and what the scene asks for."""
        points = state.particles
        data: dict[str, NDArray[Any]] = {"position": points.x}
        for name in self._scene.output.fields:
            if name == "speed":
                data[name] = np.linalg.norm(points.v, axis=1)
            elif name == "velocity":
                data[name] = points.v
            elif name == "J":
                data[name] = volume_ratios(points)
            elif name == "pressure":
                data[name] = pressures(points, self._step.materials)
            elif name == "temperature":
                data[name] = points.temperature
            elif name == "phase":
                data[name] = points.phase.astype(np.uint8)
            elif name == "body":
                data[name] = points.body.astype(np.int64)
        return data, {}

    def fields(self, state: PointState) -> Fields | None:
        """All arrays of the points."""
        held = {each.name: getattr(state.particles, each.name) for each in fields_of(Particles)}
        return {**held, "surface": np.array([state.surface_area, state.surface_energy])}

    def restored(self, fields: Fields, time: float, step: int) -> PointState:
        """The state of a checkpoint.

        Raises
        ------
        InputError
            If it has another number of points.
        KeyError
            If a field is missing.
        """
        particles = Particles(**{each.name: np.asarray(fields[each.name]) for each in fields_of(Particles)})
        if particles.x.shape != self.start.particles.x.shape:
            raise InputError(f"{self._given.folder}: the checkpoint is of other points; {START_ANEW}")
        area, energy = fields["surface"]
        return PointState(particles, time, step, float(area), float(energy))

    def quantities(self, state: PointState) -> dict[str, float]:
        """Standard quantities, and what was measured after the last step."""
        return self._meter.standard(state) | self._measured

    def verdicts(self, state: PointState, history: Columns | None) -> list[dict[str, Any]]:
        """What became of `expect`."""
        expect = self._scene.expect
        found = []
        if expect.residual is not None:
            found.append(verdict("residual", largest_of(history, "relative_residual"), expect.residual))
        values = self._meter.evaluate(state) if expect.measured else {}
        found += measured_verdicts(expect.measured, values)
        start = self._meter.evaluate(self.start) if expect.time_to_reach or expect.over_time else {}
        found += crossing_verdicts(expect.time_to_reach, history, start)
        return found + over_time_verdicts(expect.over_time, history, start)

    def facts(self) -> dict[str, Any]:
        """Solver, sizes, and what pictures show beside the points."""
        scene = self._scene
        is_explicit = scene.time.scheme == "explicit"
        return {
            "method": "explicit" if is_explicit else scene.solver.method,
            "linear_solver": "none" if is_explicit else self._linear_solver.name,
            "residual_tolerance": "none, explicit" if is_explicit else scene.solver.accuracy,
            "n_dofs": self.start.particles.n * scene.dim,
            "n_cells": self.start.particles.n,
            "dim": scene.dim,
            "cell_size": scene.grid.cell_size,
            "bodies": list(scene.bodies),
            "obstacles": [_drawn(wall) for wall in scene.walls if wall.shape.kind in ("plane", "sphere", "box")],
        }

    def resolve(self, resolved: dict[str, Any]) -> None:
        """Make the paths of mesh files absolute."""
        with_absolute_paths(self._given.loaded, resolved)

    def write_beside(self, folder: Path) -> list[str]:
        """Nothing."""
        return []

    def reset(self) -> None:
        """Let solvers and the fast step forget."""
        self._step.reset()
        if self._linear_solver is not None:
            self._linear_solver.reset()

    def destroy(self) -> None:
        """Free what the solvers hold."""
        if self._solver is not None:
            self._solver.destroy()
            self._linear_solver.destroy()


def _drawn(wall: PointWall) -> dict[str, Any]:
    """A wall as pictures take obstacles."""
    shape = wall.shape.model_dump(mode="json")
    moving = {} if wall.velocity is None else {"velocity": list(wall.velocity)}
    return {**shape, "inside": wall.inside, **moving}
