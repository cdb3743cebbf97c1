"""Runs for tests: scenes for the command line, and what two results of the same scene have in common."""

from __future__ import annotations

import csv
import json
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scenario import block, body, material, quasistatic, scene

from femdeform.run.checkpoint import read_checkpoint

# Of the unbroken run that broken ones are compared with.
STEPS = 12


@dataclass
class Said:
    """What a command said, and its exit code."""

    code: int
    out: str
    err: str


def bar(*conditions: dict[str, Any], **more: Any) -> dict[str, Any]:
    """A bar that is held at its left end."""
    stuff = material("logarithmic_neo_hookean", E=1e5, nu=0.3)
    bodies = {"b": body(block([1.0, 0.4, 0.4], [4, 2, 2]), stuff)}
    return scene(bodies, {"kind": "fixed", "on": "b.left"}, *conditions, **more)


def expecting(**wanted: Any) -> dict[str, Any]:
    """A bar pulled by a tenth in two steps, with expectations."""
    pull = {"kind": "translate", "on": "b.right", "velocity": [0.1, 0.0, 0.0]}
    return bar(pull, time=quasistatic(dt=0.5), expect=wanted)


def rolling(linear_solver: dict[str, Any] | None = None, steps: int = 40) -> dict[str, Any]:
    """A soft block that falls, hits the ground askew and slides: contact, friction, failed steps are likely."""
    return scene(
        {"b": body(block([0.5, 0.3, 0.3], [3, 2, 2], translate=[0, 0.02, 0]), material(E=5e4, nu=0.4))},
        {"kind": "initial_velocity", "on": "b", "velocity": [1.0, -2.0, 0.3], "angular_velocity": [0, 0, 4.0]},
        gravity=[0.0, -9.81, 0.0],
        obstacles=[{"kind": "plane", "point": [0, 0, 0], "normal": [0, 1, 0], "friction": 0.4}],
        time={"scheme": "backward_euler", "dt": 0.01, "end": 0.01 * steps},
        linear_solver=linear_solver or {"method": "scipy_direct"},
        output={"every": 3, "checkpoint_every": 4, "fields": ["displacement", "velocity", "jacobian"]},
    )


def facts(folder: Path) -> dict[str, Any]:
    """What result.json says."""
    return dict(json.loads((folder / "result.json").read_text(encoding="utf-8")))


def assert_meets_expectations(
    cli: Callable[..., subprocess.CompletedProcess[str]], scene: Path, out: Path, *more: str
) -> list[dict[str, Any]]:
    """Run a scene to its end, where every verdict of its `expect:` holds; the verdicts."""
    finished = cli("run", scene, "--out", out, *more)
    assert finished.returncode == 0, finished.stderr
    found = facts(out)
    assert found["status"] == "done"
    verdicts: list[dict[str, Any]] = found["expect"]
    assert all(verdict["passed"] for verdict in verdicts)
    return verdicts


def without_seconds(path: Path) -> list[dict[str, str]]:
    """Rows of a table but for the wall times."""
    with path.open(newline="") as file:
        return [{k: v for k, v in row.items() if k != "seconds"} for row in csv.DictReader(file)]


def wait_for_rows(path: Path, n: int, process: subprocess.Popen[str]) -> None:
    """Return as soon as a table has that many rows."""
    deadline = time.monotonic() + 120.0
    while time.monotonic() < deadline:
        if path.exists() and path.read_bytes().count(b"\n") > n:
            return
        if process.poll() is not None:
            break
        time.sleep(0.002)
    raise AssertionError(f"{path} never had {n} rows; the run said: {process.communicate()}")


def contents(folder: Path) -> dict[str, bytes]:
    """Every file of a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def assert_same_result(one: Path, two: Path) -> None:
    """Two results agree in every bit but for wall times."""
    a, b = read_checkpoint(one), read_checkpoint(two)
    assert set(a.fields) == set(b.fields)
    for name, values in a.fields.items():
        np.testing.assert_array_equal(values, b.fields[name], err_msg=name)
    for name in ("time", "step", "current_dt", "streak", "frames"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    names = sorted(contents(one))
    assert names == sorted(contents(two))
    compared = [name for name in names if name.endswith((".vtu", ".pvd", ".yaml"))]
    assert {"final.vtu", "frames.pvd", "resolved.yaml"} < set(compared)
    for name in compared:
        assert (one / name).read_bytes() == (two / name).read_bytes(), name
    for name in ("history.csv", "iterations.csv"):
        if (one / name).exists():
            assert without_seconds(one / name) == without_seconds(two / name)
