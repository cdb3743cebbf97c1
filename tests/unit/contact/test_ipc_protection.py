"""The contact term guards the way between positions, whoever asks for its energy."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenario import block, body, build, material, scene, write

from femdeform.contact.ipc import IPCContact
from femdeform.fem.incremental_potential import IncrementalPotential
from femdeform.run.checkpoint import read_checkpoint
from femdeform.run.runner import run_scene
from femdeform.run.setup import Simulation


def pair() -> tuple[Simulation, IPCContact, Any]:
    """Two squares 0.1 m apart, and the displacement that takes the right one to the left by a metre."""
    data = scene(
        {
            "a": body(block([0.5, 0.5], [2, 2])),
            "b": body(block([0.5, 0.5], [2, 2], translate=[0.6, 0.03])),
        },
        contact={"method": "ipc"},
    )
    simulation = build(data)
    (contact,) = simulation.problem.couplings
    assert isinstance(contact, IPCContact)
    move = np.zeros_like(simulation.state.x)
    move[simulation.conditions.local_nodes("b"), 0] = -1.0
    simulation.problem.begin_step(simulation.state, 0.01)
    return simulation, contact, move


def test_nobody_jumps_through_a_body() -> None:
    simulation, contact, move = pair()
    x = simulation.state.x
    assert contact.value(x) == 0.0
    assert math.isfinite(contact.value(x + 0.08 * move))
    # On the other side surfaces are apart again, but the way there is not free.
    beyond = x + 1.2 * move
    assert not contact.intersects(beyond)
    assert contact.value(beyond) == math.inf
    force = np.zeros_like(x)
    contact.add_gradient(beyond, force)
    assert not np.isfinite(force).all()
    assert simulation.problem.value(beyond) == math.inf
    # What was refused leaves no trace.
    assert contact.value(x) == 0.0
    assert contact.value(np.full_like(x, np.nan)) == math.inf


def test_a_way_around_is_a_way() -> None:
    simulation, contact, move = pair()
    x = simulation.state.x
    up = np.zeros_like(x)
    up[move[:, 0] != 0.0, 1] = 1.0
    for stop in (x + up, x + up + 1.2 * move, x + 1.2 * move):
        assert math.isfinite(contact.value(stop))


def test_steps_are_bounded() -> None:
    simulation, contact, move = pair()
    x = simulation.state.x
    part = simulation.problem.max_step(x, move)
    assert 0.08 < part < 0.1
    for t in (0.0, 0.3 * part, part):
        assert math.isfinite(contact.value(x + t * move))
    assert contact.value(x + (part + 0.02) * move) == math.inf
    assert simulation.problem.max_step(x, -move) > 0.3  # away: only very long steps are cut
    assert simulation.problem.max_step(x, -0.5 * move) == 1.0


def test_one_detection_serves_a_whole_search(monkeypatch: pytest.MonkeyPatch) -> None:
    simulation, contact, move = pair()
    x = simulation.state.x
    count = 0
    search = contact._search

    def counted(start: Any, end: Any) -> Any:
        nonlocal count
        count += 1
        return search(start, end)

    monkeypatch.setattr(contact, "_search", counted)
    part = simulation.problem.max_step(x, move)
    for t in (part, 0.5 * part, 0.25 * part):
        y = x + t * move
        simulation.problem.value(y)
        simulation.problem.gradient(y)
        simulation.problem.hessian(y, True)
    assert count == 1


def test_squeezing_reaches_an_end_before_rounding_does() -> None:
    """Asked again and again for more, steps come to nothing while the gap is still one."""
    simulation, contact, move = pair()
    x = simulation.state.x
    for _ in range(30):
        part = simulation.problem.max_step(x, move)
        x = x + part * move
        assert math.isfinite(contact.value(x))
    assert part < 1e-6
    assert contact.smallest_distance(x) >= 0.99e-6 * contact.reach


@pytest.mark.petsc
@pytest.mark.parametrize("linear_solver", [{"method": "ksp"}, {"method": "scipy_direct"}])
def test_a_run_goes_on_to_the_bit(
    linear_solver: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Contact and friction keep nothing from step to step."""
    data = scene(
        {
            "a": body(block([0.4, 0.1], [4, 1], translate=[0.0, 0.01]), material(E=1e5)),
            "b": body(block([0.2, 0.1], [3, 1], translate=[0.13, 0.13]), material(E=1e5)),
        },
        {"kind": "initial_velocity", "on": "b", "velocity": [0.8, -1.0]},
        obstacles=[{"kind": "plane", "point": [0.0, 0.0], "normal": [0.0, 1.0], "friction": 0.3}],
        gravity=[0.0, -9.81],
        contact={"method": "ipc", "friction": 0.4},
        linear_solver=linear_solver,
        time={"scheme": "backward_euler", "dt": 0.01, "end": 0.2},
        output={"checkpoint_every": 4, "every": 100},
    )
    path = write(data, tmp_path / "s.yaml")
    assert run_scene(path, out=tmp_path / "whole", quiet=True) == 0
    accept = IncrementalPotential.accept

    def broken(self: IncrementalPotential, state: Any, x: Any) -> Any:
        if state.step == 10:
            raise RuntimeError("power cut")
        return accept(self, state, x)

    with monkeypatch.context() as patch:
        patch.setattr(IncrementalPotential, "accept", broken)
        with pytest.raises(RuntimeError, match="power cut"):
            run_scene(path, out=tmp_path / "broken", quiet=True)
    assert read_checkpoint(tmp_path / "broken").step == 8
    assert run_scene(path, out=tmp_path / "broken", quiet=True, resume=True) == 0
    first, second = (read_checkpoint(tmp_path / name) for name in ("whole", "broken"))
    assert first.step == second.step == 20
    np.testing.assert_array_equal(first.fields["x"], second.fields["x"])
    np.testing.assert_array_equal(first.fields["v"], second.fields["v"])
