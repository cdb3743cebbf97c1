"""PBNG with weak constraints: projected Newton's answers for every law and kind of link, soft and stiff."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenario import block, body, build, material, quasistatic, random_state, scene

from femdeform.errors import InputError
from femdeform.jit import set_threads
from femdeform.materials import LAWS
from femdeform.run.setup import Simulation
from femdeform.step_problem import StepResult
from solvers.position_based.node_sweep import NodeSweep

NEWTON = {"tolerance": 1e-12}
PBNG = {"method": "pbng", "tolerance": 1e-10, "max_iterations": 4000}


def solve(data: dict[str, Any], solver: dict[str, Any], steps: int = 1) -> tuple[Simulation, StepResult]:
    simulation = build({**data, "solver": solver})
    result = None
    for _ in range(steps):
        simulation.problem.begin_step(simulation.state, simulation.scene.time.dt)
        result = simulation.solver.step(simulation.problem, simulation.state)
        assert result.converged, result.reason
        simulation.state = simulation.problem.accept(simulation.state, result.x)
    assert result is not None
    return simulation, result


def compare(
    data: dict[str, Any], steps: int = 1, moved: float = 0.05, residual: float = 1e-10, atol: float = 1e-8, **more: Any
) -> Simulation:
    newton, _ = solve(data, NEWTON, steps)
    other, _ = solve(data, {**PBNG, "tolerance": residual, **more}, steps)
    problem = other.problem
    norm = problem.residual_norm(problem.gradient(other.state.x))
    assert norm <= 1.0001 * residual * problem.force_scale
    distance = np.abs(newton.state.x - newton.discretization.points).max()
    assert distance > moved
    np.testing.assert_allclose(other.state.x, newton.state.x, rtol=0.0, atol=atol * distance)
    return other


def block_size(simulation: Simulation) -> int:
    """Nodes that PBNG moves as one block."""
    sweep = NodeSweep(simulation.problem)
    sweep.begin_step(simulation.problem)
    return 0 if sweep.block is None else len(sweep.block.nodes)


def two_bars(
    law: str, dim: int, stiffness: float | None, cells: int = 3, dynamic: bool = False, E: float = 1e4, **tie: Any
) -> dict[str, Any]:
    """Two bars tied end to end, the first held, the last end turned and stretched; or one bar of that length."""
    size, stuff = [1.0, 0.4, 0.4][:dim], material(law, E=E, density=100.0)
    turn: dict[str, Any] = {"kind": "rotate", "on": "b.right", "rate": 0.3}
    if dim == 3:
        turn = {"kind": "twist", "on": "b.right", "axis": [1, 0, 0], "rate": 0.6, "elongation_rate": 0.2}
    last = {"mesh": block(size, [4, cells, cells][:dim], translate=[1, 0, 0][:dim]), "material": stuff}
    bodies = {"a": body(block(size, [4, 2, 2][:dim]), stuff), "b": last}
    links = {"t": {"kind": "tie", "on": "b.left", "to": "a.right", "stiffness": stiffness, **tie}}
    if stiffness is None:
        bodies, links = {"b": body(block([2.0, *size[1:]], [8, 2, 2][:dim]), stuff)}, {}
    return scene(
        bodies,
        {"kind": "fixed", "on": "b.left" if stiffness is None else "a.left"},
        turn,
        links=links,
        gravity=[0.0, -9.81, 0.0][:dim],
        time={"scheme": "backward_euler", "dt": 0.05, "end": 1.0} if dynamic else quasistatic(),
    )


# ------------------------------------------------------------------------------------------------- two tied bodies


@pytest.mark.parametrize("stiffness", [200.0, 1e5], ids=["soft", "stiff"])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", list(LAWS))
def test_every_law_on_two_tied_bars(law: str, dim: int, stiffness: float) -> None:
    """Other meshes: nodes are held by interpolated points. Soft ties are swept node by node, stiff ones as a block."""
    found = compare(two_bars(law, dim, stiffness))
    assert (block_size(found) > 0) == (stiffness == 1e5)


@pytest.mark.parametrize("per", ["node", "area"])
@pytest.mark.parametrize("dim", [2, 3])
def test_tied_bars_in_motion(dim: int, per: str) -> None:
    compare(two_bars("neo_hookean", dim, 1e5, dynamic=True, per=per), 3, moved=0.02)


@pytest.mark.parametrize("acceleration", ["none", "chebyshev", "sor"])
def test_accelerations_of_a_stiff_tie(acceleration: str) -> None:
    compare(two_bars("fixed_corotated", 2, 1e5), acceleration=acceleration, residual=1e-9, atol=1e-7)


def test_single_precision_with_ties() -> None:
    compare(two_bars("neo_hookean", 3, 200.0), precision="float32")
    compare(two_bars("neo_hookean", 3, 1e5), precision="float32")


# ------------------------------------------------------------------------------------------------------ stiff pairs


@pytest.mark.parametrize("acceleration", ["none", "anderson"])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_tie_of_1e8_converges_as_one_body_does(dim: int, acceleration: str) -> None:
    """At E = 1e3 nodes by themselves would be stuck: the residual over the forces stays above one."""
    options = {**PBNG, "tolerance": 1e-6, "acceleration": acceleration, "check_every": 5}
    _, whole = solve(two_bars("fixed_corotated", dim, None, E=1e3), options)
    # The softest one gives way, which is one more thing to find.
    for stiffness, factor in ((1e3, 1.3), (1e5, 1.1), (1e8, 1.1)):
        _, tied = solve(two_bars("fixed_corotated", dim, stiffness, cells=2, E=1e3), options)
        assert tied.iterations <= factor * whole.iterations + 5
    for per in ("node", "area"):
        # One node on one side is held by two or three of the other.
        data = two_bars("fixed_corotated", dim, 1e8, cells=3, E=1e3, per=per)
        simulation, tied = solve(data, options)
        assert tied.iterations <= 1.5 * whole.iterations + 5
        assert simulation.problem.links.gap(tied.x) < 1e-4


def test_nodes_by_themselves_are_stuck(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the block is for."""
    monkeypatch.setattr("solvers.position_based.stiff_block._STIFF", 1e30)
    options = {**PBNG, "acceleration": "none", "iterations": 300}
    simulation = build({**two_bars("fixed_corotated", 2, 1e8, E=1e3), "solver": options})
    simulation.problem.begin_step(simulation.state, 1.0)
    result = simulation.solver.step(simulation.problem, simulation.state)
    assert result.relative_residual > 0.1


def test_a_stiff_tie_closes_a_gap() -> None:
    data = two_bars("neo_hookean", 3, 1e6, gap="closed", max_distance=0.2)
    compare({**data, "bodies": _apart(data["bodies"])}, residual=1e-8, atol=1e-6)


def _apart(bodies: dict[str, Any]) -> dict[str, Any]:
    mesh = {**bodies["b"]["mesh"], "translate": [1.1, 0, 0]}
    return {**bodies, "b": {**bodies["b"], "mesh": mesh}}


# ------------------------------------------------------------------------------------------------------- all kinds


def end(at: list[float], **more: Any) -> dict[str, Any]:
    return {"at": at, **more}


SPRING = {"kind": "spring", "ends": [end([1.0, 0.4], body="a"), end([1.2, 0.4], body="b")]}
KINDS: dict[str, dict[str, Any]] = {
    "stretched spring": {**SPRING, "stiffness": 400.0, "length": 0.05},
    "compressed spring": {**SPRING, "stiffness": 400.0, "length": 0.35},
    "stiff spring": {**SPRING, "stiffness": 1e5, "length": 0.25},
    "pendulum": {
        "kind": "spring",
        "ends": [end([1.2, 0.4], body="b"), end([1.2, 0.9], fixed=True)],
        "stiffness": 1e5,
        "length": 0.5,
    },
    "pair": {"kind": "pair", "ends": [end([0.9, 0.13], body="a"), end([1.33, 0.2], body="b")], "stiffness": 600.0},
    "direction": {
        "kind": "pair",
        "ends": [end([0.9, 0.13], body="a"), end([1.33, 0.2], body="b")],
        "stiffness": 1e5,
        "direction": [1.0, 0.5],
        "tangential_stiffness": 50.0,
    },
    "attachment": {"kind": "attachment", "on": "b.right", "stiffness": 800.0, "velocity": [0.5, 1.0]},
    "stiff attachment": {"kind": "attachment", "on": "b.right", "stiffness": 1e5, "velocity": [0.5, 1.0]},
    "binding": {"kind": "binding", "on": "b.left", "to": "a.right", "stiffness": 1e4, "within": 0.3},
    "sliding tie": {
        "kind": "tie",
        "on": "b.left",
        "to": "a.right",
        "stiffness": 1e5,
        "tangential_stiffness": 20.0,
        "per": "area",
        "max_distance": 0.3,
    },
}


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", list(KINDS))
def test_every_kind(name: str, dim: int) -> None:
    """Three steps of two bars with a gap of 0.2 m, the second one free but for its link."""
    link = deeper(KINDS[name]) if dim == 3 else KINDS[name]
    stuff = material("neo_hookean", E=1e4, density=100.0)
    size = [1.0, 0.4, 0.4][:dim]
    data = scene(
        {
            "a": body(block(size, [3, 2, 2][:dim]), stuff),
            "b": body(block(size, [3, 3, 3][:dim], translate=[1.2, 0, 0][:dim]), stuff),
        },
        {"kind": "fixed", "on": "a.left"},
        {"kind": "initial_velocity", "on": "b", "velocity": [0.5, -0.5, 0.3][:dim]},
        links={"l": link},
        gravity=[0.0, -9.81, 0.0][:dim],
        time={"scheme": "backward_euler", "dt": 0.04, "end": 1.0},
    )
    found = compare(data, 3, moved=0.03, atol=1e-7)
    assert found.problem.links.energy(found.state.x) > 1e-4


def deeper(link: dict[str, Any]) -> dict[str, Any]:
    """The same in space, in the middle of the third axis."""
    more = {key: [*link[key], 0.1] for key in ("velocity", "direction") if key in link}
    if "ends" in link:
        more["ends"] = [{**place, "at": [*place["at"], 0.2]} for place in link["ends"]]
    return {**link, **more}


def test_links_and_obstacles() -> None:
    """Nodes of a stiff tie that stand on a floor with friction."""
    data = two_bars("neo_hookean", 3, 1e5, dynamic=True)
    floor = {"kind": "plane", "point": [0.0, -0.01, 0.0], "normal": [0.0, 1.0, 0.0], "friction": 0.3}
    data |= {"obstacles": [floor], "conditions": [{"kind": "initial_velocity", "on": "b", "velocity": [0.5, -1, 0]}]}
    compare(data, 4, moved=0.02, atol=1e-7)


# ------------------------------------------------------------------------------------------------- energy, threads


@pytest.mark.parametrize("stiffness", [200.0, 1e5])
def test_any_number_of_threads_gives_the_same(stiffness: float) -> None:
    """Bit by bit, with more nodes a colour than a thread takes at a time."""
    data = two_bars("neo_hookean", 3, stiffness, cells=9)
    data["links"] = {"t": {**data["links"]["t"], "per": "area"}}
    found = []
    for threads in (1, 2):
        simulation = build({**data, "solver": {**PBNG, "iterations": 25}})
        set_threads(threads)
        simulation.problem.begin_step(simulation.state, 1.0)
        found.append(simulation.solver.step(simulation.problem, simulation.state).x)
    assert np.abs(found[0] - simulation.state.x).max() > 0.1
    np.testing.assert_array_equal(found[1], found[0])


@pytest.mark.parametrize("stiffness", [200.0, 1e6])
def test_nodes_of_a_row_have_different_colors(stiffness: float) -> None:
    """Those of stiff rows are the last colour, which moves as a block."""
    simulation = build(two_bars("neo_hookean", 3, stiffness))
    sweep = NodeSweep(simulation.problem)
    offsets, place = sweep.numbering.color_offsets, sweep.numbering.place
    colors = np.searchsorted(offsets, place, side="right") - 1
    rows = simulation.problem.links.rows
    for first, last in zip(rows.offsets[:-1], rows.offsets[1:], strict=True):
        own = colors[rows.nodes[first:last]]
        if stiffness > 1e5:
            assert (own == sweep.n_colors - 1).all()
        else:
            assert np.unique(own).size == own.size
    for group in simulation.problem.local_cells(("links",)):
        own = colors[group.cells]
        own = np.where(own >= sweep.n_colors - (stiffness > 1e5), -1 - np.arange(4), own)
        assert all(np.unique(cell).size == 4 for cell in own)


@pytest.mark.parametrize("stiffness", [100.0, 1e4, 1e8])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", list(LAWS))
def test_energy_never_rises_in_a_plain_sweep(law: str, dim: int, stiffness: float) -> None:
    data = two_bars(law, dim, stiffness)
    place = [[0.5, 0.1, 0.1][:dim], [1.5, 0.1, 0.1][:dim]]
    spring = {"kind": "spring", "ends": [end(place[0], body="a"), end(place[1], body="b")], "stiffness": stiffness}
    data["links"] |= {"short": {**spring, "length": 0.3}, "long": {**spring, "length": 2.0}}
    simulation = build(data)
    problem = simulation.problem
    problem.begin_step(simulation.state, 1.0)
    sweep = NodeSweep(problem)
    sweep.begin_step(problem)
    points = simulation.discretization.points
    starts = [random_state(points, 0.02)]
    if law != "logarithmic_neo_hookean":
        starts.append(random_state(points, 0.3))
    for start in starts:
        start = np.where(problem.free, start, points)
        x, flat = start.copy(), sweep.flat(start)
        value = problem.value(x)
        for k in range(25):
            sweep.sweep(flat)
            if k == 10:
                sweep.update_loads(problem, x)
            sweep.unflat(flat, x)
            after = problem.value(x)
            assert after <= value + 1e-11 * problem.value_magnitude
            value = after


def test_methods_that_do_not_know_links_are_refused() -> None:
    """Whoever sweeps over cells or nodes without saying that it minimises links too would leave them out."""
    problem = build(two_bars("neo_hookean", 2, 100.0)).problem
    with pytest.raises(InputError, match="links: this method does not know them"):
        problem.local_cells()
    assert len(problem.local_cells(("links",))) == 1


# ------------------------------------------------------------------------------------- nothing pulls but the links


@pytest.mark.parametrize("solver", [NEWTON, PBNG], ids=["newton", "pbng"])
def test_links_alone_pull_a_body_at_rest(solver: dict[str, Any]) -> None:
    """The last state has no forces but rounding, which is no scale for a residual."""
    stuff = material("fixed_corotated", E=1e4)
    data = scene(
        {"a": body(block([1.0, 0.4], [7, 3], translate=[1.1, 0.3]), stuff)},
        {"kind": "fixed", "on": "a.left"},
        links={"s": {"kind": "attachment", "on": "a.right", "stiffness": 50.0, "velocity": [0.3, 0.1]}},
        time=quasistatic(),
    )
    simulation, result = solve(data, {**solver, "tolerance": 1e-8}, 2)
    assert simulation.problem.force_scale > 0.1
    assert result.relative_residual <= 1e-8
    assert np.abs(simulation.state.x - simulation.discretization.points).max() > 1e-3
