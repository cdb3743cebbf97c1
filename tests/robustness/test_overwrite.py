"""A result that lies in the folder: refused with both ways out, replaced with --overwrite, and nothing else touched."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from running import STEPS, Said, assert_same_result, contents, facts

from femdeform.run import inputs

Say = Callable[..., Said]


@pytest.fixture
def out(unbroken: tuple[Path, Path], tmp_path: Path) -> Path:
    """A copy of the unbroken result, with files of somebody else beside and inside its folders."""
    shutil.copytree(unbroken[1], tmp_path / "out")
    (tmp_path / "out" / "notes.txt").write_text("mine")
    (tmp_path / "out" / "frames" / "notes.txt").write_text("mine")
    return tmp_path / "out"


@pytest.mark.parametrize("status", ["done", "running", "interrupted", "failed"])
def test_refused(
    status: str, unbroken: tuple[Path, Path], out: Path, say: Say, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = (out / "result.json").read_text()
    (out / "result.json").write_text(text.replace('"status": "done"', f'"status": "{status}"'))
    before = contents(out)
    monkeypatch.setattr(inputs, "load_meshes", lambda _: pytest.fail("meshed for nothing"))
    said = say("run", unbroken[0], "--out", out)
    kind = "an unfinished result" if status in ("running", "interrupted") else "a result"
    ways = "give --resume to go on with it, --overwrite to replace it, or another folder with --out"
    assert (said.code, said.out, said.err) == (2, "", f"{out}: holds {kind} already: {ways}\n")
    assert contents(out) == before


def test_replaced(unbroken: tuple[Path, Path], out: Path, say: Say) -> None:
    scene, whole = unbroken
    said = say("run", scene, "--out", out, "--overwrite", "--set", f"time.end={0.01 * STEPS / 2}", "--quiet")
    assert said.code == 0, said.err
    assert facts(out)["steps"] == STEPS / 2
    mine = {"notes.txt", "frames/notes.txt"}
    assert {name: text for name, text in contents(out).items() if name in mine} == dict.fromkeys(mine, b"mine")
    assert len(list((out / "frames").glob("*.vtu"))) == 1 + STEPS // 2 // 3
    assert not (out / "iterations.csv").exists()
    # Once more with the scene of the first: nothing of the second is left.
    assert say("run", scene, "--out", out, "--overwrite", "--trace", "--quiet").code == 0
    for name in mine:
        (out / name).unlink()
    assert_same_result(whole, out)


def test_into_an_empty_folder(unbroken: tuple[Path, Path], tmp_path: Path, say: Say) -> None:
    assert say("run", unbroken[0], "--out", tmp_path / "new", "--overwrite", "--trace").code == 0
    assert_same_result(unbroken[1], tmp_path / "new")


def test_bad_input_replaces_nothing(unbroken: tuple[Path, Path], out: Path, say: Say) -> None:
    before = contents(out)
    assert say("run", unbroken[0], "--out", out, "--overwrite", "--set", "time.dt=-1").code == 2
    assert say("run", unbroken[0], "--out", out, "--overwrite", "--set", "conditions[0].on=b.nowhere").code == 2
    assert contents(out) == before


def test_not_together_with_resume(unbroken: tuple[Path, Path], out: Path, say: Say) -> None:
    said = say("run", unbroken[0], "--out", out, "--overwrite", "--resume")
    assert said.code == 2
    assert "not allowed with argument" in said.err
