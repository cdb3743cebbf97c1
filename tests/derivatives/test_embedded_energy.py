"""Derivatives of the step function over grid nodes, and what it must reproduce exactly."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scenario

from femdeform.mpm.embedded_potential import EmbeddedPotential
from femdeform.run.setup import Simulation

CASES = [(kernel, dim) for kernel in ("linear", "quadratic") for dim in (2, 3)]


def build(kernel: str, dim: int, *conditions: dict[str, Any], law: str = "neo_hookean", **more: Any) -> Simulation:
    """Two blocks in one grid, the second of another material, at odd places."""
    size, cells = ([0.4, 0.2, 0.2][:dim], [3, 2, 2][:dim])
    first = scenario.block(size, cells, translate=[0.13, 0.07, -0.21][:dim])
    second = scenario.block(size, cells, translate=[0.17, 0.31, -0.19][:dim])
    bodies = {
        "a": scenario.body(first, scenario.material(law)),
        "b": scenario.body(second, scenario.material("fixed_corotated", E=3e4, density=700.0)),
    }
    more.setdefault("gravity", [1.0, -9.81, 2.0][:dim])
    grid = {"cell_size": 0.15, "kernel": kernel, **more.pop("grid", {})}
    return scenario.build(scenario.scene(bodies, *conditions, grid=grid, **more))


def begun(simulation: Simulation, dt: float = 0.01) -> tuple[EmbeddedPotential, np.ndarray]:
    problem = simulation.problem
    assert isinstance(problem, EmbeddedPotential)
    problem.begin_step(simulation.state, dt)
    return problem, problem.solver_state(simulation.state).x


@pytest.mark.parametrize(("kernel", "dim"), CASES)
@pytest.mark.parametrize("walls", ["separating", "slip", "sticky"])
def test_gradient_and_hessian(kernel: str, dim: int, walls: str) -> None:
    obstacles = [
        {"kind": "plane", "point": [0.0] * dim, "normal": [0.3, 1.0, 0.2][:dim], "velocity": [0.0, 0.2, 0.1][:dim]},
        {"kind": "sphere", "center": [0.6, 0.4, 0.0][:dim], "radius": 0.2},
    ]
    held = {"kind": "translate", "on": "a.left", "velocity": [0.1, 0.2, 0.0][:dim], "components": ["x", "y"]}
    load = {"kind": "pressure", "on": "b.top", "value": 300.0}
    simulation = build(kernel, dim, held, load, obstacles=obstacles, grid={"obstacles": walls})
    problem, y0 = begun(simulation)
    assert (~problem.free).any()
    assert (problem.rows is None) == (walls == "sticky")
    y = scenario.random_state(y0, 0.01)
    problem.linearize_at(y0)
    gradient = problem.full_gradient(y)
    direction = np.random.default_rng(1).standard_normal(y.shape)
    size = float(np.abs(gradient).max())

    # Pressure is the derivative of its work only along the straight line from where it is linearised: that is y - y0.
    for d in (y - y0, direction):
        if d is direction:
            problem.mesh.pressures[0].pressure = 0.0
            gradient = problem.full_gradient(y)
        h = 1e-6 / np.abs(d).max()
        slope = (problem.value(y + h * d) - problem.value(y - h * d)) / (2.0 * h)
        assert slope == pytest.approx(float(np.vdot(gradient, d)), rel=1e-6, abs=1e-6 * size)
    K = scenario.dense_hessian(problem, y, project=False, everything=True)
    np.testing.assert_allclose(K, K.T, atol=1e-12 * np.abs(K).max())
    numeric = (problem.full_gradient(y + 1e-7 * direction) - problem.full_gradient(y - 1e-7 * direction)) / 2e-7
    product = (K @ direction.ravel()).reshape(y.shape)
    np.testing.assert_allclose(product, numeric, atol=2e-6 * np.abs(product).max())
    projected = scenario.dense_hessian(problem, y, project=True, everything=True)
    assert np.linalg.eigvalsh(projected).min() > -1e-9 * np.abs(projected).max()
    np.testing.assert_allclose(
        problem.hessian_times(y, direction),
        (projected @ direction.ravel()).reshape(y.shape),
        atol=1e-9 * np.abs(K).max(),
    )


@pytest.mark.parametrize(("kernel", "dim"), CASES)
def test_residual_is_that_of_the_meshes_gathered_at_the_grid(kernel: str, dim: int) -> None:
    simulation = build(kernel, dim)
    problem, y0 = begun(simulation)
    W = problem.stencils.to_points(np.eye(problem.stencils.n_nodes))
    y = scenario.random_state(y0, 0.01)
    mesh = problem.mesh.internal_forces(W @ y) - problem.mesh.load
    inertia = problem.lumped_mass[:, None] * (y - y0) / 0.01**2
    expected = W.T @ mesh + inertia
    np.testing.assert_allclose(problem.full_gradient(y), expected, atol=1e-12 * np.abs(expected).max())
    np.testing.assert_allclose(problem.lumped_mass, W.T @ simulation.discretization.lumped_mass, atol=1e-12)


@pytest.mark.parametrize(("kernel", "dim"), CASES)
def test_affine_motion_of_the_grid_is_that_of_the_bodies(kernel: str, dim: int) -> None:
    simulation = build(kernel, dim)
    problem, y0 = begun(simulation)
    F = np.eye(dim) + 0.2 * np.random.default_rng(2).standard_normal((dim, dim))
    x = problem.node_positions(y0 @ F.T + 0.1)
    np.testing.assert_allclose(x, simulation.discretization.points @ F.T + 0.1, atol=1e-14)
    for term in problem.elastic:
        cells = x[term.group.cells]
        found = np.einsum("eac,eab->ecb", cells, term.group.gradients[:, 0])
        np.testing.assert_allclose(found, np.broadcast_to(F, found.shape), atol=1e-12)


@pytest.mark.parametrize(("kernel", "dim"), CASES)
def test_rigid_motion_costs_nothing(kernel: str, dim: int) -> None:
    simulation = build(kernel, dim, gravity=[0.0] * dim)
    problem, y0 = begun(simulation)
    Q = scenario.rotation(dim)
    y = y0 @ Q.T + 0.3
    forces = problem.mesh.internal_forces(problem.node_positions(y))
    K = scenario.dense_hessian(problem, y, project=False, everything=True)
    assert np.abs(forces).max() < 1e-12 * np.abs(K).max()
    # Inertia apart, small rigid motions at rest are free too.
    stiff = scenario.dense_hessian(problem, y0, project=False, everything=True)
    stiff -= np.diag(np.repeat(problem.lumped_mass / 0.01**2, dim))
    turn = np.zeros((dim, dim))
    turn[0, 1], turn[1, 0] = -1.0, 1.0
    for motion in (np.ones_like(y0), y0 @ turn.T):
        assert np.abs(stiff @ motion.ravel()).max() < 1e-11 * np.abs(stiff).max()


@pytest.mark.parametrize(("kernel", "dim"), CASES)
def test_patch(kernel: str, dim: int) -> None:
    """Under a uniform deformation no force acts at grid nodes that only weigh nodes inside a body."""
    mesh = scenario.block([0.8] * dim, [8] * dim, translate=[0.03] * dim)
    simulation = scenario.build(scenario.scene({"a": scenario.body(mesh)}, grid={"cell_size": 0.12, "kernel": kernel}))
    problem, y0 = begun(simulation)
    F = np.eye(dim) + 0.2 * np.random.default_rng(3).standard_normal((dim, dim))
    positions = problem.node_positions(y0 @ F.T)
    forces = problem.stencils.to_nodes(problem.mesh.internal_forces(positions))
    X = simulation.discretization.points
    edge = np.flatnonzero((np.abs(X - 0.43) > 0.4 - 1e-9).any(axis=1))
    inside = np.setdiff1d(np.arange(len(y0)), problem.stencils.nodes_of(edge))
    assert inside.size >= 4**dim
    size = np.abs(forces).max()
    assert size > 1.0
    assert np.abs(forces[inside]).max() < 1e-11 * size
