"""Bodies on, in and against obstacles: rest, sliding, sticking, being carried along."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenario import advance, block, body, build, material, quasistatic, scene, step

from femdeform.run.setup import Simulation

G = 9.81
RHO = 1000.0
STIFF = material(E=1e6, nu=0.3, density=RHO)


def ground(**more: Any) -> dict[str, Any]:
    return {"kind": "plane", "point": [0.0, 0.0], "normal": [0.0, 2.0], "stiffness": 2e7, **more}


def slab(*conditions: dict[str, Any], order: int = 1, at: Any = (0.0, 0.0), **more: Any) -> Simulation:
    """A flat plate, 0.4 m by 0.1 m, in the plane."""
    data = scene(
        {"b": body(block([0.4, 0.1], [4, 1], translate=[float(c) for c in at]), STIFF, element_order=order)},
        *conditions,
        **{"gravity": [0.0, -G], "time": {"scheme": "backward_euler", "dt": 0.01, "end": 10.0}, **more},
    )
    return build(data)


def bottom_of(simulation: Simulation) -> Any:
    """Nodes of the bottom, and their part of the obstacle's stiffness [N/m]."""
    (contact,) = simulation.problem.contacts
    nodes = simulation.conditions.local_nodes("b.bottom")
    return nodes, contact.stiffness[np.searchsorted(contact.nodes, nodes)]


def depth_below(simulation: Simulation, level: float = 0.0) -> float:
    """Mean depth of the bottom under a level, weighted by stiffness."""
    nodes, stiffness = bottom_of(simulation)
    return float(np.average(level - simulation.state.x[nodes, 1], weights=stiffness))


def resting_depth() -> float:
    """Pressure over stiffness per area."""
    return RHO * G * 0.1 / 2e7


def mean(simulation: Simulation, field: Any) -> Any:
    """Mass-weighted mean of a node field."""
    mass = simulation.discretization.lumped_mass
    return mass @ field / mass.sum()


@pytest.mark.parametrize("order", [1, 2])
def test_a_dropped_plate_comes_to_rest_on_the_ground(order: int) -> None:
    simulation = slab(obstacles=[ground()], at=[0.0, 0.02], order=order)
    fastest = 0.0
    for _ in range(150):
        step(simulation)
        fastest = max(fastest, np.abs(simulation.state.v).max())
    assert fastest > 0.3  # it did fall
    assert np.abs(simulation.state.v).max() < 1e-4
    (contact,) = simulation.problem.contacts
    assert depth_below(simulation) == pytest.approx(resting_depth(), rel=0.03)
    pushed = np.zeros_like(simulation.state.x)
    contact.add_gradient(simulation.state.x, pushed)
    np.testing.assert_allclose(-pushed.sum(axis=0), [0.0, RHO * G * 0.04], rtol=1e-4, atol=1e-6)


def stiffness_on(data: dict[str, Any]) -> tuple[Simulation, Any]:
    """Stiffness of every node [N/m] against an obstacle of 5 Pa/m, at the start of a step."""
    simulation = build(data)
    simulation.problem.begin_step(simulation.state, 0.01)
    (contact,) = simulation.problem.contacts
    stiffness = np.zeros(simulation.discretization.n_nodes)
    stiffness[contact.nodes] = contact.stiffness
    return simulation, stiffness


@pytest.mark.parametrize(("order", "dim"), [(1, 2), (2, 2), (1, 3), (2, 3)])
def test_only_the_surface_that_faces_the_obstacle_counts(order: int, dim: int) -> None:
    """The bottom as it is, other sides with the twentieth part that holds up a spike, and so for every side."""
    sides = {"bottom": (1, 1.0), "top": (1, -1.0), "left": (0, 1.0), "right": (0, -1.0)}
    size = [0.4, 0.2, 0.1][:dim]
    for name, (axis, sign) in sides.items():
        normal = (sign * np.eye(dim)[axis]).tolist()
        simulation, stiffness = stiffness_on(
            scene(
                {"b": body(block(size, [2, 1, 1][:dim]), element_order=order)},
                obstacles=[{"kind": "plane", "point": [-9.0 * c for c in normal], "normal": normal, "stiffness": 5.0}],
            )
        )
        whole = 1.2 if dim == 2 else 2 * (0.08 + 0.04 + 0.02)
        flat = float(np.prod(size)) / size[axis]
        assert stiffness.sum() == pytest.approx(5.0 * (flat + 0.05 * (whole - flat)), rel=1e-12), name
        surface = simulation.conditions.local_nodes("b.boundary")
        assert stiffness[surface].min() > 0.0


@pytest.mark.parametrize("angle", [0.0, 0.3, 1.2])
def test_cloth_and_rods_face_obstacles_with_both_sides(angle: float) -> None:
    """As much as is seen from the obstacle: a cosine, of the cloth about z, of the rod along x likewise."""
    turn = {"axis": [0, 0, 1], "angle": angle}
    cloth = {"recipe": "cloth", "size": [1.0, 0.6], "cells": [4, 3], "rotate": turn}
    rod = {"recipe": "rod", "end": [0.7, 0, 0], "cells": 5, "rotate": turn, "translate": [3.0, 0.0, 0.0]}
    for normal in (1.0, -1.0):
        plane = {"kind": "plane", "point": [0, -9.0 * normal, 0], "normal": [0, normal, 0], "stiffness": 5.0}
        bodies = {
            "cloth": body(cloth, STIFF, kind="membrane", thickness=1e-3),
            "rod": body(rod, STIFF, kind="rod", cross_section=1e-4),
        }
        simulation, stiffness = stiffness_on(scene(bodies, obstacles=[plane]))
        for name, area in (("cloth", 0.6), ("rod", 0.7 * 0.01)):
            nodes = simulation.conditions.local_nodes(name)
            assert stiffness[nodes].sum() == pytest.approx(5.0 * area * np.cos(angle), rel=1e-12)


def test_a_body_that_turns_over_stands_on_its_other_side() -> None:
    """What faces the obstacle is decided anew in every step."""
    simulation, before = stiffness_on(
        scene({"b": body(block([0.4, 0.1], [4, 1]))}, obstacles=[ground(point=[0.0, -1.0])])
    )
    simulation.state.x[:] *= -1.0
    simulation.problem.begin_step(simulation.state, 0.01)
    after = simulation.problem.contacts[0].stiffness
    top, bottom = (simulation.conditions.local_nodes(f"b.{side}") for side in ("top", "bottom"))
    order = simulation.problem.contacts[0].nodes
    assert after[np.searchsorted(order, top)].sum() == pytest.approx(before[bottom].sum())
    assert before[bottom].sum() > 10.0 * before[top].sum()


def test_it_rests_flat_on_the_ground() -> None:
    """As deep at the edges as between them: their nodes have no share of the sides."""
    simulation = slab({"kind": "fixed", "on": "b.left", "components": ["x"]}, obstacles=[ground()], time=quasistatic())
    step(simulation)
    nodes, _ = bottom_of(simulation)
    np.testing.assert_allclose(-simulation.state.x[nodes, 1], resting_depth(), rtol=0.1)


def slope(angle: float, friction: float) -> Simulation:
    """The plate on an incline: gravity is turned instead of the ground."""
    g = [G * np.sin(angle), -G * np.cos(angle)]
    return slab(obstacles=[ground(friction=friction)], gravity=g, at=[0.0, -RHO * G * np.cos(angle) * 0.1 / 2e7])


def test_friction_holds_on_a_gentle_slope() -> None:
    simulation = slope(0.3, friction=1.2 * np.tan(0.3))
    advance(simulation, 50)
    before = mean(simulation, simulation.state.x)[0]
    advance(simulation, 50)
    creep = (mean(simulation, simulation.state.x)[0] - before) / 0.5
    (contact,) = simulation.problem.contacts
    assert 0.0 < creep <= contact.stick_velocity
    # The force of a stuck node is a share of the limit, as large as the slip is of what sticks: 1 / 1.2.
    assert creep == pytest.approx(contact.stick_velocity / 1.2, rel=0.02)


@pytest.mark.parametrize("friction", [0.0, 0.1, 0.25])
def test_a_plate_slides_down_a_steep_slope(friction: float) -> None:
    angle = 0.4
    simulation = slope(angle, friction)
    advance(simulation, 40)
    before = mean(simulation, simulation.state.v)[0]
    advance(simulation, 40)
    acceleration = (mean(simulation, simulation.state.v)[0] - before) / 0.4
    assert acceleration == pytest.approx(G * (np.sin(angle) - friction * np.cos(angle)), rel=0.01)


def test_a_conveyor_belt_carries_the_plate_along() -> None:
    """Friction drags it with mu g until it moves with the belt, and no faster."""
    simulation = slab(obstacles=[ground(friction=0.3, velocity=[0.8, 0.0])], at=[0.0, -RHO * G * 0.1 / 2e7])
    advance(simulation, 20)
    assert mean(simulation, simulation.state.v)[0] == pytest.approx(0.3 * G * 0.2, rel=0.08)
    advance(simulation, 30)
    assert mean(simulation, simulation.state.v)[0] == pytest.approx(0.8, rel=0.01)


def test_a_rising_floor_lifts_the_plate() -> None:
    simulation = slab(obstacles=[ground(velocity=[0.0, 0.5])])
    advance(simulation, 60)
    assert mean(simulation, simulation.state.v)[1] == pytest.approx(0.5, rel=1e-3)
    assert depth_below(simulation, level=0.5 * 0.6) == pytest.approx(resting_depth(), rel=0.02)


def test_a_bowl_keeps_a_body_at_its_bottom() -> None:
    data = scene(
        {"b": body(block([0.2, 0.2, 0.2], [1, 1, 1], translate=[0.3, -0.1, 0.1]), STIFF)},
        gravity=[0.0, -G, 0.0],
        obstacles=[
            {"kind": "sphere", "center": [0, 0, 0], "radius": 1.0, "inside": True, "stiffness": 1e7, "friction": 0.2}
        ],
        time={"scheme": "backward_euler", "dt": 0.02, "end": 10.0},
    )
    simulation = build(data)
    advance(simulation, 150)
    x = simulation.state.x
    assert np.linalg.norm(x, axis=1).max() < 1.0 + 2e-3
    assert mean(simulation, x)[1] < -0.8
    assert np.abs(simulation.state.v).max() < 0.1


def test_a_ball_pushes_a_membrane_up() -> None:
    """A ball rises through a cloth that is held at its edges: the cloth lies on it."""
    edges = [{"kind": "fixed", "on": f"c.{side}"} for side in ("left", "right", "back", "front")]
    data = scene(
        {"c": body({"recipe": "cloth", "size": [1.0, 1.0], "cells": [8, 8]}, STIFF, kind="membrane", thickness=0.01)},
        *edges,
        obstacles=[
            {"kind": "sphere", "center": [0, -0.45, 0], "radius": 0.4, "velocity": [0, 0.5, 0], "stiffness": 1e7}
        ],
        time={"scheme": "backward_euler", "dt": 0.02, "end": 1.0},
    )
    simulation = build(data)
    advance(simulation, 20)  # its top is at 0.15 then
    x = simulation.state.x
    top = x[:, 1].max()
    assert top == pytest.approx(0.15, abs=0.01)
    assert (np.linalg.norm(x - [0.0, -0.25, 0.0], axis=1) > 0.4 - 5e-3).all()


@pytest.mark.parametrize("dim", [2, 3])
def test_a_container_keeps_a_thrown_body_inside(dim: int) -> None:
    throw = {"kind": "initial_velocity", "on": "b", "velocity": [3.0, -2.0, 2.5][:dim]}
    data = scene(
        {"b": body(block([0.2] * dim, [1] * dim, translate=[0.4] * dim), material(E=1e6))},
        throw,
        gravity=[0.0, -G, 0.0][:dim],
        obstacles=[{"kind": "box", "min": [0.0] * dim, "max": [1.0] * dim, "inside": True, "stiffness": 1e8}],
        time={"scheme": "backward_euler", "dt": 0.01, "end": 10.0},
    )
    simulation = build(data)
    for _ in range(80):
        step(simulation)
        assert simulation.state.x.min() > -0.02
        assert simulation.state.x.max() < 1.02


def test_a_body_in_the_corner_of_a_container_converges_quickly() -> None:
    """Nodes beyond an edge of the container are pushed back from both walls; Newton has to know of both."""
    data = scene(
        {"b": body(block([0.5, 0.5, 0.5], [1, 1, 1], translate=[-0.003, -0.002, -0.001]), material(E=1e6))},
        gravity=[-5.0, -G, -3.0],
        obstacles=[{"kind": "box", "min": [0, 0, 0], "max": [1, 1, 1], "inside": True, "stiffness": 1e9}],
        time=quasistatic(),
        solver={"tolerance": 1e-10},
    )
    simulation = build(data)
    result = step(simulation)
    assert result.iterations <= 12
    (contact,) = simulation.problem.contacts
    force = np.zeros_like(simulation.state.x)
    contact.add_gradient(simulation.state.x, force)
    np.testing.assert_allclose(-force.sum(axis=0), 1000.0 * 0.125 * np.array([5.0, G, 3.0]), rtol=1e-8)


def test_a_box_obstacle_holds_from_above_and_beside() -> None:
    """A plate lies across a box narrower than itself and bends over it."""
    table = {"kind": "box", "min": [0.1, -0.5], "max": [0.3, 0.0], "stiffness": 2e7, "friction": 0.5}
    simulation = slab(obstacles=[table])
    advance(simulation, 100)
    assert np.abs(simulation.state.v).max() < 1e-2
    x, X = simulation.state.x, simulation.discretization.points
    under = (X[:, 1] == 0.0) & (np.abs(X[:, 0] - 0.2) < 0.11)
    assert np.all(np.abs(x[under, 1]) < 2e-3)
    # A box from the side: the wall stops what flies against it.
    wall = {"kind": "box", "min": [0.6, -1.0], "max": [0.7, 1.0], "stiffness": 1e8}
    simulation = slab({"kind": "initial_velocity", "on": "b", "velocity": [2.0, 0.0]}, obstacles=[wall], gravity=None)
    advance(simulation, 40)
    assert simulation.state.x[:, 0].max() < 0.61


def test_default_stiffness_is_ten_moduli_over_an_element() -> None:
    simulation = slab(obstacles=[{"kind": "plane", "point": [0, 0], "normal": [0, 1]}])
    simulation.problem.begin_step(simulation.state, 0.01)
    nodes, stiffness = bottom_of(simulation)
    inside = np.abs(simulation.state.x[nodes, 0] - 0.2) < 0.15
    np.testing.assert_allclose(stiffness[inside], 10.0 * 1e6 / 0.1 * 0.1, rtol=1e-12)


def test_a_body_that_just_touches_the_floor_is_held_by_it() -> None:
    simulation = build(
        scene(
            {"b": body(block([0.4, 0.1], [4, 1]), STIFF)},
            {"kind": "fixed", "on": "b.left", "components": ["x"]},
            obstacles=[ground()],
            gravity=[0.0, -G],
            time=quasistatic(),
        )
    )
    result = step(simulation)
    assert result.converged
    weight = RHO * G * 0.4 * 0.1
    floor = simulation.problem.contacts[0]
    depth = -simulation.state.x[floor.nodes, 1]
    assert float(np.sum(floor.stiffness * np.maximum(depth, 0.0))) == pytest.approx(weight, rel=1e-6)
