"""A folder that cannot be written to: exit 4 and one line, before any work is spent on what would go there."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from running import Said, assert_same_result, contents, facts
from small_disk import Disk

from femdeform.run import deformable, inputs, recorder
from femdeform.run.checkpoint import read_checkpoint

Say = Callable[..., Said]
NOBODY = 65534


@pytest.fixture(autouse=True)
def _no_work(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """Nothing is set up for a folder that cannot be written to."""
    if "early" in request.keywords or "early" in request.node.name:

        def work(*_: Any) -> None:
            raise AssertionError("the simulation was set up")

        monkeypatch.setattr(deformable, "build_simulation", work)


@contextmanager
def without_rights() -> Iterator[None]:
    """Root may write anywhere: be somebody else for a while."""
    if os.geteuid() != 0:
        yield
        return
    os.setegid(NOBODY)
    os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(0)
        os.setegid(0)


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """A folder that anybody can reach and that belongs to whom `without_rights` makes us."""
    with tempfile.TemporaryDirectory(prefix="femdeform-test-") as name:
        folder = Path(name)
        if os.geteuid() == 0:
            os.chown(folder, NOBODY, NOBODY)
        yield folder
        folder.chmod(0o755)


def refuses(said: Said, message: str) -> None:
    assert (said.code, said.out, said.err) == (4, "", f"femdeform: {message}\n")


def test_early_a_file_in_the_place_of_the_folder(unbroken: tuple[Path, Path], tmp_path: Path, say: Say) -> None:
    (tmp_path / "out").write_text("mine")
    message = f"cannot write {tmp_path / 'out'}: there is a file of that name, not a folder"
    refuses(say("run", unbroken[0], "--out", tmp_path / "out"), message)
    message = f"cannot write {tmp_path / 'out' / 'deep'}: a part of the path is a file, not a folder"
    refuses(say("run", unbroken[0], "--out", tmp_path / "out" / "deep"), message)
    assert contents(tmp_path) == {"out": b"mine"}


def test_early_a_read_only_disk(unbroken: tuple[Path, Path], disk: Disk, say: Say) -> None:
    (disk.folder / "there").mkdir()
    subprocess.run(["mount", "-o", "remount,ro", str(disk.folder)], check=True)
    for name in ("there", "new"):
        out = disk.folder / name
        refuses(say("run", unbroken[0], "--out", out), f"cannot write {out}: the file system is read-only")


def test_early_no_permission(unbroken: tuple[Path, Path], open_folder: Path, say: Say) -> None:
    open_folder.chmod(0o555)
    (scene := open_folder.parent / f"{open_folder.name}.yaml").write_bytes(unbroken[0].read_bytes())
    try:
        with without_rights():
            said = say("run", scene, "--out", open_folder / "out")
            again = say("run", scene, "--out", open_folder)
    finally:
        scene.unlink()
    refuses(said, f"cannot write {open_folder / 'out'}: no permission to write there")
    refuses(again, f"cannot write {open_folder}: no permission to write there")
    assert list(open_folder.iterdir()) == []


def test_bad_input_comes_first_and_makes_no_folder(unbroken: tuple[Path, Path], tmp_path: Path, say: Say) -> None:
    said = say("run", unbroken[0], "--out", tmp_path / "out", "--set", "time.dt=-1")
    assert said.code == 2
    assert not (tmp_path / "out").exists()


def test_a_folder_that_is_closed_on_the_way(
    unbroken: tuple[Path, Path], open_folder: Path, say: Say, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was written stays; once the folder is open again the run goes on."""
    scene, whole = unbroken
    out = open_folder / "out"
    recorded = recorder.Recorder.step

    def closing(self: recorder.Recorder, row: Any) -> None:
        if row["step"] == 7:
            out.chmod(0o555)
            (out / "frames").chmod(0o555)
        recorded(self, row)

    (copy := open_folder / "s.yaml").write_bytes(scene.read_bytes())
    with monkeypatch.context() as patch, without_rights():
        patch.setattr(recorder.Recorder, "step", closing)
        said = say("run", copy, "--out", out, "--trace", "--quiet")
    out.chmod(0o755)
    (out / "frames").chmod(0o755)
    refuses(said, f"cannot write {out / 'checkpoint.h5'}: no permission to write there")
    # Not even result.json could be replaced, and nothing claims that the run was done.
    assert facts(out)["status"] == "running"
    assert read_checkpoint(out).step == 4
    with without_rights():
        assert say("run", copy, "--out", out, "--trace", "--resume").code == 0
    assert_same_result(whole, out)


def test_the_probe_leaves_nothing_behind(tmp_path: Path) -> None:
    inputs.check_writable(tmp_path / "a" / "b")
    assert contents(tmp_path) == {}
