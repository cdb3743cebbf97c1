"""SIGTERM and SIGINT at any moment of a run: exit 130, the result says so, --resume ends as if nothing had happened."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from running import STEPS, Said, assert_same_result, facts, rolling, wait_for_rows, without_seconds
from scenario import write

from femdeform import registry
from femdeform.run import atomic, deformable, inputs, interrupts, recorder, runner, table
from femdeform.run.checkpoint import is_unsaved, read_checkpoint
from solvers.descent import Descent

Say = Callable[..., Said]
Process = subprocess.CompletedProcess[str]
SIGNALS = [signal.SIGTERM, signal.SIGINT]

# What the run is about to do, counted from 1, when the signal comes; the steps that are kept.
# None: nothing was computed yet. STEPS: the run ends as if nothing had come.
MOMENTS = {
    "the first frame": (recorder.Recorder, "frame", 1, None),
    "the first checkpoint": (runner, "write_checkpoint", 1, None),
    "the first step": (Descent, "_direction", 1, 0),
    "a later step": (Descent, "_direction", 40, None),
    "a row": (table, "_append", 60, None),
    "a row of the history": (recorder.Recorder, "step", 6, 6),
    "a frame": (recorder.Recorder, "frame", 3, 6),
    "flushing a frame": (atomic, "_flush_to_disk", 12, None),
    "a checkpoint": (runner, "write_checkpoint", 3, 8),
    "the last step": (recorder.Recorder, "step", STEPS, STEPS),
    "the end": (recorder.Recorder, "finish", 1, STEPS),
}


def striking(monkeypatch: pytest.MonkeyPatch, owner: Any, name: str, count: int, number: signal.Signals) -> None:
    """Send ourselves a signal the moment something is done for the given time."""
    original = getattr(owner, name)
    calls = 0

    def struck(*arguments: Any, **options: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == count:
            os.kill(os.getpid(), number)
        return original(*arguments, **options)

    monkeypatch.setattr(owner, name, struck)


@pytest.mark.parametrize("number", SIGNALS, ids=lambda number: number.name)
@pytest.mark.parametrize("moment", MOMENTS)
def test_at_any_moment(
    moment: str,
    number: signal.Signals,
    unbroken: tuple[Path, Path],
    tmp_path: Path,
    say: Say,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene, whole = unbroken
    owner, name, count, kept = MOMENTS[moment]
    before = [signal.getsignal(each) for each in SIGNALS]
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        striking(patch, owner, name, count, number)
        said = say("run", scene, "--out", out, "--trace", "--quiet")
    assert [signal.getsignal(each) for each in SIGNALS] == before
    result = facts(out)
    if kept == STEPS:
        assert (said.code, result["status"], result["steps"]) == (0, "done", STEPS)
    else:
        assert said.code == 130
        assert said.out == ""
        first, advice = said.err.splitlines()
        assert (result["status"], result["reason"]) == ("interrupted", "interrupted by the user")
        steps = result["steps"]
        assert first.startswith(f"interrupted: {steps} steps to t = ")
        assert steps < STEPS
        if is_unsaved(out):
            assert (steps, advice) == (0, "nothing was computed yet; --resume begins again")
        else:
            assert advice == f"go on with --resume from step {steps}"
            assert read_checkpoint(out).step == steps
            assert (out / "final.vtu").exists()
            assert kept in (None, steps)
    assert not list(out.rglob(".*"))
    said = say("run", scene, "--out", out, "--trace", "--resume", "--quiet")
    assert said.code == 0, said.err
    assert_same_result(whole, out)


@pytest.mark.parametrize("number", SIGNALS, ids=lambda number: number.name)
@pytest.mark.parametrize("place", ["load_scene", "load_meshes", "build_simulation"])
def test_before_there_is_a_result(
    place: str,
    number: signal.Signals,
    unbroken: tuple[Path, Path],
    tmp_path: Path,
    say: Say,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    striking(monkeypatch, deformable if place == "build_simulation" else inputs, place, 1, number)
    said = say("run", unbroken[0], "--out", tmp_path / "out")
    assert (said.code, said.out, said.err) == (130, "", "femdeform: interrupted\n")
    assert not list(tmp_path.rglob("*.*"))


def test_several_signals_are_as_good_as_one(
    unbroken: tuple[Path, Path], tmp_path: Path, say: Say, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Impatience does not spoil what is being saved."""
    scene, whole = unbroken
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        striking(patch, Descent, "_direction", 20, signal.SIGINT)
        striking(patch, recorder.Recorder, "finish", 1, signal.SIGTERM)
        striking(patch, recorder.Recorder, "sync", 3, signal.SIGINT)
        assert say("run", scene, "--out", out, "--trace", "--quiet").code == 130
    assert facts(out)["status"] == "interrupted"
    assert say("run", scene, "--out", out, "--trace", "--resume").code == 0
    assert_same_result(whole, out)


def test_after_a_failed_attempt(tmp_path: Path, say: Say, monkeypatch: pytest.MonkeyPatch) -> None:
    """The step in use comes back as it was: not as it is in the middle of the next attempt."""
    data = rolling(steps=8)
    data["solver"] = {"max_iterations": 4}
    data["on_failure"] = {"action": "halve_dt", "min_dt": 1.0e-5}
    scene = write(data, tmp_path / "s.yaml")
    whole = tmp_path / "whole"
    assert say("run", scene, "--out", whole, "--trace", "--quiet").code == 0
    failed = [int(row["failed_attempts"]) for row in without_seconds(whole / "history.csv")]
    assert sum(failed) > 2
    for count in (3, 9, 17, 28):  # within the first steps of the smaller size too
        out = tmp_path / f"out{count}"
        with monkeypatch.context() as patch:
            striking(patch, Descent, "_direction", count, signal.SIGTERM)
            assert say("run", scene, "--out", out, "--trace", "--quiet").code == 130
        assert say("run", scene, "--out", out, "--trace", "--resume", "--quiet").code == 0
        assert_same_result(whole, out)


def test_ignored_signals_stay_ignored(
    unbroken: tuple[Path, Path], tmp_path: Path, say: Say, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run that was started in the background with SIGINT ignored does not end by it."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        striking(monkeypatch, Descent, "_direction", 20, signal.SIGINT)
        assert say("run", unbroken[0], "--out", tmp_path / "out", "--quiet").code == 0
    finally:
        signal.signal(signal.SIGINT, before)


# ------------------------------------------------------------------------------------------- processes


@pytest.mark.parametrize("number", SIGNALS, ids=lambda number: number.name)
def test_a_process(
    number: signal.Signals,
    unbroken_process: tuple[Path, Path],
    tmp_path: Path,
    cli: Callable[..., Process],
    start: Callable[..., subprocess.Popen[str]],
) -> None:
    """From outside, whatever the run is at."""
    scene, whole = unbroken_process
    process = start("run", scene, "--out", "out", "--trace")
    wait_for_rows(tmp_path / "out" / "history.csv", random.randint(1, 15), process)
    process.send_signal(number)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 130, error
    result = facts(tmp_path / "out")
    assert result["status"] == "interrupted"
    assert result["steps"] == read_checkpoint(tmp_path / "out").step
    assert f"go on with --resume from step {result['steps']}" in error
    assert "Traceback" not in error
    assert cli("run", scene, "--out", "out", "--resume", "--trace").returncode == 0
    assert_same_result(whole, tmp_path / "out")


DEAF = """\
import hashlib, sys
from femdeform import cli
from femdeform.run import inputs, interrupts, runner
from femdeform.run.recorder import Recorder

def deaf(*_):
    print("deaf", flush=True)
    hashlib.pbkdf2_hmac("sha256", b"", b"", 10**9)  # a library that is busy: Python's signal handlers have to wait
    return original(*_)

original = PLACE
PLACE = deaf
interrupts.answered_in_time.__wrapped__.__defaults__ = (0.2,)
sys.exit(cli.main(["run", "s.yaml", "--out", "out", "--trace"]))
"""


@pytest.mark.parametrize("number", SIGNALS, ids=lambda number: number.name)
@pytest.mark.parametrize("place", ["inputs.load_meshes", "Recorder.iteration"])
def test_a_library_that_does_not_listen(
    place: str, number: signal.Signals, tmp_path: Path, start_python: Callable[..., subprocess.Popen[str]]
) -> None:
    """In the middle of meshing or of a factorisation: the process ends soon all the same."""
    write(rolling(steps=4), tmp_path / "s.yaml")
    (tmp_path / "deaf.py").write_text(DEAF.replace("PLACE", place))
    process = start_python("deaf.py")
    assert process.stdout is not None
    while "deaf" not in process.stdout.readline():
        assert process.poll() is None, process.communicate()
    time.sleep(0.5)  # from the last line of Python into the library
    sent = time.monotonic()
    process.send_signal(number)
    _, error = process.communicate(timeout=30)
    assert time.monotonic() - sent < 20.0
    assert process.returncode == 130
    assert error.endswith("femdeform: interrupted\n")
    assert "Traceback" not in error
    if place == "inputs.load_meshes":
        assert not (tmp_path / "out").exists()
    else:
        assert facts(tmp_path / "out")["status"] == "interrupted"
        assert read_checkpoint(tmp_path / "out").step == 0


LATE = """\
import os, signal, time
from femdeform.run.interrupts import Interrupts, answered_in_time

def late(*given, read=os.read):
    byte = read(*given)
    time.sleep(0.3)  # a machine that is busy
    return byte

os.read = late
with answered_in_time(patience=0.1):
    try:
        with Interrupts():
            os.kill(os.getpid(), NUMBER)
            time.sleep(1.0)
    except KeyboardInterrupt:
        print("heard", flush=True)
with answered_in_time(patience=0.1):
    time.sleep(1.5)
"""


@pytest.mark.parametrize("number", SIGNALS, ids=lambda number: number.name)
def test_a_watcher_that_wakes_up_late(
    number: signal.Signals, tmp_path: Path, start_python: Callable[..., subprocess.Popen[str]]
) -> None:
    """A signal that was heard ends nothing, though the next command of the process has begun by then."""
    (tmp_path / "late.py").write_text(LATE.replace("NUMBER", str(int(number))))
    process = start_python("late.py")
    said, error = process.communicate(timeout=60)
    assert (process.returncode, said) == (0, "heard\n"), error


def test_meshing_alone(monkeypatch: pytest.MonkeyPatch, say: Say) -> None:
    def command(*_: Any) -> str:
        os.kill(os.getpid(), signal.SIGTERM)
        return "never said"

    monkeypatch.setattr(registry, "resolve", lambda _: command)
    said = say("mesh", "block")
    assert (said.code, said.out, said.err) == (130, "", "femdeform: interrupted\n")


def test_held_signals_come_at_the_end_of_the_block() -> None:
    done = []

    def work() -> None:
        with interrupts.Interrupts() as these:
            with these.held(), these.held():
                os.kill(os.getpid(), signal.SIGTERM)
                done.append("inner")
            done.append("never")

    with pytest.raises(KeyboardInterrupt):
        work()
    assert done == ["inner"]
    with interrupts.Interrupts() as these:
        told = []
        these.hold(lambda: told.append("come"))
        os.kill(os.getpid(), signal.SIGINT)
        assert these.is_pending
    assert told == ["come"]
