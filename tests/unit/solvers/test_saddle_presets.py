"""Presets of saddle systems: a scene that names one runs with it, others refuse it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenario import advance, block, body, build, material, scene

from femdeform.errors import InputError
from solvers.linear.ksp import KSP, load_preset

pytestmark = pytest.mark.petsc

TIKHONOV = {"per": "compliance", "value": 0.1}


def beam(preset: str, options: dict[str, Any] | None = None, **solver: Any) -> dict[str, Any]:
    """The twisted rubber beam of the guide, coarser."""
    return scene(
        {"beam": body(block([1.0, 0.2, 0.2], [5, 1, 1]), material(E=1e6, nu=0.45))},
        {"kind": "fixed", "on": "beam.left"},
        {"kind": "rotate", "on": "beam.right", "axis": [1, 0, 0], "rate": 0.5},
        gravity=[0.0, -9.81, 0.0],
        solver={"method": "mixed_fem", "outer_iterations": 1, "inner_iterations": 5, **solver},
        linear_solver={"method": "ksp", "preset": preset, "options": options or {}},
    )


def positions(data: dict[str, Any]) -> Any:
    simulation = build(data)
    x = advance(simulation, 3).x
    simulation.solver.destroy()
    simulation.linear_solver.destroy()
    return x


@pytest.mark.parametrize("preset", ["kkt-direct", "kkt-minres"])
def test_a_scene_that_names_the_preset_runs_with_it(preset: str) -> None:
    data = beam(preset)
    simulation = build(data)
    assert simulation.scene.solver.global_solve == preset.replace("-", "_")
    rows: list[Any] = []
    simulation.problem.begin_step(simulation.state, 0.01)
    result = simulation.solver.step(simulation.problem, simulation.state, lambda row, x: rows.append(row))
    assert result.converged
    assert all(row["kkt_constraint_residual"] <= 1e-8 for row in rows)
    np.testing.assert_allclose(positions(data), positions(beam("newton-mumps")), atol=1e-9)


def test_the_published_solver_by_preset() -> None:
    simulation = build(beam("kkt-cg", scheme="alternating", tikhonov=TIKHONOV))
    assert simulation.scene.solver.global_solve == "kkt_cg"
    simulation.problem.begin_step(simulation.state, 0.01)
    assert simulation.solver.step(simulation.problem, simulation.state).accepted


def test_options_reach_the_factorisation() -> None:
    np.testing.assert_allclose(
        positions(beam("kkt-direct", {"mat_mumps_icntl_7": 0})), positions(beam("kkt-direct")), atol=1e-9
    )
    simulation = build(beam("kkt-direct", {"ksp_rtoll": 1e-3}))
    simulation.problem.begin_step(simulation.state, 0.01)
    with pytest.raises(InputError, match="did not use this option"):
        simulation.solver.step(simulation.problem, simulation.state)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (beam("kkt-direct", global_solve="condensed"), "kkt-direct is for the saddle systems"),
        (beam("kkt-direct", global_solve="kkt_minres"), "kkt-direct is for the saddle systems"),
        (beam("kkt-minres", {"ksp_rtol": 1e-3}), "takes no options of PETSc"),
        (beam("kkt-cg"), "kkt_cg needs a constant constraint matrix"),
    ],
    ids=["condensed", "other", "options", "cg"],
)
def test_what_does_not_go_together_is_refused(data: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        build(data)


def test_a_saddle_preset_solves_no_definite_system() -> None:
    assert load_preset("kkt-minres").global_solve == "kkt_minres"
    simulation = build(beam("newton-mumps"))
    problem = simulation.problem
    problem.begin_step(simulation.state, 0.01)
    K = problem.hessian(simulation.state.x, project=True)
    with pytest.raises(InputError, match="saddle systems"):
        KSP("kkt-direct").solve(K, problem.load)
