"""Patch test: with x = A X + b on the boundary of an irregular mesh, F = A in every element, for every law."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from femdeform.fem.fields import deformation_gradients
from femdeform.materials import LAWS
from femdeform.types import FloatArray
from verification.prescribed_field import solve_prescribed

# Stretch, shear and rotation. Both stretches exceed one: ARAP, which does not resist a change of volume, buckles
# under compression.
A = {
    2: np.array([[1.25, 0.30], [-0.15, 1.20]]),
    3: np.array([[1.25, 0.30, -0.10], [-0.15, 1.20, 0.20], [0.10, -0.05, 1.30]]),
}
B = np.array([0.3, -0.2, 0.5])


def jitter(spacing: float, amount: float) -> Callable[[FloatArray], FloatArray]:
    """Random shift of the inner points of a unit box, up to `amount` of the spacing each way."""

    def move(points: FloatArray) -> FloatArray:
        inner = np.all((points > 1e-9) & (points < 1.0 - 1e-9), axis=1)
        shift = np.random.default_rng(3).uniform(-amount, amount, points.shape) * spacing
        return np.where(inner[:, None], shift, 0.0)

    return move


@pytest.mark.parametrize("law", sorted(LAWS))
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize(("dim", "n", "amount"), [(2, 4, 0.3), (3, 3, 0.25)], ids=["2D", "3D"])
def test_every_element_has_the_gradient_of_the_boundary(
    law: str, order: int, dim: int, n: int, amount: float, block: Callable[..., Any], scene_of: Callable[..., Any]
) -> None:
    assert np.all(np.linalg.svd(A[dim], compute_uv=False) > 1.0)
    mesh = block([n] * dim, move=jitter(1.0 / n, amount))
    scene = scene_of(
        {"law": law, "youngs_modulus": 1.0e6, "poisson_ratio": 0.4},
        order,
        dim,
        conditions=[{"kind": "fixed", "on": "body.boundary"}],
        solver={"tolerance": 1e-13},
    )
    solved = solve_prescribed(scene, {"body": mesh}, lambda X: X @ (A[dim] - np.eye(dim)).T + B[:dim])
    points = solved.simulation.discretization.points
    assert solved.problem.free.any(), "nothing to solve for"
    for group in solved.simulation.discretization.groups:
        F = deformation_gradients(group, solved.state.x)
        np.testing.assert_allclose(F, np.broadcast_to(A[dim], F.shape), rtol=0, atol=1e-10)
    np.testing.assert_allclose(solved.state.x, points @ A[dim].T + B[:dim], rtol=0, atol=1e-10)
