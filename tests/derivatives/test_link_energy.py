"""Links of every kind: energies, forces and Hessians against finite differences, in 2D and 3D."""

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
    quasistatic,
    random_state,
    scene,
    term_gradient,
)

from femdeform.run.setup import Simulation

KINDS = [
    "pair",
    "pair-directed",
    "pair-in-space",
    "spring",
    "spring-compressed",
    "spring-in-space",
    "spring-without-length",
    "attachment",
    "attachment-to-a-point",
    "tie",
    "tie-with-normals",
    "tie-closed",
    "binding",
]


def in_space(dim: int, *values: float) -> list[float]:
    return [float(v) for v in (*values, 0.13, 0.07)[:dim]]


def link(kind: str, dim: int) -> dict[str, Any]:
    a, b = {"at": in_space(dim, 0.31), "body": "a"}, {"at": in_space(dim, 1.45), "body": "b"}
    fixed = {"at": in_space(dim, -0.5), "fixed": True}
    moving = {"at": in_space(dim, -0.5), "obstacle": 0}
    axis = [0.3, -1.0, 0.5][:dim]
    surfaces = {"on": "b.left", "to": "a.right", "max_distance": 0.2}
    return {
        "pair": {"kind": "pair", "ends": [a, b], "stiffness": 3.0},
        "pair-directed": {
            "kind": "pair",
            "ends": [a, b],
            "stiffness": 3.0,
            "tangential_stiffness": 0.5,
            "direction": axis,
            "offset": axis,
        },
        "pair-in-space": {"kind": "pair", "ends": [moving, b], "stiffness": 2.0, "gap": "kept"},
        "spring": {"kind": "spring", "ends": [a, b], "stiffness": 3.0, "length": 0.4},
        "spring-compressed": {"kind": "spring", "ends": [a, b], "stiffness": 3.0, "length": 3.0},
        "spring-in-space": {"kind": "spring", "ends": [a, fixed], "stiffness": 3.0},
        "spring-without-length": {"kind": "spring", "ends": [a, b], "stiffness": 3.0, "length": 0.0},
        "attachment": {"kind": "attachment", "on": "a.left", "stiffness": 5.0, "velocity": axis},
        "attachment-to-a-point": {
            "kind": "attachment",
            "on": "a.left",
            "stiffness": 5.0,
            "per": "area",
            "to": in_space(dim, -0.4),
            "tangential_stiffness": 1.0,
            "direction": axis,
        },
        "tie": {"kind": "tie", "stiffness": 4.0, **surfaces},
        "tie-with-normals": {"kind": "tie", "stiffness": 4.0, "tangential_stiffness": 0.2, "per": "area", **surfaces},
        "tie-closed": {"kind": "tie", "stiffness": 4.0, "gap": "closed", **surfaces},
        "binding": {"kind": "binding", "stiffness": 40.0, "within": 0.12, "on": "b.left", "to": "a"},
    }[kind]


def linked(kind: str, dim: int, order: int = 1) -> Simulation:
    """Two blocks a gap apart, whose meshes do not match, with one link between them or to space."""
    first = body(block([1.0, 0.5, 0.4][:dim], [2, 2, 1][:dim]), element_order=order)
    second = body(
        block([0.6, 0.5, 0.4][:dim], [1, 3, 2][:dim], translate=[1.1, 0.03, -0.02][:dim]), element_order=order
    )
    obstacle = {"kind": "sphere", "center": [9.0] * dim, "radius": 0.1, "velocity": [0.2] * dim}
    simulation = build(
        scene({"a": first, "b": second}, links={"l": link(kind, dim)}, obstacles=[obstacle], time=quasistatic())
    )
    start = random_state(simulation.discretization.points, 0.02, seed=3)
    assert simulation.problem.links is not None
    simulation.problem.links.begin_step(start, 0.7)
    return simulation


CASES = pytest.mark.parametrize(("kind", "dim"), [(kind, dim) for kind in KINDS for dim in (2, 3)])


@CASES
@pytest.mark.parametrize("order", [1, 2])
def test_gradient_and_hessian(kind: str, dim: int, order: int) -> None:
    simulation = linked(kind, dim, order)
    links = simulation.problem.links
    assert links is not None
    x = random_state(simulation.discretization.points, 0.05, seed=1)
    assert links.energy(x) > 0.0
    assert links.energy(x) == pytest.approx(sum(term.value(x) for term in links.terms), rel=1e-14)
    for term in links.terms:
        nodes = np.unique(term.cells)

        def place(y: Any, nodes: Any = nodes) -> Any:
            z = x.copy()
            z[nodes] = y
            return z

        slope = term_gradient(term, x)
        size = np.abs(slope).max()
        assert size > 0.0
        expected = difference_gradient(lambda y, t=term, p=place: t.value(p(y)), x[nodes], 1e-5)
        np.testing.assert_allclose(slope[nodes], expected, atol=1e-8 * max(size, 1.0))
        exact = _assembled(term, x, nodes, project=False)
        differences = difference_matrix(lambda y, t=term, p=place, n=nodes: term_gradient(t, p(y))[n], x[nodes], 1e-5)
        np.testing.assert_allclose(exact, differences, atol=1e-7 * np.abs(exact).max())
        projected = cell_matrices(term, x, project=True)
        values = np.linalg.eigvalsh(projected)
        assert values.min() >= -1e-12 * values.max()
        if kind == "spring-compressed":
            assert np.linalg.eigvalsh(cell_matrices(term, x, project=False)).min() < -0.1
        elif kind != "spring-in-space":  # that one is a little shorter or longer than at rest
            np.testing.assert_allclose(projected, cell_matrices(term, x, project=False), atol=1e-12)


def _assembled(term: Any, x: Any, nodes: Any, project: bool) -> Any:
    dim = x.shape[1]
    total = np.zeros((nodes.size, dim, nodes.size, dim))
    k = term.cells.shape[1]
    place = np.searchsorted(nodes, term.cells)
    for cell, matrix in zip(place, cell_matrices(term, x, project), strict=True):
        total[np.ix_(cell, range(dim), cell, range(dim))] += matrix.reshape(k, dim, k, dim)
    return total.reshape(nodes.size * dim, -1)


@CASES
def test_the_step_problem_holds_the_links(kind: str, dim: int) -> None:
    """Value, gradient and Hessian of the whole problem: links couple nodes that share no cell."""
    simulation = linked(kind, dim)
    problem = simulation.problem
    problem.begin_step(simulation.state, 0.5)
    x = random_state(simulation.discretization.points, 0.01, seed=2)
    problem.linearize_at(x)
    gradient = difference_gradient(problem.value, x, 1e-6)
    np.testing.assert_allclose(problem.gradient(x), gradient, atol=1e-6 * np.abs(gradient).max())
    differences = difference_matrix(problem.gradient, x, 1e-6)
    K = dense_hessian(problem, x, project=False)
    np.testing.assert_allclose(K, differences, atol=1e-6 * np.abs(differences).max())
    step = random_state(np.zeros_like(x), 1.0, seed=4)
    projected = dense_hessian(problem, x, project=True, everything=True)
    np.testing.assert_allclose(
        problem.hessian_times(x, step).ravel(), projected @ step.ravel(), atol=1e-9 * np.abs(projected).max()
    )


def test_a_collapsed_spring_pushes_nowhere() -> None:
    simulation = linked("spring-in-space", 2)
    links = simulation.problem.links
    assert links is not None
    (term,) = links.terms
    x = simulation.discretization.points.copy()
    shift = term.offsets(x)[0]
    x += -shift / term.weights.sum()
    np.testing.assert_allclose(term.offsets(x), 0.0, atol=1e-15)
    x[term.cells[0]] -= term.offsets(x)[0]
    length = float(np.linalg.norm(shift))
    assert links.energy(x) == pytest.approx(0.5 * 3.0 * length**2, rel=1e-12)
    assert np.isfinite(term_gradient(term, x)).all()
    assert np.isfinite(cell_matrices(term, x, project=True)).all()
