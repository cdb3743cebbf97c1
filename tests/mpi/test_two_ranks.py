"""Runs on two MPI ranks: the serial answer, one result folder, one message. What goes wrong: tests/robustness."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenario import block, body, material, quasistatic, scene, write

from femdeform.run.checkpoint import read_checkpoint
from femdeform.run.result import Result
from femdeform.run.runner import run_scene

pytestmark = pytest.mark.mpi

Process = subprocess.CompletedProcess[str]
Ranks = Callable[..., Process]

PETSC = {"method": "ksp"}
TIGHT = {"tolerance": 1e-12}
RUN = ("-m", "femdeform", "run")


def contact_scene() -> dict[str, Any]:
    """P1 tets, consistent mass and friction in one body, lumped mass in a second; gravity and an initial spin."""
    return scene(
        {
            "a": body(block([0.5, 0.3, 0.3], [4, 2, 2], translate=[0, 0.01, 0]), material(E=5e4), mass="consistent"),
            "b": body(block([0.3, 0.3, 0.3], [2, 2, 2], translate=[2, 0.02, 0]), material(E=2e4, nu=0.4)),
        },
        {"kind": "initial_velocity", "on": "a", "velocity": [1.0, -1.0, 0.0], "angular_velocity": [0, 2, 3]},
        {"kind": "fixed", "on": "b.top", "components": ["x", "z"]},
        {"kind": "initial_velocity", "on": "b", "velocity": [0.0, -1.0, 0.0]},
        gravity=[0.0, -9.81, 0.0],
        obstacles=[{"kind": "plane", "point": [0, 0, 0], "normal": [0, 1, 0], "friction": 0.3}],
        time={"scheme": "backward_euler", "dt": 0.01, "end": 0.1},
        solver=TIGHT,
        linear_solver=PETSC,
    )


def loaded_scene() -> dict[str, Any]:
    """P2 tets with traction, follower pressure and a prescribed rotation; static."""
    return scene(
        {"b": body(block([1.0, 0.3, 0.3], [5, 2, 2]), material(E=1e5, nu=0.4), element_order=2)},
        {"kind": "fixed", "on": "b.left"},
        {"kind": "rotate", "on": "b.right", "axis": [1, 0, 0], "rate": 0.6},
        {"kind": "traction", "on": "b.front", "value": [0.0, 300.0, 100.0]},
        {"kind": "pressure", "on": "b.top", "value": 2000.0},
        time=quasistatic(dt=0.5),
        solver=TIGHT,
        linear_solver=PETSC,
        expect={
            "volume_ratio": {"value": 1.0, "atol": 1.0},
            "elastic_energy": {"value": 0.0, "atol": 1e6},
            "max_displacement": {"value": 0.0, "atol": 1.0},
            "min_jacobian": {"value": 1.0, "atol": 1.0},
            "displacement": [{"on": "b.top", "component": "y", "value": 0.0, "atol": 1.0}],
        },
    )


def thin_scene() -> dict[str, Any]:
    """A membrane over a ball, a rod beside it; GAMG on two ranks."""
    return scene(
        {
            "c": body({"recipe": "cloth", "cells": [6, 6]}, material(E=1e6), kind="membrane", thickness=0.01),
            "r": body({"recipe": "rod", "cells": 8, "translate": [0, 1, 0]}, kind="rod", cross_section=1e-3),
        },
        {"kind": "fixed", "on": "r.start"},
        {"kind": "fixed", "on": "c.left"},
        {"kind": "translate", "on": "c.right", "velocity": [-0.3, 0.1, 0.0]},
        gravity=[0.0, -9.81, 0.0],
        obstacles=[{"kind": "sphere", "center": [0, -0.3, 0], "radius": 0.28, "friction": 0.2}],
        time={"scheme": "backward_euler", "dt": 0.02, "end": 0.2},
        solver=TIGHT,
        linear_solver={"method": "ksp", "preset": "newton-gamg"},
    )


def plane_scene() -> dict[str, Any]:
    """P2 triangles under pressure and traction, consistent mass; block Jacobi with ICC on two ranks."""
    return scene(
        {"b": body(block([1.0, 0.4], [6, 3]), material(E=1e5), element_order=2, mass="consistent")},
        {"kind": "fixed", "on": "b.left"},
        {"kind": "pressure", "on": "b.boundary", "value": 500.0},
        {"kind": "traction", "on": "b.right", "value": [0.0, -3000.0]},
        gravity=[0.0, -9.81],
        time={"scheme": "backward_euler", "dt": 0.05, "end": 0.2},
        solver=TIGHT,
        linear_solver={"method": "ksp", "preset": "newton-icc"},
    )


def linked_scene() -> dict[str, Any]:
    """Links of every kind between bodies that the ranks share out: P1 and P2, normals that turn, a moving anchor."""
    ends = [{"at": [0.1, 0.25, 0.1], "body": "a"}, {"at": [0.9, 0.4, 0.2], "body": "b"}]
    return scene(
        {
            "a": body(block([0.5, 0.3, 0.3], [4, 2, 2]), material(E=5e4)),
            "b": body(block([0.5, 0.3, 0.3], [3, 3, 2], translate=[0.52, 0.2, 0]), material(E=2e4), element_order=2),
            "c": body(block([0.5, 0.2, 0.3], [5, 2, 3], translate=[0, -0.2, 0]), material(E=5e4)),
        },
        {"kind": "fixed", "on": "a.left"},
        {"kind": "initial_velocity", "on": "b", "velocity": [0.0, 1.0, 0.5]},
        links={
            "tie": {"kind": "tie", "on": "c.top", "to": "a.bottom", "stiffness": 1e7, "per": "area"},
            "slide": {
                "kind": "binding",
                "on": "b.left",
                "to": "a.right",
                "stiffness": 1e6,
                "tangential_stiffness": 1e4,
                "within": 0.05,
            },
            "spring": {"kind": "spring", "ends": ends, "stiffness": 500.0},
            "pair": {"kind": "pair", "ends": ends, "stiffness": 100.0},
            "crane": {"kind": "attachment", "on": "b.right", "stiffness": 50.0, "velocity": [0.5, 0.0, 0.0]},
        },
        gravity=[0.0, -9.81, 0.0],
        time={"scheme": "backward_euler", "dt": 0.02, "end": 0.1},
        solver=TIGHT,
        linear_solver=PETSC,
        measure={
            "gap": {"kind": "link_gap"},
            "force": {"kind": "link_force", "link": "tie", "component": "y"},
            "energy": {"kind": "link_energy", "link": "slide"},
        },
        expect={"measured": {name: {"value": 0.0, "atol": 1e9} for name in ("gap", "force", "energy")}},
    )


SCENES = {
    "contact": contact_scene,
    "loads": loaded_scene,
    "thin": thin_scene,
    "plane": plane_scene,
    "links": linked_scene,
}


@pytest.mark.parametrize("name", SCENES)
def test_the_same_answer_as_on_one_rank(name: str, tmp_path: Path, two_ranks: Ranks) -> None:
    data = SCENES[name]()
    data["output"] = {"fields": ["displacement", "velocity", "jacobian", "energy_density"], "every": 2}
    path = write(data, tmp_path / "s.yaml")
    done = two_ranks(*RUN, "s.yaml", "--out", "two")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("done:") == 1
    assert run_scene(path, out=tmp_path / "one") == 0

    one, two = Result.open(tmp_path / "one"), Result.open(tmp_path / "two")
    assert one.facts["ranks"] == 1
    assert two.facts["ranks"] == 2
    assert two.facts["n_dofs"] == one.facts["n_dofs"]
    a, b = one.read_final(), two.read_final()
    size = np.abs(a.displacement).max()
    assert size > 0.01
    np.testing.assert_allclose(b.displacement, a.displacement, rtol=0.0, atol=1e-8 * size)
    x, y = (read_checkpoint(tmp_path / name).fields["v"] for name in ("one", "two"))
    np.testing.assert_allclose(y, x, rtol=0.0, atol=1e-6 * max(float(np.abs(x).max()), 1e-12))

    for ours, theirs in zip(one.facts["expect"], two.facts["expect"], strict=True):
        assert theirs["quantity"] == ours["quantity"]
        assert theirs["computed"] == pytest.approx(ours["computed"], rel=1e-7)

    # One merged result: all points and cells in the order of the serial run, one row a step, one frame a file.
    np.testing.assert_array_equal(b.points, a.points)
    assert [kind for kind, _ in b.blocks] == [kind for kind, _ in a.blocks]
    for (_, cells), (_, others) in zip(a.blocks, b.blocks, strict=True):
        np.testing.assert_array_equal(cells, others)
    for field in ("jacobian", "energy_density"):
        for part, other in zip(a.cell_data[field], b.cell_data[field], strict=True):
            np.testing.assert_allclose(other, part, rtol=0.0, atol=1e-6 * np.abs(part).max())
    assert list(two.history["step"]) == list(one.history["step"])
    assert len(two.frames) == len(one.frames)
    for column in ("kinetic_energy", "elastic_energy", "potential_energy", "force_scale"):
        scale = np.abs(one.history[column]).max()
        np.testing.assert_allclose(two.history[column], one.history[column], atol=1e-7 * max(scale, 1e-12))


PARTITION = """\
import numpy as np
from mpi4py import MPI
from femdeform.parallel import Partition

comm = MPI.COMM_WORLD
rng = np.random.default_rng(0)  # the same numbers on every rank
n = 40
owner = rng.integers(0, 2, n)
held = rng.random((2, n)) < 0.6
held[owner, np.arange(n)] = True
partition = Partition(owner, np.flatnonzero(held[comm.rank]), comm)
whole = rng.standard_normal((2, n, 3))  # what each rank has at each node

assert partition.n_global == n
assert np.all(owner[partition.nodes[: partition.n_owned]] == comm.rank)
assert np.all(owner[partition.nodes[partition.n_owned :]] != comm.rank)

mine = partition.restrict(whole[comm.rank])
partition.update_ghosts(mine)
assert np.array_equal(mine, whole[owner[partition.nodes], partition.nodes])

mine = partition.restrict(whole[comm.rank])
partition.accumulate(mine)
total = np.where(held[:, :, None], whole, 0.0).sum(axis=0)
assert np.allclose(mine, total[partition.nodes], rtol=1e-14)

gathered = partition.gather(partition.restrict(total))
assert (gathered is None) == (comm.rank > 0)
assert gathered is None or np.array_equal(gathered, total)
assert np.isclose(partition.dot(mine, mine), np.sum(total**2), rtol=1e-13)
assert partition.max(float(comm.rank)) == 1.0 and partition.min(float(comm.rank)) == 0.0
assert np.isnan(partition.max(float("nan") if comm.rank else 3.0))
places = comm.allgather((partition.nodes, partition.global_index))
position = dict(zip(*(np.concatenate(part).tolist() for part in zip(*places))))
assert sorted(position.values()) == list(range(n))
print("sound")
"""


def test_exchange_between_ranks(tmp_path: Path, two_ranks: Ranks) -> None:
    (tmp_path / "partition.py").write_text(PARTITION)
    done = two_ranks("partition.py")
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("sound") == 2


def test_ranks_without_cells(tmp_path: Path, two_ranks: Ranks) -> None:
    """More ranks than cells: the idle ones take part in everything without a node of their own."""
    data = scene(
        {"b": body(block([1.0, 1.0], [1, 1]), mass="consistent")},
        {"kind": "fixed", "on": "b.left"},
        {"kind": "pressure", "on": "b.right", "value": 100.0},
        gravity=[0.0, -9.81],
        obstacles=[{"kind": "plane", "point": [0, 0], "normal": [0, 1], "friction": 0.1}],
        time={"scheme": "backward_euler", "dt": 0.05, "end": 0.1},
        solver=TIGHT,
        linear_solver=PETSC,
    )
    path = write(data, tmp_path / "s.yaml")
    done = two_ranks(*RUN, "s.yaml", "--out", "three", ranks=3)
    assert done.returncode == 0, done.stderr
    assert run_scene(path, out=tmp_path / "one") == 0
    one, three = read_checkpoint(tmp_path / "one"), read_checkpoint(tmp_path / "three")
    np.testing.assert_allclose(three.fields["x"], one.fields["x"], rtol=0.0, atol=1e-9)


# ------------------------------------------------------------------------------------------- failure


def test_bad_input_is_reported_once(tmp_path: Path, two_ranks: Ranks) -> None:
    data = contact_scene()
    data["bodies"]["a"]["material"]["density"] = -1.0
    data["conditions"][1]["on"] = "b.topp"
    write(data, tmp_path / "s.yaml")
    done = two_ranks(*RUN, "s.yaml", "--out", "out")
    assert done.returncode == 2
    assert done.stderr.count("density") == 1
    assert done.stderr.count("s.yaml:") == 1
    assert not (tmp_path / "out").exists()
    data["bodies"]["a"]["material"]["density"] = 1.0
    write(data, tmp_path / "s.yaml")
    done = two_ranks(*RUN, "s.yaml", "--out", "out")
    assert done.returncode == 2
    assert done.stderr.count("no group `topp`") == 1


def test_the_serial_solver_is_refused(tmp_path: Path, two_ranks: Ranks) -> None:
    data = contact_scene()
    data["linear_solver"] = {"method": "scipy_direct"}
    write(data, tmp_path / "s.yaml")
    done = two_ranks(*RUN, "s.yaml", "--out", "out")
    assert done.returncode == 2
    assert done.stderr.count("scipy_direct is serial") == 1
    assert "linear_solver.method" in done.stderr
    assert not (tmp_path / "out").exists()


def test_contact_between_bodies_is_refused(tmp_path: Path, two_ranks: Ranks) -> None:
    write({**contact_scene(), "contact": {"method": "ipc"}}, tmp_path / "s.yaml")
    done = two_ranks(*RUN, "s.yaml", "--out", "out")
    assert done.returncode == 2
    assert done.stderr.count("ipc is serial") == 1
    assert "contact.method" in done.stderr
    assert not (tmp_path / "out").exists()


def test_an_existing_result_is_not_touched(tmp_path: Path, two_ranks: Ranks) -> None:
    write(contact_scene(), tmp_path / "s.yaml")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "result.json").write_text('{"status": "done"}')
    done = two_ranks(*RUN, "s.yaml", "--out", "out")
    assert done.returncode == 2
    assert done.stderr.count("holds a result already") == 1
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["result.json"]


def test_no_convergence_is_exit_3_on_all_ranks(tmp_path: Path, two_ranks: Ranks) -> None:
    data = loaded_scene()
    data["solver"] = {"max_iterations": 2}
    data["on_failure"] = {"action": "stop"}
    write(data, tmp_path / "s.yaml")
    done = two_ranks(*RUN, "s.yaml", "--out", "out")
    assert done.returncode == 3
    assert done.stderr.count("no convergence in 2 iterations") == 1
    assert json.loads((tmp_path / "out" / "result.json").read_text())["status"] == "not_converged"
    assert (tmp_path / "out" / "final.vtu").exists()
