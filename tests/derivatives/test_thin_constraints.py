"""Constraints of membranes and rods: gradients by differences, rest values, Young's modulus, invariance."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenario import body, build, difference_gradient, material, random_state, rotation, scene, term_gradient

from femdeform.errors import InputError
from femdeform.fem.thin_constraints import (
    ThinConstraintEnergy,
    ThinConstraints,
    enclosed_volume,
    hinge_angles,
    make_constraints,
    volume_gradient,
)
from femdeform.fem.thin_kernels import (
    BENDING,
    BOW,
    DISTANCE,
    FLEX_X,
    FLEX_Y,
    FLEX_Z,
    TETHER,
    add_weighted,
    hinge,
)
from femdeform.run.setup import Simulation
from femdeform.scene.thin_schema import RodConstraints

Array = NDArray[np.float64]
CLOTH = {"recipe": "cloth", "size": [1.0, 0.7], "cells": [4, 3]}
BALL = {"recipe": "sphere_surface", "radius": 0.5, "element_size": 0.3}
ROPE = {"recipe": "rod", "end": [0.0, -1.0, 0.0], "cells": 8}


def thin(mesh: dict[str, Any], constraints: dict[str, Any], **more: Any) -> Simulation:
    rod = mesh["recipe"] in ("rod", "rod_net")
    kind = {"kind": "rod", "cross_section": 1e-4} if rod else {"kind": "membrane", "thickness": 1e-3}
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


NET = {"recipe": "rod_net", "size": [1.0, 0.8], "meshes": [2, 2], "segments": 2}


CASES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "rope": (ROPE, {}),
    "bending rope": (ROPE, {"edges": 1e3, "bending_stiffness": 0.5}),
    "bending net": (NET, {"edges": 1e3, "bending_stiffness": 0.5}),
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


def arc(n: int = 6, radius: float = 2.0, uneven: bool = True) -> Array:
    """Nodes of a polyline along a quarter of a circle."""
    angle = np.linspace(0.0, 0.5 * np.pi, n)
    if uneven:
        angle[1:-1] += 0.05 * np.random.default_rng(1).uniform(-1, 1, n - 2)
    return radius * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)


def bends_of(points: Array, edges: Array, stiffness: float = 0.5) -> ThinConstraints:
    options = RodConstraints(edges=1e9, bending_stiffness=stiffness)
    return make_constraints("r", options, points, edges, 1e-4, 2e5, None)


def energy_and_forces(c: ThinConstraints, x: Array) -> tuple[float, Array]:
    out = np.zeros_like(x)
    none = np.zeros(c.kinds.size)
    return float(add_weighted(c.kinds, c.nodes, c.rests, c.shares, c.stiffness, none, x, out)), out


def test_a_curved_rod_by_differences() -> None:
    """Of its curvature at rest, in any direction: nothing twists."""
    points = arc()
    edges = np.stack([np.arange(5), np.arange(1, 6)], axis=1)
    c = bends_of(points, edges)
    assert np.count_nonzero(c.kinds == BOW) == 4
    assert not np.isin(c.kinds, (FLEX_X, FLEX_Y, FLEX_Z)).any()
    assert np.abs(energy_and_forces(c, points @ rotation(3).T)[1]).max() < 1e-12
    for amplitude in (0.02, 0.2):
        x = random_state(points, amplitude)
        _, forces = energy_and_forces(c, x)
        expected = difference_gradient(lambda y: energy_and_forces(c, y)[0], x, 1e-6)
        np.testing.assert_allclose(forces, expected, atol=1e-7 * np.abs(forces).max())
        assert np.abs(forces.sum(axis=0)).max() < 1e-12 * np.abs(forces).max()
        assert np.abs(np.cross(x, forces).sum(axis=0)).max() < 1e-12 * np.abs(forces).max()


def test_bending_energy_of_an_arc_is_that_of_its_curvature() -> None:
    """B length / (2 r^2) for a straight rod bent to radius r, to second order; a rod made as the arc has none."""
    errors = []
    for n in (11, 21):
        angle = np.linspace(0.0, 0.5 * np.pi, n)
        straight = np.stack([2.0 * angle, 0.0 * angle, 0.0 * angle], axis=1)
        edges = np.stack([np.arange(n - 1), np.arange(1, n)], axis=1)
        c = bends_of(straight, edges, 0.7)
        bent = arc(n, uneven=False)
        energy, _ = energy_and_forces(c, bent)
        stretch = 0.5 * 1e-9 * np.sum((np.linalg.norm(np.diff(bent, axis=0), axis=1) - np.pi / (n - 1)) ** 2)
        # Half an edge at each end does not bend.
        length = np.pi * (1.0 - 1.0 / (n - 1))
        errors.append((energy - stretch) / (0.7 * length / (2.0 * 2.0**2)) - 1.0)
        assert energy_and_forces(bends_of(bent, edges), bent)[0] < 1e-20
    assert abs(errors[0]) < 0.01
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.05)


def test_which_edges_of_a_net_go_on_in_one_another() -> None:
    """Two at inner nodes of a wire whatever their angle; at crossings only those that are nearly straight."""
    c = term_of(thin(NET, {"bending_stiffness": 1.0})).constraints
    points = thin(NET, {}).discretization.points
    triples = c.nodes[c.kinds == FLEX_X][:, :3]
    degrees = np.bincount(c.nodes[c.kinds == DISTANCE][:, :2].ravel(), minlength=len(points))
    found = np.bincount(triples[:, 1], minlength=len(points))
    # Corners of the net are nodes of two edges, too: they are curved, and keep their angle.
    corners = np.unique(c.nodes[c.kinds == BOW][:, 1])
    assert corners.size == 4
    straight = np.setdiff1d(np.flatnonzero(degrees == 2), corners)
    assert (found[straight] == 1).all()
    assert (found[degrees == 3] == 1).all()
    assert (found[degrees == 4] == 2).all()
    assert {2, 3, 4} == set(degrees.tolist())
    for a, b, d in triples:
        np.testing.assert_allclose(points[a] + points[d], 2.0 * points[b], atol=1e-12)


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
