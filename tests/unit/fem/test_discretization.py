"""Nodes, gradients, quadrature, masses; selections on quadratic bodies; regions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenario import block, body, build, material, quasistatic, scene

from femdeform.errors import InputError
from femdeform.fem.discretization import node_connectivity
from femdeform.fem.fields import cell_field, deformation_gradients, jacobians, volumes
from femdeform.run.setup import Simulation

ELEMENTS = pytest.mark.parametrize(("dim", "order"), [(2, 1), (2, 2), (3, 1), (3, 2)])


def box(dim: int, order: int, *conditions: dict[str, Any], **more: Any) -> Simulation:
    return build(
        scene({"b": body(block([2.0, 1.0, 1.5][:dim], [2, 2, 1][:dim]), element_order=order, **more)}, *conditions)
    )


@ELEMENTS
def test_gradients_reproduce_polynomials(dim: int, order: int) -> None:
    """The gradient of a field of the element's own degree is exact at every quadrature point."""
    simulation = box(dim, order)
    (group,) = simulation.discretization.groups
    X = simulation.discretization.points
    rng = np.random.default_rng(0)
    A, Q = rng.standard_normal((dim, dim)), rng.standard_normal((dim, dim, dim))
    field = X @ A.T + (np.einsum("cij,ni,nj->nc", Q, X, X) if order == 2 else 0.0)
    gradient = deformation_gradients(group, field)
    if order == 2:
        # The gradient is linear, so its mean is that at the centroid.
        centroid = X[group.cells[:, : dim + 1]].mean(axis=1)
        mean = np.einsum("eq,eqck->eck", group.weights, gradient) / group.weights.sum(axis=1)[:, None, None]
        exact = A + np.einsum("cij,ej->eci", Q + np.swapaxes(Q, 1, 2), centroid)
        np.testing.assert_allclose(mean, exact, atol=1e-12)
    else:
        np.testing.assert_allclose(gradient, np.broadcast_to(A, gradient.shape), atol=1e-12)
    np.testing.assert_allclose(group.gradients.sum(axis=2), 0.0, atol=1e-12)
    assert group.weights.sum() == pytest.approx(np.prod([2.0, 1.0, 1.5][:dim]), rel=1e-13)
    assert group.weights.min() > 0.0


@ELEMENTS
def test_nodes(dim: int, order: int) -> None:
    simulation = box(dim, order)
    place = simulation.discretization.bodies["b"]
    mesh = simulation.meshes["b"]
    X = simulation.discretization.points
    np.testing.assert_array_equal(X[: mesh.n_points], mesh.points)
    assert len(np.unique(np.round(X, 9), axis=0)) == len(X)
    if order == 2:
        # On this grid the mid-edge nodes are the points half way between vertices that share a cell.
        points, connectivity = node_connectivity(mesh, 2)
        pairs = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)][: 3 if dim == 2 else 6]
        for k, (a, b) in enumerate(pairs):
            middle = 0.5 * (points[connectivity[:, a]] + points[connectivity[:, b]])
            np.testing.assert_allclose(points[connectivity[:, dim + 1 + k]], middle, atol=1e-15)
        assert place.n_nodes > place.n_vertices


@pytest.mark.parametrize("dim", [2, 3])
def test_quadratic_mass_integrates_products_of_quadratic_fields(dim: int) -> None:
    simulation = box(dim, 2, mass="consistent")
    M = simulation.discretization.consistent_mass.toarray()
    X = simulation.discretization.points
    f, g = X[:, 0] ** 2, X[:, 1] * X[:, 0] + 1.0
    depth = 1.0 if dim == 2 else 1.5
    # integral over [0,2]x[0,1] of x^2 (x y + 1), times the density
    assert f @ M @ g == pytest.approx(1000.0 * depth * (4.0 * 0.5 + 8.0 / 3.0), rel=1e-12)
    np.testing.assert_allclose(M, M.T, atol=1e-12 * M.max())
    assert np.linalg.eigvalsh(M).min() > 0.0


def test_lumped_masses() -> None:
    for order in (1, 2):
        mass = box(3, order).discretization.lumped_mass
        assert mass.min() > 0.0
        assert mass.sum() == pytest.approx(3000.0, rel=1e-13)
    simulation = box(2, 1, mass="consistent")
    discretization = simulation.discretization
    np.testing.assert_allclose(
        np.asarray(discretization.consistent_mass.sum(axis=1)).ravel(), discretization.lumped_mass, rtol=1e-13
    )


def test_lumped_and_consistent_bodies_share_a_scene() -> None:
    data = scene(
        {
            "a": body(block([1, 1], [1, 1]), mass="consistent"),
            "b": body(block([1, 1], [1, 1], translate=[3, 0]), mass="lumped"),
        }
    )
    discretization = build(data).discretization
    M = discretization.consistent_mass.toarray()
    b = discretization.bodies["b"]
    own = slice(b.first, b.first + b.n_nodes)
    np.testing.assert_allclose(M[own, own], np.diag(discretization.lumped_mass[own]))
    assert np.all(M[: b.first, own] == 0.0)
    assert M.sum() == pytest.approx(2000.0, rel=1e-13)


# ------------------------------------------------------------------------------------------- patch test


@ELEMENTS
def test_patch(dim: int, order: int) -> None:
    """x = A X + b on the boundary of an irregular mesh gives F = A in every element."""
    mesh = (
        {"recipe": "beam", "size": [1.0, 0.6, 0.8], "element_size": 0.5}
        if dim == 3
        else {"recipe": "plate_with_hole", "size": [1.0, 1.0], "radius": 0.2, "element_size": 0.3}
    )
    A = np.eye(dim) + 0.3 * np.random.default_rng(1).standard_normal((dim, dim))
    data = scene({"b": body(mesh, element_order=order)}, {"kind": "fixed", "on": "b.boundary"}, time=quasistatic())
    simulation = build(data)
    problem, X = simulation.problem, simulation.discretization.points
    target = X @ A.T + 0.5

    def set_prescribed(time: float, x: Any) -> None:
        x[~problem.free] = target[~problem.free]

    simulation.conditions.set_prescribed = set_prescribed  # type: ignore[method-assign]
    assert problem.free.any()
    problem.begin_step(simulation.state, 1.0)
    result = simulation.solver.step(problem, simulation.state)
    assert result.converged, result.reason
    np.testing.assert_allclose(result.x, target, atol=1e-10)
    for group in simulation.discretization.groups:
        np.testing.assert_allclose(
            deformation_gradients(group, result.x), np.broadcast_to(A, (*group.weights.shape, dim, dim)), atol=1e-9
        )


# ------------------------------------------------------------------------------------------- selections


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize(
    ("selection", "inside"),
    [
        ({"plane": {"point": [1.0, 0.0, 0.0], "normal": [-3.0, 0.0, 0.0]}}, lambda X: np.abs(X[:, 0] - 1.0) < 1e-9),
        ({"box": [[0.9, -1.0, -1.0], [3.0, 0.6, 3.0]]}, lambda X: (X[:, 0] > 0.9) & (X[:, 1] < 0.6)),
        ("b.left", lambda X: X[:, 0] == 0.0),
        ("b.boundary", lambda X: X[:, 0] > -1.0),
        ("b", lambda X: X[:, 0] > -1.0),
    ],
    ids=["plane", "box", "group", "boundary", "all"],
)
def test_selections_take_the_mid_edge_nodes_along(dim: int, selection: Any, inside: Any) -> None:
    if isinstance(selection, dict):
        ((kind, value),) = selection.items()
        if kind == "box":
            selection = {"box": [corner[:dim] for corner in value]}
        else:
            selection = {"plane": {k: v[:dim] for k, v in value.items()}}
    simulation = box(dim, 2, {"kind": "fixed", "on": selection})
    X = simulation.discretization.points
    (motion,) = simulation.conditions.motions
    wanted = inside(X)
    if selection == "b.boundary":
        low, high = X.min(axis=0), X.max(axis=0)
        wanted = ((low == X) | (high == X)).any(axis=1)
    n_vertices = simulation.discretization.bodies["b"].n_vertices
    if isinstance(selection, dict) and "box" in selection:
        # An edge half inside has its middle inside, but one of its ends outside: it is not taken.
        assert np.isin(motion.nodes, np.flatnonzero(wanted)).all()
        np.testing.assert_array_equal(motion.nodes[motion.nodes < n_vertices], np.flatnonzero(wanted[:n_vertices]))
    else:
        np.testing.assert_array_equal(np.sort(motion.nodes), np.flatnonzero(wanted))
    assert (motion.nodes >= n_vertices).any()


def test_sphere_and_node_selections_on_a_quadratic_body() -> None:
    sphere = {"sphere": {"center": [2.0, 0.0, 0.0], "radius": 1.2}}
    simulation = box(3, 2, {"kind": "fixed", "on": sphere})
    (motion,) = simulation.conditions.motions
    assert np.all(np.linalg.norm(motion.reference - [2.0, 0.0, 0.0], axis=1) <= 1.2 + 1e-9)
    assert (motion.nodes >= simulation.discretization.bodies["b"].n_vertices).any()

    mesh = simulation.meshes["b"]
    a, b = mesh.cells[0, 0], mesh.cells[0, 1]
    simulation = box(3, 2, {"kind": "fixed", "on": {"nodes": [int(a), int(b)]}})
    (motion,) = simulation.conditions.motions
    expected = [mesh.points[a], mesh.points[b], 0.5 * (mesh.points[a] + mesh.points[b])]
    np.testing.assert_allclose(motion.reference, expected, atol=1e-15)


def test_a_selection_reaches_every_body_unless_restricted() -> None:
    bodies = {
        "a": body(block([1, 1], [1, 1])),
        "b": body(block([1, 1], [1, 1], translate=[3, 0]), element_order=2),
    }
    ground = {"plane": {"point": [0.0, 0.0], "normal": [0.0, 1.0]}}
    (motion,) = build(scene(bodies, {"kind": "fixed", "on": ground})).conditions.motions
    assert sorted(motion.reference[:, 0]) == [0.0, 1.0, 3.0, 3.5, 4.0]
    (motion,) = build(scene(bodies, {"kind": "fixed", "on": {**ground, "body": "b"}})).conditions.motions
    assert sorted(motion.reference[:, 0]) == [3.0, 3.5, 4.0]


# ------------------------------------------------------------------------------------------- regions


def mount(**rest: Any) -> dict[str, Any]:
    """The smallest body of several parts: the rubber mount."""
    mesh = {"recipe": "rubber_mount", "element_size": 0.012, "bore_radius": 0.0, "bolt_hole_radius": 0.0}
    return {"mesh": mesh, **rest}


def test_regions_have_materials_of_their_own() -> None:
    rubber = material(E=2e6, nu=0.4, density=1100.0)
    steel = material("stable_neo_hookean", E=2e11, density=7850.0)
    data = scene({"m": mount(regions={"rubber": rubber}, material=steel)})
    simulation = build(data)
    mesh = simulation.meshes["m"]
    groups = {type(g.law).__name__: g for g in simulation.discretization.groups}
    assert set(groups) == {"NeoHookean", "StableNeoHookean"}
    np.testing.assert_array_equal(groups["NeoHookean"].cell_ids, np.sort(mesh.cell_groups["rubber"]))
    covered = np.concatenate([g.cell_ids for g in groups.values()])
    np.testing.assert_array_equal(np.sort(covered), np.arange(mesh.n_cells))
    expected = 1100.0 * groups["NeoHookean"].weights.sum() + 7850.0 * groups["StableNeoHookean"].weights.sum()
    assert simulation.discretization.lumped_mass.sum() == pytest.approx(expected, rel=1e-12)


def test_regions_that_leave_cells_out_are_an_error() -> None:
    data = scene({"m": mount(regions={"rubber": material()})})
    with pytest.raises(InputError, match=r"without a material|no material"):
        build(data)


# ------------------------------------------------------------------------------------------- fields


@ELEMENTS
def test_fields_of_a_uniform_state(dim: int, order: int) -> None:
    """One linear map of the body: every cell has the values of that map, by the formulas of the law."""
    simulation = box(dim, order)
    (term,) = simulation.problem.elastic
    A = np.eye(dim) + 0.2 * np.random.default_rng(3).standard_normal((dim, dim))
    x = simulation.discretization.points @ A.T
    J = np.linalg.det(A)
    np.testing.assert_allclose(cell_field("jacobian", term, x), J, rtol=1e-12)
    np.testing.assert_allclose(jacobians(term.group, x), J, rtol=1e-12)
    P = cell_field("pk1", term, x).reshape(-1, 3, 3)
    sigma = cell_field("cauchy_stress", term, x).reshape(-1, 3, 3)
    np.testing.assert_allclose(P[:, :dim, :dim], np.broadcast_to(P[0, :dim, :dim], (len(P), dim, dim)), rtol=1e-9)
    np.testing.assert_allclose(sigma[0, :dim, :dim], P[0, :dim, :dim] @ A.T / J, rtol=1e-12)
    np.testing.assert_allclose(sigma[0], sigma[0].T, atol=1e-9 * np.abs(sigma).max())
    reference, deformed, smallest = volumes(simulation.discretization.groups, x)
    assert deformed / reference == pytest.approx(J, rel=1e-12)
    assert smallest == pytest.approx(J, rel=1e-12)
    density = cell_field("energy_density", term, x)
    assert density * term.group.weights.sum(axis=1) == pytest.approx(term.cell_energies(x))
    if dim == 3:
        s = sigma[0] - np.trace(sigma[0]) / 3.0 * np.eye(3)
        np.testing.assert_allclose(cell_field("von_mises", term, x), np.sqrt(1.5 * np.sum(s * s)), rtol=1e-9)


def test_von_mises_in_uniaxial_strain_of_a_plane_body() -> None:
    """Small plane strain: s_zz = nu (s_xx + s_yy) enters, and the three stresses differ by 2 mu strain."""
    simulation = box(2, 1)
    (term,) = simulation.problem.elastic
    strain, mu = 1e-6, 1e5 / 2.6
    x = simulation.discretization.points * [1.0 + strain, 1.0]
    np.testing.assert_allclose(cell_field("von_mises", term, x), 2 * mu * strain, rtol=1e-4)


def test_membranes_have_areas_and_no_stress() -> None:
    data = scene({"c": body({"recipe": "cloth", "cells": [2, 2]}, kind="membrane", thickness=0.01)})
    simulation = build(data)
    (term,) = simulation.problem.elastic
    x = simulation.discretization.points * [1.2, 1.0, 0.5]
    np.testing.assert_allclose(cell_field("jacobian", term, x), 0.6, rtol=1e-12)
    assert np.isnan(cell_field("von_mises", term, x)).all()
    reference, deformed, _ = volumes(simulation.discretization.groups, x)
    assert deformed / reference == pytest.approx(0.6, rel=1e-12)
