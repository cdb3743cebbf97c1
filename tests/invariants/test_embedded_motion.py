"""Bodies in a grid: free fall, momentum through a collision, supports, walls, threads, restart."""

from __future__ import annotations

import csv
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scenario
from scenario import block, body, material, scene, write

import femdeform.run.checkpoint as checkpoints
from femdeform.run.quantities import Snapshot, make_quantity
from femdeform.run.setup import Simulation
from femdeform.scene.quantity_schema import MomentumQuantity

H, G = 0.01, 9.81


def two_blocks(dim: int, kernel: str, **more: Any) -> dict[str, Any]:
    """Blocks that meet off centre, one of them turning."""
    size, cells = [0.4, 0.3, 0.3][:dim], [4, 3, 3][:dim]
    stuff = material("neo_hookean", E=2e4, density=1000.0)
    bodies = {
        "a": body(block(size, cells), stuff),
        "b": body(block(size, cells, translate=[0.55, 0.1, 0.02][:dim]), stuff),
    }
    spin = [0.0, 0.5, 1.0] if dim == 3 else 1.0
    meet = {"kind": "initial_velocity", "on": "a", "velocity": [2.0, 0.0, 0.0][:dim]}
    turn = {"kind": "initial_velocity", "on": "b", "velocity": [-1.0, 0.0, 0.0][:dim], "angular_velocity": spin}
    return scene(bodies, meet, turn, grid={"cell_size": 0.1, "kernel": kernel}, **more)


def momenta(simulation: Simulation) -> np.ndarray:
    dim = simulation.discretization.dim
    values = []
    for kind, components in (("linear", "xyz"[:dim]), ("angular", "xyz" if dim == 3 else "z")):
        for component in components:
            block = MomentumQuantity.model_validate({"kind": f"{kind}_momentum", "component": component})
            values.append(make_quantity(simulation, block)(Snapshot(simulation, simulation.state)))
    return np.array(values)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("kernel", ["linear", "quadratic"])
def test_momentum_through_a_collision(kernel: str, dim: int) -> None:
    """Linear momentum stays to rounding; the elastic energy shows that the blocks have met."""
    simulation = scenario.build(two_blocks(dim, kernel, solver={"tolerance": 1e-12}))
    before = momenta(simulation)
    assert simulation.problem.elastic_energy(simulation.state.x) < 1e-12
    scenario.advance(simulation, 14)
    after = momenta(simulation)
    assert simulation.problem.elastic_energy(simulation.state.x) > 0.05
    np.testing.assert_allclose(after[:dim], before[:dim], atol=1e-10 * np.abs(before[:dim]).max())


@pytest.mark.parametrize("dim", [2, 3])
def test_a_rigid_spin_begins_as_it_is_told(dim: int) -> None:
    """Angular momentum at the start, with that of the nodes about themselves, is that of the grid after a transfer."""
    simulation = scenario.build(two_blocks(dim, "quadratic"))
    problem = simulation.problem
    before = momenta(simulation)[dim:]
    problem.begin_step(simulation.state, H)
    begin = problem.solver_state(simulation.state)
    arms = np.zeros((2, len(begin.x), 3))
    arms[0, :, :dim], arms[1, :, :dim] = begin.x, problem.lumped_mass[:, None] * begin.v
    of_grid = np.cross(arms[0], arms[1]).sum(axis=0)
    np.testing.assert_allclose(of_grid[3 - before.size :], before, atol=1e-12 * np.abs(before).max())


@pytest.mark.parametrize("kernel", ["linear", "quadratic"])
@pytest.mark.parametrize("method", ["projected_newton", "b_pxpbd"])
def test_free_fall_is_exact(kernel: str, method: str) -> None:
    mesh = block([0.4, 0.3, 0.3], [4, 3, 3], translate=[0.013, -0.02, 0.007])
    n = 15
    data = scene(
        {"b": body(mesh, material("fixed_corotated", E=2e4))},
        gravity=[0.0, -G, 0.0],
        grid={"cell_size": 0.1, "kernel": kernel},
        solver={"method": method},
    )
    simulation = scenario.build(data)
    scenario.advance(simulation, n)
    fallen = np.zeros_like(simulation.state.x)
    fallen[:, 1] = -G * H**2 * n * (n + 1) / 2.0
    np.testing.assert_allclose(scenario.displacement(simulation), fallen, atol=1e-10)
    assert simulation.state.affine is not None
    assert np.abs(simulation.state.affine).max() < 1e-8


def slide(walls: str, friction: float = 0.0, steps: int = 40) -> Simulation:
    """A block that lies on an oblique plane and starts to slide along it."""
    angle = 0.3
    normal = [float(np.sin(angle)), float(np.cos(angle))]
    mesh = block([0.6, 0.3], [6, 3], translate=[0.0, 0.02], rotate={"angle": -angle})
    data = scene(
        {"b": body(mesh, material("fixed_corotated", E=1e5, density=1000.0))},
        gravity=[0.0, -G],
        grid={"cell_size": 0.1, "obstacles": walls},
        obstacles=[{"kind": "plane", "point": [0.0, 0.0], "normal": normal, "friction": friction}],
    )
    simulation = scenario.build(data)
    scenario.advance(simulation, steps)
    return simulation


def test_walls() -> None:
    """Along a slope without friction a block slides as a point would; with much of it, or held, it stays."""
    along = np.array([np.cos(0.3), -np.sin(0.3)])
    across = np.array([np.sin(0.3), np.cos(0.3)])
    n = 40
    expected = G * np.sin(0.3) * H**2 * n * (n + 1) / 2.0
    for walls in ("separating", "slip"):
        moved = scenario.displacement(slide(walls))
        assert (moved @ along).mean() == pytest.approx(expected, rel=0.01)
        # Only nodes inside the plane resist: the block sinks in by a part of a cell of 0.1 m, no more.
        assert np.abs(moved @ across).max() < 0.06
    rough = (scenario.displacement(slide("separating", friction=0.1)) @ along).mean()
    braked = G * (np.sin(0.3) - 0.1 * np.cos(0.3)) * H**2 * n * (n + 1) / 2.0
    assert rough == pytest.approx(braked, rel=0.05)
    for walls, friction in (("separating", 0.6), ("sticky", 0.0)):
        assert abs((scenario.displacement(slide(walls, friction)) @ along).mean()) < 0.1 * expected


def test_separating_walls_let_go() -> None:
    """A block thrown off the floor flies; one that slips along it is held back."""
    height = {}
    for walls in ("separating", "slip"):
        mesh = block([0.3, 0.3], [3, 3], translate=[0.0, 0.01])
        up = {"kind": "initial_velocity", "on": "b", "velocity": [0.0, 1.0]}
        floor = {"kind": "plane", "point": [0.0, 0.0], "normal": [0.0, 1.0]}
        grid = {"cell_size": 0.1, "obstacles": walls}
        simulation = scenario.build(scene({"b": body(mesh)}, up, grid=grid, obstacles=[floor]))
        scenario.advance(simulation, 20)
        height[walls] = scenario.displacement(simulation)[:, 1].mean()
    assert height["separating"] == pytest.approx(0.2, abs=1e-3)
    assert height["slip"] < 0.1


def history(folder: Path) -> list[dict[str, str]]:
    with (folder / "history.csv").open() as file:
        return list(csv.DictReader(file))


STOPPED = """\
import sys
from pathlib import Path
from femdeform.run import runner

save, count = runner._Run._save, [0]

def stop(self, state):
    save(self, state)
    count[0] += 1
    if count[0] == 3:
        sys.exit(7)

runner._Run._save = stop
runner.run_scene(Path("scene.yaml"), out=Path("pieces"), threads=1, quiet=True)
"""


@pytest.mark.parametrize("method", ["projected_newton", "b_pxpbd", "pbng"])
def test_threads_and_restart_do_not_change_a_bit(
    method: str,
    cli: Callable[..., subprocess.CompletedProcess[str]],
    python: Callable[..., subprocess.CompletedProcess[str]],
    tmp_path: Path,
) -> None:
    """One run with one thread and one with two; one in a piece and one that stops at a checkpoint and goes on."""
    solver = {"method": method} if method == "projected_newton" else {"method": method, "iterations": 10}
    data = two_blocks(
        3,
        "quadratic",
        solver=solver,
        obstacles=[{"kind": "plane", "point": [0.0, 0.02, 0.0], "normal": [0.0, 1.0, 0.0], "friction": 0.2}],
        gravity=[0.0, -G, 0.0],
        time={"scheme": "backward_euler", "dt": 0.025, "end": 0.15},
        output={"checkpoint_every": 3},
    )
    write(data, tmp_path / "scene.yaml")
    for n in (1, 2):
        done = cli("run", "scene.yaml", "--out", f"threads-{n}", "--threads", n)
        assert done.returncode == 0, done.stderr
    one, two = (checkpoints.read_checkpoint(tmp_path / f"threads-{n}") for n in (1, 2))
    for name in ("x", "v", "affine"):
        np.testing.assert_array_equal(one.fields[name], two.fields[name])
    # A block that moves by more than 2 m/s crosses 0.4 of a cell of 0.1 m in less than the step asked for.
    assert min(float(row["dt"]) for row in history(tmp_path / "threads-1")) == pytest.approx(0.0125)

    # Processes of their own, as a user's: what other tests have done to this one is not in question.
    (tmp_path / "stopped.py").write_text(STOPPED)
    assert python("stopped.py").returncode == 7
    done = cli("run", "scene.yaml", "--out", "pieces", "--resume", "--threads", 1)
    assert done.returncode == 0, done.stderr
    again = checkpoints.read_checkpoint(tmp_path / "pieces")
    for name in ("x", "v", "affine"):
        np.testing.assert_array_equal(one.fields[name], again.fields[name])


@pytest.mark.mpi
def test_several_ranks_are_refused(two_ranks: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path) -> None:
    write(two_blocks(2, "linear", linear_solver={"method": "ksp"}), tmp_path / "scene.yaml")
    done = two_ranks("-m", "femdeform", "run", "scene.yaml")
    assert done.returncode != 0
    assert "bodies in a grid run on one rank" in done.stderr
