"""A comparison written down: the same answer as from the command line, and every fault at its line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from compared import write_bar

from femdeform import cli
from femdeform.errors import InputError
from femdeform.post.compare_command import compare_command
from femdeform.scene.comparison_schema import is_comparison, load_comparison


def written(folder: Path, budget: str = "iterations: 2", variants: str = "exact: {solver.hessian: exact}") -> Path:
    scene = write_bar(folder)
    path = folder / "two.yaml"
    path.write_text(f"title: Two\nscene: {scene.name}\nvariants:\n  {variants}\n{budget}\n", encoding="utf-8")
    return path


def facts(folder: Path) -> dict[str, object]:
    found: dict[str, object] = json.loads((folder / "compare.json").read_text(encoding="utf-8"))
    return found


def test_a_file_says_what_the_command_line_says(tmp_path: Path) -> None:
    path = written(tmp_path)
    assert is_comparison(path)
    assert not is_comparison(tmp_path / load_comparison(path).file.scene)
    assert compare_command(path, {}, out=tmp_path / "a", quiet=True) == 0
    option_sets = ["exact: solver.hessian=exact"]
    scene = load_comparison(path).scene_path
    assert compare_command(scene, {"iterations": 2}, option_sets=option_sets, out=tmp_path / "b", quiet=True) == 0
    by_file, by_words = facts(tmp_path / "a"), facts(tmp_path / "b")
    assert by_file["title"] == "Two"
    assert by_file["budget"] == by_words["budget"] == {"iterations": 2, "seconds": None}
    rows = [[{**row, "seconds": 0} for row in found["summary"]] for found in (by_file, by_words)]  # type: ignore[attr-defined]
    assert rows[0] == rows[1]


def test_what_is_given_beside_the_file_goes_before(tmp_path: Path) -> None:
    path = written(tmp_path)
    words = ["compare", str(path), "--seconds", "9", "--variant", "own: solver.tolerance=1e-3", "--quiet"]
    assert cli.main([*words, "--out", str(tmp_path / "o")]) == 0
    found = facts(tmp_path / "o")
    assert found["budget"] == {"iterations": None, "seconds": 9.0}
    assert list(found["variants"]) == ["exact", "own"]  # type: ignore[call-overload]


@pytest.mark.parametrize(
    ("budget", "variants", "fault"),
    [
        ("steps: 1", "a: {solver.hessian: exact}", "needs a budget: either `iterations` or `seconds`"),
        ("iterations: 1\nseconds: 1.0", "a: {solver.hessian: exact}", "needs a budget"),
        ("iterations: 1", "a: 3", "two.yaml:4: variants.a: must be a mapping"),
        ("iterations: 1", "a: {'solver..hessian': exact}", "is not a key of a scene"),
    ],
)
def test_faults_are_named(tmp_path: Path, budget: str, variants: str, fault: str) -> None:
    with pytest.raises(InputError) as error:
        load_comparison(written(tmp_path, budget, variants))
    assert any(fault in str(found) for found in error.value.faults)


def test_a_missing_scene_is_a_fault_of_the_file(tmp_path: Path) -> None:
    path = written(tmp_path)
    path.write_text(path.read_text(encoding="utf-8").replace("scene: ", "scene: not-"), encoding="utf-8")
    with pytest.raises(InputError, match=r"two\.yaml:2: scene: there is no file not-"):
        load_comparison(path)


def test_a_scene_needs_a_budget(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["compare", str(write_bar(tmp_path)), "--methods", "projected_newton"]) == 2
    assert "give a budget of either iterations or seconds" in capsys.readouterr().err
