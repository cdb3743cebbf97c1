"""`femdeform run`: one scene from file to result folder; the only place that puts all parts together."""

from __future__ import annotations

import os
import signal
import sys
import time
import traceback
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

from femdeform import parallel
from femdeform.errors import FemdeformError, InputError, OutputError
from femdeform.fem.incremental_potential import State
from femdeform.jit import CompilationAnnouncer, set_threads
from femdeform.run.checkpoint import START_ANEW, Checkpoint, is_unsaved, read_checkpoint, write_checkpoint
from femdeform.run.expectations import check_expectations, describe_verdict
from femdeform.run.output import FrameSource
from femdeform.run.progress import Progress
from femdeform.run.quantities import Meter, standard_quantities
from femdeform.run.recorder import Recorder
from femdeform.run.result import Result
from femdeform.run.setup import Simulation, build_simulation
from femdeform.run.table import read_table
from femdeform.run.time_loop import LoopOutcome, StepControl, default_min_dt, run_time_loop
from femdeform.scene.checks import check_file, check_scene
from femdeform.scene.load import LoadedScene, load_scene
from femdeform.scene.meshing import load_meshes
from femdeform.step_problem import IterationObserver, StepResult
from femdeform.types import FloatArray, Mesh

_INTERRUPTED = 130
_THREADED_CELLS = 2000


def run_scene(
    path: Path,
    *,
    out: Path | None = None,
    overrides: Sequence[str] = (),
    resume: bool = False,
    trace: bool = False,
    threads: int | None = None,
    quiet: bool = False,
) -> int:
    """Run a scene and leave a result folder.

    Parameters
    ----------
    path : Path
        Scene file.
    out : Path, optional
        Result folder; default ``results/<scene name>`` in the current folder.
    overrides : sequence of str
        ``key=value`` as given to ``--set``.
    resume : bool
        Go on from the folder's checkpoint.
    trace : bool
        Write ``iterations.csv``.
    threads : int, optional
        Threads of the compiled kernels; default: cores divided by ranks.
    quiet : bool
        No progress, no notices.

    Returns
    -------
    int
        0 done, 1 an expectation failed, 3 not converged, 130 interrupted.

    Raises
    ------
    FemdeformError
        On bad input or a missing dependency; on several ranks the same error on each, except for one that only some
        ranks meet: that one is printed and ends all ranks.
    """
    comm = parallel.world()
    given = _read_together(path, out, overrides, resume, comm)
    if comm is None:
        return _Run(given, trace, threads, quiet, None).execute()
    try:
        return _Run(given, trace, threads, quiet, comm).execute()
    except BaseException as error:  # any error on one rank would leave the others waiting for ever
        _end_all_ranks(comm, error)
        raise


def _end_all_ranks(comm: Any, error: BaseException) -> None:
    """Say on this rank what went wrong, and end the others with it."""
    if isinstance(error, FemdeformError):
        print(f"femdeform: rank {comm.Get_rank()}: {error}", file=sys.stderr, flush=True)
    else:
        traceback.print_exception(error)
        sys.stderr.flush()
    comm.Abort(error.exit_code if isinstance(error, FemdeformError) else 1)


@dataclass(frozen=True)
class _Given:
    """What a run starts from: the scene, its meshes, the result folder and what is to go on from there."""

    loaded: LoadedScene
    meshes: dict[str, Mesh]
    folder: Path
    checkpoint: Checkpoint | None
    overwrite: bool


def _read_together(
    path: Path, out: Path | None, overrides: Sequence[str], resume: bool, comm: Any | None
) -> _Given:
    """Rank 0 reads, checks and meshes; all ranks get the same answer, or the same error."""
    answer: _Given | FemdeformError | None = None
    if comm is None or comm.Get_rank() == 0:
        try:
            answer = _read(path, out, overrides, resume, 1 if comm is None else comm.Get_size())
        except FemdeformError as error:
            answer = error
        except BaseException as error:
            if comm is not None:
                _end_all_ranks(comm, error)
            raise
    if comm is not None:
        answer = comm.bcast(answer, root=0)
    if isinstance(answer, FemdeformError):
        raise answer
    assert answer is not None
    return answer


def _read(path: Path, out: Path | None, overrides: Sequence[str], resume: bool, ranks: int) -> _Given:
    try:
        loaded = load_scene(path, overrides)
    except InputError as error:
        # With what a check finds in the sound part, so that the user hears of everything at once.
        raise InputError(check_file(path, overrides) or error.faults) from None
    if ranks > 1 and loaded.scene.linear_solver.method == "scipy_direct":
        key = ("linear_solver", "method")
        raise InputError([loaded.fault(key, f"scipy_direct is serial; use ksp on {ranks} ranks")])
    if ranks > 1 and loaded.scene.contact.method == "ipc":
        key = ("contact", "method")
        raise InputError([loaded.fault(key, f"ipc is serial; run on one rank, not {ranks}, or use penalty")])
    folder = out if out is not None else Path("results") / loaded.path.stem
    # A run that was killed before its first checkpoint has nothing to go on from: it begins again.
    begin_again = resume and is_unsaved(folder)
    checkpoint = read_checkpoint(folder, loaded.hash) if resume and not begin_again else None
    meshes = load_meshes(loaded)
    faults = check_scene(loaded, meshes)
    if faults:
        raise InputError(faults)
    return _Given(loaded, meshes, folder, checkpoint, begin_again)


class _Run:
    """One run of one scene on this rank."""

    def __init__(
        self, given: _Given, trace: bool, threads: int | None, quiet: bool, comm: Any | None
    ) -> None:
        loaded, checkpoint = given.loaded, given.checkpoint
        self.loaded = loaded
        self.scene = loaded.scene
        self.comm = comm
        self.is_first = comm is None or comm.Get_rank() == 0
        self.folder = given.folder
        self.trace = trace
        self.quiet = quiet
        self.begin = time.perf_counter()
        n_cells = sum(mesh.n_cells for mesh in given.meshes.values())
        if threads is None and n_cells < _THREADED_CELLS and "FEMDEFORM_THREADS" not in os.environ:
            # Few cells are done before a second thread has woken up.
            threads = 1
        self.threads = set_threads(threads)
        # PETSc's BLAS is loaded later and would take all cores on every rank.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", str(self.threads))
        self.progress = Progress(self.scene.time.end, self.is_first and not quiet)
        self.simulation: Simulation = build_simulation(self.scene, given.meshes, comm)
        self.frames = FrameSource(self.simulation)
        self.meter = Meter(self.simulation)
        self.measured: dict[str, float] = {}
        self.n_frames = 0
        self.n_failures = 0
        scene_time = self.scene.time
        on_failure = self.scene.on_failure
        self.control = StepControl(
            dt=scene_time.dt,
            end=scene_time.end,
            min_dt=default_min_dt(scene_time.dt, on_failure.min_dt),
            halve=on_failure.action == "halve_dt",
        )
        self.earlier_seconds = 0.0 if checkpoint is None else checkpoint.seconds
        self.state = self.simulation.state if checkpoint is None else self._restore(checkpoint)
        self.resumed = checkpoint is not None
        # What a run that has reached its end already says of itself; nobody can measure the forces of its last step.
        self.earlier_facts = Result.open(self.folder).facts if self.resumed and self.is_first else {}
        self.first_step = self.state.step
        self.last_saved = self.state.step if self.resumed else -1
        self.is_recording = False
        self.is_interrupted = False
        self.recorder: Recorder | None = None
        if self.is_first:
            step = self.state.step if self.resumed else None
            self.recorder = Recorder(
                self.folder, self.frames.mesh, resume_from_step=step, trace=trace, overwrite=given.overwrite
            )

    # ---------------------------------------------------------------------------------------------- running

    def execute(self) -> int:
        """Run to the end, write the outcome, return the exit code."""
        for text in [*self.loaded.notices, *self.simulation.notices]:
            self.progress.notice(f"note: {text}")
        if self.recorder is not None:
            self.recorder.start(self._resolved(), self._facts())
        if not self.resumed:
            self._write_frame(self.state)
            self._save(self.state)
        self.step_begin = time.perf_counter()
        handlers = {number: signal.signal(number, self._interrupt) for number in (signal.SIGTERM, signal.SIGINT)}
        try:
            with CompilationAnnouncer(self.progress.notice), self.progress:
                outcome = run_time_loop(
                    self.simulation.problem,
                    self.simulation.solver,
                    self.control,
                    self.state,
                    on_accept=self._on_accept,
                    on_failure=self._on_failure,
                    observe=self._observer,
                )
        except KeyboardInterrupt:
            return self._interrupted()
        except Exception as error:
            self._record_failure(error)
            raise
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
        return self._finish(outcome)

    def _interrupt(self, number: int, frame: FrameType | None) -> None:
        if not self.is_recording:
            raise KeyboardInterrupt
        self.is_interrupted = True

    def _on_accept(self, state: State, result: StepResult, dt: float) -> None:
        # A step is recorded as a whole or not at all: an interrupt waits for that.
        self.is_recording = True
        self._record(state, result, dt)
        self.is_recording = False
        if self.is_interrupted and not self.control.is_done(state.time):
            raise KeyboardInterrupt

    def _record(self, state: State, result: StepResult, dt: float) -> None:
        problem = self.simulation.problem
        self.state = state
        now = time.perf_counter()
        row: dict[str, float | int | str] = {
            "step": state.step,
            "time": state.time,
            "dt": dt,
            "iterations": result.iterations,
            "linear_iterations": result.linear_iterations,
            "residual_norm": result.residual_norm,
            "relative_residual": result.relative_residual,
            "kinetic_energy": problem.kinetic_energy(state.v),
            "elastic_energy": problem.elastic_energy(state.x),
            "potential_energy": problem.load_potential(state.x),
            "seconds": now - self.step_begin,
            "force_scale": problem.force_scale,
            "failed_attempts": self.n_failures,
            "stopped_by": result.reason,
        }
        self.measured = {f"measure.{name}": value for name, value in self.meter.evaluate(state).items()}
        row.update(self.measured)
        self.n_failures = 0
        if self.recorder is not None:
            self.recorder.step(row)
        if state.step % self.scene.output.every == 0 or self.control.is_done(state.time):
            self._write_frame(state)
        # The end is saved with its verdicts, for which the forces of the last step are needed.
        if state.step % self.scene.output.checkpoint_every == 0 and not self.control.is_done(state.time):
            self._save(state)
        self.progress.advance(state.step, state.time, result.relative_residual, result.iterations)
        self.step_begin = time.perf_counter()

    def _on_failure(self, state: State, result: StepResult, dt: float, retry: bool) -> None:
        self.n_failures += 1
        if retry:
            self.progress.notice(
                f"step {state.step + 1} with dt = {dt:.3g} s: {result.reason}; trying dt = {self.control.current:.3g} s"
            )

    def _observer(self, step: int) -> IterationObserver | None:
        if not self.trace or self.recorder is None:
            return None
        recorder = self.recorder

        def observe(row: Mapping[str, float | int | str], x: FloatArray) -> None:
            recorder.iteration({"step": step, **row})

        return observe

    # ---------------------------------------------------------------------------------------------- output

    def _write_frame(self, state: State) -> None:
        points = self.frames.point_data(state)
        cells = self.frames.cell_data(state)
        if self.recorder is not None and points is not None:
            self.recorder.frame(self.n_frames, state.time, points, cells)
        self.n_frames += 1

    def _save(self, state: State) -> None:
        """Write a checkpoint, and forget what the linear solver remembers: a resumed run starts without it too."""
        partition = self.simulation.discretization.partition
        x, v = partition.gather(state.x), partition.gather(state.v)
        if self.recorder is not None and x is not None and v is not None:
            self.recorder.sync()
            write_checkpoint(
                self.folder,
                Checkpoint(
                    x, v, state.time, state.step, self.control.current, self.n_frames, self._seconds(), self.loaded.hash
                ),
            )
        self.simulation.linear_solver.reset()
        self.last_saved = state.step

    def _restore(self, checkpoint: Checkpoint) -> State:
        partition = self.simulation.discretization.partition
        if checkpoint.x.shape != (partition.n_global, self.simulation.discretization.dim):
            raise InputError(f"{self.folder}: the checkpoint is of another mesh; {START_ANEW}")
        self.control.current = checkpoint.current_dt
        self.n_frames = checkpoint.frames
        return State(
            partition.restrict(checkpoint.x), partition.restrict(checkpoint.v), checkpoint.time, checkpoint.step
        )

    def _seconds(self) -> float:
        return self.earlier_seconds + time.perf_counter() - self.begin

    def _finish(self, outcome: LoopOutcome) -> int:
        verdicts, quantities = self._judge(outcome)
        failed = [v for v in verdicts if not v["passed"]]
        if not outcome.finished:
            status, reason, code = "not_converged", outcome.reason, 3
        elif failed:
            status, code = "expectation_failed", 1
            reason = "; ".join(map(describe_verdict, failed))
        else:
            status, reason, code = "done", "", 0
        self._record_end(outcome.state, status, reason, verdicts, quantities)
        if self.last_saved != outcome.state.step:
            self._save(outcome.state)
        self._say_outcome(status, reason, outcome.state, verdicts)
        self.simulation.linear_solver.destroy()
        return code

    def _judge(self, outcome: LoopOutcome) -> tuple[list[dict[str, Any]], dict[str, float]]:
        """Verdicts of `expect` and the quantities at the end; the same on all ranks."""
        if self.resumed and outcome.finished and outcome.state.step == self.first_step:
            earlier = (list(self.earlier_facts.get("expect", [])), dict(self.earlier_facts.get("quantities", {})))
            return earlier if self.comm is None else self.comm.bcast(earlier, root=0)
        quantities = standard_quantities(self.simulation, outcome.state) | self.measured
        if not outcome.finished:
            return [], quantities
        history = None
        if self.is_first and (self.folder / "history.csv").exists():
            history = read_table(self.folder / "history.csv")
        if self.comm is not None:
            history = self.comm.bcast(history, root=0)
        return check_expectations(self.simulation, outcome.state, history), quantities

    def _interrupted(self) -> int:
        # Gathering needs every rank; ranks may be interrupted in different steps, so only a serial run saves.
        if self.comm is None:
            if self.last_saved != self.state.step:
                self._save(self.state)
            self._record_end(self.state, "interrupted", "interrupted by the user", [])
            self._say_outcome("interrupted", f"go on with --resume from step {self.state.step}", self.state, [])
        elif self.recorder is not None:
            self.recorder.close()
            print(f"interrupted; go on with --resume from step {self.last_saved}", file=sys.stderr)
        return _INTERRUPTED

    def _record_failure(self, error: Exception) -> None:
        """Let the result say that the run is over; on several ranks the others may be waiting elsewhere."""
        if self.comm is None:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            with suppress(OutputError):
                self._record_end(self.state, "failed", reason, [])

    def _record_end(
        self,
        state: State,
        status: str,
        reason: str,
        verdicts: list[dict[str, Any]],
        quantities: Mapping[str, float] | None = None,
    ) -> None:
        points = self.frames.point_data(state)
        cells = self.frames.cell_data(state)
        if self.recorder is not None and points is not None:
            facts = {
                "wall_seconds": self._seconds(),
                "expect": verdicts,
                "quantities": quantities or {},
                "steps": state.step,
                "time": state.time,
            }
            self.recorder.finish(status, reason, facts, points, cells)

    def _say_outcome(self, status: str, reason: str, state: State, verdicts: list[dict[str, Any]]) -> None:
        if not self.is_first:
            return
        for v in verdicts:
            mark = "ok" if v["passed"] else "FAILED"
            print(f"expect: {describe_verdict(v)}: {mark}")
        text = f"{status}: {state.step} steps to t = {state.time:.6g} s in {self._seconds():.1f} s; {self.folder}"
        stream = sys.stdout if status == "done" else sys.stderr
        if not (self.quiet and status == "done"):
            print(f"{text}\n{reason}" if reason else text, file=stream, flush=True)

    def _resolved(self) -> dict[str, Any]:
        resolved: dict[str, Any] = self.scene.model_dump(mode="json", exclude_none=True)
        for body in resolved["bodies"].values():
            if "file" in body["mesh"]:
                body["mesh"]["file"] = str((self.loaded.base_dir / body["mesh"]["file"]).resolve())
        return resolved

    def _facts(self) -> dict[str, Any]:
        from femdeform.info import versions

        discretization = self.simulation.discretization
        tolerance = self.scene.solver.tolerance
        return {
            "title": self.scene.title,
            "simulation": self.scene.simulation,
            "method": self.scene.solver.method,
            "linear_solver": self.simulation.linear_solver.name,
            "residual_tolerance": f"{tolerance:g} of the forces of each step (column force_scale, N)",
            "n_dofs": discretization.n_dofs,
            "n_cells": sum(mesh.n_cells for mesh in self.simulation.meshes.values()),
            "ranks": 1 if self.comm is None else self.comm.Get_size(),
            "threads": self.threads,
            "versions": versions(),
            "scene_hash": self.loaded.hash,
            "scene_file": self.loaded.path.name,
            "bodies": list(self.scene.bodies),
            "obstacles": [obstacle.model_dump(mode="json") for obstacle in self.scene.obstacles],
        }
