"""The benchmark of deep conjugate directions: what the source draws and claims, beside classical solvers."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any

from verification.benchmarks.cases import Cases
from verification.benchmarks.child_process import Outcome
from verification.benchmarks.environment import chosen_cells
from verification.benchmarks.poisson import Grid, chosen_grids
from verification.benchmarks.tables import Findings

GRIDS = (Grid(64, 2), Grid(128, 2), Grid(32, 3), Grid(64, 3))
# Steps of the flow whose pressures are solved for; fewer in space, where networks are slow.
FRAMES = (5, 10, 15, 20, 25, 30, 35, 40)
FRAMES_IN_SPACE = (20, 40)
# Diffusion numbers of heat steps: from one that any solver takes in its stride to one that is all but steady.
NUMBERS = (1.0, 100.0, 1e4)
# Optimiser's steps and voxels along an edge of a square; half a minute each on a core that nobody else uses. The
# networks are tried on twice as many voxels along an edge.
STEPS, CELLS = 400, 32
# Networks by name: the word of `femdeform train dcdm --model`, and the route.
NETWORKS: dict[str, tuple[str, str]] = {
    "the source's for 64^3": ("source-64", "on_policy"),
    "the same, trained as the source's": ("source-64", "ritz"),
    "the source's for 128^3": ("source-128", "on_policy"),
    "no residual connections": ("no-residual", "on_policy"),
    "no sum over halving": ("no-skip", "on_policy"),
    "convolutions only": ("no-pooling", "on_policy"),
    "8 channels": ("narrow", "on_policy"),
    "no biases": ("no-bias", "on_policy"),
    "no biases, sees fluid and air": ("masks", "on_policy"),
}

_CASE = "verification.benchmarks.dcdm_case"


@dataclass
class Results:
    """Outcomes of all cases; `dcdm_tables` makes tables of them.

    Attributes
    ----------
    pressures : dict
        By grid and whether it is open.
    heat : dict
        By grid.
    networks : dict
        By name, see `NETWORKS`.
    transfer : dict
        By voxels along an edge that the network was trained on.
    training, tests : int
        Voxels along an edge that networks are trained and tried on.
    """

    training: int
    tests: int
    pressures: dict[tuple[Grid, bool], Outcome] = field(default_factory=dict)
    heat: dict[Grid, Outcome] = field(default_factory=dict)
    networks: dict[str, Outcome] = field(default_factory=dict)
    transfer: dict[int, Outcome] = field(default_factory=dict)


def run_dcdm(cases: Cases) -> Findings:
    """Pressures and steps of the heat equation on each grid, then networks; see `Benchmark`."""
    from verification.benchmarks import dcdm_tables
    from verification.benchmarks.learned_weights import missing_weights

    training = chosen_cells() or CELLS
    results = Results(training, 2 * training)
    cases.begin(partial(dcdm_tables.findings, results))
    for grid in chosen_grids(GRIDS):
        reason = missing_weights("dcdm", grid.dim)
        frames = FRAMES if grid.dim == 2 else FRAMES_IN_SPACE
        case: dict[str, Any] = {"kind": "compare", **grid._asdict(), "frames": frames}
        for is_open in (False, True):
            name = f"{grid}: pressures, {'open' if is_open else 'closed'}"
            cases.run(results.pressures, (grid, is_open), name, _CASE, case | {"open": is_open}, reason=reason)
        case = {"kind": "heat", **grid._asdict(), "numbers": NUMBERS}
        cases.run(results.heat, grid, f"{grid}: heat", _CASE, case, reason=reason)
    for network, (model, route) in NETWORKS.items():
        case = {"kind": "train", "model": model, "route": route, "steps": STEPS, "frames": FRAMES}
        case |= {"cells": results.training, "test_cells": results.tests}
        cases.run(results.networks, network, f"training: {network}", _CASE, case)
    for size in (training, 2 * training):
        tests = [training, 2 * training, 4 * training]
        case = {"kind": "transfer", "cells": size, "tests": tests, "steps": STEPS, "frames": FRAMES}
        cases.run(results.transfer, size, f"transfer: trained on {size} voxels along an edge", _CASE, case)
    return dcdm_tables.findings(results)
