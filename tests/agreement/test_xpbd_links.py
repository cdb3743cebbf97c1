"""Weak constraints in sweeps over cells: projected Newton's answers where a method converges, XPBD's own where not."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenario import block, body, build, material, quasistatic, scene

from femdeform.jit import set_threads
from femdeform.run.setup import Simulation
from solvers.position_based.constraint_sweeps import ConstraintSweep

FP = {"method": "fp_pxpbd", "tolerance": 1e-10, "max_iterations": 2000}
B = {"method": "b_pxpbd", "tolerance": 1e-10, "max_iterations": 2000}


def solve(data: dict[str, Any], solver: dict[str, Any], steps: int) -> Simulation:
    """Steps of a scene, all of which have to be accepted."""
    simulation = build({**data, "solver": solver})
    for _ in range(steps):
        simulation.problem.begin_step(simulation.state, simulation.scene.time.dt)
        result = simulation.solver.step(simulation.problem, simulation.state)
        assert result.accepted, result.reason
        simulation.state = simulation.problem.accept(simulation.state, result.x)
    return simulation


def compare(data: dict[str, Any], solver: dict[str, Any], steps: int = 2) -> Simulation:
    newton = solve(data, {"tolerance": 1e-12}, steps)
    other = solve(data, solver, steps)
    problem = other.problem
    assert problem.residual_norm(problem.gradient(other.state.x)) <= 1.001e-10 * problem.force_scale
    distance = np.abs(newton.state.x - newton.discretization.points).max()
    assert distance > 0.02
    np.testing.assert_allclose(other.state.x, newton.state.x, rtol=0.0, atol=1e-7 * distance)
    return other


def end(at: list[float], **more: Any) -> dict[str, Any]:
    return {"at": at, **more}


SPRING = {"kind": "spring", "ends": [end([1.0, 0.4], body="a"), end([1.2, 0.4], body="b")]}
KINDS: dict[str, dict[str, Any]] = {
    "stretched spring": {**SPRING, "stiffness": 4e4, "length": 0.05},
    "compressed spring": {**SPRING, "stiffness": 4e4, "length": 0.35},
    "stiff spring": {**SPRING, "stiffness": 1e7, "length": 0.25},
    "pendulum": {
        "kind": "spring",
        "ends": [end([1.2, 0.4], body="b"), end([1.2, 0.9], fixed=True)],
        "stiffness": 1e6,
        "length": 0.5,
    },
    "pair": {"kind": "pair", "ends": [end([0.9, 0.13], body="a"), end([1.33, 0.2], body="b")], "stiffness": 6e4},
    "direction": {
        "kind": "pair",
        "ends": [end([0.9, 0.13], body="a"), end([1.33, 0.2], body="b")],
        "stiffness": 1e6,
        "direction": [1.0, 0.5],
        "tangential_stiffness": 5e3,
    },
    "attachment": {"kind": "attachment", "on": "b.right", "stiffness": 8e4, "velocity": [0.5, 1.0]},
    "stiff attachment": {"kind": "attachment", "on": "b.right", "stiffness": 1e6, "velocity": [0.5, 1.0]},
    "binding": {"kind": "binding", "on": "b.left", "to": "a.right", "stiffness": 1e6, "within": 0.3},
    "sliding tie": {
        "kind": "tie",
        "on": "b.left",
        "to": "a.right",
        "stiffness": 1e6,
        "tangential_stiffness": 2e3,
        "per": "area",
        "max_distance": 0.3,
    },
}


def two_bars(link: dict[str, Any], dim: int, *conditions: dict[str, Any], E: float = 1e5) -> dict[str, Any]:
    """Two bars with a gap of 0.2 m, the second one thrown and free but for its link; kappa = 0.16."""
    if dim == 3:
        more = {key: [*link[key], 0.1] for key in ("velocity", "direction") if key in link}
        if "ends" in link:
            more["ends"] = [{**place, "at": [*place["at"], 0.2]} for place in link["ends"]]
        link = {**link, **more}
    stuff = material("fixed_corotated", E=E)
    size = [1.0, 0.4, 0.4][:dim]
    return scene(
        {
            "a": body(block(size, [3, 2, 2][:dim]), stuff),
            "b": body(block(size, [3, 3, 3][:dim], translate=[1.2, 0, 0][:dim]), stuff),
        },
        {"kind": "fixed", "on": "a.left"},
        {"kind": "initial_velocity", "on": "b", "velocity": [1.5, -2.0, 1.0][:dim]},
        *conditions,
        links={"l": link},
        gravity=[0.0, -9.81, 0.0][:dim],
    )


@pytest.mark.parametrize("solver", [FP, B], ids=["fp", "b"])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", list(KINDS))
def test_every_kind(name: str, dim: int, solver: dict[str, Any]) -> None:
    found = compare(two_bars(KINDS[name], dim), solver)
    assert found.problem.links.energy(found.state.x) > 1e-4


@pytest.mark.parametrize("solver", [FP, B], ids=["fp", "b"])
@pytest.mark.parametrize("name", ["stretched spring", "stiff spring", "pendulum", "direction", "sliding tie"])
def test_rows_of_nodes_on_rollers(name: str, solver: dict[str, Any]) -> None:
    """Held nodes whose components are partly prescribed: a row's mobility then has a direction."""
    for dim in (2, 3):
        roller = {"kind": "fixed", "on": "b.left", "components": ["x"]}
        compare(two_bars(KINDS[name], dim, roller, {"kind": "fixed", "on": "a.top", "components": ["y"]}), solver)


@pytest.mark.parametrize("solver", [FP, B], ids=["fp", "b"])
def test_links_and_obstacles(solver: dict[str, Any]) -> None:
    data = two_bars(KINDS["binding"], 3)
    floor = {"kind": "plane", "point": [0.0, -0.01, 0.0], "normal": [0.0, 1.0, 0.0], "friction": 0.3}
    compare({**data, "obstacles": [floor]}, solver, 3)


# ------------------------------------------------------------------------------------------------ XPBD's own answers


@pytest.mark.parametrize("method", ["xpbd", "pbd", "b_pxpbd", "fp_pxpbd"])
def test_any_number_of_threads_gives_the_same(method: str) -> None:
    """Bit by bit, with more rows a colour than a thread takes at a time."""
    data = two_bars({**KINDS["binding"], "tangential_stiffness": 1e3}, 3)
    data["bodies"]["b"]["mesh"]["cells"] = [3, 20, 20]
    found = []
    for threads in (1, 2):
        simulation = build({**data, "solver": {"method": method, "iterations": 5}})
        set_threads(threads)
        simulation.problem.begin_step(simulation.state, 0.01)
        found.append(simulation.solver.step(simulation.problem, simulation.state).x)
    set_threads(1)
    np.testing.assert_array_equal(found[1], found[0])


def test_rows_of_a_color_share_no_node() -> None:
    sweep = ConstraintSweep(build(two_bars(KINDS["binding"], 3)).problem)
    links = sweep._links
    assert links is not None
    rows = links._rows
    assert links.n_colors > 1
    assert links._cuts[-1] == rows.n_rows > 10
    for first, last in zip(links._cuts[:-1], links._cuts[1:], strict=True):
        nodes = rows.nodes[rows.offsets[first] : rows.offsets[last]]
        assert np.unique(nodes).size == nodes.size


def hanging_by_a_spring(method: str, iterations: int, scale: float = 1.0, density: float = 1000.0) -> Simulation:
    """A block of 125 kg on a spring of 1e4 N/m, one step of 0.1 s from rest."""
    s, heavy = scale, density / 1000.0
    up = [end([0.25 * s, 0.5 * s], body="b"), end([0.25 * s, 1.5 * s], fixed=True)]
    return build(
        scene(
            {
                "b": body(
                    block([0.5 * s, 0.5 * s], [2, 2]), material("fixed_corotated", 1e5 * heavy * s * s, 0.3, density)
                )
            },
            links={"l": {"kind": "spring", "ends": up, "stiffness": 1e4 * heavy * s * s}},
            gravity=[0.0, -9.81 * s],
            time={"scheme": "backward_euler", "dt": 0.1, "end": 1.0},
            solver={"method": method, "iterations": iterations},
        )
    )


def lengthened(simulation: Simulation) -> float:
    simulation.problem.begin_step(simulation.state, 0.1)
    result = simulation.solver.step(simulation.problem, simulation.state)
    assert result.accepted, result.reason
    return float(simulation.problem.links.gap(result.x))


def test_the_stretch_of_a_spring_does_not_depend_on_the_number_of_sweeps() -> None:
    """XPBD's promise; and what PBD makes of the same spring."""
    once, twice = (lengthened(hanging_by_a_spring("xpbd", count)) for count in (400, 800))
    assert once > 1e-3
    assert twice == pytest.approx(once, rel=1e-6)
    assert lengthened(hanging_by_a_spring("pbd", 100)) < 1e-2 * once


@pytest.mark.parametrize("method", ["xpbd", "pbd", "b_pxpbd", "fp_pxpbd"])
def test_rows_have_no_scale(method: str) -> None:
    """Lengths in another unit, or all heavier and stiffer; powers of two change no rounding."""
    base = lengthened(hanging_by_a_spring(method, 5))
    s = 2.0**10
    for scale in (s, 1.0 / s):
        assert lengthened(hanging_by_a_spring(method, 5, scale)) / scale == base
    for density in (1000.0 * s, 1000.0 / s):
        assert lengthened(hanging_by_a_spring(method, 5, density=density)) == base
    assert lengthened(hanging_by_a_spring(method, 5, 1000.0)) / 1000.0 == pytest.approx(base, rel=1e-9)


def test_what_is_visited_last_is_met() -> None:
    """Two blocks one below the other, tied by 1e8 N/m: links last close the gap, links first leave one of millimetres.

    The true gap is 0.1 micrometres; both are at a wrong place, and say so.
    """
    gaps, residuals = [], []
    stuff = material("fixed_corotated", E=1e3, density=10.0)
    for first in (False, True):
        simulation = build(
            scene(
                {
                    "u": body(block([1, 1, 1], [3, 3, 3], translate=[0, 1, 0]), stuff),
                    "l": body(block([1, 1, 1], [3, 3, 3]), stuff),
                },
                {"kind": "fixed", "on": "u.top"},
                links={"t": {"kind": "tie", "on": "l.top", "to": "u.bottom", "stiffness": 1e8}},
                gravity=[0, -9.8, 0],
                time=quasistatic(),
                solver={
                    "method": "xpbd_qs",
                    "pseudo_step": 0.03,
                    "iterations": 10,
                    "max_pseudo_steps": 60,
                    "links_first": first,
                },
            )
        )
        simulation.problem.begin_step(simulation.state, 1.0)
        result = simulation.solver.step(simulation.problem, simulation.state)
        assert result.accepted
        gaps.append(simulation.problem.links.gap(result.x))
        residuals.append(result.relative_residual)
    assert gaps[0] < 1e-6
    assert gaps[1] > 1e-3
    assert residuals[0] > 0.1
    assert residuals[1] > 1e3


# ------------------------------------------------------------------------------------------------ both residuals


@pytest.mark.parametrize(
    "solver",
    [
        {"method": "xpbd"},
        {"method": "xpbd", "constraints": "root"},
        {"method": "xpbd", "keep_primary_residual": True},
        {"method": "b_pxpbd"},
        {"method": "fp_pxpbd", "local_iterations": 1},
    ],
    ids=lambda solver: "-".join(map(str, solver.values())),
)
@pytest.mark.parametrize("dim", [2, 3])
def test_both_residuals_add_up_to_the_one_of_the_problem(dim: int, solver: dict[str, Any]) -> None:
    """Cells, links with and without a direction, springs, an obstacle and pressure, to round-off; neither vanishes."""
    roller = {"kind": "fixed", "on": "b.left", "components": ["x"]}
    pressure = {"kind": "pressure", "on": "b.top", "value": 3000.0}
    data = two_bars(KINDS["sliding tie"], dim, roller, pressure)
    data["links"]["s"] = two_bars(KINDS["stretched spring"], dim)["links"]["l"]
    data["obstacles"] = [{"kind": "plane", "point": [0.0, -0.01, 0.0][:dim], "normal": [0, 1, 0][:dim]}]
    simulation = build({**data, "solver": {**solver, "iterations": 4, "check_every": 2}})
    problem, state = simulation.problem, simulation.state
    problem.begin_step(state, 0.01)
    rows: list[dict[str, Any]] = []
    result = simulation.solver.step(problem, state, lambda row, x: rows.append(dict(row)))
    primary, secondary = simulation.solver.sweep_of(problem).residual_parts(problem)
    residual = problem.gradient(result.x)
    np.testing.assert_allclose(primary + secondary, residual, rtol=0.0, atol=1e-12 * np.abs(secondary).max())
    assert rows[-1]["primary_residual"] == pytest.approx(np.linalg.norm(primary))
    assert rows[-1]["secondary_residual"] == pytest.approx(np.linalg.norm(secondary))
    assert np.abs(secondary).max() > 1e-3
    assert np.abs(primary).max() > 1e-6
    assert problem.contact_energy(result.x) > 0.0


def test_pbd_has_no_such_residuals() -> None:
    simulation = build({**two_bars(KINDS["pair"], 2), "solver": {"method": "pbd", "iterations": 4}})
    simulation.problem.begin_step(simulation.state, 0.01)
    rows: list[dict[str, Any]] = []
    simulation.solver.step(simulation.problem, simulation.state, lambda row, x: rows.append(dict(row)))
    assert rows
    assert not any("primary_residual" in row for row in rows)
