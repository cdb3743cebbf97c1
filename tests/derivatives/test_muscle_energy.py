"""Fibres of cells: energy, forces and Hessian of a body with muscles against finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from scenario import (
    block,
    body,
    build,
    cell_matrices,
    difference_gradient,
    difference_matrix,
    material,
    quasistatic,
    scene,
    term_gradient,
)

from femdeform.fem.fields import cell_field, deformation_gradients
from femdeform.materials import batch, muscle_fibre
from femdeform.run.setup import Simulation

ELEMENTS = pytest.mark.parametrize(("dim", "order"), [(2, 1), (2, 2), (3, 1), (3, 2)])
DIRECTION = [1.0, 0.4, -0.3]


def muscle(dim: int, activation: object = 0.8) -> dict[str, object]:
    return {
        "fibres": {"kind": "constant", "direction": DIRECTION[:dim]},
        "max_isometric_stress": 2.0e5,
        "optimal_stretch": 1.1,
        "activation": activation,
    }


def bar(dim: int, order: int = 1, **more: object) -> Simulation:
    mesh = block([1.0, 0.5, 0.5][:dim], [2, 1, 1][:dim])
    return build(scene({"b": body(mesh, material("neo_hookean"), element_order=order, muscle=muscle(dim), **more)}))


def bent(simulation: Simulation) -> np.ndarray:
    """Nodes moved at random; stretches of fibres reach from 0.6 to 1.5."""
    X = simulation.discretization.points
    return X * 1.05 + 0.12 * np.random.default_rng(3).normal(size=X.shape)


@ELEMENTS
def test_forces_are_derivatives_of_the_energy(dim: int, order: int) -> None:
    simulation = bar(dim, order)
    (term,) = simulation.problem.elastic
    x = bent(simulation)
    difference = difference_gradient(term.value, x, 1e-6)
    gradient = term_gradient(term, x)
    assert np.abs(gradient - difference).max() < 1e-6 * np.abs(gradient).max()


@ELEMENTS
def test_hessian_is_derivative_of_the_forces(dim: int, order: int) -> None:
    simulation = bar(dim, order)
    (term,) = simulation.problem.elastic
    x = bent(simulation)
    n, d = x.shape
    cells = term.cells
    full = np.zeros((n * d, n * d))
    dofs = (d * cells[:, :, None] + np.arange(d)).reshape(len(cells), -1)
    for matrix, rows in zip(cell_matrices(term, x, False), dofs, strict=True):
        full[np.ix_(rows, rows)] += matrix
    difference = difference_matrix(lambda y: term_gradient(term, y), x, 1e-6)
    assert np.abs(full - difference).max() < 1e-5 * np.abs(full).max()


@pytest.mark.parametrize("dim", [2, 3])
def test_projected_cells_are_semi_definite(dim: int) -> None:
    simulation = bar(dim)
    (term,) = simulation.problem.elastic
    X = simulation.discretization.points
    x = X * 1.3  # longer than optimal: active fibres soften
    exact, projected = (np.linalg.eigvalsh(cell_matrices(term, x, flag)) for flag in (False, True))
    assert projected.min() > -1e-9 * projected.max()
    assert (projected.sum(axis=1) > exact.sum(axis=1)).all()


@pytest.mark.parametrize("dim", [2, 3])
def test_cells_are_those_of_the_law(dim: int) -> None:
    """Energy and stress of cells are those of matrix and fibres at the cells' F."""
    simulation = bar(dim)
    (term,) = simulation.problem.elastic
    group, x = term.group, bent(simulation)
    F = deformation_gradients(group, x)[:, 0]
    v = np.tile(DIRECTION[:dim], (len(F), 1))
    law = muscle_fibre.MuscleFibre(2.0e5, 1.1, 0.8)
    density = batch.energy_density(F, group.law) + muscle_fibre.energy_density(F, v, law)
    np.testing.assert_allclose(cell_field("energy_density", term, x), density, rtol=1e-10)
    P = batch.pk1(F, group.law) + muscle_fibre.pk1(F, v, law)
    found = cell_field("pk1", term, x).reshape(-1, 3, 3)[:, :dim, :dim]
    np.testing.assert_allclose(found, P, rtol=1e-10, atol=1e-6)


def test_activation_over_time() -> None:
    table = {"times": [1.0, 3.0], "values": [0.0, 1.0]}
    data = scene({"b": body(block([1.0, 1.0], [1, 1]), muscle=muscle(2, table))}, time=quasistatic(1.0, 4.0))
    simulation = build(data)
    (term,) = simulation.problem.elastic
    X = simulation.discretization.points
    forces = []
    for time in (0.0, 1.0, 2.0, 3.0, 4.0):
        simulation.problem.set_loads(time)
        forces.append(np.linalg.norm(term_gradient(term, X)))
    assert forces[:2] == [pytest.approx(0.0, abs=1e-6)] * 2
    assert forces[2] == pytest.approx(0.5 * forces[3])
    assert forces[4] == forces[3] > 0.0


def test_muscles_of_groups_pull_for_themselves(tmp_path: object) -> None:
    """Two cell groups with activations of their own; cells outside have no fibres."""
    from pathlib import Path

    points = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0], [0.0, 1.0], [1.0, 1.0], [2.0, 1.0], [3.0, 1.0]])
    quads = [(i, i + 1, i + 5, i + 4) for i in range(3)]
    cells = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    path = Path(str(tmp_path)) / "strip.npz"
    np.savez(path, points=points, triangles=cells, one=np.array([0, 1]), two=np.array([4, 5]))
    muscles = {"one": muscle(2, 0.5), "two": muscle(2, 1.0)}
    data = scene({"b": {"mesh": {"file": str(path)}, "material": material(), "muscles": muscles}})
    simulation = build(data)
    (term,) = simulation.problem.elastic
    simulation.problem.set_loads(0.0)
    P = cell_field("pk1", term, simulation.discretization.points).reshape(-1, 3, 3)
    size = np.linalg.norm(P, axis=(1, 2))
    assert size[:2] == pytest.approx(0.5 * size[4:])
    assert size[2:4] == pytest.approx(0.0, abs=1e-9)
    assert size[4] > 1e4
