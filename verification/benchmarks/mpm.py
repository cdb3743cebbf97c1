"""The material point benchmark: points a second in explicit steps, how that grows, and a Taichi kernel beside."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from femdeform import jit
from verification.benchmarks import child_process
from verification.benchmarks.child_process import Outcome, skipped
from verification.benchmarks.environment import chosen_cells, is_wanted
from verification.benchmarks.newton import peers_python
from verification.benchmarks.run import Findings

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

_CASE = "verification.benchmarks.mpm_case"


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
    peers : dict
        By type of numbers.
    """

    points: int
    nodes: int
    main: dict[tuple[str, int], Outcome] = field(default_factory=dict)
    growth: dict[tuple[int, str], Outcome] = field(default_factory=dict)
    others: dict[tuple[str, str], Outcome] = field(default_factory=dict)
    sampled: dict[int, Outcome] = field(default_factory=dict)
    peers: dict[str, Outcome] = field(default_factory=dict)


def run_mpm(say: Callable[[str], None]) -> Findings:
    """Run all cases, one after the other, each in a process of its own.

    Parameters
    ----------
    say : callable
        Gets a line of text before each case.

    Returns
    -------
    Findings
    """
    from verification.benchmarks import mpm_tables

    cells = chosen_cells()
    # FEMDEFORM_BENCH_CELLS is the number of cells along an edge of the body.
    results = Results(POINTS, NODES) if cells is None else Results(8 * cells**3, 2 * cells + 8)
    scale = results.points / POINTS
    most = jit.default_threads()

    def steps(name: str, points: int, law: str, dtype: str, transfer: str, threads: int) -> Outcome | None:
        if not is_wanted(name):
            return None
        say(name)
        case = {"kind": "steps", "points": points, "nodes": results.nodes}
        more = {"law": law, "dtype": dtype, "transfer": transfer}
        return child_process.run_module(_CASE, case | more, threads)

    for dtype in DTYPES:
        for threads in sorted({most, 1}, reverse=True):
            name = f"steps: {dtype}, {threads} thread{'s' if threads > 1 else ''}"
            found = steps(name, results.points, "neo_hookean", dtype, "apic", threads)
            if found is not None:
                results.main[dtype, threads] = found
        for points in (max(64, round(each * scale)) for each in GROWTH):
            found = steps(f"growth: {dtype}, {points:,} points", points, "neo_hookean", dtype, "apic", most)
            if found is not None:
                results.growth[points, dtype] = found
    for law, transfer in OTHERS:
        found = steps(f"others: {law}, {transfer}", results.points, law, "float64", transfer, most)
        if found is not None:
            results.others[law, transfer] = found
    for threads in sorted({most, 1}, reverse=True):
        name = f"sampled: {threads} thread{'s' if threads > 1 else ''}"
        if is_wanted(name):
            say(name)
            case = {"kind": "sampled", "points": max(64, round(SAMPLED * scale)), "nodes": results.nodes}
            results.sampled[threads] = child_process.run_module(_CASE, case, threads)
    _peers(results, say, most)
    return mpm_tables.findings(results)


def _peers(results: Results, say: Callable[[str], None], threads: int) -> None:
    wanted = [dtype for dtype in DTYPES if is_wanted(f"peers: Taichi, {dtype}")]
    if not wanted:
        return
    python, reason = peers_python()
    if python is None:
        results.peers = dict.fromkeys(wanted, skipped(reason))
        return
    with tempfile.TemporaryDirectory(prefix="femdeform-bench-") as folder:
        dump = str(Path(folder, "points.npz"))
        case = {"kind": "dump", "points": results.points, "nodes": results.nodes, "dump": dump}
        written = child_process.run_module(_CASE, case, 1)
        for dtype in wanted:
            if not written.done:
                results.peers[dtype] = skipped("there is no state to compare at")
                continue
            say(f"peers: Taichi, {dtype}")
            path = Path(__file__).parent / "peers" / "taichi_mpm.py"
            results.peers[dtype] = child_process.run_script(
                python, path, {"dump": dump, "dtype": dtype, "threads": threads}
            )
