"""Walls in the implicit grid step: unknowns eliminated, active sets, friction."""

from __future__ import annotations

from typing import Any

import numpy as np
import point_drop
import pytest
from numpy.typing import NDArray

from femdeform.mpm.implicit_step import GridSolution, solve_step
from femdeform.mpm.node_walls import NodeWall, WallContact
from femdeform.mpm.point_potential import PointPotential
from femdeform.scene.schema import ProjectedNewtonSolver
from solvers.linear.block_cg import BlockCG
from solvers.linear.scipy_direct import SciPyDirect
from solvers.projected_newton import ProjectedNewton

Array = NDArray[np.float64]
DT = 0.01
TOLERANCE = 1e-10


def plane(x: Array, normal: Array, distance: float, kind: Any, velocity: Any = 0.0, friction: float = 0.0) -> NodeWall:
    """The half space ``n . x <= distance``."""
    n = np.asarray(normal, dtype=float) / np.linalg.norm(normal)
    shape = np.broadcast_to(n, x.shape)
    return NodeWall(x @ n - distance, shape, np.broadcast_to(velocity, x.shape), kind, friction)


def sphere(x: Array, center: Array, radius: float, kind: Any, friction: float = 0.0) -> NodeWall:
    apart = x - center
    length = np.linalg.norm(apart, axis=1)
    return NodeWall(length - radius, apart / length[:, None], np.zeros_like(x), kind, friction)


def solve(problem: PointPotential, linear: Any = None) -> GridSolution:
    newton = ProjectedNewton(ProjectedNewtonSolver(tolerance=TOLERANCE), linear or SciPyDirect())
    return solve_step(problem, newton, TOLERANCE)


def oblique(dim: int) -> Array:
    return np.array([0.4, 1.0, -0.3])[:dim] / np.linalg.norm([0.4, 1.0, -0.3][:dim])


def start(dim: int, **options: Any) -> point_drop.Drop:
    return point_drop.drop(dim, gravity=[0.0, -9.81, 0.0][:dim], **options)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("linear", [SciPyDirect, BlockCG])
def test_slip(dim: int, linear: type) -> None:
    drop = start(dim)
    x, n = drop.stencils.positions, oblique(dim)
    carried = np.array([0.2, 0.5, 0.1])[:dim]
    wall = plane(x, n, float(n @ np.full(dim, 0.33)), "slip", carried)
    problem = drop.begun(DT, [wall])
    inside = wall.phi <= 0.0
    assert 5 < inside.sum() < len(x) - 5
    found = solve(problem, linear())
    assert found.converged
    np.testing.assert_allclose((found.velocity[inside] - carried) @ n, 0.0, atol=1e-13)
    # Forces of the wall are along its normal, what is left elsewhere is nothing.
    np.testing.assert_allclose(
        found.wall_forces, (found.wall_forces @ n)[:, None] * n, atol=10 * TOLERANCE * problem.force_scale
    )
    assert np.abs(found.wall_forces[~inside]).max() == 0.0
    assert np.abs(found.wall_forces[inside]).max() > 1e-3
    # Impulses balance: momentum gained is that of gravity and the wall.
    before, _ = drop.momentum(drop.velocity)
    after, _ = drop.momentum(found.velocity)
    gained = DT * (drop.mass.sum() * drop.gravity + found.wall_forces.sum(axis=0))
    np.testing.assert_allclose(after - before, gained, atol=1e-9)
    # It is a minimum among the motions that the wall allows.
    u = DT * found.velocity
    rng = np.random.default_rng(0)
    lowest = drop.objective(u, DT)
    for _ in range(20):
        other = 1e-4 * rng.standard_normal(u.shape)
        other[inside] -= (other[inside] @ n)[:, None] * n
        assert drop.objective(u + other, DT) > lowest


@pytest.mark.parametrize("dim", [2, 3])
def test_stick(dim: int) -> None:
    drop = start(dim)
    x = drop.stencils.positions
    wall = sphere(x, np.full(dim, 0.217), 0.22, "stick")
    found = solve(drop.begun(DT, [wall]))
    assert found.converged
    assert (wall.phi <= 0.0).sum() > 3
    assert np.abs(found.velocity[wall.phi <= 0.0]).max() < 1e-14


@pytest.mark.parametrize("dim", [2, 3])
def test_moving_wall_is_reached_where_nodes_stick(dim: int) -> None:
    drop = start(dim)
    x = drop.stencils.positions
    velocity = np.array([0.3, -0.4, 0.2])[:dim]
    wall = plane(x, oblique(dim), float(oblique(dim) @ np.full(dim, 0.33)), "stick", velocity)
    found = solve(drop.begun(DT, [wall]))
    assert found.converged
    held = found.velocity[wall.phi <= 0.0]
    np.testing.assert_allclose(held, np.broadcast_to(velocity, held.shape), atol=1e-13)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("shape", ["plane", "corner", "sphere"])
def test_separation_is_a_minimum_under_its_inequalities(dim: int, seed: int, shape: str) -> None:
    """Karush, Kuhn and Tucker: gaps, reactions, and one of them zero at every node."""
    drop = start(dim, seed=seed)
    x = drop.stencils.positions
    e = np.eye(dim)
    if shape == "sphere":
        walls = [sphere(x, np.full(dim, 0.217), 0.25, "separate")]
    else:
        walls = [plane(x, oblique(dim), float(oblique(dim) @ np.full(dim, 0.33)), "separate")]
    if shape == "corner":
        walls += [plane(x, e[0], 0.33, "separate", 0.1 * e[0]), plane(x, -e[1], -0.41, "slip")]
    problem = drop.begun(DT, walls)
    found = solve(problem)
    assert found.converged
    u = DT * found.velocity
    contact = problem.contact
    forces = problem.node_forces(problem.unknowns(u))
    small = 10.0 * TOLERANCE * problem.force_scale
    rows = ~contact.two_sided
    gaps, reactions = contact.gaps(u), contact.reactions(forces)
    assert gaps[rows].min() > -1e-10 * point_drop.SPACING - 1e-16
    assert np.abs(gaps[~rows]).max(initial=0.0) < 1e-15
    assert reactions[rows].min() > -small
    assert np.abs(gaps * reactions)[rows].max() < small * point_drop.SPACING
    # The reactions are all that holds the nodes.
    total = np.zeros_like(u)
    np.add.at(total, contact.nodes, reactions[:, None] * contact.normals)
    np.testing.assert_allclose(forces, total, atol=small)
    open_, closed = (gaps > 1e-8)[rows], (reactions > 1e-6)[rows]
    assert open_.any() or closed.any()


def test_nodes_are_let_go_and_held() -> None:
    """Some step needs more than one solve, nodes of both kinds exist, and the answer is that of the right set."""
    passes, freed, kept = [], 0, 0
    for seed in range(12):
        drop = start(2, seed=seed)
        x = drop.stencils.positions
        problem = drop.begun(DT, [sphere(x, np.array([0.217, 0.217]), 0.25, "separate")])
        found = solve(problem)
        assert found.converged
        passes.append(found.passes)
        kept += int((problem.contact.active == 1).sum())
        freed += int((problem.contact.active == 0).sum())
    assert max(passes) > 1
    assert max(passes) <= 6
    assert kept > 0
    assert freed > 0


def test_a_drop_that_leaves_its_wall_is_free() -> None:
    drop = start(2)
    drop.velocity[:] = [0.0, 5.0]
    drop.tension.coefficient[:] = 0.0
    drop.points.J[:], drop.points.F[:] = 1.0, np.eye(2)
    wall = plane(drop.stencils.positions, np.array([0.0, 1.0]), 0.4, "separate")
    problem = drop.begun(DT, [wall])
    found = solve(problem)
    assert not problem.contact.any
    np.testing.assert_allclose(
        found.velocity, np.broadcast_to([0.0, 5.0 - 9.81 * DT], found.velocity.shape), atol=1e-12
    )
    assert np.abs(found.wall_forces).max() == 0.0


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("friction", [0.05, 0.3, 1e6])
def test_friction(dim: int, friction: float) -> None:
    drop = start(dim)
    drop.velocity -= 2.0 * oblique(dim)
    x, n = drop.stencils.positions, oblique(dim)
    height = float(n @ np.full(dim, 0.33))
    carried = 0.3 * np.roll(n, 1)
    problem = drop.begun(DT, [plane(x, n, height, "separate", carried, friction)])
    found = solve(problem)
    smooth = solve(drop.begun(DT, [plane(x, n, height, "separate", carried)]))
    rows = problem.contact.active == 1
    nodes = problem.contact.nodes[rows]
    assert nodes.size > 4
    impulse = DT * (smooth.wall_forces[nodes] @ n) / drop.mass[nodes]
    before, after = smooth.velocity[nodes] - carried, found.velocity[nodes] - carried
    np.testing.assert_allclose(after @ n, before @ n, atol=1e-12)
    along_before = before - (before @ n)[:, None] * n
    along_after = after - (after @ n)[:, None] * n
    speed = np.linalg.norm(along_before, axis=1)
    expected = along_before * np.maximum(0.0, 1.0 - friction * np.maximum(impulse, 0.0) / speed)[:, None]
    np.testing.assert_allclose(along_after, expected, atol=1e-9)
    others = np.setdiff1d(np.arange(len(x)), nodes)
    np.testing.assert_array_equal(found.velocity[others], smooth.velocity[others])
    if friction == 1e6:
        assert np.abs(along_after).max() < 1e-9


def test_friction_at_an_edge_acts_along_the_edge_only() -> None:
    drop = start(3)
    drop.velocity -= [2.0, 2.0, 0.0]
    x, e = drop.stencils.positions, np.eye(3)
    walls = [plane(x, e[0], 0.35, "slip", 0.2 * e[0], 0.2), plane(x, e[1], 0.35, "slip")]
    problem = drop.begun(DT, walls)
    found = solve(problem)
    both = (walls[0].phi <= 0.0) & (walls[1].phi <= 0.0)
    assert both.sum() > 3
    expected = np.broadcast_to([0.2, 0.0], found.velocity[both, :2].shape)
    np.testing.assert_allclose(found.velocity[both, :2], expected, atol=1e-13)


def test_a_wall_without_normals_is_refused() -> None:
    drop = start(2)
    wall = sphere(drop.stencils.positions, np.full(2, 0.317), 0.25, "slip")
    wall.normals[np.argmin(wall.phi)] = np.nan
    with pytest.raises(ValueError, match="normal"):
        drop.begun(DT, [wall])


def test_axes_of_nodes() -> None:
    rng = np.random.default_rng(0)
    for dim in (2, 3):
        n = 30
        walls = []
        for kind in ("slip", "slip", "separate", "slip", "separate"):
            normals = rng.standard_normal((n, dim))
            normals /= np.linalg.norm(normals, axis=1)[:, None]
            walls.append(NodeWall(rng.standard_normal(n), normals, rng.standard_normal((n, dim)), kind))  # type: ignore[arg-type]
        contact = WallContact(walls, n, dim, DT, -np.ones((n, dim)))
        Q = contact.frames
        np.testing.assert_allclose(np.swapaxes(Q, 1, 2) @ Q, np.broadcast_to(np.eye(dim), Q.shape), atol=1e-13)
        u = np.einsum("iab,ib->ia", Q, np.where(contact.held, contact.shift, rng.standard_normal((n, dim))))
        np.testing.assert_allclose(contact.gaps(u)[contact.active == 1], 0.0, atol=1e-12)
        counts = np.bincount(contact.nodes[contact.active == 1], minlength=n)
        np.testing.assert_array_equal(contact.held.sum(axis=1), counts)
        assert counts.max() == dim
        # More walls than axes: some add nothing, and say so.
        assert ((contact.active == 2).any()) == (np.bincount(contact.nodes, minlength=n).max() > dim)
        forces = np.einsum("r,rc->rc", np.ones(len(contact.nodes)) * (contact.active == 1), contact.normals)
        total = np.zeros((n, dim))
        np.add.at(total, contact.nodes, forces)
        np.testing.assert_allclose(contact.reactions(total), (contact.active == 1).astype(float), atol=1e-9)
