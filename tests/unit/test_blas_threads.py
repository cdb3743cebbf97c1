"""Threads of the BLASes: NumPy's and SciPy's one, PETSc's those of the kernels; the user's wish before ours."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import pytest

from femdeform.blas_threads import begin_with_one, go_on_with, is_chosen

NAMES = ("OPENBLAS_NUM_THREADS", "GOTO_NUM_THREADS", "OMP_NUM_THREADS", "FEMDEFORM_OPENBLAS_THREADS")

# Prints the threads of each OpenBLAS of a process that runs kernels on two threads; then those of its child.
PROGRAM = """
import ctypes, os, subprocess, sys
from femdeform.run.threads import use_threads
import numpy, scipy.linalg
if "early" in sys.argv:
    from petsc4py import PETSc
use_threads(2, 100000)
from solvers.linear.ksp import KSP
KSP()
maps = {line.split()[-1] for line in open("/proc/self/maps") if "openblas" in line and ".so" in line}
for path in sorted(maps):
    library = ctypes.CDLL(path)
    for name in ("scipy_openblas_get_num_threads64_", "scipy_openblas_get_num_threads", "openblas_get_num_threads"):
        if hasattr(library, name):
            print(name, getattr(library, name)())
if "parent" in sys.argv:
    subprocess.run([sys.executable, *sys.argv[:1], "child"], check=True)
"""


@pytest.fixture
def clean(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in NAMES:
        # Set first, so that what a test leaves is taken away again.
        monkeypatch.setenv(name, "0")
        monkeypatch.delenv(name)


@pytest.mark.usefixtures("clean")
def test_one_thread_then_those_of_the_kernels() -> None:
    assert not is_chosen()
    begin_with_one()
    assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
    go_on_with(4)
    assert os.environ["OPENBLAS_NUM_THREADS"] == "4"
    assert not is_chosen()
    # A child process has the same environment, and begins anew.
    begin_with_one()
    assert os.environ["OPENBLAS_NUM_THREADS"] == "1"


@pytest.mark.usefixtures("clean")
def test_what_the_user_says_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "3")
    begin_with_one()
    go_on_with(2)
    assert os.environ["OPENBLAS_NUM_THREADS"] == "3"
    assert is_chosen()
    # Over what a parent process has left.
    monkeypatch.setenv("FEMDEFORM_OPENBLAS_THREADS", "2")
    begin_with_one()
    assert os.environ["OPENBLAS_NUM_THREADS"] == "3"
    monkeypatch.delenv("OPENBLAS_NUM_THREADS")
    for name in ("GOTO_NUM_THREADS", "OMP_NUM_THREADS"):
        monkeypatch.setenv(name, "3")
        begin_with_one()
        assert "OPENBLAS_NUM_THREADS" not in os.environ
        monkeypatch.delenv(name)


def threads_of(tmp_path: Path, more: Mapping[str, str], *words: str) -> list[tuple[str, int]]:
    script = tmp_path / "program.py"
    script.write_text(PROGRAM, encoding="utf-8")
    root = Path(__file__).resolve().parents[2]
    environment = {name: value for name, value in os.environ.items() if name not in (*NAMES, "FEMDEFORM_THREADS")}
    environment |= {"PYTHONPATH": str(root), "NUMBA_NUM_THREADS": "2", **more}
    done = subprocess.run(
        [sys.executable, str(script), *words], env=environment, capture_output=True, text=True, check=True, timeout=120
    )
    return [(line.split()[0], int(line.split()[1])) for line in done.stdout.splitlines()]


@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="needs two cores")
def test_the_libraries_of_a_process(tmp_path: Path) -> None:
    pytest.importorskip("petsc4py")
    for words in (("parent",), ("early",)):
        found = threads_of(tmp_path, {}, *words)
        own = [count for name, count in found if name.startswith("scipy_")]
        petsc = [count for name, count in found if not name.startswith("scipy_")]
        if not own or not petsc:
            pytest.skip("another BLAS")
        assert set(own) == {1}
        assert set(petsc) == {2}
        assert len(own) == (4 if words == ("parent",) else 2)
    chosen = threads_of(tmp_path, {"OPENBLAS_NUM_THREADS": "2"})
    assert {count for _, count in chosen} == {2}
