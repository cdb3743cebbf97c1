"""The scenes with muscles: free of faults, and meeting what they expect."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from femdeform.cli import main

REPOSITORY = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get("FEMDEFORM_DATA", REPOSITORY.parent / "shared" / "data"))
MUSCLE, BICEPS = REPOSITORY / "scenes/pbng/muscle.yaml", REPOSITORY / "scenes/pbng/biceps.yaml"
BOX, BOUND = REPOSITORY / "scenes/xpbd/muscle-box.yaml", REPOSITORY / "scenes/pbng/bound-muscles.yaml"


def run(scene: Path, out: Path, *overrides: str) -> int:
    arguments = ["run", str(scene), "--out", str(out)]
    for override in overrides:
        arguments += ["--set", override]
    return main(arguments)


@pytest.mark.parametrize("scene", [MUSCLE, BOX, BOUND], ids=lambda path: path.stem)
def test_no_faults(scene: Path) -> None:
    assert main(["check", str(scene)]) == 0


def test_first_steps_of_the_muscle_box(tmp_path: Path) -> None:
    assert run(BOX, tmp_path / "result", "time.end=0.09", "expect={}") == 0


@pytest.mark.gallery
@pytest.mark.parametrize("scene", [MUSCLE, BOX, BOUND], ids=lambda path: path.stem)
def test_meets_what_it_expects(scene: Path, tmp_path: Path) -> None:
    assert run(scene, tmp_path / "result") == 0


def real_biceps() -> str:
    path = DATA / "biceps" / "biceps.npz"
    if not path.is_file():
        pytest.skip(f"biceps/biceps.npz is not in {DATA}; FEMDEFORM_DATA names another folder")
    return f"bodies.arm.mesh.file={path}"


def test_biceps_has_no_faults(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["check", str(BICEPS), "--set", real_biceps()]) == 0


@pytest.mark.gallery
def test_biceps_meets_what_it_expects(tmp_path: Path) -> None:
    assert run(BICEPS, tmp_path / "result", real_biceps()) == 0
