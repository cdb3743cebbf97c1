"""A time step too large: halved as far as allowed, then exit 3 with the reason; what was accepted stays."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from running import Said, bar, contents, facts, rolling
from scenario import quasistatic, write

from femdeform.run.checkpoint import read_checkpoint
from femdeform.run.result import Result
from femdeform.run.table import read_table

Say = Callable[..., Said]


def crushed_at(time: float, **more: Any) -> dict[str, Any]:
    """A bar whose end moves slowly, then by more than its length at once: no step size solves that."""
    path = {
        "kind": "path",
        "on": "b.right",
        "times": [0.0, time, time + 1e-6],
        "displacements": [[0, 0, 0], [0.1, 0, 0], [-3.0, 0, 0]],
    }
    return bar(path, time=quasistatic(dt=0.1), **more)


def test_stop_keeps_the_last_accepted_state(tmp_path: Path, say: Say) -> None:
    scene, out = write(crushed_at(0.55, on_failure={"action": "stop"}), tmp_path / "s.yaml"), tmp_path / "out"
    said = say("run", scene, "--out", out)
    assert (said.code, said.out) == (3, "")
    result = facts(out)
    assert result["status"] == "not_converged"
    assert result["steps"] == 5
    assert result["reason"].startswith("step 6 to t = 0.6 s failed with dt = 0.1 s: ")
    assert "trying" not in said.err
    assert said.err.splitlines()[1] == result["reason"]
    checkpoint = read_checkpoint(out)
    assert checkpoint.step == 5
    assert checkpoint.time == pytest.approx(0.5)
    opened = Result.open(out)
    final = opened.read_final()
    np.testing.assert_array_equal(final.displacement, opened.read_frame(-1).displacement)
    np.testing.assert_array_equal(final.positions, checkpoint.fields["x"])
    assert final.displacement[:, 0].max() == pytest.approx(0.1 * 0.5 / 0.55)
    assert len(opened.history["step"]) == 5
    # To resume is to try again; it ends the same way, and loses nothing.
    kept = {name: data for name, data in contents(out).items() if name.endswith(".vtu")}
    assert say("run", scene, "--out", out, "--resume").code == 3
    assert facts(out)["reason"] == result["reason"]
    assert {name: data for name, data in contents(out).items() if name.endswith(".vtu")} == kept


def test_halving_ends_at_the_smallest_step(tmp_path: Path, say: Say) -> None:
    data = crushed_at(0.55, on_failure={"action": "halve_dt", "min_dt": 0.02})
    said = say("run", write(data, tmp_path / "s.yaml"), "--out", tmp_path / "out")
    assert said.code == 3
    result = facts(tmp_path / "out")
    assert result["status"] == "not_converged"
    assert result["reason"].endswith("; dt cannot be halved below min_dt = 0.02 s")
    # 0.5, then with dt = 0.05 to 0.55, then nothing goes any more.
    assert result["time"] == pytest.approx(0.55)
    table = read_table(tmp_path / "out" / "history.csv")
    np.testing.assert_allclose(table["time"], [0.1, 0.2, 0.3, 0.4, 0.5, 0.55])
    assert list(table["failed_attempts"]) == [0, 0, 0, 0, 0, 1]
    assert "trying dt = 0.05 s" in said.err
    assert (tmp_path / "out" / "final.vtu").exists()
    assert read_checkpoint(tmp_path / "out").step == 6


def test_halving_gets_over_a_hard_step(tmp_path: Path, say: Say) -> None:
    """Half a turn at once takes the law through J = 0: smaller steps for that, then the full size again."""
    turn = {"kind": "rotate", "on": "b.right", "axis": [1, 0, 0], "rate": float(np.pi), "start": 1.0, "stop": 2.0}
    data = bar(turn, time=quasistatic(dt=1.0, end=6.0), on_failure={"min_dt": 0.01})
    out = tmp_path / "out"
    assert say("run", write(data, tmp_path / "s.yaml"), "--out", out, "--trace").code == 0
    table = read_table(out / "history.csv")
    assert table["failed_attempts"].sum() >= 1
    assert table["dt"].min() < 1.0
    assert np.count_nonzero(table["dt"] == 1.0) >= 4  # before and after
    assert table["time"][-1] == pytest.approx(6.0)
    np.testing.assert_allclose(np.cumsum(table["dt"]), table["time"], rtol=1e-12)
    iterations = read_table(out / "iterations.csv")
    assert set(iterations["step"]) <= set(table["step"])
    final = Result.open(out).read_final()
    right = final.points[:, 0] == 1.0
    np.testing.assert_allclose(final.positions[right], final.points[right] * [1, -1, -1] + [0, 0.4, 0.4], atol=1e-12)


OVERFLOWS = {
    "time step": ["time.dt=1e150", "time.end=1e152"],
    "gravity": ["gravity=[0, -1e300, 0]"],
    "a product out of range": ["gravity=[0, -1e308, 0]", "time.dt=10", "time.end=20"],
    "velocity": ["conditions[0].velocity=[0, -1e160, 0]"],
}


@pytest.mark.parametrize("action", ["stop", "halve_dt"])
@pytest.mark.parametrize("overflow", OVERFLOWS)
def test_numbers_out_of_range(overflow: str, action: str, tmp_path: Path, say: Say) -> None:
    """Infinite and undefined numbers make the step fail, in words; no warning of NumPy comes through."""
    scene, out = write(rolling(steps=3), tmp_path / "s.yaml"), tmp_path / "out"
    sets = [f"--set={text}" for text in [*OVERFLOWS[overflow], f"on_failure.action={action}"]]
    said = say("run", scene, "--out", out, *sets)
    assert (said.code, said.out) == (3, "")
    notices = said.err.splitlines()
    reason = notices.pop()
    assert notices.pop().startswith("not_converged: 0 steps")
    assert len(notices) == (0 if action == "stop" else 6)
    assert all(text.startswith("step 1 with dt = ") for text in notices)
    result = facts(out)
    assert (result["status"], result["reason"], result["steps"]) == ("not_converged", reason, 0)
    assert reason.startswith("step 1 to t = ")
    # Without inertia, which an infinite step leaves none of, nothing holds the body.
    words = ("not finite", "line search failed", "the system may be singular")
    assert any(text in reason for text in words)
    final = Result.open(out).read_final()
    assert np.all(final.displacement == 0.0)
    assert read_checkpoint(out).step == 0


def test_out_of_range_on_the_way(tmp_path: Path, say: Say) -> None:
    """A load that explodes after four good steps."""
    data = rolling(steps=8)
    amplitude = {"times": [0.0, 0.045, 0.046], "values": [0.0, 1.0, 1e300]}
    data["conditions"].append({"kind": "traction", "on": "b.top", "value": [0.0, 100.0, 0.0], "amplitude": amplitude})
    scene, out = write(data, tmp_path / "s.yaml"), tmp_path / "out"
    said = say("run", scene, "--out", out, "--set", "on_failure.action=stop", "--quiet")
    assert said.code == 3
    assert (facts(out)["status"], facts(out)["steps"]) == ("not_converged", 4)
    assert read_checkpoint(out).step == 4
    assert np.all(np.isfinite(Result.open(out).read_final().displacement))
