"""St. Venant-Kirchhoff law."""

from __future__ import annotations

from typing import Any, NamedTuple, Self

from numpy.typing import NDArray

from femdeform.jit import ORDERED, njit
from femdeform.materials.dispatch import Kernels, register
from femdeform.materials.isotropic import (
    isotropic_tangent_2d,
    isotropic_tangent_3d,
    write_block_pair_3d,
    write_diagonal_block_3d,
    write_symmetric_2d,
)
from femdeform.materials.small_matrix import (
    Matrix2,
    Matrix3,
    Symmetric2,
    Symmetric3,
    Vector2,
    Vector3,
    is_surely_definite_2d,
    is_surely_definite_3d,
)


class SaintVenantKirchhoff(NamedTuple):
    """Psi = mu |E|^2 + lambda/2 (tr E)^2 with the Green strain E = (F^T F - I)/2.

    P = F S with S = 2 mu E + lambda tr(E) I. Exact for any rotation; linear elasticity (mu, lambda) at rest.
    In 2D, plane strain: the 3D law at diag(F, 1).

    References
    ----------
    J. Bonet, R. D. Wood, "Nonlinear Continuum Mechanics for Finite Element Analysis", Cambridge University
    Press, 2nd edition, 2008, section 6.3.

    Limitations
    -----------
    For small strains: under uniaxial compression the stress falls back to zero as the stretch goes from
    1/sqrt 3 to 0, so strongly compressed elements collapse and invert, and an inverted element is as much at
    rest as a straight one.
    """

    mu: float
    lmbda: float

    @classmethod
    def from_lame(cls, mu: float, lmbda: float, dim: int) -> Self:
        """Make the law from the Lame parameters [Pa]; the same in 2D and 3D."""
        return cls(mu, lmbda)


# ---------------------------------------------------------------------------------------- 3D


@njit(fastmath=ORDERED)
def _green_strain_3d(F: Matrix3) -> Symmetric3:
    # With D = F - I: E = (D + D^T + D^T D)/2, which does not cancel near rest.
    d0, d4, d8 = F[0] - 1.0, F[4] - 1.0, F[8] - 1.0
    return (
        d0 + 0.5 * (d0 * d0 + F[3] * F[3] + F[6] * F[6]),
        d4 + 0.5 * (F[1] * F[1] + d4 * d4 + F[7] * F[7]),
        d8 + 0.5 * (F[2] * F[2] + F[5] * F[5] + d8 * d8),
        0.5 * ((F[5] + F[7]) + (F[1] * F[2] + d4 * F[5] + F[7] * d8)),
        0.5 * ((F[2] + F[6]) + (d0 * F[2] + F[3] * F[5] + F[6] * d8)),
        0.5 * ((F[1] + F[3]) + (d0 * F[1] + F[3] * d4 + F[6] * F[7])),
    )


@njit
def _second_piola_3d(F: Matrix3, law: SaintVenantKirchhoff) -> Symmetric3:
    E = _green_strain_3d(F)
    p, m = law.lmbda * (E[0] + E[1] + E[2]), 2.0 * law.mu
    return (m * E[0] + p, m * E[1] + p, m * E[2] + p, m * E[3], m * E[4], m * E[5])


@njit
def energy_density_3d(F: Matrix3, law: SaintVenantKirchhoff) -> float:
    """Return Psi(F)."""
    E = _green_strain_3d(F)
    trace = E[0] + E[1] + E[2]
    square = E[0] * E[0] + E[1] * E[1] + E[2] * E[2] + 2.0 * (E[3] * E[3] + E[4] * E[4] + E[5] * E[5])
    return law.mu * square + 0.5 * law.lmbda * trace * trace


@njit
def pk1_3d(F: Matrix3, law: SaintVenantKirchhoff) -> Matrix3:
    """Return P = F S."""
    S = _second_piola_3d(F, law)
    return (
        F[0] * S[0] + F[1] * S[5] + F[2] * S[4],
        F[0] * S[5] + F[1] * S[1] + F[2] * S[3],
        F[0] * S[4] + F[1] * S[3] + F[2] * S[2],
        F[3] * S[0] + F[4] * S[5] + F[5] * S[4],
        F[3] * S[5] + F[4] * S[1] + F[5] * S[3],
        F[3] * S[4] + F[4] * S[3] + F[5] * S[2],
        F[6] * S[0] + F[7] * S[5] + F[8] * S[4],
        F[6] * S[5] + F[7] * S[1] + F[8] * S[3],
        F[6] * S[4] + F[7] * S[3] + F[8] * S[2],
    )


@njit(fastmath=ORDERED)
def energy_from_stretches_3d(s: Vector3, law: SaintVenantKirchhoff) -> float:
    """Return Psi(diag(s))."""
    a = 0.5 * (s[0] - 1.0) * (s[0] + 1.0)
    b = 0.5 * (s[1] - 1.0) * (s[1] + 1.0)
    c = 0.5 * (s[2] - 1.0) * (s[2] + 1.0)
    trace = a + b + c
    return law.mu * (a * a + b * b + c * c) + 0.5 * law.lmbda * trace * trace


@njit
def stretch_derivatives_3d(s: Vector3, law: SaintVenantKirchhoff) -> tuple[Vector3, Symmetric3, Vector3, Vector3]:
    """Return (gradient, hessian, twist, flip); see `dispatch.stretch_derivatives`."""
    mu, lmbda = law.mu, law.lmbda
    a, b, c = s
    aa, bb, cc = a * a, b * b, c * c
    bc, ca, ab = b * c, c * a, a * b
    p = 0.5 * lmbda * ((aa - 1.0) + (bb - 1.0) + (cc - 1.0)) - mu
    gradient = ((mu * aa + p) * a, (mu * bb + p) * b, (mu * cc + p) * c)
    square = 3.0 * mu + lmbda
    hessian = (square * aa + p, square * bb + p, square * cc + p, lmbda * bc, lmbda * ca, lmbda * ab)
    twist = (mu * (bb + cc - bc) + p, mu * (cc + aa - ca) + p, mu * (aa + bb - ab) + p)
    flip = (mu * (bb + cc + bc) + p, mu * (cc + aa + ca) + p, mu * (aa + bb + ab) + p)
    return gradient, hessian, twist, flip


@njit
def _own_block(f: Vector3, S: Symmetric3, law: SaintVenantKirchhoff) -> Symmetric3:
    """Return S + (mu + lambda) f f^T + mu |f|^2 I."""
    k, m = law.mu + law.lmbda, law.mu * (f[0] * f[0] + f[1] * f[1] + f[2] * f[2])
    k0, k1, k2 = k * f[0], k * f[1], k * f[2]
    return (
        S[0] + m + k0 * f[0],
        S[1] + m + k1 * f[1],
        S[2] + m + k2 * f[2],
        S[3] + k1 * f[2],
        S[4] + k0 * f[2],
        S[5] + k0 * f[1],
    )


@njit
def _cross_block(f: Vector3, h: Vector3, law: SaintVenantKirchhoff) -> Matrix3:
    """Return lambda f h^T + mu h f^T + mu (f . h) I."""
    m = law.mu * (f[0] * h[0] + f[1] * h[1] + f[2] * h[2])
    p0, p1, p2 = law.lmbda * f[0], law.lmbda * f[1], law.lmbda * f[2]
    q0, q1, q2 = law.mu * f[0], law.mu * f[1], law.mu * f[2]
    return (
        p0 * h[0] + q0 * h[0] + m,
        p0 * h[1] + q1 * h[0],
        p0 * h[2] + q2 * h[0],
        p1 * h[0] + q0 * h[1],
        p1 * h[1] + q1 * h[1] + m,
        p1 * h[2] + q2 * h[1],
        p2 * h[0] + q0 * h[2],
        p2 * h[1] + q1 * h[2],
        p2 * h[2] + q2 * h[2] + m,
    )


@njit
def tangent_3d(F: Matrix3, law: SaintVenantKirchhoff, project: bool, H: NDArray[Any]) -> None:
    """Write the tangent into H; see `dispatch.tangent`.

    H_abcd = delta_ac S_bd + mu (F_ad F_cb + (F F^T)_ac delta_bd) + lambda F_ab F_cd; all but the first term
    is always positive semi-definite, so a tensile S needs no projection.
    """
    S = _second_piola_3d(F, law)
    if project and not is_surely_definite_3d(S):
        isotropic_tangent_3d(F, law, True, H)
        return
    f, h, k = (F[0], F[1], F[2]), (F[3], F[4], F[5]), (F[6], F[7], F[8])
    write_diagonal_block_3d(H, 0, _own_block(f, S, law))
    write_diagonal_block_3d(H, 3, _own_block(h, S, law))
    write_diagonal_block_3d(H, 6, _own_block(k, S, law))
    write_block_pair_3d(H, 0, 3, _cross_block(f, h, law))
    write_block_pair_3d(H, 0, 6, _cross_block(f, k, law))
    write_block_pair_3d(H, 3, 6, _cross_block(h, k, law))


# ---------------------------------------------------------------------------------------- 2D


@njit(fastmath=ORDERED)
def _green_strain_2d(F: Matrix2) -> Symmetric2:
    d0, d3 = F[0] - 1.0, F[3] - 1.0
    return (
        d0 + 0.5 * (d0 * d0 + F[2] * F[2]),
        d3 + 0.5 * (F[1] * F[1] + d3 * d3),
        0.5 * ((F[1] + F[2]) + (d0 * F[1] + F[2] * d3)),
    )


@njit
def _second_piola_2d(F: Matrix2, law: SaintVenantKirchhoff) -> Symmetric2:
    E = _green_strain_2d(F)
    p, m = law.lmbda * (E[0] + E[1]), 2.0 * law.mu
    return (m * E[0] + p, m * E[1] + p, m * E[2])


@njit
def energy_density_2d(F: Matrix2, law: SaintVenantKirchhoff) -> float:
    """Return Psi(F)."""
    E = _green_strain_2d(F)
    trace = E[0] + E[1]
    return law.mu * (E[0] * E[0] + E[1] * E[1] + 2.0 * E[2] * E[2]) + 0.5 * law.lmbda * trace * trace


@njit
def pk1_2d(F: Matrix2, law: SaintVenantKirchhoff) -> Matrix2:
    """Return P = F S."""
    S = _second_piola_2d(F, law)
    return (
        F[0] * S[0] + F[1] * S[2],
        F[0] * S[2] + F[1] * S[1],
        F[2] * S[0] + F[3] * S[2],
        F[2] * S[2] + F[3] * S[1],
    )


@njit(fastmath=ORDERED)
def energy_from_stretches_2d(s: Vector2, law: SaintVenantKirchhoff) -> float:
    """Return Psi(diag(s))."""
    a, b = 0.5 * (s[0] - 1.0) * (s[0] + 1.0), 0.5 * (s[1] - 1.0) * (s[1] + 1.0)
    trace = a + b
    return law.mu * (a * a + b * b) + 0.5 * law.lmbda * trace * trace


@njit
def stretch_derivatives_2d(
    s: Vector2, law: SaintVenantKirchhoff
) -> tuple[Vector2, Symmetric2, tuple[float], tuple[float]]:
    """Return (gradient, hessian, twist, flip); see `dispatch.stretch_derivatives`."""
    mu, lmbda = law.mu, law.lmbda
    a, b = s
    aa, bb, ab = a * a, b * b, a * b
    p = 0.5 * lmbda * ((aa - 1.0) + (bb - 1.0)) - mu
    square = 3.0 * mu + lmbda
    return (
        ((mu * aa + p) * a, (mu * bb + p) * b),
        (square * aa + p, square * bb + p, lmbda * ab),
        (mu * (aa + bb - ab) + p,),
        (mu * (aa + bb + ab) + p,),
    )


@njit
def tangent_2d(F: Matrix2, law: SaintVenantKirchhoff, project: bool, H: NDArray[Any]) -> None:
    """Write the tangent into H; see `tangent_3d`."""
    S = _second_piola_2d(F, law)
    if project and not is_surely_definite_2d(S):
        isotropic_tangent_2d(F, law, True, H)
        return
    mu, lmbda = law.mu, law.lmbda
    k = mu + lmbda
    a, b, c, d = F
    m, n, o = mu * (a * a + b * b), mu * (a * c + b * d), mu * (c * c + d * d)
    write_symmetric_2d(
        H,
        (S[0] + m + k * a * a, S[1] + m + k * b * b, S[2] + k * a * b),
        (n + k * a * c, lmbda * a * d + mu * b * c, lmbda * b * c + mu * a * d, n + k * b * d),
        (S[0] + o + k * c * c, S[1] + o + k * d * d, S[2] + k * c * d),
    )


_2D = Kernels(energy_density_2d, pk1_2d, tangent_2d, energy_from_stretches_2d, stretch_derivatives_2d)
_3D = Kernels(energy_density_3d, pk1_3d, tangent_3d, energy_from_stretches_3d, stretch_derivatives_3d)
register(SaintVenantKirchhoff, 2, _2D)
register(SaintVenantKirchhoff, 3, _3D)
