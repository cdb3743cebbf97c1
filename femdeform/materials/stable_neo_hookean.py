"""Stable neo-Hookean law."""

from __future__ import annotations

import math
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
    squared_norm_2d,
    squared_norm_3d,
    strain_invariants_2d,
    strain_invariants_3d,
)


class StableNeoHookean(NamedTuple):
    """Psi = mu'/2 (I - d) - mu'/2 ln((I + 1)/(d + 1)) + lambda'/2 ((J - alpha)^2 - (1 - alpha)^2), I = |F|^2.

    alpha = 1 + mu/lambda' makes the rest state stress free. P = m F + g' cof F with m = mu' (1 - 1/(I + 1))
    and g' = lambda' (J - alpha) = lambda' (J - 1) - mu. The constants mu' = (d + 1)/d mu and lambda' = lambda
    + (1 - 2/(d (d + 1))) mu make the law agree with linear elasticity (mu, lambda) at rest: they are 4/3 mu
    and lambda + 5/6 mu in 3D, 3/2 mu and lambda + 2/3 mu in 2D.

    References
    ----------
    B. Smith, F. de Goes, T. Kim, "Stable neo-Hookean flesh simulation", ACM Transactions on Graphics 37(2),
    2018.

    Limitations
    -----------
    The two-dimensional law is one of its own, with its own constants: plane strain at rest, but at finite
    strain not the 3D law at diag(F, 1), since I counts the dimensions. Finite for J <= 0: elements may invert
    and recover.
    """

    mu: float
    lmbda: float
    mu_corrected: float
    lmbda_corrected: float

    @classmethod
    def from_lame(cls, mu: float, lmbda: float, dim: int) -> Self:
        """Make the law from the Lame parameters at rest [Pa]; the corrected ones depend on the dimension."""
        if dim == 2:
            return cls(mu, lmbda, 3.0 * mu / 2.0, lmbda + 2.0 * mu / 3.0)
        return cls(mu, lmbda, 4.0 * mu / 3.0, lmbda + 5.0 * mu / 6.0)


@njit(fastmath=ORDERED)
def _energy(x: float, square: float, rest: float, d: float, law: StableNeoHookean) -> float:
    # With x = J - 1 and y = |F|^2 - d the energy is mu/2 (y - 2 x) + mu'/2 (z - ln(1 + z)) + lambda'/2 x^2,
    # where z = y / (d + 1): written like this nothing large cancels near rest, and it vanishes there.
    excess = square - 2.0 * rest
    z = (excess + 2.0 * x) / (d + 1.0)
    return 0.5 * (law.mu * excess + law.mu_corrected * (z - math.log1p(z)) + law.lmbda_corrected * x * x)


@njit
def _shear_coefficients(square: float, law: StableNeoHookean) -> tuple[float, float]:
    """Return m and e = 2 dm/d|F|^2 where |F|^2 = square."""
    inverse = 1.0 / (square + 1.0)
    return law.mu_corrected * (1.0 - inverse), 2.0 * law.mu_corrected * inverse * inverse


@njit
def energy_density_2d(F: Matrix2, law: StableNeoHookean) -> float:
    """Return Psi(F)."""
    x, square, rest = strain_invariants_2d(F)
    return _energy(x, square, rest, 2.0, law)


@njit
def energy_density_3d(F: Matrix3, law: StableNeoHookean) -> float:
    """Return Psi(F)."""
    x, square, rest = strain_invariants_3d(F)
    return _energy(x, square, rest, 3.0, law)


@njit
def energy_from_stretches_2d(s: Vector2, law: StableNeoHookean) -> float:
    """Return Psi(diag(s))."""
    x, square, rest = stretch_invariants_2d(s)
    return _energy(x, square, rest, 2.0, law)


@njit
def energy_from_stretches_3d(s: Vector3, law: StableNeoHookean) -> float:
    """Return Psi(diag(s))."""
    x, square, rest = stretch_invariants_3d(s)
    return _energy(x, square, rest, 3.0, law)


@njit
def pk1_2d(F: Matrix2, law: StableNeoHookean) -> Matrix2:
    """Return P = m F + g' cof F."""
    x, _, _ = strain_invariants_2d(F)
    m, _ = _shear_coefficients(squared_norm_2d(F), law)
    return combination_2d(m, F, law.lmbda_corrected * x - law.mu, cofactor_2d(F))


@njit
def pk1_3d(F: Matrix3, law: StableNeoHookean) -> Matrix3:
    """Return P = m F + g' cof F."""
    x, _, _ = strain_invariants_3d(F)
    m, _ = _shear_coefficients(squared_norm_3d(F), law)
    return combination_3d(m, F, law.lmbda_corrected * x - law.mu, cofactor_3d(F))


@njit
def stretch_derivatives_2d(s: Vector2, law: StableNeoHookean) -> tuple[Vector2, Symmetric2, tuple[float], tuple[float]]:
    """Return (gradient, hessian, twist, flip); see `dispatch.stretch_derivatives`."""
    x, _, _ = stretch_invariants_2d(s)
    m, e = _shear_coefficients(s[0] * s[0] + s[1] * s[1], law)
    g1 = law.lmbda_corrected * x - law.mu
    hessian, twist, flip = determinant_modes_2d(s, m, e, g1, law.lmbda_corrected)
    return (m * s[0] + g1 * s[1], m * s[1] + g1 * s[0]), hessian, twist, flip


@njit
def stretch_derivatives_3d(s: Vector3, law: StableNeoHookean) -> tuple[Vector3, Symmetric3, Vector3, Vector3]:
    """Return (gradient, hessian, twist, flip); see `dispatch.stretch_derivatives`."""
    x, _, _ = stretch_invariants_3d(s)
    m, e = _shear_coefficients(s[0] * s[0] + s[1] * s[1] + s[2] * s[2], law)
    g1 = law.lmbda_corrected * x - law.mu
    gradient = (
        m * s[0] + g1 * s[1] * s[2],
        m * s[1] + g1 * s[2] * s[0],
        m * s[2] + g1 * s[0] * s[1],
    )
    hessian, twist, flip = determinant_modes_3d(s, m, e, g1, law.lmbda_corrected)
    return gradient, hessian, twist, flip


@njit
def tangent_2d(F: Matrix2, law: StableNeoHookean, project: bool, H: NDArray[Any]) -> None:
    """Write the tangent into H; see `dispatch.tangent`."""
    x, _, _ = strain_invariants_2d(F)
    m, e = _shear_coefficients(squared_norm_2d(F), law)
    g1 = law.lmbda_corrected * x - law.mu
    # The term e F F^T only adds convexity.
    if not project or is_surely_convex_2d(m, g1, law.lmbda_corrected):
        determinant_tangent_2d(F, cofactor_2d(F), m, e, g1, law.lmbda_corrected, H)
    else:
        isotropic_tangent_2d(F, law, True, H)


@njit
def tangent_3d(F: Matrix3, law: StableNeoHookean, project: bool, H: NDArray[Any]) -> None:
    """Write the tangent into H; see `dispatch.tangent`."""
    x, _, _ = strain_invariants_3d(F)
    m, e = _shear_coefficients(squared_norm_3d(F), law)
    g1 = law.lmbda_corrected * x - law.mu
    # The term e F F^T only adds convexity.
    if not project or is_surely_convex_3d(F, 1.0 + x, m, g1, law.lmbda_corrected):
        determinant_tangent_3d(F, cofactor_3d(F), m, e, g1, law.lmbda_corrected, H)
    else:
        isotropic_tangent_3d(F, law, True, H)


_2D = Kernels(energy_density_2d, pk1_2d, tangent_2d, energy_from_stretches_2d, stretch_derivatives_2d)
_3D = Kernels(energy_density_3d, pk1_3d, tangent_3d, energy_from_stretches_3d, stretch_derivatives_3d)
register(StableNeoHookean, 2, _2D)
register(StableNeoHookean, 3, _3D)
