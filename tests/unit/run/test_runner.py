"""`femdeform run` from file to result folder: expectations, facts, fallback. What goes wrong: tests/robustness."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from running import bar, expecting, facts, rolling
from scenario import block, body, material, quasistatic, scene, write
from scipy.optimize import brentq

from femdeform.run import runner
from femdeform.run.checkpoint import read_checkpoint
from femdeform.run.result import Result
from femdeform.run.runner import run_scene
from femdeform.run.table import read_table

Process = subprocess.CompletedProcess[str]


# ------------------------------------------------------------------------------------------- expectations


def test_expectations_met(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    middle = {"plane": {"point": [0.5, 0, 0], "normal": [1, 0, 0]}}
    data = expecting(
        max_displacement={"value": 0.1, "rtol": 1e-9},
        min_jacobian={"value": 1.0, "atol": 0.1},
        kinetic_energy={"value": 0.0, "atol": 1e-12},
        displacement=[
            {"on": "b.right", "component": "x", "value": 0.1, "atol": 1e-9},
            {"on": "b.left", "component": "norm", "value": 0.0, "atol": 1e-12},
            {"on": middle, "component": "x", "value": 0.05, "rtol": 0.05},
        ],
    )
    assert run_scene(write(data, tmp_path / "s.yaml"), out=tmp_path / "out") == 0
    result = facts(tmp_path / "out")
    assert result["status"] == "done"
    assert [verdict["passed"] for verdict in result["expect"]] == [True] * 6
    assert capfd.readouterr().out.count(": ok") == 6


def test_an_expectation_missed(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    data = expecting(
        max_displacement={"value": 0.1, "rtol": 1e-9},
        volume_ratio={"value": 1.0, "rtol": 1e-3},
        elastic_energy={"value": 0.0, "atol": 1.0},
    )
    assert run_scene(write(data, tmp_path / "s.yaml"), out=tmp_path / "out") == 1
    result = facts(tmp_path / "out")
    assert result["status"] == "expectation_failed"
    verdicts = {verdict["quantity"]: verdict for verdict in result["expect"]}
    passed = {name: verdict["passed"] for name, verdict in verdicts.items()}
    assert passed == {"max_displacement": True, "volume_ratio": False, "elastic_energy": False}
    assert verdicts["volume_ratio"]["computed"] == pytest.approx(1.04, abs=0.02)
    # E/2 strain^2 V, a little more for the held cross-sections.
    assert verdicts["elastic_energy"]["computed"] == pytest.approx(0.5 * 1e5 * 0.01 * 0.16, rel=0.15)
    assert "volume_ratio is" in result["reason"]
    output = capfd.readouterr()
    assert output.out.count("FAILED") == 2
    assert (tmp_path / "out" / "final.vtu").exists()


# ------------------------------------------------------------------------------------------- the folder


def test_facts_and_history(tmp_path: Path) -> None:
    path = write({**expecting(), "title": "Pulled bar"}, tmp_path / "pulled.yaml")
    assert run_scene(path, out=tmp_path / "out", threads=1) == 0
    result = facts(tmp_path / "out")
    expected = {"title": "Pulled bar", "n_dofs": 135, "ranks": 1, "threads": 1, "steps": 2, "scene_file": "pulled.yaml"}
    assert {key: result[key] for key in expected} == expected
    assert result["linear_solver"] == "scipy_direct"
    assert result["wall_seconds"] > 0.0
    table = read_table(tmp_path / "out" / "history.csv")
    for column in ("residual_norm", "relative_residual", "elastic_energy", "kinetic_energy", "force_scale"):
        assert np.isfinite(table[column]).all()
    assert np.all(table["relative_residual"] <= 1e-8)
    assert not (tmp_path / "out" / "iterations.csv").exists()
    # The resolved scene gives the same run.
    assert run_scene(tmp_path / "out" / "resolved.yaml", out=tmp_path / "again") == 0
    np.testing.assert_array_equal(*(read_checkpoint(tmp_path / name).fields["x"] for name in ("out", "again")))


def test_notices_reach_the_user(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    data = bar(
        {"kind": "translate", "on": "b.right", "velocity": [0.1, 0.0, 0.0]},
        {"kind": "rotate", "on": "b.right", "axis": [1, 0, 0], "rate": 0.1},
        time=quasistatic(),
    )
    assert run_scene(write(data, tmp_path / "s.yaml"), out=tmp_path / "out") == 0
    assert "note: conditions[2] (rotate) takes over 9 nodes" in capfd.readouterr().err
    assert run_scene(write(data, tmp_path / "s.yaml"), out=tmp_path / "quiet", quiet=True) == 0
    assert capfd.readouterr() == ("", "")


# ------------------------------------------------------------------------------------------- without PETSc


def fake_petsc(folder: Path) -> dict[str, str]:
    """Environment in which importing petsc4py fails the way a missing library makes it fail."""
    package = folder / "fake" / "petsc4py"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text('raise ImportError("libpetsc.so.3.99: cannot open shared object file")\n')
    repository = Path(runner.__file__).parents[2]
    return {"PYTHONPATH": os.pathsep.join([str(package.parent), str(repository)])}


def test_scipy_takes_over_where_petsc_cannot_be_imported(tmp_path: Path, cli: Callable[..., Process]) -> None:
    data = rolling({"method": "ksp"}, steps=6)
    data["solver"] = {"tolerance": 1e-11}
    write(data, tmp_path / "s.yaml")
    done = cli("run", "s.yaml", "--out", "fallback", extra=fake_petsc(tmp_path))
    assert done.returncode == 0, done.stderr
    lines = [line for line in done.stderr.splitlines() if re.search("petsc|scipy", line, re.IGNORECASE)]
    assert len(lines) == 1, done.stderr
    assert "libpetsc.so.3.99" in lines[0]
    assert "SciPy" in lines[0]
    assert facts(tmp_path / "fallback")["linear_solver"] == "scipy_direct"
    assert run_scene(tmp_path / "s.yaml", out=tmp_path / "here") == 0
    fallback, here = read_checkpoint(tmp_path / "fallback"), read_checkpoint(tmp_path / "here")
    size = np.abs(here.fields["x"] - Result.open(tmp_path / "here").read_final().points).max()
    np.testing.assert_allclose(fallback.fields["x"], here.fields["x"], atol=1e-8 * size)


# ------------------------------------------------------------------------------------------- cloth and rods


def test_a_cloth_hangs(tmp_path: Path) -> None:
    """Held at two corners, it swings down and stretches little."""
    mesh = {"recipe": "cloth", "size": [1.0, 1.0], "cells": [6, 6]}
    cloth = body(mesh, material(E=1e6, nu=0.3, density=300.0), kind="membrane", thickness=0.002)
    corner = {"box": [[-0.6, -0.1, -0.51], [0.6, 0.1, -0.45]]}
    data = scene(
        {"c": cloth},
        {"kind": "fixed", "on": {"sphere": {"center": [-0.5, 0, -0.5], "radius": 0.01}}},
        {"kind": "fixed", "on": {"sphere": {"center": [0.5, 0, -0.5], "radius": 0.01}}},
        gravity=[0.0, -9.81, 0.0],
        time={"scheme": "backward_euler", "dt": 0.02, "end": 0.5},
        expect={"displacement": [{"on": corner, "component": "y", "value": -0.05, "atol": 0.05}]},
    )
    assert run_scene(write(data, tmp_path / "s.yaml"), out=tmp_path / "out") == 0
    final = Result.open(tmp_path / "out").read_final()
    assert final.positions[:, 1].min() < -0.7
    table = read_table(tmp_path / "out" / "history.csv")
    assert len(table["step"]) == 25
    total = table["kinetic_energy"] + table["elastic_energy"] + table["potential_energy"]
    assert np.all(np.diff(total) < 1e-9)
    triangles = final.blocks[0][1]
    sides = final.positions[triangles[:, 1:]] - final.positions[triangles[:, :1]]
    area = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1).sum()
    assert area == pytest.approx(1.0, rel=0.05)


@pytest.mark.parametrize("contact", [{"method": "penalty"}, {"method": "ipc", "distance": 0.02, "stiffness": 3.0e3}])
def test_the_energy_balance_is_closed_in_contact(contact: dict[str, Any], tmp_path: Path) -> None:
    """A plate bounces on soft ground: what is missing while it touches is in the column of contact."""
    ground: dict[str, Any] = {"kind": "plane", "point": [0, 0], "normal": [0, 1]}
    if contact["method"] == "penalty":
        ground["stiffness"] = 1.0e6
    data = scene(
        {"b": body(block([0.4, 0.1], [4, 1], translate=[0.0, 0.03]), material(E=1e6))},
        {"kind": "initial_velocity", "on": "b", "velocity": [0.0, -1.0]},
        obstacles=[ground],
        contact=contact,
        gravity=[0.0, -9.81],
        time={"scheme": "backward_euler", "dt": 0.0005, "end": 0.1},
        measure={"total": {"kind": "total_energy"}},
    )
    assert run_scene(write(data, tmp_path / "s.yaml"), out=tmp_path / "out", quiet=True) == 0
    table = read_table(tmp_path / "out" / "history.csv")
    without = table["kinetic_energy"] + table["elastic_energy"] + table["potential_energy"]
    total = without + table["contact_energy"]
    np.testing.assert_allclose(table["measure.total"], total, rtol=1e-12, atol=1e-9)
    assert table["contact_energy"].max() > 0.1 * total[0]
    assert np.diff(without).max() > 0.05 * total[0]  # as if it came from nowhere
    assert np.diff(total).max() < 1e-6 * total[0]
    assert 0.6 * total[0] < total[-1]
    assert table["contact_energy"][0] == table["contact_energy"][-1] == 0.0  # before it comes and after it has left


def test_a_net_of_rods_falls_onto_a_ball(tmp_path: Path) -> None:
    net = body(
        {"recipe": "rod_net", "size": [1.0, 1.0], "meshes": [5, 5], "segments": 2},
        material(E=1e6, density=1000.0),
        kind="rod",
        cross_section=1e-4,
    )
    data = scene(
        {"n": net},
        gravity=[0.0, -9.81, 0.0],
        obstacles=[{"kind": "sphere", "center": [0.02, -0.35, 0.01], "radius": 0.3, "friction": 0.5}],
        time={"scheme": "backward_euler", "dt": 0.02, "end": 0.5},
    )
    assert run_scene(write(data, tmp_path / "s.yaml"), out=tmp_path / "out") == 0
    final = Result.open(tmp_path / "out").read_final()
    distance = np.linalg.norm(final.positions - [0.02, -0.35, 0.01], axis=1)
    assert distance.min() > 0.29
    assert np.count_nonzero(distance < 0.31) >= 5
    assert final.positions[:, 1].min() < -0.2


def test_a_taut_rod_carries_a_load_across(tmp_path: Path) -> None:
    """Stretched by a tenth, then pushed in the middle: the balance of forces at the middle node, solved by hand."""
    E, A, F = 1e6, 1e-3, 40.0
    data = scene(
        {"r": body({"recipe": "rod", "cells": 2}, material(E=E, nu=0.0), kind="rod", cross_section=A)},
        {"kind": "fixed", "on": "r.start"},
        {"kind": "path", "on": "r.end", "times": [0.0, 0.5], "displacements": [[0, 0, 0], [0.1, 0, 0]]},
        {
            "kind": "point_load",
            "on": {"nodes": [1]},
            "force": [0.0, -F, 0.0],
            "amplitude": {"times": [0.5, 1.0], "values": [0.0, 1.0]},
        },
        {"kind": "fixed", "on": {"nodes": [1]}, "components": ["z"]},
        time=quasistatic(dt=0.25),
        solver={"tolerance": 1e-11},
    )
    assert run_scene(write(data, tmp_path / "s.yaml"), out=tmp_path / "out") == 0
    x = read_checkpoint(tmp_path / "out").fields["x"]

    mu = E / 2.0  # nu = 0: lambda = 0, lambda-hat = mu, psi' = mu (s - 1) + mu (s - 1) for stretches (s, 1, 1)

    def unbalanced(sag: float) -> float:
        stretch = np.hypot(0.55, sag) / 0.5
        tension = A * (mu * stretch + mu * (stretch - 1.0) - mu)
        return 2.0 * tension * sag / np.hypot(0.55, sag) - F

    sag = brentq(unbalanced, 0.0, 1.0)
    np.testing.assert_allclose(x[1], [0.55, -sag, 0.0], atol=1e-9)


def test_the_command_line_takes_what_the_function_takes(tmp_path: Path, cli: Callable[..., Process]) -> None:
    write(expecting(), tmp_path / "s.yaml")
    done = cli("run", "s.yaml", "--set", "time.dt=0.25", "--out", "out", "--threads", "1")
    assert done.returncode == 0, done.stderr
    assert facts(tmp_path / "out")["steps"] == 4
    assert done.stdout.startswith("done: 4 steps")
