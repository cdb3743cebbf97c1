"""What nobody expected: a bug of ours is shown whole, once, with exit code 70; no memory is not a bug. Results stay."""

from __future__ import annotations

import errno
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from running import Said, assert_same_result, expecting, facts, rolling
from scenario import write

from femdeform import cli
from femdeform.run import deformable, inputs, output
from femdeform.run.checkpoint import read_checkpoint
from femdeform.run.failure import BUG, MemoryExhaustedError, exit_code, expected_error, reason_of
from solvers.linear import coo
from solvers.projected_newton import ProjectedNewton

Say = Callable[..., Said]
NOTE = "femdeform: this is a bug in femdeform, not in your scene; please report it with the lines above\n"


def bug(*_: Any, **__: Any) -> None:
    raise ZeroDivisionError("division by a bug")


def hunger(*_: Any, **__: Any) -> None:
    np.empty(2**55)


def failing_step(monkeypatch: pytest.MonkeyPatch, count: int, failure: Callable[..., None]) -> None:
    original = ProjectedNewton.step
    calls = 0

    def step(self: ProjectedNewton, *arguments: Any, **options: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == count:
            failure()
        return original(self, *arguments, **options)

    monkeypatch.setattr(ProjectedNewton, "step", step)


def test_a_bug_in_a_step(
    unbroken: tuple[Path, Path], tmp_path: Path, say: Say, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, whole = unbroken
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        failing_step(patch, 7, bug)
        said = say("run", scene, "--out", out, "--trace")
    assert (said.code, said.out) == (70, "")
    assert said.err.count("Traceback (most recent call last)") == 1
    assert said.err.endswith("ZeroDivisionError: division by a bug\n" + NOTE)
    result = facts(out)
    assert (result["status"], result["steps"]) == ("failed", 6)
    assert result["reason"] == "ZeroDivisionError: division by a bug"
    assert (out / "final.vtu").exists()
    assert read_checkpoint(out).step == 4
    assert say("run", scene, "--out", out, "--trace", "--resume").code == 0
    assert_same_result(whole, out)


def test_a_bug_that_spoils_the_last_words_too(
    unbroken: tuple[Path, Path], tmp_path: Path, say: Say, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, whole = unbroken
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        failing_step(patch, 7, lambda: patch.setattr(output.FrameSource, "cell_data", bug))
        said = say("run", scene, "--out", out, "--trace")
    assert said.code == 70
    # The one that made the run fail is shown, and not as the cause of what followed from it.
    assert said.err.count("Traceback") == 1
    result = facts(out)
    assert (result["status"], result["reason"]) == ("failed", "ZeroDivisionError: division by a bug")
    assert result["steps"] == 9  # every third step has a frame
    assert say("run", scene, "--out", out, "--trace", "--resume").code == 0
    assert_same_result(whole, out)


@pytest.mark.parametrize("place", ["load_meshes", "build_simulation"])
def test_a_bug_before_there_is_a_result(
    place: str, unbroken: tuple[Path, Path], tmp_path: Path, say: Say, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(inputs if place == "load_meshes" else deformable, place, bug)
    said = say("run", unbroken[0], "--out", tmp_path / "out")
    assert said.code == 70
    assert said.err.count("Traceback") == 1
    assert said.err.endswith(NOTE)
    assert not list(tmp_path.rglob("*.*"))


def test_a_bug_in_any_command(say: Say, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cli, "_info", bug)
    said = say("info")
    assert (said.code, said.out) == (70, "")
    assert said.err.count("Traceback") == 1
    assert said.err.endswith(NOTE)


def test_no_memory_in_a_step(
    unbroken: tuple[Path, Path], tmp_path: Path, say: Say, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, whole = unbroken
    out = tmp_path / "out"
    with monkeypatch.context() as patch:
        failing_step(patch, 7, hunger)
        said = say("run", scene, "--out", out, "--trace")
    assert (said.code, said.out) == (4, "")
    assert said.err.startswith("femdeform: out of memory (Unable to allocate 256. PiB")
    assert said.err.endswith("): take a coarser mesh, or more computers\n")
    assert said.err.count("\n") == 1
    result = facts(out)
    assert (result["status"], result["steps"]) == ("failed", 6)
    assert f"femdeform: {result['reason']}\n" == said.err
    assert say("run", scene, "--out", out, "--trace", "--resume").code == 0
    assert_same_result(whole, out)


@pytest.mark.petsc
def test_no_memory_in_petsc(tmp_path: Path, say: Say, monkeypatch: pytest.MonkeyPatch) -> None:
    from petsc4py import PETSc

    def hungry(*_: Any) -> None:
        raise PETSc.Error(55)

    monkeypatch.setattr(coo, "preallocate", hungry)
    scene = write(rolling({"method": "ksp"}, steps=2), tmp_path / "s.yaml")
    said = say("run", scene, "--out", tmp_path / "out", "--quiet")
    assert (said.code, said.err) == (4, "femdeform: out of memory (PETSc): take a coarser mesh, or more computers\n")
    assert facts(tmp_path / "out")["status"] == "failed"


def test_no_memory_for_the_mesh(unbroken: tuple[Path, Path], tmp_path: Path, say: Say) -> None:
    """Refused with the line of the scene that asks for it."""
    cells = [2000000, 2000, 2000]
    said = say("run", unbroken[0], "--out", tmp_path / "out", "--set", f"bodies.b.mesh.cells={cells}")
    assert said.code == 2
    assert said.err.count("\n") == 1
    assert "bodies.b.mesh" in said.err
    assert not (tmp_path / "out").exists()


def test_what_is_a_bug_and_what_is_not() -> None:
    full = OSError(errno.ENOSPC, "No space left on device")
    assert str(expected_error(full)) == (
        "cannot write a temporary file or the cache of compiled code: the disk is full"
    )
    named = OSError(errno.ENOSPC, "No space left on device", "/far/away")
    assert str(expected_error(named)) == "cannot write /far/away: the disk is full"
    assert exit_code(full) == 4
    assert isinstance(expected_error(MemoryError()), MemoryExhaustedError)
    assert reason_of(MemoryError()) == "out of memory: take a coarser mesh, or more computers"
    for error in (FileNotFoundError(errno.ENOENT, "No such file"), KeyError("x"), RecursionError("too deep")):
        assert expected_error(error) is None
        assert exit_code(error) == BUG == 70
    assert reason_of(KeyError("x")) == "KeyError: 'x'"
    assert reason_of(ValueError("\n first\nsecond")) == "ValueError: first"
    assert reason_of(ValueError()) == "ValueError"


@pytest.mark.petsc
def test_an_error_on_the_way_is_recorded(tmp_path: Path, say: Say) -> None:
    """PETSc tells after the first solve which options it knows; the result must not say that the run goes on."""
    options = {"method": "ksp", "options": {"ksp_rtoll": 1e-3}}
    path = write({**expecting(), "linear_solver": options}, tmp_path / "s.yaml")
    said = say("run", path, "--out", tmp_path / "out")
    assert said.code == 2
    assert "linear_solver.options.ksp_rtoll: PETSc did not use this option" in said.err
    result = facts(tmp_path / "out")
    assert result["status"] == "failed"
    assert "PETSc did not use this option" in result["reason"]
    assert result["steps"] == 0
    assert (tmp_path / "out" / "final.vtu").exists()
