"""The `expect:` block: values at the end of a run, and whether they are inside their tolerance."""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.fem.fields import volumes
from femdeform.fem.incremental_potential import State
from femdeform.run.setup import Simulation
from femdeform.scene import schema


def check_expectations(simulation: Simulation, state: State) -> list[dict[str, Any]]:
    """Compare every expected value of a scene with the computed one; collective over the ranks.

    Returns
    -------
    list of dict
        ``quantity, computed, expected, atol, rtol, passed`` of each, in the order of the schema.
    """
    expect = simulation.scene.expect
    verdicts = []
    scalars = {
        "volume_ratio": expect.volume_ratio,
        "elastic_energy": expect.elastic_energy,
        "kinetic_energy": expect.kinetic_energy,
        "max_displacement": expect.max_displacement,
        "min_jacobian": expect.min_jacobian,
    }
    for name, expected in scalars.items():
        if expected is not None:
            verdicts.append(_verdict(name, scalar_quantity(name, simulation, state), expected))
    for wanted in expect.displacement:
        label = f"displacement.{wanted.component} on {wanted.on if isinstance(wanted.on, str) else 'selection'}"
        verdicts.append(_verdict(label, mean_displacement(simulation, state, wanted), wanted))
    return verdicts


def scalar_quantity(name: str, simulation: Simulation, state: State) -> float:
    """One of the scalar quantities of `expect:`; collective over the ranks."""
    problem, partition = simulation.problem, simulation.discretization.partition
    if name == "elastic_energy":
        return problem.elastic_energy(state.x)
    if name == "kinetic_energy":
        return problem.kinetic_energy(state.v)
    if name == "max_displacement":
        length = np.linalg.norm(state.x - simulation.discretization.points, axis=1)
        return partition.max(float(length.max(initial=0.0)))
    reference, deformed, smallest = volumes(simulation.discretization.groups, state.x)
    if name == "min_jacobian":
        return partition.min(smallest)
    return partition.sum(deformed) / partition.sum(reference)


def mean_displacement(simulation: Simulation, state: State, wanted: schema.ExpectedDisplacement) -> float:
    """Component, or norm, of the mean displacement of the selected nodes [m]; collective over the ranks."""
    discretization = simulation.discretization
    partition = discretization.partition
    nodes = simulation.conditions.local_nodes(wanted.on)
    nodes = nodes[nodes < partition.n_owned]
    total = (state.x[nodes] - discretization.points[nodes]).sum(axis=0)
    count = partition.sum(float(nodes.size))
    mean = np.array([partition.sum(float(component)) for component in total]) / count
    if wanted.component == "norm":
        return float(np.linalg.norm(mean))
    return float(mean["xyz".index(wanted.component)])


def _verdict(quantity: str, computed: float, expected: schema.ExpectedValue) -> dict[str, Any]:
    allowed = expected.atol + expected.rtol * abs(expected.value)
    return {
        "quantity": quantity,
        "computed": computed,
        "expected": expected.value,
        "atol": expected.atol,
        "rtol": expected.rtol,
        "passed": bool(abs(computed - expected.value) <= allowed),
    }
