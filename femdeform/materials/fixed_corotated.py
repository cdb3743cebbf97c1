"""Fixed corotated law."""

from __future__ import annotations

from typing import NamedTuple, Self

from femdeform.jit import ORDERED, njit
from femdeform.materials.determinant_form import (
    combination_2d,
    combination_3d,
    determinant_modes_2d,
    determinant_modes_3d,
    stretch_invariants_2d,
    stretch_invariants_3d,
)
from femdeform.materials.dispatch import Kernels, register
from femdeform.materials.isotropic import guarded_sum, isotropic_tangent_2d, isotropic_tangent_3d
from femdeform.materials.small_matrix import (
    Matrix2,
    Matrix3,
    Symmetric2,
    Symmetric3,
    Vector2,
    Vector3,
    cofactor_2d,
    cofactor_3d,
    polar_rotation_2d,
    polar_rotation_3d,
    signed_svd_2d,
    signed_svd_3d,
    strain_invariants_2d,
    strain_invariants_3d,
)


class FixedCorotated(NamedTuple):
    """Psi = mu |F - R|^2 + lambda/2 (J - 1)^2 with the rotation R of F = R S.

    P = 2 mu (F - R) + lambda (J - 1) cof F. Agrees with linear elasticity (mu, lambda) at rest. In 2D, plane
    strain: the 3D law at diag(F, 1).

    References
    ----------
    A. Stomakhin, R. Howes, C. Schroeder, J. Teran, "Energetically consistent invertible elasticity",
    Symposium on Computer Animation, 2012.

    Limitations
    -----------
    Finite for J <= 0: elements may invert and recover. R jumps, and stress with it, where the sum of the two
    smallest signed stretches vanishes; there the twist stiffness is cut off at s_i + s_j = 1e-6.
    """

    mu: float
    lmbda: float

    @classmethod
    def from_lame(cls, mu: float, lmbda: float, dim: int) -> Self:
        """Make the law from the Lame parameters [Pa]; the same in 2D and 3D."""
        return cls(mu, lmbda)


@njit
def energy_from_stretches_2d(s: Vector2, law: FixedCorotated) -> float:
    """Return Psi(diag(s))."""
    x, square, _ = stretch_invariants_2d(s)
    return law.mu * square + 0.5 * law.lmbda * x * x


@njit
def energy_from_stretches_3d(s: Vector3, law: FixedCorotated) -> float:
    """Return Psi(diag(s))."""
    x, square, _ = stretch_invariants_3d(s)
    return law.mu * square + 0.5 * law.lmbda * x * x


@njit
def energy_density_2d(F: Matrix2, law: FixedCorotated) -> float:
    """Return Psi(F)."""
    _, s, _ = signed_svd_2d(F)
    return energy_from_stretches_2d(s, law)


@njit
def energy_density_3d(F: Matrix3, law: FixedCorotated) -> float:
    """Return Psi(F)."""
    _, s, _ = signed_svd_3d(F)
    return energy_from_stretches_3d(s, law)


@njit(fastmath=ORDERED)
def pk1_2d(F: Matrix2, law: FixedCorotated) -> Matrix2:
    """Return P = 2 mu (F - R) + lambda (J - 1) cof F."""
    x, _, _ = strain_invariants_2d(F)
    strain = combination_2d(1.0, F, -1.0, polar_rotation_2d(F))
    return combination_2d(2.0 * law.mu, strain, law.lmbda * x, cofactor_2d(F))


@njit(fastmath=ORDERED)
def pk1_3d(F: Matrix3, law: FixedCorotated) -> Matrix3:
    """Return P = 2 mu (F - R) + lambda (J - 1) cof F."""
    x, _, _ = strain_invariants_3d(F)
    strain = combination_3d(1.0, F, -1.0, polar_rotation_3d(F))
    return combination_3d(2.0 * law.mu, strain, law.lmbda * x, cofactor_3d(F))


@njit
def stretch_derivatives_2d(s: Vector2, law: FixedCorotated) -> tuple[Vector2, Symmetric2, tuple[float], tuple[float]]:
    """Return (gradient, hessian, twist, flip); see `dispatch.stretch_derivatives`."""
    k = 2.0 * law.mu
    x, _, _ = stretch_invariants_2d(s)
    g1 = law.lmbda * x
    hessian, twist, flip = determinant_modes_2d(s, k, 0.0, g1, law.lmbda)
    gradient = (k * (s[0] - 1.0) + g1 * s[1], k * (s[1] - 1.0) + g1 * s[0])
    return gradient, hessian, (twist[0] - 2.0 * k / guarded_sum(s[0], s[1]),), flip


@njit
def stretch_derivatives_3d(s: Vector3, law: FixedCorotated) -> tuple[Vector3, Symmetric3, Vector3, Vector3]:
    """Return (gradient, hessian, twist, flip); see `dispatch.stretch_derivatives`."""
    k = 2.0 * law.mu
    x, _, _ = stretch_invariants_3d(s)
    g1 = law.lmbda * x
    hessian, twist, flip = determinant_modes_3d(s, k, 0.0, g1, law.lmbda)
    gradient = (
        k * (s[0] - 1.0) + g1 * s[1] * s[2],
        k * (s[1] - 1.0) + g1 * s[2] * s[0],
        k * (s[2] - 1.0) + g1 * s[0] * s[1],
    )
    twist = (
        twist[0] - 2.0 * k / guarded_sum(s[1], s[2]),
        twist[1] - 2.0 * k / guarded_sum(s[2], s[0]),
        twist[2] - 2.0 * k / guarded_sum(s[0], s[1]),
    )
    return gradient, hessian, twist, flip


_2D = Kernels(energy_density_2d, pk1_2d, isotropic_tangent_2d, energy_from_stretches_2d, stretch_derivatives_2d)
_3D = Kernels(energy_density_3d, pk1_3d, isotropic_tangent_3d, energy_from_stretches_3d, stretch_derivatives_3d)
register(FixedCorotated, 2, _2D)
register(FixedCorotated, 3, _3D)
