"""Lazy names: they exist, they import nothing by themselves, and what is missing is said in one line."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

from femdeform import registry
from femdeform.errors import MissingDependencyError
from femdeform.scene import schema
from femdeform.scene.annotations import alternatives, take_apart
from femdeform.scene.point_schema import PointLinearSolver


def words(annotation: object, key: str) -> set[str]:
    """Words that choose a member of a union of the schema."""
    from typing import get_args

    models = alternatives(take_apart(annotation))
    return {word for model in models for word in get_args(model.model_fields[key].annotation)}


def test_every_word_of_the_schema_has_its_class() -> None:
    assert words(schema.Solver, "method") == set(registry.SOLVERS)
    linear = words(schema.LinearSolver, "method") | words(PointLinearSolver, "method")
    assert linear == set(registry.LINEAR_SOLVERS)


@pytest.mark.parametrize(
    "spec",
    [
        *registry.SOLVERS.values(),
        *registry.LINEAR_SOLVERS.values(),
        *registry.MESH.values(),
        registry.INITIAL_CONTACT,
    ],
)
def test_every_module_is_there(spec: str) -> None:
    module, colon, attribute = spec.partition(":")
    assert colon
    assert attribute
    assert importlib.util.find_spec(module) is not None


def test_resolve(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "plugged_in.py").write_text("class Solver:\n    pass\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    assert registry.resolve("plugged_in:Solver").__name__ == "Solver"


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("import nowhere_to_be_found", "Thing needs nowhere_to_be_found, which is not installed"),
        (
            "raise ModuleNotFoundError('No module', name='petsc4py')",
            "Thing needs petsc4py, which is not installed; install it with: pip install 'femdeform[petsc]'",
        ),
        ("raise ImportError('libpetsc.so: cannot open')", "Thing cannot be used here: libpetsc.so: cannot open"),
        (
            "raise ImportError('libmpi.so: cannot open', name='mpi4py.MPI')",
            "Thing cannot be used here: libmpi.so: cannot open",
        ),
    ],
)
def test_what_is_not_installed(line: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "needy.py").write_text(line + "\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(MissingDependencyError) as caught:
        registry.resolve("needy:Thing")
    assert str(caught.value) == message
    assert "needy" not in sys.modules


def test_a_missing_module_of_our_own_is_a_bug() -> None:
    with pytest.raises(ModuleNotFoundError, match=r"solvers\.nowhere"):
        registry.resolve("solvers.nowhere:Thing")


def test_presets_are_the_files_of_their_folder() -> None:
    folder = Path(__file__).parents[2] / "solvers" / "presets"
    names = registry.preset_names()
    assert list(names) == sorted(path.stem for path in folder.glob("*.yaml"))
    assert schema.KSPLinearSolver().preset in names
