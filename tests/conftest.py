"""What every test may use: the command line as a process, alone or on two MPI ranks."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import pytest

# `scenario` lies beside this file; with pytest's other import modes it would not be found.
sys.path.insert(0, str(Path(__file__).parent))

REPOSITORY = Path(__file__).resolve().parent.parent
MPI_ENVIRONMENT = {
    "OMPI_ALLOW_RUN_AS_ROOT": "1",
    "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
    "OMPI_MCA_rmaps_base_oversubscribe": "1",
    # Spinning ranks would steal the cores of one another where there are fewer cores than ranks.
    "OMPI_MCA_mpi_yield_when_idle": "1",
}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what needs PETSc or MPI where they are missing, and whole scenes unless they are asked for."""
    whole_scenes = bool(os.environ.get("FEMDEFORM_GALLERY"))
    has_petsc = importlib.util.find_spec("petsc4py") is not None
    has_mpi = importlib.util.find_spec("mpi4py") is not None and shutil.which("mpiexec") is not None
    for item in items:
        if item.get_closest_marker("gallery") and not whole_scenes:
            item.add_marker(pytest.mark.skip(reason="a scene of minutes; set FEMDEFORM_GALLERY=1, or `make gallery`"))
        elif item.get_closest_marker("gallery"):
            item.add_marker(pytest.mark.timeout(PATIENCE))
        if item.get_closest_marker("petsc") and not has_petsc:
            item.add_marker(pytest.mark.skip(reason="petsc4py is not installed"))
        if item.get_closest_marker("mpi") and not (has_petsc and has_mpi):
            item.add_marker(pytest.mark.skip(reason="mpiexec, mpi4py or petsc4py is not installed"))


# A process may take this long [s]; scenes of minutes more, on machines that do something else besides.
PATIENCE = 3600.0 if os.environ.get("FEMDEFORM_GALLERY") else 240.0


def environment(extra: Mapping[str, str] | None = None) -> dict[str, str]:
    """Environment of a child process: ours, without what numba was told in this process."""
    inherited = {k: v for k, v in os.environ.items() if k not in ("NUMBA_NUM_THREADS", "FEMDEFORM_EXPORTED_THREADS")}
    path = os.pathsep.join([str(REPOSITORY), *filter(None, [os.environ.get("PYTHONPATH")])])
    return {**inherited, "PYTHONPATH": path, **(extra or {})}


@pytest.fixture(scope="session")
def child_environment() -> dict[str, str]:
    """`environment`, for fixtures that outlive a test."""
    return environment()


@pytest.fixture
def python(tmp_path: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run Python with the given arguments in `tmp_path`; keyword `extra` adds to its environment."""

    def run(
        *arguments: object, extra: Mapping[str, str] | None = None, folder: Path = tmp_path, **options: Any
    ) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, *map(str, arguments)],
            **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options},
            cwd=folder,
            env=environment(extra),
            text=True,
            timeout=PATIENCE,
            check=False,
        )

    return run


@pytest.fixture
def cli(python: Callable[..., subprocess.CompletedProcess[str]]) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run ``femdeform ARGUMENTS`` as a process in `tmp_path`; keywords as for `python`."""
    return partial(python, "-m", "femdeform")


@pytest.fixture
def start(start_python: Callable[..., subprocess.Popen[str]]) -> Callable[..., subprocess.Popen[str]]:
    """Start ``femdeform ARGUMENTS`` as a process in `tmp_path` without waiting for it."""
    return partial(start_python, "-m", "femdeform")


@pytest.fixture
def start_python(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start Python with the given arguments in `tmp_path` without waiting for it; it is killed with the test."""
    started: list[subprocess.Popen[str]] = []

    def begin(*arguments: object) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            [sys.executable, *map(str, arguments)],
            cwd=tmp_path,
            env=environment(),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        return process

    yield begin
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()


@pytest.fixture
def two_ranks(tmp_path: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run Python with the given arguments on two ranks (`ranks` says otherwise) in `tmp_path`."""

    def run(*arguments: object, ranks: int = 2, timeout: float = PATIENCE) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            ["mpiexec", "-n", str(ranks), sys.executable, *map(str, arguments)],
            cwd=tmp_path,
            env=environment(MPI_ENVIRONMENT),
            capture_output=True,
            text=True,
            timeout=timeout,
            check=False,
        )

    return run
