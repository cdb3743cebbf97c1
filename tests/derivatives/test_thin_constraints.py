"""Constraints of membranes and rods: gradients by differences, rest values, Young's modulus, invariance."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenario import body, build, difference_gradient, material, random_state, rotation, scene, term_gradient

from femdeform.errors import InputError
from femdeform.fem.thin_constraints import ThinConstraintEnergy, enclosed_volume, hinge_angles, volume_gradient
from femdeform.fem.thin_kernels import BENDING, TETHER, hinge
from femdeform.run.setup import Simulation

Array = NDArray[np.float64]
CLOTH = {"recipe": "cloth", "size": [1.0, 0.7], "cells": [4, 3]}
BALL = {"recipe": "sphere_surface", "radius": 0.5, "element_size": 0.3}
ROPE = {"recipe": "rod", "end": [0.0, -1.0, 0.0], "cells": 8}


def thin(mesh: dict[str, Any], constraints: dict[str, Any], **more: Any) -> Simulation:
    kind = (
        {"kind": "rod", "cross_section": 1e-4} if mesh["recipe"] == "rod" else {"kind": "membrane", "thickness": 1e-3}
    )
    stuff = material("fixed_corotated", E=2e5, density=300.0)
    return build(
        scene(
            {"c": body(mesh, stuff, constraints=constraints, **kind)},
            **{"solver": {"method": "xpbd"}, **more},
        )
    )


def term_of(simulation: Simulation) -> ThinConstraintEnergy:
    (term,) = simulation.problem.elastic
    assert isinstance(term, ThinConstraintEnergy)
    return term


CASES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "rope": (ROPE, {}),
    "edges": (CLOTH, {"edges": 1e-3}),
    "tether": (CLOTH, {"edges": 1.0, "tether": {"to": "left_back", "compliance": 1e-3}}),
    "bending": (CLOTH, {"edges": 1e3, "bending": 0.5}),
    "volume": (BALL, {"edges": 1e3, "volume": {"compliance": 1e-4, "ratio": 1.3}}),
    "all": (BALL, {"bending": 2.0, "volume": {"compliance": 1e-4}}),
}


@pytest.mark.parametrize("name", list(CASES))
def test_forces_by_differences(name: str) -> None:
    simulation = thin(*CASES[name])
    term = term_of(simulation)
    points = simulation.discretization.points
    for amplitude in (0.02, 0.1):
        x = random_state(points, amplitude)
        found = term_gradient(term, x)
        expected = difference_gradient(term.value, x, 1e-6)
        assert np.abs(found).max() > 0.0
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-7 * np.abs(found).max())


@pytest.mark.parametrize("name", list(CASES))
def test_no_force_at_rest_nor_moved_rigidly(name: str) -> None:
    """But for what is inflated: rest values are those of the mesh."""
    mesh, constraints = CASES[name]
    if "volume" in constraints:
        constraints = {**constraints, "volume": {"compliance": 1e-4}}
    simulation = thin(mesh, constraints)
    points = simulation.discretization.points
    moved = points @ rotation(3).T + [0.3, -2.0, 5.0]
    force = np.abs(term_gradient(term_of(simulation), random_state(points, 0.05))).max()
    for x in (points, moved):
        assert np.abs(term_gradient(term_of(simulation), x)).max() <= 1e-10 * force
    bent = random_state(moved, 0.05)
    turned = bent @ rotation(3, seed=4).T
    assert term_of(simulation).value(turned) == pytest.approx(term_of(simulation).value(bent), rel=1e-9)


def test_the_angle_of_a_hinge() -> None:
    """Every angle from -pi to pi, its sign, and gradients by differences."""
    quads = np.arange(4)[None]
    for angle in np.linspace(-3.0, 3.0, 13):
        x = np.array([[0, 0, 0], [0, 1.0, 0], [-0.7, 0.3, 0], [0.9 * np.cos(angle), 0.4, 0.9 * np.sin(angle)]])
        x = x @ rotation(3).T + 1.0
        found, *gradients = hinge(*(tuple(p) for p in x))
        assert abs(found) == pytest.approx(abs(angle), abs=1e-12)
        np.testing.assert_allclose(hinge_angles(x, quads), found, atol=1e-12)
        expected = difference_gradient(lambda y: float(hinge_angles(y, quads)[0]), x, 1e-6)
        np.testing.assert_allclose(gradients, expected, atol=1e-8)
    signs = {
        float(np.sign(hinge((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.5, 0.0), (1.0, 0.5, z))[0])) for z in (-0.3, 0.3)
    }
    assert signs == {-1.0, 1.0}


def test_a_collapsed_hinge_has_no_force() -> None:
    flat = hinge((0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.5, 0.0), (1.0, 0.5, 0.0))
    assert all(np.all(np.asarray(part) == 0.0) for part in flat)


def test_the_volume_of_a_sphere() -> None:
    simulation = thin(*CASES["volume"])
    term = term_of(simulation)
    points = simulation.discretization.points
    inside = enclosed_volume(points, term.constraints.surface)
    assert 0.85 < inside / (np.pi / 6.0) < 1.0
    assert term.constraints.volume == pytest.approx(1.3 * inside)
    gradient = volume_gradient(points, term.constraints.surface)
    expected = difference_gradient(lambda x: enclosed_volume(x, term.constraints.surface), points, 1e-6)
    np.testing.assert_allclose(gradient, expected, atol=1e-9)


def test_youngs_modulus_of_edges() -> None:
    """A rope is exact, E A strain; an equilateral net is that of its material for nu = 1/3 in plane stress."""
    simulation = thin(ROPE, {})
    stretched = simulation.discretization.points * [1.0, 1.01, 1.0]
    force = term_gradient(term_of(simulation), stretched)[:, 1]
    assert np.abs(force).max() == pytest.approx(2e5 * 1e-4 * 0.01)
    term = term_of(thin(CLOTH, {}))
    c = term.constraints
    # 2e5 Pa, 1 mm: the inner edges along an axis have two triangles of half a cell each.
    cell = (1.0 / 4) * (0.7 / 3)
    inner = np.isclose(c.rests, 0.25)
    assert c.stiffness[inner].max() == pytest.approx(2e5 * 1e-3 * cell / 0.25**2)


def test_tethers_reach_along_the_edges() -> None:
    simulation = thin(CLOTH, {"tether": {"to": "left_back", "compliance": 1e-3, "slack": 1.1}})
    c, points = term_of(simulation).constraints, simulation.discretization.points
    own = c.kinds == TETHER
    (anchor,) = np.unique(c.nodes[own, 1])
    assert np.count_nonzero(own) == len(points) - 1
    straight = np.linalg.norm(points[c.nodes[own, 0]] - points[anchor], axis=1)
    assert (c.rests[own] >= 1.1 * straight - 1e-12).all()
    assert (c.rests[own] < 1.1 * 1.5 * straight).all()
    assert not (c.kinds == BENDING).any()


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(InputError, match="not closed"):
        thin(CLOTH, {"volume": {"compliance": 1e-4}})
    for solver in ({"method": "projected_newton"}, {"method": "xpbd", "keep_primary_residual": True}):
        with pytest.raises(InputError, match="are for the methods xpbd and pbd"):
            thin(CLOTH, {}, solver=solver)
    simulation = thin(CLOTH, {})
    with pytest.raises(InputError, match="are for the methods"):
        simulation.problem.hessian(simulation.state.x, project=True)
