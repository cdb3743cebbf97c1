"""What the child processes of the Newton benchmark do: one case each, on one rank or several.

``python -m verification.benchmarks.newton_case CASE RESULT``: CASE is a JSON file with ``kind`` and the case's own
keys, RESULT is written by the first rank.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from femdeform.fem.assembly import SparseHessian
from femdeform.types import FloatArray
from solvers.linear import coo
from solvers.linear.ksp import KSP, load_preset
from verification.benchmarks import child_process
from verification.benchmarks.block import Block
from verification.benchmarks.matrix_times import matrix_times
from verification.benchmarks.measure import REPETITIONS, measure, peak_memory, summary

# An iteration that takes longer is measured once: its repetitions would hold everything up and teach nothing.
_TOO_LONG = 60.0
_TOLERANCE = "1e-6"


def assembly(case: dict[str, Any]) -> dict[str, Any]:
    """Time energy, residual, tangents and their way into PETSc.

    Parameters
    ----------
    case : dict
        ``cells``: grid cells along an edge; ``dump``: optional file for the peers, see `dump`.

    Returns
    -------
    dict
        Summaries of seconds (see `measure.summary`) and sizes; ``values`` and ``all`` are None without PETSc.
    """
    block = Block(case["cells"], quasistatic=True)
    problem, x = block.problem, block.begin(1.0)
    result = _sizes(block) | {
        "energy": measure(lambda: problem.value(x)),
        "residual": measure(lambda: problem.gradient(x)),
        "tangent_projected": measure(lambda: problem.hessian(x, project=True)),
        "tangent_exact": measure(lambda: problem.hessian(x, project=False)),
        "values": None,
        "all": None,
    }
    solver = block.simulation.linear_solver
    if isinstance(solver, KSP):
        load = _loader(solver, problem.hessian(x, project=True))
        K = problem.hessian(x, project=True)
        result["values"] = measure(lambda: load(K))

        def everything() -> None:
            problem.gradient(x)
            load(problem.hessian(x, project=True))

        result["all"] = measure(everything)
    result["memory"] = peak_memory()
    if "dump" in case:
        dump(block, x, case["dump"])
    return result


def _loader(solver: KSP, K: SparseHessian) -> Callable[[SparseHessian], None]:
    """Return what sets the values of a solver's matrix, as its `solve` does before it solves."""
    solver._set_up(K)
    matrix = solver._matrix
    return lambda K: coo.set_values(matrix, K.values)


def dump(block: Block, x: FloatArray, path: str) -> None:
    """Write mesh, material and state for the peers, with our forces and one product K v to compare theirs with."""
    problem, discretization = block.problem, block.simulation.discretization
    law = discretization.groups[0].law
    direction = np.random.default_rng(7).standard_normal(x.shape)
    K = problem.hessian(x, project=False, free=np.ones_like(problem.free))
    np.savez(
        path,
        points=discretization.points,
        cells=block.simulation.meshes["block"].cells,
        displacement=x - discretization.points,
        load=problem.load,
        fixed=np.flatnonzero(~problem.free[:, 0]),
        mu=law.mu,
        lmbda=law.lmbda,
        forces=problem.internal_forces(x),
        direction=direction,
        product=matrix_times(K, direction),
    )


def iteration(case: dict[str, Any]) -> dict[str, Any]:
    """Time Newton iterations: residual, projected tangent, linear solve to a relative residual of 1e-6.

    The first one, from half the deformation, also pays for all that depends on the mesh only; the repeated ones
    start from the full deformation, with whatever the solver keeps from the first.

    Parameters
    ----------
    case : dict
        ``cells``, ``quasistatic``, ``linear_solver`` (as in a scene).

    Returns
    -------
    dict
        ``first`` and ``repeated``: seconds for ``residual``, ``tangent``, ``solve`` and ``whole`` (``repeated``:
        summaries, or None where the first took too long); linear iterations; the true relative residual of the
        linear system; ``memory``: peak of each rank [bytes], before the first linear solve and at the end.
    """
    options = dict(case["linear_solver"])
    if options["method"] == "ksp" and "ksp_rtol" in load_preset(options["preset"]).options:
        options["options"] = {"ksp_rtol": _TOLERANCE}
    block = Block(case["cells"], case["quasistatic"], options)
    problem, solver = block.problem, block.simulation.linear_solver
    if options["method"] == "ksp" and not isinstance(solver, KSP):
        return {"skipped": "; ".join(block.simulation.notices)}
    comm = problem.partition.comm
    barrier = None if comm is None else comm.Barrier
    # Kernels are compiled, or loaded from the disk, before anything is timed.
    x = block.begin(0.5)
    problem.gradient(x)
    problem.hessian(x, project=True)
    before = _all_ranks(comm, peak_memory())

    def one() -> tuple[dict[str, float], Any, float]:
        marks = [_now(barrier)]
        residual = problem.gradient(x)
        marks.append(_now(barrier))
        K = problem.hessian(x, project=True)
        marks.append(_now(barrier))
        answer = solver.solve(K, -residual)
        marks.append(_now(barrier))
        parts = dict(zip(("residual", "tangent", "solve"), np.diff(marks).tolist(), strict=True))
        remainder = problem.partition.norm(matrix_times(K, answer.x) + residual) / problem.partition.norm(residual)
        return parts | {"whole": marks[-1] - marks[0]}, answer, remainder

    first, answer, remainder = one()
    after = _all_ranks(comm, peak_memory())
    repeated = None
    too_long = problem.partition.max(first["whole"]) > _TOO_LONG
    if answer.converged and not too_long:
        x = block.begin(1.0)
        one()
        rows = []
        for _ in range(REPETITIONS):
            row, answer, remainder = one()
            rows.append(row)
        after = _all_ranks(comm, peak_memory())
        repeated = {name: summary([row[name] for row in rows]) for name in rows[0]}
    return _sizes(block) | {
        "solver": solver.name,
        "ranks": problem.partition.size,
        "first": first,
        "repeated": repeated,
        "iterations": answer.iterations,
        "converged": answer.converged,
        "reason": answer.reason,
        "relative_residual": remainder,
        "memory_before_solve": before,
        "memory": after,
    }


def _now(barrier: Callable[[], Any] | None) -> float:
    if barrier is not None:
        barrier()
    return time.perf_counter()


def _all_ranks(comm: Any | None, value: int) -> list[int]:
    return [value] if comm is None else list(comm.allgather(value))


def _sizes(block: Block) -> dict[str, Any]:
    from femdeform.jit import set_threads

    return {
        "n_nodes": block.simulation.discretization.partition.n_global,
        "n_cells": block.n_cells,
        "n_dofs": block.simulation.discretization.n_dofs,
        "threads": set_threads(),
    }


KINDS: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {"assembly": assembly, "iteration": iteration}


if __name__ == "__main__":
    child_process.serve(KINDS)
