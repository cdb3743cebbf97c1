"""What must not change a result: the number of threads, the order of the bodies."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenario import block, body, material, run, scene, write

import femdeform.run.checkpoint as checkpoints


def test_threads_do_not_change_a_bit(cli: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path) -> None:
    """More cells than one thread takes at a time; supports, contact and consistent mass included."""
    data = scene(
        {"b": body(block([1, 1, 1], [6, 6, 6]), material(E=2e4), mass="consistent")},
        {"kind": "rotate", "on": "b.top", "axis": [0, 1, 0], "rate": 2.0},
        gravity=[0.0, -9.81, 0.0],
        obstacles=[{"kind": "plane", "point": [0, 0.05, 0], "normal": [0, 1, 0], "friction": 0.3}],
        time={"scheme": "backward_euler", "dt": 0.02, "end": 0.06},
    )
    write(data, tmp_path / "scene.yaml")
    for n in (1, 2):
        done = cli("run", "scene.yaml", "--out", f"threads-{n}", "--threads", n)
        assert done.returncode == 0, done.stderr
    one, two = (tmp_path / f"threads-{n}" for n in (1, 2))
    assert f'"threads": {2}' in (two / "result.json").read_text()
    assert (one / "final.vtu").read_bytes() == (two / "final.vtu").read_bytes()
    a, b = checkpoints.read_checkpoint(one), checkpoints.read_checkpoint(two)
    np.testing.assert_array_equal(a.fields["x"], b.fields["x"])
    np.testing.assert_array_equal(a.fields["v"], b.fields["v"])
    assert np.abs(a.fields["x"]).max() > 1.0


def test_order_of_the_bodies() -> None:
    """Two solids and a membrane, each with conditions of its own, listed in two orders."""
    bodies = {
        "a": body(block([1, 1, 1], [1, 1, 1]), material(E=2e4)),
        "b": body(block([1, 1, 1], [1, 1, 1], translate=[2, 0, 0]), material(E=5e4), element_order=2),
        "c": body({"recipe": "cloth", "cells": [3, 3], "translate": [0, 0, 5]}, kind="membrane", thickness=0.01),
    }
    conditions: list[dict[str, Any]] = [
        {"kind": "fixed", "on": "a.left"},
        {"kind": "fixed", "on": "b.top"},
        {"kind": "fixed", "on": "c.left"},
        {"kind": "traction", "on": "b.right", "value": [100.0, 200.0, 0.0]},
    ]
    more: dict[str, Any] = {
        "gravity": [0.0, -9.81, 0.0],
        "obstacles": [{"kind": "plane", "point": [0, -0.02, 0], "normal": [0, 1, 0], "friction": 0.5}],
        "time": {"scheme": "backward_euler", "dt": 0.02, "end": 0.1},
        "solver": {"tolerance": 1e-11},
    }
    first = run(scene(bodies, *conditions, **more))
    second = run(scene(dict(reversed(bodies.items())), *conditions, **more))
    for name in bodies:
        parts = []
        for simulation in (first, second):
            place = simulation.discretization.bodies[name]
            own = slice(place.first, place.first + place.n_nodes)
            parts.append((simulation.state.x - simulation.discretization.points)[own])
        assert np.abs(parts[0]).max() > 1e-3
        np.testing.assert_allclose(parts[1], parts[0], atol=1e-9 * np.abs(parts[0]).max())


@pytest.mark.parametrize("law", ["neo_hookean", "fixed_corotated", "saint_venant_kirchhoff"])
def test_threads_do_not_change_a_bit_of_a_sweep(
    law: str, cli: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    """Sweeps over nodes in several pieces a colour, with obstacles, a moving support and acceleration."""
    data = scene(
        {"b": body(block([1, 1, 1], [9, 9, 9]), material(law, E=2e4))},
        {"kind": "rotate", "on": "b.top", "axis": [0, 1, 0], "rate": 2.0},
        gravity=[0.0, -9.81, 0.0],
        obstacles=[{"kind": "plane", "point": [0, 0.05, 0], "normal": [0, 1, 0], "friction": 0.3}],
        time={"scheme": "backward_euler", "dt": 0.02, "end": 0.04},
        solver={"method": "pbng", "tolerance": 1e-6},
    )
    write(data, tmp_path / "scene.yaml")
    for n in (1, 2):
        done = cli("run", "scene.yaml", "--out", f"threads-{n}", "--threads", n)
        assert done.returncode == 0, done.stderr
    a, b = (checkpoints.read_checkpoint(tmp_path / f"threads-{n}") for n in (1, 2))
    np.testing.assert_array_equal(a.fields["x"], b.fields["x"])
    np.testing.assert_array_equal(a.fields["v"], b.fields["v"])
    assert np.abs(a.fields["x"]).max() > 1.0


@pytest.mark.parametrize(
    ("law", "solver"),
    [
        ("fixed_corotated", {"method": "xpbd", "iterations": 10}),
        ("neo_hookean", {"method": "b_pxpbd", "iterations": 10}),
        ("fixed_corotated", {"method": "fp_pxpbd", "iterations": 10}),
        ("stable_neo_hookean", {"method": "fp_pxpbd", "iterations": 10, "tangent": "exact"}),
    ],
)
def test_threads_do_not_change_a_bit_of_a_sweep_over_cells(
    law: str, solver: dict[str, Any], cli: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path
) -> None:
    """Several pieces a colour, with obstacles, rollers and a moving support."""
    data = scene(
        {"b": body(block([1, 1, 1], [9, 9, 9]), material(law, E=2e4))},
        {"kind": "translate", "on": "b.top", "velocity": [1.0, 0.0, 0.0]},
        {"kind": "fixed", "on": "b.left", "components": ["z"]},
        gravity=[0.0, -9.81, 0.0],
        obstacles=[{"kind": "plane", "point": [0, 0.05, 0], "normal": [0, 1, 0], "friction": 0.3}],
        time={"scheme": "backward_euler", "dt": 0.01, "end": 0.02},
        solver=solver,
    )
    write(data, tmp_path / "scene.yaml")
    for n in (1, 2):
        done = cli("run", "scene.yaml", "--out", f"threads-{n}", "--threads", n)
        assert done.returncode == 0, done.stderr
    a, b = (checkpoints.read_checkpoint(tmp_path / f"threads-{n}") for n in (1, 2))
    np.testing.assert_array_equal(a.fields["x"], b.fields["x"])
    np.testing.assert_array_equal(a.fields["v"], b.fields["v"])
    assert np.abs(a.fields["x"]).max() > 1.0
