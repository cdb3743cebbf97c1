"""Contact by weak constraints: PBNG against projected Newton, against barriers and obstacles, and what is conserved."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenario import block, body, build, material, quasistatic, scene

from femdeform.contact.weak_contact import WeakContact
from femdeform.errors import InputError
from femdeform.run.quantities import Meter
from femdeform.run.setup import Simulation
from solvers.position_based.node_sweep import NodeSweep

Array = NDArray[np.float64]
NEWTON = {"tolerance": 1e-10, "max_iterations": 60}
PBNG = {"method": "pbng", "tolerance": 1e-8, "max_iterations": 3000, "check_every": 5}
SOFT = material("neo_hookean", E=1e3, density=10.0)


def contact_of(simulation: Simulation) -> WeakContact:
    contact = simulation.problem.weak_contact
    assert contact is not None
    return contact


def two_blocks(dim: int, law: str = "neo_hookean", dynamic: bool = True, **more: Any) -> dict[str, Any]:
    """One block on a support, another one, shifted and of another mesh, pushed down onto it from a gap of 0.005 m."""
    stuff = material(law, E=1e3, density=10.0)
    lower = body(block([1.0, 0.5, 1.0][:dim], [4, 2, 3][:dim]), stuff)
    upper = body(block([0.8, 0.5, 0.8][:dim], [3, 2, 3][:dim], translate=[0.13, 0.505, 0.08][:dim]), stuff)
    down = [0.0, -1.0, 0.0][:dim]
    start = [{"kind": "initial_velocity", "on": "upper", "velocity": down}] if dynamic else []
    return scene(
        {"lower": lower, "upper": upper},
        {"kind": "fixed", "on": "lower.bottom"},
        {"kind": "translate", "on": "upper.top", "velocity": down},
        *start,
        **{
            "contact": {"method": "weak_constraints", "stiffness": 1e8},
            "time": {"scheme": "backward_euler", "dt": 0.002, "end": 1.0} if dynamic else quasistatic(dt=0.01, end=1.0),
            **more,
        },
    )


def solve(data: dict[str, Any], solver: dict[str, Any], steps: int) -> Simulation:
    simulation = build({**data, "solver": solver})
    dt = simulation.scene.time.dt
    for _ in range(steps):
        simulation.problem.begin_step(simulation.state, dt)
        result = simulation.solver.step(simulation.problem, simulation.state)
        assert result.converged, result.reason
        simulation.state = simulation.problem.accept(simulation.state, result.x)
    return simulation


def touching(simulation: Simulation) -> int:
    return contact_of(simulation).count(simulation.state.x)


# --------------------------------------------------------------------------------------- PBNG and projected Newton


@pytest.mark.parametrize("stiffness", [500.0, 1e8], ids=["soft", "stiff"])
@pytest.mark.parametrize("dynamic", [True, False], ids=["dynamic", "static"])
@pytest.mark.parametrize("dim", [2, 3])
def test_pbng_agrees_with_newton(dim: int, dynamic: bool, stiffness: float) -> None:
    contact = {"method": "weak_constraints", "stiffness": stiffness}
    data = two_blocks(dim, dynamic=dynamic, contact=contact)
    newton, pbng = (solve(data, solver, 8 if dynamic else 4) for solver in (NEWTON, PBNG))
    assert touching(newton) >= (3 if dim == 2 else 9)
    problem = pbng.problem
    assert problem.residual_norm(problem.gradient(pbng.state.x)) <= 1e-8 * problem.force_scale
    moved = np.abs(newton.state.x - newton.discretization.points).max()
    # Errors of each step are carried on.
    np.testing.assert_allclose(pbng.state.x, newton.state.x, rtol=0.0, atol=2e-7 * moved)


@pytest.mark.parametrize("law", ["fixed_corotated", "stable_neo_hookean", "logarithmic_neo_hookean"])
def test_other_laws(law: str) -> None:
    data = two_blocks(2, law)
    newton, pbng = (solve(data, solver, 12) for solver in (NEWTON, PBNG))
    assert touching(newton) >= 3
    np.testing.assert_allclose(pbng.state.x, newton.state.x, rtol=0.0, atol=1e-8)


@pytest.mark.parametrize(
    "more", [{"acceleration": "none"}, {"precision": "float32"}, {"finish": "newton_krylov"}], ids=str
)
def test_ways_to_sweep(more: dict[str, Any]) -> None:
    data = two_blocks(3)
    newton, pbng = (solve(data, solver, 6) for solver in (NEWTON, {**PBNG, **more}))
    assert touching(newton) >= 9
    np.testing.assert_allclose(pbng.state.x, newton.state.x, rtol=0.0, atol=1e-8)


def test_mixed_elements_agree() -> None:
    data = two_blocks(2, dynamic=False)
    newton, mixed = (solve(data, s, 4) for s in (NEWTON, {"method": "mixed_fem", "tolerance": 1e-10}))
    assert touching(newton) >= 3
    np.testing.assert_allclose(mixed.state.x, newton.state.x, rtol=0.0, atol=1e-9)


def test_with_ties_drag_and_an_obstacle() -> None:
    """Nodes that are tied, in contact and on the ground: one block moves them all."""
    top = {"kind": "tie", "on": "hat.bottom", "to": "upper.top", "stiffness": 1e7}
    data = two_blocks(2, contact={"method": "weak_constraints", "stiffness": 1e7, "tangential_stiffness": 1e4})
    hat = body(block([0.8, 0.2], [3, 1], translate=[0.13, 1.005]), SOFT)
    velocity = [{"kind": "initial_velocity", "on": name, "velocity": [0.2, -1.0]} for name in ("upper", "hat")]
    data = {
        **data,
        "bodies": {**data["bodies"], "hat": hat},
        "conditions": velocity,
        "links": {"t": top},
        "obstacles": [{"kind": "plane", "point": [0, 0], "normal": [0, 1]}],
    }
    newton, pbng = (solve(data, solver, 10) for solver in (NEWTON, PBNG))
    assert touching(newton) >= 3
    np.testing.assert_allclose(pbng.state.x, newton.state.x, rtol=0.0, atol=1e-7)


# ------------------------------------------------------------------------------------------------- against others


def test_force_is_stiffness_times_depth_and_the_limit_is_that_of_barriers() -> None:
    """Blocks pressed together: the supports carry what the rows push; stiff rows lead to what barriers give."""
    measure = {"force": {"kind": "reaction", "on": "upper.top", "component": "y"}}
    pushes = {}
    for stiffness in (1e3, 1e4, 1e6):
        data = two_blocks(
            2, dynamic=False, measure=measure, contact={"method": "weak_constraints", "stiffness": stiffness}
        )
        simulation = solve(data, NEWTON, 6)
        contact, x = contact_of(simulation), simulation.state.x
        gaps = np.minimum(contact.gaps(x), 0.0)
        held = np.isin(contact.cells[:, 0], np.flatnonzero(simulation.discretization.points[:, 1] > 0.502))
        sign = np.where(held, 1.0, -1.0)
        carried = float(-np.sum(contact.normal_stiffness * gaps * sign * contact.normals[:, 1]))
        pushes[stiffness] = -Meter(simulation).evaluate(simulation.state)["force"]
        assert carried == pytest.approx(pushes[stiffness], rel=1e-6)
    assert pushes[1e3] < pushes[1e4] < pushes[1e6]
    barrier = two_blocks(
        2, dynamic=False, measure=measure, contact={"method": "ipc", "distance": 2e-4, "stiffness": 1e3}
    )
    simulation = solve(barrier, NEWTON, 6)
    exact = -Meter(simulation).evaluate(simulation.state)["force"]
    assert pushes[1e6] == pytest.approx(exact, rel=0.02)
    assert abs(pushes[1e6] - exact) < abs(pushes[1e3] - exact)


def test_a_hard_block_is_an_obstacle() -> None:
    """A soft block falls onto a block that is held everywhere, and onto a plane there."""
    soft = body(block([0.6, 0.5], [3, 3], translate=[0.2, 0.505]), SOFT)
    hard = body(block([1.0, 0.5], [3, 2]), SOFT)
    fall = {"kind": "initial_velocity", "on": "soft", "velocity": [0.0, -1.0]}
    contact = {"method": "weak_constraints", "stiffness": 1e7, "per": "area"}
    held = {"kind": "fixed", "on": "hard"}
    time = {"scheme": "backward_euler", "dt": 0.002, "end": 1.0}
    blocks = solve(scene({"hard": hard, "soft": soft}, held, fall, contact=contact, time=time), NEWTON, 60)
    plane = [{"kind": "plane", "point": [0, 0.5], "normal": [0, 1], "stiffness": 1e7}]
    alone = solve(scene({"soft": soft}, fall, obstacles=plane, time=time), NEWTON, 60)
    mine = blocks.discretization.bodies["soft"]
    x = blocks.state.x[mine.first : mine.first + mine.n_nodes]
    moved = np.abs(alone.state.x - alone.discretization.points).max()
    assert moved > 0.01
    np.testing.assert_allclose(x, alone.state.x, rtol=0.0, atol=0.02 * moved)


# ------------------------------------------------------------------------------------------------- what is conserved


@pytest.mark.parametrize("solver", [NEWTON, {**PBNG, "tolerance": 1e-9}], ids=["newton", "pbng"])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_free_impact(dim: int, solver: dict[str, Any]) -> None:
    """Two blocks hit each other off centre: momentum stays, angular momentum nearly, energy does not rise."""
    a = body(block([0.5] * dim, [3, 3, 2][:dim]), SOFT)
    b = body(block([0.5] * dim, [2, 3, 3][:dim], translate=[0.2, 0.505, 0.1][:dim]), SOFT)
    down, up = [0.0, -1.0, 0.0][:dim], [0.0, 0.5, 0.0][:dim]
    data = scene(
        {"a": a, "b": b},
        {"kind": "initial_velocity", "on": "a", "velocity": up},
        {"kind": "initial_velocity", "on": "b", "velocity": down},
        contact={"method": "weak_constraints", "stiffness": 1e6},
        time={"scheme": "backward_euler", "dt": 0.002, "end": 1.0},
    )
    simulation = build({**data, "solver": solver})
    mass = simulation.discretization.lumped_mass[:, None]
    problem = simulation.problem

    def spin(x: Array, v: Array) -> float:
        return float(np.sum(mass[:, 0] * (x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0])))

    def energy() -> float:
        x, v = simulation.state.x, simulation.state.v
        return problem.kinetic_energy(v) + problem.elastic_energy(x) + problem.contact_energy(x)

    momentum = (mass * simulation.state.v).sum(axis=0)
    turning = spin(simulation.state.x, simulation.state.v)
    size = float(np.abs(mass * simulation.state.v).sum())
    before, hits = energy(), 0
    for _ in range(40):
        problem.begin_step(simulation.state, 0.002)
        start = simulation.state
        result = simulation.solver.step(problem, start)
        assert result.converged, result.reason
        simulation.state = problem.accept(start, result.x)
        # Backward Euler loses h m v' x v of it in each step, contact or not.
        turning += 0.002 * spin(simulation.state.v, start.v)
        after = energy()
        assert after <= before + 1e-6 * abs(before)
        before = after
        hits = max(hits, touching(simulation))
    assert hits >= (2 if dim == 2 else 5)
    np.testing.assert_allclose((mass * simulation.state.v).sum(axis=0), momentum, rtol=0.0, atol=1e-8 * size)
    assert abs(spin(simulation.state.x, simulation.state.v) - turning) < 2e-3 * size


def test_a_strip_bends_onto_itself() -> None:
    """A horseshoe whose ends are pressed together: they meet and do not pass."""
    strip = body(block([2.0, 0.1], [40, 2]), material("neo_hookean", E=1e4, density=10.0))
    ends = [
        {"kind": "rotate", "on": "strip.left", "center": [1.0, 0.05], "rate": 1.2},
        {"kind": "rotate", "on": "strip.right", "center": [1.0, 0.05], "rate": -1.2},
    ]
    data = scene(
        {"strip": strip},
        *ends,
        contact={"method": "weak_constraints", "stiffness": 1e5},
        time=quasistatic(dt=0.05, end=1.4),
    )
    newton = solve(data, {**NEWTON, "tolerance": 1e-8}, 27)
    contact, x = contact_of(newton), newton.state.x
    assert contact.count(x) >= 2
    assert contact.penetration(x) < 0.01
    free = solve({**data, "contact": {"method": "penalty"}}, {**NEWTON, "tolerance": 1e-8}, 27)
    assert np.abs(free.state.x - x).max() > 0.01  # without contact the ends go through each other


# ------------------------------------------------------------------------------------------------- what PBNG lays out


def test_only_nodes_in_contact_change_their_place_in_the_sweep() -> None:
    simulation = build({**two_blocks(3), "solver": PBNG})
    problem, dt = simulation.problem, 0.002
    problem.begin_step(simulation.state, dt)
    sweep = NodeSweep(problem)
    order, parts = sweep.numbering.order.copy(), list(sweep._parts)
    sweep.begin_step(problem)
    blocks = []
    state = simulation.state
    for shift in (0.0, 0.0, 0.1, 5.0, 0.0):
        state.x[:] = simulation.discretization.points
        state.x[simulation.discretization.points[:, 1] > 0.502, 0] += shift
        problem.begin_step(state, dt)
        sweep.begin_step(problem)
        assert np.array_equal(sweep.numbering.order, order)
        assert all(a is b for a, b in zip(sweep._parts, parts, strict=True))
        held = np.zeros(len(order), dtype=bool)
        if sweep.block is not None:
            held[sweep.block.nodes] = True
        rows = contact_of(simulation).nodes()
        movable = problem.free.any(axis=1)
        assert np.array_equal(np.flatnonzero(held), rows[movable[rows]])
        # Colours pass the block's nodes by, and them only.
        passed = ~sweep._free.reshape(-1, 3)[sweep.numbering.place, :3].any(axis=1)
        assert np.array_equal(passed, held | ~movable)
        blocks.append(sweep.block)
    assert blocks[0] is blocks[1]  # the same nodes: nothing is made anew
    assert blocks[2] is not blocks[1]
    assert blocks[3] is None
    assert blocks[4] is not None


def test_a_fast_body_is_caught() -> None:
    """A block that would fly right through another one in a single step is stopped by planes found on its way."""
    stiff = material("neo_hookean", E=1e6, density=10.0)
    thin = body(block([1.0, 0.1], [4, 1]), stiff)
    ball = body(block([0.3, 0.3], [2, 2], translate=[0.35, 0.3]), stiff)
    data = scene(
        {"thin": thin, "ball": ball},
        {"kind": "fixed", "on": "thin"},
        {"kind": "initial_velocity", "on": "ball", "velocity": [0.0, -50.0]},
        contact={"method": "weak_constraints", "stiffness": 1e8},
        time={"scheme": "backward_euler", "dt": 0.01, "end": 1.0},
    )
    simulation = solve(data, {**NEWTON, "tolerance": 1e-8}, 1)
    place = simulation.discretization.bodies["ball"]
    x = simulation.state.x[place.first : place.first + place.n_nodes]
    assert x[:, 1].min() > 0.099  # in free flight -0.2


def test_faults_are_told() -> None:
    data = two_blocks(2)
    with pytest.raises(InputError, match="penalty only"):
        build({**data, "solver": {"method": "xpbd"}})
    with pytest.raises(InputError, match="alternating"):
        build({**data, "solver": {"method": "mixed_fem", "scheme": "alternating"}})
    sheet = {"mesh": {"recipe": "cloth", "size": [1.0, 1.0], "cells": [2, 2]}, "kind": "membrane", "thickness": 0.01}
    bodies = {"s": {**sheet, "material": SOFT}}
    with pytest.raises(InputError, match="solids only"):
        build(scene(bodies, contact={"method": "weak_constraints"}))
    with pytest.raises(InputError, match="weak_constraints only"):
        build({**data, "contact": {"method": "penalty"}, "measure": {"d": {"kind": "penetration"}}})
