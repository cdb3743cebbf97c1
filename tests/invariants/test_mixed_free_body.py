"""What the mixed method keeps and loses in two hundred steps of a free body: momentum, energy, volume."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenario import Array, block, body, build, material, scene

from femdeform.run.quantities import standard_quantities

H, STEPS = 0.005, 200
SCHEMES: dict[str, dict[str, Any]] = {
    "converged": {"method": "mixed_fem", "tolerance": 1e-12},
    "alternating": {"method": "mixed_fem", "scheme": "alternating", "inner_iterations": 5},
}


def moment(x: Array, p: Array) -> Array:
    return np.asarray(np.cross(x, p).sum(axis=0))


def tumble(law: str, solver: dict[str, Any]) -> dict[str, Array]:
    """A block thrown and spinning so fast that it deforms; nothing holds it, nothing pulls at it."""
    simulation = build(
        scene(
            {"b": body(block([0.8, 0.4, 0.4], [4, 2, 2]), material(law, E=1e5, nu=0.45))},
            {"kind": "initial_velocity", "on": "b", "velocity": [1, 2, 3], "angular_velocity": [3, -5, 8]},
            time={"scheme": "backward_euler", "dt": H, "end": STEPS * H},
            solver=solver,
        )
    )
    problem, M = simulation.problem, simulation.problem.apply_mass
    rows: dict[str, list[Any]] = {}

    def record(own_loss: Array) -> None:
        x, v = simulation.state.x, simulation.state.v
        elastic = problem.elastic_energy(x)
        kinetic = problem.kinetic_energy(v)
        found = {
            "linear": M(v).sum(axis=0),
            "angular": moment(x, M(v)),
            "own_loss": own_loss,
            "elastic": elastic,
            "energy": kinetic + elastic,
            "volume": standard_quantities(simulation, simulation.state)["volume_ratio"],
        }
        for name, value in found.items():
            rows.setdefault(name, []).append(value)

    record(np.zeros(3))
    for _ in range(STEPS):
        before = M(simulation.state.v)
        problem.begin_step(simulation.state, H)
        result = simulation.solver.step(problem, simulation.state)
        assert result.accepted, result.reason
        simulation.state = problem.accept(simulation.state, result.x)
        # Backward Euler's change of the angular momentum (methods.md, section 6): h sum v_new x M v_old.
        record(H * moment(simulation.state.v, before))
    return {name: np.array(values) for name, values in rows.items()}
