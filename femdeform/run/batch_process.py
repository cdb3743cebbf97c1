"""Runs of a study as processes of their own: a crash of one leaves the others, and the batch, alone."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import IO

from femdeform.run import atomic
from femdeform.run.batch_record import Ending, RunFiles, judge

# Seconds that runs get to write a checkpoint once they are asked to end.
GRACE = 60.0
_SHORT_GRACE = 5.0
_POLL = 0.05
# What the launchers of MPI leave in the environment; a process that inherits it takes itself for one of their ranks.
_LAUNCHER = ("OMPI_", "PMIX_", "PMI_", "PRTE_", "ORTE_", "HYDRA_", "HYDI_", "MPI_LOCAL", "MPIR_", "MV2_COMM_")
_BUSY = "a process that an earlier batch left is still at it; wait for it, or end it"


@dataclass(frozen=True)
class Task:
    """One run to be made.

    Attributes
    ----------
    name : str
        Name of its folder.
    scene : Path
        Scene file.
    overrides : tuple of str
        Each ``key=value``.
    files : RunFiles
        Where it writes.
    threads : int
        Threads of its kernels.
    """

    name: str
    scene: Path
    overrides: tuple[str, ...]
    files: RunFiles
    threads: int

    def command(self, resume: bool) -> list[str]:
        """Command line of the run."""
        settings = [part for text in self.overrides for part in ("--set", text)]
        return [
            *(sys.executable, "-m", "femdeform", "run", str(self.scene), "--out", str(self.files.folder)),
            *settings,
            *("--threads", str(self.threads), "--quiet"),
            *(["--resume"] if resume else []),
        ]


def serial_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """An environment without what a launcher of MPI left in it: processes started with it are serial runs."""
    return {name: value for name, value in environment.items() if not name.startswith(_LAUNCHER)}


class Stop:
    """Hears SIGINT, SIGTERM and SIGHUP; a second signal means that there is no time to be polite.

    Used as a context manager in the main thread; while it is active the signals do nothing but count.
    """

    def __init__(self) -> None:
        self.count = 0
        self._handlers: dict[signal.Signals, object] = {}

    def __enter__(self) -> Stop:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            # What the parent process had decided to ignore (nohup) stays ignored.
            if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:
                self._handlers[number] = signal.signal(number, self._hear)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._handlers.items():
            signal.signal(number, handler)  # type: ignore[arg-type]

    def _hear(self, number: int, frame: FrameType | None) -> None:
        self.count += 1


class _Child:
    """A run's process, from its start to its ending."""

    def __init__(self, task: Task) -> None:
        self.task = task
        self._begin = time.perf_counter()
        self._process: subprocess.Popen[bytes] | None = None
        self._asked = 0.0
        self._earlier = 0.0
        self.ending: Ending | None = None
        with atomic.writing(task.files.log):
            self._start()

    def _start(self) -> None:
        task, files = self.task, self.task.files
        before = files.ending()
        with files.log.open("ab") as log:
            if not _lock(log):
                self.ending = Ending("running", _BUSY)
                return
            resume = before.status in ("interrupted", "killed") and files.can_go_on()
            if resume:
                self._earlier = before.seconds or 0.0
            else:
                log.truncate(0)
                if files.folder.exists():
                    shutil.rmtree(files.folder)
            files.record.unlink(missing_ok=True)
            files.picture.unlink(missing_ok=True)
            # In a session of its own a run hears of Ctrl-C from us only, and only once. The lock of its log lasts
            # as long as the process does, even if that outlives this one.
            try:
                self._process = subprocess.Popen(
                    task.command(resume),
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=log,
                    env=serial_environment(os.environ),
                    start_new_session=True,
                )
            except OSError as error:
                self.ending = Ending("failed", f"the process cannot be started: {error.strerror or error}")

    def poll(self, stop: Stop) -> Ending | None:
        """How it ended; None while it is alive. Passes on that the batch is to stop."""
        if self._process is None:
            return self.ending
        code = self._process.poll()
        if code is None:
            self._pass_on(stop)
            return None
        seconds = self._earlier + time.perf_counter() - self._begin
        ending = judge(code, self.task.files.facts(), self.task.files.log, seconds)
        if self._asked and ending.status == "killed":
            ending = Ending("interrupted", ending.reason, code, seconds)
        self._process = None
        self.ending = ending
        self.task.files.write_record(ending)
        return ending

    def _pass_on(self, stop: Stop) -> None:
        assert self._process is not None
        if stop.count and not self._asked:
            self._asked = time.monotonic()
            self._process.terminate()
        elif self._asked and (stop.count > 1 or time.monotonic() > self._asked + GRACE):
            self._process.kill()

    def abandon(self) -> None:
        """End it, for a batch that cannot go on."""
        if self._process is not None:
            self._process.terminate()
            try:
                self._process.wait(_SHORT_GRACE)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()


def _lock(file: IO[bytes]) -> bool:
    """Lock an open file until the last process that has it open ends; False if another one holds the lock."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        # Some file systems know no locks; then nobody is protected from himself.
        return error.errno not in (errno.EAGAIN, errno.EACCES)
    return True


@contextlib.contextmanager
def only_batch(path: Path) -> Iterator[bool]:
    """Hold a lock file; yields False if another batch holds it."""
    with atomic.writing(path), path.open("ab") as file:
        yield _lock(file)


def run_one(task: Task, stop: Stop) -> Ending:
    """Make one run and wait for its end; asked to stop, it leaves a run that goes on later."""
    if stop.count:
        return task.files.ending()
    child = _Child(task)
    try:
        while (ending := child.poll(stop)) is None:
            time.sleep(_POLL)
    finally:
        child.abandon()
    return ending


def run_here(tasks: Sequence[Task], jobs: int, stop: Stop) -> Iterator[tuple[Task, Ending]]:
    """Make runs on this computer, some at a time.

    Parameters
    ----------
    tasks : sequence of Task
        The runs, in the order in which they start.
    jobs : int
        How many at a time.
    stop : Stop
        Tells when no more are to start and those alive are to end.

    Yields
    ------
    (Task, Ending)
        Each run that was started, in the order of their ends.
    """
    waiting = deque(tasks)
    alive: list[_Child] = []
    try:
        while True:
            ended = [child for child in alive if child.poll(stop) is not None]
            alive = [child for child in alive if child not in ended]
            # The next ones work while the caller looks at those that ended.
            while waiting and len(alive) < jobs and not stop.count:
                alive.append(_Child(waiting.popleft()))
            for child in ended:
                assert child.ending is not None
                yield child.task, child.ending
            if not alive:
                return
            if not ended:
                time.sleep(_POLL)
    finally:
        for child in alive:
            child.abandon()
