"""Incremental potential contact in whole simulations: forces in balance, friction, folds, and nothing ever crosses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scenario import advance, block, body, build, material, quasistatic, scene, step

from femdeform.contact.ipc import IPCContact
from femdeform.contact.obstacle_barrier import ObstacleBarrier
from femdeform.run.setup import Simulation
from femdeform.step_problem import Budget

G = 9.81
RHO = 1000.0
STIFF = material(E=1e6, nu=0.3, density=RHO)
IPC: dict[str, Any] = {"method": "ipc"}


def ground(dim: int, **more: Any) -> dict[str, Any]:
    return {"kind": "plane", "point": [0.0] * dim, "normal": [0.0, 1.0, 0.0][:dim], **more}


def bodies_contact(simulation: Simulation) -> IPCContact:
    (contact,) = simulation.problem.couplings
    assert isinstance(contact, IPCContact)
    return contact


def barriers(simulation: Simulation) -> list[ObstacleBarrier]:
    return [contact for contact in simulation.problem.contacts if isinstance(contact, ObstacleBarrier)]


def force_of(term: Any, x: Any) -> Any:
    out = np.zeros_like(x)
    term.add_gradient(x, out)
    return -out


def assert_nothing_crosses(simulation: Simulation) -> None:
    """By ipctk's own test of intersection, by the smallest distance and by the gaps to obstacles."""
    x = simulation.state.x
    for contact in simulation.problem.couplings:
        assert not contact.intersects(x)
        assert contact.smallest_distance(x) > contact.offset
    for barrier in barriers(simulation):
        assert barrier.gaps(x).min() > 0.0


def run_through(simulation: Simulation, steps: int, look: Callable[[], None] = lambda: None) -> None:
    for _ in range(steps):
        step(simulation)
        assert_nothing_crosses(simulation)
        look()


def mean(simulation: Simulation, field: Any, nodes: Any) -> Any:
    mass = simulation.discretization.lumped_mass[nodes]
    return mass @ field[nodes] / mass.sum()


# ------------------------------------------------------------------------------------------------- equilibrium


def column(dim: int, order: int = 1) -> Simulation:
    """Two blocks, one on the other on the ground, guided on two sides."""
    size, cells = [0.4, 0.2, 0.3][:dim], [2, 1, 2][:dim]
    upper = [0.0, 0.21, 0.0][:dim]
    bodies = {
        "lower": body(block(size, cells, translate=[0.0, 0.005, 0.0][:dim]), STIFF, element_order=order),
        "upper": body(block(size, [3, 1, 3][:dim], translate=upper), STIFF, element_order=order),
    }
    guides = [{"kind": "fixed", "on": f"{b}.left", "components": ["x"]} for b in bodies]
    if dim == 3:
        guides += [{"kind": "fixed", "on": f"{b}.back", "components": ["z"]} for b in bodies]
    return build(
        scene(
            bodies,
            *guides,
            obstacles=[ground(dim)],
            gravity=[0.0, -G, 0.0][:dim],
            contact={**IPC, "distance": 0.01},
            time=quasistatic(0.5),
            solver={"tolerance": 1e-10},
        )
    )


@pytest.mark.parametrize(("dim", "order"), [(2, 1), (3, 1), (2, 2), (3, 2)])
def test_weights_are_carried_from_body_to_body_to_the_ground(dim: int, order: int) -> None:
    simulation = column(dim, order)
    run_through(simulation, 2)
    weight = RHO * G * 0.4 * 0.2 * (0.3 if dim == 3 else 1.0)
    x = simulation.state.x
    (floor,) = barriers(simulation)
    assert force_of(floor, x)[:, 1].sum() == pytest.approx(2.0 * weight, rel=1e-6)
    push = force_of(bodies_contact(simulation), x)
    upper = simulation.conditions.local_nodes("upper")
    lower = simulation.conditions.local_nodes("lower")
    assert push[upper][:, 1].sum() == pytest.approx(weight, rel=1e-6)
    np.testing.assert_allclose(push[upper].sum(axis=0), -push[lower].sum(axis=0), atol=1e-9 * weight)


def test_the_gap_needs_no_tuning() -> None:
    """From soft to stiff bodies the gap under a body's weight stays near the distance at which contact begins."""
    for E in (2e4, 1e6, 1e10):
        data = scene(
            {"b": body(block([0.2, 0.1], [2, 1], translate=[0.0, 0.005]), material(E=E))},
            obstacles=[ground(2)],
            gravity=[0.0, -G],
            contact={**IPC, "self_contact": False},
            time={"scheme": "backward_euler", "dt": 0.02, "end": 10.0},
        )
        simulation = build(data)
        assert not simulation.problem.couplings
        run_through(simulation, 40)
        (floor,) = barriers(simulation)
        assert 0.6 * floor.reach < floor.gaps(simulation.state.x).min() < floor.reach


# ---------------------------------------------------------------------------------------------------- friction


def slider(angle: float, friction: float, on: str) -> Simulation:
    """A plate on an incline (gravity is turned), which is an obstacle or a body held in place."""
    bodies = {"b": body(block([0.3, 0.1], [3, 1], translate=[0.2, 0.0085]), STIFF)}
    conditions: list[dict[str, Any]] = []
    more: dict[str, Any] = {}
    if on == "obstacle":
        more["obstacles"] = [ground(2, friction=friction)]
    else:
        bodies["slope"] = body(block([2.5, 0.1], [9, 1], translate=[0.0, -0.1]), STIFF)
        conditions.append({"kind": "fixed", "on": "slope"})
    return build(
        scene(
            bodies,
            *conditions,
            gravity=[G * float(np.sin(angle)), -G * float(np.cos(angle))],
            contact={**IPC, "distance": 0.01, "friction": friction, "friction_velocity": 2e-3},
            **more,
        )
    )


@pytest.mark.parametrize("on", ["obstacle", "body"])
def test_friction_holds_below_its_angle(on: str) -> None:
    simulation = slider(0.3, 1.2 * float(np.tan(0.3)), on)
    nodes = simulation.conditions.local_nodes("b")
    run_through(simulation, 60)
    before = mean(simulation, simulation.state.x, nodes)[0]
    run_through(simulation, 40)
    creep = (mean(simulation, simulation.state.x, nodes)[0] - before) / 0.4
    # The force of the slip s below eps_v is 2 s/eps_v - (s/eps_v)^2 of the limit: 1 / 1.2 of it is taken.
    part = 1.0 - np.sqrt(1.0 - 1.0 / 1.2)
    assert creep == pytest.approx(part * 2e-3, rel=0.03)


@pytest.mark.parametrize("on", ["obstacle", "body"])
@pytest.mark.parametrize("friction", [0.0, 0.2])
def test_a_body_slides_above_its_angle(on: str, friction: float) -> None:
    angle = 0.4
    simulation = slider(angle, friction, on)
    nodes = simulation.conditions.local_nodes("b")
    run_through(simulation, 40)
    before = mean(simulation, simulation.state.v, nodes)[0]
    run_through(simulation, 30)
    acceleration = (mean(simulation, simulation.state.v, nodes)[0] - before) / 0.3
    # Edges of a flat surface that is made of segments are no bumps: contact knows no direction along it.
    assert acceleration == pytest.approx(G * (np.sin(angle) - friction * np.cos(angle)), rel=0.02)


# --------------------------------------------------------------------------------------------- moving supports


def test_a_press_does_not_tunnel_and_needs_no_small_steps() -> None:
    """A plate comes down by a third of a block's height, in steps of many gaps."""
    for dt in (1.0, 0.1):
        data = scene(
            {
                "soft": body(block([0.4, 0.2], [6, 3]), material(E=1e5)),
                "plate": body(block([0.3, 0.05], [3, 1], translate=[0.05, 0.22]), material(E=1e8)),
            },
            {"kind": "fixed", "on": "soft.bottom"},
            {"kind": "translate", "on": "plate.top", "velocity": [0.0, -0.09]},
            contact=IPC,
            time=quasistatic(dt),
        )
        simulation = build(data)
        run_through(simulation, round(1.0 / dt))
        x = simulation.state.x
        soft = simulation.conditions.local_nodes("soft")
        bottom = x[simulation.conditions.local_nodes("plate.bottom"), 1].min()
        assert bottom < 0.14
        assert x[simulation.conditions.local_nodes("soft.top"), 1].min() < bottom
        push = force_of(bodies_contact(simulation), x)[soft].sum(axis=0)
        held = simulation.problem.full_gradient(x)[simulation.conditions.local_nodes("plate.top")].sum(axis=0)
        np.testing.assert_allclose(push, held, atol=1e-6 * np.linalg.norm(held))


def test_a_moving_obstacle_takes_bodies_along() -> None:
    """A piston, faster than its gap a step, drives a block against a wall."""
    data = scene(
        {"b": body(block([0.2, 0.2], [3, 3], translate=[0.3, 0.0]), material(E=1e5))},
        obstacles=[
            {"kind": "plane", "point": [0.25, 0.0], "normal": [1.0, 0.0], "velocity": [0.5, 0.0]},
            {"kind": "plane", "point": [0.6, 0.0], "normal": [-1.0, 0.0]},
        ],
        contact=IPC,
        time={"scheme": "backward_euler", "dt": 0.05, "end": 10.0},
    )
    simulation = build(data)
    run_through(simulation, 8)
    width = np.ptp(simulation.state.x[:, 0])
    assert 0.6 - 0.25 - 0.2 - 2 * barriers(simulation)[0].reach < width < 0.15


def test_a_motion_that_cannot_be_is_refused() -> None:
    """One held body is driven through another one."""
    data = scene(
        {
            "a": body(block([0.2, 0.2], [2, 2])),
            "b": body(block([0.2, 0.2], [2, 2], translate=[0.05, 0.25])),
        },
        {"kind": "fixed", "on": "a"},
        {"kind": "translate", "on": "b", "velocity": [0.0, -10.0]},
        contact=IPC,
    )
    simulation = build(data)
    problem, state = simulation.problem, simulation.state
    problem.begin_step(state, 0.01)
    result = simulation.solver.step(problem, state)
    assert not result.converged
    assert "of the prescribed motion could be carried out" in result.reason
    # Half of it is possible.
    problem.begin_step(state, 0.004)
    assert simulation.solver.step(problem, state).converged


# ------------------------------------------------------------------------------------------------ self contact


def test_a_cloth_folds_onto_itself() -> None:
    data = scene(
        {
            "c": body(
                {"recipe": "cloth", "size": [1.0, 0.5], "cells": [10, 5]},
                material(E=2e5, density=300.0),
                kind="membrane",
                thickness=2e-3,
            )
        },
        {"kind": "fixed", "on": "c.left"},
        {
            "kind": "path",
            "on": "c.right",
            "times": [0.0, 0.5, 1.0],
            "displacements": [[0.0, 0.0, 0.0], [-0.5, 0.4, 0.0], [-0.9, 0.08, 0.0]],
        },
        gravity=[0.0, -G, 0.0],
        obstacles=[ground(3, point=[0.0, -0.05, 0.0])],
        contact=IPC,
        time={"scheme": "backward_euler", "dt": 0.025, "end": 1.0},
        solver={"tolerance": 1e-6},
    )
    simulation = build(data)
    contact = bodies_contact(simulation)
    assert contact.offset == pytest.approx(2e-3)
    counts: list[int] = []
    run_through(simulation, 44, lambda: counts.append(contact.count(simulation.state.x)))
    assert max(counts) > 50
    # Two layers lie one upon the other: above the floor by half a thickness, apart by a whole one.
    x = simulation.state.x
    assert x[:, 1].min() > -0.05 + 1e-3
    assert contact.smallest_distance(x) > 2e-3


def test_a_ring_hangs_on_the_rod_that_goes_through_it() -> None:
    data = scene(
        {
            "ring": body(
                {
                    "recipe": "torus",
                    "radius": 0.2,
                    "tube_radius": 0.06,
                    "element_size": 0.09,
                    "rotate": {"axis": [0.0, 0.0, 1.0], "angle": float(np.pi / 2)},
                },
                material(E=1e6),
            ),
            "rod": body(
                {"recipe": "rod", "start": [-0.5, 0.0, 0.0], "end": [0.5, 0.0, 0.0], "cells": 12},
                material(E=1e8),
                kind="rod",
                cross_section=1e-4,
            ),
        },
        {"kind": "fixed", "on": "rod.start"},
        {"kind": "fixed", "on": "rod.end"},
        gravity=[0.0, -G, 0.0],
        contact={**IPC, "between": [["rod", "ring"]], "self_contact": False},
        time={"scheme": "backward_euler", "dt": 0.02, "end": 1.0},
    )
    simulation = build(data)
    contact = bodies_contact(simulation)
    # The rod's radius is kept between the two.
    assert contact.offset == pytest.approx(np.sqrt(1e-4 / np.pi), rel=1e-12)
    run_through(simulation, 40)
    ring = simulation.conditions.local_nodes("ring")
    center = mean(simulation, simulation.state.x, ring)
    assert -0.6 < center[1] < -0.1  # free fall would have taken it to -3.1


# ------------------------------------------------------------------------------------------------- conservation


@pytest.mark.parametrize("dim", [2, 3])
def test_momentum_is_conserved_in_a_collision(dim: int) -> None:
    size, cells = [0.2] * dim, [2] * dim
    data = scene(
        {
            "a": body(block(size, cells), material(E=1e5)),
            "b": body(block(size, cells, translate=[0.25, 0.07, 0.05][:dim]), material(E=3e5, density=2000.0)),
        },
        {"kind": "initial_velocity", "on": "a", "velocity": [3.0, 0.4, 0.0][:dim]},
        contact={**IPC, "friction": 0.3},
        solver={"tolerance": 1e-11},
    )
    simulation = build(data)
    mass = simulation.discretization.lumped_mass[:, None]
    before = (mass * simulation.state.v).sum(axis=0)
    counts: list[int] = []
    run_through(simulation, 30, lambda: counts.append(bodies_contact(simulation).count(simulation.state.x)))
    assert max(counts) > 0
    b = simulation.conditions.local_nodes("b")
    assert mean(simulation, simulation.state.v, b)[0] > 0.5  # it was hit
    after = (mass * simulation.state.v).sum(axis=0)
    np.testing.assert_allclose(after, before, atol=1e-7 * np.linalg.norm(before))


@pytest.mark.parametrize("seed", [0, 1, 2, 3, 4, 21])
def test_random_drops(seed: int) -> None:
    """Bodies of several kinds, thrown into a container at random: nothing crosses, and no energy comes from nothing."""
    rng = np.random.default_rng(seed)

    def placed(height: float) -> dict[str, Any]:
        axis = rng.standard_normal(3)
        return {
            "rotate": {"axis": [float(c) for c in axis], "angle": float(rng.uniform(0.0, 3.0))},
            "translate": [float(rng.uniform(-0.1, 0.1)), height, float(rng.uniform(-0.1, 0.1))],
        }

    def stuff() -> dict[str, Any]:
        E, density = 10.0 ** rng.uniform(4.5, 8.0), rng.uniform(200.0, 3000.0)
        return material("stable_neo_hookean", E=float(E), density=float(density))

    cube = block([0.2, 0.2, 0.2], [2, 2, 2])
    cloth = {"recipe": "cloth", "size": [0.4, 0.4], "cells": [4, 4]}
    data = scene(
        {
            "a": body({**cube, **placed(0.35)}, stuff()),
            "b": body({**cube, **placed(0.9)}, stuff()),
            "c": body({**cloth, **placed(1.5)}, stuff(), kind="membrane", thickness=2e-3),
        },
        *(
            {"kind": "initial_velocity", "on": name, "velocity": [float(c) for c in rng.uniform(-3.0, 3.0, 3)]}
            for name in "abc"
        ),
        obstacles=[{"kind": "box", "min": [-0.6, 0.0, -0.6], "max": [0.6, 2.5, 0.6], "inside": True}],
        gravity=[0.0, -G, 0.0],
        contact={**IPC, "friction": 0.2},
        time={"scheme": "backward_euler", "dt": 0.02, "end": 10.0},
        solver={"tolerance": 1e-6},
    )
    simulation = build(data)
    problem = simulation.problem

    def energy() -> float:
        state = simulation.state
        stored = problem.kinetic_energy(state.v) + problem.elastic_energy(state.x) + problem.load_potential(state.x)
        for term in (*barriers(simulation), bodies_contact(simulation)):
            # Without friction, whose work is not stored; a step begun again changes nothing.
            friction, term.friction = term.friction, 0.0
            term.begin_step(state.x, problem.time, problem.dt)
            stored += term.value(state.x)
            term.friction = friction
        return stored

    problem.begin_step(simulation.state, 0.02)
    energies = [energy()]
    run_through(simulation, 40, lambda: energies.append(energy()))
    # Backward Euler only takes energy away, up to the tolerance of the steps and what a non-convex energy may give.
    assert np.diff(energies).max() < 1e-3 * energies[0]
    assert energies[-1] < energies[0]


def test_a_bullet_does_not_tunnel() -> None:
    """Within one step it would fly ten times through the sheet."""
    data = scene(
        {
            "sheet": body(
                {"recipe": "cloth", "size": [1.0, 1.0], "cells": [6, 6]},
                material(E=1e6),
                kind="membrane",
                thickness=0.005,
            ),
            "bullet": body(block([0.05, 0.05, 0.05], [1, 1, 1], translate=[0.03, 0.2, 0.01]), material(E=1e8)),
        },
        *({"kind": "fixed", "on": f"sheet.{side}"} for side in ("left", "right", "front", "back")),
        {"kind": "initial_velocity", "on": "bullet", "velocity": [0.0, -50.0, 0.0]},
        contact=IPC,
        time={"scheme": "backward_euler", "dt": 0.02, "end": 10.0},
    )
    simulation = build(data)
    run_through(simulation, 12)
    bullet = simulation.conditions.local_nodes("bullet")
    assert mean(simulation, simulation.state.v, bullet)[1] > -1.0  # caught, or thrown back


def test_a_scene_without_contact_pays_nothing() -> None:
    """A scene with the method but nothing in reach gives the very bits of one without it."""
    bodies = {"b": body(block([0.4, 0.1, 0.1], [4, 1, 1]))}
    held = {"kind": "fixed", "on": "b.left"}
    with_method = build(scene(bodies, held, gravity=[0.0, -G, 0.0], contact={**IPC, "distance": 1e-3}))
    without = build(scene(bodies, held, gravity=[0.0, -G, 0.0]))
    assert not without.problem.has_barriers
    np.testing.assert_array_equal(advance(with_method, 5).x, advance(without, 5).x)


def test_a_budget_ends_the_way_of_the_supports_too() -> None:
    data = scene(
        {
            "soft": body(block([0.4, 0.2], [6, 3]), material(E=1e5)),
            "plate": body(block([0.3, 0.05], [3, 1], translate=[0.05, 0.22]), material(E=1e8)),
        },
        {"kind": "fixed", "on": "soft.bottom"},
        {"kind": "translate", "on": "plate.top", "velocity": [0.0, -0.09]},
        contact=IPC,
        time=quasistatic(1.0),
    )
    simulation = build(data)
    problem, state = simulation.problem, simulation.state
    problem.begin_step(state, 1.0)
    result = simulation.solver.step(problem, state, budget=Budget(iterations=2))
    assert not result.converged
    assert "the budget of 2 iterations is spent" in result.reason
    assert result.iterations <= 5
