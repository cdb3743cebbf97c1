"""Convergence to manufactured solutions: P1 with rates 2 (L2) and 1 (H1), P2 with 3 and 2, for every law that can."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import sympy

from femdeform.materials import batch, law_for
from femdeform.types import FloatArray
from verification.manufactured import ManufacturedSolution, coordinates
from verification.norms import ErrorNorms, error_norms, observed_rates
from verification.prescribed_field import solve_prescribed

E, NU = 2.0, 0.3
ALL_LAWS = [
    "linear",
    "saint_venant_kirchhoff",
    "neo_hookean",
    "stable_neo_hookean",
    "logarithmic_neo_hookean",
    "arap",
    "corotated",
    "fixed_corotated",
]
LAWS_3D = ALL_LAWS[:5]
CASES = [(law, 2) for law in ALL_LAWS] + [(law, 3) for law in LAWS_3D]
RATES = {1: (2.0, 1.0), 2: (3.0, 2.0)}  # order of the element -> L2, H1
BAND = 0.15


def solution(law: str, dim: int) -> ManufacturedSolution:
    """The displacement of methods.md, section 6, row 6, and one like it in two dimensions: stretches 0.7 to 1.3.

    St. Venant-Kirchhoff's law loses ellipticity in compression, in plane strain with two equal stretches a where
    (lmbda + mu)(a^2 - 1) + mu a^2 = 0, a = 0.85 for nu = 0.3. It gets a smaller one, stretches 0.87 to 1.13.
    """
    X = coordinates(dim)
    sin, cos, pi = sympy.sin, sympy.cos, sympy.pi
    if dim == 2:
        x, y = X
        u = [sin(pi * x) * cos(pi * y), x * sin(pi * y)]
    else:
        x, y, z = X
        u = [sin(pi * x) * cos(pi * y), sin(pi * y) * cos(pi * z), x * y * sin(pi * z)]
    amplitude = sympy.Rational(1, 25 if law == "saint_venant_kirchhoff" else 10)
    return ManufacturedSolution(law, E, NU, [amplitude * component for component in u])


def bulge(points: FloatArray) -> FloatArray:
    """Smooth shift of the inner points: no two elements stay congruent, and refinement keeps their shape."""
    direction = np.array([0.6, -0.8, 0.5])[: points.shape[1]]
    return np.asarray(0.08 * np.prod(np.sin(np.pi * points), axis=1)[:, None] * direction)


@pytest.fixture
def errors_of(block: Callable[..., Any], scene_of: Callable[..., Any]) -> Callable[..., list[ErrorNorms]]:
    """Errors on a sequence of meshes."""

    def solve(
        law: str, order: int, dim: int, counts: Sequence[int], split: int = 5, distorted: bool = True
    ) -> list[ErrorNorms]:
        exact = solution(law, dim)
        scene = scene_of(
            {"law": law, "youngs_modulus": E, "poisson_ratio": NU},
            order,
            dim,
            conditions=[{"kind": "fixed", "on": "body.boundary"}],
            solver={"tolerance": 1e-10},
        )
        found = []
        for n in counts:
            mesh = block([n] * dim, split=split, move=bulge if distorted else None)
            solved = solve_prescribed(scene, {"body": mesh}, exact.displacement, exact.body_force)
            found.append(error_norms(solved.table(6), solved.displacement, exact.displacement, exact.gradient))
        return found

    return solve


def check_rates(counts: Sequence[int], errors: list[ErrorNorms], order: int) -> None:
    """The rates of the finest pair of meshes lie in the band."""
    sizes = [1.0 / n for n in counts]
    l2 = observed_rates(sizes, [e.l2 for e in errors])[-1]
    h1 = observed_rates(sizes, [e.h1 for e in errors])[-1]
    print(f"rates {l2:.3f} (L2), {h1:.3f} (H1); errors {errors[-1].l2:.3e} m, {errors[-1].h1:.3e}")
    assert (l2, h1) == pytest.approx(RATES[order], abs=BAND)


# ------------------------------------------------------------------------------------- the solutions themselves


@pytest.mark.parametrize(("law", "dim"), CASES)
def test_stress_of_sympy_is_that_of_the_compiled_law(law: str, dim: int) -> None:
    exact = solution(law, dim)
    points = np.random.default_rng(1).uniform(0.05, 0.95, (20, dim))
    material = SimpleNamespace(law=law, youngs_modulus=E, poisson_ratio=NU)
    F = np.eye(dim) + exact.gradient(points)
    compiled = np.asarray(batch.pk1(F, law_for(material, dim)))
    np.testing.assert_allclose(exact.pk1(points), compiled, rtol=0, atol=1e-12 * E)


@pytest.mark.parametrize(("law", "dim"), CASES)
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


def test_traction_closes_the_balance_of_forces() -> None:
    """Body force over the unit square and traction over its sides add up to nothing."""
    exact = solution("neo_hookean", 2)
    nodes, weights = np.polynomial.legendre.leggauss(20)
    t, w = 0.5 * (nodes + 1.0), 0.5 * weights
    x, y = (grid.ravel() for grid in np.meshgrid(t, t, indexing="ij"))
    total = np.einsum("q,qi->i", np.outer(w, w).ravel(), exact.body_force(np.stack([x, y], axis=1)))
    for axis in range(2):
        for end in (0.0, 1.0):
            points = np.stack([t, t], axis=1)
            points[:, axis] = end
            normal = np.zeros((t.size, 2))
            normal[:, axis] = 2.0 * end - 1.0
            total = total + w @ exact.traction(points, normal)
    np.testing.assert_allclose(total, 0.0, atol=1e-13)


def test_a_law_without_closed_form_is_refused() -> None:
    with pytest.raises(ValueError, match="no closed form of arap in 3 dimensions"):
        solution("arap", 3)


# ------------------------------------------------------------------------------------------------------ rates


@pytest.mark.parametrize(("order", "counts"), [(1, (8, 16, 32)), (2, (4, 8, 16))], ids=["P1", "P2"])
@pytest.mark.parametrize("law", ALL_LAWS)
def test_rates_in_2d(law: str, order: int, counts: tuple[int, ...], errors_of: Callable[..., Any]) -> None:
    check_rates(counts, errors_of(law, order, 2, counts), order)


@pytest.mark.parametrize(("order", "counts"), [(1, (3, 6, 12)), (2, (2, 4, 8))], ids=["P1", "P2"])
@pytest.mark.parametrize("law", LAWS_3D)
def test_rates_in_3d(law: str, order: int, counts: tuple[int, ...], errors_of: Callable[..., Any]) -> None:
    check_rates(counts, errors_of(law, order, 3, counts), order)


def test_errors_are_those_of_an_independent_program(errors_of: Callable[..., Any]) -> None:
    """Absolute errors on Kuhn meshes, as methods.md, section 6, row 6 gives them."""
    errors = errors_of("neo_hookean", 1, 3, (3, 6), split=6, distorted=False)
    assert [e.l2 for e in errors] == pytest.approx([1.5e-2, 4.4e-3], rel=0.05)
    assert [e.h1 for e in errors] == pytest.approx([0.162, 0.084], rel=0.01)
