"""The benchmark of deep conjugate directions on grids of a few voxels."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from femdeform import cli
from solvers.linear.poisson.conjugate_gradients import ConjugateGradients
from solvers.linear.poisson.dcdm_network import Architecture, glorot_parameters
from solvers.linear.poisson.incomplete_cholesky import IncompleteCholesky
from solvers.linear.poisson.multigrid import Multigrid
from solvers.linear.poisson.weights_file import Weights, save_weights
from verification.benchmarks import dcdm, dcdm_case, dcdm_tables, environment, learned_weights
from verification.benchmarks.child_process import Outcome
from verification.benchmarks.heat_system import HeatSystem
from verification.benchmarks.poisson import Grid


@pytest.fixture(autouse=True)
def one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FEMDEFORM_THREADS", "1")


@pytest.fixture
def weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Weights in the plane that nobody trained, and that the benchmark knows."""
    options = {"channels": 4, "left": 0, "low": 1, "up": 0}
    parameters = glorot_parameters(Architecture(2, **options), np.random.default_rng(0))  # type: ignore[arg-type]
    save_weights(tmp_path / "poor.npz", Weights({"kind": "dcdm", "dim": 2, "architecture": options}, parameters))
    monkeypatch.setenv(learned_weights.WEIGHTS_VARIABLE, str(tmp_path / "poor.npz"))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("number", [0.5, 1e3])
def test_the_matrix_of_a_heat_step(dim: int, number: float) -> None:
    """(I + k L)/k with known temperatures around: its eigenvalues are known, and solvers of pressures find T."""
    n = 12 if dim == 2 else 8
    system = HeatSystem(n, dim, number)
    assert system.n_closed == 0
    assert system.n_unknowns == (n - 2) ** dim
    lowest = np.linalg.eigvalsh(system.matrix().toarray())[0]
    # T is given at the centres of the outer voxels, n - 1 voxels apart.
    assert lowest == pytest.approx(1.0 / number + dim * (2.0 - 2.0 * np.cos(np.pi / (n - 1))), rel=1e-12)
    b = system.hot_ball(number)
    expected = np.linalg.solve(system.matrix().toarray(), system.restrict(b))
    for preconditioner in (None, IncompleteCholesky(system), Multigrid(system)):
        answer = ConjugateGradients(system, preconditioner).solve(b, 1e-10, 200)
        assert answer.converged
        np.testing.assert_allclose(system.restrict(answer.x), expected, atol=1e-8)
    assert expected.min() > 0.0
    assert expected.max() < 1.0


def test_iterations_of_a_curve() -> None:
    assert dcdm_tables.iterations([1.0, 0.1, 1e-4, 1e-5], 1e-4) == 2
    assert dcdm_tables.iterations([1.0, 0.1], 1e-4) is None


def test_a_comparison_of_kept_directions() -> None:
    """With the shipped weights, which reach their tolerance; the more directions are kept the sooner."""
    found = dcdm_case.compare({"cells": 16, "dim": 2, "frames": [1, 2], "open": True})["curves"]
    assert list(found) == ["dcdm, kept 1", "dcdm, kept 2", "dcdm, kept all", "spd_lmg", "mg v(2,2)", "ic(0)", "cg"]
    for curves in found.values():
        assert len(curves) == 2
        for curve in curves:
            assert curve[0] == pytest.approx(1.0)
            assert curve[-1] <= 1e-6
    assert len(found["dcdm, kept all"][0]) < len(found["dcdm, kept 1"][0])


def test_failures_are_said() -> None:
    curve = {"dcdm, kept 2": [[1.0, 0.5, 0.2], [1.0, 1e-5, 1e-7]], "cg": [[1.0, 1e-5, 1e-7]] * 2}
    results = dcdm.Results(8, 16, {(Grid(8, 2), True): Outcome("done", {"curves": curve})})
    results.networks["8 channels"] = Outcome("failed", {}, "broken")
    found = dcdm_tables.findings(results)
    assert found.failures == ["8 channels broken"]
    row = found.tables[0].rows[0]
    assert [getattr(entry, "long", entry) for entry in row] == [
        "8^2, open",
        "1 of 2 not in 2 / 1 of 2 not in 2",
        "1 / 2",
        "0 / 0",
    ]


def test_the_whole_benchmark_of_dcdm(tmp_path: Path, weights: None, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("torch")
    monkeypatch.setenv(environment.CELLS_VARIABLE, "8")
    monkeypatch.setenv(environment.ONLY_VARIABLE, "8^2; 8^3: heat; training: 8 channels; trained as; transfer")
    monkeypatch.setattr(dcdm, "STEPS", 2)
    monkeypatch.setattr(learned_weights, "missing_weights", lambda _, dim: "" if dim == 2 else "there are none")
    out = tmp_path / "out"
    assert cli.main(["bench", "dcdm", "--out", str(out)]) == 0
    data = json.loads((out / "bench.json").read_text())["benchmarks"]["dcdm"]
    assert [(row["dim"], row["open"], row["status"]) for row in data["pressures"]] == [
        (2, False, "done"),
        (2, True, "done"),
    ]
    assert [(row["dim"], row["status"]) for row in data["heat"]] == [(2, "done"), (3, "skipped")]
    assert [row["network"] for row in data["networks"]] == ["the same, trained as the source's", "8 channels"]
    assert all(row["status"] == "done" for row in data["networks"])
    assert data["networks"][0]["n_parameters"] == 32_657
    # Weights of either size on three grids; the picture is of the largest.
    assert [(row["trained_on"], list(row["curves"])) for row in data["transfer"]] == [
        (8, ["8", "16", "32"]),
        (16, ["8", "16", "32"]),
    ]
    # Two steps leave the weights of the start the best ones, the same for both; what they were trained on differs.
    assert data["transfer"][0]["loss"] != data["transfer"][1]["loss"]
    assert all(curve[0][0] == 1.0 for row in data["transfer"] for curve in row["curves"].values())
    pictures = {path.name for path in out.glob("*.png")}
    names = [f"dcdm-{kind}-8-2d-{word}.png" for kind in ("solvers", "kept") for word in ("open", "closed")]
    assert pictures == {*names, "dcdm-networks.png", "dcdm-transfer.png", "dcdm-heat-8-2d.png"}
    assert "8^3: skipped: there are none" in (out / "bench.md").read_text()
