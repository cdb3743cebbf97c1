"""`femdeform info` says what is there and what is not, whatever that is."""

from __future__ import annotations

import sys
from importlib import metadata

import pytest

from femdeform import info


def rows(text: str) -> dict[str, str]:
    """Name and value of each indented line."""
    lines = [line for line in text.splitlines() if line.startswith("  ")]
    return {line[2:18].strip(): line[18:].strip() for line in lines}


def test_versions_of_this_environment() -> None:
    text = info.describe()
    found = rows(text)
    assert found["version"] == info.own_version()
    assert found["numpy"] == metadata.version("numpy")
    assert found["scikit-fem"] == metadata.version("scikit-fem")
    assert found["Python"].startswith(f"{sys.version_info[0]}.{sys.version_info[1]}.")
    assert int(found["cores"]) >= 1
    assert "MISSING" not in text
    titles = [line for line in text.splitlines() if not line.startswith(" ")]
    assert titles == ["femdeform", "libraries", "linear solvers", "MPI", "threads", "optional parts"]


@pytest.mark.petsc
def test_packages_of_petsc() -> None:
    petsc4py = pytest.importorskip("petsc4py")
    found = rows(info.describe())
    assert found["PETSc"].startswith(".".join(petsc4py.__version__.split(".")[:2]))
    named = found["with"].split(", ") + found.get("without", "").split(", ")
    assert {"mumps", "hypre"} <= set(named)


def test_what_is_missing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("petsc4py", "mpi4py"):
        monkeypatch.setitem(sys.modules, name, None)

    def version(name: str) -> str:
        if name in ("petsc4py", "mpi4py", "imageio-ffmpeg", "scipy"):
            raise metadata.PackageNotFoundError(name)
        return "1.0"

    monkeypatch.setattr(metadata, "version", version)
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("IMAGEIO_FFMPEG_EXE", raising=False)
    found = rows(info.describe())
    assert found["scipy"] == "MISSING"
    assert found["PETSc"] == "not found (petsc4py is not installed)"
    assert found["library"] == "not found (mpi4py is not installed)"
    assert found["ffmpeg"] == "not found, needed for movies"
    assert found["numpy"] == "1.0"


def test_threads_and_cache_follow_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FEMDEFORM_THREADS", "3")
    monkeypatch.setenv("NUMBA_CACHE_DIR", "somewhere")
    found = rows(info.describe())
    assert found["threads a rank"].startswith("3 ")
    assert found["kernel cache"] == "somewhere"
