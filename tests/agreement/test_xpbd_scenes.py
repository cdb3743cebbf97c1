"""The scenes of scenes/xpbd: ropes, wires, cloth, a balloon, bodies in a grid; muscles have a module of their own."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from femdeform.cli import main
from femdeform.scene.load import load_scene

SCENES = Path(__file__).resolve().parents[2] / "scenes" / "xpbd"
NAMES = sorted({path.stem for path in SCENES.glob("*.yaml")} - {"muscle-box"})
# Scenes of a few seconds.
QUICK = {"rope", "hanging-cloth", "balloon", "bending-wires"}


@pytest.mark.parametrize("name", NAMES)
def test_a_scene_has_no_faults_and_expects_something(name: str) -> None:
    assert main(["check", str(SCENES / f"{name}.yaml")]) == 0
    assert load_scene(SCENES / f"{name}.yaml").scene.expect is not None


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.gallery) for name in NAMES]
)
def test_scene(name: str, cli: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path) -> None:
    out = tmp_path / "result"
    finished = cli("run", SCENES / f"{name}.yaml", "--out", out)
    assert finished.returncode == 0, finished.stderr
    facts = json.loads((out / "result.json").read_text(encoding="utf-8"))
    assert facts["status"] == "done"
    assert facts["expect"]
    assert all(verdict["passed"] for verdict in facts["expect"])
