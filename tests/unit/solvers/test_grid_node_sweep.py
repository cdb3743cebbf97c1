"""Sweeps over the nodes of a grid: forces, carried deformations, energy that falls, colours from step to step."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scenario
from numpy.typing import NDArray

from femdeform.materials import LAWS
from femdeform.run.setup import Simulation
from femdeform.run.time_loop import take_step
from solvers.coloring import Incidence, is_valid
from solvers.position_based.grid_node_sweep import GridNodeSweep

Array = NDArray[np.float64]


def build(law: str = "fixed_corotated", dim: int = 3, kernel: str = "quadratic", **more: Any) -> Simulation:
    """Two blocks of two stiffnesses that share grid nodes, held at one component of one side, in a corner of walls."""
    cells = [3, 2, 2][:dim]
    bodies = {
        "low": scenario.body(scenario.block([0.6, 0.4, 0.4][:dim], cells), scenario.material(law, E=1e4)),
        "high": scenario.body(
            scenario.block([0.6, 0.4, 0.4][:dim], cells, translate=[0.1, 0.45, 0.05][:dim]),
            scenario.material(law, E=3e4),
        ),
    }
    walls = [
        {"kind": "plane", "point": [0.0, 0.05, 0.0][:dim], "normal": [0.1, 1.0, 0.0][:dim]},
        {"kind": "plane", "point": [0.62, 0.0, 0.0][:dim], "normal": [-1.0, 0.0, 0.0][:dim]},
    ]
    held = {"kind": "fixed", "on": "low.left", "components": ["x"]}
    thrown = {"kind": "initial_velocity", "on": "high", "velocity": [0.5, -3.0, 0.0][:dim]}
    data = scenario.scene(
        bodies,
        held,
        thrown,
        obstacles=walls,
        gravity=[0.0, -9.8, 0.0][:dim],
        grid={"cell_size": 0.15, "kernel": kernel},
        **{"solver": {"method": "pbng"}, **more},
    )
    return scenario.build(data)


def begun(simulation: Simulation, dt: float = 0.01) -> tuple[Any, Any]:
    problem = simulation.problem
    problem.begin_step(simulation.state, dt)
    return problem, problem.solver_state(simulation.state)


def shared_cells(problem: Any, colors: Array) -> tuple[Incidence, Array]:
    """Nodes that move, by the cells they share, and their colours."""
    moves = problem.free.any(axis=1)
    numbers = np.where(moves, np.cumsum(moves) - 1, -1)
    cells, first = [], 0
    items = []
    for group in problem.gathered_cells():
        of_cell = first + np.repeat(np.arange(len(group.volumes)), np.diff(group.offsets))
        kept = moves[group.nodes]
        cells.append(of_cell[kept])
        items.append(numbers[group.nodes[kept]])
        first += len(group.volumes)
    all_cells, all_items = np.concatenate(cells), np.concatenate(items)
    set_offsets = np.concatenate([[0], np.cumsum(np.bincount(all_cells, minlength=first))])
    order = np.argsort(all_items, kind="stable")
    item_offsets = np.concatenate([[0], np.cumsum(np.bincount(all_items, minlength=int(moves.sum())))])
    return Incidence(set_offsets, all_items, item_offsets, all_cells[order]), colors[moves]


@pytest.mark.parametrize("kernel", ["linear", "quadratic"])
@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", list(LAWS))
def test_forces_are_those_of_the_step_problem(law: str, dim: int, kernel: str) -> None:
    simulation = build(law, dim, kernel)
    problem, begin = begun(simulation)
    sweep = GridNodeSweep(problem)
    y = begin.x @ (np.eye(dim) + 0.2 * np.random.default_rng(4).uniform(-1, 1, (dim, dim)))
    y = scenario.random_state(y, 0.01)
    flat = sweep.flat(y)
    acc = np.zeros(9 * len(y))
    for part in sweep._parts:
        part.refresh(flat)
        for c in range(sweep.n_colors):
            part.add(c, flat, acc)
    rows = acc.reshape(-1, 9)[sweep.numbering.place]
    expected = problem.full_gradient(y, elastic=False) - problem.full_gradient(y)
    moves = problem.free.any(axis=1)
    np.testing.assert_allclose(rows[moves, :dim], expected[moves], atol=1e-9 * np.abs(expected).max())
    # Matrices: no less than half of the exact second derivatives at rest, which the others only stiffen.
    K = scenario.dense_hessian(problem, begin.x, project=True, everything=True)
    weights = problem.nodal_terms().weights
    flat = sweep.flat(begin.x)
    acc[:] = 0.0
    for part in sweep._parts:
        part.refresh(flat)
        for c in range(sweep.n_colors):
            part.add(c, flat, acc)
    rows = acc.reshape(-1, 9)[sweep.numbering.place]
    rules = problem.rows
    for i in np.setdiff1d(np.flatnonzero(moves), rules.nodes):
        A = np.diag(rows[i, 3:6])
        for k, (a, b) in enumerate([(1, 2), (0, 2), (0, 1)]):
            A[a, b] = A[b, a] = rows[i, 6 + k]
        exact = K[dim * i : dim * i + dim, dim * i : dim * i + dim] - weights[i] * np.eye(dim)
        assert np.linalg.eigvalsh(A[:dim, :dim] - 0.5 * exact).min() > -1e-9 * np.abs(exact).max()


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("law", list(LAWS))
def test_energy_falls_and_deformations_do_not_drift(law: str, dim: int) -> None:
    simulation = build(law, dim)
    problem, begin = begun(simulation, 0.05)
    assert problem.rows is not None
    sweep = GridNodeSweep(problem)
    sweep.begin_step(problem)
    stretch = np.array([1.3, 0.85, 1.1])[:dim]
    starts = [problem.predictor(begin), scenario.random_state(begin.x * stretch, 0.01)]
    if law != "logarithmic_neo_hookean":
        starts.append(scenario.random_state(begin.x, 0.2))
    for start in starts:
        y = np.where(problem.free, start, problem.initial_guess(begin))
        flat = sweep.flat(y)
        value = first = problem.value(y)
        assert np.isfinite(value)
        for _ in range(15):
            sweep.sweep(flat)
            sweep.unflat(flat, y)
            after = problem.value(y)
            assert after <= value + 1e-13 * problem.value_magnitude
            value = after
        assert value < first
        for part in sweep._parts:
            carried = part.deformations.copy()
            part.refresh(flat)
            np.testing.assert_allclose(carried, part.deformations, atol=1e-13 * np.abs(carried).max())


@pytest.mark.parametrize("kernel", ["linear", "quadratic"])
@pytest.mark.parametrize("dim", [2, 3])
def test_colours_are_valid_and_kept_from_step_to_step(dim: int, kernel: str) -> None:
    simulation = build(dim=dim, kernel=kernel)
    kept: list[float] = []
    earlier: dict[tuple[float, ...], int] = {}
    for _ in range(6):
        result = take_step(simulation.problem, simulation.solver, simulation.state, 0.01)
        assert result.accepted
        sweep = simulation.solver._grid
        graph, colors = shared_cells(simulation.problem, sweep.colors)
        assert is_valid(graph, colors)
        # A cell spans four or five nodes each way; greedy colours need a little more than that.
        assert sweep.n_colors <= 6**dim
        broken = colors.copy()
        broken[graph.set_items[:2]] = 0
        assert not is_valid(graph, broken)
        now = dict(zip(map(tuple, sweep._points.tolist()), sweep.colors.tolist(), strict=True))
        if earlier:
            kept.append(float(np.mean([earlier[place] == now[place] for place in now if place in earlier])))
        earlier = now
        simulation.state = simulation.problem.accept(simulation.state, result.x)
    assert min(kept) > 0.6
    simulation.solver.reset()
    assert simulation.solver._grid is None
