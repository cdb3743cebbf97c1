"""Supports and prescribed motions: where they put nodes at a time, and which of them wins."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenario import block, body, build, displacement, quasistatic, run, scene, step

from femdeform.run.setup import Simulation

DYNAMIC = {"scheme": "backward_euler", "dt": 0.1, "end": 4.0}


def beam(*conditions: dict[str, Any], dim: int = 3, order: int = 1, **more: Any) -> Simulation:
    mesh = block([2.0, 1.0, 1.0][:dim], [2, 1, 1][:dim])
    return build(scene({"b": body(mesh, element_order=order)}, *conditions, **{"time": DYNAMIC, **more}))


def prescribed(simulation: Simulation, time: float) -> Any:
    """Displacements of all nodes with the prescribed values of a time written into the reference."""
    x = simulation.discretization.points.copy()
    simulation.conditions.set_prescribed(time, x)
    return x - simulation.discretization.points


def on(simulation: Simulation, group: str) -> Any:
    return simulation.conditions.local_nodes(group)


def test_translate_from_start_to_stop() -> None:
    simulation = beam({"kind": "translate", "on": "b.right", "velocity": [1.0, -2.0, 0.5], "start": 1.0, "stop": 3.0})
    right = on(simulation, "b.right")
    for time, elapsed in ((0.0, 0.0), (1.0, 0.0), (1.5, 0.5), (3.0, 2.0), (4.0, 2.0)):
        u = prescribed(simulation, time)
        expected = np.tile([elapsed, -2.0 * elapsed, 0.5 * elapsed], (right.size, 1))
        np.testing.assert_allclose(u[right], expected, atol=1e-15)
        assert np.all(np.delete(u, right, axis=0) == 0.0)
    assert not simulation.conditions.free[right].any()
    assert np.delete(simulation.conditions.free, right, axis=0).all()


@pytest.mark.parametrize("order", [1, 2])
def test_rotate_about_the_centroid_of_the_group(order: int) -> None:
    simulation = beam(
        {"kind": "rotate", "on": "b.right", "axis": [2.0, 0.0, 0.0], "rate": 0.5, "start": 1.0}, order=order
    )
    right = on(simulation, "b.right")
    X = simulation.discretization.points[right]
    angle = 0.5 * 2.0
    y, z = X[:, 1] - 0.5, X[:, 2] - 0.5
    expected = np.stack(
        [X[:, 0], 0.5 + np.cos(angle) * y - np.sin(angle) * z, 0.5 + np.sin(angle) * y + np.cos(angle) * z], axis=1
    )
    np.testing.assert_allclose(X + prescribed(simulation, 3.0)[right], expected, atol=1e-14)


def test_rotate_in_the_plane_about_a_point() -> None:
    simulation = beam({"kind": "rotate", "on": "b.right", "rate": np.pi / 2.0, "center": [0.0, 0.0]}, dim=2)
    right = on(simulation, "b.right")
    X = simulation.discretization.points[right]
    quarter = np.stack([-X[:, 1], X[:, 0]], axis=1)
    np.testing.assert_allclose(X + prescribed(simulation, 1.0)[right], quarter, atol=1e-14)


def test_twist_turns_and_moves_along_its_axis() -> None:
    twist = {"kind": "twist", "on": "b.right", "axis": [1, 0, 0], "rate": np.pi, "elongation_rate": 0.3, "stop": 2.0}
    simulation = beam(twist)
    right = on(simulation, "b.right")
    X = simulation.discretization.points[right]
    half = X * [1.0, -1.0, -1.0] + [0.3, 1.0, 1.0]
    np.testing.assert_allclose(X + prescribed(simulation, 1.0)[right], half, atol=1e-14)
    np.testing.assert_allclose(X + prescribed(simulation, 9.0)[right], X + np.array([0.6, 0.0, 0.0]), atol=1e-14)


def test_path() -> None:
    table = [[0, 0, 0], [1, 2, 0], [1, 0, -4]]
    simulation = beam({"kind": "path", "on": "b.right", "times": [1.0, 2.0, 4.0], "displacements": table})
    right = on(simulation, "b.right")
    for time, u in ((0.0, [0, 0, 0]), (1.5, [0.5, 1, 0]), (2.0, [1, 2, 0]), (3.0, [1, 1, -2]), (7.0, [1, 0, -4])):
        np.testing.assert_allclose(prescribed(simulation, time)[right], np.tile(u, (right.size, 1)), atol=1e-14)


def test_fixed_components() -> None:
    simulation = beam({"kind": "fixed", "on": "b.left", "components": ["x", "z"]}, gravity=[1.0, -9.81, 2.0])
    left = on(simulation, "b.left")
    np.testing.assert_array_equal(simulation.conditions.free[left], np.tile([False, True, False], (left.size, 1)))
    step(simulation)
    u = displacement(simulation)
    assert np.all(u[left][:, [0, 2]] == 0.0)
    assert np.all(u[left][:, 1] < -1e-3)


def test_the_later_condition_wins_with_a_notice() -> None:
    slide = {"kind": "translate", "on": "b.right", "velocity": [1.0, 0.0, 0.0]}
    lift = {"kind": "path", "on": "b.top", "times": [0.0, 1.0], "displacements": [[0, 0, 0], [0, 1, 0]]}
    simulation = beam(slide, lift)
    right, top = on(simulation, "b.right"), on(simulation, "b.top")
    u = prescribed(simulation, 1.0)
    np.testing.assert_allclose(u[top], np.tile([0, 1, 0], (top.size, 1)))
    np.testing.assert_allclose(u[np.setdiff1d(right, top)], np.tile([1, 0, 0], (2, 1)))
    (notice,) = simulation.notices
    assert "conditions[1] (path)" in notice
    assert "2 nodes" in notice
    assert "translate" in notice
    # The other way round, the other one.
    u = prescribed(beam(lift, slide), 1.0)
    np.testing.assert_allclose(u[right], np.tile([1, 0, 0], (right.size, 1)))


def test_conditions_on_different_components_do_not_meet() -> None:
    x = {"kind": "fixed", "on": "b.left", "components": ["x"]}
    yz = {"kind": "fixed", "on": "b.left", "components": ["y", "z"]}
    simulation = beam(x, yz)
    assert simulation.notices == []
    assert not simulation.conditions.free[on(simulation, "b.left")].any()
    # Two supports agree on what they share.
    assert beam({"kind": "fixed", "on": "b.left"}, {"kind": "fixed", "on": "b.top"}).notices == []


def test_a_motion_over_one_held_component() -> None:
    """A translation takes over a node that is held in x only, and says so."""
    simulation = beam(
        {"kind": "fixed", "on": "b.left", "components": ["x"]},
        {"kind": "translate", "on": "b.left", "velocity": [0.5, 0.0, 0.0]},
    )
    assert len(simulation.notices) == 1
    np.testing.assert_allclose(prescribed(simulation, 1.0)[on(simulation, "b.left")][:, 0], 0.5)


def test_a_motion_of_one_component_leaves_the_others_free() -> None:
    """The end of a bar is pulled along x and may shrink across."""
    pull = {"kind": "translate", "on": "b.right", "velocity": [0.4, 9.0, 9.0], "components": ["x"]}
    hold = {"kind": "fixed", "on": "b.left", "components": ["x"]}
    corner = {"kind": "fixed", "on": {"nodes": [0]}}
    turn = {"kind": "fixed", "on": {"box": [[0, 0, 0], [0, 1, 0]]}, "components": ["z"]}
    simulation = run(
        scene({"b": body(block([2.0, 1.0, 1.0], [2, 1, 1]))}, hold, pull, corner, turn, time=quasistatic())
    )
    right = on(simulation, "b.right")
    u = displacement(simulation)[right]
    np.testing.assert_allclose(u[:, 0], 0.4, rtol=1e-15)
    assert np.ptp(simulation.state.x[right, 1]) < 0.97


def test_prescribed_nodes_are_where_they_should_be_after_a_run() -> None:
    """A bar pulled by a screw motion: the end reaches its place to the bit, the middle follows."""
    data = scene(
        {"b": body(block([2.0, 1.0, 1.0], [2, 1, 1]))},
        {"kind": "fixed", "on": "b.left"},
        {"kind": "twist", "on": "b.right", "axis": [1, 0, 0], "rate": 1.0, "elongation_rate": 0.5},
        time=quasistatic(dt=0.25),
    )
    simulation = run(data)
    right = on(simulation, "b.right")
    np.testing.assert_array_equal(
        simulation.state.x[right], (simulation.discretization.points + prescribed(simulation, 1.0))[right]
    )
    middle = np.flatnonzero(simulation.discretization.points[:, 0] == 1.0)
    assert displacement(simulation)[middle, 0].mean() == pytest.approx(0.25, abs=0.01)


def test_prescribed_nodes_carry_their_velocity() -> None:
    simulation = beam({"kind": "translate", "on": "b.right", "velocity": [0.3, 0.0, 0.0]}, gravity=None)
    step(simulation)
    np.testing.assert_allclose(simulation.state.v[on(simulation, "b.right")], np.tile([0.3, 0, 0], (4, 1)), atol=1e-14)


# ------------------------------------------------------------------------------------------- initial velocity


def test_initial_velocity_of_a_group_and_a_later_one() -> None:
    simulation = beam(
        {"kind": "initial_velocity", "on": "b", "velocity": [1.0, 0.0, 0.0]},
        {"kind": "initial_velocity", "on": "b.right", "velocity": [0.0, 2.0, 0.0]},
    )
    right = on(simulation, "b.right")
    np.testing.assert_array_equal(simulation.state.v[right], np.tile([0.0, 2.0, 0.0], (right.size, 1)))
    assert np.all(np.delete(simulation.state.v, right, axis=0) == [1.0, 0.0, 0.0])


@pytest.mark.parametrize("order", [1, 2])
def test_initial_spin(order: int) -> None:
    omega, v0 = np.array([1.0, -2.0, 0.5]), np.array([0.1, 0.2, 0.3])
    simulation = beam(
        {"kind": "initial_velocity", "on": "b", "velocity": v0.tolist(), "angular_velocity": omega.tolist()},
        order=order,
    )
    X = simulation.discretization.points
    np.testing.assert_allclose(simulation.state.v, v0 + np.cross(omega, X - X.mean(axis=0)), atol=1e-14)


def test_initial_spin_in_the_plane_about_a_point() -> None:
    simulation = beam({"kind": "initial_velocity", "on": "b", "angular_velocity": 3.0, "center": [1.0, 2.0]}, dim=2)
    X = simulation.discretization.points - [1.0, 2.0]
    np.testing.assert_allclose(simulation.state.v, 3.0 * np.stack([-X[:, 1], X[:, 0]], axis=1), atol=1e-14)
