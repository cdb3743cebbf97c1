"""Incremental potential contact: energies, forces and Hessians of obstacles, bodies and friction."""

from __future__ import annotations

from typing import Any

import ipctk
import numpy as np
import pytest
from scenario import block, body, build, dense_hessian, difference_gradient, difference_matrix, material, scene

from femdeform.contact.barrier import barrier, friction_force, friction_work
from femdeform.contact.ipc import IPCContact
from femdeform.contact.obstacle_barrier import ObstacleBarrier
from femdeform.contact.obstacles import Box, Plane, Shape, Sphere
from femdeform.contact.surface import SurfacePart, collision_surface

DIMS = pytest.mark.parametrize("dim", [2, 3])
REACH = 0.1


# ----------------------------------------------------------------------------------------------- scalar laws


@pytest.mark.parametrize("offset", [0.0, 0.03])
def test_barrier_and_its_derivatives(offset: float) -> None:
    gap = np.linspace(1e-3, 0.999 * REACH, 40)
    offsets = np.full_like(gap, offset)
    value, slope, curvature = barrier(gap, REACH, offsets)
    h = 1e-7
    above, below = barrier(gap + h, REACH, offsets), barrier(gap - h, REACH, offsets)
    np.testing.assert_allclose((above[0] - below[0]) / (2 * h), slope, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose((above[1] - below[1]) / (2 * h), curvature, rtol=1e-5, atol=1e-6)
    assert np.all(np.diff(value) < 0.0)
    assert np.all(slope < 0.0)
    assert np.all(curvature > 0.0)
    # It is the one that ipctk evaluates.
    potential = ipctk.BarrierPotential(REACH, 1.0, True)
    for g, s in zip(gap, slope, strict=True):
        assert potential.force_magnitude((g + offset) ** 2, offset) == pytest.approx(-s, rel=1e-9)


def test_barrier_ends_softly_and_never_gives_way() -> None:
    none = np.zeros(2)
    value, slope, curvature = barrier(np.array([REACH, REACH * (1 - 1e-9)]), REACH, none)
    np.testing.assert_allclose([value, slope, curvature * REACH], 0.0, atol=1e-7)
    assert barrier(np.array([0.0, -1.0]), REACH, none)[0].tolist() == [np.inf, np.inf]
    assert barrier(np.array([1e-30, 1e-3]), REACH, none)[0][0] > 10.0 * REACH


def test_friction_law() -> None:
    h = 0.02
    slip = np.array([1e-9, 0.003, 0.01, 0.0199, 0.0201, 0.5])
    secant, tangent = friction_force(slip, h)
    d = 1e-8
    work = (friction_work(slip + d, h) - friction_work(slip - d, h)) / (2 * d)
    np.testing.assert_allclose(secant * slip, work, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose([ipctk.smooth_friction_f0(y, h) for y in slip], friction_work(slip, h), rtol=1e-12)
    force = [friction_force(slip + s, h)[0] * (slip + s) for s in (d, -d)]
    np.testing.assert_allclose(tangent, (force[0] - force[1]) / (2 * d), rtol=1e-5, atol=1e-5)
    assert np.isfinite(friction_force(np.zeros(1), h)[0]).all()


# ------------------------------------------------------------------------------------------------- obstacles


def shapes(dim: int) -> dict[str, Shape]:
    center = np.array([0.2, -0.1, 0.3])[:dim]
    half = np.array([0.5, 0.4, 0.6])[:dim]
    return {
        "plane": Plane(center, np.array([0.3, 2.0, -0.5])[:dim]),
        "ball": Sphere(center, 0.7, inside=False),
        "bowl": Sphere(center, 0.7, inside=True),
        "box": Box(center - half, center + half, inside=False),
    }


SHAPES = pytest.mark.parametrize("name", ["plane", "ball", "bowl", "box"])


def near(shape: Shape, dim: int, offset: float, n: int = 12) -> Any:
    """Points with gaps from nothing to a little more than the barrier's reach."""
    x = np.random.default_rng(3).uniform(-1.0, 1.0, (n, dim)) + 0.1
    for _ in range(20):
        distance, normal = shape.distance(x)
        x = x - (distance - np.linspace(0.1, 1.1, n) * REACH - offset)[:, None] * normal
    return x


def obstacle(shape: Shape, n: int, dim: int, friction: float = 0.0, offset: float = 0.02) -> ObstacleBarrier:
    weight = np.linspace(50.0, 150.0, n)
    velocity = np.array([0.3, -0.2, 0.1])[:dim]
    return ObstacleBarrier(shape, np.arange(n), weight, np.full(n, offset), REACH, friction, velocity, 0.05)


def gradient(term: Any, x: Any) -> Any:
    out = np.zeros_like(x)
    term.add_gradient(x, out)
    return out


def hessian(term: ObstacleBarrier, x: Any, project: bool) -> Any:
    n, d = x.shape
    diagonal = np.zeros((n, d * d))
    term.add_hessian(x, project, diagonal)
    full = np.zeros((n, d, n, d))
    full[np.arange(n), :, np.arange(n), :] = diagonal.reshape(n, d, d)
    return full.reshape(n * d, n * d)


@DIMS
@SHAPES
@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_obstacle_forces_and_stiffness(name: str, dim: int, friction: float) -> None:
    shape = shapes(dim)[name]
    x = near(shape, dim, 0.02)
    term = obstacle(shape, len(x), dim, friction)
    term.begin_step(x, time=0.1, dt=0.1)
    x = x + np.random.default_rng(0).uniform(-1.0, 1.0, x.shape) * 0.004
    assert np.isfinite(term.value(x))
    scale = np.abs(gradient(term, x)).max()
    np.testing.assert_allclose(gradient(term, x), difference_gradient(term.value, x, 1e-8), atol=1e-5 * scale)
    K = difference_matrix(lambda y: gradient(term, y), x, 1e-8)
    exact, projected = hessian(term, x, False), hessian(term, x, True)
    np.testing.assert_allclose(exact, K, atol=1e-5 * np.abs(K).max())
    assert np.linalg.eigvalsh(projected).min() > -1e-10 * np.abs(K).max()
    assert np.linalg.eigvalsh(projected - exact).min() > -1e-10 * np.abs(K).max()
    # A moving obstacle: the change of the force when it drifts on.
    change = np.zeros_like(x)
    term.drift_force(x, 1e-6, change)
    before = gradient(term, x)
    term.place(1e-6)
    if name in ("plane", "bowl"):  # around the others curvature softens, and is left out there
        np.testing.assert_allclose(gradient(term, x) - before, change, atol=1e-3 * np.abs(change).max())


@DIMS
@SHAPES
def test_nothing_steps_through_an_obstacle(name: str, dim: int) -> None:
    shape = shapes(dim)[name]
    start = near(shape, dim, 0.02, n=60)
    term = obstacle(shape, len(start), dim)
    term.begin_step(start, time=0.1, dt=0.1)
    rng = np.random.default_rng(1)
    for size in (0.1, 1.0, 10.0):
        step = rng.standard_normal(start.shape) * size
        part = term.max_step(start, step, 0.0)
        assert 0.0 < part <= 1.0
        for t in np.linspace(0.0, part, 50):
            assert np.all(term.gaps(start + t * step) >= 0.0999 * term.gaps(start))
        # Whoever is stopped comes close: the bound is not idle.
        if part < 1.0:
            assert (term.gaps(start + part * step) / term.gaps(start)).min() < 0.11
    # Nodes at rest, and an obstacle that comes to them.
    alone = obstacle(shape, len(start), dim)
    alone.begin_step(start, time=10.0, dt=10.0)
    gaps = alone.gaps(start)
    part = alone.max_step(start, np.zeros_like(start), 1.0)
    assert (part < 1.0) == (name != "plane")  # which moves away
    alone.place(part)
    assert np.all(alone.gaps(start) >= 0.0999 * gaps)


# ---------------------------------------------------------------------------------------------------- bodies


def grid(n: int, height: float, shift: float) -> tuple[Any, Any]:
    along = np.linspace(0.0, 1.0, n + 1)
    points = np.array([[x + shift, y + 0.7 * shift, height] for y in along for x in along])
    first = np.array([j * (n + 1) + i for j in range(n) for i in range(n)])[:, None]
    return points, np.concatenate([first + np.array([0, 1, n + 2]), first + np.array([0, n + 2, n + 1])])


def surfaces(dim: int, offset: float = 0.0) -> Any:
    """Two facing surfaces closer than the barrier reaches, and in 3D a rod above them."""
    gap = 0.5 * REACH + offset
    parts = []
    if dim == 3:
        lower, faces = grid(2, 0.0, 0.0)
        upper, _ = grid(2, gap, 0.13)
        rod = np.array([[0.2, 0.37, 2 * gap], [0.6, 0.41, 2 * gap], [0.9, 0.5, 2 * gap]])
        points = np.concatenate([lower, upper, rod])
        parts.append(SurfacePart("a", faces, 3, 1.0, 0.0, 100.0))
        parts.append(SurfacePart("b", faces + len(lower), 3, 1.0, 0.0, 300.0))
        segments = np.array([[0, 1], [1, 2]]) + len(lower) + len(upper)
        parts.append(SurfacePart("c", segments, 2, 0.2, 0.0, 200.0))
    else:
        x = np.linspace(0.0, 1.0, 5)
        points = np.concatenate([np.stack([x, 0 * x], 1), np.stack([x[::-1] + 0.06, 0 * x + gap], 1)])
        segments = np.stack([np.arange(4), np.arange(1, 5)], 1)
        parts = [
            SurfacePart("a", segments, 2, 1.0, 0.0, 100.0),
            SurfacePart("b", segments + 5, 2, 1.0, 0.0, 300.0),
        ]
    points = points + np.random.default_rng(2).uniform(-1, 1, points.shape) * 0.1 * REACH
    return collision_surface(parts, points), points


def bodies(dim: int, friction: float = 0.0, offset: float = 0.0) -> tuple[IPCContact, Any]:
    surface, points = surfaces(dim, offset)
    touch = np.ones((len(surface.bodies),) * 2, dtype=bool)
    return IPCContact(surface, touch, REACH, offset, friction, 0.05), points


def dense(term: IPCContact, x: Any, project: bool) -> Any:
    n, d = x.shape
    found = term.hessian_blocks(x, project)
    assert np.all(np.diff(found.rows * n + found.columns) > 0)
    full = np.zeros((n, d, n, d))
    blocks = found.blocks.reshape(-1, d, d)
    full[found.rows, :, found.columns, :] = blocks
    full[found.columns, :, found.rows, :] = blocks.transpose(0, 2, 1)
    full[found.nodes, :, found.nodes, :] = found.diagonal.reshape(-1, d, d)
    return full.reshape(n * d, n * d)


@DIMS
@pytest.mark.parametrize("friction", [0.0, 0.4])
@pytest.mark.parametrize("offset", [0.0, 0.03])
def test_contact_of_bodies(dim: int, friction: float, offset: float) -> None:
    term, start = bodies(dim, friction, offset)
    term.begin_step(start, time=0.1, dt=0.1)
    x = start + np.random.default_rng(4).uniform(-1, 1, start.shape) * 0.006
    assert term.count(x) > 10
    assert term.value(x) > 0.0
    force = gradient(term, x)
    scale = np.abs(force).max()
    np.testing.assert_allclose(force, difference_gradient(term.value, x, 1e-8), atol=1e-5 * scale)
    K = difference_matrix(lambda y: gradient(term, y), x, 1e-8)
    exact, projected = dense(term, x, False), dense(term, x, True)
    np.testing.assert_allclose(exact, K, atol=2e-5 * np.abs(K).max())
    np.testing.assert_allclose(exact, exact.T, atol=1e-9 * np.abs(K).max())
    assert np.linalg.eigvalsh(projected).min() > -1e-9 * np.abs(K).max()
    # Pairs of forces: nothing is left over, neither as a force nor, without friction, as a moment.
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-10 * np.abs(force).sum())
    if friction == 0.0:
        arm = np.concatenate([x, np.zeros((len(x), 3 - dim))], axis=1)
        push = np.concatenate([force, np.zeros((len(x), 3 - dim))], axis=1)
        np.testing.assert_allclose(np.cross(arm, push).sum(axis=0), 0.0, atol=1e-10 * np.abs(force).sum())


@DIMS
def test_energy_scales_with_area_and_stiffness_of_the_bodies(dim: int) -> None:
    surface, points = surfaces(dim)
    doubled = collision_surface([SurfacePart(b, f, k, w, 0.0, 2.0 * E) for b, f, k, w, E in parts_of(dim)], points)
    touch = np.ones((len(surface.bodies),) * 2, dtype=bool)
    values = []
    for some in (surface, doubled):
        term = IPCContact(some, touch, REACH, 0.0, 0.0, 1.0)
        term.begin_step(points, 0.1, 0.1)
        values.append(term.value(points))
    assert values[1] == pytest.approx(2.0 * values[0], rel=1e-12)


def parts_of(dim: int) -> list[tuple[Any, ...]]:
    _, faces = grid(2, 0.0, 0.0)
    segments = np.stack([np.arange(4), np.arange(1, 5)], 1)
    if dim == 2:
        return [("a", segments, 2, 1.0, 100.0), ("b", segments + 5, 2, 1.0, 300.0)]
    rod = np.array([[0, 1], [1, 2]]) + 18
    return [("a", faces, 3, 1.0, 100.0), ("b", faces + 9, 3, 1.0, 300.0), ("c", rod, 2, 0.2, 200.0)]


# --------------------------------------------------------------------------------------- the whole of a step


def stack(dim: int, mass: str = "lumped") -> Any:
    """Two blocks a little apart above a plane; all barriers are at work."""
    size, cells = [0.4, 0.2, 0.3][:dim], [2, 1, 1][:dim]
    up = np.eye(dim)[1]
    data = scene(
        {
            "a": body(block(size, cells, translate=[float(c) for c in 0.013 * up]), material(), mass=mass),
            "b": body(block(size, cells, translate=[float(c) for c in 0.232 * up + 0.03]), material(), mass=mass),
        },
        {"kind": "fixed", "on": "a.left"},
        obstacles=[{"kind": "plane", "point": [0.0] * dim, "normal": [float(c) for c in up], "friction": 0.3}],
        contact={"method": "ipc", "distance": 0.06, "friction": 0.3, "friction_velocity": 1.0},
    )
    return build(data)


@DIMS
@pytest.mark.parametrize("mass", ["lumped", "consistent"])
def test_hessian_of_a_step_with_contact(dim: int, mass: str) -> None:
    simulation = stack(dim, mass)
    problem, state = simulation.problem, simulation.state
    problem.begin_step(state, 0.01)
    (contact,) = problem.couplings
    x = state.x + np.random.default_rng(0).uniform(-1, 1, state.x.shape) * 0.002
    assert contact.count(x) > 0
    cells_only = problem.pattern
    K = difference_matrix(problem.full_gradient, x, 1e-8)
    full = dense_hessian(problem, x, project=False, everything=True)
    np.testing.assert_allclose(full, K, atol=2e-5 * np.abs(K).max())
    assert problem.pattern is not cells_only
    assert np.linalg.eigvalsh(dense_hessian(problem, x, project=True)).min() > 0.0
    # As long as the same nodes are in contact the pattern stays; away from contact a new step has the cells' again.
    held = problem.pattern
    problem.hessian(x, True)
    assert problem.pattern is held
    apart = state.copy()
    apart.x[simulation.conditions.local_nodes("b")] += 1.0
    problem.begin_step(apart, 0.01)
    np.testing.assert_allclose(
        dense_hessian(problem, apart.x, project=False, everything=True),
        difference_matrix(problem.full_gradient, apart.x, 1e-8),
        atol=2e-5 * np.abs(K).max(),
    )
    assert problem.pattern is cells_only
