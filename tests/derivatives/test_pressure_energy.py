"""Follower pressure: forces, work and tangent on open and closed surfaces, 2D and 3D, P1 and P2."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenario import (
    block,
    body,
    build,
    cell_matrices,
    difference_matrix,
    quasistatic,
    random_state,
    rotation,
    scene,
    term_gradient,
)

from femdeform.fem.energies import FollowerPressure
from femdeform.run.setup import Simulation

ELEMENTS = pytest.mark.parametrize(("dim", "order"), [(2, 1), (2, 2), (3, 1), (3, 2)])
P = 7.0


def pressed(dim: int, order: int, on: str) -> tuple[Simulation, FollowerPressure]:
    data = scene(
        {"b": body(block([2.0, 1.0, 0.5][:dim], [2, 1, 1][:dim]), element_order=order)},
        {"kind": "pressure", "on": on, "value": P},
        time=quasistatic(),
    )
    simulation = build(data)
    (term,) = simulation.problem.pressures
    term.set_time(1.0)
    return simulation, term


def assembled(term: FollowerPressure, x: Any) -> Any:
    K = np.zeros((x.size, x.size))
    dofs = (term.cells[:, :, None] * x.shape[1] + np.arange(x.shape[1])).reshape(len(term.cells), -1)
    for rows, matrix in zip(dofs, cell_matrices(term, x, False), strict=True):
        K[np.ix_(rows, rows)] += matrix
    return K


@ELEMENTS
def test_flat_patch(dim: int, order: int) -> None:
    simulation, term = pressed(dim, order, "b.right")
    x = simulation.discretization.points
    area = 1.0 if dim == 2 else 0.5
    force = -term_gradient(term, x)
    np.testing.assert_allclose(force.sum(axis=0), -P * area * np.eye(dim)[0], atol=1e-13)
    # Stretched and turned, it follows: p times the deformed area against the deformed normal.
    F = rotation(dim, 3) @ np.diag([1.1, 1.3, 0.9][:dim])
    normal = np.linalg.det(F) * np.linalg.inv(F).T @ np.eye(dim)[0]
    np.testing.assert_allclose(-term_gradient(term, x @ F.T).sum(axis=0), -P * area * normal, atol=1e-12)


@ELEMENTS
def test_force_follows_from_the_work_along_a_line(dim: int, order: int) -> None:
    simulation, term = pressed(dim, order, "b.right")
    rng = np.random.default_rng(1)
    x = random_state(simulation.discretization.points, 0.2, seed=1)
    d = rng.standard_normal(x.shape)
    term.set_reference(x)
    assert term.value(x) == 0.0
    for t in (0.0, 0.3, 1.0):
        slope = (term.value(x + (t + 1e-5) * d) - term.value(x + (t - 1e-5) * d)) / 2e-5
        assert slope == pytest.approx(float(np.vdot(term_gradient(term, x + t * d), d)), rel=1e-8)


@ELEMENTS
def test_tangent_is_the_symmetric_part(dim: int, order: int) -> None:
    simulation, term = pressed(dim, order, "b.top")
    x = random_state(simulation.discretization.points, 0.2, seed=2)
    K = difference_matrix(lambda y: term_gradient(term, y), x, 1e-5)
    # On an open surface the tangent is not symmetric: there is something to drop.
    assert np.abs(K - K.T).max() > 1e-2 * np.abs(K).max()
    np.testing.assert_allclose(assembled(term, x), 0.5 * (K + K.T), atol=1e-8 * np.abs(K).max())
    projected = cell_matrices(term, x, True)
    assert np.linalg.eigvalsh(projected).min() > -1e-12 * np.abs(projected).max()


@ELEMENTS
def test_closed_surface(dim: int, order: int) -> None:
    """Uniform pressure has no resultant and no moment, and its potential is p times the volume."""
    simulation, term = pressed(dim, order, "b.boundary")
    points = simulation.discretization.points
    x = random_state(points, 0.15, seed=3)
    force = -term_gradient(term, x)
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-12)
    moment = np.cross(x, force).sum(axis=0) if dim == 3 else float(x[:, 0] @ force[:, 1] - x[:, 1] @ force[:, 0])
    np.testing.assert_allclose(moment, 0.0, atol=1e-12)

    (group,) = simulation.discretization.groups
    rule = np.einsum("eac,eqak->eqck", x[group.cells], group.gradients)
    if order == 1:
        volume = float(np.vdot(group.weights, np.linalg.det(rule)))
        term.set_reference(points)
        before = float(group.weights.sum())
        assert term.value(x) == pytest.approx(P * (volume - before), rel=1e-12)
    K = difference_matrix(lambda y: term_gradient(term, y), x, 1e-5)
    np.testing.assert_allclose(assembled(term, x), K, atol=1e-8 * np.abs(K).max())


@pytest.mark.parametrize(("dim", "order"), [(2, 2), (3, 2)])
def test_work_on_quadratic_facets(dim: int, order: int) -> None:
    """The work on moved mid-edge nodes, by a rule of many points along the line."""
    simulation, term = pressed(dim, order, "b.boundary")
    points = simulation.discretization.points
    n_vertices = simulation.discretization.bodies["b"].n_vertices
    x = points.copy()
    x[n_vertices:] += 0.05 * np.random.default_rng(4).standard_normal(x[n_vertices:].shape)
    term.set_reference(points)
    t, w = np.polynomial.legendre.leggauss(6)
    d = x - points
    work = [np.vdot(term_gradient(term, points + 0.5 * (1.0 + ti) * d), d) for ti in t]
    assert term.value(x) == pytest.approx(0.5 * float(w @ work), rel=1e-12)


def test_amplitude_scales_the_pressure() -> None:
    data = scene(
        {"b": body(block([1.0, 1.0], [1, 1]))},
        {"kind": "pressure", "on": "b.top", "value": P, "amplitude": {"times": [0, 1, 2], "values": [0, 1, -1]}},
    )
    (term,) = build(data).problem.pressures
    for time, factor in ((0.0, 0.0), (0.25, 0.25), (1.0, 1.0), (1.75, -0.5), (9.0, -1.0)):
        term.set_time(time)
        assert term.pressure == pytest.approx(factor * P, abs=1e-14)
