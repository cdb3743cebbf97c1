"""Sweeps over the nodes refuse two MPI ranks, in words."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from scenario import block, body, scene, write

pytestmark = pytest.mark.mpi


def test_two_ranks_are_refused(tmp_path: Path, two_ranks: Callable[..., subprocess.CompletedProcess[str]]) -> None:
    data = scene(
        {"b": body(block([1.0, 0.5, 0.5], [4, 2, 2]))},
        {"kind": "fixed", "on": "b.left"},
        solver={"method": "pbng"},
        linear_solver={"method": "ksp"},
    )
    write(data, tmp_path / "s.yaml")
    done = two_ranks("-m", "femdeform", "run", "s.yaml", "--out", "two")
    assert done.returncode == 2
    assert "solver.method: pbng runs on one rank, with threads" in done.stderr
