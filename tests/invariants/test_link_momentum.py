"""Links between free bodies conserve momentum: their forces add up to nothing, and those along a line turn nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenario import Array, block, body, build, material, random_state, rotation, scene, step, term_gradient

from femdeform.run.setup import Simulation


def surfaces(**more: Any) -> dict[str, Any]:
    return {"kind": "tie", "on": "b.left", "to": "a.right", "max_distance": 0.2, "stiffness": 1e4, **more}


def ends(dim: int) -> list[dict[str, Any]]:
    return [{"at": [0.31, 0.13, 0.07][:dim], "body": "a"}, {"at": [1.45, 0.2, 0.1][:dim], "body": "b"}]


LINKS = {
    "tie": lambda dim: surfaces(),
    "tie-closed": lambda dim: surfaces(gap="closed"),
    "tie-by-area": lambda dim: surfaces(per="area"),
    "binding": lambda dim: {"kind": "binding", "on": "b", "to": "a", "within": 0.2, "stiffness": 1e5},
    "spring": lambda dim: {"kind": "spring", "ends": ends(dim), "stiffness": 300.0, "length": 0.8},
    "pair": lambda dim: {"kind": "pair", "ends": ends(dim), "stiffness": 300.0},
}
# Their forces add up to nothing, but act along lines that need not pass through both points.
LINEAR_ONLY = {
    "tie-with-normals": lambda dim: surfaces(tangential_stiffness=10.0),
    "pair-kept": lambda dim: {"kind": "pair", "ends": ends(dim), "stiffness": 300.0, "gap": "kept"},
}


def free_bodies(dim: int, link: dict[str, Any], order: int = 1) -> Simulation:
    first = body(block([1.0, 0.5, 0.4][:dim], [2, 2, 1][:dim]), element_order=order)
    second = body(
        block([0.6, 0.5, 0.4][:dim], [1, 3, 2][:dim], translate=[1.1, 0.03, -0.02][:dim]),
        material(E=4e4, density=700.0),
        element_order=order,
    )
    velocity = {"kind": "initial_velocity", "on": "a", "velocity": [0.4, -0.3, 0.2][:dim]}
    spin = {"kind": "initial_velocity", "on": "b", "angular_velocity": 2.0 if dim == 2 else [0.5, -1.0, 2.0]}
    return build(scene({"a": first, "b": second}, velocity, spin, links={"l": link}, solver={"tolerance": 1e-10}))


def link_forces(simulation: Simulation, x: Array) -> Array:
    links = simulation.problem.links
    assert links is not None
    links.begin_step(x, 0.1)
    return np.sum([term_gradient(term, x) for term in links.terms], axis=0)


def torque(x: Array, force: Array) -> Array:
    spread = np.zeros((2, len(x), 3))
    spread[0, :, : x.shape[1]], spread[1, :, : x.shape[1]] = x, force
    return np.asarray(np.cross(spread[0], spread[1]).sum(axis=0))


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("name", [*LINKS, *LINEAR_ONLY])
def test_forces_balance(name: str, order: int, dim: int) -> None:
    simulation = free_bodies(dim, {**LINKS, **LINEAR_ONLY}[name](dim), order)
    x = random_state(simulation.discretization.points, 0.05, seed=1) + 0.3
    force = link_forces(simulation, x)
    size = np.abs(force).sum()
    assert size > 1.0
    np.testing.assert_allclose(force.sum(axis=0), 0.0, atol=1e-13 * size)
    if name in LINKS:
        np.testing.assert_allclose(torque(x, force), 0.0, atol=1e-13 * size)
    else:
        assert np.abs(torque(x, force)).max() > 1e-4 * size


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", ["tie", "tie-by-area", "binding", "spring", "tie-with-normals"])
def test_rigid_motion_stores_no_energy(name: str, dim: int) -> None:
    """A gap that is kept turns with the bodies: two that move as one are without force."""
    link = {**LINKS, **LINEAR_ONLY}[name](dim)
    link.pop("length", None)
    simulation = free_bodies(dim, link)
    start = simulation.discretization.points
    moved = start @ rotation(dim, 2).T + 0.7
    force = link_forces(simulation, moved)
    links = simulation.problem.links
    assert links is not None
    assert links.gap(moved) < 1e-14
    assert np.abs(force).max() < 1e-9


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("name", [*LINKS, *LINEAR_ONLY])
def test_linear_momentum_of_a_run(name: str, dim: int) -> None:
    simulation = free_bodies(dim, {**LINKS, **LINEAR_ONLY}[name](dim))
    masses = simulation.discretization.lumped_mass[:, None]
    before = (masses * simulation.state.v).sum(axis=0)
    for _ in range(10):
        step(simulation)
    after = (masses * simulation.state.v).sum(axis=0)
    links = simulation.problem.links
    assert links is not None
    assert links.energy(simulation.state.x) > 1e-3
    np.testing.assert_allclose(after, before, atol=1e-9 * np.abs(masses * simulation.state.v).sum())
