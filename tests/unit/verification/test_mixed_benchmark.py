"""The mixed benchmark on bodies of a few cells; nothing here depends on how fast anything is."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from femdeform import cli
from femdeform.errors import InputError
from meshes.writers import write_mesh
from verification.benchmarks import environment, mixed, mixed_bodies, mixed_case, mixed_iteration_tables, mixed_tables
from verification.benchmarks.cases import Cases
from verification.benchmarks.child_process import Outcome, skipped
from verification.benchmarks.mixed_bodies import TABLE, Body, TableRow

needs_petsc = pytest.mark.skipif(not environment.has_petsc(), reason="petsc4py is not installed")
DIRECT = {"method": "scipy_direct"}
# The beam's law and moduli on a block of 3^3 cells.
SMALL = TABLE[6].body.small(3)


@pytest.fixture(autouse=True)
def one_thread_without_published_meshes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("FEMDEFORM_THREADS", "1")
    monkeypatch.setenv(mixed_bodies.DATA_VARIABLE, str(tmp_path / "nothing"))


def variant(solver: dict[str, Any] | None = None, linear_solver: dict[str, Any] | None = None) -> dict[str, Any]:
    return {"solver": solver or {}, "linear_solver": linear_solver or DIRECT}


def substep(variants: dict[str, dict[str, Any]], body: Body = SMALL) -> dict[str, Any]:
    return mixed_case.substep({"body": body.case(), "dt": 0.01, "variants": variants})


# ------------------------------------------------------------------------------------------------- bodies


def test_rows_are_those_of_the_table() -> None:
    """Published sizes: nodes q and elements T."""
    published = [
        (5929, 11552),
        (5929, 11552),
        (675, 2019),
        (452, 1140),
        *[(6000, 29142)] * 3,
        (699, 2274),
        (34834, 69664),
        (500, 2434),
        *[(4079, 15555)] * 2,
    ]
    assert len(TABLE) == len(published)
    meshes: dict[str, Any] = {}
    for row, (n_nodes, n_cells) in zip(TABLE, published, strict=True):
        key = json.dumps(row.body.case()["mesh"]) + str(row.body.edges)
        if key not in meshes:
            meshes[key] = mixed_bodies.body_mesh(row.body.case())
        mesh = meshes[key]
        assert mesh.n_cells == pytest.approx(n_cells, rel=0.1), row.body.name
        assert len(mesh.points) == pytest.approx(n_nodes, rel=0.2), row.body.name
        assert {"solid": 4, "membrane": 3, "rod": 2}[row.body.kind] == mesh.cells.shape[1]
        assert row.paper is not None


def test_published_meshes_are_preferred(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (row,) = (row for row in TABLE if row.body.name == "Rods Bunny")
    assert row.body.case()["edges"]
    (tmp_path / "meshes").mkdir()
    block = mixed_bodies.body_mesh(SMALL.case())
    write_mesh(replace(block, points=1000.0 * block.points), tmp_path / "meshes" / row.body.file)
    monkeypatch.setenv(mixed_bodies.DATA_VARIABLE, str(tmp_path))
    case = row.body.case()
    mesh = mixed_bodies.body_mesh(case)
    assert case["mesh"]["file"] == str(tmp_path / "meshes" / row.body.file)
    assert not case["edges"]
    assert mesh.cells.shape[1] == 2
    np.testing.assert_allclose(mesh.points.max(axis=0), 1.0)


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.body.name)
def test_bodies_are_held_as_they_say_and_spin(row: TableRow) -> None:
    simulation = mixed_bodies.thrown(row.body.small(3).case(), 0.01, {"method": "mixed_fem"}, DIRECT)
    points, held = simulation.discretization.points, ~simulation.problem.free.all(axis=1)
    if row.body.held == "nowhere":
        assert not held.any()
    else:
        axis, end = (1, points[:, 1].max()) if row.body.held == "top" else (0, points[:, 0].min())
        assert np.array_equal(held, np.isclose(points[:, axis], end))
    speed = np.linalg.norm(simulation.state.v, axis=1)
    assert speed[~held].max() > 0.1
    material = simulation.discretization.groups[0]
    assert material.kind == row.body.kind


# ------------------------------------------------------------------------------------------------- substeps


def test_phases_are_parts_of_the_substep() -> None:
    found = substep({"direct": variant()})
    assert (found["n_nodes"], found["n_cells"], found["threads"]) == (64, 135, 1)
    result = found["variants"]["direct"]
    times = result["times"]
    assert set(times) == {"whole", *mixed_case.PHASES}
    assert all(times[phase]["min"] > 0.0 for phase in mixed_case.PHASES)
    assert sum(times[phase]["min"] for phase in mixed_case.PHASES) <= times["whole"]["max"]
    assert result["sum"]["median"] <= times["whole"]["max"]
    assert result["linear_iterations"] == 1
    assert max(result["momentum"], result["constraint"]) < 1e-12
    assert result["memory"] >= result["memory_before"] > 1e7


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.body.name)
def test_every_row_can_be_stepped(row: TableRow) -> None:
    result = substep({"direct": variant()}, row.body.small(2))["variants"]["direct"]
    assert result["times"]["whole"]["n"] >= 5
    assert max(result["momentum"], result["constraint"]) < 1e-9


def stepped(solver: dict[str, Any]) -> tuple[Any, Any, np.ndarray, np.ndarray, dict[str, Any]]:
    """One substep: problem, scheme, positions before and after its linear solve, and its row of the log."""
    options = {"method": "mixed_fem", "scheme": "alternating", "inner_iterations": 1, **solver}
    simulation = mixed_bodies.thrown(SMALL.case(), 0.01, options, DIRECT)
    problem, state, rows = simulation.problem, simulation.state, []
    problem.begin_step(state, 0.01)
    simulation.solver.step(problem, state, lambda row, x: rows.append((dict(row), x.copy())))
    row, x = rows[-1]
    return problem, simulation.solver._alternating, problem.predictor(state), x, row  # type: ignore[attr-defined]


def test_block_rows_are_those_of_the_saddle_solver() -> None:
    problem, scheme, start, end, row = stepped({"global_solve": "kkt_minres", "kkt_tolerance": 1e-2})
    found = mixed_case.block_rows(problem, scheme, start, end)
    np.testing.assert_allclose(found, (row["kkt_momentum_residual"], row["kkt_constraint_residual"]), rtol=1e-6)
    assert min(found) > 1e-8


def test_block_rows_notice_what_is_wrong() -> None:
    problem, scheme, start, end, _ = stepped({})
    assert max(mixed_case.block_rows(problem, scheme, start, end)) < 1e-12
    moved = end + 1e-3 * problem.free * np.abs(end - start).max()
    assert mixed_case.block_rows(problem, scheme, start, moved)[0] > 1e-5
    scheme.groups[0].L *= 1.01
    assert min(mixed_case.block_rows(problem, scheme, start, end)) > 1e-5


@needs_petsc
@pytest.mark.petsc
def test_the_loosest_sufficient_tolerance_is_timed() -> None:
    icc = variant(linear_solver={"method": "ksp", "preset": "newton-icc"})
    found = substep({"three": {**icc, "tolerances": ["0.9", "1e-5", "1e-9"]}, "one": {**icc, "tolerances": ["0.9"]}})
    three, one = found["variants"]["three"], found["variants"]["one"]
    assert three["tolerance"] == "1e-5"
    assert three["momentum"] < 1e-3
    assert one["momentum"] > 1e-3
    assert "times" not in one


@needs_petsc
@pytest.mark.petsc
def test_every_way_to_solve_the_saddle_system() -> None:
    found = substep(mixed.linear_solvers() | mixed.saddle_solvers())["variants"]
    assert {"newton-icc", "newton-mumps", "kkt_direct", "kkt_minres", "kkt_cg"} <= set(found)
    assert all(max(result["momentum"], result["constraint"]) <= 1e-3 for result in found.values())
    assert found["kkt_minres"]["linear_iterations"] > found["kkt_direct"]["linear_iterations"] == 1


def test_large_bodies_are_left_out_without_petsc(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mixed, "has_petsc", lambda: False)
    assert set(mixed.linear_solvers()) == {"scipy_direct"}
    monkeypatch.setattr(mixed_case, "_SCIPY_DOFS", 100)
    assert "100 degrees of freedom" in substep(mixed.linear_solvers())["variants"]["scipy_direct"]["reason"]


# ------------------------------------------------------------------------------------------------- iterations


def test_single_iterations_are_timed() -> None:
    variants = {name: variant(solver) for name, solver in mixed.METHODS.items()}
    found = mixed_case.iteration({"body": SMALL.case(), "dt": 1.0 / 30.0, "variants": variants})
    for result in found["variants"].values():
        assert result["whole"]["n"] == len(result["linear_iterations"]) >= 2
        assert 0.0 < result["solve"]["min"] < result["whole"]["max"]


@pytest.mark.parametrize("kind", ["twist", "sag"])
def test_methods_find_one_solution_in_countable_iterations(kind: str) -> None:
    case = {"problem": kind, "law": "corotated", "modulus": 1e5, "cells": [4, 2, 2], "linear_solver": DIRECT}
    variants = {name: {**solver, "tolerance": 1e-9} for name, solver in mixed.COUNTED.items()}
    found = mixed_case.counts({**case, "variants": variants})["variants"]
    assert all(result["converged"] and result["difference"] < 1e-6 for result in found.values())
    assert found["mixed"]["iterations"] < found["Newton, projected"]["iterations"]
    hasty = mixed_case.counts({**case, "variants": {"hasty": {"max_iterations": 2}}})["variants"]["hasty"]
    assert not hasty["converged"]
    assert "2 iterations" in hasty["reason"]


# ------------------------------------------------------------------------------------------------- tables


def test_exponent_and_crossing() -> None:
    sizes = [10.0, 100.0, 1000.0, 10000.0]
    cubic = [(n, 2.0 * n**1.5) for n in sizes]
    assert mixed_iteration_tables.exponent(cubic) == "1.50"
    assert mixed_iteration_tables.exponent([(1.0, 77.0), *cubic]) == "1.50"
    assert mixed_iteration_tables.exponent(cubic[:2]) == "-"
    linear = [(n, 40.0 * n) for n in sizes]
    assert mixed_iteration_tables.crossing(linear, cubic) == pytest.approx(400.0)
    assert mixed_iteration_tables.crossing(linear[3:], cubic[3:]) == 0.0
    assert mixed_iteration_tables.crossing(linear[:2], cubic[:2]) is None
    assert mixed_iteration_tables.crossing(cubic, linear) is None


def _times(value: float) -> dict[str, float]:
    return {"median": value, "min": value, "max": value, "n": 5}


def _timed(total: float, tolerance: str = "") -> dict[str, Any]:
    phases = {"assembly": 0.2, "solve": 0.5, "local": 0.3}
    return {
        "times": {"whole": _times(1.5 * total)} | {name: _times(part * total) for name, part in phases.items()},
        "sum": _times(total),
        "linear_iterations": 7,
        "momentum": 1e-5,
        "constraint": 1e-14,
        "tolerance": tolerance,
        "memory_before": 10**8,
        "memory": 15 * 10**7,
    }


def _outcome(variants: dict[str, Any]) -> Outcome:
    return Outcome("done", {"n_nodes": 10, "n_cells": 20, "n_dofs": 30, "threads": 2, "variants": variants})


def _results() -> mixed.Results:
    rows = [row for row in TABLE if row.body.name in ("Beam NH", "Tet Bunny", "Rod Armadillo")]
    results = mixed.Results(rows)
    inaccurate = {"linear_iterations": 99, "momentum": 0.25, "constraint": 1e-14, "tolerance": "1e-6"}
    results.table = {
        "Rod Armadillo": _outcome({"newton-icc": inaccurate}),
        "Beam NH": _outcome({"newton-icc": _timed(0.029, "1e-4"), "newton-mumps": _timed(0.1)}),
        "Tet Bunny": skipped("no mesh"),
    }
    iterations = {"newton": 0.08, "mixed": 0.1}
    for method, value in iterations.items():
        variants = {"newton-icc": {"reason": "broken"}} | {
            name: {"whole": _times(seconds), "solve": _times(0.5 * seconds), "linear_iterations": [3, 5]}
            for name, seconds in (("newton-mumps", value), ("newton-hypre", 2.0 * value))
        }
        results.iterations.setdefault("spot", {})[method] = _outcome(variants)
    results.references["spot"] = (0.2, 0.3)
    for cells in (2, 4, 8):
        mumps, icc = _timed(1e-6 * cells**6), _timed(1.6e-5 * cells**3, "1e-6")
        results.growth[cells] = {
            "newton-mumps": _outcome({"newton-mumps": mumps}),
            "newton-icc": _outcome({"newton-icc": icc}),
        }
    counted = {
        name: {"iterations": n, "converged": True, "reason": "", "seconds": 1.0, "difference": 1e-9}
        for name, n in zip(mixed.COUNTED, (20, 12, 8), strict=True)
    }
    results.counts = {("twist", "corotated", 1e8): _outcome(counted), ("sag", "corotated", 1e4): _outcome(counted)}
    return results


def test_what_the_tables_say() -> None:
    found = mixed_tables.findings(_results())
    tables = {table.title.split(",")[0].split(":")[0]: table for table in found.tables[1:]}
    assert found.failures == []
    (row,) = found.tables[0].rows
    assert row[:4] == ["Beam NH", "recipe block", "10 / 20", "icc, 1e-4"]
    assert row[-3:] == ["7", "1e-05", "1e-14"]
    assert "Tet Bunny skipped: no mesh." in found.tables[0].notes
    assert "Rod Armadillo: no solver brings both block rows below 0.001." in found.tables[0].notes
    beside = {row[0]: row[1:] for row in found.tables[1].rows}
    assert beside["Beam NH"] == [
        "5.8 / 14.5 / 8.7",
        "29",
        "8.88 / 169 / 3.21",
        "181",
        "6.24 x",
        "25.6 / 23.8 / 8.3",
        "57.7",
        "1.99 x",
    ]
    assert beside["Rod Armadillo"] == ["-", "-", "1.01 / 0.48 / 0.73", "2.22", "-", "-", "-", "-"]
    by_solver = {row[0]: row[1:] for row in found.tables[2].rows}
    assert by_solver["Rod Armadillo"] == ["2e-01 (99) *", "-"]
    assert by_solver["Beam NH"] == ["29 ms (7)", "100 ms (7)"]
    iterations = tables["One iteration"].rows
    assert [row[2] for row in iterations] == ["newton-mumps", "newton-mumps"]
    assert [row[-2:] for row in iterations] == [["2.5 x", "1.00"], ["3.0 x", "1.25"]]
    growth = tables["Growth with the mesh"]
    assert growth.rows[-1][:5] == ["exponent", "2.00", "2.00", "2.00", "1.00"]
    # 1e-6 c^6 = 1.6e-5 c^3 at c^3 = 16.
    assert "newton-icc overtakes the factorisation at about 80 tetrahedra." in growth.notes
    aims = {row[0]: row[1:] for row in tables["Aims"].rows}
    assert aims["substep, Beam NH, against C++"] == ["2 x", "2.0 x"]
    assert aims["substep, Tet Bunny, against C++"] == ["2 x", "-"]
    assert aims["Newton iteration, spot, against C++"] == ["2.5 x", "2.5 x"]
    assert aims["mixed iteration over Newton's, spot"] == ["at most 1.3", "1.25"]
    twist = "iterations over Newton's (projected), quarter turn in 1/30 s, corotated, 1e+08 Pa"
    assert aims[twist] == ["at most 0.5", "0.40"]
    assert found.data["table"]["Beam NH"]["variants"]["newton-icc"]["sum"]["median"] == 0.029
    json.dumps(found.data)


def test_a_broken_case_fails_the_benchmark() -> None:
    results = _results()
    results.growth[4]["newton-icc"] = Outcome("failed", {}, "segmentation fault")
    found = mixed_tables.findings(results)
    assert found.failures == ["4^3 cells, newton-icc: segmentation fault"]


# ------------------------------------------------------------------------------------------------- all of it


def test_size_from_the_environment_is_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(environment.CELLS_VARIABLE, "one")
    with pytest.raises(InputError, match="at least 2"):
        mixed.run_mixed(Cases(lambda _: None))


@needs_petsc
@pytest.mark.petsc
@pytest.mark.slow
def test_mixed_benchmark_from_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(environment.CELLS_VARIABLE, "2")
    monkeypatch.setattr(mixed, "TABLE", TABLE[1:3])
    monkeypatch.setattr(mixed, "PROBLEMS", mixed.PROBLEMS[1:2])
    monkeypatch.setattr(mixed, "ITERATION_BODIES", dict(list(mixed_bodies.ITERATION_BODIES.items())[:1]))
    monkeypatch.setattr(mixed, "_GROWTH_PRESETS", ("newton-mumps",))
    assert cli.main(["bench", "mixed", "--out", str(tmp_path / "out")]) == 0
    assert "Growth with the mesh" in capsys.readouterr().out
    data = json.loads((tmp_path / "out" / "bench.json").read_text())["benchmarks"]["mixed"]
    assert data["table"]["Rod Armadillo"]["variants"]["newton-mumps"]["sum"]["n"] >= 5
    assert data["table"]["Square Cloth (stiff)"]["reference_ms"] is None
    assert set(data["growth"]) == {"2", "3", "4"}
    text = (tmp_path / "out" / "bench.md").read_text()
    assert "| Rod Armadillo | recipe block | 27 / 90 |" in text
    assert "C++ / ours" in text
