"""XPBD and PBD on membranes and rods: what they promise, one-sided tethers, no scale, threads."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenario import body, build, displacement, material, scene

from femdeform.fem.thin_constraints import enclosed_volume
from femdeform.fem.thin_kernels import BENDING, BOW, DISTANCE, FLEX_X, FLEX_Y, FLEX_Z, TETHER
from femdeform.jit import set_threads
from femdeform.run.setup import Simulation
from solvers.position_based.constraint_sweeps import ConstraintSweep

Array = NDArray[np.float64]
# Nodes of each kind of constraint.
COUNTS = np.zeros(7, dtype=np.int64)
COUNTS[[DISTANCE, TETHER, BENDING, FLEX_X, FLEX_Y, FLEX_Z, BOW]] = 2, 2, 4, 3, 3, 3, 3


def rope(method: str = "xpbd", scale: float = 1.0, density: float = 1000.0, **more: Any) -> Simulation:
    """A rope of 1 m and 0.1 kg under gravity, held at its top: E A = 20 N."""
    s, heavy = scale, density / 1000.0
    constraints = more.pop("constraints", {})
    mesh = {"recipe": "rod", "end": [0.0, -1.0 * s, 0.0], "cells": 8}
    stuff = material("fixed_corotated", E=2e5 * heavy * s * s, density=density)
    return build(
        scene(
            {"r": body(mesh, stuff, kind="rod", cross_section=1e-4 * s * s, constraints=constraints)},
            {"kind": "fixed", "on": "r.start"},
            gravity=[0.0, -9.81 * s, 0.0],
            solver={"method": method, "iterations": 20, **more},
        )
    )


def cloth(constraints: dict[str, Any], method: str = "xpbd", **more: Any) -> Simulation:
    stuff = material("fixed_corotated", E=2e5, density=300.0)
    mesh = {"recipe": "cloth", "size": [1.0, 1.0], "cells": [8, 8]}
    return build(
        scene(
            {"c": body(mesh, stuff, kind="membrane", thickness=1e-3, constraints=constraints)},
            {"kind": "fixed", "on": "c.left_back"},
            {"kind": "fixed", "on": "c.right_back"},
            gravity=[0.0, -9.81, 0.0],
            solver={"method": method, "iterations": 20, **more},
        )
    )


def advance(simulation: Simulation, steps: int) -> Array:
    for _ in range(steps):
        simulation.problem.begin_step(simulation.state, simulation.scene.time.dt)
        result = simulation.solver.step(simulation.problem, simulation.state)
        assert result.accepted, result.reason
        simulation.state = simulation.problem.accept(simulation.state, result.x)
    return simulation.state.x


def test_the_stretch_of_a_rope_does_not_depend_on_the_number_of_sweeps() -> None:
    """Hanging at rest it is m g / (2 E A) longer, by 2.45 %, with 300 sweeps as with 600; PBD's is stiff."""
    found = []
    for iterations in (300, 600):
        simulation = rope(iterations=iterations)
        advance(simulation, 60)
        simulation.state.v[:] = 0.0  # what is left of the swinging
        advance(simulation, 60)
        found.append(-float(displacement(simulation)[:, 1].min()))
    weight = simulation.discretization.lumped_mass @ (simulation.discretization.points[:, 1] != 0.0)
    assert 0.8 < weight / 0.1 <= 1.0
    assert found[0] == pytest.approx(0.1 * 9.81 / (2.0 * 20.0), rel=0.05)
    assert found[1] == pytest.approx(found[0], rel=1e-6)
    assert -displacement(simulation)[:, 1].min() > 0.0
    stiff = rope("pbd", iterations=300)
    advance(stiff, 120)
    assert -displacement(stiff)[:, 1].min() < 0.05 * found[0]


def wire(stiffness: float | None, scale: float = 1.0, heavy: float = 1.0, cells: int = 8, **more: Any) -> Simulation:
    """A wire of 1 m and 0.1 kg that is clamped level at one end: two nodes are held."""
    s = scale
    mesh = {"recipe": "rod", "start": [-s / cells, 0.0, 0.0], "end": [s, 0.0, 0.0], "cells": cells + 1}
    stuff = material("fixed_corotated", E=2e6 * heavy * s * s, density=1000.0 * heavy)
    bending = {} if stiffness is None else {"bending_stiffness": stiffness * heavy * s**6}
    return build(
        scene(
            {"w": body(mesh, stuff, kind="rod", cross_section=1e-4 * s * s, constraints=bending)},
            {"kind": "fixed", "on": {"box": [[-s] * 3, [1e-6 * s] * 3]}},
            gravity=[0.0, -9.81 * s, 0.0],
            solver={"method": "xpbd", "iterations": 50, **more},
        )
    )


def droop(simulation: Simulation) -> float:
    """Of the tip at rest; what is left of the swinging is taken away again and again."""
    for _ in range(8):
        advance(simulation, 40)
        simulation.state.v[:] = 0.0
    advance(simulation, 60)
    return -float(displacement(simulation)[:, 1].min())


def test_a_wire_droops_as_a_beam_does() -> None:
    """q L^4 / (8 B), the clamp being half an edge before the last node held; the same with twice the sweeps."""
    weight = 0.1 * 9.81
    for stiffness in (2.0, 4.0):
        found = [droop(wire(stiffness, cells=5, iterations=n)) for n in (100, 200)]
        length = 1.0 + 0.5 / 5
        expected = weight * length**4 / (8.0 * stiffness)
        assert found[0] == pytest.approx(expected, rel=0.03)
        assert found[1] == pytest.approx(found[0], rel=1e-7)
    assert droop(wire(None, cells=5, iterations=100)) > 0.9


@pytest.mark.parametrize("method", ["xpbd", "pbd"])
def test_the_path_of_a_wire_has_no_scale(method: str) -> None:
    base = advance(wire(0.5, method=method), 5)
    assert np.abs(base[:, 1]).max() > 1e-3 * (method == "xpbd")
    for s in (2.0**5, 2.0**-5):
        np.testing.assert_allclose(advance(wire(0.5, s, method=method), 5) / s, base, rtol=0.0, atol=1e-13)
        np.testing.assert_allclose(advance(wire(0.5, heavy=s, method=method), 5), base, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(advance(wire(0.5, 1000.0, method=method), 5) / 1000.0, base, rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("method", ["xpbd", "pbd"])
def test_the_path_has_no_scale(method: str) -> None:
    """Larger, smaller, heavier, lighter and in millimetres: the same but for rounding."""
    more = {"constraints": {"tether": {"to": "start", "compliance": 1e-6}}}
    base = advance(rope(method), 5)
    for s in (2.0**10, 2.0**-10):
        np.testing.assert_allclose(advance(rope(method, s), 5) / s, base, rtol=0.0, atol=1e-14)
        np.testing.assert_allclose(advance(rope(method, density=1000.0 * s), 5), base, rtol=0.0, atol=1e-14)
    np.testing.assert_allclose(advance(rope(method, 1000.0), 5) / 1000.0, base, rtol=0.0, atol=1e-12)
    # Compliances have units: m/N.
    tied = advance(rope(method, **more), 5)
    s = 2.0**10
    more["constraints"]["tether"]["compliance"] /= s
    np.testing.assert_allclose(advance(rope(method, density=1000.0 * s, **more), 5), tied, rtol=0.0, atol=1e-14)


def test_tethers_pull_and_do_not_push() -> None:
    """A rope of rubber under its weight would be twice as long; thrown up it is slack."""
    constraints = {"edges": 1.0, "tether": {"to": "start", "compliance": 1e-6}}
    loose, tied = (rope(iterations=50, constraints=c) for c in ({"edges": 1.0}, constraints))
    assert -displacement_after(loose) > 0.3
    assert -displacement_after(tied) < 0.02
    thrown = rope(iterations=50, constraints=constraints)
    thrown.state.v[:, 1] = 3.0 * (thrown.discretization.points[:, 1] != 0.0)
    free = rope(iterations=50, constraints={"edges": 1.0})
    free.state.v[:] = thrown.state.v
    np.testing.assert_array_equal(advance(thrown, 5), advance(free, 5))


def displacement_after(simulation: Simulation) -> float:
    advance(simulation, 60)
    return float(displacement(simulation)[:, 1].min())


def test_a_stiff_hinge_keeps_a_cloth_flat() -> None:
    bent, flat = (cloth({} if k is None else {"bending": k}) for k in (None, 0.5))
    for simulation in (bent, flat):
        advance(simulation, 20)
    spread = [np.ptp(s.state.x[:, 1]) / np.ptp(s.state.x[:, 2]) for s in (bent, flat)]
    height = [curvature(simulation) for simulation in (bent, flat)]
    assert height[1] < 0.6 * height[0]
    assert min(spread) > 0.0


def curvature(simulation: Simulation) -> float:
    """Distance of the nodes from the plane that fits them best [m]."""
    x = simulation.state.x - simulation.state.x.mean(axis=0)
    return float(np.linalg.svd(x, compute_uv=False)[-1] / np.sqrt(len(x)))


def test_a_closed_membrane_is_inflated() -> None:
    """To the volume asked for where nothing else resists; without a net force."""
    mesh = {"recipe": "sphere_surface", "radius": 0.5, "element_size": 0.2}
    stuff = material("fixed_corotated", E=2e5, density=300.0)
    constraints = {"edges": 10.0, "volume": {"compliance": 1e-9, "ratio": 1.5}}
    simulation = build(
        scene(
            {"b": body(mesh, stuff, kind="membrane", thickness=1e-3, constraints=constraints)},
            solver={"method": "xpbd", "iterations": 30},
        )
    )
    surface = simulation.problem.constraints[0].surface
    before = enclosed_volume(simulation.state.x, surface)
    x = advance(simulation, 3)
    assert enclosed_volume(x, surface) / before == pytest.approx(1.5, rel=1e-4)
    momentum = simulation.discretization.lumped_mass[:, None] * simulation.state.v
    assert np.abs(momentum.sum(axis=0)).max() < 1e-10 * np.abs(momentum).sum()


@pytest.mark.parametrize("method", ["xpbd", "pbd"])
@pytest.mark.parametrize("kind", ["cloth", "wire"])
def test_any_number_of_threads_gives_the_same(method: str, kind: str) -> None:
    found = []
    for threads in (1, 2):
        if kind == "cloth":
            simulation = cloth({"bending": 1.0, "tether": {"to": "back", "compliance": 1e-5}}, method)
        else:
            simulation = wire(0.5, cells=1500, method=method)
        set_threads(threads)
        found.append(advance(simulation, 3))
    set_threads(1)
    np.testing.assert_array_equal(found[1], found[0])


def test_constraints_of_a_color_move_no_node_in_common() -> None:
    simulation = cloth({"bending": 1.0, "tether": {"to": "left_back", "compliance": 1e-5}})
    (thin,) = ConstraintSweep(simulation.problem)._thin
    assert thin._cuts[-1] == thin._kinds.size
    moves = thin._free.any(axis=1)
    for first, last in zip(thin._cuts[:-1], thin._cuts[1:], strict=True):
        counts = COUNTS[thin._kinds[first:last]]
        nodes = thin._nodes[first:last][np.arange(4) < counts[:, None]]
        nodes = nodes[moves[nodes]]
        assert np.unique(nodes).size == nodes.size


def test_components_of_a_bend_are_visited_at_once() -> None:
    """They have a colour in common and move nothing in common; of the rest, no two of a colour share a node."""
    (thin,) = ConstraintSweep(wire(0.5).problem)._thin
    moves = thin._free.any(axis=1)
    found = 0
    for first, last in zip(thin._cuts[:-1], thin._cuts[1:], strict=True):
        kinds, nodes = thin._kinds[first:last], thin._nodes[first:last]
        dofs = []
        for kind, row in zip(kinds, nodes, strict=True):
            axes = [int(kind) - FLEX_X] if kind in (FLEX_X, FLEX_Y, FLEX_Z) else [0, 1, 2]
            dofs += [(int(i), a) for i in row[: COUNTS[kind]] if moves[i] for a in axes]
        assert len(set(dofs)) == len(dofs)
        found += np.count_nonzero(kinds == FLEX_Z)
    assert found == 8


def test_both_residuals_add_up() -> None:
    simulation = cloth({"bending": 1.0, "tether": {"to": "left_back", "compliance": 1e-4, "slack": 1.0}}, iterations=5)
    advance(simulation, 20)
    problem = simulation.problem
    problem.begin_step(simulation.state, 0.01)
    result = simulation.solver.step(problem, simulation.state)
    primary, secondary = simulation.solver.sweep_of(problem).residual_parts(problem)
    residual = problem.gradient(result.x)
    np.testing.assert_allclose(primary + secondary, residual, rtol=0.0, atol=1e-12 * np.abs(residual).max())
    assert np.abs(primary).max() > 1e-9
