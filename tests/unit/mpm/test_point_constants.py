"""Explicit stresses of points whose constants differ from point to point."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from femdeform.materials.fixed_corotated import FixedCorotated
from femdeform.materials.neo_hookean import NeoHookean
from femdeform.mpm.explicit_laws import Liquid
from femdeform.mpm.group_step import stresses
from femdeform.mpm.particles import LIQUID, SOLID, Particles
from femdeform.mpm.point_terms import PointMaterials


def mixture(dim: int, n: int = 24) -> tuple[Particles, PointMaterials, np.ndarray]:
    """Points of four bodies, half of each liquid, their constants, and velocity gradients."""
    rng = np.random.default_rng(3)
    points = Particles.at(rng.uniform(0.0, 1.0, (n, dim)), np.ones(n), rng.uniform(1.0, 2.0, n))
    points.body[:] = np.arange(n) % 4
    points.phase[:] = np.where(np.arange(n) < n // 2, SOLID, LIQUID)
    points.J[:] = rng.uniform(0.8, 1.2, n)
    points.F[:] = np.eye(dim) + 0.2 * rng.standard_normal((n, dim, dim))
    moduli = rng.uniform(1.0, 9.0, (n, 2))
    moduli[points.body == 3] = np.nan  # keep those of their law
    materials = PointMaterials({}, rng.uniform(10.0, 90.0, n), rng.uniform(0.1, 0.9, n), moduli)
    return points, materials, rng.standard_normal((n, dim, dim))


@pytest.mark.parametrize("law", [FixedCorotated, NeoHookean])
@pytest.mark.parametrize("dim", [2, 3])
def test_each_point_has_the_stress_of_its_own_law(dim: int, law: Any) -> None:
    points, materials, gradient = mixture(dim)
    kept = law.from_lame(5.0, 7.0, dim)
    laws = {
        (body, phase): kept if phase == SOLID else Liquid(1.0, 1.0) for body in range(4) for phase in (SOLID, LIQUID)
    }
    found = stresses(points, laws, gradient, materials)
    assert materials.moduli is not None
    for p in range(points.n):
        body, mu, lmbda = int(points.body[p]), *materials.moduli[p]
        own = {
            (body, SOLID): kept if body == 3 else law.from_lame(mu, lmbda, dim),
            (body, LIQUID): Liquid(materials.bulk_modulus[p], materials.viscosity[p]),
        }
        alone = stresses(points.take(np.array([p])), own, gradient[p : p + 1])[0]
        np.testing.assert_allclose(found[p], alone, rtol=1e-12, atol=1e-12 * np.abs(alone).max())
    np.testing.assert_array_equal(stresses(points, laws, gradient), stresses(points, laws, gradient, None))
    assert np.abs(found - stresses(points, laws, gradient)).max() > 1.0


def test_viscosity_needs_gradients_whoever_says_it() -> None:
    points, materials, gradient = mixture(2)
    laws = {(body, phase): FixedCorotated.from_lame(5.0, 7.0, 2) for body in range(4) for phase in (SOLID,)}
    laws |= {(body, LIQUID): Liquid(1.0, 0.0) for body in range(4)}
    stresses(points, laws)
    with pytest.raises(ValueError, match="viscosity"):
        stresses(points, laws, None, materials)
    dry = replace(materials, viscosity=np.zeros(points.n))
    np.testing.assert_allclose(stresses(points, laws, None, dry), stresses(points, laws, gradient, dry), atol=1e-15)
