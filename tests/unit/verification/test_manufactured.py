"""Manufactured solutions in themselves: stress, body force, traction. Solving for them is a verification case."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import sympy

from femdeform.materials import LAWS, batch, law_for
from verification.manufactured import ManufacturedSolution, coordinates, polar_trace

E, NU = 2.0, 0.3
EVERY = [(law, dim) for law in sorted(LAWS) for dim in (2, 3)]


def solution(law: str, dim: int) -> ManufacturedSolution:
    """Stretches 0.7 to 1.3, rotations up to 0.3 rad."""
    X = coordinates(dim)
    sin, cos, pi = sympy.sin, sympy.cos, sympy.pi
    if dim == 2:
        x, y = X
        u = [sin(pi * x) * cos(pi * y), x * sin(pi * y)]
    else:
        x, y, z = X
        u = [sin(pi * x) * cos(pi * y), sin(pi * y) * cos(pi * z), x * y * sin(pi * z)]
    return ManufacturedSolution(law, E, NU, [component / 10 for component in u])


@pytest.mark.parametrize(("law", "dim"), EVERY)
def test_stress_of_sympy_is_that_of_the_compiled_law(law: str, dim: int) -> None:
    exact = solution(law, dim)
    points = np.random.default_rng(1).uniform(0.05, 0.95, (50, dim))
    material = SimpleNamespace(law=law, youngs_modulus=E, poisson_ratio=NU)
    F = np.eye(dim) + exact.gradient(points)
    compiled = np.asarray(batch.pk1(F, law_for(material, dim)))
    assert np.abs(compiled).max() > 0.1 * E
    np.testing.assert_allclose(exact.pk1(points), compiled, rtol=0, atol=1e-12 * E)


@pytest.mark.parametrize(("law", "dim"), EVERY)
def test_body_force_is_minus_the_divergence_of_the_stress(law: str, dim: int) -> None:
    exact = solution(law, dim)
    points = np.random.default_rng(2).uniform(0.05, 0.95, (20, dim))
    h = 1e-5
    shifts = h * np.eye(dim)
    divergence = sum(
        (exact.pk1(points + shift) - exact.pk1(points - shift))[:, :, j] / (2.0 * h) for j, shift in enumerate(shifts)
    )
    force = exact.body_force(points)
    assert np.abs(force).max() > 0.01 * E
    np.testing.assert_allclose(force, -divergence, rtol=0, atol=1e-8 * E)


@pytest.mark.parametrize(("law", "dim"), [("neo_hookean", 2), ("corotated", 2), ("fixed_corotated", 3)])
def test_traction_closes_the_balance_of_forces(law: str, dim: int) -> None:
    """Body force over the unit box and traction over its sides add up to nothing."""
    exact = solution(law, dim)
    nodes, weights = np.polynomial.legendre.leggauss(14)
    t, w = 0.5 * (nodes + 1.0), 0.5 * weights

    def rule(d: int) -> tuple[np.ndarray, np.ndarray]:
        points = np.stack([grid.ravel() for grid in np.meshgrid(*[t] * d, indexing="ij")], axis=1)
        return points, np.prod(np.stack([grid.ravel() for grid in np.meshgrid(*[w] * d, indexing="ij")]), axis=0)

    points, weight = rule(dim)
    total = weight @ exact.body_force(points)
    assert np.abs(total).max() > 1e-3 * E
    flat, weight = rule(dim - 1)
    for axis in range(dim):
        for end in (0.0, 1.0):
            points = np.insert(flat, axis, end, axis=1)
            normal = np.zeros_like(points)
            normal[:, axis] = 2.0 * end - 1.0
            total = total + weight @ exact.traction(points, normal)
    np.testing.assert_allclose(total, 0.0, atol=1e-12)


@pytest.mark.parametrize("dim", [2, 3])
def test_trace_of_the_stretch_is_the_sum_of_signed_singular_values(dim: int) -> None:
    F = np.eye(dim) + 0.8 * np.random.default_rng(dim).normal(size=(5000, dim, dim))
    s = np.linalg.svd(F, compute_uv=False)
    s[:, -1] *= np.sign(np.linalg.det(F))
    unique = s[:, -2] + s[:, -1] > 0.05
    assert np.sum(np.linalg.det(F)[unique] < 0.0) > 100
    np.testing.assert_allclose(polar_trace(F[unique]), s[unique].sum(axis=1), rtol=1e-13)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_rotation_that_is_not_unique_is_refused(dim: int) -> None:
    mirror = np.eye(dim)
    mirror[-1, -1] = -1.0
    with pytest.raises(ValueError, match="not unique"):
        polar_trace(mirror[None])


def test_an_unknown_law_is_refused() -> None:
    with pytest.raises(ValueError, match="no manufactured solution for the law mooney_rivlin"):
        solution("mooney_rivlin", 3)
