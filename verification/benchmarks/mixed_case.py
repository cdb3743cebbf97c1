"""What the child processes of the mixed benchmark do: one body or beam each.

``python -m verification.benchmarks.mixed_case CASE RESULT``: CASE is a JSON file with ``kind`` and the case's own
keys.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from femdeform.jit import set_threads
from femdeform.run.setup import Simulation
from femdeform.types import FloatArray
from solvers.linear.interface import LinearResult, LinearSolver
from solvers.mixed import local_kernels
from solvers.mixed.alternating import Alternating
from solvers.mixed.local_state import LocalState
from verification.benchmarks import child_process
from verification.benchmarks.matrix_times import matrix_times
from verification.benchmarks.measure import REPETITIONS, peak_memory, summary
from verification.benchmarks.mixed_bodies import soft_cantilever, thrown, twisted_beam

PHASES = ("assembly", "solve", "local")
# Steps that strain the body before anything is measured.
_STEPS = 5
# Short substeps are repeated until they fill so many seconds, but not more often than that.
_FILL_SECONDS, _MOST_REPETITIONS = 0.3, 50
# Iterations of the step of which single iterations are timed, the first left out.
_ITERATIONS = 7
# Both block rows of a saddle system that counts as solved, each over its own size.
ROW_TOLERANCE = 1e-3
# A first step this many times above that is not followed by others.
_HOPELESS = 10.0
# SuperLU's fill grows so fast that the fallback without PETSc is measured on small bodies only.
_SCIPY_DOFS = 10_000
_PROBLEMS = {"twist": twisted_beam, "sag": soft_cantilever}


def substep(case: dict[str, Any]) -> dict[str, Any]:
    """Time substeps of the alternating scheme: one outer, one inner iteration, after a few steps.

    Parameters
    ----------
    case : dict
        ``body`` (see `mixed_bodies.Body.case`), ``dt`` [s], ``variants``: by name, with ``solver`` (options of
        mixed_fem), ``linear_solver`` and ``tolerances``: of conjugate gradients, the loosest first. The first one
        that brings both block rows to `ROW_TOLERANCE` is timed; where none does, nothing is.

    Returns
    -------
    dict
        Sizes and, by variant, linear iterations, relative residuals of both block rows, ``tolerance``, and where both
        are small enough summaries of seconds of the three phases (``times``, with the ``whole`` substep) and of their
        sum, peak memory [bytes] before and after; or ``reason`` where a step failed.
    """
    threads = set_threads()
    results: dict[str, Any] = {}
    for name, variant in case["variants"].items():
        options = {"method": "mixed_fem", "scheme": "alternating", "outer_iterations": 1, "inner_iterations": 1}
        tolerances = variant.get("tolerances") or [""]
        for tolerance in tolerances:
            linear_solver = dict(variant["linear_solver"])
            if tolerance:
                linear_solver["options"] = {"ksp_rtol": tolerance}
            simulation = thrown(case["body"], case["dt"], options | variant["solver"], linear_solver)
            results[name] = _substeps(simulation, case["dt"]) | {"tolerance": tolerance}
            sizes = _sizes(simulation)
            simulation.destroy()
            if "times" in results[name]:
                break
    return sizes | {"threads": threads, "variants": results}


def _substeps(simulation: Simulation, dt: float) -> dict[str, Any]:
    """Steps, then one step again and again, unless it leaves a block row above `ROW_TOLERANCE`."""
    problem, solver, state = simulation.problem, simulation.solver, simulation.state
    if simulation.linear_solver.name == "scipy_direct" and simulation.discretization.n_dofs > _SCIPY_DOFS:
        return {"reason": f"SciPy's direct solver: only up to {_SCIPY_DOFS:,} degrees of freedom"}
    problem.begin_step(state, dt)
    problem.gradient(state.x)
    problem.hessian(state.x, project=True)
    before = peak_memory()
    facts: dict[str, Any] = {}

    def judge(row: Mapping[str, Any], x: FloatArray) -> None:
        if "kkt_constraint_residual" in row:
            facts["momentum"], facts["constraint"] = row["kkt_momentum_residual"], row["kkt_constraint_residual"]
        else:
            scheme = getattr(solver, "_alternating", None)
            assert isinstance(scheme, Alternating)
            facts["momentum"], facts["constraint"] = block_rows(problem, scheme, problem.predictor(state), x)

    for k in range(_STEPS + 1):
        problem.begin_step(state, dt)
        # The first step shows early whether a solver is far from accurate; the last one is that which is timed.
        limit = {0: _HOPELESS * ROW_TOLERANCE, _STEPS: ROW_TOLERANCE}.get(k)
        result = solver.step(problem, state, None if limit is None else judge)
        if not result.accepted:
            return {"reason": f"step {k + 1}: {result.reason}"}
        facts["linear_iterations"] = result.linear_iterations
        # Not a maximum: nan has to fail.
        if limit is not None and not all(facts[row] <= limit for row in ("momentum", "constraint")):
            return facts
        if k < _STEPS:
            state = problem.accept(state, result.x)
    rows: list[dict[str, float]] = []
    while len(rows) < REPETITIONS or (
        sum(row["whole"] for row in rows) < _FILL_SECONDS and len(rows) < _MOST_REPETITIONS
    ):
        earlier, begin = _phases(solver), time.perf_counter()
        result = solver.step(problem, state)
        row = {"whole": time.perf_counter() - begin}
        later = _phases(solver)
        rows.append(row | {phase: later[phase] - earlier[phase] for phase in PHASES})
    return facts | {
        "times": {name: summary([row[name] for row in rows]) for name in rows[0]},
        "sum": summary([sum(row[phase] for phase in PHASES) for row in rows]),
        "memory_before": before,
        "memory": peak_memory(),
    }


def _phases(solver: Any) -> dict[str, float]:
    seconds: dict[str, float] = solver.seconds
    return seconds


def block_rows(problem: Any, scheme: Alternating, start: FloatArray, end: FloatArray) -> tuple[float, float]:
    """Relative residuals of the saddle system that one inner iteration from `start` to `end` solved.

    Momentum row A dx + B^T y = b1 and constraint row B dx - C y = b2, each over the sum of the sizes of its terms,
    from the multipliers that the scheme holds; for six multipliers a point.

    Parameters
    ----------
    problem : IncrementalPotential
        With the step begun.
    scheme : Alternating
        Right after the iteration.
    start, end : (n_local, dim) float64
        Positions [m].

    Returns
    -------
    tuple of float
        Momentum and constraint row [-].
    """
    change = end - start

    def nothing(k: int, blocks: FloatArray, first: int) -> None:
        n = scheme.groups[k].group.cells.shape[1]
        blocks[first : first + scheme.groups[k].group.n_cells * n * (n + 1) // 2] = 0.0

    A = problem.hessian(start, project=True, elastic=nothing, is_part=True)
    forces = np.zeros_like(change)
    rows = []
    for group in scheme.groups:
        B, C, side = group.saddle()
        y = _multipliers(group)
        cells, dim = group.group.cells, change.shape[1]
        B_y = np.einsum("eqmk,eqm->ek", B, y).reshape(*cells.shape, dim)
        np.add.at(forces, cells.ravel(), B_y.reshape(-1, dim))
        B_dx = np.einsum("eqmk,ek->eqm", B, change[cells].reshape(len(cells), -1))
        rows.append((B_dx, -np.einsum("eqml,eql->eqm", C, y), -side))
    free = problem.free
    momentum = (
        np.where(free, matrix_times(A, change), 0.0),
        np.where(free, forces, 0.0),
        np.where(free, problem.full_gradient(start, elastic=False), 0.0),
    )
    constraint = tuple(np.concatenate([part.ravel() for part in parts]) for parts in zip(*rows, strict=True))
    return _relative(momentum), _relative(constraint)


def _multipliers(group: LocalState) -> FloatArray:
    """Components y of the multipliers in the basis of `LocalState.saddle`, which is orthonormal."""
    n, n_q = group.group.weights.shape
    m = group.d * (group.d + 1) // 2
    y, L = np.zeros((n, n_q, m)), np.empty_like(group.L)
    result = np.empty_like(y)
    for i in range(m):
        y[:] = 0.0
        y[..., i] = 1.0
        local_kernels.symmetric_multipliers(y, group.R, group._frames, group._dim, L)
        result[..., i] = np.einsum("eqi,eqi->eq", L, group.L)
    return result


def _relative(terms: tuple[FloatArray, ...]) -> float:
    """Norm of a sum over the sum of the norms."""
    size = sum(float(np.linalg.norm(term)) for term in terms)
    return float(np.linalg.norm(sum(terms))) / size if size > 0.0 else 0.0


def iteration(case: dict[str, Any]) -> dict[str, Any]:
    """Time single iterations of one step with methods and linear solvers.

    Parameters
    ----------
    case : dict
        ``body``, ``dt`` [s], ``variants``: by name, with ``solver`` and ``linear_solver``.

    Returns
    -------
    dict
        Sizes and, by variant, summaries of seconds of a ``whole`` iteration and of its linear ``solve``, linear
        iterations of each; or ``reason``.
    """
    threads = set_threads()
    results = {}
    for name, variant in case["variants"].items():
        options = {"tolerance": 1e-12, "max_iterations": _ITERATIONS} | variant["solver"]
        simulation = thrown(case["body"], case["dt"], options, variant["linear_solver"])
        results[name] = _iterations(simulation, case["dt"])
        sizes = _sizes(simulation)
        simulation.destroy()
    return sizes | {"threads": threads, "variants": results}


class _TimedSolver:
    """A linear solver, and the seconds that were spent in it."""

    def __init__(self, solver: LinearSolver) -> None:
        self.solver = solver
        self.name = solver.name
        self.seconds = 0.0

    def solve(self, K: Any, b: FloatArray) -> LinearResult:
        begin = time.perf_counter()
        answer = self.solver.solve(K, b)
        self.seconds += time.perf_counter() - begin
        return answer

    def reset(self) -> None:
        self.solver.reset()

    def destroy(self) -> None:
        self.solver.destroy()


def _iterations(simulation: Simulation, dt: float) -> dict[str, Any]:
    problem, state = simulation.problem, simulation.state
    timed = _TimedSolver(simulation.linear_solver)
    solver: Any = simulation.solver
    solver.linear_solver = timed
    marks: list[tuple[float, float, int]] = []

    def mark(row: Mapping[str, Any], x: FloatArray) -> None:
        marks.append((float(row["seconds"]), timed.seconds, int(row["linear_iterations"])))

    # Once for the kernels and for all that depends on the mesh only, once for the figures.
    for _ in range(2):
        marks.clear()
        problem.begin_step(state, dt)
        result = solver.step(problem, state, mark)
    if len(marks) < 3:
        return {"reason": f"{len(marks)} iterations: {result.reason}"}
    whole, solve = np.diff([mark[:2] for mark in marks], axis=0).T
    return {
        "whole": summary(whole.tolist()),
        "solve": summary(solve.tolist()),
        "linear_iterations": [mark[2] for mark in marks[1:]],
        "relative_residual": result.relative_residual,
    }


def counts(case: dict[str, Any]) -> dict[str, Any]:
    """Count the iterations of one step of a beam.

    Parameters
    ----------
    case : dict
        ``problem`` (``twist`` or ``sag``), ``law``, ``modulus`` [Pa], ``cells``, ``linear_solver``, ``variants``: by
        name, options of the solver.

    Returns
    -------
    dict
        By variant: iterations, whether they converged and why they ended, seconds of the step, and how far its
        positions are from those of the first variant over that one's displacement [-].
    """
    threads = set_threads()
    make = _PROBLEMS[case["problem"]]
    results: dict[str, Any] = {}
    first: FloatArray | None = None
    for name, solver in case["variants"].items():
        simulation = make(case["law"], case["modulus"], tuple(case["cells"]), solver, case["linear_solver"])
        problem, state = simulation.problem, simulation.state
        problem.begin_step(state, simulation.scene.time.dt)
        begin = time.perf_counter()
        result = simulation.solver.step(problem, state)
        seconds = time.perf_counter() - begin
        first = result.x if first is None else first
        moved = float(np.abs(first - simulation.discretization.points).max())
        results[name] = {
            "iterations": result.iterations,
            "converged": result.converged,
            "reason": result.reason,
            "seconds": seconds,
            "difference": float(np.abs(result.x - first).max()) / moved,
        }
        sizes = _sizes(simulation)
        simulation.destroy()
    return sizes | {"threads": threads, "variants": results}


def _sizes(simulation: Simulation) -> dict[str, Any]:
    return {
        "n_nodes": simulation.discretization.partition.n_global,
        "n_cells": simulation.meshes["body"].n_cells,
        "n_dofs": simulation.discretization.n_dofs,
    }


KINDS: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    "substep": substep,
    "iteration": iteration,
    "counts": counts,
}

if __name__ == "__main__":
    child_process.serve(KINDS)
