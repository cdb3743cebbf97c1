"""Every case runs in a process of its own: its peak memory is its own, and a crash costs one row, not the table."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from femdeform.run.interrupts import signals_held

_PATIENCE = 1200.0


@dataclass(frozen=True)
class Outcome:
    """What became of a case.

    Attributes
    ----------
    status : str
        ``done``, ``skipped`` or ``failed``.
    data : dict
        What the case measured; empty unless done.
    reason : str
        Why it was skipped or failed, one line.
    """

    status: str
    data: dict[str, Any]
    reason: str = ""

    @property
    def done(self) -> bool:
        """Whether there is something to show."""
        return self.status == "done"

    def as_data(self) -> dict[str, Any]:
        """All of it as plain data."""
        reason = {"reason": self.reason} if self.reason else {}
        return {"status": self.status, **reason, **self.data}


def skipped(reason: str) -> Outcome:
    """Return the outcome of a case that was not run."""
    return Outcome("skipped", {}, reason)


def run_module(module: str, case: Mapping[str, Any], threads: int, launcher: Sequence[str] = ()) -> Outcome:
    """Run ``python -m module CASE RESULT``, which reads a JSON file and writes another.

    Parameters
    ----------
    module : str
        Module to run.
    case : mapping
        What to measure.
    threads : int
        Threads of the kernels and of the BLAS.
    launcher : sequence of str
        Words before the command, such as ``mpiexec -n 2``.
    """
    # What this process exported for its own kernels is not meant for the child's.
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_NUM_THREADS"}
    environment |= {"FEMDEFORM_THREADS": str(threads), "OPENBLAS_NUM_THREADS": str(threads)}
    if launcher:
        # Open MPI asks for this consent where the user is root, as in containers.
        environment |= {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    return _run([*launcher, sys.executable, "-m", module], case, environment)


def run_script(python: Path, script: Path, case: Mapping[str, Any]) -> Outcome:
    """Run a script by the Python of another environment; it reads a JSON file and writes another."""
    hidden = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV", "NUMBA_NUM_THREADS")
    environment = {name: value for name, value in os.environ.items() if name not in hidden}
    return _run([str(python), str(script)], case, environment)


def _run(command: list[str], case: Mapping[str, Any], environment: dict[str, str]) -> Outcome:
    with ExitStack() as stack:
        # A signal between the start of a process and the moment its end is arranged for would leave it behind.
        with signals_held():
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="femdeform-bench-"))
            case_file, result_file = Path(folder, "case.json"), Path(folder, "result.json")
            case_file.write_text(json.dumps(dict(case)), encoding="utf-8")
            try:
                # A session of its own, so that a case that takes too long goes with all the processes it started.
                process = subprocess.Popen(
                    [*command, str(case_file), str(result_file)],
                    env=environment,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.PIPE,
                    text=True,
                    errors="replace",
                    start_new_session=True,
                )
            except OSError as error:
                return Outcome("failed", {}, f"cannot be started: {error}")
            stack.callback(_end, process)
        try:
            _, complaint = process.communicate(timeout=_PATIENCE)
        except subprocess.TimeoutExpired:
            return Outcome("failed", {}, f"took more than {_PATIENCE:.0f} s")
        if process.returncode != 0 or not result_file.is_file():
            return Outcome("failed", {}, _last_line(complaint) or f"ended with code {process.returncode}")
        try:
            answer = json.loads(result_file.read_text(encoding="utf-8"))
        except ValueError as error:
            return Outcome("failed", {}, f"its result cannot be read: {error}")
    if "skipped" in answer:
        return skipped(answer["skipped"])
    return Outcome("done", answer)


def _end(process: subprocess.Popen[str]) -> None:
    """End a process and all it has started, if it has not ended by itself."""
    if process.poll() is not None:
        return
    os.killpg(process.pid, signal.SIGTERM)
    try:
        process.communicate(timeout=10.0)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()


def _last_line(text: str) -> str:
    """The last line of a complaint that says something; launchers and PETSc frame theirs with rulers."""
    lines = [line.strip() for line in text.splitlines()]
    telling = [line for line in lines if any(ch.isalnum() for ch in line) and "MPI_ABORT" not in line]
    errors = [line for line in telling if "Error" in line or "ERROR" in line or "femdeform" in line]
    return (errors or telling or [""])[-1][:300]


def read_case() -> dict[str, Any]:
    """In the child: the case it was given on its command line."""
    case: dict[str, Any] = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    return case


def write_result(data: Mapping[str, Any]) -> None:
    """In the child: hand the result back."""
    Path(sys.argv[2]).write_text(json.dumps(dict(data)), encoding="utf-8")


def serve(kinds: Mapping[str, Callable[[dict[str, Any]], dict[str, Any]]]) -> None:
    """In the child: do what the case's ``kind`` says and hand the result of the first rank back."""
    from femdeform import parallel

    comm = parallel.world()
    case = read_case()
    try:
        result = kinds[case["kind"]](case)
    except BaseException:
        if comm is None:
            raise
        import traceback

        traceback.print_exc()
        comm.Abort(1)
        raise
    if comm is None or comm.Get_rank() == 0:
        write_result(result)
