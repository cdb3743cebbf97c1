"""Weights of points on a background grid, and APIC transfers between them."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest
from numpy.typing import NDArray

from femdeform.jit import set_threads
from femdeform.mpm import grid as grid_module
from femdeform.mpm.grid import Grid, Stencils
from femdeform.mpm.transfers import momentum_to_grid, spin, velocity_to_points

Array = NDArray[np.float64]

CASES = [(kernel, dim) for kernel in ("linear", "quadratic") for dim in (2, 3)]


def cloud(dim: int, n: int = 200, seed: int = 0) -> Array:
    """Points on both sides of the origin, some of them at nodes and half way between."""
    points = np.random.default_rng(seed).uniform(-0.7, 0.9, (n, dim))
    points[:3] = [[0.2] * dim, [-0.3] * dim, [0.1] * dim]
    return points


def dense(s: Stencils) -> Array:
    """W as a dense matrix."""
    W = np.zeros((len(s.weights), s.n_nodes))
    np.add.at(W, (np.arange(len(W))[:, None], s.nodes), s.weights)
    return W


def cross(a: Array, b: Array) -> Array:
    """Cross products (n, 3) of vectors in space or in the plane."""
    wide = np.zeros((2, len(a), 3))
    wide[0, :, : a.shape[1]], wide[1, :, : b.shape[1]] = a, b
    return np.cross(wide[0], wide[1])


@pytest.mark.parametrize(("kernel", "dim"), CASES)
def test_weights_reproduce_affine_fields(kernel: str, dim: int) -> None:
    points = cloud(dim)
    s = Grid(0.2, kernel).stencils(points)
    assert np.all(s.weights >= 0.0)
    np.testing.assert_allclose(s.weights.sum(axis=1), 1.0, atol=1e-14)
    np.testing.assert_allclose(s.to_points(s.positions), points, atol=1e-14)
    slope = np.random.default_rng(1).standard_normal((dim, dim))
    np.testing.assert_allclose(s.to_points(s.positions @ slope + 3.0), points @ slope + 3.0, atol=1e-13)
    np.testing.assert_allclose(s.gradients.sum(axis=1), 0.0, atol=1e-12)
    apart = s.positions[s.nodes] - points[:, None]
    # Where a weight vanishes its node may be any; its gradient then belongs to the one it would have been.
    inside = (s.weights > 0.0).all(axis=1)
    unit = np.einsum("pki,pkj->pij", apart, s.gradients)
    np.testing.assert_allclose(unit[inside], np.broadcast_to(np.eye(dim), unit[inside].shape), atol=1e-12)
    assert inside.sum() > 100


@pytest.mark.parametrize("dim", [2, 3])
def test_inertia_of_quadratic_weights_is_the_same_everywhere(dim: int) -> None:
    points = cloud(dim)
    s = Grid(0.2, "quadratic").stencils(points)
    apart = s.positions[s.nodes] - points[:, None]
    inertia = np.einsum("pk,pki,pkj->pij", s.weights, apart, apart)
    np.testing.assert_allclose(inertia, np.broadcast_to(0.01 * np.eye(dim), inertia.shape), atol=1e-15)


@pytest.mark.parametrize(("kernel", "dim"), CASES)
def test_gradients_are_the_derivatives_of_the_weights(kernel: str, dim: int) -> None:
    points = cloud(dim)[3:]  # linear weights have kinks at nodes
    grid, h = Grid(0.2, kernel), 1e-6
    f = np.random.default_rng(2).standard_normal((64, 1))

    def field(x: Array) -> Array:
        s = grid.stencils(x)
        # A field of the position of the node, whatever its number.
        values = np.sin(7.0 * s.positions @ np.arange(1, dim + 1))[:, None] * f[0]
        return s.to_points(values)[:, 0]

    s = grid.stencils(points)
    values = np.sin(7.0 * s.positions @ np.arange(1, dim + 1)) * f[0]
    inside = (s.weights > 0.0).all(axis=1)
    slope = np.einsum("pk,pkc->pc", values[s.nodes], s.gradients)
    for c in range(dim):
        step = h * np.eye(dim)[c]
        numeric = (field(points + step) - field(points - step)) / (2.0 * h)
        np.testing.assert_allclose(slope[inside, c], numeric[inside], atol=1e-7)


@pytest.mark.parametrize(("kernel", "dim"), CASES)
def test_nodes_list_their_points(kernel: str, dim: int) -> None:
    points = cloud(dim)
    s = Grid(0.2, kernel).stencils(points)
    W = dense(s)
    assert np.all(W.sum(axis=0) > 0.0)  # no node without mass
    assert len(np.unique(s.positions, axis=0)) == s.n_nodes
    values = np.random.default_rng(3).standard_normal((len(points), 2))
    np.testing.assert_allclose(s.to_nodes(values), W.T @ values, atol=1e-13)
    field = np.random.default_rng(4).standard_normal((s.n_nodes, 2))
    np.testing.assert_allclose(s.to_points(field), W @ field, atol=1e-13)
    some = np.array([0, 5, 7])
    np.testing.assert_array_equal(s.nodes_of(some), np.flatnonzero(W[some].sum(axis=0)))


def test_a_point_at_a_node_makes_no_node_without_mass() -> None:
    s = Grid(0.5, "linear").stencils(np.array([[1.0, 0.5]]))
    np.testing.assert_array_equal(s.positions, [[1.0, 0.5]])


def test_far_points_have_nodes_of_their_own() -> None:
    points = np.array([[0.0, 0.0, 0.0], [1e4, -2e4, 3e4]])
    s = Grid(0.1, "quadratic").stencils(points)
    assert s.n_nodes == 54
    np.testing.assert_allclose(s.to_points(s.positions), points, atol=1e-9)
    with pytest.raises(ValueError, match="too far apart"):
        Grid(1e-9, "linear").stencils(points)
    with pytest.raises(ValueError, match="not finite"):
        Grid(1.0, "linear").stencils(np.array([[np.nan, 0.0]]))


@pytest.mark.parametrize(("kernel", "dim"), CASES)
def test_affine_motion_survives_the_transfers(kernel: str, dim: int) -> None:
    points = cloud(dim)
    mass = np.random.default_rng(5).uniform(0.5, 2.0, len(points))
    slope = np.random.default_rng(6).standard_normal((dim, dim))
    velocity = points @ slope.T + 0.3
    affine = np.broadcast_to(slope, (len(points), dim, dim)).copy()
    s = Grid(0.2, kernel).stencils(points)
    m, v = momentum_to_grid(s, points, mass, velocity, affine)
    assert abs(m.sum() - mass.sum()) < 1e-12
    np.testing.assert_allclose(v, s.positions @ slope.T + 0.3, atol=1e-12)
    back, gradient = velocity_to_points(s, points, v)
    np.testing.assert_allclose(back, velocity, atol=1e-12)
    inside = (s.weights > 0.0).all(axis=1)
    np.testing.assert_allclose(gradient[inside], affine[inside], atol=1e-11)


def fly(kernel: str, dim: int, steps: int) -> tuple[Array, Array]:
    """Linear and angular momentum of free points before each of many transfers there and back."""
    rng = np.random.default_rng(7)
    points = cloud(dim)
    mass = rng.uniform(0.5, 2.0, len(points))
    velocity = rng.standard_normal(points.shape)
    affine = rng.standard_normal((len(points), dim, dim))
    grid, dt = Grid(0.2, kernel), 0.02
    linear, angular = [], []
    for _ in range(steps):
        linear.append(mass @ velocity)
        own = spin(grid.spacing, grid.degree, points, mass, affine)
        angular.append((cross(points, mass[:, None] * velocity) + own).sum(axis=0))
        s = grid.stencils(points)
        m, v = momentum_to_grid(s, points, mass, velocity, affine)
        np.testing.assert_allclose(m @ v, linear[-1], atol=1e-11)
        np.testing.assert_allclose(cross(s.positions, m[:, None] * v).sum(axis=0), angular[-1], atol=1e-11)
        velocity, affine = velocity_to_points(s, points, v)
        points = points + dt * velocity
    return np.array(linear), np.array(angular)


@pytest.mark.parametrize("dim", [2, 3])
def test_quadratic_transfers_keep_momentum_over_many_steps(dim: int) -> None:
    linear, angular = fly("quadratic", dim, 300)
    assert np.abs(linear - linear[0]).max() < 1e-11 * np.abs(linear).max()
    assert np.abs(angular - angular[0]).max() < 1e-11 * np.abs(angular).max()


@pytest.mark.parametrize("dim", [2, 3])
def test_linear_transfers_keep_linear_momentum_only(dim: int) -> None:
    linear, angular = fly("linear", dim, 100)
    assert np.abs(linear - linear[0]).max() < 1e-11 * np.abs(linear).max()
    assert np.abs(angular - angular[0]).max() > 1e-6 * np.abs(angular).max()


@pytest.mark.parametrize(("kernel", "dim"), CASES)
@pytest.mark.parametrize("box", ["small", "large"])
def test_lists_of_nodes_are_complete_and_ascend(
    kernel: str, dim: int, box: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Against a stable sort of all entries; with nodes of a box numbered one by one, and only those near points."""
    if box == "large":
        monkeypatch.setattr(grid_module, "_SMALL_BOX", 0)
    spread = 30.0 if box == "large" else 1.0
    points = spread * cloud(dim, 500)
    s = Grid(0.2, kernel).stencils(points)
    index = np.rint(s.positions / 0.2).astype(np.int64)
    assert np.array_equal(index, np.unique(index, axis=0))  # in lexicographic order, none twice
    held = np.flatnonzero(s.weights.ravel() > 0.0)
    of_entry = s.nodes.ravel()[held]
    np.testing.assert_array_equal(s.entries, held[np.argsort(of_entry, kind="stable")])
    np.testing.assert_array_equal(np.diff(s.offsets), np.bincount(of_entry, minlength=s.n_nodes))
    assert np.diff(s.offsets).min() > 0
    np.testing.assert_allclose(s.to_points(s.positions), points, atol=1e-12)


@pytest.mark.parametrize("dim", [2, 3])
def test_stencils_of_the_first_points(dim: int) -> None:
    points, grid = cloud(dim, 300), Grid(0.2, "quadratic")
    whole = grid.stencils(points)
    part, alone = whole.of_first(120), grid.stencils(points[:120])
    assert part.n_nodes < whole.n_nodes
    for each in fields(Stencils):  # they stay as they were
        np.testing.assert_array_equal(getattr(whole, each.name), getattr(grid.stencils(points), each.name))
    for each in fields(Stencils):
        np.testing.assert_array_equal(getattr(part, each.name), getattr(alone, each.name))


def test_stencils_do_not_depend_on_threads() -> None:
    points, grid = cloud(3, 5000), Grid(0.05, "quadratic")
    found = []
    try:
        for threads in (1, 2):
            set_threads(threads)
            found.append(grid.stencils(points))
    finally:
        set_threads()
    for each in fields(Stencils):
        np.testing.assert_array_equal(getattr(found[0], each.name), getattr(found[1], each.name))
