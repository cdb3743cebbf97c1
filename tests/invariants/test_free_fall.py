"""Free fall, momentum and energy of backward Euler against its closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenario import Array, block, body, build, material, run, scene, step

G = 9.81
H = 0.01


def falling(what: dict[str, Any], steps: int, **more: Any) -> dict[str, Any]:
    dim = 3 if what["mesh"]["recipe"] != "block" else len(what["mesh"]["size"])
    return scene(
        {"b": what},
        gravity=[0.0, -G, 0.0][:dim],
        time={"scheme": "backward_euler", "dt": H, "end": steps * H},
        **more,
    )


SOLIDS = {
    f"{dim}d-p{order}-{mass}": body(block([1.0] * dim, [2, 1, 1][:dim]), element_order=order, mass=mass)
    for dim in (2, 3)
    for order in (1, 2)
    for mass in ("lumped", "consistent")
}
THIN = {
    f"{kind}-{mass}": body({"recipe": recipe, **mesh}, kind=kind, mass=mass, **measure)
    for mass in ("lumped", "consistent")
    for kind, recipe, mesh, measure in (
        ("membrane", "cloth", {"cells": [2, 1]}, {"thickness": 0.01}),
        ("rod", "rod", {"cells": 3}, {"cross_section": 0.01}),
    )
}


@pytest.mark.parametrize("name", [*SOLIDS, *THIN])
def test_free_fall_is_exact(name: str) -> None:
    """After n steps every node has fallen by g h^2 n (n + 1) / 2."""
    n = 20
    simulation = run(falling({**SOLIDS, **THIN}[name], n))
    u = simulation.state.x - simulation.discretization.points
    expected = np.zeros_like(u)
    expected[:, 1] = -G * H**2 * n * (n + 1) / 2.0
    np.testing.assert_allclose(u, expected, atol=1e-9)
    np.testing.assert_allclose(simulation.state.v[:, 1], -G * H * n, rtol=1e-8)
    mass = simulation.discretization.lumped_mass
    kinetic = 0.5 * mass.sum() * (G * H * n) ** 2
    assert simulation.problem.kinetic_energy(simulation.state.v) == pytest.approx(kinetic, rel=1e-7)


@pytest.mark.parametrize("name", [*SOLIDS, *THIN])
def test_mass_is_density_times_volume(name: str) -> None:
    simulation = build(falling({**SOLIDS, **THIN}[name], 1))
    volume = 1.0 if name in SOLIDS else 0.01
    discretization = simulation.discretization
    for mass in (discretization.lumped_mass, discretization.row_mass):
        assert mass.sum() == pytest.approx(1000.0 * volume, rel=1e-12)
    assert discretization.lumped_mass.min() > 0.0
    if discretization.consistent_mass is not None:
        assert discretization.consistent_mass.sum() == pytest.approx(1000.0 * volume, rel=1e-12)


# ------------------------------------------------------------------------------------------- conservation


def tumbling(dim: int, order: int, mass: str, law: str = "neo_hookean") -> dict[str, Any]:
    """Two free bodies, thrown and spinning so fast that they deform."""
    spin: Any = 20.0 if dim == 2 else [5.0, -20.0, 8.0]
    stuff = material(law, E=2e4, nu=0.3)
    bodies = {
        name: body(
            block([1.0, 0.5, 0.4][:dim], [2, 1, 1][:dim], translate=[shift, 0.0, 0.0][:dim]),
            stuff,
            element_order=order,
            mass=mass,
        )
        for name, shift in (("a", 0.0), ("b", 3.0))
    }
    return scene(
        bodies,
        {"kind": "initial_velocity", "on": "a", "velocity": [1.0, 2.0, 3.0][:dim], "angular_velocity": spin},
        {"kind": "initial_velocity", "on": "b.right", "velocity": [4.0, -2.0, 1.0][:dim]},
        time={"scheme": "backward_euler", "dt": 0.005, "end": 1.0},
        solver={"tolerance": 1e-12},
    )


def momentum_of(apply_mass: Any, v: Array) -> Array:
    return np.asarray(apply_mass(v).sum(axis=0))


def moment(x: Array, p: Array) -> Array:
    """Sum of x cross p, as the skew matrix sum (x p^T - p x^T): in 2D and 3D alike."""
    product = np.einsum("ia,ib->ab", x, p)
    return np.asarray(product - product.T)


@pytest.mark.parametrize(("dim", "order"), [(2, 1), (3, 1), (3, 2)])
@pytest.mark.parametrize("mass", ["lumped", "consistent"])
def test_momentum(dim: int, order: int, mass: str) -> None:
    """Linear momentum stays; angular momentum changes by h sum v_new x M v_old, backward Euler's own loss."""
    simulation = build(tumbling(dim, order, mass))
    M = simulation.problem.apply_mass
    h = 0.005
    start = momentum_of(M, simulation.state.v)
    deformation = 0.0
    for _ in range(10):
        x, v = simulation.state.x, simulation.state.v
        step(simulation)
        new_x, new_v = simulation.state.x, simulation.state.v
        change = moment(new_x, M(new_v)) - moment(x, M(v))
        np.testing.assert_allclose(change, h * moment(new_v, M(v)), atol=1e-8 * np.abs(moment(x, M(v))).max())
        deformation = max(deformation, simulation.problem.elastic_energy(new_x))
    np.testing.assert_allclose(momentum_of(M, simulation.state.v), start, rtol=1e-9)
    assert deformation > 1e-2 * simulation.problem.kinetic_energy(simulation.state.v)


def energy(simulation: Any) -> float:
    problem, state = simulation.problem, simulation.state
    return float(problem.kinetic_energy(state.v) + problem.elastic_energy(state.x) + problem.load_potential(state.x))


@pytest.mark.parametrize(("dim", "order"), [(2, 2), (3, 1)])
@pytest.mark.parametrize("mass", ["lumped", "consistent"])
def test_energy_of_a_linear_body(dim: int, order: int, mass: str) -> None:
    """A convex energy: the loss of a step is 1/2 |dv|^2 in the mass plus 1/2 |dx|^2 in the stiffness, exactly."""
    size, cells = [1.0, 0.25, 0.25][:dim], [4, 1, 1][:dim]
    data = scene(
        {"b": body(block(size, cells), material("linear", E=1e5), element_order=order, mass=mass)},
        {"kind": "fixed", "on": "b.left"},
        {"kind": "initial_velocity", "on": "b.right", "velocity": [0.0, 3.0, -1.0][:dim]},
        gravity=[0.0, -G, 0.0][:dim],
        time={"scheme": "backward_euler", "dt": 0.02, "end": 1.0},
        solver={"tolerance": 1e-13},
    )
    simulation = build(data)
    problem = simulation.problem
    problem.set_loads(0.0)
    # The support holds from the first step on.
    simulation.state.v[~problem.free] = 0.0
    X = simulation.discretization.points
    for _ in range(20):
        before, x, v = energy(simulation), simulation.state.x, simulation.state.v
        step(simulation)
        dx, dv = simulation.state.x - x, simulation.state.v - v
        loss = problem.kinetic_energy(dv) + problem.elastic_energy(X + dx)
        assert before - energy(simulation) == pytest.approx(loss, rel=1e-7)
        assert loss > 0.0


def test_energy_of_a_nonlinear_body_goes_down() -> None:
    simulation = build(tumbling(3, 1, "lumped"))
    energies = [energy(simulation)]
    for _ in range(30):
        step(simulation)
        energies.append(energy(simulation))
    assert np.all(np.diff(energies) < 0.0)


@pytest.mark.parametrize("dim", [2, 3])
def test_spin_of_a_stiff_body(dim: int) -> None:
    """Backward Euler slows a rigid spin: tan t' = sin t / (2 - cos t) a step."""
    h, steps = 0.01, 30
    data = scene(
        {"b": body(block([1.0, 1.0, 0.5][:dim], [2, 2, 1][:dim]), material(E=1e9))},
        {"kind": "initial_velocity", "on": "b", "angular_velocity": 10.0 if dim == 2 else [0.0, 0.0, 10.0]},
        time={"scheme": "backward_euler", "dt": h, "end": steps * h},
        solver={"tolerance": 1e-10},
    )
    simulation = run(data)
    X = simulation.discretization.points - simulation.discretization.points.mean(axis=0)
    x = simulation.state.x - simulation.state.x.mean(axis=0)
    A = np.einsum("ia,ib->ab", x[:, :2], X[:, :2])
    angle = np.arctan2(A[1, 0] - A[0, 1], A[0, 0] + A[1, 1])
    turn, expected = np.arctan(10.0 * h), 0.0
    for _ in range(steps):
        expected += turn
        turn = np.arctan2(np.sin(turn), 2.0 - np.cos(turn))
    assert expected == pytest.approx(2.65202, abs=1e-5)
    assert angle == pytest.approx(expected, abs=1e-4)
