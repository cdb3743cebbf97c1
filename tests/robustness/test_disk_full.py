"""The disk is full, at any moment of a run: exit 4, one line, all that was written stays, --resume goes on from it."""

from __future__ import annotations

import resource
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from running import STEPS, Said, assert_same_result, facts, rolling
from scenario import write
from small_disk import Disk

from femdeform.errors import OutputError
from femdeform.run import atomic, recorder, runner, table
from femdeform.run.checkpoint import read_checkpoint
from femdeform.run.result import Result

Say = Callable[..., Said]

# What is about to be written, counted from 1, when the disk fills up; the file the message names; steps until then.
MOMENTS = {
    "scene": (atomic, "write_bytes", 2, "resolved.yaml", None),
    "first frame": (recorder.Recorder, "frame", 1, "frames/frame_00000.vtu", None),
    "first checkpoint": (runner, "write_checkpoint", 1, "checkpoint.h5", None),
    "first row": (table, "_append", 1, "iterations.csv", None),
    "frame": (recorder.Recorder, "frame", 3, "frames/frame_00002.vtu", 6),
    "list of frames": (recorder, "write_pvd", 4, "frames.pvd", 9),
    "checkpoint": (runner, "write_checkpoint", 3, "checkpoint.h5", 8),
    "end": (recorder.Recorder, "finish", 1, "final.vtu", STEPS),
}


@pytest.mark.parametrize("moment", MOMENTS)
def test_at_any_moment(
    moment: str, unbroken: tuple[Path, Path], disk: Disk, say: Say, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, whole = unbroken
    owner, name, count, file, steps = MOMENTS[moment]
    original = getattr(owner, name)
    calls = 0

    def filling(*arguments: Any, **options: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls == count:
            disk.fill()
        return original(*arguments, **options)

    out = disk.folder / "out"
    with monkeypatch.context() as patch:
        patch.setattr(owner, name, filling)
        said = say("run", scene, "--out", out, "--trace", "--quiet")
    assert (said.code, said.out, said.err) == (4, "", f"femdeform: cannot write {out / file}: the disk is full\n")
    result = Result.open(out)
    assert result.facts["status"] == "failed"
    assert result.facts["reason"] == f"cannot write {out / file}: the disk is full"
    if steps is not None:
        assert result.facts["steps"] == steps
        assert list(result.history["step"]) == list(range(1, steps + 1))
        assert read_checkpoint(out).step <= steps
        assert result.frames
        assert all(result.read_frame(i).displacement.shape[1] == 3 for i in range(len(result.frames)))
    # Nothing half-written lies about.
    assert not list(out.rglob("*.part*"))

    disk.make_room()
    said = say("run", scene, "--out", out, "--trace", "--resume")
    assert said.code == 0, said.err
    assert_same_result(whole, out)


def test_no_room_for_anything(unbroken: tuple[Path, Path], disk: Disk, say: Say) -> None:
    scene, whole = unbroken
    out = disk.folder / "out"
    disk.fill()
    said = say("run", scene, "--out", out, "--trace", "--quiet")
    assert said.code == 4
    assert said.err.startswith(f"femdeform: cannot write {out}")
    assert said.err.endswith(": the disk is full\n")
    assert said.err.count("\n") == 1
    disk.make_room()
    assert say("run", scene, "--out", out, "--trace", "--quiet").code == 0
    assert_same_result(whole, out)


@pytest.mark.parametrize("size", ["96k"])
def test_a_small_disk(
    size: str, unbroken_process: tuple[Path, Path], tmp_path: Path, disk: Disk, cli: Callable[..., Any]
) -> None:
    """As a process, wherever the room ends."""
    scene, whole = unbroken_process
    disk.resize(size)
    done = cli("run", scene, "--out", "disk/out", "--trace")
    assert done.returncode == 4
    assert done.stderr.startswith("femdeform: cannot write disk/out/")
    assert done.stderr.endswith(": the disk is full\n")
    assert done.stderr.count("\n") == 1
    assert facts(tmp_path / "disk" / "out")["status"] == "failed"
    disk.resize("4m")
    done = cli("run", scene, "--out", "disk/out", "--trace", "--resume")
    assert done.returncode == 0, done.stderr
    assert_same_result(whole, tmp_path / "disk" / "out")


def test_files_that_may_grow_no_further(
    unbroken_process: tuple[Path, Path], tmp_path: Path, cli: Callable[..., Any]
) -> None:
    """The same without the right to mount: the system refuses to let files grow beyond a limit."""
    scene, whole = unbroken_process
    limit = 12000  # more than a frame and a checkpoint, less than the table of all iterations
    done = cli(
        *("run", scene, "--out", "out", "--trace"),
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
    )
    assert done.returncode == 4
    message = "cannot write out/iterations.csv: the file would be larger than allowed here"
    assert done.stderr == f"femdeform: {message}\n"
    result = Result.open(tmp_path / "out")
    assert result.facts["status"] == "failed"
    assert result.facts["reason"] == message
    steps = result.facts["steps"]
    assert 5 < steps < 40
    assert list(result.history["step"]) == list(range(1, steps + 1))
    assert steps - 4 <= read_checkpoint(tmp_path / "out").step <= steps
    # Only whole rows, and none beyond the limit.
    assert result.iterations is not None
    assert (tmp_path / "out" / "iterations.csv").read_bytes().endswith(b"\n")
    done = cli("run", scene, "--out", "out", "--trace", "--resume")
    assert done.returncode == 0, done.stderr
    assert_same_result(whole, tmp_path / "out")


def test_a_row_is_written_as_a_whole_or_not_at_all(disk: Disk) -> None:
    path = disk.folder / "history.csv"
    rows = table.Table(path, ("step",))
    rows.append({"step": 1, "note": "short"})
    disk.fill()
    before = path.read_bytes()
    # Part of it fits into what is left of the file's last page.
    with pytest.raises(OutputError, match=r"cannot write .*history\.csv: the disk is full"):
        rows.append({"step": 2, "note": "x" * 10000})
    assert path.read_bytes() == before
    disk.make_room()
    rows.append({"step": 2, "note": "y" * 10000})
    rows.close()
    assert list(table.read_table(path)["step"]) == [1, 2]


needs_dev_full = pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")


@needs_dev_full
def test_a_table_that_cannot_grow(tmp_path: Path) -> None:
    rows = table.Table(tmp_path / "history.csv", ("step",))
    # Only now: to read it would never end.
    (tmp_path / "history.csv").symlink_to("/dev/full")
    with pytest.raises(OutputError, match=r"cannot write .*history\.csv: the disk is full"):
        rows.append({"step": 1})
    rows.close()


@needs_dev_full
@pytest.mark.parametrize("arguments", [["schema"], ["run", "s.yaml"]], ids=" ".join)
def test_the_output_goes_to_a_full_disk(arguments: list[str], tmp_path: Path, cli: Callable[..., Any]) -> None:
    """A result is not spoiled by what is said about it."""
    write(rolling(steps=2), tmp_path / "s.yaml")
    with Path("/dev/full").open("w") as full:
        done = cli(*arguments, stdout=full)
    assert done.returncode == 4
    assert done.stderr == "femdeform: cannot write to the standard output: the disk is full\n"
    if arguments[0] == "run":
        assert facts(tmp_path / "results" / "s")["status"] == "done"
