"""Tangent of any isotropic law from its derivatives with respect to the principal stretches.

With F = U diag(s) V^T the tangent of an isotropic law has, in the rotated basis u_i v_j^T, a scaling block
A_ij on the diagonal directions and, for each pair (i, j), two modes across: twist, U (e_j e_i^T - e_i e_j^T)
V^T / sqrt 2 with eigenvalue (psi_i + psi_j) / (s_i + s_j), and flip, U (e_i e_j^T + e_j e_i^T) V^T / sqrt 2
with eigenvalue (psi_i - psi_j) / (s_i - s_j). Projection clamps these values; no 9x9 eigenproblem is ever
solved.

References
----------
B. Smith, F. de Goes, T. Kim, "Analytic eigensystems for isotropic distortion energies", ACM Transactions on
Graphics 38(1), 2019.
"""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from femdeform.jit import njit
from femdeform.materials.dispatch import Law, stretch_derivatives
from femdeform.materials.small_matrix import (
    Matrix2,
    Matrix3,
    Symmetric2,
    Symmetric3,
    Vector3,
    clamp_symmetric_2d,
    clamp_symmetric_3d,
    signed_svd_2d,
    signed_svd_3d,
)

_SMALLEST_SUM = 1.0e-6


@njit
def guarded_sum(a: float, b: float) -> float:
    """Return a + b, kept away from 0, where the polar rotation jumps and a twist value is infinite."""
    total = a + b
    if abs(total) < _SMALLEST_SUM:
        return _SMALLEST_SUM if total >= 0.0 else -_SMALLEST_SUM
    return total


@njit
def clamp(value: float) -> float:
    """Return the value, or 0 if it is negative; nan stays nan."""
    return 0.0 if value < 0.0 else value


# ---------------------------------------------------------------------------------------- 3D


@njit
def write_diagonal_block_3d(H: NDArray[Any], i: int, B: Symmetric3) -> None:
    """Write a symmetric 3x3 block at (i, i)."""
    H[i, i], H[i + 1, i + 1], H[i + 2, i + 2] = B[0], B[1], B[2]
    H[i + 1, i + 2] = H[i + 2, i + 1] = B[3]
    H[i, i + 2] = H[i + 2, i] = B[4]
    H[i, i + 1] = H[i + 1, i] = B[5]


@njit
def write_block_pair_3d(H: NDArray[Any], i: int, j: int, B: Matrix3) -> None:
    """Write a 3x3 block at (i, j) and its transpose at (j, i)."""
    H[i, j] = H[j, i] = B[0]
    H[i, j + 1] = H[j + 1, i] = B[1]
    H[i, j + 2] = H[j + 2, i] = B[2]
    H[i + 1, j] = H[j, i + 1] = B[3]
    H[i + 1, j + 1] = H[j + 1, i + 1] = B[4]
    H[i + 1, j + 2] = H[j + 2, i + 1] = B[5]
    H[i + 2, j] = H[j, i + 2] = B[6]
    H[i + 2, j + 1] = H[j + 1, i + 2] = B[7]
    H[i + 2, j + 2] = H[j + 2, i + 2] = B[8]


@njit
def _sum_of_squares(a: float, u: Vector3, b: float, v: Vector3, c: float, w: Vector3) -> Symmetric3:
    """Return a u u^T + b v v^T + c w w^T."""
    au0, au1, au2 = a * u[0], a * u[1], a * u[2]
    bv0, bv1, bv2 = b * v[0], b * v[1], b * v[2]
    cw0, cw1, cw2 = c * w[0], c * w[1], c * w[2]
    return (
        au0 * u[0] + bv0 * v[0] + cw0 * w[0],
        au1 * u[1] + bv1 * v[1] + cw1 * w[1],
        au2 * u[2] + bv2 * v[2] + cw2 * w[2],
        au1 * u[2] + bv1 * v[2] + cw1 * w[2],
        au0 * u[2] + bv0 * v[2] + cw0 * w[2],
        au0 * u[1] + bv0 * v[1] + cw0 * w[1],
    )


@njit
def _two_products(a: float, b: float, u: Vector3, v: Vector3) -> Matrix3:
    """Return a u v^T + b v u^T."""
    au0, au1, au2 = a * u[0], a * u[1], a * u[2]
    bv0, bv1, bv2 = b * v[0], b * v[1], b * v[2]
    return (
        au0 * v[0] + bv0 * u[0],
        au0 * v[1] + bv0 * u[1],
        au0 * v[2] + bv0 * u[2],
        au1 * v[0] + bv1 * u[0],
        au1 * v[1] + bv1 * u[1],
        au1 * v[2] + bv1 * u[2],
        au2 * v[0] + bv2 * u[0],
        au2 * v[1] + bv2 * u[1],
        au2 * v[2] + bv2 * u[2],
    )


@njit
def _block(
    a: Vector3, c: Vector3, P: Symmetric3, Q: Symmetric3, R: Symmetric3, X: Matrix3, Y: Matrix3, Z: Matrix3
) -> Matrix3:
    """Return the 3x3 block of the tangent that belongs to the rows a and c of U."""
    p, q, r = a[0] * c[0], a[1] * c[1], a[2] * c[2]
    x, xt = a[1] * c[2], a[2] * c[1]
    y, yt = a[2] * c[0], a[0] * c[2]
    z, zt = a[0] * c[1], a[1] * c[0]
    d12 = p * P[3] + q * Q[3] + r * R[3]
    d02 = p * P[4] + q * Q[4] + r * R[4]
    d01 = p * P[5] + q * Q[5] + r * R[5]
    return (
        p * P[0] + q * Q[0] + r * R[0] + (x + xt) * X[0] + (y + yt) * Y[0] + (z + zt) * Z[0],
        d01 + x * X[1] + xt * X[3] + y * Y[1] + yt * Y[3] + z * Z[1] + zt * Z[3],
        d02 + x * X[2] + xt * X[6] + y * Y[2] + yt * Y[6] + z * Z[2] + zt * Z[6],
        d01 + x * X[3] + xt * X[1] + y * Y[3] + yt * Y[1] + z * Z[3] + zt * Z[1],
        p * P[1] + q * Q[1] + r * R[1] + (x + xt) * X[4] + (y + yt) * Y[4] + (z + zt) * Z[4],
        d12 + x * X[5] + xt * X[7] + y * Y[5] + yt * Y[7] + z * Z[5] + zt * Z[7],
        d02 + x * X[6] + xt * X[2] + y * Y[6] + yt * Y[2] + z * Z[6] + zt * Z[2],
        d12 + x * X[7] + xt * X[5] + y * Y[7] + yt * Y[5] + z * Z[7] + zt * Z[5],
        p * P[2] + q * Q[2] + r * R[2] + (x + xt) * X[8] + (y + yt) * Y[8] + (z + zt) * Z[8],
    )


@njit
def _write_diagonal(H: NDArray[Any], i: int, B: Matrix3) -> None:
    write_diagonal_block_3d(H, i, (B[0], B[4], B[8], B[5], B[2], B[1]))


@njit
def assemble_modes_3d(
    U: Matrix3, V: Matrix3, hessian: Symmetric3, twist: Vector3, flip: Vector3, H: NDArray[Any]
) -> None:
    """Write the 9x9 tangent with the given rotations and modes into H; see `dispatch.stretch_derivatives`.

    For stretch pairs (i, j) the modes couple u_i v_j^T to itself by (flip + twist) / 2 and to u_j v_i^T by
    (flip - twist) / 2. Blocks are summed over the columns of V first, then over those of U.
    """
    u, v, w = (V[0], V[3], V[6]), (V[1], V[4], V[7]), (V[2], V[5], V[8])
    self12, self20, self01 = (
        0.5 * (flip[0] + twist[0]),
        0.5 * (flip[1] + twist[1]),
        0.5 * (flip[2] + twist[2]),
    )
    P = _sum_of_squares(hessian[0], u, self01, v, self20, w)
    Q = _sum_of_squares(self01, u, hessian[1], v, self12, w)
    R = _sum_of_squares(self20, u, self12, v, hessian[2], w)
    X = _two_products(hessian[3], 0.5 * (flip[0] - twist[0]), v, w)
    Y = _two_products(hessian[4], 0.5 * (flip[1] - twist[1]), w, u)
    Z = _two_products(hessian[5], 0.5 * (flip[2] - twist[2]), u, v)
    a, b, c = (U[0], U[1], U[2]), (U[3], U[4], U[5]), (U[6], U[7], U[8])
    _write_diagonal(H, 0, _block(a, a, P, Q, R, X, Y, Z))
    _write_diagonal(H, 3, _block(b, b, P, Q, R, X, Y, Z))
    _write_diagonal(H, 6, _block(c, c, P, Q, R, X, Y, Z))
    write_block_pair_3d(H, 0, 3, _block(a, b, P, Q, R, X, Y, Z))
    write_block_pair_3d(H, 0, 6, _block(a, c, P, Q, R, X, Y, Z))
    write_block_pair_3d(H, 3, 6, _block(b, c, P, Q, R, X, Y, Z))


@njit
def isotropic_tangent_3d(F: Matrix3, law: Law, project: bool, H: NDArray[Any]) -> None:
    """Write the 9x9 tangent of any law with stretch derivatives into H; see `dispatch.tangent`."""
    U, s, V = signed_svd_3d(F)
    _, hessian, twist, flip = stretch_derivatives(s, law)
    if project:
        hessian = clamp_symmetric_3d(hessian)
        twist = (clamp(twist[0]), clamp(twist[1]), clamp(twist[2]))
        flip = (clamp(flip[0]), clamp(flip[1]), clamp(flip[2]))
    assemble_modes_3d(U, V, hessian, twist, flip, H)


# ---------------------------------------------------------------------------------------- 2D


@njit
def write_symmetric_2d(H: NDArray[Any], A: Symmetric2, B: Matrix2, C: Symmetric2) -> None:
    """Write the symmetric 4x4 matrix [[A, B], [B^T, C]]."""
    H[0, 0], H[1, 1], H[2, 2], H[3, 3] = A[0], A[1], C[0], C[1]
    H[0, 1] = H[1, 0] = A[2]
    H[2, 3] = H[3, 2] = C[2]
    H[0, 2] = H[2, 0] = B[0]
    H[0, 3] = H[3, 0] = B[1]
    H[1, 2] = H[2, 1] = B[2]
    H[1, 3] = H[3, 1] = B[3]


@njit
def assemble_modes_2d(U: Matrix2, V: Matrix2, hessian: Symmetric2, twist: float, flip: float, H: NDArray[Any]) -> None:
    """Write the 4x4 tangent with the given rotations and modes into H; see `assemble_modes_3d`."""
    own, other = 0.5 * (flip + twist), 0.5 * (flip - twist)
    c, s = V[0], V[2]
    cc, ss, cs = c * c, s * s, c * s
    # The columns of V are (c, s) and (-s, c).
    P = (hessian[0] * cc + own * ss, hessian[0] * ss + own * cc, (hessian[0] - own) * cs)
    Q = (own * cc + hessian[1] * ss, own * ss + hessian[1] * cc, (own - hessian[1]) * cs)
    z0 = -(hessian[2] + other) * cs
    z1, z2 = hessian[2] * cc - other * ss, other * cc - hessian[2] * ss
    a, b = U[0], U[2]
    # The rows of U are (a, -b) and (b, a).
    aa, bb, ab = a * a, b * b, a * b
    shear = ab * (z1 + z2)
    twice = 2.0 * ab * z0
    d01 = ab * (P[2] - Q[2])
    write_symmetric_2d(
        H,
        (aa * P[0] + bb * Q[0] - twice, aa * P[1] + bb * Q[1] + twice, aa * P[2] + bb * Q[2] - shear),
        (
            ab * (P[0] - Q[0]) + (aa - bb) * z0,
            d01 + aa * z1 - bb * z2,
            d01 + aa * z2 - bb * z1,
            ab * (P[1] - Q[1]) - (aa - bb) * z0,
        ),
        (bb * P[0] + aa * Q[0] + twice, bb * P[1] + aa * Q[1] - twice, bb * P[2] + aa * Q[2] + shear),
    )


@njit
def isotropic_tangent_2d(F: Matrix2, law: Law, project: bool, H: NDArray[Any]) -> None:
    """Write the 4x4 tangent of any law with stretch derivatives into H; see `dispatch.tangent`."""
    U, s, V = signed_svd_2d(F)
    _, hessian, twist, flip = stretch_derivatives(s, law)
    if project:
        hessian = clamp_symmetric_2d(hessian)
        assemble_modes_2d(U, V, hessian, clamp(twist[0]), clamp(flip[0]), H)
    else:
        assemble_modes_2d(U, V, hessian, twist[0], flip[0], H)
