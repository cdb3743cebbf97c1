"""The Poisson benchmark on grids of a few voxels; nothing here depends on how fast anything is."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import label

from femdeform import cli
from femdeform.flow.pressure_system import FLUID, SOLID, PressureSystem
from solvers.linear.poisson.dcdm_network import Architecture, glorot_parameters
from solvers.linear.poisson.weights_file import Weights, save_weights
from verification.benchmarks import (
    environment,
    learned_weights,
    poisson,
    poisson_case,
    poisson_domains,
    poisson_tables,
)
from verification.benchmarks.child_process import Outcome
from verification.benchmarks.poisson import Results


@pytest.fixture(autouse=True)
def one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FEMDEFORM_THREADS", "1")


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", poisson_domains.HARD)
@pytest.mark.parametrize("n", [8, 16, 32])
def test_a_hard_domain_is_one_room(name: str, n: int, dim: int) -> None:
    labels = poisson_domains.HARD[name](n, dim)
    assert labels.shape == (n,) * dim
    assert set(np.unique(labels)) == {FLUID, SOLID}
    assert label(labels == FLUID)[1] == 1
    system = PressureSystem(labels)
    assert system.n_closed == 1
    for _, b in poisson_domains.random_sides(labels, 2):
        assert abs(b[system.unknown].mean()) < 1e-15
        assert system.norm(b) > 0.0


def test_plates_make_a_long_way() -> None:
    """From the first channel to the last one has to go along all of them."""
    n = 16
    fluid = poisson_domains.plates(n) == FLUID
    reached, steps = np.zeros_like(fluid), 0
    reached[0, -1] = True
    while not reached[-1].any():
        wider = reached.copy()
        for axis in range(3):
            for side in (-1, 1):
                moved = np.roll(reached, side, axis)
                np.moveaxis(moved, axis, 0)[0 if side == 1 else -1] = False
                wider |= moved
        reached, steps = wider & fluid, steps + 1
    assert steps > 3 * (n - 5)


@pytest.mark.parametrize("scene", poisson.FLOWS)
@pytest.mark.parametrize("is_open", [False, True])
@pytest.mark.parametrize("dim", [2, 3])
def test_right_hand_sides_of_flows(scene: str, is_open: bool, dim: int) -> None:
    frames = poisson_domains.record(scene, is_open, 12, (1, 2), dim)
    for labels, b in frames:
        system = PressureSystem(labels)
        assert system.dim == dim
        assert system.n_closed == (0 if is_open else 1)
        assert (np.count_nonzero(labels == SOLID) > 0) == (scene != "plume")
        assert np.all(b[~system.unknown] == 0.0)
        assert system.norm(b) > 0.0
    assert np.array_equal(frames[0][0], frames[1][0]) or scene == "spinning box"


@pytest.fixture
def weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file of weights of deep conjugate directions that nobody trained, and that the benchmark knows."""
    options = {"channels": 4, "left": 0, "low": 1, "up": 0}
    parameters = glorot_parameters(Architecture(3, **options), np.random.default_rng(0))  # type: ignore[arg-type]
    path = tmp_path / "poor.npz"
    save_weights(path, Weights({"kind": "dcdm", "dim": 3, "architecture": options}, parameters))
    monkeypatch.setenv(learned_weights.WEIGHTS_VARIABLE, f" {path} ;")
    return path


def test_whose_weights(weights: Path) -> None:
    assert learned_weights.bench_weights("dcdm", 3).meta["architecture"]["channels"] == 4
    # It is of another method: the shipped ones are taken.
    assert learned_weights.bench_weights("spd_lmg", 3).meta["kind"] == "spd_lmg"
    assert learned_weights.missing_weights("dcdm", 3) == learned_weights.missing_weights("spd_lmg", 2) == ""
    weights.write_bytes(weights.read_bytes()[:-1])
    assert "damaged" in learned_weights.missing_weights("dcdm", 3)


def test_every_solver_by_name(tmp_path: Path, weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(poisson_case._FEWER, "dcdm", 20)
    file = str(tmp_path / "frames.npz")
    case = {"scene": "blob", "open": True, "cells": 12, "dim": 3, "frames": [1, 2], "file": file}
    assert poisson_case.record(case)["n_closed"] == 0
    counts = {}
    for name in poisson_case.SOLVERS:
        if name.startswith("petsc"):
            pytest.importorskip("petsc4py")
        found = poisson_case.solve({"solver": name, "file": file, "tolerances": [1e-4, 1e-6]})
        if name == "dcdm":  # nobody trained it
            assert found["reasons"] == ["20 iterations"]
            assert found["tolerances"]["1e-06"]["iterations"] == [None, None]
            assert len(found["residuals"]) == 21
            continue
        assert found["reasons"] == []
        few, more = (found["tolerances"][tolerance]["iterations"] for tolerance in ("0.0001", "1e-06"))
        assert len(few) == len(more) == 2
        assert all(0 < a <= b for a, b in zip(few, more, strict=True))
        assert len(found["residuals"]) == more[-1] + 1
        # Deflation has done something before its first iteration.
        assert 0.9 < found["residuals"][0] < 1.0 + 1e-9
        assert found["residuals"][-1] <= 1.01e-6
        # The domain rests: it is set up once.
        assert found["set_up"]["n"] == 1
        counts[name] = more[-1]
    assert counts["mg v(2,2)"] < counts["mic(0)"] < counts["cg"]


def test_failures_and_winners_are_said() -> None:
    def done(iterations: list[int | None], time: float, set_up: float) -> Outcome:
        times = {"median": time, "min": time, "max": time, "n": 2}
        row = {"iterations": iterations, "seconds": times}
        set_ups = {**times, "median": set_up}
        data = {"tolerances": {"0.0001": row, "1e-06": row}, "set_up": set_ups, "residuals": [1.0, 1e-7]}
        return Outcome("done", {**data, "reasons": ["5000 iterations"] if None in iterations else [], "memory": 10**7})

    solves = {"cg": done([4, 6], 0.2, 0.0), "mg v(2,2)": done([4, 4], 0.1, 0.3), "mic(0)": done([None, 5], 0.01, 0.0)}
    grid = poisson.Grid(8, 3)
    results = Results([grid], {}, {(grid, "rooms", name): outcome for name, outcome in solves.items()})
    found = poisson_tables.findings(results)
    solved, _, _, quickest = found.tables
    assert [getattr(entry, "long", entry) for entry in solved.rows[0]] == [
        "rooms",
        "5 +- 1.4 / 200 ms",
        "4 / 100 ms",
        "1 of 2 failed",
    ]
    assert solved.notes == ["rooms, mic(0), frames without an answer: 5000 iterations."]
    assert quickest.rows == [["rooms", *["mg v(2,2), 100 ms", "cg, 200 ms"] * 2]]
    assert found.failures == []


def test_the_whole_benchmark_of_poisson(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(environment.CELLS_VARIABLE, "8")
    wanted = "8^3, plates: mg; 8^2, plates: spd; plume, closed: cg; spinning box, open: mic"
    monkeypatch.setenv(environment.ONLY_VARIABLE, wanted)
    assert cli.main(["bench", "poisson", "--out", str(tmp_path / "out")]) == 0
    data = json.loads((tmp_path / "out" / "bench.json").read_text())["benchmarks"]["poisson"]
    found = [(row["dim"], row["scene"], row["solver"], row["status"]) for row in data["solves"]]
    assert found == [
        (2, "plume, closed", "cg", "done"),
        (2, "spinning box, open", "mic(0)", "done"),
        (2, "plates", "spd_lmg", "done"),
        (2, "plates", "spd_lmg v(2,2)", "done"),
        (3, "plume, closed", "cg", "done"),
        (3, "spinning box, open", "mic(0)", "done"),
        (3, "plates", "mg v(1,1)", "done"),
        (3, "plates", "mg v(2,2)", "done"),
    ]
    pictures = {path.name for path in (tmp_path / "out").glob("*.png")}
    scenes = ("plates", "plume-closed", "spinning-box-open")
    assert pictures == {f"poisson-8-{dim}d-{scene}.png" for dim in (2, 3) for scene in scenes}
    page = (tmp_path / "out" / "bench.md").read_text()
    for title in ("8^3 voxels, to 0.0001", "8^3 voxels: set-up of a domain", "8^3 voxels: the quickest"):
        assert f"### {title}" in page
    assert all(f"]({name})" in page for name in pictures)
