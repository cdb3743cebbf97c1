"""Neo-Hookean law in the form of Macklin and Mueller."""

from __future__ import annotations

from typing import Any, NamedTuple, Self

from numpy.typing import NDArray

from femdeform.jit import ORDERED, njit
from femdeform.materials.determinant_form import (
    combination_2d,
    combination_3d,
    determinant_modes_2d,
    determinant_modes_3d,
    determinant_tangent_2d,
    determinant_tangent_3d,
    is_surely_convex_2d,
    is_surely_convex_3d,
    stretch_invariants_2d,
    stretch_invariants_3d,
)
from femdeform.materials.dispatch import Kernels, register
from femdeform.materials.isotropic import isotropic_tangent_2d, isotropic_tangent_3d
from femdeform.materials.small_matrix import (
    Matrix2,
    Matrix3,
    Symmetric2,
    Symmetric3,
    Vector2,
    Vector3,
    cofactor_2d,
    cofactor_3d,
    strain_invariants_2d,
    strain_invariants_3d,
)


class NeoHookean(NamedTuple):
    """Psi = mu/2 (|F|^2 - d) - mu (J - 1) + lambda^/2 (J - 1)^2 with lambda^ = lambda + mu.

    The constant lambda^ makes the law agree with linear elasticity (mu, lambda) at rest; up to a constant the
    energy is mu/2 |F|^2 + lambda^/2 (J - 1 - mu/lambda^)^2. P = mu F + (lambda^ (J - 1) - mu) cof F. The same
    formula holds in 2D, which is plane strain: the 3D law at diag(F, 1).

    References
    ----------
    M. Macklin, M. Mueller, "A constraint-based formulation of stable neo-Hookean materials", Motion,
    Interaction and Games, 2021.

    Limitations
    -----------
    Finite for J <= 0: elements may invert under large forces, and recover. Volume change costs a finite
    energy at J = 0.
    """

    mu: float
    lmbda: float
    lmbda_hat: float

    @classmethod
    def from_lame(cls, mu: float, lmbda: float, dim: int) -> Self:
        """Make the law from the Lame parameters at rest [Pa]; the same in 2D and 3D."""
        return cls(mu, lmbda, lmbda + mu)


@njit(fastmath=ORDERED)
def _energy(x: float, square: float, rest: float, law: NeoHookean) -> float:
    # x = J - 1; |F|^2 - d - 2 x = square - 2 rest, without cancellation near rest.
    return 0.5 * law.mu * (square - 2.0 * rest) + 0.5 * law.lmbda_hat * x * x


@njit
def energy_density_2d(F: Matrix2, law: NeoHookean) -> float:
    """Return Psi(F)."""
    x, square, rest = strain_invariants_2d(F)
    return _energy(x, square, rest, law)


@njit
def energy_density_3d(F: Matrix3, law: NeoHookean) -> float:
    """Return Psi(F)."""
    x, square, rest = strain_invariants_3d(F)
    return _energy(x, square, rest, law)


@njit
def energy_from_stretches_2d(s: Vector2, law: NeoHookean) -> float:
    """Return Psi(diag(s))."""
    x, square, rest = stretch_invariants_2d(s)
    return _energy(x, square, rest, law)


@njit
def energy_from_stretches_3d(s: Vector3, law: NeoHookean) -> float:
    """Return Psi(diag(s))."""
    x, square, rest = stretch_invariants_3d(s)
    return _energy(x, square, rest, law)


@njit
def pk1_2d(F: Matrix2, law: NeoHookean) -> Matrix2:
    """Return P = mu F + g' cof F."""
    x, _, _ = strain_invariants_2d(F)
    return combination_2d(law.mu, F, law.lmbda_hat * x - law.mu, cofactor_2d(F))


@njit
def pk1_3d(F: Matrix3, law: NeoHookean) -> Matrix3:
    """Return P = mu F + g' cof F."""
    x, _, _ = strain_invariants_3d(F)
    return combination_3d(law.mu, F, law.lmbda_hat * x - law.mu, cofactor_3d(F))


@njit
def stretch_derivatives_2d(s: Vector2, law: NeoHookean) -> tuple[Vector2, Symmetric2, tuple[float], tuple[float]]:
    """Return (gradient, hessian, twist, flip); see `dispatch.stretch_derivatives`."""
    x, _, _ = stretch_invariants_2d(s)
    g1 = law.lmbda_hat * x - law.mu
    hessian, twist, flip = determinant_modes_2d(s, law.mu, 0.0, g1, law.lmbda_hat)
    return (law.mu * s[0] + g1 * s[1], law.mu * s[1] + g1 * s[0]), hessian, twist, flip


@njit
def stretch_derivatives_3d(s: Vector3, law: NeoHookean) -> tuple[Vector3, Symmetric3, Vector3, Vector3]:
    """Return (gradient, hessian, twist, flip); see `dispatch.stretch_derivatives`."""
    x, _, _ = stretch_invariants_3d(s)
    g1 = law.lmbda_hat * x - law.mu
    gradient = (
        law.mu * s[0] + g1 * s[1] * s[2],
        law.mu * s[1] + g1 * s[2] * s[0],
        law.mu * s[2] + g1 * s[0] * s[1],
    )
    hessian, twist, flip = determinant_modes_3d(s, law.mu, 0.0, g1, law.lmbda_hat)
    return gradient, hessian, twist, flip


@njit
def tangent_2d(F: Matrix2, law: NeoHookean, project: bool, H: NDArray[Any]) -> None:
    """Write the tangent into H; see `dispatch.tangent`."""
    x, _, _ = strain_invariants_2d(F)
    g1 = law.lmbda_hat * x - law.mu
    if not project or is_surely_convex_2d(law.mu, g1, law.lmbda_hat):
        determinant_tangent_2d(F, cofactor_2d(F), law.mu, 0.0, g1, law.lmbda_hat, H)
    else:
        isotropic_tangent_2d(F, law, True, H)


@njit
def tangent_3d(F: Matrix3, law: NeoHookean, project: bool, H: NDArray[Any]) -> None:
    """Write the tangent into H; see `dispatch.tangent`."""
    x, _, _ = strain_invariants_3d(F)
    g1 = law.lmbda_hat * x - law.mu
    if not project or is_surely_convex_3d(F, 1.0 + x, law.mu, g1, law.lmbda_hat):
        determinant_tangent_3d(F, cofactor_3d(F), law.mu, 0.0, g1, law.lmbda_hat, H)
    else:
        isotropic_tangent_3d(F, law, True, H)


_2D = Kernels(energy_density_2d, pk1_2d, tangent_2d, energy_from_stretches_2d, stretch_derivatives_2d)
_3D = Kernels(energy_density_3d, pk1_3d, tangent_3d, energy_from_stretches_3d, stretch_derivatives_3d)
register(NeoHookean, 2, _2D)
register(NeoHookean, 3, _3D)
