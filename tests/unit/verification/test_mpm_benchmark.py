"""The material point benchmark with few points; nothing here depends on how fast anything is."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from femdeform import cli
from verification.benchmarks import mpm, mpm_case, mpm_step_case, mpm_tables
from verification.benchmarks.child_process import Outcome, run_script, skipped
from verification.benchmarks.mpm import Results


@pytest.fixture(autouse=True)
def one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FEMDEFORM_THREADS", "1")


def steps(law: str = "neo_hookean", dtype: str = "float64", transfer: str = "apic") -> dict[str, Any]:
    return mpm_case.steps({"points": 512, "nodes": 16, "law": law, "dtype": dtype, "transfer": transfer})


@pytest.mark.parametrize("dtype", mpm.DTYPES)
def test_steps_are_timed_and_momentum_is_gravity_s(dtype: str) -> None:
    found = steps(dtype=dtype)
    assert found["n"] == 512
    assert 0.0 < sum(found["phases"].values()) < 2.0 * found["time"]["max"]
    assert found["momentum"] < (1e-11 if dtype == "float64" else 1e-2)


@pytest.mark.parametrize(("law", "transfer"), mpm.OTHERS)
def test_other_materials_and_transfers(law: str, transfer: str) -> None:
    assert steps(law, transfer=transfer)["momentum"] < 1e-11


def test_parts_of_a_sampled_step_are_timed() -> None:
    found = mpm_case.sampled({"points": 512, "nodes": 16})
    assert found["n"] == 512
    assert found["samples"] > 100
    assert set(found["phases"]) == set(mpm_case.SAMPLED_PHASES)
    assert all(seconds > 0.0 for seconds in found["phases"].values())


@pytest.mark.parametrize("dim", [2, 3])
def test_conjugate_gradients_take_more_iterations_with_the_courant_number(dim: int) -> None:
    def iterations(method: str) -> list[int]:
        case = {"dim": dim, "cells": 12, "numbers": [0.5, 10.0], "method": method}
        found = mpm_step_case.courant(case)
        assert found["converged"] == [True, True]
        return list(found["iterations"])

    few, many = iterations("block_cg")
    assert 1 < few < many / 2


@pytest.mark.petsc
def test_a_direct_solve_takes_one_iteration() -> None:
    case = {"dim": 2, "cells": 12, "numbers": [0.5, 10.0], "method": "newton-mumps"}
    assert mpm_step_case.courant(case)["iterations"] == [1, 1]


@pytest.mark.slow
def test_parts_of_steps_of_a_scene_make_up_the_step() -> None:
    found = mpm_step_case.steps_of_scene({"scene": "wine-glass", "steps": 5})
    phases = found["phases"]
    assert found["n"] > 500
    assert all(phases[name] > 0.0 for name in ("sampling", "split", "to grid", "to points"))
    assert phases["solve"] > 0.0
    assert phases["heat"] == 0.0
    assert sum(phases.values()) < 2.0 * phases["step"]


def test_tables() -> None:
    data = steps()
    done = Outcome("done", data)
    results = Results(mpm.POINTS, mpm.NODES)
    results.main = {("float64", 2): done, ("float32", 2): Outcome("failed", {}, "it broke")}
    results.growth = {(512, "float64"): done}
    results.others = {("liquid", "apic"): done}
    results.sampled = {2: Outcome("done", mpm_case.sampled({"points": 64, "nodes": 16}))}
    results.scenes = {"impact": Outcome("failed", {}, "it fell")}
    case = {"dim": 2, "cells": 12, "numbers": mpm.COURANT, "method": "block_cg"}
    results.courant = {(2, "block_cg"): Outcome("done", mpm_step_case.courant(case))}
    peer = {"time": data["time"], "n": 512, "threads": 2, "notes": ["version 1"]}
    results.peers = {"float64": Outcome("done", peer), "float32": skipped("no Taichi")}
    found = mpm_tables.findings(results)
    text = "\n".join(table.to_markdown() for table in found.tables)
    assert "| million points/s, float64 | 5 |" in text
    assert "1.0 x" in text
    assert "| 2 threads | 64 |" in text
    assert "Taichi, float32 skipped: no Taichi." in text
    assert "float32, 2 threads failed: it broke." in text
    assert "impact failed: it fell." in text
    assert "| block_cg | " in text
    assert found.failures == ["steps, float32, 2 threads: it broke", "scene, impact: it fell"]
    json.dumps(found.data)


def test_a_peer_without_taichi_is_skipped(tmp_path: Path) -> None:
    blocked = tmp_path / "taichi.py"
    blocked.write_text("raise ImportError('not here')\n", encoding="utf-8")
    script = Path(mpm.__file__).parent / "peers" / "taichi_mpm.py"
    copy = tmp_path / "run.py"
    first = f"import sys, runpy; sys.path.insert(0, {str(tmp_path)!r})"
    copy.write_text(f"{first}\nrunpy.run_path({str(script)!r}, run_name='__main__')", encoding="utf-8")
    outcome = run_script(Path(sys.executable), copy, {"dtype": "float64"})
    assert outcome.status == "skipped"
    assert "Taichi is not installed" in outcome.reason


def test_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FEMDEFORM_BENCH_CELLS", "4")
    monkeypatch.setenv("FEMDEFORM_BENCH_ONLY", "steps: float64, 1 thread;peers")
    monkeypatch.setenv("FEMDEFORM_PEERS", str(tmp_path / "none"))
    assert cli.main(["bench", "mpm", "--out", str(tmp_path)]) == 0
    data = json.loads((tmp_path / "bench.json").read_text(encoding="utf-8"))["benchmarks"]["mpm"]
    assert data["main"][0]["n"] == 512
    assert data["peers"]["float64"]["status"] == "skipped"
