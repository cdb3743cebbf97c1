"""Linear elasticity."""

from __future__ import annotations

from typing import Any, NamedTuple, Self

from numpy.typing import NDArray

from femdeform.jit import ORDERED, njit
from femdeform.materials.dispatch import Kernels, register
from femdeform.materials.isotropic import write_block_pair_3d, write_diagonal_block_3d, write_symmetric_2d
from femdeform.materials.small_matrix import Matrix2, Matrix3


class Linear(NamedTuple):
    """Psi = mu |eps|^2 + lambda/2 (tr eps)^2 with eps = (F + F^T)/2 - I; P = 2 mu eps + lambda tr(eps) I.

    In 2D, plane strain: the 3D law at diag(F, 1). The tangent is constant and positive semi-definite.

    References
    ----------
    T. J. R. Hughes, "The Finite Element Method", Dover, 2000, chapter 2.

    Limitations
    -----------
    For small strains and small rotations: a rigid rotation costs energy and inflates the body. Not a function
    of the principal stretches of F, so it has no meaning for membranes and rods in space.
    """

    mu: float
    lmbda: float

    @classmethod
    def from_lame(cls, mu: float, lmbda: float, dim: int) -> Self:
        """Make the law from the Lame parameters [Pa]; the same in 2D and 3D."""
        return cls(mu, lmbda)


@njit(fastmath=ORDERED)
def energy_density_2d(F: Matrix2, law: Linear) -> float:
    """Return Psi(F)."""
    a, b, c = F[0] - 1.0, F[3] - 1.0, F[1] + F[2]
    t = a + b
    return law.mu * (a * a + b * b + 0.5 * c * c) + 0.5 * law.lmbda * t * t


@njit(fastmath=ORDERED)
def energy_density_3d(F: Matrix3, law: Linear) -> float:
    """Return Psi(F)."""
    a, b, c = F[0] - 1.0, F[4] - 1.0, F[8] - 1.0
    d, e, f = F[5] + F[7], F[2] + F[6], F[1] + F[3]
    t = a + b + c
    return law.mu * (a * a + b * b + c * c + 0.5 * (d * d + e * e + f * f)) + 0.5 * law.lmbda * t * t


@njit(fastmath=ORDERED)
def pk1_2d(F: Matrix2, law: Linear) -> Matrix2:
    """Return P = 2 mu eps + lambda tr(eps) I."""
    k = 2.0 * law.mu
    a, b, c = F[0] - 1.0, F[3] - 1.0, law.mu * (F[1] + F[2])
    p = law.lmbda * (a + b)
    return (k * a + p, c, c, k * b + p)


@njit(fastmath=ORDERED)
def pk1_3d(F: Matrix3, law: Linear) -> Matrix3:
    """Return P = 2 mu eps + lambda tr(eps) I."""
    k = 2.0 * law.mu
    a, b, c = F[0] - 1.0, F[4] - 1.0, F[8] - 1.0
    d, e, f = law.mu * (F[5] + F[7]), law.mu * (F[2] + F[6]), law.mu * (F[1] + F[3])
    p = law.lmbda * (a + b + c)
    return (k * a + p, f, e, f, k * b + p, d, e, d, k * c + p)


@njit
def tangent_2d(F: Matrix2, law: Linear, project: bool, H: NDArray[Any]) -> None:
    """Write the tangent into H, the same for every F and positive semi-definite; see `dispatch.tangent`."""
    mu, lmbda = law.mu, law.lmbda
    own = 2.0 * mu + lmbda
    write_symmetric_2d(H, (own, mu, 0.0), (0.0, lmbda, mu, 0.0), (mu, own, 0.0))


@njit
def tangent_3d(F: Matrix3, law: Linear, project: bool, H: NDArray[Any]) -> None:
    """Write the tangent into H, the same for every F and positive semi-definite; see `dispatch.tangent`."""
    mu, lmbda = law.mu, law.lmbda
    own = 2.0 * mu + lmbda
    write_diagonal_block_3d(H, 0, (own, mu, mu, 0.0, 0.0, 0.0))
    write_diagonal_block_3d(H, 3, (mu, own, mu, 0.0, 0.0, 0.0))
    write_diagonal_block_3d(H, 6, (mu, mu, own, 0.0, 0.0, 0.0))
    write_block_pair_3d(H, 0, 3, (0.0, lmbda, 0.0, mu, 0.0, 0.0, 0.0, 0.0, 0.0))
    write_block_pair_3d(H, 0, 6, (0.0, 0.0, lmbda, 0.0, 0.0, 0.0, mu, 0.0, 0.0))
    write_block_pair_3d(H, 3, 6, (0.0, 0.0, 0.0, 0.0, 0.0, lmbda, 0.0, mu, 0.0))


register(Linear, 2, Kernels(energy_density_2d, pk1_2d, tangent_2d))
register(Linear, 3, Kernels(energy_density_3d, pk1_3d, tangent_3d))
