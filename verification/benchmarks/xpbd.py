"""The XPBD benchmark: sweeps over the cells, what they reach at given stiffness numbers, and other codes beside."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from femdeform import jit
from verification.benchmarks import child_process
from verification.benchmarks.block import DT
from verification.benchmarks.child_process import Outcome, skipped
from verification.benchmarks.environment import chosen_cells, is_wanted
from verification.benchmarks.newton import NODES_BLOCK, peers_python
from verification.benchmarks.run import Findings

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


def run_xpbd(say: Callable[[str], None]) -> Findings:
    """Run all cases, one after the other, each in a process of its own.

    Parameters
    ----------
    say : callable
        Gets a line of text before each case.

    Returns
    -------
    Findings
    """
    from verification.benchmarks import xpbd_tables

    results = Results(chosen_cells() or NODES_BLOCK)
    for law in LAWS:
        for method in METHODS:
            # The neo-Hookean pair does not vanish at rest.
            if method == "pbd" and law == "neo_hookean":
                continue
            for threads in sorted({jit.default_threads(), 1}, reverse=True):
                name = f"sweeps: {law}, {method}, {threads} thread{'s' if threads > 1 else ''}"
                if not is_wanted(name):
                    continue
                say(name)
                case = {"kind": "sweeps", "cells": results.cells, "law": law, "method": method}
                more = {"kappas": KAPPAS, "looks": LOOKS}
                results.sweeps[law, method, threads] = child_process.run_module(_CASE, case | more, threads)
    _peers(results, say)
    return xpbd_tables.findings(results)


def _peers(results: Results, say: Callable[[str], None]) -> None:
    wanted = {name: script for name, script in PEERS.items() if is_wanted(f"peers: {name}")}
    if not wanted:
        return
    python, reason = peers_python()
    if python is None:
        results.peers = dict.fromkeys(wanted, skipped(reason))
        return
    with tempfile.TemporaryDirectory(prefix="femdeform-bench-") as folder:
        dump = str(Path(folder, "block.npz"))
        case = {"kind": "dump", "cells": results.cells, "dump": dump, "dt": DT, "kappas": KAPPAS, "looks": LOOKS}
        written = child_process.run_module(_CASE, case, 1)
        for name, script in wanted.items():
            if not written.done:
                results.peers[name] = skipped("there is no state to compare at")
                continue
            say(f"peers: {name}")
            path = Path(__file__).parent / "peers" / script
            results.peers[name] = child_process.run_script(python, path, {"block": dump})
