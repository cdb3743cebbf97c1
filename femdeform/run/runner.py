"""`femdeform run`: one scene from file to result folder; the only place that puts all parts together."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from femdeform import parallel, registry
from femdeform.errors import Fault, InputError
from femdeform.jit import CompilationAnnouncer
from femdeform.run.checkpoint import FILE_NAME, START_ANEW, Checkpoint, write_checkpoint
from femdeform.run.course import Course
from femdeform.run.expectations import describe_verdict
from femdeform.run.failure import end_all_ranks, reason_of
from femdeform.run.inputs import RunInput, read_together
from femdeform.run.interrupts import INTERRUPTED, Interrupts, last_words
from femdeform.run.progress import Progress
from femdeform.run.recorder import Recorder
from femdeform.run.result_folder import mark_ended
from femdeform.run.table import read_table
from femdeform.run.threads import use_threads
from femdeform.run.time_loop import (
    LoopOutcome,
    Moment,
    StepControl,
    StepReport,
    default_min_dt,
    run_time_loop,
)
from femdeform.step_problem import IterationObserver
from femdeform.types import FloatArray


def run_scene(
    path: Path,
    *,
    out: Path | None = None,
    overrides: Sequence[str] = (),
    resume: bool = False,
    overwrite: bool = False,
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
    overwrite : bool
        Replace a result that lies in the folder; other files stay.
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
    KeyboardInterrupt
        On SIGINT or SIGTERM before there is a result to go on from.
    """
    comm = parallel.world()
    with Interrupts() as interrupts:
        given = read_together(path, out, overrides, resume, overwrite, comm)
        if given.ended is not None:
            if not quiet and (comm is None or comm.Get_rank() == 0):
                print(f"{given.folder}: this run has reached its end already; its result is left as it is")
            return given.ended
        if comm is None:
            return _Run(given, trace, threads, quiet, interrupts, None).execute()
        try:
            return _Run(given, trace, threads, quiet, interrupts, comm).execute()
        except BaseException as error:  # any error on one rank would leave the others waiting for ever
            interrupts.hold()
            if isinstance(error, KeyboardInterrupt):
                mark_ended(given.folder, "interrupted", "interrupted by the user")
            else:
                mark_ended(given.folder, "failed", f"rank {comm.Get_rank()}: {reason_of(error)}")
            end_all_ranks(comm, error)
            raise


@dataclass(frozen=True)
class _End:
    """How a run ended, and what the user is told about it."""

    code: int
    status: str
    advice: str
    state: Moment
    verdicts: list[dict[str, Any]]


class _Run:
    """One run of one scene on this rank."""

    def __init__(
        self,
        given: RunInput,
        trace: bool,
        threads: int | None,
        quiet: bool,
        interrupts: Interrupts,
        comm: Any | None,
    ) -> None:
        loaded, checkpoint = given.loaded, given.checkpoint
        self.loaded = loaded
        self.scene = loaded.scene
        self.comm = comm
        self.is_first = comm is None or comm.Get_rank() == 0
        self.folder = given.folder
        self.mesh_files = given.mesh_files
        self.interrupts = interrupts
        self.trace = trace
        self.quiet = quiet
        self.begin = time.perf_counter()
        self.threads = use_threads(threads, given.n_cells, given.threaded_cells)
        self.progress = Progress(self.scene.time.end, self.is_first and not quiet)
        self.course: Course[Any, Any] = registry.resolve(registry.COURSES[self.scene.simulation])(given, comm)
        self.n_frames = 0
        self.n_failures = 0
        self.n_told = 0
        self.limited_dt = np.inf
        scene_time = self.scene.time
        on_failure = self.scene.on_failure
        self.control = StepControl(
            dt=scene_time.dt,
            end=scene_time.end,
            min_dt=default_min_dt(scene_time.dt, on_failure.min_dt),
            halve=on_failure.action == "halve_dt",
            growth=self.course.growth,
        )
        self.earlier_seconds = 0.0 if checkpoint is None else checkpoint.seconds
        self.state: Moment = self.course.start if checkpoint is None else self._restore(checkpoint)
        self.resumed = checkpoint is not None
        self.last_saved = self.state.step if self.resumed else -1
        self.next_dt, self.streak = self.control.current, self.control.streak
        self.recorder: Recorder | None = None
        if self.is_first:
            step = self.state.step if self.resumed else None
            self.recorder = Recorder(
                self.folder,
                self.course.writer,
                self.course.columns,
                resume_from_step=step,
                trace=trace,
                overwrite=given.overwrite,
            )

    # ---------------------------------------------------------------------------------------------- running

    def execute(self) -> int:
        """Run to the end, write the outcome, return the exit code."""
        try:
            try:
                with last_words(self._mark_interrupted):
                    outcome = self._run()
            except KeyboardInterrupt:
                self.interrupts.hold()
                end = self._interrupted()
            else:
                self.interrupts.hold()
                end = self._finish(outcome)
        except Exception as error:
            self._record_failure(error)
            raise
        self._say(end)
        return end.code

    def _run(self) -> LoopOutcome[Moment]:
        if self.comm is not None:
            # Ranks have to stop at the same step; the launcher may lack the patience to wait for that.
            self.interrupts.hold(self._mark_interrupted)
        for text in self.loaded.notices:
            self.progress.notice(f"note: {text}")
        self._tell_notices()
        if self.recorder is not None:
            self.recorder.start(self._resolved(), self._facts())
            for text in self.course.write_beside(self.folder):
                self.progress.notice(f"note: {text}")
        if not self.resumed:
            self._write_frame(self.state)
            self._save(self.state)
        self.step_begin = time.perf_counter()
        # Numbers that leave their range make a step fail, with a reason; NumPy need not warn of each.
        overflow = np.errstate(over="ignore", invalid="ignore")
        with CompilationAnnouncer(self.progress.notice), self.progress, overflow:
            return run_time_loop(
                self.course,
                self.control,
                self.state,
                on_accept=self._on_accept,
                on_failure=self._on_failure,
                observe=self._observer,
                on_limit=self._on_limit,
            )

    def _on_accept(self, state: Moment, report: StepReport, dt: float) -> None:
        if self.control.is_done(state.time):
            self.interrupts.hold()  # all there is left to do is to write, and that takes a moment
        # A step is recorded as a whole or not at all: an interrupt waits for that.
        with self.interrupts.held():
            self._record(state, report, dt)
        if not self.control.is_done(state.time):
            self._stop_together()

    def _stop_together(self) -> None:
        """Raise KeyboardInterrupt on every rank if one of them was told to stop."""
        if self.comm is not None and self.comm.allreduce(int(self.interrupts.is_pending)):
            raise KeyboardInterrupt

    def _record(self, state: Moment, report: StepReport, dt: float) -> None:
        self.state = state
        # Not what is in use when a checkpoint is written: that may belong to a later attempt.
        self.next_dt, self.streak = self.control.current, self.control.streak
        now = time.perf_counter()
        row: dict[str, float | int | str] = {
            "step": state.step,
            "time": state.time,
            "dt": dt,
            "iterations": report.iterations,
            "relative_residual": report.relative_residual,
            "seconds": now - self.step_begin,
            "failed_attempts": self.n_failures,
            "stopped_by": report.reason,
            **self.course.row(state, report),
        }
        self.n_failures = 0
        self._tell_notices()
        if self.recorder is not None:
            self.recorder.step(row)
        if state.step % self.scene.output.every == 0 or self.control.is_done(state.time):
            self._write_frame(state)
        # The end is saved with its verdicts, for which the forces of the last step are needed.
        if state.step % self.scene.output.checkpoint_every == 0 and not self.control.is_done(state.time):
            self._save(state)
        self.progress.advance(state.step, state.time, report.relative_residual, report.iterations)
        self.step_begin = time.perf_counter()

    def _tell_notices(self) -> None:
        """Say what the course has noticed since it was asked last."""
        for text in self.course.notices[self.n_told :]:
            self.progress.notice(f"note: {text}")
        self.n_told = len(self.course.notices)

    def _on_failure(self, state: Moment, report: StepReport, dt: float, retry: bool) -> None:
        self.n_failures += 1
        if retry:
            self.progress.notice(
                f"step {state.step + 1} with dt = {dt:.3g} s: {report.reason}; trying dt = {self.control.current:.3g} s"
            )
        self._stop_together()

    def _on_limit(self, state: Moment, dt: float, limit: float) -> None:
        # Limits may change in every step: told again once they have halved it again.
        if dt <= 0.5 * self.limited_dt:
            self.limited_dt = dt
            self.progress.notice(
                f"step {state.step + 1}: dt = {dt:.3g} s, for steps may not be longer than {limit:.3g} s "
                f"({self.course.limited_by})"
            )

    def _observer(self, step: int) -> IterationObserver | None:
        if not self.trace or self.recorder is None:
            return None
        recorder = self.recorder

        def observe(row: Mapping[str, float | int | str], x: FloatArray) -> None:
            recorder.iteration({"step": step, **row})

        return observe

    # ---------------------------------------------------------------------------------------------- output

    def _write_frame(self, state: Moment) -> None:
        data = self.course.frame(state)
        if self.recorder is not None and data is not None:
            self.recorder.frame(self.n_frames, state.time, *data)
        self.n_frames += 1

    def _save(self, state: Moment) -> None:
        """Write a checkpoint, and forget what the solvers remember: a resumed run starts without it too."""
        fields = self.course.fields(state)
        if self.recorder is not None and fields is not None:
            self.recorder.sync()
            write_checkpoint(
                self.folder,
                Checkpoint(
                    fields,
                    state.time,
                    state.step,
                    self.next_dt,
                    self.streak,
                    self.n_frames,
                    self._seconds(),
                    self.loaded.hash,
                    self.mesh_files,
                ),
            )
        self.course.reset()
        self.last_saved = state.step

    def _restore(self, checkpoint: Checkpoint) -> Moment:
        try:
            state: Moment = self.course.restored(checkpoint.fields, checkpoint.time, checkpoint.step)
        except KeyError as error:
            message = f"the checkpoint is damaged (there is no {error} in it); {START_ANEW}"
            raise InputError([Fault(str(self.folder / FILE_NAME), 0, "", message)]) from None
        self.control.current, self.control.streak = checkpoint.current_dt, checkpoint.streak
        self.n_frames = checkpoint.frames
        return state

    def _seconds(self) -> float:
        return self.earlier_seconds + time.perf_counter() - self.begin

    def _finish(self, outcome: LoopOutcome[Moment]) -> _End:
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
        self.course.destroy()
        return _End(code, status, reason, outcome.state, verdicts)

    def _judge(self, outcome: LoopOutcome[Moment]) -> tuple[list[dict[str, Any]], dict[str, float]]:
        """Verdicts of `expect` and the quantities at the end; the same on all ranks."""
        quantities = self.course.quantities(outcome.state)
        if not outcome.finished:
            return [], quantities
        history = None
        if self.is_first and (self.folder / "history.csv").exists():
            history = read_table(self.folder / "history.csv")
        if self.comm is not None:
            history = self.comm.bcast(history, root=0)
        return self.course.verdicts(outcome.state, history), quantities

    def _interrupted(self) -> _End:
        if self.last_saved < 0:
            self._mark_interrupted()
            advice = "nothing was computed yet; --resume begins again"
        else:
            if self.last_saved != self.state.step:
                self._save(self.state)
            self._record_end(self.state, "interrupted", "interrupted by the user", [])
            advice = f"go on with --resume from step {self.state.step}"
        return _End(INTERRUPTED, "interrupted", advice, self.state, [])

    def _mark_interrupted(self) -> None:
        if self.is_first:
            # A launcher ends the ranks that are left when one has died.
            who = "the user" if self.comm is None else "the user, or by the launcher"
            mark_ended(self.folder, "interrupted", f"interrupted by {who}")

    def _record_failure(self, error: Exception) -> None:
        """Let the result say that the run is over; on several ranks the others may be waiting elsewhere."""
        if self.comm is None:
            self.interrupts.hold()
            try:
                self._record_end(self.state, "failed", reason_of(error), [])
            except Exception:  # whatever made the run fail may keep its fields from being written
                mark_ended(self.folder, "failed", reason_of(error))
            finally:
                if self.recorder is not None:
                    self.recorder.close()

    def _record_end(
        self,
        state: Moment,
        status: str,
        reason: str,
        verdicts: list[dict[str, Any]],
        quantities: Mapping[str, float] | None = None,
    ) -> None:
        data = self.course.frame(state)
        if self.recorder is not None and data is not None:
            facts = {
                "wall_seconds": self._seconds(),
                "expect": verdicts,
                "quantities": quantities or {},
                "steps": state.step,
                "time": state.time,
            }
            self.recorder.finish(status, reason, facts, *data)

    def _say(self, end: _End) -> None:
        if not self.is_first:
            return
        for v in end.verdicts:
            mark = "ok" if v["passed"] else "FAILED"
            print(f"expect: {describe_verdict(v)}: {mark}")
        done = f"{end.state.step} steps to t = {end.state.time:.6g} s in {self._seconds():.1f} s"
        text = f"{end.status}: {done}; {self.folder}"
        stream = sys.stdout if end.status == "done" else sys.stderr
        if not (self.quiet and end.status == "done"):
            print(f"{text}\n{end.advice}" if end.advice else text, file=stream, flush=True)

    def _resolved(self) -> dict[str, Any]:
        resolved: dict[str, Any] = self.scene.model_dump(mode="json", exclude_none=True)
        self.course.resolve(resolved)
        return resolved

    def _facts(self) -> dict[str, Any]:
        from femdeform.info import versions

        return {
            "title": self.scene.title,
            "simulation": self.scene.simulation,
            "ranks": 1 if self.comm is None else self.comm.Get_size(),
            "threads": self.threads,
            "versions": versions(),
            "scene_hash": self.loaded.hash,
            "scene_file": self.loaded.path.name,
            **self.course.facts(),
        }
