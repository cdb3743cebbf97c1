"""As-rigid-as-possible law."""

from __future__ import annotations

from typing import NamedTuple, Self

from femdeform.jit import ORDERED, njit
from femdeform.materials.dispatch import Kernels, register
from femdeform.materials.isotropic import guarded_sum, isotropic_tangent_2d, isotropic_tangent_3d
from femdeform.materials.small_matrix import (
    Matrix2,
    Matrix3,
    Symmetric2,
    Symmetric3,
    Vector2,
    Vector3,
    polar_rotation_2d,
    polar_rotation_3d,
    signed_svd_2d,
    signed_svd_3d,
)


class ARAP(NamedTuple):
    """Psi = mu |F - R|^2 with the rotation R of F = R S; P = 2 mu (F - R).

    At rest it agrees with linear elasticity (mu, 0): the second Lame parameter of the user is not used and
    the field ``lmbda`` is 0. Some authors write mu/2 |F - R|^2, which is half as stiff. In 2D, plane strain.

    References
    ----------
    O. Sorkine, M. Alexa, "As-rigid-as-possible surface modeling", Symposium on Geometry Processing, 2007. I.
    Chao, U. Pinkall, P. Sanan, P. Schroeder, "A simple geometric model for elastic deformations", ACM
    Transactions on Graphics 29(4), 2010.

    Limitations
    -----------
    No resistance to volume change beyond that of shape, no lateral contraction. R jumps, and stress with it,
    where the sum of the two smallest signed stretches vanishes; there the twist stiffness is cut off at s_i +
    s_j = 1e-6.
    """

    mu: float
    lmbda: float

    @classmethod
    def from_lame(cls, mu: float, lmbda: float, dim: int) -> Self:
        """Make the law from the shear modulus [Pa]; ``lmbda`` is not used."""
        return cls(mu, 0.0)


@njit(fastmath=ORDERED)
def energy_from_stretches_2d(s: Vector2, law: ARAP) -> float:
    """Return Psi(diag(s))."""
    a, b = s[0] - 1.0, s[1] - 1.0
    return law.mu * (a * a + b * b)


@njit(fastmath=ORDERED)
def energy_from_stretches_3d(s: Vector3, law: ARAP) -> float:
    """Return Psi(diag(s))."""
    a, b, c = s[0] - 1.0, s[1] - 1.0, s[2] - 1.0
    return law.mu * (a * a + b * b + c * c)


@njit
def energy_density_2d(F: Matrix2, law: ARAP) -> float:
    """Return Psi(F)."""
    _, s, _ = signed_svd_2d(F)
    return energy_from_stretches_2d(s, law)


@njit
def energy_density_3d(F: Matrix3, law: ARAP) -> float:
    """Return Psi(F)."""
    _, s, _ = signed_svd_3d(F)
    return energy_from_stretches_3d(s, law)


@njit
def pk1_2d(F: Matrix2, law: ARAP) -> Matrix2:
    """Return P = 2 mu (F - R)."""
    R = polar_rotation_2d(F)
    k = 2.0 * law.mu
    return (k * (F[0] - R[0]), k * (F[1] - R[1]), k * (F[2] - R[2]), k * (F[3] - R[3]))


@njit
def pk1_3d(F: Matrix3, law: ARAP) -> Matrix3:
    """Return P = 2 mu (F - R)."""
    R = polar_rotation_3d(F)
    k = 2.0 * law.mu
    return (
        k * (F[0] - R[0]),
        k * (F[1] - R[1]),
        k * (F[2] - R[2]),
        k * (F[3] - R[3]),
        k * (F[4] - R[4]),
        k * (F[5] - R[5]),
        k * (F[6] - R[6]),
        k * (F[7] - R[7]),
        k * (F[8] - R[8]),
    )


@njit
def stretch_derivatives_2d(s: Vector2, law: ARAP) -> tuple[Vector2, Symmetric2, tuple[float], tuple[float]]:
    """Return (gradient, hessian, twist, flip); see `dispatch.stretch_derivatives`."""
    k = 2.0 * law.mu
    a, b = s
    return (
        (k * (a - 1.0), k * (b - 1.0)),
        (k, k, 0.0),
        (k - 2.0 * k / guarded_sum(a, b),),
        (k,),
    )


@njit
def stretch_derivatives_3d(s: Vector3, law: ARAP) -> tuple[Vector3, Symmetric3, Vector3, Vector3]:
    """Return (gradient, hessian, twist, flip); see `dispatch.stretch_derivatives`."""
    k = 2.0 * law.mu
    a, b, c = s
    return (
        (k * (a - 1.0), k * (b - 1.0), k * (c - 1.0)),
        (k, k, k, 0.0, 0.0, 0.0),
        (
            k - 2.0 * k / guarded_sum(b, c),
            k - 2.0 * k / guarded_sum(c, a),
            k - 2.0 * k / guarded_sum(a, b),
        ),
        (k, k, k),
    )


_2D = Kernels(energy_density_2d, pk1_2d, isotropic_tangent_2d, energy_from_stretches_2d, stretch_derivatives_2d)
_3D = Kernels(energy_density_3d, pk1_3d, isotropic_tangent_3d, energy_from_stretches_3d, stretch_derivatives_3d)
register(ARAP, 2, _2D)
register(ARAP, 3, _3D)
