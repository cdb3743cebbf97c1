"""What keeps the memory of large meshes low gives the same numbers, and leaves out what nobody asks for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from femdeform.fem import discretization
from solvers.position_based import layout
from solvers.position_based.node_sweep import NodeSweep
from verification.benchmarks.pbng_case import block


def simulation(law: str = "neo_hookean", solver: dict[str, Any] | None = None) -> Any:
    return block(3, law, "stretch", solver or {"method": "pbng", "iterations": 2}, None)


def test_shape_functions_in_batches_are_those_of_all_cells(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = simulation().discretization
    monkeypatch.setattr(discretization, "_BATCH", 7)
    parts = simulation().discretization
    (a,), (b,) = whole.groups, parts.groups
    for name in ("cells", "gradients", "weights", "cell_ids"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    np.testing.assert_allclose(parts.lumped_mass, whole.lumped_mass, rtol=1e-14)
    assert parts.lumped_mass.sum() == pytest.approx(1000.0, rel=1e-13)


@pytest.mark.parametrize("law", ["neo_hookean", "fixed_corotated"])
def test_visits_in_batches_are_those_of_all_cells(law: str, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = simulation(law).problem
    (whole,) = NodeSweep(problem)._parts
    monkeypatch.setattr(layout, "_BATCH", 11)
    (parts,) = NodeSweep(problem)._parts
    for name in ("nodes", "offsets", "others", "gradients", "volumes"):
        np.testing.assert_array_equal(getattr(whole.visits, name), getattr(parts.visits, name))
    if law == "neo_hookean":
        a: Any = whole
        b: Any = parts
        np.testing.assert_array_equal(a._stencil.neighbours, b._stencil.neighbours)
        np.testing.assert_allclose(a._stencil.weights, b._stencil.weights, rtol=1e-13)
        np.testing.assert_allclose(a._stencil.diagonal, b._stencil.diagonal, rtol=1e-13)


def test_sweeps_need_no_sparsity_and_no_copies_of_gradients() -> None:
    ready = simulation()
    problem = ready.problem
    ready.solver.step(problem, ready.state)
    assert problem._cell_pattern is None
    (cells,) = problem.local_cells()
    assert np.shares_memory(cells.gradients, problem.elastic[0].group.gradients)
    K = problem.hessian(ready.state.x, project=True)
    assert problem._cell_pattern is K.pattern is problem.pattern
