"""Bodies in a grid: steps from rest, depth in walls, advice for stiff scenes, the residual study, meshes of one's own.

That the scenes themselves meet what they expect is tested with the others of scenes/xpbd.
"""

from __future__ import annotations

import csv
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scenario

from femdeform.cli import main
from femdeform.errors import InputError
from femdeform.run.setup import Simulation
from femdeform.run.time_loop import take_step
from femdeform.step_problem import StepResult

REPOSITORY = Path(__file__).resolve().parents[2]
SCENES, STUDY = REPOSITORY / "scenes" / "xpbd", REPOSITORY / "scenes" / "studies" / "xpbd-grid-residual.yaml"
DATA = Path(os.environ.get("FEMDEFORM_DATA", REPOSITORY.parent / "shared" / "data")) / "meshes"
CELL = 0.1


def run(name: str, out: Path, *overrides: str) -> int:
    arguments = ["run", str(SCENES / f"{name}.yaml"), "--out", str(out)]
    for override in overrides:
        arguments += ["--set", override]
    return main(arguments)


@pytest.mark.parametrize("method", ["b_pxpbd", "fp_pxpbd", "projected_newton"])
def test_a_body_at_rest_follows_a_support_that_begins_to_move(method: str) -> None:
    """The last state has no forces but rounding: those of the first iterate are the scale then."""
    mesh = scenario.block([0.8, 0.2, 0.2], [8, 2, 2], translate=[0.02, 0.03, 0.01])
    turn = {"kind": "rotate", "on": "bar.right", "axis": [1.0, 0.0, 0.0], "rate": 3.0}
    stuff = scenario.material("fixed_corotated", E=1e3, density=10.0)
    solver = {"method": method, "tolerance": 1e-9}
    data = scenario.scene({"bar": scenario.body(mesh, stuff)}, turn, grid={"cell_size": CELL}, solver=solver)
    simulation = scenario.build(data)
    result = take_step(simulation.problem, simulation.solver, simulation.state, 0.005)
    assert result.converged
    assert result.iterations <= 40
    # Inertia of the end that was moved: not rounding.
    assert simulation.problem.force_scale > 1e-3


def lowest(angle: float, shift: float, kernel: str) -> float:
    """Height of the lowest node of a block over an oblique floor it has come to rest on [cells]."""
    normal = np.array([np.sin(angle), np.cos(angle)])
    mesh = scenario.block([0.6, 0.3], [6, 3], translate=[0.013, 0.03 + shift], rotate={"angle": -angle})
    floor = {"kind": "plane", "point": [0.0, shift], "normal": normal.tolist(), "friction": 5.0}
    stuff = scenario.material("fixed_corotated", E=1e5, density=1000.0)
    data = scenario.scene(
        {"b": scenario.body(mesh, stuff)},
        gravity=[0.0, -9.81],
        grid={"cell_size": CELL, "kernel": kernel},
        obstacles=[floor],
    )
    simulation = scenario.build(data)
    scenario.advance(simulation, 60)
    return float(((simulation.state.x - [0.0, shift]) @ normal).min() / CELL)


@pytest.mark.parametrize("kernel", ["linear", "quadratic"])
@pytest.mark.parametrize("angle", [0.0, 0.3, 0.7])
def test_bodies_rest_within_a_third_of_a_cell_of_a_wall(angle: float, kernel: str) -> None:
    """However the wall lies in the grid; were only nodes inside it to resist, it would be 0.7 of a cell."""
    assert max(abs(lowest(angle, shift, kernel)) for shift in (0.0, 0.033, 0.066)) < 0.34


def stiff(solver: dict[str, Any], E: float, law: str = "fixed_corotated") -> tuple[Simulation, StepResult]:
    """A block that is thrown with a gradient of velocity, and what came of its first step."""
    mesh = scenario.block([0.6, 0.4, 0.4], [6, 4, 4], translate=[0.02, 0.03, 0.01])
    spin = {"kind": "initial_velocity", "on": "b", "angular_velocity": [0.0, 3.0, -2.0]}
    held = {"kind": "fixed", "on": "b.left"}
    stuff = scenario.material(law, E=E, density=10.0)
    data = scenario.scene({"b": scenario.body(mesh, stuff)}, spin, held, grid={"cell_size": CELL}, solver=solver)
    simulation = scenario.build(data)
    return simulation, take_step(simulation.problem, simulation.solver, simulation.state, 0.01)


@pytest.mark.parametrize("method", ["b_pxpbd", "fp_pxpbd"])
def test_a_step_too_stiff_for_sweeps_fails_and_says_how_short_it_should_be(method: str) -> None:
    options = {"method": method, "tolerance": 1e-9, "max_iterations": 60}
    simulation, failed = stiff(options, 4e5, "neo_hookean")
    assert not failed.converged
    assert "stiffness number" in failed.reason
    shorter = float(failed.reason.rsplit("at most ", 1)[1].removesuffix(" s"))
    assert shorter < 0.01
    assert take_step(simulation.problem, simulation.solver, simulation.state, shorter).converged
    _, soft = stiff({**options, "max_iterations": 2, "tolerance": 1e-14}, 1e3)
    assert soft.reason == "no convergence in 2 sweeps"


@pytest.mark.parametrize("method", ["projected_newton", "fp_pxpbd"])
def test_muscles_in_a_grid_go_with_newton_only(method: str) -> None:
    fibres = {"kind": "constant", "direction": [1.0, 0.0, 0.0]}
    muscle = {"fibres": fibres, "max_isometric_stress": 5e3, "activation": 0.5}
    mesh = scenario.block([0.6, 0.2, 0.2], [6, 2, 2])
    stuff = scenario.material("fixed_corotated", E=1e3, density=10.0)
    data = scenario.scene(
        {"b": scenario.body(mesh, stuff, muscle=muscle)}, grid={"cell_size": CELL}, solver={"method": method}
    )
    if method == "fp_pxpbd":
        with pytest.raises(InputError, match="knows no muscles in a grid; use projected_newton"):
            scenario.build(data)
        return
    simulation = scenario.build(data)
    scenario.advance(simulation, 5)
    along = simulation.state.x[:, 0]
    assert float(np.ptp(along)) < 0.59


@pytest.mark.slow
def test_the_residual_study_on_a_coarser_block(tmp_path: Path) -> None:
    """At kappa = 1 B-PXPBD and FP-PXPBD converge, the source's zeta too, and XPBD stagnates."""
    size = ["bodies.block.mesh.cells=[5, 5, 5]", "grid.cell_size=0.2", "time.dt=0.02", "grid.cfl=1.0"]
    arguments = ["compare", str(STUDY), "--out", str(tmp_path / "out"), "--quiet", "--threads", "1"]
    for override in size:
        arguments += ["--set", override]
    assert main(arguments) == 0
    with (tmp_path / "out" / "compare.csv").open() as file:
        found = {row["variant"]: float(row["relative_residual"]) for row in csv.DictReader(file)}
    for name in ("B-PXPBD", "B-PXPBD, zeta 0.5", "FP-PXPBD", "Newton, CG with ICC", "Newton, CG with Jacobi"):
        assert found[name] < 1e-8
    assert found["XPBD"] > 1e-3


@pytest.mark.slow
def test_a_step_of_dropped_meshes_of_ones_own(tmp_path: Path) -> None:
    files = {name: DATA / f"{name}.mesh" for name in ("coarse_bunny", "spot")}
    if not all(path.is_file() for path in files.values()):
        pytest.skip(f"coarse_bunny.mesh and spot.mesh are not in {DATA}; FEMDEFORM_DATA names the folder above")
    bunny = f"bodies.d04.mesh={{file: {files['coarse_bunny']}, scale: 0.003, translate: [0.42, 0.68, 0.36]}}"
    spot = f"bodies.d05.mesh={{file: {files['spot']}, scale: 0.3, translate: [0.95, 0.95, 0.3]}}"
    assert run("grid-dropping-shapes", tmp_path / "result", bunny, spot, "time.end=0.005", "expect={}") == 0
