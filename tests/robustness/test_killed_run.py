"""Killed without warning at any moment: the folder can be read, and --resume ends as if nothing had happened."""

from __future__ import annotations

import random
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from running import assert_same_result, contents, facts, rolling, wait_for_rows, without_seconds
from scenario import write

from femdeform.errors import InputError
from femdeform.run import runner
from femdeform.run.checkpoint import read_checkpoint
from femdeform.run.result import Result
from femdeform.run.runner import run_scene

Process = subprocess.CompletedProcess[str]

KILLED = """\
import os, signal, sys
from femdeform import cli
from femdeform.run import atomic, recorder, runner, table

original = PLACE
calls = 0

def killed(*arguments, **options):
    global calls
    calls += 1
    if calls == COUNT:
        BEFORE
        os.kill(os.getpid(), signal.SIGKILL)
    return original(*arguments, **options)

PLACE = killed
sys.exit(cli.main(["run", sys.argv[1], "--out", "out", "--trace", "--quiet"]))
"""
# The last one dies with half of a checkpoint written.
HALF = "data = arguments[1]; arguments[0].with_name('.checkpoint-00.part.h5').write_bytes(data[:len(data) // 2])"
MOMENTS = {
    "the first frame": ("recorder.Recorder.frame", 1, "pass"),
    "a row": ("table._append", 40, "pass"),
    "half a row": ("table._append", 33, "os.write(arguments[0].fileno(), arguments[1][:50])"),
    "between frame and list": ("recorder.write_pvd", 4, "pass"),
    "flushing": ("atomic._flush_to_disk", 14, "pass"),
    "half a checkpoint": ("atomic.write_bytes", 7, HALF),
}


@pytest.mark.parametrize("moment", MOMENTS)
def test_at_any_moment(
    moment: str,
    unbroken_process: tuple[Path, Path],
    tmp_path: Path,
    python: Callable[..., Process],
    cli: Callable[..., Process],
) -> None:
    scene, whole = unbroken_process
    place, count, before = MOMENTS[moment]
    script = KILLED.replace("PLACE", place).replace("COUNT", str(count)).replace("BEFORE", before)
    (tmp_path / "killed.py").write_text(script)
    done = python("killed.py", scene)
    assert done.returncode == -signal.SIGKILL
    out = tmp_path / "out"
    result = Result.open(out)
    assert result.facts["status"] == "running"
    if moment != "the first frame":
        # Never half a checkpoint under its name, and the tables go at least as far.
        assert read_checkpoint(out).step <= len(result.history["step"])
        assert result.read_frame(-1).displacement.shape[1] == 3
    resumed = cli("run", scene, "--out", "out", "--trace", "--quiet", "--resume")
    assert (resumed.returncode, resumed.stderr) == (0, "")
    assert_same_result(whole, out)


@pytest.mark.parametrize(
    "linear_solver",
    [
        pytest.param({"method": "ksp"}, id="mumps", marks=pytest.mark.petsc),
        pytest.param({"method": "ksp", "preset": "newton-gamg"}, id="gamg", marks=pytest.mark.petsc),
    ],
)
def test_twice_at_random_moments(
    linear_solver: dict[str, Any], tmp_path: Path, cli: Callable[..., Process], start: Callable[..., Any]
) -> None:
    """PETSc's solvers remember their last matrices; a resumed run is the same to the bit nevertheless."""
    write(rolling(linear_solver), tmp_path / "s.yaml")
    arguments = ("run", "s.yaml", "--trace", "--quiet", "--out")
    unbroken = cli(*arguments, "whole")
    assert unbroken.returncode == 0, unbroken.stderr
    for first, last, more in ((1, 10, ()), (14, 22, ("--resume",))):
        process = start(*arguments, "broken", *more)
        wait_for_rows(tmp_path / "broken" / "history.csv", random.randint(first, last), process)
        time.sleep(random.uniform(0.0, 0.03))
        process.kill()
        assert process.wait() == -signal.SIGKILL
        assert facts(tmp_path / "broken")["status"] == "running"
    resumed = cli(*arguments, "broken", "--resume")
    assert resumed.returncode == 0, resumed.stderr
    assert_same_result(tmp_path / "whole", tmp_path / "broken")
    assert facts(tmp_path / "broken")["status"] == "done"
    assert len(without_seconds(tmp_path / "broken" / "history.csv")) == 40


def test_a_killed_start_begins_again(unbroken: tuple[Path, Path], tmp_path: Path, monkeypatch: Any) -> None:
    """Ended after the folder was made and before the first checkpoint: --resume is what the folder asks for."""

    class KilledError(BaseException):
        pass

    def killed(*_: Any) -> None:
        raise KilledError

    scene, whole = unbroken
    with monkeypatch.context() as patch:
        patch.setattr(runner, "write_checkpoint", killed)
        with pytest.raises(KilledError):
            run_scene(scene, out=tmp_path / "out", trace=True)
    assert facts(tmp_path / "out")["status"] == "running"
    with pytest.raises(InputError, match="give --resume"):
        run_scene(scene, out=tmp_path / "out")
    assert run_scene(scene, out=tmp_path / "out", resume=True, trace=True) == 0
    assert_same_result(whole, tmp_path / "out")


def test_a_finished_run_is_left_as_it_is(unbroken: tuple[Path, Path]) -> None:
    scene, whole = unbroken
    before = contents(whole)
    assert run_scene(scene, out=whole, resume=True) == 0
    assert contents(whole) == before
