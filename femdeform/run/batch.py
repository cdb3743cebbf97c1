"""`femdeform batch`: all runs of a study, some at a time, kept when they are finished and gone on with when not."""

from __future__ import annotations

import os
import sys
import time
from collections import Counter
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Protocol

from femdeform import parallel
from femdeform.errors import Fault, InputError, MissingDependencyError
from femdeform.jit import default_threads, n_available_cores
from femdeform.run import atomic
from femdeform.run.batch_expectations import described, over_runs_verdicts
from femdeform.run.batch_index import Index, StudyTable
from femdeform.run.batch_plan import Plan, PlannedRun
from femdeform.run.batch_process import Stop, Task, only_batch, run_here
from femdeform.run.batch_progress import BatchProgress
from femdeform.run.batch_ranks import MakeRuns, run_on_ranks
from femdeform.run.batch_record import Ending
from femdeform.run.batch_scenes import check_runs, plan_runs
from femdeform.scene.batch_schema import load_study

_INTERRUPTED = 130
_NOT_CONVERGED = 3
_EXPECTATION_FAILED = 1
# Seconds between two pages on the way; the table is written after every run.
_PAGE_INTERVAL = 30.0
_MANIFEST = "study.json"
_OUTPUTS = ("index.csv", "index.html", "result.json")


class Page(Protocol):
    """Draws what a batch shows; given from above, because nothing here knows how to draw."""

    def draw(self, result: Path, picture: Path) -> None:
        """Draw a picture of a result folder."""

    def write(self, table: StudyTable) -> Path:
        """Write the page of a study, and return where it lies."""


def run_batch(
    path: Path,
    *,
    jobs: int | None = None,
    out: Path | None = None,
    retry: bool = False,
    quiet: bool = False,
    page: Page | None = None,
) -> int:
    """Make all runs of a study; started by a launcher of MPI, its ranks make them.

    Parameters
    ----------
    path : Path
        Study file.
    jobs : int, optional
        Runs at a time; default: one for each core, at most the number of runs.
    out : Path, optional
        Folder of the batch; default: as the study says, else ``results/<study>`` in the current folder.
    retry : bool
        Also run again what failed before, from its start.
    quiet : bool
        No progress; failures are reported all the same.
    page : Page, optional
        Draws pictures and the page; without it there are none.

    Returns
    -------
    int
        0 all runs are done, 1 an expectation of a run or over all runs failed, 3 a run did not converge or crashed, 130
        interrupted.

    Raises
    ------
    FemdeformError
        On bad input, before anything is run, or if the folder cannot be written to.
    """
    if parallel.launched_ranks() == 1:
        with Stop() as stop:
            return _Batch(path, jobs, out, retry, quiet, page, stop).execute(None)
    if jobs is not None:
        raise InputError("--jobs is for a batch without a launcher; here the ranks make the runs")

    def schedule(make_runs: MakeRuns, stop: Stop) -> int:
        return _Batch(path, None, out, retry, quiet, page, stop).execute(make_runs)

    return run_on_ranks(schedule)


class _Batch:
    """One call of `run_batch`, on the process that schedules."""

    def __init__(
        self, path: Path, jobs: int | None, out: Path | None, retry: bool, quiet: bool, page: Page | None, stop: Stop
    ) -> None:
        self.path = path
        self.jobs = jobs
        self.given_out = out
        self.retry = retry
        self.quiet = quiet
        self.page = page
        self.stop = stop
        self.can_draw = page is not None
        self.last_page = time.monotonic()
        self.progress = BatchProgress(not quiet)

    def execute(self, make_runs: MakeRuns | None) -> int:
        """Plan, run, report; the exit code.

        Parameters
        ----------
        make_runs : callable, optional
            Makes the runs elsewhere; by default they are made here.
        """
        with self.progress:
            self.plan: Plan = plan_runs(load_study(self.path), self._checked)
            self.out = self._folder()
            check_runs(self.plan, self._due_runs(), self._checked)
            atomic.make_folder(self.out / "runs")
            with only_batch(self.out / ".lock") as is_alone:
                if not is_alone:
                    raise _fault(self.out, "another batch is working in this folder")
                todo = self._due_runs()
                self._begin(len(todo))
                with closing(self._endings(todo, make_runs)) as endings:
                    for task, ending in endings:
                        self._ended(task, ending)
                self._finish()
        return self._summarise()

    def _checked(self, done: int, total: int) -> None:
        if self.stop.count:
            raise KeyboardInterrupt
        self.progress.checked(done, total)

    def _due_runs(self) -> list[PlannedRun]:
        """Read how the runs stand, and return those that are to be made."""
        self.index = Index(self.plan, self.out)
        return [run for run in self.plan.distinct.values() if self._is_due(self.index.ending(run))]

    def _folder(self) -> Path:
        study = self.plan.study
        if self.given_out is not None:
            folder = self.given_out
        elif study.study.out is not None:
            folder = study.path.parent / study.study.out
        else:
            folder = Path("results") / study.path.stem
        if not (folder / _MANIFEST).exists() and any((folder / name).exists() for name in _OUTPUTS):
            raise _fault(folder, "holds something other than a batch; give another folder with --out")
        return folder

    def _is_due(self, ending: Ending) -> bool:
        if ending.is_finished:
            return False
        # Who was killed from outside did nothing wrong.
        return self.retry or not ending.is_failure or ending.status == "killed"

    def _begin(self, n_todo: int) -> None:
        for place in (self.out, self.out / "runs"):
            atomic.remove_leftovers(place)
        n_distinct = len(self.plan.distinct)
        self.index.write_manifest(self._table().verdicts)
        self.index.write_csv()
        kept = f", {n_distinct - n_todo} of them kept as they are" if n_todo < n_distinct else ""
        self.progress.notice(f"{self.plan.title}: {_count(n_distinct)}{kept}; {self.out}")
        for text in self._repetitions():
            self.progress.notice(f"note: {text}")
        self.progress.start(n_distinct - n_todo, n_distinct)

    def _repetitions(self) -> Iterator[str]:
        first = self.plan.distinct
        for run in self.plan.runs:
            if first[run.name].number != run.number:
                yield f"run {run.number} is the same scene as run {first[run.name].number}; it is made once"

    # -------------------------------------------------------------------------------------------- running

    def _endings(
        self, todo: Sequence[PlannedRun], make_runs: MakeRuns | None
    ) -> Generator[tuple[Task, Ending], None, None]:
        if make_runs is not None:
            yield from make_runs(self._tasks(todo, default_threads()))
            return
        jobs = max(1, min(self.jobs or n_available_cores(), len(todo)))
        chosen = os.environ.get("FEMDEFORM_THREADS", "").strip()
        threads = default_threads() if chosen else max(1, n_available_cores() // jobs)
        yield from run_here(self._tasks(todo, threads), jobs, self.stop)

    def _tasks(self, todo: Sequence[PlannedRun], threads: int) -> list[Task]:
        scene = self.plan.study.scene_path
        return [Task(run.name, scene, run.overrides, self.index.files[run.name], threads) for run in todo]

    def _ended(self, task: Task, ending: Ending) -> None:
        run = self.plan.distinct[task.name]
        self.index.update(task.name, ending)
        self.index.write_csv()
        self.progress.ended(self._line(run, ending), ending.is_failure or ending.status == "expectation_failed")
        if not self.stop.count:
            self._draw(task.name)
            if time.monotonic() > self.last_page + _PAGE_INTERVAL:
                self._write_page()

    # -------------------------------------------------------------------------------------------- showing

    def _draw(self, name: str) -> None:
        """Draw a run that has left something to see; a picture that cannot be drawn is no failure of the batch."""
        files = self.index.files[name]
        is_moving = self.index.ending(self.plan.distinct[name]).status == "running"
        if self.page is None or not self.can_draw or is_moving or files.picture.exists() or not files.facts():
            return
        try:
            self.page.draw(files.folder, files.picture)
        except MissingDependencyError as error:
            self.can_draw = False
            self.progress.notice(f"note: no pictures: {error}")
        except Exception as error:  # whatever a drawing library comes up with, the run itself is all right
            self.progress.notice(f"note: no picture of {files.folder}: {error}")

    def _write_page(self) -> None:
        if self.page is None:
            return
        self.last_page = time.monotonic()
        try:
            self.page.write(self._table())
        except MissingDependencyError as error:
            self.progress.notice(f"note: no page: {error}")

    def _finish(self) -> None:
        if not self.stop.count:
            for name in self.index.files:
                self._draw(name)
        self.index.write_csv()
        self.index.write_manifest(self._table().verdicts)
        self._write_page()

    def _table(self) -> StudyTable:
        """The study as it stands, with what has become of its own `expect`."""
        table = self.index.table()
        verdicts = over_runs_verdicts(self.plan.study.study.expect, self.plan.expected, table)
        return replace(table, verdicts=tuple(verdicts))

    def _summarise(self) -> int:
        """Say how the runs stand; the exit code."""
        runs = [(run, self.index.ending(run)) for run in self.plan.distinct.values()]
        endings = [ending for _, ending in runs]
        code = _exit_code(endings, self.stop.count > 0)
        calm = ("done", "waiting", "interrupted") if code == _INTERRUPTED else ("done",)
        for run, ending in runs:
            if ending.status not in calm:
                reason = f": {ending.reason}" if ending.reason else ""
                print(f"{self._line(run, ending)}{reason}; {self.index.files[run.name].log}", file=sys.stderr)
        counts = Counter(ending.status for ending in endings)
        words = ", ".join(f"{count} {_words(status)}" for status, count in counts.most_common())
        if not (self.quiet and code == 0):
            stream = sys.stdout if code == 0 else sys.stderr
            print(f"{_count(len(endings))}: {words}; {self.out}", file=stream, flush=True)
        if code == _INTERRUPTED:
            print("interrupted; the same command goes on from here", file=sys.stderr, flush=True)
        elif any(ending.is_failure and ending.status != "killed" for ending in endings):
            print("give --retry to make the failed runs again", file=sys.stderr, flush=True)
        return self._judge(code)

    def _judge(self, code: int) -> int:
        """Say what became of the study's own `expect`, if all runs are finished; the exit code."""
        if code not in (0, _EXPECTATION_FAILED):
            return code
        verdicts = self._table().verdicts
        for found in verdicts:
            if not (self.quiet and found["passed"]):
                print(described(found), file=sys.stdout if found["passed"] else sys.stderr, flush=True)
        return code if all(found["passed"] for found in verdicts) else _EXPECTATION_FAILED

    def _line(self, run: PlannedRun, ending: Ending) -> str:
        seconds = f", {ending.seconds:.1f} s" if ending.seconds is not None else ""
        return f"run {run.number} ({self.plan.label(run)}): {_words(ending.status)}{seconds}"


def _count(n_runs: int) -> str:
    return f"{n_runs} run{'' if n_runs == 1 else 's'}"


def _words(status: str) -> str:
    return status.replace("_", " ")


def _exit_code(endings: Sequence[Ending], interrupted: bool) -> int:
    if interrupted and not all(ending.is_finished or ending.is_failure for ending in endings):
        return _INTERRUPTED
    if not all(ending.is_finished for ending in endings):
        return _NOT_CONVERGED
    return _EXPECTATION_FAILED if any(ending.status != "done" for ending in endings) else 0


def _fault(folder: Path, message: str) -> InputError:
    return InputError([Fault(str(folder), 0, "", message)])
