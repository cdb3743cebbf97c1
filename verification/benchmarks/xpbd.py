"""The XPBD benchmark: sweeps over the cells, what they reach at given stiffness numbers, and other codes beside."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any

from verification.benchmarks.block import DT
from verification.benchmarks.cases import Cases
from verification.benchmarks.child_process import Outcome
from verification.benchmarks.environment import chosen_cells, is_wanted, thread_counts
from verification.benchmarks.newton import NODES_BLOCK
from verification.benchmarks.tables import Findings, threads_text

LAWS = ("neo_hookean", "fixed_corotated")
METHODS = ("xpbd", "pbd", "b_pxpbd", "fp_pxpbd, 1 local", "fp_pxpbd, 3 local")
# Stiffness numbers h^2 E / (rho dx^2), and sweeps after which the residual is looked at.
KAPPAS = (0.16, 1.6, 16.0)
LOOKS = (5, 20, 60)
PEERS = {
    "pyPBD, XPBD": "pypbd_block.py",
    "Newton, SolverXPBD": "newton_xpbd.py",
    "Newton, SolverVBD": "newton_vbd.py",
}

_CASE = "verification.benchmarks.xpbd_case"


@dataclass
class Results:
    """Outcomes of all cases; `xpbd_tables` makes tables of them.

    Attributes
    ----------
    cells : int
        Grid cells along an edge of the block.
    sweeps : dict
        By law, method and number of threads.
    peers : dict
        By name.
    """

    cells: int
    sweeps: dict[tuple[str, str, int], Outcome] = field(default_factory=dict)
    peers: dict[str, Outcome] = field(default_factory=dict)


def run_xpbd(cases: Cases) -> Findings:
    """Sweeps, then peers; see `Benchmark`."""
    from verification.benchmarks import xpbd_tables

    results = Results(chosen_cells() or NODES_BLOCK)
    cases.begin(partial(xpbd_tables.findings, results))
    for law in LAWS:
        for method in METHODS:
            # The neo-Hookean pair does not vanish at rest.
            if method == "pbd" and law == "neo_hookean":
                continue
            case: dict[str, Any] = {"kind": "sweeps", "cells": results.cells, "law": law, "method": method}
            case |= {"kappas": KAPPAS, "looks": LOOKS}
            for threads in thread_counts():
                name = f"sweeps: {law}, {method}, {threads_text(threads)}"
                cases.run(results.sweeps, (law, method, threads), name, _CASE, case, threads)
    _peers(results, cases)
    return xpbd_tables.findings(results)


def _peers(results: Results, cases: Cases) -> None:
    names = {name: f"peers: {name}" for name in PEERS}
    if not any(is_wanted(name) for name in names.values()):
        return
    case = {"kind": "dump", "cells": results.cells, "dt": DT, "kappas": KAPPAS, "looks": LOOKS}
    with cases.state(_CASE, case) as (dump, written):
        for name, script in PEERS.items():
            cases.peer(results.peers, name, names[name], script, {"block": dump}, written)
