"""From links of a scene to weak constraints: whom they hold, with what weights, and what a sweep over nodes reads."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenario import block, body, build, material, quasistatic, random_state, scene, step, term_gradient

from femdeform.contact.weak_constraints import WeakConstraints
from femdeform.errors import InputError
from femdeform.run.setup import Simulation


def constraints(simulation: Simulation) -> WeakConstraints:
    links = simulation.problem.links
    assert links is not None
    return links


def two(link: dict[str, Any], gap: float = 0.0, order: int = 1, **more: Any) -> Simulation:
    first = body(block([1.0, 0.5], [2, 2]), element_order=order)
    second = body(block([0.6, 0.5], [1, 3], translate=[1.0 + gap, 0.0]), element_order=order)
    return build(scene({"a": first, "b": second}, links={"l": link}, time=quasistatic(), **more))


def tie(**more: Any) -> dict[str, Any]:
    return {"kind": "tie", "on": "b.left", "to": "a.right", "stiffness": 5.0, **more}


def test_nodes_are_held_by_the_closest_points() -> None:
    links = constraints(two(tie()))
    rows = links.rows
    # Of four nodes two meet corners of the other mesh, two lie on its edges.
    np.testing.assert_array_equal(np.diff(rows.offsets), [2, 2, 3, 3])
    np.testing.assert_allclose(np.add.reduceat(rows.weights, rows.offsets[:-1]), 0.0, atol=1e-15)
    for row in (2, 3):
        weights = np.sort(rows.weights[rows.offsets[row] : rows.offsets[row + 1]])
        np.testing.assert_allclose(weights, [-2 / 3, -1 / 3, 1.0], atol=1e-14)
    np.testing.assert_allclose(links.stiffness, np.tile(5.0 * np.eye(2), (4, 1, 1)))


def test_a_gap_is_kept_by_the_cell_that_goes_on_or_closed() -> None:
    kept = two(tie(max_distance=0.2), gap=0.1)
    x = kept.discretization.points
    assert constraints(kept).gap(x) < 1e-15
    # The cell behind the surface reaches 0.5 m into the body: 0.1 m beyond, its far corner has weight -0.2.
    assert np.count_nonzero(np.isclose(constraints(kept).rows.weights, 0.2)) == 4
    closed = two(tie(max_distance=0.2, gap="closed"), gap=0.1)
    assert constraints(closed).gap(x) == pytest.approx(0.1)
    assert constraints(closed).energy(x) == pytest.approx(4 * 0.5 * 5.0 * 0.01)
    # On a straight line through the gap, an affine motion is followed exactly by what is kept.
    F = np.array([[1.3, 0.2], [-0.1, 0.9]])
    assert constraints(kept).gap(x @ F.T + 0.4) < 1e-14


def test_quadratic_bodies_hold_by_their_shape_functions() -> None:
    links = constraints(two(tie(), order=2))
    x = links_quadratic_field(two(tie(), order=2))
    assert links.gap(x) < 1e-14


def links_quadratic_field(simulation: Simulation) -> Any:
    """A motion that is quadratic in space, the same for both bodies."""
    X = simulation.discretization.points
    return X + 0.1 * np.stack([X[:, 1] ** 2, X[:, 0] * X[:, 1]], axis=1)


@pytest.mark.parametrize("per", ["node", "area"])
@pytest.mark.parametrize("order", [1, 2])
def test_stiffness_adds_up(per: str, order: int) -> None:
    """By node each has the whole, by area they share the surface."""
    links = constraints(two(tie(per=per), order=order))
    total = links.stiffness.sum(axis=0)
    expected = 5.0 * (0.5 if per == "area" else {1: 4, 2: 7}[order])
    np.testing.assert_allclose(total, expected * np.eye(2), rtol=1e-13)


def test_thin_bodies_hold_and_are_held() -> None:
    cloth = body({"recipe": "cloth", "cells": [4, 4]}, kind="membrane", thickness=0.01)
    rod = body(
        {"recipe": "rod", "cells": 3, "start": [-0.4, 0.02, 0.1], "end": [0.4, 0.02, 0.1]},
        kind="rod",
        cross_section=1e-4,
    )
    seam = {"kind": "binding", "on": "r", "to": "c", "stiffness": 2.0e4, "within": 0.05}
    simulation = build(scene({"c": cloth, "r": rod}, links={"seam": seam}, time=quasistatic()))
    links = constraints(simulation)
    x = simulation.discretization.points
    assert links.gap(x) < 1e-15
    # A rod is as wide as a square section is: 0.01 m.
    np.testing.assert_allclose(links.stiffness.sum(axis=0), 2e4 * 0.8 * 0.01 * np.eye(3), rtol=1e-12)
    assert any("does not turn" in notice for notice in simulation.notices)
    turned = {**seam, "tangential_stiffness": 0.0}
    links = constraints(build(scene({"c": cloth, "r": rod}, links={"seam": turned}, time=quasistatic())))
    # The cloth lies across y.
    np.testing.assert_allclose(links.stiffness.sum(axis=0), 160.0 * np.diag([0.0, 1.0, 0.0]), atol=1e-9)
    other = {**turned, "on": "c", "to": "r", "within": 2.0}
    with pytest.raises(InputError, match=r"links\.seam\.direction: missing; the rod `r` has no normal in 3D"):
        build(scene({"c": cloth, "r": rod}, links={"seam": other}, time=quasistatic()))


def test_ties_inside_a_body_and_a_node_of_both_ends() -> None:
    """Ends in the same cell share nodes: each enters once, with the difference of its weights."""
    ends = [{"at": [0.1, 0.2]}, {"at": [0.2, 0.1]}]
    data = scene(
        {"a": body(block([1.0, 1.0], [1, 1]))},
        links={"l": {"kind": "pair", "ends": ends, "stiffness": 1.0}},
        time=quasistatic(),
    )
    rows = constraints(build(data)).rows
    assert np.unique(rows.nodes).size == rows.nodes.size <= 4
    np.testing.assert_allclose(rows.weights.sum(), 0.0, atol=1e-15)
    ring = scene(
        {"a": body(block([1.0, 0.2], [5, 1]))},
        links={"l": {"kind": "tie", "on": "a.left", "to": "a.right", "stiffness": 1.0, "max_distance": 2.0}},
        time=quasistatic(),
    )
    assert constraints(build(ring)).rows.n_rows == 2


def test_a_sweep_over_nodes_finds_its_constraints() -> None:
    """`by_node` and the arrays are enough for the gradient and the diagonal blocks of all kinds together."""
    links = {
        "t": tie(),
        "s": {"kind": "spring", "ends": [{"at": [0.2, 0.2]}, {"at": [1.3, 0.1]}], "stiffness": 7.0, "length": 0.9},
        "h": {"kind": "attachment", "on": "a.left", "stiffness": 3.0},
    }
    simulation = build(
        scene(
            {
                "a": body(block([1.0, 0.5], [2, 2])),
                "b": body(block([0.6, 0.5], [1, 3], translate=[1.0, 0.0])),
            },
            links=links,
            time=quasistatic(),
        )
    )
    held = constraints(simulation)
    x = random_state(simulation.discretization.points, 0.05, seed=3)
    n = len(x)
    offsets, rows, weights = held.by_node(n)
    C = np.concatenate([term.offsets(x) for term in held.terms])
    gradient, diagonal = np.zeros((n, 2)), np.zeros((n, 2, 2))
    for node in range(n):
        for entry in range(offsets[node], offsets[node + 1]):
            c, w = rows[entry], weights[entry]
            K, L = held.stiffness[c], held.rows.length[c]
            if L > 0.0:
                size = np.linalg.norm(C[c])
                m, slack = C[c] / size, 1.0 - L / size
                gradient[node] += w * K[0, 0] * slack * C[c]
                outer = np.outer(m, m)
                diagonal[node] += w**2 * K[0, 0] * (outer + max(slack, 0.0) * (np.eye(2) - outer))
            else:
                gradient[node] += w * K @ C[c]
                diagonal[node] += w**2 * K
    np.testing.assert_allclose(gradient, np.sum([term_gradient(t, x) for t in held.terms], axis=0), atol=1e-13)
    total = np.zeros((n, 2, 2))
    for term in held.terms:
        k = term.cells.shape[1]
        a, b = np.triu_indices(k)
        blocks = np.empty((term.cells.shape[0] * a.size, 4))
        term.hessian(x, True, blocks, 0)
        own = blocks.reshape(term.cells.shape[0], a.size, 2, 2)[:, a == b]
        np.add.at(total, term.cells, own)
    np.testing.assert_allclose(diagonal, total, atol=1e-13)


def test_normals_are_those_at_the_start_of_the_step() -> None:
    simulation = two(tie(tangential_stiffness=1.0))
    links = constraints(simulation)
    np.testing.assert_allclose(links.stiffness[0], np.diag([5.0, 1.0]), atol=1e-15)
    x = simulation.discretization.points
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    links.begin_step(x @ turn.T, 0.0)
    np.testing.assert_allclose(links.stiffness[0], np.diag([1.0, 5.0]), atol=1e-14)


def test_forces_of_stiff_links_do_not_set_the_scale() -> None:
    """The residual is judged by the forces in the bodies, also where a stiff tie is far from its place."""
    simulation = two(tie(gap="closed", max_distance=0.2, stiffness=1e8), gap=0.1, gravity=[0.0, -9.81])
    simulation.problem.begin_step(simulation.state, 1.0)
    weight = simulation.problem.partition.norm(simulation.problem.load)
    assert simulation.problem.force_scale == pytest.approx(weight)


def test_steps_converge_with_all_kinds_at_once() -> None:
    links = {
        "hold": {"kind": "attachment", "on": "a.left", "stiffness": 1e3},
        "t": tie(stiffness=1e5, tangential_stiffness=1e3),
        "s": {"kind": "spring", "ends": [{"at": [1.6, 0.5]}, {"at": [1.8, 1.5], "fixed": True}], "stiffness": 50.0},
    }
    simulation = build(
        scene(
            {
                "a": body(block([1.0, 0.5], [2, 2]), material(E=1e4)),
                "b": body(block([0.6, 0.5], [1, 3], translate=[1.0, 0.0]), material(E=1e4)),
            },
            gravity=[0.0, -1.0],
            links=links,
        )
    )
    for _ in range(5):
        assert step(simulation).relative_residual < 1e-7
