"""Fibres in the node sweep: the force is exact, and the matrix bounds the energy along every step within its reach."""

from __future__ import annotations

import numpy as np
import pytest
from scenario import block, body, build, material, scene, term_gradient

from femdeform.materials.muscle_fibre import MuscleFibre, fibre_derivatives, fibre_energy
from solvers.position_based.node_fibres import REACH, bounds
from solvers.position_based.node_sweep import NodeSweep

FIBRES = {
    "passive": MuscleFibre(3.0, 1.2, 0.0),
    "half": MuscleFibre(3.0, 1.2, 0.5),
    "active": MuscleFibre(2.0, 0.9, 1.0),
}
ALL = pytest.mark.parametrize("fibre", FIBRES.values(), ids=FIBRES)


@ALL
def test_bound_holds_in_every_direction(fibre: MuscleFibre) -> None:
    """The energy at y + d lies below the parabola of the bound, for any d within reach, along y and across."""
    reach = REACH * fibre.optimal_stretch
    largest = 0.0
    for q in np.linspace(0.3, 1.9, 641):
        length = q * fibre.optimal_stretch
        along, across = bounds(length, fibre)
        tension, slope = fibre_derivatives(length, fibre)
        assert along >= slope - 1e-12
        assert across >= tension / length - 1e-12
        for angle in np.linspace(0.0, np.pi, 13):
            for size in (0.1, 0.5, 1.0):
                d = size * reach * np.array([np.cos(angle), np.sin(angle)])
                there = float(np.hypot(length + d[0], d[1]))
                parabola = tension * d[0] + 0.5 * along * d[0] ** 2 + 0.5 * across * d[1] ** 2
                above = fibre_energy(there, fibre) - fibre_energy(length, fibre) - parabola
                assert above <= 1e-13 * fibre.stress
                largest = max(largest, parabola - above)
    assert largest > 0.0


@ALL
def test_bound_is_not_far_from_the_stiffness(fibre: MuscleFibre) -> None:
    scale = fibre.stress / fibre.optimal_stretch**2
    for q in (0.5, 0.7, 0.9, 1.1, 1.3, 1.5):
        length = q * fibre.optimal_stretch
        along, across = bounds(length, fibre)
        near = [
            fibre_derivatives(k * fibre.optimal_stretch, fibre) for k in np.linspace(q - 2.0 * REACH, q + 2.0 * REACH)
        ]
        tension, slope = (max(values) for values in zip(*near, strict=True))
        assert along <= max(slope, 0.0) + 0.35 * fibre.activation * scale + 1e-12
        assert across <= 1.2 * tension / length + 0.1 * along


@pytest.mark.parametrize("dim", [2, 3])
def test_forces_of_the_sweep_are_those_of_the_problem(dim: int) -> None:
    muscle = {
        "fibres": {"kind": "constant", "direction": [1.0, 0.5, 0.2][:dim]},
        "max_isometric_stress": 2.0e5,
        "optimal_stretch": 1.1,
        "activation": 0.7,
    }
    data = scene({"b": body(block([1.0, 0.5, 0.5][:dim], [3, 2, 2][:dim]), material("neo_hookean"), muscle=muscle)})
    simulation = build(data)
    problem = simulation.problem
    problem.begin_step(simulation.state, 0.01)
    sweep = NodeSweep(problem)
    X = simulation.discretization.points
    x = X + 0.03 * np.random.default_rng(2).normal(size=X.shape)
    flat = sweep.flat(x)
    acc = np.zeros(9 * len(x))
    for color in range(sweep.n_colors):
        for part in (*sweep._parts, *sweep._fibres):
            part.add(color, flat, acc)
    forces = np.empty_like(x)
    forces[sweep.numbering.order] = acc.reshape(-1, 9)[:, :dim]
    (term,) = problem.elastic
    np.testing.assert_allclose(forces, -term_gradient(term, x), atol=1e-9 * np.abs(forces).max())
