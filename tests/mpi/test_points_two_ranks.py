"""Material points on two ranks: the grid solve is shared, the answer is that of one rank."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import numpy as np
import pytest
from ruamel.yaml import YAML

from femdeform.run.checkpoint import read_checkpoint
from femdeform.run.result import Result
from femdeform.run.runner import run_scene

pytestmark = pytest.mark.mpi

Ranks = Callable[..., CompletedProcess[str]]
RUN = ("-m", "femdeform", "run")


def points_scene(dim: int, linear_solver: dict[str, Any]) -> dict[str, Any]:
    """A drop with tension that changes with temperature, and a jelly on a ramp that rubs, beside a wall that sticks."""
    spin: Any = 3.0 if dim == 2 else [0.0, 1.0, 3.0]
    z, flat = ([], []) if dim == 2 else ([0.5], [0.0])
    heat = {"capacity": 1.0, "conductivity": 0.5, "transfer": 1.0, "ambient": 20.0}
    return {
        "simulation": "material_points",
        "grid": {"cell_size": 0.0625, "low": [0.0] * dim, "high": [1.0] * dim},
        "bodies": {
            "drop": {
                "shape": {"kind": "sphere", "center": [0.35, 0.4, *z], "radius": 0.14},
                "liquid": {"density": 10.0, "bulk_modulus": 100.0, "viscosity": 0.02},
                "surface_tension": {
                    "liquid_gas": {"kind": "table", "temperatures": [0.0, 20.0], "values": [0.1, 0.3]},
                },
                "velocity": [1.0, -0.5, *z],
                "temperature": {"value": 5.0, "gradient": [20.0, 0.0, *z], "at": [0.35, 0.4, *z]},
                "heat": heat,
            },
            "jelly": {
                "shape": {"kind": "box", "min": [0.6, 0.35, *[0.4 for _ in z]], "max": [0.8, 0.5, *[0.6 for _ in z]]},
                "solid": {"law": "neo_hookean", "density": 10.0, "youngs_modulus": 400.0, "poisson_ratio": 0.3},
                "angular_velocity": spin,
                "heat": heat,
            },
        },
        "walls": [
            {
                "shape": {"kind": "plane", "point": [0.5, 0.25, *z], "normal": [-0.2, 1.0, *flat]},
                "kind": "separate",
                "friction": 0.3,
            },
            {
                "shape": {"kind": "plane", "point": [0.2, 0.0, *z], "normal": [1.0, 0.0, *flat]},
                "kind": "stick",
            },
        ],
        "gravity": [0.0, -5.0, *flat],
        "time": {"dt": 0.01, "end": 0.12 if dim == 2 else 0.04},
        "solver": {"tolerance": 1e-10},
        "linear_solver": linear_solver,
        "measure": {"x": {"kind": "centroid", "component": "x"}},
        "output": {"every": 4},
    }


def written(data: dict[str, Any], path: Path) -> Path:
    with path.open("w") as file:
        YAML().dump(data, file)
    return path


SOLVERS = {
    "direct": {"preset": "newton-mumps"},
    "jacobi": {"preset": "newton-pbjacobi", "options": {"ksp_rtol": 1e-10}},
    "free": {"method": "block_cg", "tolerance": 1e-10},
}


@pytest.mark.parametrize(("dim", "solver"), [(2, "direct"), (2, "jacobi"), (2, "free"), (3, "direct")])
def test_the_same_answer_as_on_one_rank(dim: int, solver: str, tmp_path: Path, two_ranks: Ranks) -> None:
    path = written(points_scene(dim, SOLVERS[solver]), tmp_path / "s.yaml")
    done = two_ranks(*RUN, "s.yaml", "--out", "two")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("done:") == 1
    assert run_scene(path, out=tmp_path / "one", quiet=True) == 0
    one, two = Result.open(tmp_path / "one"), Result.open(tmp_path / "two")
    assert (one.facts["ranks"], two.facts["ranks"]) == (1, 2)
    assert len(two.frames) == len(one.frames)
    assert list(two.history["step"]) == list(one.history["step"])
    np.testing.assert_array_equal(two.history["nodes"], one.history["nodes"])
    a, b = (read_checkpoint(tmp_path / name).fields for name in ("one", "two"))
    moved = np.abs(a["v"]).max()
    assert moved > 0.5
    np.testing.assert_allclose(b["x"], a["x"], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(b["v"], a["v"], rtol=0.0, atol=1e-6 * moved)
    np.testing.assert_allclose(b["temperature"], a["temperature"], rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(two.history["measure.x"], one.history["measure.x"], rtol=0.0, atol=1e-9)


def test_explicit_steps_run_on_one_rank(tmp_path: Path, two_ranks: Ranks) -> None:
    data = points_scene(2, SOLVERS["direct"])
    data["time"]["scheme"] = "explicit"
    written(data, tmp_path / "s.yaml")
    done = two_ranks(*RUN, "s.yaml", "--out", "two")
    assert done.returncode == 2
    assert done.stderr.count("explicit steps of material points run on one rank") == 1
