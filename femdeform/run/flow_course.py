"""Smoke in an incompressible flow as a course that a run drives."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform import registry
from femdeform.errors import InputError, NotConvergedError
from femdeform.flow.curl import vorticity
from femdeform.flow.mac_grid import ProjectionReport
from femdeform.run.checkpoint import START_ANEW
from femdeform.run.course import Columns, Fields, FrameData
from femdeform.run.expectations import crossing_verdicts, largest_of, measured_verdicts, verdict
from femdeform.run.flow_quantities import FlowMeter, FlowState, at_centres, kinetic_energy, smoke
from femdeform.run.flow_setup import build_flow, walls_behind
from femdeform.run.inputs import RunInput
from femdeform.run.vti import VTIWriter
from femdeform.scene.mesh_files import with_absolute_paths
from femdeform.scene.pressure_schema import LearnedPressureSolver
from femdeform.step_problem import IterationObserver
from femdeform.types import FloatArray

# Where a learned pressure solver was stopped or put aside.
SOLVER_LOG = "linear_solver.log"

COLUMNS = (
    "step",
    "time",
    "dt",
    "substeps",
    "iterations",
    "relative_residual",
    "divergence_before",
    "divergence",
    "imbalance",
    "kinetic_energy",
    "smoke",
    "seconds",
)


@dataclass(frozen=True)
class FlowReport:
    """What became of a step; see `femdeform.run.time_loop.StepReport`.

    Attributes
    ----------
    projections : list of ProjectionReport
        One for each part of the step; none if it was refused.
    reason : str
        Of the solver that failed, or of the last one.
    accepted : bool
        Whether all pressures were found and all velocities are finite.
    """

    projections: list[ProjectionReport]
    reason: str
    accepted: bool

    @property
    def iterations(self) -> int:
        """Of the pressure solver, over all parts."""
        return sum(each.iterations for each in self.projections)

    @property
    def relative_residual(self) -> float:
        """Largest residual of a pressure over its right-hand side [-]."""
        return max((each.relative_residual for each in self.projections), default=float("nan"))

    def largest(self, name: str) -> float:
        """Largest value of an attribute of the projections."""
        return max(float(getattr(each, name)) for each in self.projections)


class FlowCourse:
    """A scene of smoke; see `femdeform.run.course.Course`.

    Parameters
    ----------
    given : RunInput
        The checked scene and the meshes of its solids.
    comm : None
        Flows run on one rank.
    """

    columns = COLUMNS
    limited_by = ""
    growth: float | None = None

    def __init__(self, given: RunInput, comm: Any | None) -> None:
        scene = given.loaded.scene
        assert scene.simulation == "incompressible_flow"
        self._given, self._scene = given, scene
        make = registry.resolve(registry.PRESSURE_SOLVER)
        self._make_solver = make(scene.linear_solver, given.loaded.base_dir)
        self.flow = build_flow(scene, given.meshes, self._make_solver)
        self._meter = FlowMeter(scene, self.flow.grid)
        self._events: list[str] = self._make_solver.events
        self._folder: Path | None = None
        self._measured: dict[str, float] = {}
        grid = self.flow.grid
        self.writer = VTIWriter(grid.shape, grid.spacing, grid.origin.tolist())
        self.start = FlowState(_copies(grid.velocity), self.flow.density, np.zeros(grid.shape))
        self.notices: list[str] = []
        for name, source in zip(scene.sources, self.flow.sources, strict=True):
            if not source.voxels.any():
                self.notices.append(f"sources.{name}: no voxel has its centre in its region; there is no smoke")
            self.notices += [
                f"sources.{name}: blows from the wall on the {side}, which lets nothing in; `inlets` drive fluid in"
                for side in walls_behind(scene, source)
            ]

    def step_limit(self, state: FlowState) -> float:
        """Steps are divided where they have to be: there is no limit [s]."""
        return np.inf

    def attempt(self, state: FlowState, dt: float, observe: IterationObserver | None) -> tuple[FlowState, FlowReport]:
        """Try a step."""
        flow = self.flow
        flow.put(state.velocity, state.density, state.time)
        try:
            n = flow.n_substeps(dt)
        except NotConvergedError as error:
            return state, FlowReport([], str(error), False)
        projections = flow.step(dt)
        failed = [each for each in projections if not each.converged]
        finite = all(bool(np.isfinite(each.divergence_after)) for each in projections)
        reason = failed[0].reason if failed else projections[-1].reason if finite else "velocities are not finite"
        report = FlowReport(projections, reason, finite and not failed)
        last = projections[-1]
        new = FlowState(
            _copies(flow.grid.velocity),
            flow.density,
            np.asarray(last.q[1:-1, 1:-1, 1:-1] * (self._scene.density * flow.grid.spacing * n / dt), dtype=float),
            flow.time,
            state.step + 1,
            report.largest("divergence_after"),
            report.largest("imbalance"),
        )
        return new, report

    def row(self, state: FlowState, report: FlowReport) -> dict[str, float | int | str]:
        """Divergence, energies and what the scene measures."""
        self._log_events(state.step)
        self.notices += [f"linear_solver: {text}" for text in self._make_solver.notices]
        self._make_solver.notices.clear()
        grid = self.flow.grid
        self._measured = {f"measure.{name}": value for name, value in self._meter.evaluate(state).items()}
        return {
            "substeps": len(report.projections),
            "divergence_before": report.largest("divergence_before"),
            "divergence": state.divergence,
            "imbalance": state.imbalance,
            "kinetic_energy": kinetic_energy(grid, state.velocity, self._scene.density),
            "smoke": smoke(grid, state.density),
            **self._measured,
        }

    def frame(self, state: FlowState) -> FrameData | None:
        """Fields at the centres of the voxels."""
        # An attempt that came to nothing may have left the flow elsewhere.
        self.flow.put(state.velocity, state.density, state.time)
        grid = self.flow.grid
        cells: dict[str, list[NDArray[Any]]] = {}
        velocity: FloatArray = at_centres(state.velocity)
        for name in self._scene.output.fields:
            if name == "density":
                cells[name] = [state.density]
            elif name == "velocity":
                cells[name] = [velocity]
            elif name == "speed":
                cells[name] = [np.linalg.norm(velocity, axis=-1)]
            elif name == "vorticity":
                cells[name] = [vorticity(velocity, grid.spacing, grid.dim)]
            elif name == "solid":
                cells[name] = [self.flow.is_solid.astype(np.uint8)]
            elif name == "divergence":
                inner = self.flow.grid.divergence(self.flow.system)[1:-1, 1:-1, 1:-1]
                cells[name] = [inner / grid.spacing]
            elif name == "pressure":
                cells[name] = [state.pressure]
        return {}, cells

    def fields(self, state: FlowState) -> Fields | None:
        """Velocities and density."""
        held = dict(zip("uvw", state.velocity, strict=True))
        left = np.array([state.divergence, state.imbalance])
        return {**held, "density": state.density, "pressure": state.pressure, "left": left}

    def restored(self, fields: Fields, time: float, step: int) -> FlowState:
        """The state of a checkpoint.

        Raises
        ------
        InputError
            If it is one of another grid.
        """
        if fields["density"].shape != self.flow.grid.shape:
            raise InputError(f"{self._given.folder}: the checkpoint is of another grid; {START_ANEW}")
        state = FlowState(
            (fields["u"], fields["v"], fields["w"]),
            fields["density"],
            fields["pressure"],
            time,
            step,
            float(fields["left"][0]),
            float(fields["left"][1]),
        )
        self.flow.put(state.velocity, state.density, state.time)
        return state

    def quantities(self, state: FlowState) -> dict[str, float]:
        """Standard quantities, and what was measured after the last step."""
        return self._meter.standard(state) | self._measured

    def verdicts(self, state: FlowState, history: Columns | None) -> list[dict[str, Any]]:
        """What became of `expect`."""
        expect = self._scene.expect
        found = []
        for name, column in (("residual", "relative_residual"), ("divergence", "divergence")):
            expected = getattr(expect, name)
            if expected is not None:
                found.append(verdict(name, largest_of(history, column), expected))
        values = self._meter.evaluate(state) if expect.measured else {}
        found += measured_verdicts(expect.measured, values)
        start = self._meter.evaluate(self.start) if expect.time_to_reach else {}
        return found + crossing_verdicts(expect.time_to_reach, history, start)

    def facts(self) -> dict[str, Any]:
        """The pressure solver and sizes."""
        options = self._scene.linear_solver
        return {
            "method": "chorin_projection",
            "linear_solver": options.method,
            "residual_tolerance": f"{options.tolerance:g} of the divergence of each projection",
            "n_dofs": self.flow.system.n_unknowns,
            "n_cells": self._scene.n_cells,
            "solids": list(self._scene.solids),
        }

    def _log_events(self, step: int) -> None:
        """Write down where a learned pressure solver was stopped or put aside."""
        if self._events and self._folder is not None:
            with (self._folder / SOLVER_LOG).open("a", encoding="utf-8") as log:
                log.writelines(f"step {step}: {text}\n" for text in self._events)
        self._events.clear()

    def resolve(self, resolved: dict[str, Any]) -> None:
        """Make the paths of files absolute."""
        with_absolute_paths(self._given.loaded, resolved)
        options = self._scene.linear_solver
        if isinstance(options, LearnedPressureSolver) and options.weights is not None:
            path = registry.resolve(registry.WEIGHTS_PATH)(options.weights, self._given.loaded.base_dir)
            resolved["linear_solver"]["weights"] = path

    def write_beside(self, folder: Path) -> list[str]:
        """Nothing yet; remember where to write what the pressure solver tells."""
        self._folder = folder
        return []

    def reset(self) -> None:
        """Forget which solver was the faster one."""
        self._make_solver.reset()

    def destroy(self) -> None:
        """Free what the pressure solver holds."""
        self.flow.destroy()


def _copies(velocity: list[FloatArray]) -> tuple[FloatArray, FloatArray, FloatArray]:
    u, v, w = (component.copy() for component in velocity)
    return u, v, w
