"""The folder of a comparison and its table: complete, readable, and nobody else's files touched."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from compared import MISBEHAVIOUR, let_misbehave, write_bar

from femdeform.errors import InputError, OutputError
from femdeform.run.compare import Comparison, Variant, compare
from femdeform.run.compare_output import (
    abandon_folder,
    claim_folder,
    state_files,
    summary,
    table_text,
    write_comparison,
)
from femdeform.run.vtu_reader import read_vtu

VARIANTS = [Variant("exact", ("solver.hessian=exact",)), Variant("a / b", ("solver.hessian=projected",))]


@pytest.fixture(scope="module")
def comparison(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    path = write_bar(tmp_path_factory.mktemp("scene"), title="A bar")
    return compare(path, VARIANTS, iterations=4, steps=2)


@pytest.fixture(scope="module")
def diverged(tmp_path_factory: pytest.TempPathFactory) -> Comparison:
    """One fine, one diverged in its second step, one that gives up."""
    with pytest.MonkeyPatch.context() as patch:
        let_misbehave(patch)
        variants = [VARIANTS[0], *(Variant(name, (MISBEHAVIOUR[name],)) for name in ("nan", "stubborn"))]
        return compare(write_bar(tmp_path_factory.mktemp("scene")), variants, iterations=50, steps=2)


def read_rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def written(comparison: Comparison, folder: Path, *further: str) -> Path:
    claim_folder(folder)
    write_comparison(comparison, folder, further)
    return folder


def test_tables_hold_every_number(comparison: Comparison, tmp_path: Path) -> None:
    folder = written(comparison, tmp_path / "new" / "c")
    rows = read_rows(folder / "compare.csv")
    assert [(row["variant"], row["step"]) for row in rows] == [
        (label, step) for label in ("exact", "a / b", "reference") for step in ("1", "2")
    ]
    for row, known in zip(rows, [*comparison.steps, *comparison.reference], strict=True):
        assert set(row) == set(known)
        for name in ("relative_residual", "distance", "total_energy", "linear_momentum_x", "force_scale"):
            assert float(row[name]) == known[name]
        assert row["status"] == known["status"]
    iterations = read_rows(folder / "iterations.csv")
    assert len(iterations) == len(comparison.iterations)
    assert [float(row["residual_norm"]) for row in iterations] == [
        row["residual_norm"] for row in comparison.iterations
    ]
    assert {row["variant"] for row in iterations} == {"exact", "a / b"}


def test_facts(comparison: Comparison, tmp_path: Path) -> None:
    facts = json.loads((written(comparison, tmp_path / "c", "index.html") / "compare.json").read_text())
    assert facts["status"] == "done"
    assert facts["budget"] == {"iterations": 4, "seconds": None}
    assert facts["stiffness_number"] is None  # quasistatic: infinite
    assert facts["title"] == "A bar"
    assert facts["versions"]["numpy"] == np.__version__
    assert facts["variants"]["exact"]["solver"]["hessian"] == "exact"
    assert facts["variants"]["a / b"]["overrides"] == ["solver.hessian=projected"]
    assert facts["reference"]["solver"]["tolerance"] <= 1e-11
    assert [row["variant"] for row in facts["summary"]] == ["exact", "a / b", "reference"]
    assert set(facts["files"]) == {
        *("compare.json", "compare.csv", "iterations.csv", "index.html"),
        *("exact.vtu", "a-b.vtu", "reference.vtu"),
    }


def test_last_states(comparison: Comparison, tmp_path: Path) -> None:
    folder = written(comparison, tmp_path / "c")
    reference = read_vtu(folder / "reference.vtu")
    for label, name in state_files(comparison).items():
        contents = read_vtu(folder / name)
        assert contents.time == pytest.approx(0.5)
        gap = contents.point_data["displacement"] - reference.point_data["displacement"]
        np.testing.assert_allclose(contents.point_data["deviation"], gap, atol=1e-15)
        largest = np.linalg.norm(gap, axis=1).max()
        assert largest == pytest.approx(comparison.of(label)[-1]["distance_max"], abs=1e-15)
    assert np.abs(reference.point_data["displacement"]).max() > 0.1


def test_a_diverged_variant_leaves_no_state(diverged: Comparison, tmp_path: Path) -> None:
    folder = written(diverged, tmp_path / "c")
    assert sorted(path.name for path in folder.glob("*.vtu")) == ["exact.vtu", "reference.vtu", "stubborn.vtu"]
    rows = [row for row in read_rows(folder / "compare.csv") if row["variant"] == "nan"]
    assert [row["status"] for row in rows] == ["converged", "diverged"]
    assert rows[1]["total_energy"] == "nan"
    json.loads((folder / "compare.json").read_text())  # strict JSON, NaN is null


# --------------------------------------------------------------------------------------------------- table


def test_summary_and_table(diverged: Comparison) -> None:
    rows = {row["variant"]: row for row in summary(diverged)}
    assert rows["exact"]["status"] == "converged"
    assert rows["nan"]["status"] == "diverged in step 2: iterate 3 is not finite"
    assert np.isnan(rows["nan"]["relative_residual"])
    assert rows["stubborn"]["status"] == "stopped in 2 of 2 steps: the line search failed"
    assert rows["exact"]["iterations"] == sum(row["iterations"] for row in diverged.of("exact"))
    assert rows["exact"]["relative_residual"] == max(row["relative_residual"] for row in diverged.of("exact"))
    head, blank, titles, rule, *lines = table_text(diverged).splitlines()
    assert head == "bar.yaml: 2 steps from t = 0 s, 50 iterations a step, kappa = inf, 42 degrees of freedom"
    assert blank == ""
    assert titles.split() == [
        *("variant", "iterations", "seconds", "max", "r/R0", "distance", "[m]", "energy", "[J]", "status")
    ]
    assert [line.split()[0] for line in lines] == ["exact", "nan", "stubborn", "reference"]
    # Every column begins, or ends, where its rule does.
    ends = [i for i in range(len(rule)) if rule[i] == "-" and rule[i + 1 : i + 2] != "-"]
    for line in lines:
        assert all(line[end] != " " and line[end + 1 : end + 2] in (" ", "") for end in ends[1:-1])
    assert "-" in lines[1].split()  # no residual to show for what is not a number


def test_budget_spent_in_some_steps(comparison: Comparison) -> None:
    rows = {row["variant"]: row for row in summary(comparison)}
    assert rows["a / b"]["status"] in ("budget spent in 2 of 2 steps", "budget spent in 1 of 2 steps")
    n_spent = sum(row["status"] == "budget spent" for row in comparison.of("a / b"))
    assert rows["a / b"]["status"].startswith(f"budget spent in {n_spent} ")


# -------------------------------------------------------------------------------------------------- folder


def test_a_folder_with_other_files_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(InputError, match="holds files that are not of a comparison; give another folder with --out"):
        claim_folder(tmp_path)
    (tmp_path / "compare.json").write_text('{"files": ["thesis.txt"]}')
    with pytest.raises(InputError, match="not of a comparison"):
        claim_folder(tmp_path)
    with pytest.raises(InputError, match="is a file"):
        claim_folder(tmp_path / "thesis.txt")
    assert (tmp_path / "thesis.txt").read_text() == "years of work"


def test_a_comparison_is_replaced_by_the_next(comparison: Comparison, diverged: Comparison, tmp_path: Path) -> None:
    folder = written(comparison, tmp_path / "c", "index.html")
    (folder / "index.html").write_text("old")
    (folder / "notes.txt").write_text("mine")
    before = (folder / "compare.json").read_bytes()
    claim_folder(folder)
    assert (folder / "compare.json").read_bytes() == before  # the old one is whole until there is a new one
    assert (folder / "a-b.vtu").exists()
    write_comparison(diverged, folder)
    assert sorted(path.name for path in folder.iterdir()) == [
        *("compare.csv", "compare.json", "exact.vtu", "iterations.csv"),
        *("notes.txt", "reference.vtu", "stubborn.vtu"),
    ]


@pytest.mark.parametrize("name", ["../outside.txt", "/{parent}/outside.txt", "sub/inside.txt", 7, None])
def test_a_doctored_list_of_files_reaches_nothing_else(comparison: Comparison, tmp_path: Path, name: Any) -> None:
    folder = written(comparison, tmp_path / "c")
    (tmp_path / "outside.txt").write_text("mine")
    (folder / "sub").mkdir()
    (folder / "sub" / "inside.txt").write_text("mine")
    facts = json.loads((folder / "compare.json").read_text())
    if isinstance(name, str):
        name = name.format(parent=tmp_path)
    (folder / "compare.json").write_text(json.dumps({**facts, "files": [name] if name is not None else 7}))
    claim_folder(folder)
    write_comparison(comparison, folder)
    assert (tmp_path / "outside.txt").exists()
    assert (folder / "sub" / "inside.txt").exists()


def test_a_comparison_that_came_to_nothing_leaves_nothing(comparison: Comparison, tmp_path: Path) -> None:
    claim_folder(tmp_path / "c")
    assert json.loads((tmp_path / "c" / "compare.json").read_text())["status"] == "running"
    claim_folder(tmp_path / "c")  # what a killed one left is taken over
    abandon_folder(tmp_path / "c")
    assert not (tmp_path / "c").exists()
    folder = written(comparison, tmp_path / "d")
    abandon_folder(folder)
    assert (folder / "compare.csv").exists()


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises((OutputError, InputError), match="file"):
        claim_folder(tmp_path / "file" / "c")
