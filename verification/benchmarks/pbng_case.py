"""What the child processes of the PBNG benchmark do: one case each.

``python -m verification.benchmarks.pbng_case CASE RESULT``: CASE is a JSON file with ``kind`` and the case's own keys.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from femdeform import jit
from femdeform.run.setup import Simulation, build_simulation
from femdeform.scene.schema import DeformableScene
from femdeform.step_problem import Budget
from meshes.build import build_mesh
from solvers.coloring import color, incidence
from solvers.position_based.node_sweep import NodeSweep
from verification.benchmarks import child_process
from verification.benchmarks.block import DENSITY, DT, POISSON_RATIO, YOUNGS_MODULUS
from verification.benchmarks.measure import measure, peak_memory, time_once

# Sweeps between two looks at the clock: a second of work in all, at least this many.
_SWEEPS, _ENOUGH = 10, 0.2
STRETCH, ANGLE = 0.1, 0.8
# What a visit of a node to a cell and to a neighbour of the stencil does, counted in `fast_kernels`: operations (a
# division or a root is one), and the matrix and the step of a node.
FLOPS = {"neo_hookean": 49, "fixed_corotated": 292}
FLOPS_NEIGHBOUR, FLOPS_NODE = 10, 60
# Bytes of arrays that a node reads and writes, in numbers of the precision: position, inertia, load, and the nine terms
# of the accumulator, written, read and cleared.
_NODE_NUMBERS = 3 + 3 + 1 + 3 + 3 + 3 * 9
_COPY_BYTES = 1 << 28


def block(cells: int, law: str, problem: str, solver: dict[str, Any], linear: dict[str, Any] | None) -> Simulation:
    """The unit cube of cells^3 grid cells, held at x = 0, stretched by 10 %.

    Parameters
    ----------
    cells : int
        Along an edge.
    law : str
        As in a scene.
    problem : str
        ``stretch``: released in a step of `DT` under gravity; ``twist``: in statics, the end x = 1 held at a stretch of
        10 % and an angle of `ANGLE`, from the evenly stretched and twisted block, 10 kg/m^3.
    solver, linear : dict
        As in a scene.
    """
    is_twist = problem == "twist"
    material = {
        "law": law,
        "density": 10.0 if is_twist else DENSITY,
        "youngs_modulus": YOUNGS_MODULUS,
        "poisson_ratio": POISSON_RATIO,
    }
    conditions: list[dict[str, Any]] = [{"kind": "fixed", "on": "block.left"}]
    if is_twist:
        turn = {"kind": "twist", "on": "block.right", "axis": (1.0, 0.0, 0.0)}
        conditions.append({**turn, "rate": ANGLE, "elongation_rate": STRETCH})
    mesh = {"recipe": "block", "size": (1.0, 1.0, 1.0), "cells": (cells, cells, cells)}
    scene = DeformableScene.model_validate(
        {
            "schema_version": 1,
            "title": "Benchmark block",
            "simulation": "deformable",
            "bodies": {"block": {"mesh": mesh, "material": material}},
            "conditions": conditions,
            "gravity": (0.0, 0.0 if is_twist else -9.81, 0.0),
            "time": {"scheme": "quasistatic", "dt": 1.0, "end": 1.0}
            if is_twist
            else {"scheme": "backward_euler", "dt": DT, "end": 1.0},
            "solver": solver,
            **({} if linear is None else {"linear_solver": linear}),
        }
    )
    simulation = build_simulation(scene, {"block": build_mesh(scene.bodies["block"].mesh, Path())})
    x = simulation.state.x
    x[:, 0] *= 1.0 + STRETCH
    if is_twist:
        angle = ANGLE * simulation.discretization.points[:, 0]
        y, z = x[:, 1] - 0.5, x[:, 2] - 0.5
        x[:, 1], x[:, 2] = 0.5 + np.cos(angle) * y - np.sin(angle) * z, 0.5 + np.sin(angle) * y + np.cos(angle) * z
    simulation.problem.begin_step(simulation.state, scene.time.dt)
    return simulation


def sweep(case: dict[str, Any]) -> dict[str, Any]:
    """Time plain sweeps from the stretched block.

    Parameters
    ----------
    case : dict
        ``cells``, ``law``, ``precision``; ``constraints``: whether to colour the cells too.

    Returns
    -------
    dict
        ``time``: summary of seconds of a sweep. ``bytes``: what a sweep streams at least, beside the positions of
        neighbours; ``flops``. Sizes, colours, seconds of set-up, peak of memory [bytes].
    """
    # Kernels are compiled, or loaded from the disk, before anything is timed.
    small: Any = block(2, case["law"], "stretch", {"method": "pbng"}, None).problem
    NodeSweep(small)
    simulation = block(case["cells"], case["law"], "stretch", {"method": "pbng"}, None)
    problem: Any = simulation.problem
    mesh_memory = peak_memory()
    start = time.perf_counter()
    nodes = NodeSweep(problem, np.dtype(case["precision"]))
    set_up = time.perf_counter() - start
    nodes.begin_step(problem)
    flat = nodes.flat(simulation.state.x)

    def run() -> None:
        for _ in range(_SWEEPS):
            nodes.sweep(flat)

    run()
    repetitions = int(min(20, max(3, _ENOUGH / time_once(run))))
    taken = measure(run, repetitions, warm_up=0)
    groups = problem.local_cells()
    graph = incidence([group.cells for group in groups], len(problem.points))
    start = time.perf_counter()
    color(graph)
    coloring = time.perf_counter() - start
    return {
        "n_nodes": len(problem.points),
        "n_cells": sum(len(group.cells) for group in groups),
        "threads": jit.set_threads(),
        "time": {key: value if key == "n" else value / _SWEEPS for key, value in taken.items()},
        **_traffic(nodes, case["law"]),
        "colors": nodes.n_colors,
        "constraint_colors": int(color(graph.transposed()).max()) + 1 if case["constraints"] else None,
        "coloring": coloring,
        "set_up": set_up,
        "mesh_memory": mesh_memory,
        "memory": peak_memory(),
    }


def _traffic(sweep: NodeSweep, law: str) -> dict[str, int]:
    """Visits, and least bytes and operations of one sweep."""
    (part,) = sweep._parts
    visits = part.visits
    arrays: list[np.ndarray[Any, Any]] = [visits.others, visits.gradients]
    arrays.append(part._scales)  # type: ignore[attr-defined]
    neighbours = 0
    if law == "neo_hookean":
        stencil = part._stencil  # type: ignore[attr-defined]
        arrays += [stencil.neighbours, stencil.weights]
        neighbours = stencil.neighbours.size
    else:
        arrays.append(visits.volumes)
    nodes = int(sweep.numbering.color_offsets[-1])
    n_visits = visits.volumes.size
    return {
        "visits": n_visits,
        "visit_bytes": sum(array.nbytes for array in arrays) // n_visits,
        "bytes": sum(array.nbytes for array in arrays) + nodes * _NODE_NUMBERS * sweep.dtype.itemsize,
        "flops": FLOPS[law] * n_visits + FLOPS_NEIGHBOUR * neighbours + FLOPS_NODE * nodes,
    }


def bandwidth(case: dict[str, Any]) -> dict[str, Any]:
    """Time copies of large arrays by every thread at once: bytes read and written a second."""
    threads = jit.default_threads()
    size = case.get("bytes", _COPY_BYTES) // 8 // threads
    pairs = [(np.ones(size), np.zeros(size)) for _ in range(threads)]
    with ThreadPoolExecutor(threads) as pool:
        taken = measure(lambda: list(pool.map(lambda pair: np.copyto(pair[1], pair[0]), pairs)))
    return {"threads": threads, "bandwidth": 16.0 * size * threads / taken["median"]}


def convergence(case: dict[str, Any]) -> dict[str, Any]:
    """Follow the residual of one step.

    Parameters
    ----------
    case : dict
        ``cells``, ``law``, ``problem`` (see `block`), ``solver``, ``linear_solver``, ``levels`` of the relative
        residual in descending order; ``seconds``: after which a step is given up.

    Returns
    -------
    dict
        ``reached``: for each level iterations, linear iterations and seconds to the first look below it, or None;
        ``start``: relative residual where the step begins. The step is taken twice, on one simulation, the second
        one counts: patterns and layouts exist then, as after the first step of a run.
    """
    simulation = block(case["cells"], case["law"], case["problem"], case["solver"], case["linear_solver"])
    problem: Any = simulation.problem
    solver = simulation.solver
    method = simulation.linear_solver.name
    if case["linear_solver"] is not None and case["linear_solver"].get("preset", method) not in method:
        return {"skipped": "; ".join(simulation.notices)}
    rows: list[dict[str, Any]] = []
    for _ in range(2):
        rows.clear()
        solver.reset()
        problem.begin_step(simulation.state, simulation.scene.time.dt)
        budget = Budget(seconds=case.get("seconds"))
        budget.start()
        result = solver.step(problem, simulation.state, lambda row, x: rows.append(dict(row)), budget)
    linear = np.cumsum([row["linear_iterations"] for row in rows])
    reached: list[Any] = []
    for level in case["levels"]:
        below = [k for k, row in enumerate(rows) if row["relative_residual"] <= level]
        k = below[0] if below else -1
        reached.append([rows[k]["iteration"], int(linear[k]), rows[k]["seconds"]] if below else None)
    guess = problem.initial_guess(simulation.state)
    return {
        "threads": jit.set_threads(),
        "converged": result.converged,
        "reason": result.reason,
        "start": problem.residual_norm(problem.gradient(guess)) / problem.force_scale,
        "reached": reached,
        "memory": peak_memory(),
    }


def dump(case: dict[str, Any]) -> dict[str, Any]:
    """Write the block for a peer, and time our own sweeps of a step in dynamics with the same mesh and numbers."""
    simulation = block(case["cells"], "neo_hookean", "stretch", {"method": "pbng"}, None)
    discretization = simulation.discretization
    law = discretization.groups[0].law
    np.savez(
        case["dump"],
        points=discretization.points,
        cells=simulation.meshes["block"].cells,
        positions=simulation.state.x,
        density=DENSITY,
        dt=DT,
        mu=law.mu,
        lmbda=law.lmbda,
    )
    times = {precision: _sweep_times(simulation, precision) for precision in ("float64", "float32")}
    return {"threads": jit.set_threads(), "times": times}


def _sweep_times(simulation: Simulation, precision: str) -> dict[str, float]:
    """Seconds of single sweeps from the present state."""
    problem: Any = simulation.problem
    nodes = NodeSweep(problem, np.dtype(precision))
    nodes.begin_step(problem)
    flat = nodes.flat(simulation.state.x)
    return measure(lambda: nodes.sweep(flat), _SWEEPS)


KINDS: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    "sweep": sweep,
    "bandwidth": bandwidth,
    "convergence": convergence,
    "dump": dump,
}


if __name__ == "__main__":
    child_process.serve(KINDS)
