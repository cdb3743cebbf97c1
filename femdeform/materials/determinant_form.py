"""What the laws Psi = (function of |F|^2) + g(J) share.

These are the neo-Hookean family and, in part, the fixed corotated law. Their stress is m F + g' cof F and
their tangent m I + e F F^T + g'' cof cof^T + g' d2J/dF2, with numbers m and e that depend on the law (e = 0
but for the stable neo-Hookean law): no singular value decomposition is needed, and F may be singular or
inverted wherever g is defined.
"""

from __future__ import annotations

import math
from typing import Any

from numpy.typing import NDArray

from femdeform.jit import ORDERED, njit
from femdeform.materials.isotropic import write_block_pair_3d, write_diagonal_block_3d, write_symmetric_2d
from femdeform.materials.small_matrix import Matrix2, Matrix3, Symmetric2, Symmetric3, Vector2, Vector3

# ---------------------------------------------------------------------------------------- invariants


@njit(fastmath=ORDERED)
def stretch_invariants_2d(s: Vector2) -> tuple[float, float, float]:
    """Return `small_matrix.strain_invariants_2d` of diag(s)."""
    a, b = s[0] - 1.0, s[1] - 1.0
    rest = a * b
    return (a + b) + rest, a * a + b * b, rest


@njit(fastmath=ORDERED)
def stretch_invariants_3d(s: Vector3) -> tuple[float, float, float]:
    """Return `small_matrix.strain_invariants_3d` of diag(s)."""
    a, b, c = s[0] - 1.0, s[1] - 1.0, s[2] - 1.0
    rest = (a * b + b * c + c * a) + a * b * c
    return (a + b + c) + rest, a * a + b * b + c * c, rest


# ---------------------------------------------------------------------------------------- stress


@njit
def combination_2d(a: float, A: Matrix2, b: float, B: Matrix2) -> Matrix2:
    """Return a A + b B."""
    return (a * A[0] + b * B[0], a * A[1] + b * B[1], a * A[2] + b * B[2], a * A[3] + b * B[3])


@njit
def combination_3d(a: float, A: Matrix3, b: float, B: Matrix3) -> Matrix3:
    """Return a A + b B."""
    return (
        a * A[0] + b * B[0],
        a * A[1] + b * B[1],
        a * A[2] + b * B[2],
        a * A[3] + b * B[3],
        a * A[4] + b * B[4],
        a * A[5] + b * B[5],
        a * A[6] + b * B[6],
        a * A[7] + b * B[7],
        a * A[8] + b * B[8],
    )


# ---------------------------------------------------------------------------------------- exact tangents


@njit
def determinant_tangent_2d(F: Matrix2, C: Matrix2, m: float, e: float, g1: float, g2: float, H: NDArray[Any]) -> None:
    """Write m I + e F F^T + g2 C C^T + g1 d2J/dF2 into the 4x4 array H; C is the cofactor matrix of F."""
    a0, a1, a2, a3 = e * F[0], e * F[1], e * F[2], e * F[3]
    b0, b1, b2, b3 = g2 * C[0], g2 * C[1], g2 * C[2], g2 * C[3]
    write_symmetric_2d(
        H,
        (m + a0 * F[0] + b0 * C[0], m + a1 * F[1] + b1 * C[1], a0 * F[1] + b0 * C[1]),
        (
            a0 * F[2] + b0 * C[2],
            a0 * F[3] + b0 * C[3] + g1,
            a1 * F[2] + b1 * C[2] - g1,
            a1 * F[3] + b1 * C[3],
        ),
        (m + a2 * F[2] + b2 * C[2], m + a3 * F[3] + b3 * C[3], a2 * F[3] + b2 * C[3]),
    )


@njit
def _diagonal_block(m: float, e: float, f: Vector3, g2: float, c: Vector3) -> Symmetric3:
    a0, a1, a2 = e * f[0], e * f[1], e * f[2]
    b0, b1, b2 = g2 * c[0], g2 * c[1], g2 * c[2]
    return (
        m + a0 * f[0] + b0 * c[0],
        m + a1 * f[1] + b1 * c[1],
        m + a2 * f[2] + b2 * c[2],
        a1 * f[2] + b1 * c[2],
        a0 * f[2] + b0 * c[2],
        a0 * f[1] + b0 * c[1],
    )


@njit
def _off_diagonal_block(e: float, f: Vector3, h: Vector3, g2: float, c: Vector3, d: Vector3, k: Vector3) -> Matrix3:
    """Return e f h^T + g2 c d^T + the skew matrix of k."""
    a0, a1, a2 = e * f[0], e * f[1], e * f[2]
    b0, b1, b2 = g2 * c[0], g2 * c[1], g2 * c[2]
    return (
        a0 * h[0] + b0 * d[0],
        a0 * h[1] + b0 * d[1] + k[2],
        a0 * h[2] + b0 * d[2] - k[1],
        a1 * h[0] + b1 * d[0] - k[2],
        a1 * h[1] + b1 * d[1],
        a1 * h[2] + b1 * d[2] + k[0],
        a2 * h[0] + b2 * d[0] + k[1],
        a2 * h[1] + b2 * d[1] - k[0],
        a2 * h[2] + b2 * d[2],
    )


@njit
def determinant_tangent_3d(F: Matrix3, C: Matrix3, m: float, e: float, g1: float, g2: float, H: NDArray[Any]) -> None:
    """Write m I + e F F^T + g2 C C^T + g1 d2J/dF2 into the 9x9 array H; C is the cofactor matrix of F.

    d2J/dF_ab dF_cd = eps_ace eps_bdf F_ef: the block of rows a and c is the skew matrix of the third row of
    F.
    """
    f, h, k = (F[0], F[1], F[2]), (F[3], F[4], F[5]), (F[6], F[7], F[8])
    c, d, q = (C[0], C[1], C[2]), (C[3], C[4], C[5]), (C[6], C[7], C[8])
    write_diagonal_block_3d(H, 0, _diagonal_block(m, e, f, g2, c))
    write_diagonal_block_3d(H, 3, _diagonal_block(m, e, h, g2, d))
    write_diagonal_block_3d(H, 6, _diagonal_block(m, e, k, g2, q))
    third = (g1 * k[0], g1 * k[1], g1 * k[2])
    write_block_pair_3d(H, 0, 3, _off_diagonal_block(e, f, h, g2, c, d, third))
    third = (-g1 * h[0], -g1 * h[1], -g1 * h[2])
    write_block_pair_3d(H, 0, 6, _off_diagonal_block(e, f, k, g2, c, q, third))
    third = (g1 * f[0], g1 * f[1], g1 * f[2])
    write_block_pair_3d(H, 3, 6, _off_diagonal_block(e, h, k, g2, d, q, third))


# ---------------------------------------------------------------------------------------- definiteness


@njit
def is_surely_convex_2d(m: float, g1: float, g2: float) -> bool:
    """Tell whether m I + g2 C C^T + g1 d2J/dF2 is positive semi-definite, for a reason cheap to see (2D).

    d2J/dF2 has the eigenvalues 1, 1, -1, -1.
    """
    return abs(g1) <= m and g2 >= 0.0


@njit
def is_surely_convex_3d(F: Matrix3, J: float, m: float, g1: float, g2: float) -> bool:
    """Tell whether m I + g2 C C^T + g1 d2J/dF2 is positive semi-definite, for a reason cheap to see (3D).

    The modes are: twist m + g1 s_k, flip m - g1 s_k, and a scaling block. Let J > 0, so that all s_k > 0.

    - g1 < 0: flips are positive; twists are if -g1 s_0 <= m, with s_0 bounded by trace and norm of F^T F (Wolkowicz
      and Styan 1980). The scaling block is diag(m - g1 c_i^2 / J) + (g2 + g1 / J) c c^T with c_i = J / s_i,
      which is positive if -(g2 + g1 / J) times sum c_i^2 / (m - g1 c_i^2 / J) <= 1; that sum is below -3 J /
      g1, so 3 J g2 >= -2 g1 is enough.
    - g1 >= 0: no eigenvalue of d2J/dF2 is below -|F|, so g1 |F| <= m and g2 >= 0 are enough.
    """
    if not J > 0.0:
        return False
    xx, yy, zz = (
        F[0] * F[0] + F[3] * F[3] + F[6] * F[6],
        F[1] * F[1] + F[4] * F[4] + F[7] * F[7],
        F[2] * F[2] + F[5] * F[5] + F[8] * F[8],
    )
    if g1 >= 0.0:
        return g2 >= 0.0 and g1 * g1 * (xx + yy + zz) <= m * m
    if 3.0 * J * g2 < -2.0 * g1:
        return False
    xy, yz, zx = (
        F[0] * F[1] + F[3] * F[4] + F[6] * F[7],
        F[1] * F[2] + F[4] * F[5] + F[7] * F[8],
        F[2] * F[0] + F[5] * F[3] + F[8] * F[6],
    )
    mean = (xx + yy + zz) / 3.0
    deviation = (xx - mean) ** 2 + (yy - mean) ** 2 + (zz - mean) ** 2 + 2.0 * (xy * xy + yz * yz + zx * zx)
    return g1 * g1 * (mean + math.sqrt(deviation * (2.0 / 3.0))) <= m * m


# ---------------------------------------------------------------------------------------- in stretches


@njit
def determinant_modes_2d(
    s: Vector2, m: float, e: float, g1: float, g2: float
) -> tuple[Symmetric2, tuple[float], tuple[float]]:
    """Return hessian, twist and flip (see `dispatch.stretch_derivatives`) of the terms described above."""
    a, b = s
    hessian = (m + e * a * a + g2 * b * b, m + e * b * b + g2 * a * a, e * a * b + g2 * a * b + g1)
    return hessian, (m + g1,), (m - g1,)


@njit
def determinant_modes_3d(s: Vector3, m: float, e: float, g1: float, g2: float) -> tuple[Symmetric3, Vector3, Vector3]:
    """Return hessian, twist and flip (see `dispatch.stretch_derivatives`) of the terms described above."""
    a, b, c = s
    bc, ca, ab = b * c, c * a, a * b
    hessian = (
        m + e * a * a + g2 * bc * bc,
        m + e * b * b + g2 * ca * ca,
        m + e * c * c + g2 * ab * ab,
        e * bc + g2 * ca * ab + g1 * a,
        e * ca + g2 * bc * ab + g1 * b,
        e * ab + g2 * bc * ca + g1 * c,
    )
    return hessian, (m + g1 * a, m + g1 * b, m + g1 * c), (m - g1 * a, m - g1 * b, m - g1 * c)
