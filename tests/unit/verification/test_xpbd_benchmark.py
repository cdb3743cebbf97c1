"""The XPBD benchmark on blocks of a few cells; nothing here depends on how fast anything is."""

from __future__ import annotations

import json
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from femdeform import cli
from verification.benchmarks import environment, xpbd, xpbd_case, xpbd_tables
from verification.benchmarks.block import DT, stiffness_number
from verification.benchmarks.child_process import Outcome, run_script
from verification.benchmarks.xpbd import Results


@pytest.fixture(autouse=True)
def one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FEMDEFORM_THREADS", "1")


def sweeps(method: str, law: str = "fixed_corotated") -> dict[str, Any]:
    return xpbd_case.sweeps({"cells": 4, "law": law, "method": method, "kappas": [0.16, 1.6], "looks": [2, 10]})


@pytest.mark.parametrize("method", xpbd.METHODS)
def test_sweeps_are_timed_and_followed(method: str) -> None:
    found = sweeps(method)
    assert (found["n_cells"], found["threads"]) == (320, 1)
    assert found["colors"] > 20
    assert 0.0 < found["time"]["min"] <= found["time"]["median"]
    (early, late), _ = found["reached"]
    if "pxpbd" in method:
        assert late < 0.1 * early
    else:  # they stagnate
        assert late > 0.5 * early


def test_stiffness_numbers_are_those_of_the_time_step() -> None:
    assert xpbd_case.time_step(stiffness_number(7), 7) == pytest.approx(DT)


def test_residuals_that_are_not_finite_are_dashes() -> None:
    data = {"time": {"median": 1.0, "min": 1.0, "max": 1.0}, "reached": [[0.5, None, None]] * 3}
    results = Results(8, {("fixed_corotated", "xpbd", 2): Outcome("done", data)})
    assert xpbd_tables._residuals(results, "fixed_corotated").rows == [["xpbd", *["5.0e-01 / - / -"] * 3]]
    assert xpbd_tables._aims(results).rows == []
    results.cells = 31
    (row,) = xpbd_tables._aims(results).rows
    assert row[:2] == ["xpbd, fixed_corotated", "8 ms"]


@pytest.mark.parametrize("script", ["pypbd_block.py", "newton_xpbd.py"])
def test_peers_without_their_packages_are_skipped(script: str) -> None:
    if find_spec("newton") is not None or find_spec("pypbd") is not None:
        pytest.skip("they are installed here")
    path = Path(xpbd.__file__).parent / "peers" / script
    assert run_script(Path(sys.executable), path, {"block": "none"}).status == "skipped"


def test_the_whole_benchmark_of_xpbd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(environment.CELLS_VARIABLE, "2")
    monkeypatch.setenv("FEMDEFORM_PEERS", str(tmp_path / "none"))
    assert cli.main(["bench", "xpbd", "--out", str(tmp_path / "out")]) == 0
    data = json.loads((tmp_path / "out" / "bench.json").read_text())["benchmarks"]["xpbd"]
    assert [row["status"] for row in data["sweeps"]] == ["done"] * 9
    assert {peer["status"] for peer in data["peers"].values()} == {"skipped"}
    page = (tmp_path / "out" / "bench.md").read_text()
    for title in ("A sweep over the cells", "Residual after 5 / 20 / 60 sweeps, neo_hookean", "An iteration beside"):
        assert f"### {title}" in page
