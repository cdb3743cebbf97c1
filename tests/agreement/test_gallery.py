"""Every scene of the gallery runs and meets its own `expect:` block."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

SCENES = Path(__file__).resolve().parents[2] / "scenes"
# The demo takes a minute on its own: its first steps show that it runs, `make demo` shows the rest.
SHORTENED = {"rubber-mount": ["--set", "time.dt=0.1", "--set", "time.end=0.2", "--set", "expect={}"]}


def test_the_gallery_is_there() -> None:
    assert len(list(SCENES.glob("*.yaml"))) >= 5


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(path.stem for path in SCENES.glob("*.yaml")))
def test_scene(name: str, cli: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path) -> None:
    out = tmp_path / "result"
    finished = cli("run", SCENES / f"{name}.yaml", "--out", out, *SHORTENED.get(name, []))
    assert finished.returncode == 0, finished.stderr
    facts = json.loads((out / "result.json").read_text(encoding="utf-8"))
    assert facts["status"] == "done"
    assert all(verdict["passed"] for verdict in facts["expect"])
    if name not in SHORTENED:
        assert facts["expect"], "a scene of the gallery says what to expect"
