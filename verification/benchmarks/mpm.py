"""The material point benchmark: points a second, their growth, parts of steps, linear iterations, and Taichi."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any

from femdeform import jit
from verification.benchmarks.cases import Cases
from verification.benchmarks.child_process import Outcome
from verification.benchmarks.environment import chosen_cells, has_petsc, is_wanted, thread_counts
from verification.benchmarks.tables import Findings, threads_text

# The main case: points, and grid nodes along an edge.
POINTS, NODES = 512_000, 128
# Points of the steps with a sampled surface and heat.
SAMPLED = 100_000
GROWTH = (64_000, 128_000, 256_000, 512_000, 1_000_000)
DTYPES = ("float64", "float32")
# Other materials and transfers, in float64.
OTHERS = (
    ("fixed_corotated", "apic"),
    ("liquid", "apic"),
    ("viscous liquid", "apic"),
    ("neo_hookean", "pic"),
    ("neo_hookean", "flip"),
)

# Scenes of scenes/mpm whose steps are taken apart, and how many of them; only without FEMDEFORM_BENCH_CELLS.
SCENES = {"impact": 40, "rebound": 40, "soap-3d": 40, "wine-glass-3d": 40, "candle-3d": 20, "drop-on-jelly": 5}
# Courant numbers of sound, and cells along a unit length by dimension.
COURANT = (0.5, 2.0, 10.0, 50.0, 200.0)
COURANT_CELLS = {2: 48, 3: 24}
PRECONDITIONERS = ("newton-pbjacobi", "newton-icc-scaled", "newton-icc", "newton-ssor", "newton-gamg", "newton-hypre")
METHODS = ("block_cg", *PRECONDITIONERS, "newton-mumps")

_CASE = "verification.benchmarks.mpm_case"
_STEP_CASE = "verification.benchmarks.mpm_step_case"


@dataclass
class Results:
    """Outcomes of all cases; `mpm_tables` makes tables of them.

    Attributes
    ----------
    points, nodes : int
        Points of the main case, and grid cells along an edge.
    main : dict
        By type of numbers and number of threads.
    growth : dict
        By number of points and type of numbers.
    others : dict
        By law and transfer.
    sampled : dict
        By number of threads.
    scenes : dict
        By name.
    courant : dict
        By dimension and linear solver.
    peers : dict
        By type of numbers.
    """

    points: int
    nodes: int
    main: dict[tuple[str, int], Outcome] = field(default_factory=dict)
    growth: dict[tuple[int, str], Outcome] = field(default_factory=dict)
    others: dict[tuple[str, str], Outcome] = field(default_factory=dict)
    sampled: dict[int, Outcome] = field(default_factory=dict)
    scenes: dict[str, Outcome] = field(default_factory=dict)
    courant: dict[tuple[int, str], Outcome] = field(default_factory=dict)
    peers: dict[str, Outcome] = field(default_factory=dict)

    def own_cases(self) -> dict[str, Outcome]:
        """Every case of femdeform's own, by a name for people."""
        cases = {f"steps, {dtype}, {threads_text(n)}": outcome for (dtype, n), outcome in self.main.items()}
        cases |= {f"growth, {dtype}, {n:,} points": outcome for (n, dtype), outcome in self.growth.items()}
        cases |= {f"{law}, {transfer}": outcome for (law, transfer), outcome in self.others.items()}
        cases |= {f"sampled, {threads_text(n)}": outcome for n, outcome in self.sampled.items()}
        cases |= {f"scene, {name}": outcome for name, outcome in self.scenes.items()}
        return cases | {f"Courant, {dim}D, {method}": outcome for (dim, method), outcome in self.courant.items()}


def run_mpm(cases: Cases) -> Findings:
    """Steps, their growth, other materials, parts of steps, linear iterations, then peers; see `Benchmark`."""
    from verification.benchmarks import mpm_tables

    cells = chosen_cells()
    # FEMDEFORM_BENCH_CELLS is the number of cells along an edge of the body.
    results = Results(POINTS, NODES) if cells is None else Results(8 * cells**3, 2 * cells + 8)
    cases.begin(partial(mpm_tables.findings, results))
    scale = results.points / POINTS
    most = jit.default_threads()

    def steps(points: int, law: str, dtype: str, transfer: str) -> dict[str, Any]:
        case = {"kind": "steps", "points": points, "nodes": results.nodes}
        return case | {"law": law, "dtype": dtype, "transfer": transfer}

    for dtype in DTYPES:
        for threads in thread_counts():
            case = steps(results.points, "neo_hookean", dtype, "apic")
            cases.run(results.main, (dtype, threads), f"steps: {dtype}, {threads_text(threads)}", _CASE, case, threads)
        for points in (max(64, round(each * scale)) for each in GROWTH):
            name = f"growth: {dtype}, {points:,} points"
            cases.run(results.growth, (points, dtype), name, _CASE, steps(points, "neo_hookean", dtype, "apic"), most)
    for law, transfer in OTHERS:
        case = steps(results.points, law, "float64", transfer)
        cases.run(results.others, (law, transfer), f"others: {law}, {transfer}", _CASE, case, most)
    for threads in thread_counts():
        case = {"kind": "sampled", "points": max(64, round(SAMPLED * scale)), "nodes": results.nodes}
        cases.run(results.sampled, threads, f"sampled: {threads_text(threads)}", _CASE, case, threads)
    if cells is None:
        for scene, count in SCENES.items():
            cases.run(
                results.scenes,
                scene,
                f"scenes: {scene}",
                _STEP_CASE,
                {"kind": "scene", "scene": scene, "steps": count},
                most,
            )
    for dim, along in COURANT_CELLS.items():
        for method in METHODS if has_petsc() else METHODS[:1]:
            case = {"kind": "courant", "dim": dim, "cells": along if cells is None else 16, "method": method}
            name = f"courant: {dim}D, {method}"
            cases.run(results.courant, (dim, method), name, _STEP_CASE, case | {"numbers": COURANT}, most)
    _peers(results, cases, most)
    return mpm_tables.findings(results)


def _peers(results: Results, cases: Cases, threads: int) -> None:
    names = {dtype: f"peers: Taichi, {dtype}" for dtype in DTYPES}
    if not any(is_wanted(name) for name in names.values()):
        return
    state = {"kind": "dump", "points": results.points, "nodes": results.nodes}
    with cases.state(_CASE, state) as (dump, written):
        for dtype, name in names.items():
            case = {"dump": dump, "dtype": dtype, "threads": threads}
            cases.peer(results.peers, dtype, name, "taichi_mpm.py", case, written)
