"""Stresses of the output against closed forms, in the plane and across it."""

from __future__ import annotations

import numpy as np
import pytest
from scenario import block, body, build, material, quasistatic, scene

from femdeform.fem.fields import cell_field

STRAIN = 1.0e-6


@pytest.mark.parametrize("law", ["linear", "neo_hookean", "stable_neo_hookean", "corotated"])
@pytest.mark.parametrize("order", [1, 2])
def test_small_plane_strain_has_a_stress_across_the_plane(law: str, order: int) -> None:
    E, nu = 1.0e5, 0.3
    deck = scene({"b": body(block([1.0, 1.0], [2, 2]), material(law, E, nu), element_order=order)}, time=quasistatic())
    simulation = build(deck)
    x = simulation.state.x * np.array([1.0 + STRAIN, 1.0])
    mu, lmbda = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))
    expected = np.diag([lmbda + 2 * mu, lmbda, lmbda]) * STRAIN
    for name in ("cauchy_stress", "pk1"):
        stress = cell_field(name, simulation.problem.elastic[0], x).reshape(-1, 3, 3)
        np.testing.assert_allclose(stress, np.broadcast_to(expected, stress.shape), atol=1e-4 * lmbda * STRAIN)
    von_mises = cell_field("von_mises", simulation.problem.elastic[0], x)
    np.testing.assert_allclose(von_mises, 2 * mu * STRAIN, rtol=1e-4)


def test_plane_strain_is_the_block_held_across_the_plane() -> None:
    flat = build(scene({"b": body(block([1.0, 1.0], [2, 2]), material())}, time=quasistatic()))
    solid = build(scene({"b": body(block([1.0, 1.0, 1.0], [2, 2, 2]), material())}, time=quasistatic()))
    planar, spatial = flat.problem.elastic[0], solid.problem.elastic[0]
    a = cell_field("cauchy_stress", planar, flat.state.x * np.array([1.5, 0.8]))
    b = cell_field("cauchy_stress", spatial, solid.state.x * np.array([1.5, 0.8, 1.0]))
    np.testing.assert_allclose(a[0], b[0], rtol=1e-12, atol=1e-9)
