"""Mixed finite elements under incremental potential contact: the same answers as projected Newton's."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenario import block, body, build, material, quasistatic, scene, write

from femdeform.contact.obstacle_barrier import ObstacleBarrier
from femdeform.errors import InputError
from femdeform.run.compare import Variant, compare
from femdeform.run.setup import Simulation
from femdeform.scene.mixed_schema import MixedFEMSolver
from solvers.mixed_variational import MixedVariational

NEWTON = {"tolerance": 1e-11}
MIXED = {"method": "mixed_fem", "tolerance": 1e-11}
IPC: dict[str, Any] = {"method": "ipc"}
GROUND = {"kind": "plane", "point": [0.0, 0.0], "normal": [0.0, 1.0], "friction": 0.4}
SOFT = material("stable_neo_hookean", E=1e5, nu=0.35)


def solve(
    data: dict[str, Any], solver: dict[str, Any], steps: int, look: Callable[[Simulation], None] | None = None
) -> tuple[Simulation, list[list[dict[str, Any]]]]:
    """Steps of a scene with a solver, and the rows of the iterations of each; nothing may cross."""
    simulation = build({**data, "solver": solver})
    problem = simulation.problem
    rows: list[list[dict[str, Any]]] = []
    for _ in range(steps):
        rows.append([])
        problem.begin_step(simulation.state, simulation.scene.time.dt)
        result = simulation.solver.step(problem, simulation.state, lambda row, x: rows[-1].append(dict(row)))
        assert result.converged, result.reason
        simulation.state = problem.accept(simulation.state, result.x)
        for coupling in problem.couplings:
            assert not coupling.intersects(simulation.state.x)
        for contact in problem.contacts:
            assert isinstance(contact, ObstacleBarrier)
            assert contact.gaps(simulation.state.x).min() > 0.0
        if look is not None:
            look(simulation)
    simulation.destroy()
    return simulation, rows


def drop() -> dict[str, Any]:
    """A tilted block falls onto another one that lies on the ground: pairs come and go, friction acts."""
    tilted = block([0.2, 0.1], [4, 2], rotate={"angle": 0.2}, translate=[0.12, 0.125])
    return scene(
        {
            "lower": body(block([0.4, 0.1], [6, 2], translate=[0.0, 0.002]), SOFT),
            "upper": body(tilted, SOFT),
        },
        {"kind": "initial_velocity", "on": "upper", "velocity": [0.3, -1.0], "angular_velocity": 1.0},
        obstacles=[GROUND],
        gravity=[0.0, -9.81],
        contact={**IPC, "friction": 0.3},
        time={"scheme": "backward_euler", "dt": 0.01, "end": 10.0},
    )


@pytest.mark.parametrize("more", [{}, {"finish": "mixed"}, {"global_solve": "kkt_direct"}])
def test_a_drop_agrees(more: dict[str, Any]) -> None:
    patterns: list[int] = []

    def look(simulation: Simulation) -> None:
        patterns.append(simulation.problem.pattern.n_values)
        # The level of rounding is known whatever became of the matrix it was taken from.
        assert simulation.problem.roundoff_norm(simulation.state.x) > 0.0

    newton, _ = solve(drop(), NEWTON, 15)
    mixed, rows = solve(drop(), {**MIXED, **more}, 15, look)
    (contact,) = mixed.problem.couplings
    assert contact.count(mixed.state.x) > 0
    assert len(set(patterns)) > 3  # the sparsity did change under way
    moved = np.abs(newton.state.x - newton.discretization.points).max()
    np.testing.assert_allclose(mixed.state.x, newton.state.x, atol=1e-7 * moved)
    assert max(map(len, rows)) < 40


def press(**obstacle: Any) -> dict[str, Any]:
    """A block pressed between a support and a plate that comes down."""
    bodies = {"soft": body(block([0.4, 0.2], [6, 3]), SOFT)}
    conditions: list[dict[str, Any]] = [{"kind": "fixed", "on": "soft.bottom"}]
    if not obstacle:
        bodies["plate"] = body(block([0.3, 0.05], [3, 1], translate=[0.05, 0.22]), material(E=1e8))
        conditions.append({"kind": "translate", "on": "plate.top", "velocity": [0.0, -0.06]})
    more = {"obstacles": [obstacle]} if obstacle else {}
    return scene(bodies, *conditions, contact=IPC, time=quasistatic(0.5), **more)


PLATE = {"kind": "plane", "point": [0.0, 0.22], "normal": [0.0, -1.0], "velocity": [0.0, -0.06]}


@pytest.mark.parametrize("obstacle", [{}, PLATE])
def test_supports_and_obstacles_push_in_portions(obstacle: dict[str, Any]) -> None:
    """Their motion of a step is longer than the gap before them: it has to be broken, and bodies give way."""
    data = press(**obstacle)
    newton, _ = solve(data, NEWTON, 2)
    mixed, rows = solve(data, MIXED, 2)
    assert rows[0][0]["iteration"] > 2
    top = mixed.conditions.local_nodes("soft.top")
    assert (mixed.state.x - mixed.discretization.points)[top, 1].min() < -0.03
    np.testing.assert_allclose(mixed.state.x, newton.state.x, atol=1e-8)


@pytest.mark.parametrize("obstacle", [{}, PLATE])
def test_comparisons_judge_where_obstacles_are(obstacle: dict[str, Any], tmp_path: Path) -> None:
    """The judge sees the moved obstacle too: it finds the residual that the solvers report, and a reference."""
    path = write(press(**obstacle), tmp_path / "s.yaml")
    comparison = compare(path, [Variant("newton"), Variant("mixed", (), "mixed_fem")], iterations=60, steps=2)
    for row in comparison.steps:
        assert row["status"] == "converged", row["stopped_by"]
        assert row["distance_max"] < 1e-6
        assert row["residual_norm"] == pytest.approx(row["reported_residual"], rel=1e-3, abs=1e-9 * row["force_scale"])
    assert not [text for text in comparison.notices if "residual" in text]


def test_the_alternating_scheme_refuses_barriers() -> None:
    with pytest.raises(InputError, match=r"solver\.scheme: .* inside a barrier; use converged"):
        build({**drop(), "solver": {"method": "mixed_fem", "scheme": "alternating"}})
    simulation = build(drop())
    solver = MixedVariational(MixedFEMSolver(method="mixed_fem", scheme="alternating"), simulation.linear_solver)
    simulation.problem.begin_step(simulation.state, 0.01)
    with pytest.raises(InputError, match="inside a barrier"):
        solver.step(simulation.problem, simulation.state)
