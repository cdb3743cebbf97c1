"""Steps of material points that are refused, and what keeps them short."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_point_course import JELLY, facts, points, run, written

from femdeform.mpm.crushed_points import count_crushed
from femdeform.mpm.particles import LIQUID, Particles
from femdeform.run.inputs import read_together
from femdeform.run.point_course import PointCourse
from femdeform.run.runner import run_scene
from femdeform.run.table import read_table

SCHEMES = ["explicit", "backward_euler"]
BLOCK = {"kind": "box", "min": [0.3, 0.3], "max": [0.7, 0.7]}
# As soft as can be, so that nothing else keeps the steps short.
SOFT = {"density": 10.0, "bulk_modulus": 1e-4}
SPACE = {"cell_size": 0.05, "low": [-2.0, -2.0], "high": [4.0, 2.0]}


@pytest.mark.parametrize("scheme", SCHEMES)
def test_nothing_falls_through_a_floor(tmp_path: Path, scheme: str) -> None:
    """From rest, with a step in which gravity alone would carry the body by 18 cells and past the floor."""
    out = run(
        tmp_path,
        grid=SPACE,
        shape={"kind": "sphere", "center": [0.0, 0.3], "radius": 0.1},
        liquid=SOFT,
        walls=[{"shape": {"kind": "box", "min": [-1.0, -0.2], "max": [1.0, 0.0]}, "kind": "slip"}],
        gravity=[0.0, -10.0],
        time={"scheme": scheme, "dt": 0.3, "end": 0.3},
        on_failure={"min_dt": 1e-3},
        measure={"low": {"kind": "lowest", "component": "y"}},
    )
    history = read_table(out / "history.csv")
    assert history["measure.low"].min() > -0.05
    assert history["dt"].max() < 0.1


@pytest.mark.parametrize("scheme", SCHEMES)
def test_steps_follow_walls(tmp_path: Path, scheme: str) -> None:
    """A wall that comes at 10 m/s pushes a body that rests, at its own speed."""
    wall = {"shape": {"kind": "box", "min": [-0.6, -0.5], "max": [-0.1, 0.8]}, "velocity": [10.0, 0.0], "kind": "stick"}
    scene = points(
        grid=SPACE,
        shape={"kind": "box", "min": [0.0, 0.0], "max": [0.2, 0.2]},
        liquid={"density": 10.0, "bulk_modulus": 1.0},
        walls=[wall],
        time={"scheme": scheme, "dt": 0.05, "end": 0.05},
        measure={"fastest": {"kind": "max_speed"}},
        on_failure={"min_dt": 1e-5},
    )
    path = written(scene, tmp_path / "s.yaml")
    course = PointCourse(read_together(path, tmp_path / "o", (), False, False, None), None)
    assert course.step_limit(course.start) == pytest.approx(0.6 * 0.05 / 10.0)
    course.destroy()
    out = tmp_path / "out"
    assert run_scene(path, out=out, threads=1, quiet=True) == 0
    history = read_table(out / "history.csv")
    assert history["dt"].max() <= 0.003 * (1.0 + 1e-9)
    assert history["measure.fastest"].max() < 15.0


@pytest.mark.parametrize("law", ["neo_hookean", "fixed_corotated"])
@pytest.mark.parametrize("heat", [None, {"capacity": 1.0, "conductivity": 1.0}], ids=["cold", "heat"])
def test_explicit_solids_do_not_turn_inside_out(tmp_path: Path, law: str, heat: dict[str, Any] | None) -> None:
    """A block that is squeezed at 30 per second and whose step may be longer than that."""
    more = {} if heat is None else {"heat": heat}
    out = run(
        tmp_path,
        grid={"cell_size": 0.05, "low": [-0.5, -0.5], "high": [1.5, 1.5]},
        shape=BLOCK,
        liquid=None,
        solid={**JELLY, "law": law, "youngs_modulus": 10.0, "poisson_ratio": 0.2},
        velocity_gradient=[[-30.0, 0.0], [0.0, 0.0]],
        time={"scheme": "explicit", "dt": 0.05, "end": 0.06, "cfl": 0.9},
        on_failure={"min_dt": 1e-6},
        measure={"J": {"kind": "min_jacobian"}},
        **more,
    )
    assert read_table(out / "history.csv")["measure.J"].min() > 0.0
    assert facts(out)["status"] == "done"


@pytest.mark.parametrize("dim", [2, 3])
def test_what_counts_as_crushed(dim: int) -> None:
    """Solid points only, by the part of their volume that is left, and by its sign; one that is no number."""
    n = 7
    before = Particles.at(np.zeros((n, dim)), np.ones(n), np.ones(n))
    before.F *= np.random.default_rng(0).uniform(0.5, 2.0, (n, 1, 1))
    after = before.take(np.arange(n))
    stretch = np.array([1.0, 0.11, 0.09, -0.5, 0.09, np.nan, 1e-3])
    after.F[:, 0] *= stretch[:, None]
    after.phase[4] = LIQUID
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((dim, dim)))[0]
    turn[:, 0] *= np.sign(np.linalg.det(turn))
    after.F = turn @ after.F
    assert count_crushed(before, after) == 4
    after.phase[:] = LIQUID
    assert count_crushed(before, after) == 0
