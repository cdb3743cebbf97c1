"""The benchmarks on blocks small enough to run in seconds; nothing here depends on how fast anything is."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from femdeform import cli
from femdeform.errors import InputError
from verification.benchmarks import child_process, environment, measure, newton, newton_case, newton_tables, run
from verification.benchmarks.block import Block, stiffness_number
from verification.benchmarks.cases import Cases
from verification.benchmarks.child_process import Outcome, skipped
from verification.benchmarks.tables import Cell, Table, megabytes, ratio, seconds

ROOT = Path(run.__file__).resolve().parents[2]
needs_petsc = pytest.mark.skipif(find_spec("petsc4py") is None, reason="petsc4py is not installed")

# ------------------------------------------------------------------------------------------------- names


def test_unknown_benchmark_is_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError, match="did you mean `newton`") as caught:
        run.run_benchmarks(["newtn", "nothing", "newton"], tmp_path / "out")
    assert len(caught.value.faults) == 2
    assert not (tmp_path / "out").exists()
    assert cli.main(["bench", "newtn", "--out", str(tmp_path / "out")]) == 2
    assert "unknown benchmark `newtn`" in capsys.readouterr().err


def test_no_name_means_all_and_each_runs_once() -> None:
    assert run.check_names([]) == list(run.BENCHMARKS)
    assert run.check_names(["newton", "newton"]) == ["newton"]


def test_bench_starts_its_own_ranks(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("OMPI_COMM_WORLD_SIZE", "2")
    with pytest.raises(InputError, match="one rank"):
        run.run_benchmarks([], tmp_path)


@pytest.mark.parametrize("text", ["0", "1", "-3", "six", "2.5"])
def test_size_from_the_environment_is_checked(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(environment.CELLS_VARIABLE, text)
    with pytest.raises(InputError, match="at least 2"):
        newton.block_sizes()


def test_default_sizes_are_those_of_the_literature(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(environment.CELLS_VARIABLE, raising=False)
    cells, peer_cells = newton.block_sizes()
    assert ((cells + 1) ** 3, 5 * cells**3) == (32_768, 148_955)
    assert 5 * peer_cells**3 == 163_840
    assert stiffness_number(peer_cells) == pytest.approx(10.24)


# ------------------------------------------------------------------------------------------------- measuring


def test_measure_counts_calls_and_keeps_the_extremes() -> None:
    calls: list[str] = []
    answer = measure.measure(lambda: calls.append("w"), repetitions=4, warm_up=2, barrier=lambda: calls.append("b"))
    assert "".join(calls) == "ww" + 4 * "bwb"
    assert answer["n"] == 4
    assert 0.0 <= answer["min"] <= answer["median"] <= answer["max"]
    assert measure.summary([3.0, 1.0, 2.0, 10.0]) == {"median": 2.5, "min": 1.0, "max": 10.0, "n": 4}
    with pytest.raises(ValueError, match="at least one"):
        measure.summary([])


def test_time_is_measured_in_seconds() -> None:
    assert 0.02 <= measure.time_once(lambda: time.sleep(0.02)) < 10.0


def test_peak_memory_is_the_process_own_and_needs_no_library() -> None:
    code = f"""
import sys
sys.path.append({str(ROOT)!r})
from verification.benchmarks.measure import peak_memory
before = peak_memory()
block = bytearray(80_000_000)
for i in range(0, len(block), 1024):
    block[i] = 1
after = peak_memory()
assert "numpy" not in sys.modules
print(before, after)
"""
    ballast = np.ones(20_000_000)  # 160 MB in this process, which the child must not count
    answer = subprocess.run([sys.executable, "-I", "-c", code], capture_output=True, text=True, check=True)
    before, after = map(int, answer.stdout.split())
    assert 75e6 < after - before < 100e6
    assert before < 60e6 < ballast.nbytes


# ------------------------------------------------------------------------------------------------- children


def _script(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "script.py"
    path.write_text(text, encoding="utf-8")
    return path


def test_child_reads_a_case_and_hands_back_a_result(tmp_path: Path) -> None:
    script = _script(
        tmp_path,
        "import json, sys\n"
        "case = json.load(open(sys.argv[1]))\n"
        "print('noise')\n"
        "json.dump({'twice': 2 * case['n']}, open(sys.argv[2], 'w'))\n",
    )
    outcome = child_process.run_script(Path(sys.executable), script, {"n": 21})
    assert outcome == Outcome("done", {"twice": 42})


def test_child_may_say_why_it_skips(tmp_path: Path) -> None:
    script = _script(tmp_path, "import json, sys\njson.dump({'skipped': 'no such thing'}, open(sys.argv[2], 'w'))\n")
    assert child_process.run_script(Path(sys.executable), script, {}) == skipped("no such thing")


def test_broken_child_costs_one_line(tmp_path: Path) -> None:
    script = _script(tmp_path, "raise ValueError('out of luck')\n")
    outcome = child_process.run_script(Path(sys.executable), script, {})
    assert (outcome.status, outcome.reason) == ("failed", "ValueError: out of luck")
    quiet = _script(tmp_path, "import sys; sys.exit(7)\n")
    assert child_process.run_script(Path(sys.executable), quiet, {}).reason == "ended with code 7"


def _is_running(pid: str) -> bool:
    try:
        state = Path("/proc", pid, "stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"  # ended, but nobody has waited for it yet


def test_child_that_takes_too_long_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(child_process, "_PATIENCE", 1.0)
    pid_file = tmp_path / "pid"
    script = _script(
        tmp_path,
        "import subprocess, sys\n"
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)'])\n"
        f"open({str(pid_file)!r}, 'w').write(str(child.pid))\n"
        "child.wait()\n",
    )
    outcome = child_process.run_script(Path(sys.executable), script, {})
    assert outcome.status == "failed"
    assert "took more than" in outcome.reason
    if Path("/proc/self/stat").is_file() and pid_file.is_file():
        wait_until = time.monotonic() + 20.0
        while _is_running(pid_file.read_text()) and time.monotonic() < wait_until:
            time.sleep(0.05)
        assert not _is_running(pid_file.read_text())


def test_environment_with_peers_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(environment.PEERS_VARIABLE, str(tmp_path / "nowhere"))
    python, reason = environment.peers_python()
    assert python is None
    assert "nowhere" in reason
    assert environment.PEERS_VARIABLE in reason
    executable = tmp_path / "bin" / "python"
    executable.parent.mkdir()
    executable.write_text("#!/bin/sh\n")
    executable.chmod(0o755)
    monkeypatch.setenv(environment.PEERS_VARIABLE, str(tmp_path))
    assert environment.peers_python() == (executable, "")
    monkeypatch.setenv(environment.PEERS_VARIABLE, str(executable))
    assert environment.peers_python() == (executable, "")


# ------------------------------------------------------------------------------------------------- cases


def test_state_is_clamped_uninverted_and_stretched() -> None:
    block = Block(4, quasistatic=True)
    points, x = block.simulation.discretization.points, block.begin(1.0)
    fixed = points[:, 0] == 0.0
    assert np.array_equal(x[fixed], points[fixed])
    assert fixed.sum() == 25
    assert x[points[:, 0] == 1.0, 0].mean() == pytest.approx(1.1, abs=2e-3)
    corners = x[block.simulation.meshes["block"].cells]
    assert np.linalg.det(corners[:, 1:] - corners[:, :1]).min() > 0.0
    assert block.problem.residual_norm(block.problem.gradient(x)) > 0.0


def test_assembly_case_agrees_with_plain_scikit_fem(tmp_path: Path) -> None:
    from verification.benchmarks.peers import scikit_fem_block

    dump = tmp_path / "block.npz"
    result = newton_case.assembly({"cells": 4, "dump": str(dump)})
    assert (result["n_cells"], result["n_nodes"], result["n_dofs"]) == (320, 125, 375)
    for key in ("energy", "residual", "tangent_projected", "tangent_exact"):
        assert result[key]["n"] >= 5
        assert 0.0 < result[key]["min"] <= result[key]["median"] <= result[key]["max"]
    assert (result["all"] is None) == (find_spec("petsc4py") is None)
    with np.load(dump) as arrays:
        theirs = scikit_fem_block.compare(arrays)
        assert np.linalg.norm(arrays["load"].sum(axis=0)) == pytest.approx(9810.0)
    assert theirs["difference_forces"] < 1e-12
    assert theirs["difference_product"] < 1e-12


@needs_petsc
@pytest.mark.petsc
@pytest.mark.parametrize("quasistatic", [True, False])
@pytest.mark.parametrize("preset", newton.newton_presets())
def test_iteration_case_solves_the_linear_system(preset: str, quasistatic: bool) -> None:
    solver = {"method": "ksp", "preset": preset}
    result = newton_case.iteration({"cells": 5, "quasistatic": quasistatic, "linear_solver": solver})
    assert result["converged"]
    assert result["iterations"] >= 1
    assert result["relative_residual"] < (1e-10 if preset == "newton-mumps" else 3e-6)
    repeated = result["repeated"]
    assert {row["n"] for row in repeated.values()} == {measure.REPETITIONS}
    parts = sum(repeated[name]["min"] for name in ("residual", "tangent", "solve"))
    assert parts <= repeated["whole"]["max"]
    assert result["memory"][0] >= result["memory_before_solve"][0] > 1e7


def test_iteration_case_without_petsc_uses_what_it_is_told() -> None:
    direct = {"method": "scipy_direct"}
    result = newton_case.iteration({"cells": 3, "quasistatic": True, "linear_solver": direct})
    assert result["solver"] == "scipy_direct"
    assert result["relative_residual"] < 1e-10


def test_large_direct_solves_are_skipped_with_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(newton, "has_petsc", lambda: True)
    assert newton.reason_to_skip("newton-mumps", newton.NODES_BLOCK) == ""
    assert "GB" in newton.reason_to_skip("newton-mumps", 120)
    assert newton.reason_to_skip("newton-gamg", 120) == ""
    monkeypatch.setattr(newton, "has_petsc", lambda: False)
    assert newton.reason_to_skip("newton-gamg", 6) == "petsc4py is not installed"


# ------------------------------------------------------------------------------------------------- tables


def _times(value: float) -> dict[str, float]:
    return {"median": value, "min": 0.9 * value, "max": 1.2 * value, "n": 5}


def _iteration(whole: float, converged: bool = True) -> Outcome:
    names = ("residual", "tangent", "solve")
    data: dict[str, Any] = {
        "first": dict.fromkeys((*names, "whole"), whole),
        "repeated": {name: _times(whole / 3) for name in names} | {"whole": _times(whole)},
        "iterations": 12,
        "converged": converged,
        "reason": "converged rtol" if converged else "diverged its",
        "relative_residual": 9e-7,
        "memory_before_solve": [100_000_000],
        "memory": [140_000_000],
    }
    return Outcome("done", data)


def _results() -> newton.Results:
    keys = ("energy", "residual", "tangent_projected", "tangent_exact", "values", "all")
    assembly = Outcome("done", {key: _times(0.1) for key in keys} | {"n_cells": 1080, "threads": 2, "memory": 10**8})
    statics = {"newton-a": _iteration(3.0), "newton-b": _iteration(2.0), "newton-c": _iteration(1.0, False)}
    results = newton.Results(6, 6, {"threads": assembly}, {"statics": statics, "dynamics": {}})
    best = newton.fastest(statics)
    assert best == "newton-b"
    results.best["statics"] = best
    results.ranks["statics"] = {1: _iteration(2.0), 2: _iteration(1.25)}
    results.ranks["dynamics"] = {2: skipped("mpiexec not found")}
    results.own = {"assembly": assembly, "iteration": _iteration(2.0)}
    felupe = {"residual": _times(0.2), "tangent": _times(0.6), "both": _times(0.75), "memory": 2 * 10**8}
    results.peers = {"FElupe": Outcome("done", felupe), "scikit-fem": skipped("not there")}
    return results


def test_ratios_and_speed_ups_in_the_tables() -> None:
    found = newton_tables.findings(_results())
    tables = {table.title.split(",")[0]: table for table in found.tables}
    beside = {row[0]: row[1:] for row in tables["Beside other codes"].rows}
    assert beside["residual"][-1] == "2.0 x"
    assert beside["residual + tangent (ours into PETSc)"][-1] == "7.5 x"
    assert beside["memory of assembly"] == ["100 MB", "200 MB", "2.0 x"]
    assert "scikit-fem skipped: not there." in tables["Beside other codes"].notes
    aims = {row[0]: row[1:] for row in tables["Aims"].rows}
    assert aims["two ranks against one, statics"] == ["1.6 x", "1.6 x"]
    assert aims["two ranks against one, dynamics"] == ["1.6 x", "-"]
    assert aims["residual + tangent in PETSc, against scikit-fem"] == ["40 x", "-"]
    assert any("mpiexec not found" in note for note in tables["Two ranks"].notes)
    assert "diverged its" in next(t for t in found.tables if "statics" in t.title).to_markdown()
    assert found.failures == []
    assert found.data["iterations"]["statics"]["newton-b"]["repeated"]["whole"]["median"] == 2.0


def test_a_broken_case_of_our_own_fails_the_benchmark(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    results = _results()
    results.iterations["statics"]["newton-a"] = Outcome("failed", {}, "segmentation fault")
    results.peers["FElupe"] = Outcome("failed", {}, "its own affair")
    found = newton_tables.findings(results)
    assert found.failures == ["newton-a, statics: segmentation fault"]
    monkeypatch.setattr(newton, "run_newton", lambda cases: found)
    assert run.run_benchmarks(["newton"], tmp_path) == 1
    assert "failed: newton: newton-a, statics: segmentation fault" in capsys.readouterr().out
    text = (tmp_path / "bench.md").read_text()
    assert "Failed: newton-a" in text
    assert "FElupe failed: its own affair." in text


def test_table_in_markdown_and_on_the_screen() -> None:
    table = Table("Times [s]", ["", "a|b"], [["row", seconds(_times(0.02))], ["x|y", seconds(None)]], ["A note."])
    lines = table.to_markdown().splitlines()
    assert lines[0] == "### Times [s]"
    assert "| row | 20 ms [18 ms, 24 ms] |" in lines
    assert "|  | a\\|b |" in lines
    assert "| x\\|y | - |" in lines
    assert lines[-1] == "A note."
    rich_table = table.to_rich()
    assert list(rich_table.columns[1].cells) == ["20 ms", "-"]


def test_quantities_as_text() -> None:
    assert (seconds(2.5), seconds(0.25), seconds(0.0004)) == ("2.5 s", "250 ms", "0.4 ms")
    assert seconds(_times(2.0)) == Cell("2 s", "2 s [1.8 s, 2.4 s]")
    assert ratio(_times(0.3), _times(0.1)) == "3.0 x"
    assert ratio(None, _times(0.1)) == "-"
    assert megabytes(123_456_789) == "123 MB"


# ------------------------------------------------------------------------------------------------- all of it


@needs_petsc
@pytest.mark.petsc
@pytest.mark.slow
def test_newton_benchmark_from_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(environment.CELLS_VARIABLE, "6")
    monkeypatch.setenv("FEMDEFORM_THREADS", "1")
    monkeypatch.setenv(environment.PEERS_VARIABLE, str(tmp_path / "no-peers"))
    monkeypatch.setattr(newton, "newton_presets", lambda: ["newton-icc"])
    monkeypatch.setattr(newton, "reason_against_ranks", lambda: "not in this test")
    assert cli.main(["bench", "newton", "--out", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    assert "newton-icc" in printed
    assert "there is no Python at" in printed
    document = json.loads((tmp_path / "out" / "bench.json").read_text())
    assert document["machine"]["cores"] >= 1
    assert document["machine"]["processor"]
    assert "numpy" in document["machine"]["versions"]
    data = document["benchmarks"]["newton"]
    assert data["assembly"]["threads"]["n_cells"] == 1080
    assert data["assembly"]["threads"]["threads"] == 1
    assert data["assembly"]["threads"]["all"]["n"] >= 5
    for mode in ("statics", "dynamics"):
        assert data["iterations"][mode]["newton-icc"]["relative_residual"] < 3e-6
        assert data["best"][mode] == "newton-icc"
        assert data["ranks"][mode]["2"] == {"status": "skipped", "reason": "not in this test"}
    steps = [data["iterations"][mode]["newton-icc"]["iterations"] for mode in ("statics", "dynamics")]
    assert steps[0] > steps[1] > 1
    assert {peer["status"] for peer in data["peers"].values()} == {"skipped"}
    text = (tmp_path / "out" / "bench.md").read_text()
    assert "343 nodes, 1,080 tetrahedra, 1,029 degrees of freedom" in text
    assert "kappa = h^2 E / (rho dx^2) = 0.36" in text


@pytest.mark.mpi
@pytest.mark.petsc
@pytest.mark.skipif(bool(newton.reason_against_ranks()), reason=newton.reason_against_ranks() or "two ranks are there")
def test_two_ranks_solve_the_same_system() -> None:
    results = newton.Results(5, 5, best={"statics": "newton-icc"})
    newton._two_ranks(results, Cases(lambda _: None))
    one, two = (results.ranks["statics"][n] for n in (1, 2))
    assert (one.status, two.status) == ("done", "done"), (one.reason, two.reason)
    assert (one.data["ranks"], two.data["ranks"]) == (1, 2)
    assert one.data["n_dofs"] == two.data["n_dofs"] == 648
    assert len(two.data["memory"]) == 2
    assert max(one.data["relative_residual"], two.data["relative_residual"]) < 3e-6
    assert results.ranks["dynamics"] == {2: skipped("no preset converged on one rank")}
