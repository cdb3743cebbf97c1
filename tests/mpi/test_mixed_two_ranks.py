"""Mixed finite elements on two MPI ranks: the serial answer, condensed and as a saddle system."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenario import block, body, material, scene, write

from femdeform.run.checkpoint import read_checkpoint
from femdeform.run.runner import run_scene
from femdeform.run.table import read_table

pytestmark = pytest.mark.mpi

RUN = ("-m", "femdeform", "run")
TIGHT = {"method": "mixed_fem", "tolerance": 1e-12}
FIXED = {"method": "mixed_fem", "scheme": "alternating", "inner_iterations": 3}
TIKHONOV = {"per": "compliance", "value": 0.1}


def deck(solver: dict[str, Any], preset: str) -> dict[str, Any]:
    return scene(
        {
            "a": body(block([0.5, 0.3, 0.3], [4, 2, 2], translate=[0, 0.01, 0]), material(E=5e4), mass="consistent"),
            "c": body({"recipe": "cloth", "cells": [5, 5], "translate": [0, 1, 0]}, kind="membrane", thickness=0.01),
        },
        {"kind": "initial_velocity", "on": "a", "velocity": [1.0, -1.0, 0.0], "angular_velocity": [0, 2, 3]},
        {"kind": "fixed", "on": "c.left"},
        {"kind": "translate", "on": "c.right", "velocity": [-0.3, 0.1, 0.0]},
        gravity=[0.0, -9.81, 0.0],
        obstacles=[{"kind": "plane", "point": [0, 0, 0], "normal": [0, 1, 0]}],
        time={"scheme": "backward_euler", "dt": 0.01, "end": 0.05},
        solver=solver,
        linear_solver={"method": "ksp", "preset": preset},
    )


@pytest.mark.parametrize(
    ("solver", "preset"),
    [
        pytest.param(TIGHT, "newton-icc", id="condensed"),
        pytest.param(TIGHT, "newton-ssor", id="condensed-ssor"),
        pytest.param({**TIGHT, "global_solve": "condensed_cg"}, "newton-mumps", id="constant"),
        pytest.param({**TIGHT, "global_solve": "kkt_direct"}, "newton-mumps", id="saddle"),
        pytest.param({**FIXED, "global_solve": "kkt_minres"}, "newton-mumps", id="alternating-minres"),
        pytest.param({**FIXED, "global_solve": "kkt_cg", "tikhonov": TIKHONOV}, "newton-mumps", id="alternating-cg"),
    ],
)
def test_the_same_answer_as_on_one_rank(
    solver: dict[str, Any], preset: str, tmp_path: Path, two_ranks: Callable[..., subprocess.CompletedProcess[str]]
) -> None:
    path = write(deck(solver, preset), tmp_path / "s.yaml")
    done = two_ranks(*RUN, "s.yaml", "--out", "two")
    assert done.returncode == 0, done.stderr
    assert run_scene(path, out=tmp_path / "one") == 0
    one, two = read_checkpoint(tmp_path / "one"), read_checkpoint(tmp_path / "two")
    assert two.step == one.step == 5
    np.testing.assert_allclose(two.fields["x"], one.fields["x"], rtol=0.0, atol=1e-8)
    a, b = (read_table(tmp_path / name / "history.csv") for name in ("one", "two"))
    np.testing.assert_array_equal(b["iterations"], a["iterations"])
