"""The PBNG benchmark on blocks of a few cells; nothing here depends on how fast anything is."""

from __future__ import annotations

import json
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from femdeform import cli
from verification.benchmarks import environment, pbng, pbng_budgets, pbng_case, pbng_tables
from verification.benchmarks.child_process import Outcome, run_script, skipped
from verification.benchmarks.pbng import Results

needs_petsc = pytest.mark.skipif(not environment.has_petsc(), reason="petsc4py is not installed")


@pytest.fixture(autouse=True)
def one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FEMDEFORM_THREADS", "1")


def sweep(law: str, precision: str = "float64", cells: int = 4) -> dict[str, Any]:
    return pbng_case.sweep({"cells": cells, "law": law, "precision": precision, "constraints": True})


@pytest.mark.parametrize("law", pbng.LAWS)
def test_sweeps_are_timed_and_weighed(law: str) -> None:
    double, single = sweep(law), sweep(law, "float32")
    assert (double["n_nodes"], double["n_cells"], double["colors"], double["threads"]) == (125, 320, 5, 1)
    assert double["constraint_colors"] > 20
    # 100 of 125 nodes move; each cell is visited by those of its nodes that do.
    assert 0.7 * 4 * 320 < double["visits"] == single["visits"] < 4 * 320
    assert 0.0 < double["time"]["min"] <= double["time"]["median"] < double["set_up"] + 1.0
    assert double["visit_bytes"] > single["visit_bytes"] > 10
    assert double["flops"] == single["flops"] > 40 * double["visits"]
    assert double["memory"] >= double["mesh_memory"] > 1e7


def test_bytes_of_a_visit_are_those_of_its_arrays() -> None:
    """Three corners, nine gradients, volume and scale with fixed corotated material."""
    assert sweep("fixed_corotated")["visit_bytes"] == 3 * 4 + 11 * 8
    assert sweep("fixed_corotated", "float32")["visit_bytes"] == 3 * 4 + 11 * 4


def convergence(problem: str, solver: dict[str, Any], linear: dict[str, Any] | None = None) -> dict[str, Any]:
    case = {"cells": 4, "law": "neo_hookean", "problem": problem, "solver": solver, "linear_solver": linear}
    return pbng_case.convergence({**case, "levels": pbng.LEVELS, "seconds": 60.0})


@pytest.mark.parametrize("problem", list(pbng.PROBLEMS))
def test_levels_are_reached_one_after_the_other(problem: str) -> None:
    found = convergence(problem, {"method": "pbng", "acceleration": "none"})
    assert found["converged"], found["reason"]
    assert found["start"] > 2.0 * pbng.LEVELS[0]
    sweeps, linear, taken = zip(*found["reached"], strict=True)
    assert list(sweeps) == sorted(sweeps)
    assert list(taken) == sorted(taken)
    assert linear == (0, 0, 0)


def test_newton_steps_count_their_linear_iterations() -> None:
    plain = convergence("twist", {"method": "pbng", "acceleration": "none"})
    finished = convergence("twist", {"method": "pbng", "finish": "newton_krylov"}, {"method": "scipy_direct"})
    assert finished["converged"], finished["reason"]
    assert finished["reached"][-1][0] < plain["reached"][-1][0]
    assert 0 < finished["reached"][-1][1] <= 4


def test_levels_that_are_not_reached_are_dashes() -> None:
    found = convergence("twist", {"method": "pbng", "acceleration": "none", "max_iterations": 20})
    assert not found["converged"]
    assert found["reached"][-1] is None
    results = Results(4, 4, skipped("no time"), convergence={"twist": {"pbng, plain": Outcome("done", found)}})
    table = pbng_tables._convergence(results, "twist")
    assert table.rows[0][-3:-1] == ["-", "-"]
    assert any("no convergence in 20 sweeps" in note for note in table.notes)
    assert pbng_tables.fastest(results.convergence["twist"], "pbng", 2) is None


def test_both_problems_start_away_from_their_solution_with_every_cell_upright() -> None:
    for problem in pbng.PROBLEMS:
        simulation = pbng_case.block(3, "neo_hookean", problem, {"method": "pbng"}, None)
        points, x = simulation.discretization.points, simulation.state.x
        assert np.ptp(x[:, 0]) == pytest.approx(1.1)
        guess = simulation.problem.initial_guess(simulation.state)
        np.testing.assert_allclose(guess, x, atol=1e-12)  # the ends are where they are held
        edges = x[simulation.meshes["block"].cells]
        assert np.all(np.linalg.det(edges[:, 1:] - edges[:, :1]) > 0.0)
        assert np.abs(x - points).max() > 0.09


@needs_petsc
@pytest.mark.petsc
@pytest.mark.parametrize(
    ("problem", "others"),
    [("stretch", ["PBD", "XPBD"]), ("twist", ["PBD", "XPBD-QS, h = 0.001 s", "XPBD-QS, h = 0.01 s"])],
)
def test_equal_budgets(problem: str, others: list[str]) -> None:
    case = {"cells": 4, "law": "fixed_corotated", "problem": problem, "sweeps": [[6, 7]]}
    found = pbng_budgets.budgets({**case, "linear_solver": {"method": "ksp", "preset": "newton-icc"}})
    rows = found["rows"]
    assert [row["name"] for row in rows] == ["PBNG, 6 sweeps", "Newton, 7 CG each", *others]
    assert found["notes"] == []
    assert rows[0]["iterations"] == 6
    # The budgets are so small that some methods may not begin.
    assert 0.0 < rows[0]["energy"] < 1.0
    if problem == "twist":
        assert rows[2]["iterations"] >= 1
        assert rows[2]["residual"] > 5.0 * rows[0]["residual"]


def test_only_the_cases_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    assert environment.is_wanted("growth: neo_hookean, 27 nodes")
    monkeypatch.setenv(environment.ONLY_VARIABLE, "growth; twist, newton")
    assert environment.is_wanted("growth: neo_hookean, 27 nodes")
    assert environment.is_wanted("to a tolerance: twist, newton, hypre 1e-3")
    assert not environment.is_wanted("to a tolerance: stretch, newton, hypre 1e-3")
    monkeypatch.setenv(environment.ONLY_VARIABLE, "64^3, ;not dcdm; not : ic(0)")
    names = ("64^3, rooms: mic(0)", "64^3, rooms: ic(0)", "64^3, rooms: dcdm", "32^3, rooms: mic(0)")
    assert [environment.is_wanted(name) for name in names] == [True, False, False, False]
    monkeypatch.setenv(environment.ONLY_VARIABLE, "not dcdm")
    assert [environment.is_wanted(name) for name in names] == [True, True, False, True]


def test_aims_are_those_of_one_block() -> None:
    done = Outcome("done", {"time": {"median": 2e-3, "min": 2e-3, "max": 2e-3}})
    sweeps = {("neo_hookean", "float64", n): done for n in (2, 1)}
    assert pbng_tables._aims(Results(8, 8, skipped("no time"), sweeps)).rows == []
    (time, threads) = pbng_tables._aims(Results(31, 32, skipped("no time"), sweeps)).rows
    assert time[:2] == ["sweep, neo_hookean, float64", "5 ms"]
    assert threads[1:] == ["1.8 x", "1.0 x"]


def test_large_blocks_are_left_out_where_memory_is_short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pbng, "available_memory", lambda: 1_000_000_000)
    assert pbng.reason_against_size(15) == ""
    assert pbng.reason_against_size(127).startswith("2,097,152 nodes need about 10 GB, 1 GB are free")
    monkeypatch.setattr(pbng, "available_memory", lambda: None)
    assert pbng.reason_against_size(127) == ""


def test_without_petsc_small_blocks_use_scipy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pbng, "has_petsc", lambda: False)
    assert pbng.methods(4)["newton, scipy"][1:] == ({"method": "scipy_direct"}, "")
    assert "fill memory" in pbng.methods(31)["newton, scipy"][2]


def test_peer_without_its_packages_is_skipped(tmp_path: Path) -> None:
    if find_spec("newton") is not None:
        pytest.skip("Newton is installed here")
    script = Path(pbng.__file__).parent / "peers" / pbng.PEER
    assert run_script(Path(sys.executable), script, {"block": "none"}).status == "skipped"


@needs_petsc
@pytest.mark.petsc
def test_the_whole_benchmark(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(environment.CELLS_VARIABLE, "2")
    monkeypatch.setenv("FEMDEFORM_PEERS", str(tmp_path / "none"))
    few = "bandwidth;sweeps;growth;equal budgets;comparison;plain;relaxation;chebyshev;anderson;hypre 1e-3"
    monkeypatch.setenv(environment.ONLY_VARIABLE, few)
    assert cli.main(["bench", "pbng", "--out", str(tmp_path / "out")]) == 0
    data = json.loads((tmp_path / "out" / "bench.json").read_text())["benchmarks"]["pbng"]
    assert {row["status"] for row in data["sweeps"]} == {"done"}
    assert [(row["law"], row["cells"]) for row in data["growth"]] == [(law, n) for law in pbng.LAWS for n in (2, 4)]
    for outcomes in data["convergence"].values():
        done = [outcome for outcome in outcomes.values() if outcome["status"] == "done"]
        assert len(done) >= 5
        assert all(outcome["converged"] for outcome in done)
    assert data["peer"]["status"] == "skipped"
    page = (tmp_path / "out" / "bench.md").read_text()
    for title in ("A plain sweep", "Growth with the mesh", "Equal budgets", "An iteration beside"):
        assert f"### {title}" in page
    assert "### Aims" not in page  # they are those of a larger block
    assert "no Python at" in page
