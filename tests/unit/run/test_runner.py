"""`femdeform run` from file to result folder: failure, expectations, interruption, resumption, fallback."""

from __future__ import annotations

import csv
import json
import os
import random
import re
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenario import block, body, material, quasistatic, scene, write
from scipy.optimize import brentq

from femdeform.errors import InputError
from femdeform.run import runner
from femdeform.run.checkpoint import read_checkpoint
from femdeform.run.recorder import Recorder
from femdeform.run.result import Result
from femdeform.run.runner import run_scene
from femdeform.run.table import read_table

Process = subprocess.CompletedProcess[str]


def bar(*conditions: dict[str, Any], **more: Any) -> dict[str, Any]:
    stuff = material("logarithmic_neo_hookean", E=1e5, nu=0.3)
    bodies = {"b": body(block([1.0, 0.4, 0.4], [4, 2, 2]), stuff)}
    return scene(bodies, {"kind": "fixed", "on": "b.left"}, *conditions, **more)


def crushed_at(time: float, **more: Any) -> dict[str, Any]:
    """A bar whose end moves slowly, then by more than its length at once: no step size solves that."""
    path = {
        "kind": "path",
        "on": "b.right",
        "times": [0.0, time, time + 1e-6],
        "displacements": [[0, 0, 0], [0.1, 0, 0], [-3.0, 0, 0]],
    }
    return bar(path, time=quasistatic(dt=0.1), **more)


def facts(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "result.json").read_text()))


# ------------------------------------------------------------------------------------------- failure


def test_stop_keeps_the_last_accepted_state(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = write(crushed_at(0.55, on_failure={"action": "stop"}), tmp_path / "s.yaml")
    assert run_scene(path, out=tmp_path / "out") == 3
    result = facts(tmp_path / "out")
    assert result["status"] == "not_converged"
    assert result["steps"] == 5
    assert "step 6" in result["reason"]
    assert result["reason"] in capfd.readouterr().err
    checkpoint = read_checkpoint(tmp_path / "out")
    assert checkpoint.step == 5
    assert checkpoint.time == pytest.approx(0.5)
    final = Result.open(tmp_path / "out").read_final()
    opened = Result.open(tmp_path / "out")
    np.testing.assert_array_equal(final.displacement, opened.read_frame(-1).displacement)
    np.testing.assert_array_equal(final.positions, checkpoint.x)
    assert final.displacement[:, 0].max() == pytest.approx(0.1 * 0.5 / 0.55)
    assert len(opened.history["step"]) == 5


def test_halving_ends_at_the_smallest_step(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    data = crushed_at(0.55, on_failure={"action": "halve_dt", "min_dt": 0.02})
    assert run_scene(write(data, tmp_path / "s.yaml"), out=tmp_path / "out") == 3
    result = facts(tmp_path / "out")
    assert "min_dt = 0.02 s" in result["reason"]
    # 0.5, then with dt = 0.05 to 0.55, then nothing goes any more.
    assert result["time"] == pytest.approx(0.55)
    assert "trying dt = 0.05 s" in capfd.readouterr().err


def test_halving_gets_over_a_hard_step(tmp_path: Path) -> None:
    """Half a turn at once takes the law through J = 0: smaller steps for that, then the full size again."""
    turn = {"kind": "rotate", "on": "b.right", "axis": [1, 0, 0], "rate": float(np.pi), "start": 1.0, "stop": 2.0}
    data = bar(turn, time=quasistatic(dt=1.0, end=6.0), on_failure={"min_dt": 0.01})
    assert run_scene(write(data, tmp_path / "s.yaml"), out=tmp_path / "out", trace=True) == 0
    table = read_table(tmp_path / "out" / "history.csv")
    assert table["failed_attempts"].sum() >= 1
    assert table["dt"].min() < 1.0
    assert np.count_nonzero(table["dt"] == 1.0) >= 4  # before and after
    assert table["time"][-1] == pytest.approx(6.0)
    np.testing.assert_allclose(np.cumsum(table["dt"]), table["time"], rtol=1e-12)
    iterations = read_table(tmp_path / "out" / "iterations.csv")
    assert set(iterations["step"]) <= set(table["step"])
    final = Result.open(tmp_path / "out").read_final()
    right = final.points[:, 0] == 1.0
    np.testing.assert_allclose(final.positions[right], final.points[right] * [1, -1, -1] + [0, 0.4, 0.4], atol=1e-12)


@pytest.mark.petsc
def test_an_error_on_the_way_is_recorded(tmp_path: Path) -> None:
    """PETSc tells after the first solve which options it knows; the result must not say that the run goes on."""
    options = {"method": "ksp", "options": {"ksp_rtoll": 1e-3}}
    path = write({**expecting(), "linear_solver": options}, tmp_path / "s.yaml")
    with pytest.raises(InputError, match=r"linear_solver\.options\.ksp_rtoll"):
        run_scene(path, out=tmp_path / "out")
    result = facts(tmp_path / "out")
    assert result["status"] == "failed"
    assert "PETSc did not use this option" in result["reason"]
    assert result["steps"] == 0
    assert (tmp_path / "out" / "final.vtu").exists()


# ------------------------------------------------------------------------------------------- expectations


def expecting(**wanted: Any) -> dict[str, Any]:
    pull = {"kind": "translate", "on": "b.right", "velocity": [0.1, 0.0, 0.0]}
    return bar(pull, time=quasistatic(dt=0.5), expect=wanted)


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


def test_a_result_is_not_overwritten(tmp_path: Path) -> None:
    path = write(expecting(), tmp_path / "s.yaml")
    assert run_scene(path, out=tmp_path / "out") == 0
    before = (tmp_path / "out" / "result.json").read_bytes()
    with pytest.raises(InputError, match="holds a result already"):
        run_scene(path, out=tmp_path / "out")
    assert (tmp_path / "out" / "result.json").read_bytes() == before


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
    np.testing.assert_array_equal(read_checkpoint(tmp_path / "out").x, read_checkpoint(tmp_path / "again").x)


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


# ------------------------------------------------------------------------------------------- resume


def rolling(linear_solver: dict[str, Any], steps: int = 40) -> dict[str, Any]:
    """A soft block that falls, hits the ground askew and slides: contact, friction, failed steps are likely."""
    return scene(
        {"b": body(block([0.5, 0.3, 0.3], [3, 2, 2], translate=[0, 0.02, 0]), material(E=5e4, nu=0.4))},
        {"kind": "initial_velocity", "on": "b", "velocity": [1.0, -2.0, 0.3], "angular_velocity": [0, 0, 4.0]},
        gravity=[0.0, -9.81, 0.0],
        obstacles=[{"kind": "plane", "point": [0, 0, 0], "normal": [0, 1, 0], "friction": 0.4}],
        time={"scheme": "backward_euler", "dt": 0.01, "end": 0.01 * steps},
        linear_solver=linear_solver,
        output={"every": 3, "checkpoint_every": 4, "fields": ["displacement", "velocity", "jacobian"]},
    )


def without_seconds(path: Path) -> list[dict[str, str]]:
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


def assert_same_result(one: Path, two: Path) -> None:
    a, b = read_checkpoint(one), read_checkpoint(two)
    for name in ("x", "v", "time", "step", "current_dt", "frames"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name), err_msg=name)
    names = sorted(path.relative_to(one) for path in one.rglob("*") if path.is_file())
    assert names == sorted(path.relative_to(two) for path in two.rglob("*") if path.is_file())
    compared = [name for name in names if name.suffix in (".vtu", ".pvd", ".yaml")]
    assert len(compared) > 10
    for name in compared:
        assert (one / name).read_bytes() == (two / name).read_bytes(), name
    for name in ("history.csv", "iterations.csv"):
        assert without_seconds(one / name) == without_seconds(two / name)


@pytest.mark.parametrize(
    "linear_solver",
    [
        pytest.param({"method": "scipy_direct"}, id="scipy"),
        pytest.param({"method": "ksp"}, id="mumps", marks=pytest.mark.petsc),
        pytest.param({"method": "ksp", "preset": "newton-gamg"}, id="gamg", marks=pytest.mark.petsc),
    ],
)
def test_kill_and_resume_to_the_bit(
    linear_solver: dict[str, Any], tmp_path: Path, cli: Callable[..., Process], start: Callable[..., Any]
) -> None:
    """Killed twice without warning at random moments, the run ends as if nothing had happened."""
    write(rolling(linear_solver), tmp_path / "s.yaml")
    arguments = ("run", "s.yaml", "--trace", "--quiet", "--out")
    unbroken = cli(*arguments, "whole")
    assert unbroken.returncode == 0, unbroken.stderr
    for first, last, more in ((1, 12, ()), (16, 28, ("--resume",))):
        process = start(*arguments, "broken", *more)
        wait_for_rows(tmp_path / "broken" / "history.csv", random.randint(first, last), process)
        time.sleep(random.uniform(0.0, 0.03))
        process.kill()
        assert process.wait() == -signal.SIGKILL
        assert facts(tmp_path / "broken")["status"] == "running"
    resumed = cli(*arguments, "broken", "--resume")
    assert resumed.returncode == 0, resumed.stderr
    assert_same_result(tmp_path / "whole", tmp_path / "broken")
    assert facts(tmp_path / "broken")["status"] == "done"
    assert len(without_seconds(tmp_path / "broken" / "history.csv")) == 40


def test_sigterm_leaves_a_run_to_go_on_with(
    tmp_path: Path, cli: Callable[..., Process], start: Callable[..., Any]
) -> None:
    write(rolling({"method": "scipy_direct"}), tmp_path / "s.yaml")
    process = start("run", "s.yaml", "--out", "out", "--trace")
    wait_for_rows(tmp_path / "out" / "history.csv", 9, process)
    process.send_signal(signal.SIGTERM)
    _, error = process.communicate(timeout=60)
    assert process.returncode == 130, error
    result = facts(tmp_path / "out")
    assert result["status"] == "interrupted"
    assert result["steps"] == read_checkpoint(tmp_path / "out").step >= 9
    assert "--resume" in error
    assert (tmp_path / "out" / "final.vtu").exists()
    # Processes like the first one: the BLAS of this process was loaded with another number of threads.
    assert cli("run", "s.yaml", "--out", "out", "--resume", "--trace").returncode == 0
    assert cli("run", "s.yaml", "--out", "whole", "--trace").returncode == 0
    # SciPy's solver remembers nothing, so even the extra checkpoint leaves no trace.
    assert_same_result(tmp_path / "whole", tmp_path / "out")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_an_interrupt_while_a_step_is_recorded_waits(
    number: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Row and checkpoint belong together: were only one of them written, there would be no way to go on."""
    recorded = Recorder.step

    def interrupted(self: Recorder, row: Any) -> None:
        if row["step"] == 6:
            os.kill(os.getpid(), number)
        recorded(self, row)

    path = write(rolling({"method": "scipy_direct"}, steps=12), tmp_path / "s.yaml")
    before = signal.getsignal(number)
    with monkeypatch.context() as patch:
        patch.setattr(Recorder, "step", interrupted)
        assert run_scene(path, out=tmp_path / "out") == 130
    assert signal.getsignal(number) is before
    assert facts(tmp_path / "out")["steps"] == 6
    assert len(without_seconds(tmp_path / "out" / "history.csv")) == 6
    assert run_scene(path, out=tmp_path / "out", resume=True) == 0
    assert len(without_seconds(tmp_path / "out" / "history.csv")) == 12


def test_a_finished_run_is_left_as_it_is(tmp_path: Path) -> None:
    path = write(rolling({"method": "scipy_direct"}, steps=6), tmp_path / "s.yaml")
    out = tmp_path / "out"
    assert run_scene(path, out=out) == 0
    kept = {p: p.read_bytes() for p in out.rglob("*.vtu")}
    x, rows = read_checkpoint(out).x, without_seconds(out / "history.csv")
    assert run_scene(path, out=out, resume=True) == 0
    assert facts(out)["status"] == "done"
    assert {p: p.read_bytes() for p in out.rglob("*.vtu")} == kept
    np.testing.assert_array_equal(read_checkpoint(out).x, x)
    assert without_seconds(out / "history.csv") == rows


def test_a_killed_start_begins_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Killed after the folder was made and before the first checkpoint: --resume is what the folder asks for."""
    path = write(rolling({"method": "scipy_direct"}, steps=5), tmp_path / "s.yaml")

    class KilledError(Exception):
        pass

    def killed(*_: Any) -> None:
        raise KilledError

    with monkeypatch.context() as patch:
        patch.setattr(runner, "write_checkpoint", killed)
        with pytest.raises(KilledError):
            run_scene(path, out=tmp_path / "out")
    assert facts(tmp_path / "out")["status"] == "running"
    with pytest.raises(InputError, match="give --resume"):
        run_scene(path, out=tmp_path / "out")
    assert run_scene(path, out=tmp_path / "out", resume=True) == 0
    assert facts(tmp_path / "out")["steps"] == 5


def test_resume_wants_the_same_scene_and_a_sound_checkpoint(tmp_path: Path) -> None:
    path = write(rolling({"method": "scipy_direct"}, steps=5), tmp_path / "s.yaml")
    out = tmp_path / "out"
    with pytest.raises(InputError, match="no checkpoint to resume from"):
        run_scene(path, out=out, resume=True)
    assert not out.exists()
    assert run_scene(path, out=out) == 0
    before = {p: p.read_bytes() for p in out.rglob("*") if p.is_file()}
    with pytest.raises(InputError, match=r"another version of this scene.*--out"):
        run_scene(path, out=out, resume=True, overrides=["time.dt=0.005"])
    (out / "checkpoint.h5").write_bytes(before[out / "checkpoint.h5"][:300])
    with pytest.raises(InputError, match=r"checkpoint\.h5: the checkpoint is damaged"):
        run_scene(path, out=out, resume=True)
    (out / "checkpoint.h5").write_bytes(before[out / "checkpoint.h5"])
    assert {p: p.read_bytes() for p in out.rglob("*") if p.is_file()} == before


def test_a_failed_run_can_be_resumed(tmp_path: Path) -> None:
    path = write(crushed_at(0.55, on_failure={"action": "stop"}), tmp_path / "s.yaml")
    assert run_scene(path, out=tmp_path / "out") == 3
    assert run_scene(path, out=tmp_path / "out", resume=True) == 3
    assert facts(tmp_path / "out")["steps"] == 5


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
    size = np.abs(here.x - Result.open(tmp_path / "here").read_final().points).max()
    np.testing.assert_allclose(fallback.x, here.x, atol=1e-8 * size)


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
    x = read_checkpoint(tmp_path / "out").x

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
