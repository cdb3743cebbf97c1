"""`femdeform check` of files that are not scenes: all scenes they lead to are checked."""

from __future__ import annotations

from pathlib import Path

import pytest
from compared import write_bar

from femdeform.cli import main

COMPARISON = "scene: {scene}\nvariants:\n  exact: {{solver.hessian: exact}}\niterations: 2\n"
STUDY = "scene: {scene}\nsweep:\n  grid:\n    solver.hessian: [exact, project_cells]\n"


def checked(folder: Path, text: str, capsys: pytest.CaptureFixture[str], *more: str) -> tuple[int, str, str]:
    path = folder / "file.yaml"
    path.write_text(text.format(scene=write_bar(folder).name), encoding="utf-8")
    code = main(["check", str(path), *more])
    said = capsys.readouterr()
    return code, said.out, said.err


@pytest.mark.parametrize("text", [COMPARISON, STUDY], ids=["comparison", "study"])
def test_sound_files_have_no_faults(text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = text.replace("project_cells", "projected")
    assert checked(tmp_path, text, capsys) == (0, f"{tmp_path / 'file.yaml'}: no faults\n", "")


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (COMPARISON.replace("exact}", "exakt}"), "--variant exact"),
        (COMPARISON.replace("iterations: 2", "iterations: 2\nsteps: 10000"), "go beyond the scene's end"),
        (COMPARISON.replace("iterations: 2", "rounds: 2"), "file.yaml:4: rounds"),
        (COMPARISON.replace("{scene}", "not-{scene}"), "file.yaml:1: scene"),
        (STUDY.replace("project_cells", "exakt"), "file.yaml:4: solver.hessian: must be one of"),
        ("studies:\n  a: {{kind: value}}\n", "is a verification study: `femdeform verify` checks it"),
    ],
)
def test_faults_of_what_they_lead_to(text: str, fault: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, out, err = checked(tmp_path, text, capsys)
    assert (code, out) == (2, "")
    assert fault in err


def test_set_is_for_all_variants(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = checked(tmp_path, COMPARISON, capsys, "--set", "time.dt=-1")
    assert code == 2
    assert "time.dt" in err


def test_set_is_not_for_studies(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, _, err = checked(tmp_path, STUDY.replace("project_cells", "projected"), capsys, "--set", "time.dt=1")
    assert code == 2
    assert "--set: is not for" in err


def test_the_shipped_files(capsys: pytest.CaptureFixture[str]) -> None:
    paths = sorted((Path(__file__).parents[3] / "scenes" / "studies").glob("*.yaml"))
    assert len(paths) > 20
    assert main(["check", *map(str, paths)]) == 0, capsys.readouterr().err
