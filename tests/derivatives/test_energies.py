"""Elastic energy of solids, inertia and the whole incremental potential against finite differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenario import (
    block,
    body,
    build,
    cell_matrices,
    dense_hessian,
    difference_gradient,
    difference_matrix,
    material,
    quasistatic,
    random_state,
    scene,
    term_gradient,
)

from femdeform.run.setup import Simulation

ELEMENTS = pytest.mark.parametrize(("dim", "order"), [(2, 1), (2, 2), (3, 1), (3, 2)])
SOFT = material(E=100.0, nu=0.35, density=10.0)


def one_body(dim: int, order: int, law: str = "neo_hookean", **more: Any) -> Simulation:
    cells = [2, 1] if dim == 2 else [1, 1, 1]
    stuff = {**SOFT, "law": law}
    return build(scene({"b": body(block([1.0] * dim, cells), stuff, element_order=order, **more)}))


def relative(a: Any, b: Any) -> float:
    return float(np.abs(a - b).max() / np.abs(b).max())


# ------------------------------------------------------------------------------------------- elastic energy


@ELEMENTS
@pytest.mark.parametrize("amplitude", [0.05, 0.6])  # 0.6 turns cells inside out
def test_elastic_forces_and_tangent(dim: int, order: int, amplitude: float) -> None:
    simulation = one_body(dim, order)
    (term,) = simulation.problem.elastic
    x = random_state(simulation.discretization.points, amplitude, seed=dim + order)
    if amplitude > 0.5:
        assert np.linalg.det(np.einsum("eac,eqak->eqck", x[term.cells], term.group.gradients)).min() < 0.0
    g = term_gradient(term, x)
    assert relative(g, difference_gradient(term.value, x, 1e-5)) < 1e-7

    problem = build_quasistatic(dim, order).problem
    problem.begin_step(simulation.state, 1.0)
    K = dense_hessian(problem, x, project=False)
    assert relative(K, difference_matrix(lambda y: term_gradient(term, y), x, 1e-5)) < 1e-7
    np.testing.assert_allclose(K, K.T, rtol=0.0, atol=1e-12 * np.abs(K).max())


def build_quasistatic(dim: int, order: int) -> Simulation:
    cells = [2, 1] if dim == 2 else [1, 1, 1]
    return build(scene({"b": body(block([1.0] * dim, cells), SOFT, element_order=order)}, time=quasistatic()))


@ELEMENTS
def test_projected_tangent_is_positive_and_above_the_exact_one(dim: int, order: int) -> None:
    simulation = one_body(dim, order)
    (term,) = simulation.problem.elastic
    points = simulation.discretization.points
    for amplitude in (0.1, 0.8):
        x = random_state(0.5 * points, amplitude, seed=5)
        exact, projected = cell_matrices(term, x, False), cell_matrices(term, x, True)
        scale = np.abs(exact).max()
        assert np.linalg.eigvalsh(exact).min() < -1e-2 * scale  # else there is nothing to project
        assert np.linalg.eigvalsh(projected).min() > -1e-12 * scale
        # Clamping only adds: the difference is positive semi-definite too.
        assert np.linalg.eigvalsh(projected - exact).min() > -1e-12 * scale


@ELEMENTS
def test_projection_leaves_the_rest_state_alone(dim: int, order: int) -> None:
    simulation = one_body(dim, order)
    (term,) = simulation.problem.elastic
    points = simulation.discretization.points
    np.testing.assert_allclose(
        cell_matrices(term, points, True), cell_matrices(term, points, False), atol=1e-10 * SOFT["youngs_modulus"]
    )
    # Its null space is the infinitesimal rigid motions and nothing else.
    K = dense_hessian(build_quasistatic(dim, order).problem, points, project=True)
    zero = np.linalg.eigvalsh(K) < 1e-10 * np.abs(K).max()
    assert np.count_nonzero(zero) == (3 if dim == 2 else 6)


# ------------------------------------------------------------------------------------------- inertia


@ELEMENTS
@pytest.mark.parametrize("mass", ["lumped", "consistent"])
def test_inertia(dim: int, order: int, mass: str) -> None:
    """Phi without elasticity is the quadratic form of the mass matrix about x_hat."""
    simulation = one_body(dim, order, mass=mass)
    problem, state = simulation.problem, simulation.state
    rng = np.random.default_rng(2)
    state.v[:] = rng.standard_normal(state.v.shape)
    problem.begin_step(state, 0.02)
    x = random_state(state.x, 0.01, seed=4)

    def inertia_gradient(y: Any) -> Any:
        return problem.full_gradient(y) - problem.internal_forces(y)

    assert (
        relative(
            inertia_gradient(x),
            difference_gradient(lambda y: problem.value(y) - problem.elastic_energy(y), x, 1e-4),
        )
        < 1e-8
    )
    M = difference_matrix(inertia_gradient, x, 1e-2) * 0.02**2
    elastic = dense_hessian(build_quasistatic(dim, order).problem, x, project=False)
    np.testing.assert_allclose(
        dense_hessian(problem, x, project=False) * 0.02**2 - elastic * 0.02**2, M, atol=1e-10 * np.abs(M).max()
    )
    # The mass of the body, once for each component, and positive.
    n, d = x.shape
    ones = np.tile(np.eye(d), (n, 1))
    np.testing.assert_allclose(ones.T @ M @ ones, 10.0 * np.eye(d), rtol=0.0, atol=1e-8)
    assert np.linalg.eigvalsh(0.5 * (M + M.T)).min() > 0.0
    if mass == "lumped":
        np.testing.assert_allclose(M, np.diag(np.diag(M)), atol=1e-9)
    else:
        # A consistent mass integrates quadratic fields exactly: here the square of x + 1, so x^2 + 2x + 1.
        field = np.zeros((n, d))
        field[:, 0] = state.x[:, 0] + 1.0
        assert field.ravel() @ M @ field.ravel() == pytest.approx(10.0 * (1.0 / 3.0 + 1.0 + 1.0), rel=1e-9)


# ------------------------------------------------------------------------------------------- the whole


def several_bodies() -> dict[str, Any]:
    """Solids of both orders and masses, a membrane and a rod, with supports, loads, contact and friction."""
    cloth = {"recipe": "cloth", "size": [1.0, 1.0], "cells": [1, 1], "translate": [0.0, 1.5, 0.0]}
    rod = {"recipe": "rod", "start": [0.0, 1.2, 0.0], "end": [0.0, 1.2, 1.0], "cells": 2}
    return scene(
        {
            "a": body(block([1, 1, 1], [1, 1, 1]), SOFT, mass="consistent"),
            "b": body(block([1, 1, 1], [1, 1, 1], translate=[2.0, 0.0, 0.0]), SOFT, element_order=2),
            "cloth": body(cloth, SOFT, kind="membrane", thickness=0.1, mass="consistent"),
            "rod": body(rod, SOFT, kind="rod", cross_section=0.05),
        },
        {"kind": "fixed", "on": "a.left"},
        {"kind": "fixed", "on": "b.top", "components": ["y"]},
        {"kind": "translate", "on": "rod.start", "velocity": [0.1, 0.0, 0.2]},
        {"kind": "traction", "on": "b.right", "value": [3.0, -1.0, 2.0]},
        {"kind": "pressure", "on": "b.boundary", "value": 5.0},
        {"kind": "point_load", "on": "cloth", "force": [0.0, -0.3, 0.1]},
        gravity=[0.3, -9.81, 0.1],
        obstacles=[
            {"kind": "plane", "point": [0, 0.05, 0], "normal": [0.1, 1, 0], "stiffness": 300.0, "friction": 0.4},
            {"kind": "sphere", "center": [0.5, 0.5, 0.5], "radius": 0.8, "stiffness": 200.0, "inside": True},
        ],
        time={"scheme": "backward_euler", "dt": 0.1, "end": 1.0},
    )


def test_whole_potential() -> None:
    simulation = build(several_bodies())
    problem, state = simulation.problem, simulation.state
    state.v[:] = 0.2 * np.random.default_rng(1).standard_normal(state.v.shape)
    problem.begin_step(state, 0.1)
    x = random_state(problem.initial_guess(state), 0.03, seed=8)
    problem.linearize_at(x)

    full = problem.full_gradient(x)
    assert relative(full, difference_gradient(problem.value, x, 1e-5)) < 1e-7
    g = problem.gradient(x)
    assert not problem.free.all()
    assert np.all(g[~problem.free] == 0.0)
    np.testing.assert_array_equal(g[problem.free], full[problem.free])

    # The surface of body b is closed: its pressure has a potential, and its tangent is symmetric once summed.
    K = dense_hessian(problem, x, project=False, everything=True)
    assert relative(K, difference_matrix(problem.full_gradient, x, 1e-5)) < 1e-6

    free = problem.free.ravel()
    reduced = dense_hessian(problem, x, project=False)
    np.testing.assert_array_equal(reduced[np.ix_(free, free)], K[np.ix_(free, free)])
    held = reduced[~free]
    held[:, ~free] -= np.diag(np.diag(reduced)[~free])
    assert np.all(held == 0.0)
    assert np.all(reduced[:, ~free][free] == 0.0)


def test_product_with_the_projected_hessian() -> None:
    simulation = build(several_bodies())
    problem, state = simulation.problem, simulation.state
    problem.begin_step(state, 0.1)
    x = random_state(state.x, 0.03, seed=9)
    d = np.random.default_rng(3).standard_normal(x.shape)
    K = dense_hessian(problem, x, project=True, everything=True)
    np.testing.assert_allclose(problem.hessian_times(x, d).ravel(), K @ d.ravel(), atol=1e-10 * np.abs(K).max())
    assert np.linalg.eigvalsh(dense_hessian(problem, x, project=True)).min() > 0.0


def test_quasistatic_potential_has_no_inertia() -> None:
    data = several_bodies()
    data["time"] = quasistatic()
    simulation = build(data)
    problem, state = simulation.problem, simulation.state
    state.v[:] = 1.0
    problem.begin_step(state, 1.0)
    x = random_state(state.x, 0.03, seed=10)
    problem.linearize_at(x)
    assert relative(problem.full_gradient(x), difference_gradient(problem.value, x, 1e-5)) < 1e-7
    mass = simulation.discretization.row_mass
    load = simulation.problem.load.sum(axis=0)
    # Gravity at full size at the end of the ramp, the traction and the point load.
    expected = mass.sum() * np.array([0.3, -9.81, 0.1]) + np.array([3.0, -1.3, 2.1])
    np.testing.assert_allclose(load, expected, rtol=1e-12)


def test_force_scale_is_the_sum_of_the_forces_of_the_step() -> None:
    simulation = build(several_bodies())
    problem, state = simulation.problem, simulation.state
    state.v[:] = 0.5
    problem.begin_step(state, 0.1)
    inertia = problem.full_gradient(state.x) + problem.load - problem.internal_forces(state.x)
    expected = np.linalg.norm(inertia) + np.linalg.norm(problem.internal_forces(state.x)) + np.linalg.norm(problem.load)
    assert problem.force_scale == pytest.approx(expected, rel=1e-12)
