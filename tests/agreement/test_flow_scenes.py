"""The scenes of scenes/flow: smoke in boxes, past solids, around a box that turns."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from running import assert_meets_expectations

from femdeform.cli import main
from femdeform.scene.load import load_scene

SCENES = Path(__file__).resolve().parents[2] / "scenes" / "flow"
NAMES = sorted(path.stem for path in SCENES.glob("*.yaml"))


@pytest.mark.parametrize("name", NAMES)
def test_a_scene_has_no_faults(name: str) -> None:
    assert main(["check", str(SCENES / f"{name}.yaml")]) == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [name if name.endswith("-2d") else pytest.param(name, marks=pytest.mark.gallery) for name in NAMES]
)
def test_scene(name: str, cli: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path) -> None:
    path = SCENES / f"{name}.yaml"
    verdicts = assert_meets_expectations(cli, path, tmp_path / "result")
    assert len(verdicts) == 2 + len(load_scene(path).scene.expect.measured)
