"""Examples among the scenes of scenes/mpm; those that verify a number have a module of their own."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from running import assert_meets_expectations

from femdeform.cli import main
from femdeform.run.batch_scenes import check_runs, plan_runs
from femdeform.run.table import read_table
from femdeform.scene.batch_schema import load_study
from femdeform.scene.load import load_scene

SCENES = Path(__file__).resolve().parents[2] / "scenes" / "mpm"
NAMES = sorted(path.stem for path in SCENES.glob("*.yaml") if not path.stem.startswith("verify-"))
STUDIES = sorted(SCENES.parent.glob("studies/mpm-*.yaml"))
# Scenes of a few seconds.
QUICK = {"marangoni-drop-frictionless", "wine-glass"}


def test_the_scenes_are_there() -> None:
    assert len(NAMES) >= 10
    assert set(NAMES) >= QUICK


@pytest.mark.parametrize("name", NAMES)
def test_a_scene_has_no_faults_and_expects_something(name: str) -> None:
    assert main(["check", str(SCENES / f"{name}.yaml")]) == 0
    scene = load_scene(SCENES / f"{name}.yaml").scene
    assert scene.simulation == "material_points"
    assert scene.expect.measured


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_a_study_can_be_run(path: Path) -> None:
    """Every scene it leads to is sound, and has what the study lists."""
    plan = plan_runs(load_study(path), lambda done, total: None)
    assert len(plan.distinct) > 2
    check_runs(plan, plan.runs, lambda done, total: None)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.gallery) for name in NAMES]
)
def test_example(name: str, cli: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path) -> None:
    assert assert_meets_expectations(cli, SCENES / f"{name}.yaml", tmp_path / "result")


@pytest.mark.slow
def test_a_drop_keeps_the_volume_that_it_shows(
    cli: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    """With long steps, 0.06 s: with the motion of groups a twentieth is lost."""
    kept = {}
    for motion in ("field", "group"):
        out = tmp_path / motion
        angle = ("--set", "bodies.drop.surface_tension.contact_angle=135")
        steps = ("--set", "time.dt=4e-4", "--set", "time.end=0.06", "--set", "expect={}")
        finished = cli(
            "run", SCENES / "contact-angle.yaml", "--out", out, *angle, *steps, "--set", f"surface.motion={motion}"
        )
        assert finished.returncode == 0, finished.stderr
        visible = read_table(out / "history.csv")["measure.visible"]
        kept[motion] = float(visible[-1] / visible[0])
    assert kept["field"] == pytest.approx(1.02, abs=0.03)
    assert kept["group"] < 0.95
