"""The XPBD benchmark on blocks of a few cells; nothing here depends on how fast anything is."""

from __future__ import annotations

import json
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from femdeform import cli
from verification.benchmarks import environment, xpbd, xpbd_case, xpbd_tables
from verification.benchmarks.block import DT, stiffness_number
from verification.benchmarks.child_process import Outcome, run_script
from verification.benchmarks.pbng_case import block as benchmark_block
from verification.benchmarks.step_residual import StepResidual, first_piola, follow
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


@pytest.fixture
def dumped(tmp_path: Path) -> Any:
    path = tmp_path / "block.npz"
    xpbd_case.dump({"cells": 3, "dump": str(path), "dt": DT, "kappas": [0.16, 1.6], "looks": [1, 4]})
    with np.load(path) as arrays:
        return dict(arrays)


def shaken(block: Any) -> Any:
    noise = 0.05 * np.random.default_rng(3).standard_normal(block["positions"].shape)
    noise[block["points"][:, 0] == 0.0] = 0.0
    return block["positions"] + noise


@pytest.mark.parametrize("law", ["neo_hookean", "saint_venant_kirchhoff"])
def test_residual_of_peers_is_that_of_ours(law: str, dumped: Any) -> None:
    simulation = benchmark_block(3, law, "stretch", {"method": "xpbd"}, None)
    problem: Any = simulation.problem
    problem.begin_step(simulation.state, DT)
    x = shaken(dumped)
    ours = problem.residual_norm(problem.gradient(x))
    assert StepResidual(dumped, law).norm(x, DT) == pytest.approx(ours, rel=1e-11)


def test_stress_of_the_law_of_trace_and_determinant() -> None:
    mu, lmbda, step = 3.0, 5.0, 1e-6
    f = np.eye(3) + 0.2 * np.random.default_rng(4).standard_normal((1, 3, 3))

    def energy(g: Any) -> float:
        return 0.5 * mu * ((g**2).sum() - 3.0) ** 2 + 0.5 * lmbda * (np.linalg.det(g)[0] - 1.0) ** 2

    stress = first_piola("trace_and_determinant", mu, lmbda, f)
    for i, j in np.ndindex(3, 3):
        change = np.zeros((1, 3, 3))
        change[0, i, j] = step
        slope = (energy(f + change) - energy(f - change)) / (2.0 * step)
        assert stress[0, i, j] == pytest.approx(slope, rel=1e-7, abs=1e-7)


def test_what_a_peer_reaches(dumped: Any) -> None:
    """Free flight leaves one, whatever the step; what is not finite is told."""
    residual = StepResidual(dumped, "neo_hookean")
    rows = follow(dumped, "neo_hookean", lambda dt, n: residual.flight(dt) if n == 1 else np.full((64, 3), np.nan))
    assert rows == [[1.0, None]] * 2


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
