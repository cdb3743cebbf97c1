"""Obstacles and friction: distances, energies, forces and Hessians against finite differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenario import difference_gradient, difference_matrix

from femdeform.contact.obstacles import Box, Plane, Shape, Sphere
from femdeform.contact.penalty import PenaltyContact

DIMS = pytest.mark.parametrize("dim", [2, 3])


def shapes(dim: int) -> dict[str, Shape]:
    center = np.array([0.2, -0.1, 0.3])[:dim]
    half = np.array([0.5, 0.4, 0.6])[:dim]
    return {
        "plane": Plane(center, np.array([0.3, 2.0, -0.5])[:dim]),
        "ball": Sphere(center, 0.7, inside=False),
        "bowl": Sphere(center, 0.7, inside=True),
        "box": Box(center - half, center + half, inside=False),
        "container": Box(center - half, center + half, inside=True),
    }


SHAPES = pytest.mark.parametrize("name", ["plane", "ball", "bowl", "box", "container"])


def scattered(shape: Shape, dim: int, n: int = 60) -> Any:
    """Points around a shape, away from where its distance has a kink."""
    x = np.random.default_rng(5).uniform(-1.2, 1.2, (n, dim)) + 0.1
    if isinstance(shape, Box):
        excess = np.sort(np.abs(x - shape.center) - shape.half, axis=1)
        tie = (excess[:, -1] < 0.0) & (excess[:, -1] - excess[:, -2] < 0.02)
        x = x[~tie & (np.abs(excess) > 0.02).all(axis=1)]
    return x


@DIMS
@SHAPES
def test_normal_is_the_gradient_of_the_distance(name: str, dim: int) -> None:
    shape = shapes(dim)[name]
    x = scattered(shape, dim)
    distance, normal = shape.distance(x)
    assert (distance > 0.0).any()
    assert (distance < 0.0).any()
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, rtol=1e-12)
    for c in range(dim):
        e = 1e-6 * np.eye(dim)[c]
        slope = (shape.distance(x + e)[0] - shape.distance(x - e)[0]) / 2e-6
        np.testing.assert_allclose(normal[:, c], slope, atol=1e-8)


def test_distances_are_the_ones_of_geometry() -> None:
    corners = np.array([[-1.0, -1.0], [1.0, 2.0]])
    box, container = Box(*corners, inside=False), Box(*corners, inside=True)
    x = np.array([[0.0, 0.0], [0.5, 0.5], [4.0, 6.0], [0.0, 3.0], [-2.0, 0.0]])
    expected = np.array([-1.0, -0.5, 5.0, 1.0, 1.0])
    np.testing.assert_allclose(box.distance(x)[0], expected, rtol=1e-12)
    np.testing.assert_allclose(container.distance(x)[0], -expected, rtol=1e-12)
    ball = Sphere(np.array([1.0, 0.0]), 2.0, inside=False)
    np.testing.assert_allclose(ball.distance(np.array([[1.0, 0.0], [1.0, 3.0]]))[0], [-2.0, 1.0])
    assert np.isfinite(ball.distance(np.array([[1.0, 0.0]]))[1]).all()
    plane = Plane(np.array([0.0, 1.0]), np.array([0.0, 5.0]))
    np.testing.assert_allclose(plane.distance(np.array([[3.0, 4.0]]))[0], [3.0])


def contact(shape: Shape, n: int, dim: int, friction: float = 0.0) -> PenaltyContact:
    stiffness = np.linspace(50.0, 150.0, n)
    velocity = np.array([0.3, -0.2, 0.1])[:dim]
    return PenaltyContact(shape, np.arange(n), lambda x, normals: stiffness, friction, velocity, stick_velocity=0.05)


def gradient(term: PenaltyContact, x: Any) -> Any:
    out = np.zeros_like(x)
    term.add_gradient(x, out)
    return out


def hessian(term: PenaltyContact, x: Any, project: bool) -> Any:
    n, d = x.shape
    diagonal = np.zeros((n, d * d))
    term.add_hessian(x, project, diagonal)
    full = np.zeros((n, d, n, d))
    full[np.arange(n), :, np.arange(n), :] = diagonal.reshape(n, d, d)
    return full.reshape(n * d, n * d)


@DIMS
@SHAPES
def test_normal_force_and_stiffness(name: str, dim: int) -> None:
    shape = shapes(dim)[name]
    x = scattered(shape, dim, n=25)
    term = contact(shape, len(x), dim)
    term.begin_step(x, time=0.0, dt=0.1)
    g = gradient(term, x)
    np.testing.assert_allclose(g, difference_gradient(term.value, x, 1e-6), atol=1e-6)
    assert term.value(x) > 0.0
    # Outside there is no force.
    assert np.all(g[shape.distance(x)[0] > 0.0] == 0.0)
    K = difference_matrix(lambda y: gradient(term, y), x, 1e-6)
    np.testing.assert_allclose(hessian(term, x, project=False), K, atol=1e-5 * 150.0)
    projected = hessian(term, x, project=True)
    assert np.linalg.eigvalsh(projected).min() > -1e-10
    assert np.linalg.eigvalsh(projected - K).min() > -1e-5 * 150.0
    if name != "ball":
        # Only the outside of a ball curves away; elsewhere nothing is lost by projection.
        np.testing.assert_allclose(projected, K, atol=1e-5 * 150.0)


@DIMS
@SHAPES
def test_moving_obstacle(name: str, dim: int) -> None:
    """The obstacle is where its velocity has taken it by the end of the step."""
    shape = shapes(dim)[name]
    x = scattered(shape, dim, n=25)
    term, still = contact(shape, len(x), dim), contact(shape, len(x), dim)
    term.begin_step(x, time=2.0, dt=0.1)
    still.velocity = np.zeros(dim)
    still.begin_step(x - 2.0 * term.velocity, time=2.0, dt=0.1)
    assert term.value(x) == pytest.approx(still.value(x - 2.0 * term.velocity), rel=1e-12)


@DIMS
@pytest.mark.parametrize("factor", [0.3, 0.99, 1.5, 20.0])
def test_friction_potential(dim: int, factor: float) -> None:
    """Below and beyond the slip that counts as sticking, relative to an obstacle that moves itself."""
    plane = Plane(np.zeros(dim), np.array([0.2, 1.0, 0.1])[:dim])
    n = 6
    rng = np.random.default_rng(2)
    start = rng.uniform(-1.0, 1.0, (n, dim))
    start -= plane.distance(start)[0][:, None] * plane.normal  # on the plane, then into it
    start -= np.linspace(0.01, 0.05, n)[:, None] * plane.normal
    dt, mu = 0.1, 0.4
    term = contact(plane, n, dim, friction=mu)
    before = start + term.velocity * 0.9  # at time 0.9 the obstacle has moved by that
    term.begin_step(before, time=1.0, dt=dt)
    normal_force = term.stiffness * np.linspace(0.01, 0.05, n)

    direction = rng.standard_normal((n, dim))
    direction -= (direction @ plane.normal)[:, None] * plane.normal
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    stick = 0.05 * dt
    x = before + term.velocity * dt + factor * stick * direction
    only = contact(plane, n, dim, friction=0.0)
    only.begin_step(before, time=1.0, dt=dt)

    force = gradient(only, x) - gradient(term, x)
    expected = -mu * (normal_force * min(factor, 1.0))[:, None] * direction
    np.testing.assert_allclose(force, expected, atol=1e-10)
    np.testing.assert_allclose(gradient(term, x), difference_gradient(term.value, x, 1e-7), atol=1e-6)
    K = difference_matrix(lambda y: gradient(term, y), x, 1e-8)
    np.testing.assert_allclose(hessian(term, x, project=False), K, atol=1e-4 * np.abs(K).max())
    assert np.linalg.eigvalsh(hessian(term, x, project=True)).min() > -1e-9 * np.abs(K).max()


def test_friction_of_a_node_at_rest_is_finite() -> None:
    term = contact(Plane(np.zeros(3), np.array([0.0, 0.0, 1.0])), 1, 3, friction=0.5)
    x = np.array([[0.0, 0.0, -0.01]])
    term.begin_step(x, time=0.1, dt=0.1)
    at_rest = x + term.velocity * 0.1
    assert np.isfinite(term.value(at_rest))
    assert np.isfinite(gradient(term, at_rest)).all()
    assert np.isfinite(hessian(term, at_rest, project=True)).all()


def test_a_node_outside_has_no_friction() -> None:
    term = contact(Plane(np.zeros(2), np.array([0.0, 1.0])), 1, 2, friction=0.5)
    x = np.array([[0.0, 0.2]])
    term.begin_step(x, time=0.0, dt=0.1)
    assert np.all(gradient(term, x + np.array([0.5, 0.0])) == 0.0)
