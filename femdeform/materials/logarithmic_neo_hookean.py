"""Neo-Hookean law with logarithmic volume terms."""

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
    strain_invariants_2d,
    strain_invariants_3d,
)


class LogarithmicNeoHookean(NamedTuple):
    """Psi = mu/2 (|F|^2 - d) - mu ln J + lambda/2 (ln J)^2, for J > 0 only.

    P = mu F + g' cof F with g' = (lambda ln J - mu) / J. Agrees with linear elasticity (mu, lambda) at rest.
    The same formula holds in 2D, which is plane strain: the 3D law at diag(F, 1).

    References
    ----------
    J. Bonet, R. D. Wood, "Nonlinear Continuum Mechanics for Finite Element Analysis", Cambridge University
    Press, 2nd edition, 2008, section 6.4.3.

    Limitations
    -----------
    For J <= 0 the energy density is inf and stress and tangent are not numbers: a solver has to keep J > 0,
    for example by a line search that refuses an infinite energy. The energy grows without bound as J -> 0, so
    elements never invert, but the volume term loses convexity for ln J > 1 + mu/lambda.
    """

    mu: float
    lmbda: float

    @classmethod
    def from_lame(cls, mu: float, lmbda: float, dim: int) -> Self:
        """Make the law from the Lame parameters at rest [Pa]; the same in 2D and 3D."""
        return cls(mu, lmbda)


@njit(fastmath=ORDERED)
def _energy(x: float, square: float, rest: float, law: LogarithmicNeoHookean) -> float:
    # x = J - 1; |F|^2 - d - 2 x = square - 2 rest, without cancellation near rest.
    if x <= -1.0:
        return math.inf
    log = math.log1p(x)
    return 0.5 * law.mu * (square - 2.0 * rest) + law.mu * (x - log) + 0.5 * law.lmbda * log * log


@njit(fastmath=ORDERED)
def _volume_derivatives(x: float, law: LogarithmicNeoHookean) -> tuple[float, float]:
    """Return g' and g'' at J = 1 + x; not numbers for J < 0."""
    inverse = 1.0 / (1.0 + x)
    pressure = law.lmbda * math.log1p(x)
    return (pressure - law.mu) * inverse, (law.mu + law.lmbda - pressure) * inverse * inverse


@njit
def energy_density_2d(F: Matrix2, law: LogarithmicNeoHookean) -> float:
    """Return Psi(F)."""
    x, square, rest = strain_invariants_2d(F)
    return _energy(x, square, rest, law)


@njit
def energy_density_3d(F: Matrix3, law: LogarithmicNeoHookean) -> float:
    """Return Psi(F)."""
    x, square, rest = strain_invariants_3d(F)
    return _energy(x, square, rest, law)


@njit
def energy_from_stretches_2d(s: Vector2, law: LogarithmicNeoHookean) -> float:
    """Return Psi(diag(s))."""
    x, square, rest = stretch_invariants_2d(s)
    return _energy(x, square, rest, law)


@njit
def energy_from_stretches_3d(s: Vector3, law: LogarithmicNeoHookean) -> float:
    """Return Psi(diag(s))."""
    x, square, rest = stretch_invariants_3d(s)
    return _energy(x, square, rest, law)


@njit
def pk1_2d(F: Matrix2, law: LogarithmicNeoHookean) -> Matrix2:
    """Return P = mu F + g' cof F."""
    x, _, _ = strain_invariants_2d(F)
    g1, _ = _volume_derivatives(x, law)
    return combination_2d(law.mu, F, g1, cofactor_2d(F))


@njit
def pk1_3d(F: Matrix3, law: LogarithmicNeoHookean) -> Matrix3:
    """Return P = mu F + g' cof F."""
    x, _, _ = strain_invariants_3d(F)
    g1, _ = _volume_derivatives(x, law)
    return combination_3d(law.mu, F, g1, cofactor_3d(F))


@njit
def stretch_derivatives_2d(
    s: Vector2, law: LogarithmicNeoHookean
) -> tuple[Vector2, Symmetric2, tuple[float], tuple[float]]:
    """Return (gradient, hessian, twist, flip); see `dispatch.stretch_derivatives`."""
    x, _, _ = stretch_invariants_2d(s)
    g1, g2 = _volume_derivatives(x, law)
    hessian, twist, flip = determinant_modes_2d(s, law.mu, 0.0, g1, g2)
    return (law.mu * s[0] + g1 * s[1], law.mu * s[1] + g1 * s[0]), hessian, twist, flip


@njit
def stretch_derivatives_3d(s: Vector3, law: LogarithmicNeoHookean) -> tuple[Vector3, Symmetric3, Vector3, Vector3]:
    """Return (gradient, hessian, twist, flip); see `dispatch.stretch_derivatives`."""
    x, _, _ = stretch_invariants_3d(s)
    g1, g2 = _volume_derivatives(x, law)
    gradient = (
        law.mu * s[0] + g1 * s[1] * s[2],
        law.mu * s[1] + g1 * s[2] * s[0],
        law.mu * s[2] + g1 * s[0] * s[1],
    )
    hessian, twist, flip = determinant_modes_3d(s, law.mu, 0.0, g1, g2)
    return gradient, hessian, twist, flip


@njit
def tangent_2d(F: Matrix2, law: LogarithmicNeoHookean, project: bool, H: NDArray[Any]) -> None:
    """Write the tangent into H; see `dispatch.tangent`."""
    x, _, _ = strain_invariants_2d(F)
    g1, g2 = _volume_derivatives(x, law)
    if not project or is_surely_convex_2d(law.mu, g1, g2):
        determinant_tangent_2d(F, cofactor_2d(F), law.mu, 0.0, g1, g2, H)
    else:
        isotropic_tangent_2d(F, law, True, H)


@njit
def tangent_3d(F: Matrix3, law: LogarithmicNeoHookean, project: bool, H: NDArray[Any]) -> None:
    """Write the tangent into H; see `dispatch.tangent`."""
    x, _, _ = strain_invariants_3d(F)
    g1, g2 = _volume_derivatives(x, law)
    if not project or is_surely_convex_3d(F, 1.0 + x, law.mu, g1, g2):
        determinant_tangent_3d(F, cofactor_3d(F), law.mu, 0.0, g1, g2, H)
    else:
        isotropic_tangent_3d(F, law, True, H)


_2D = Kernels(energy_density_2d, pk1_2d, tangent_2d, energy_from_stretches_2d, stretch_derivatives_2d)
_3D = Kernels(energy_density_3d, pk1_3d, tangent_3d, energy_from_stretches_3d, stretch_derivatives_3d)
register(LogarithmicNeoHookean, 2, _2D)
register(LogarithmicNeoHookean, 3, _3D)
