"""The test that lets a projected tangent skip the singular value decomposition: sound, and worth having."""

from __future__ import annotations

import numpy as np
import pytest

from femdeform.materials.determinant_form import (
    determinant_tangent_2d,
    determinant_tangent_3d,
    is_surely_convex_2d,
    is_surely_convex_3d,
)
from femdeform.materials.small_matrix import cofactor_2d, cofactor_3d, det_3d


def random_cases(dim: int, n: int = 3000) -> list[tuple[tuple[float, ...], float, float, float]]:
    rng = np.random.default_rng(5)
    F = np.eye(dim) + rng.choice([0.02, 0.2, 0.5], (n, 1, 1)) * rng.standard_normal((n, dim, dim))
    m, g1, g2 = rng.uniform(0.0, 2.0, n), rng.uniform(-2.0, 2.0, n), rng.uniform(-0.5, 5.0, n)
    return [(tuple(map(float, F[e].ravel())), float(m[e]), float(g1[e]), float(g2[e])) for e in range(n)]


def test_never_wrong_and_often_true_3d() -> None:
    H = np.empty((9, 9))
    seen = 0
    for F, m, g1, g2 in random_cases(3):
        if is_surely_convex_3d(F, det_3d(F), m, g1, g2):
            seen += 1
            determinant_tangent_3d(F, cofactor_3d(F), m, 0.0, g1, g2, H)
            assert np.linalg.eigvalsh(H)[0] > -1e-12 * np.abs(H).max()
    assert seen > 600


def test_never_wrong_and_often_true_2d() -> None:
    H = np.empty((4, 4))
    seen = 0
    for F, m, g1, g2 in random_cases(2):
        if is_surely_convex_2d(m, g1, g2):
            seen += 1
            determinant_tangent_2d(F, cofactor_2d(F), m, 0.0, g1, g2, H)
            assert np.linalg.eigvalsh(H)[0] > -1e-12 * np.abs(H).max()
    assert seen > 1000


@pytest.mark.parametrize("stretch", [(1.0, 1.0, 1.0), (1.5, 0.95, 0.95), (1.1, 1.1, 1.0), (2.0, 2.0, 2.0)])
def test_tension_of_a_neo_hookean_body_is_recognised(stretch: tuple[float, float, float]) -> None:
    # mu = 1, lambda^ = 2.5 (Poisson's ratio 0.3); the twist value of the pair (1, 2) is mu + g' s_0 >= 0
    # here.
    a, b, c = stretch
    J = a * b * c
    g1 = 2.5 * (J - 1.0) - 1.0
    expected = 1.0 + min(g1 * a, -g1 * a) >= 0.0
    F = (a, 0.0, 0.0, 0.0, b, 0.0, 0.0, 0.0, c)
    assert is_surely_convex_3d(F, J, 1.0, g1, 2.5) == expected


def test_nothing_is_claimed_of_inverted_or_undefined_states() -> None:
    F = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0)
    assert not is_surely_convex_3d(F, -1.0, 1.0, -0.1, 5.0)
    assert not is_surely_convex_3d((np.nan,) * 9, np.nan, 1.0, -0.1, 5.0)
    assert not is_surely_convex_2d(1.0, np.nan, 5.0)
