"""Corotated linear elasticity."""

from __future__ import annotations

from typing import NamedTuple, Self

from femdeform.jit import ORDERED, njit
from femdeform.materials.determinant_form import combination_2d, combination_3d
from femdeform.materials.dispatch import Kernels, register
from femdeform.materials.isotropic import guarded_sum, isotropic_tangent_2d, isotropic_tangent_3d
from femdeform.materials.small_matrix import (
    Matrix2,
    Matrix3,
    Symmetric2,
    Symmetric3,
    Vector2,
    Vector3,
    rotation_and_trace_2d,
    rotation_and_trace_3d,
    signed_svd_2d,
    signed_svd_3d,
)


class Corotated(NamedTuple):
    """Psi = mu |S - I|^2 + lambda/2 (tr S - d)^2 with F = R S; P = 2 mu (F - R) + lambda (tr S - d) R.

    Linear elasticity of the stretch tensor: agrees with linear elasticity (mu, lambda) at rest and is exact
    for any rotation. In 2D, plane strain: the 3D law at diag(F, 1).

    References
    ----------
    M. Mueller, M. Gross, "Interactive virtual materials", Graphics Interface, 2004, in the hyperelastic form
    of A. McAdams et al., "Efficient elasticity for character skinning with contact and collisions", ACM
    Transactions on Graphics 30(4), 2011.

    Limitations
    -----------
    Volume is only resisted to first order: tr S - d is not J - 1. R jumps, and stress with it, where the sum
    of the two smallest signed stretches vanishes; there the twist stiffness is cut off at s_i + s_j = 1e-6.
    """

    mu: float
    lmbda: float

    @classmethod
    def from_lame(cls, mu: float, lmbda: float, dim: int) -> Self:
        """Make the law from the Lame parameters [Pa]; the same in 2D and 3D."""
        return cls(mu, lmbda)


@njit(fastmath=ORDERED)
def energy_from_stretches_2d(s: Vector2, law: Corotated) -> float:
    """Return Psi(diag(s))."""
    a, b = s[0] - 1.0, s[1] - 1.0
    t = a + b
    return law.mu * (a * a + b * b) + 0.5 * law.lmbda * t * t


@njit(fastmath=ORDERED)
def energy_from_stretches_3d(s: Vector3, law: Corotated) -> float:
    """Return Psi(diag(s))."""
    a, b, c = s[0] - 1.0, s[1] - 1.0, s[2] - 1.0
    t = a + b + c
    return law.mu * (a * a + b * b + c * c) + 0.5 * law.lmbda * t * t


@njit
def energy_density_2d(F: Matrix2, law: Corotated) -> float:
    """Return Psi(F)."""
    _, s, _ = signed_svd_2d(F)
    return energy_from_stretches_2d(s, law)


@njit
def energy_density_3d(F: Matrix3, law: Corotated) -> float:
    """Return Psi(F)."""
    _, s, _ = signed_svd_3d(F)
    return energy_from_stretches_3d(s, law)


@njit
def pk1_2d(F: Matrix2, law: Corotated) -> Matrix2:
    """Return P = 2 mu (F - R) + lambda t R."""
    R, t = rotation_and_trace_2d(F)
    return combination_2d(2.0 * law.mu, F, law.lmbda * t - 2.0 * law.mu, R)


@njit
def pk1_3d(F: Matrix3, law: Corotated) -> Matrix3:
    """Return P = 2 mu (F - R) + lambda t R."""
    R, t = rotation_and_trace_3d(F)
    return combination_3d(2.0 * law.mu, F, law.lmbda * t - 2.0 * law.mu, R)


@njit(fastmath=ORDERED)
def stretch_derivatives_2d(s: Vector2, law: Corotated) -> tuple[Vector2, Symmetric2, tuple[float], tuple[float]]:
    """Return (gradient, hessian, twist, flip); see `dispatch.stretch_derivatives`."""
    k, lmbda = 2.0 * law.mu, law.lmbda
    a, b = s[0] - 1.0, s[1] - 1.0
    p = lmbda * (a + b)
    return (
        (k * a + p, k * b + p),
        (k + lmbda, k + lmbda, lmbda),
        (k + 2.0 * (p - k) / guarded_sum(s[0], s[1]),),
        (k,),
    )


@njit(fastmath=ORDERED)
def stretch_derivatives_3d(s: Vector3, law: Corotated) -> tuple[Vector3, Symmetric3, Vector3, Vector3]:
    """Return (gradient, hessian, twist, flip); see `dispatch.stretch_derivatives`."""
    k, lmbda = 2.0 * law.mu, law.lmbda
    a, b, c = s[0] - 1.0, s[1] - 1.0, s[2] - 1.0
    p = lmbda * (a + b + c)
    own = k + lmbda
    q = 2.0 * (p - k)
    return (
        (k * a + p, k * b + p, k * c + p),
        (own, own, own, lmbda, lmbda, lmbda),
        (k + q / guarded_sum(s[1], s[2]), k + q / guarded_sum(s[2], s[0]), k + q / guarded_sum(s[0], s[1])),
        (k, k, k),
    )


_2D = Kernels(energy_density_2d, pk1_2d, isotropic_tangent_2d, energy_from_stretches_2d, stretch_derivatives_2d)
_3D = Kernels(energy_density_3d, pk1_3d, isotropic_tangent_3d, energy_from_stretches_3d, stretch_derivatives_3d)
register(Corotated, 2, _2D)
register(Corotated, 3, _3D)
