"""Ropes, cloth and balloons of constraints: every scene meets its own `expect:` block."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

SCENES = Path(__file__).resolve().parents[2] / "scenes" / "xpbd"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rope", "hanging-cloth", "balloon"])
def test_scene(name: str, cli: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path) -> None:
    out = tmp_path / "result"
    finished = cli("run", SCENES / f"{name}.yaml", "--out", out)
    assert finished.returncode == 0, finished.stderr
    facts = json.loads((out / "result.json").read_text(encoding="utf-8"))
    assert facts["status"] == "done"
    assert facts["expect"]
    assert all(verdict["passed"] for verdict in facts["expect"])
