"""Every scene of tests/scenes/bad gives exactly the faults that its head announces."""

from __future__ import annotations

from pathlib import Path

import pytest

from femdeform.cli import main

FOLDER = Path(__file__).parents[2] / "scenes" / "bad"
SCENES = sorted(FOLDER.glob("*.yaml"))
EXPECT = "# expect: "


def announced(path: Path) -> list[str]:
    """Lines that the comments at the head of a bad scene announce, without the file's name."""
    lines = path.read_text(encoding="utf-8").split("\n")
    return [line.removeprefix(EXPECT) for line in lines if line.startswith(EXPECT)]


def test_there_are_bad_scenes_enough() -> None:
    assert len(SCENES) >= 60
    assert all(announced(path) for path in SCENES)


@pytest.mark.parametrize("path", SCENES, ids=lambda path: path.stem)
def test_faults_are_the_announced_ones(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(path)]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.splitlines() == [f"{path}:{line}" for line in announced(path)]
