"""Algebra of 2x2 and 3x3 matrices for compiled kernels: matrices are flat, row-major tuples of floats.

Tuples live in registers: nothing here allocates. A 3x3 matrix is ``(A00, A01, A02, A10, ..., A22)``; a
symmetric matrix is ``(S00, S11, S22, S12, S02, S01)`` in 3D and ``(S00, S11, S01)`` in 2D. Nan in gives nan
out, and every iteration is bounded. Matrices of norm 1e-70 to 1e70 keep their relative accuracy. Literals are
float64, so float32 input is computed in float64 where it is mixed with them.
"""

from __future__ import annotations

import math
from typing import TypeAlias

from femdeform.jit import ORDERED, njit

Vector2: TypeAlias = tuple[float, float]
Vector3: TypeAlias = tuple[float, float, float]
Symmetric2: TypeAlias = tuple[float, float, float]
Symmetric3: TypeAlias = tuple[float, float, float, float, float, float]
Matrix2: TypeAlias = tuple[float, float, float, float]
Matrix3: TypeAlias = tuple[float, float, float, float, float, float, float, float, float]

Columns3: TypeAlias = tuple[Vector3, Vector3, Vector3]

# Cosine between two columns below which they count as orthogonal, squared.
_ORTHOGONAL = (4.0e-15) ** 2
_DEFINITE = 1.0e-10
_MAX_SWEEPS = 12
# A length below this counts as 0: its square would lose digits to underflow.
_TINY = 1.0e-140


# ---------------------------------------------------------------------------------------- invariants


@njit
def det_2d(F: Matrix2) -> float:
    """Return the determinant of a 2x2 matrix."""
    return F[0] * F[3] - F[1] * F[2]


@njit
def det_3d(F: Matrix3) -> float:
    """Return the determinant of a 3x3 matrix."""
    return F[0] * (F[4] * F[8] - F[5] * F[7]) + F[1] * (F[5] * F[6] - F[3] * F[8]) + F[2] * (F[3] * F[7] - F[4] * F[6])


@njit
def cofactor_2d(F: Matrix2) -> Matrix2:
    """Return dJ/dF of a 2x2 matrix; J F^-T where that exists."""
    return (F[3], -F[2], -F[1], F[0])


@njit
def cofactor_3d(F: Matrix3) -> Matrix3:
    """Return dJ/dF of a 3x3 matrix by cross products; J F^-T where that exists, defined for singular F."""
    return (
        F[4] * F[8] - F[5] * F[7],
        F[5] * F[6] - F[3] * F[8],
        F[3] * F[7] - F[4] * F[6],
        F[2] * F[7] - F[1] * F[8],
        F[0] * F[8] - F[2] * F[6],
        F[1] * F[6] - F[0] * F[7],
        F[1] * F[5] - F[2] * F[4],
        F[2] * F[3] - F[0] * F[5],
        F[0] * F[4] - F[1] * F[3],
    )


@njit(fastmath=ORDERED)
def strain_invariants_2d(F: Matrix2) -> tuple[float, float, float]:
    """Return (J - 1, |D|^2, det D) with D = F - I, without cancellation near F = I.

    With these, ``|F|^2 - 2 - 2 (J - 1) = |D|^2 - 2 det D``: energies near rest keep their relative accuracy.
    """
    d0, d3 = F[0] - 1.0, F[3] - 1.0
    second = d0 * d3 - F[1] * F[2]
    return (d0 + d3) + second, d0 * d0 + d3 * d3 + F[1] * F[1] + F[2] * F[2], second


@njit(fastmath=ORDERED)
def strain_invariants_3d(F: Matrix3) -> tuple[float, float, float]:
    """Return (J - 1, |D|^2, I2(D) + det D) with D = F - I, without cancellation near F = I.

    With these, ``|F|^2 - 3 - 2 (J - 1) = |D|^2 - 2 (I2 + det D)``: energies near rest keep their relative
    accuracy.
    """
    d0, d4, d8 = F[0] - 1.0, F[4] - 1.0, F[8] - 1.0
    c0 = d4 * d8 - F[5] * F[7]
    c4 = d0 * d8 - F[2] * F[6]
    c8 = d0 * d4 - F[1] * F[3]
    third = d0 * c0 + F[1] * (F[5] * F[6] - F[3] * d8) + F[2] * (F[3] * F[7] - d4 * F[6])
    rest = (c0 + c4 + c8) + third
    square = (d0 * d0 + d4 * d4 + d8 * d8) + (
        (F[1] * F[1] + F[2] * F[2] + F[3] * F[3]) + (F[5] * F[5] + F[6] * F[6] + F[7] * F[7])
    )
    return (d0 + d4 + d8) + rest, square, rest


@njit
def squared_norm_2d(F: Matrix2) -> float:
    """Return the sum of the squared entries of a 2x2 matrix."""
    return F[0] * F[0] + F[1] * F[1] + F[2] * F[2] + F[3] * F[3]


@njit
def squared_norm_3d(F: Matrix3) -> float:
    """Return the sum of the squared entries of a 3x3 matrix."""
    return (
        (F[0] * F[0] + F[1] * F[1] + F[2] * F[2])
        + (F[3] * F[3] + F[4] * F[4] + F[5] * F[5])
        + (F[6] * F[6] + F[7] * F[7] + F[8] * F[8])
    )


# ---------------------------------------------------------------------------------------- products


@njit
def transpose_2d(A: Matrix2) -> Matrix2:
    """Return A^T."""
    return (A[0], A[2], A[1], A[3])


@njit
def transpose_3d(A: Matrix3) -> Matrix3:
    """Return A^T."""
    return (A[0], A[3], A[6], A[1], A[4], A[7], A[2], A[5], A[8])


@njit
def multiply_2d(A: Matrix2, B: Matrix2) -> Matrix2:
    """Return A B."""
    return (
        A[0] * B[0] + A[1] * B[2],
        A[0] * B[1] + A[1] * B[3],
        A[2] * B[0] + A[3] * B[2],
        A[2] * B[1] + A[3] * B[3],
    )


@njit
def multiply_3d(A: Matrix3, B: Matrix3) -> Matrix3:
    """Return A B."""
    return (
        A[0] * B[0] + A[1] * B[3] + A[2] * B[6],
        A[0] * B[1] + A[1] * B[4] + A[2] * B[7],
        A[0] * B[2] + A[1] * B[5] + A[2] * B[8],
        A[3] * B[0] + A[4] * B[3] + A[5] * B[6],
        A[3] * B[1] + A[4] * B[4] + A[5] * B[7],
        A[3] * B[2] + A[4] * B[5] + A[5] * B[8],
        A[6] * B[0] + A[7] * B[3] + A[8] * B[6],
        A[6] * B[1] + A[7] * B[4] + A[8] * B[7],
        A[6] * B[2] + A[7] * B[5] + A[8] * B[8],
    )


# ---------------------------------------------------------------------------------------- 2D


@njit
def symmetric_frame_2d(S: Symmetric2) -> Vector2:
    """Return (c, s): the columns (c, s) and (-s, c) are eigenvectors, that of the larger eigenvalue first."""
    difference, twice = S[0] - S[1], 2.0 * S[2]
    r = math.sqrt(difference * difference + twice * twice)
    if r < _TINY:
        return 1.0, 0.0
    # Half-angle vector of (difference, twice), from the side without cancellation.
    near = r + abs(difference)
    scale = 1.0 / math.sqrt(near * near + twice * twice)
    near, far = near * scale, twice * scale
    if difference >= 0.0:
        return near, far
    return abs(far), math.copysign(near, far)


@njit
def symmetric_eigen_2d(S: Symmetric2) -> tuple[Vector2, Matrix2]:
    """Return eigenvalues (descending) and the rotation whose columns are the eigenvectors."""
    c, s = symmetric_frame_2d(S)
    cross = 2.0 * c * s * S[2]
    return (c * c * S[0] + s * s * S[1] + cross, s * s * S[0] + c * c * S[1] - cross), (c, -s, s, c)


@njit
def rotation_and_trace_2d(F: Matrix2) -> tuple[Matrix2, float]:
    """Return R and tr S - 2 of F = R S with det R = 1, also for det F < 0; R = I where R is arbitrary."""
    x, y = F[0] + F[3], F[2] - F[1]
    r = math.sqrt(x * x + y * y)
    if r < _TINY:
        return (1.0, 0.0, 0.0, 1.0), -2.0
    c, s = x / r, y / r
    return (c, -s, s, c), r - 2.0


@njit
def polar_rotation_2d(F: Matrix2) -> Matrix2:
    """Return the rotation closest to F, with determinant 1 also for det F < 0."""
    R, _ = rotation_and_trace_2d(F)
    return R


@njit
def signed_svd_2d(F: Matrix2) -> tuple[Matrix2, Vector2, Matrix2]:
    """Return (U, s, V) with F = U diag(s) V^T, U and V rotations and s0 >= |s1|; s1 has the sign of det F."""
    R = polar_rotation_2d(F)
    c, s = R[0], R[2]
    S00 = c * F[0] + s * F[2]
    S11 = c * F[3] - s * F[1]
    S01 = 0.5 * ((c * F[1] + s * F[3]) + (c * F[2] - s * F[0]))
    stretches, V = symmetric_eigen_2d((S00, S11, S01))
    return multiply_2d(R, V), stretches, V


@njit
def is_surely_definite_2d(S: Symmetric2) -> bool:
    """Tell whether S is positive definite by a margin that rounding cannot forge."""
    product = S[0] * S[1]
    return S[0] > 0.0 and S[1] > 0.0 and product - S[2] * S[2] > _DEFINITE * product


@njit
def clamp_symmetric_2d(S: Symmetric2) -> Symmetric2:
    """Return the closest positive semi-definite symmetric matrix: negative eigenvalues become 0."""
    if is_surely_definite_2d(S):
        return S
    w, V = symmetric_eigen_2d(S)
    w0 = 0.0 if w[0] < 0.0 else w[0]
    w1 = 0.0 if w[1] < 0.0 else w[1]
    c, s = V[0], V[2]
    return (w0 * c * c + w1 * s * s, w0 * s * s + w1 * c * c, (w0 - w1) * c * s)


# ---------------------------------------------------------------------------------------- 3D


@njit
def symmetric_frame_3d(S: Symmetric3) -> Columns3:
    """Return the columns of a rotation that are approximate eigenvectors of S, eigenvalues descending.

    The eigenvalue farthest from the others is a well-conditioned root of the characteristic cubic; its
    eigenvector is the largest column of adj(S - x I), and the plane across is a 2x2 problem. No step divides
    by a small gap, so what S has off the diagonal of this frame is a few roundings of |S|, also for repeated
    eigenvalues.
    """
    mean = (S[0] + S[1] + S[2]) / 3.0
    a00, a11, a22, a12, a02, a01 = S[0] - mean, S[1] - mean, S[2] - mean, S[3], S[4], S[5]
    q = a00 * a00 + a11 * a11 + a22 * a22 + 2.0 * (a12 * a12 + a02 * a02 + a01 * a01)
    if q < _TINY * _TINY:
        return (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    scale = math.sqrt(6.0 / q)
    a00, a11, a22 = a00 * scale, a11 * scale, a22 * scale
    a12, a02, a01 = a12 * scale, a02 * scale, a01 * scale

    # Eigenvalues of the scaled deviator solve x^3 - 3 x = d with |d| <= 2: the outer root lies in [sqrt 3,
    # 2].
    d = a00 * (a11 * a22 - a12 * a12) + a01 * (a12 * a02 - a01 * a22) + a02 * (a01 * a12 - a11 * a02)
    size = min(abs(d), 2.0)
    # Chebyshev interpolant of degree 3, error 8e-5; two Newton steps square that twice.
    x = 0.16533035022084486 + size * (-0.020345598711442925 + size * 0.0023299209743701255)
    x = 1.7321326590663837 + size * x
    x = (2.0 * x * x * x + size) / (3.0 * x * x - 3.0)
    x = (2.0 * x * x * x + size) / (3.0 * x * x - 3.0)
    largest = d >= 0.0
    if not largest:
        x = -x

    m00, m11, m22 = a00 - x, a11 - x, a22 - x
    k00, k11, k22 = m11 * m22 - a12 * a12, m00 * m22 - a02 * a02, m00 * m11 - a01 * a01
    k01, k02, k12 = a02 * a12 - a01 * m22, a01 * a12 - a02 * m11, a01 * a02 - a12 * m00
    first = k00 >= k11 and k00 >= k22
    second = k11 >= k22
    w0 = k00 if first else (k01 if second else k02)
    w1 = k01 if first else (k11 if second else k12)
    w2 = k02 if first else (k12 if second else k22)
    scale = 1.0 / math.sqrt(w0 * w0 + w1 * w1 + w2 * w2)
    w0, w1, w2 = w0 * scale, w1 * scale, w2 * scale

    # Two unit vectors that complete w to a right-handed frame, without a square root (Duff et al. 2017).
    sign = math.copysign(1.0, w2)
    p = -1.0 / (sign + w2)
    r = w0 * w1 * p
    e0, e1, e2 = 1.0 + sign * w0 * w0 * p, sign * r, -sign * w0
    f0, f1, f2 = r, sign + w1 * w1 * p, -w1

    ae0, ae1, ae2 = (
        a00 * e0 + a01 * e1 + a02 * e2,
        a01 * e0 + a11 * e1 + a12 * e2,
        a02 * e0 + a12 * e1 + a22 * e2,
    )
    af0, af1, af2 = (
        a00 * f0 + a01 * f1 + a02 * f2,
        a01 * f0 + a11 * f1 + a12 * f2,
        a02 * f0 + a12 * f1 + a22 * f2,
    )
    c, s = symmetric_frame_2d(
        (e0 * ae0 + e1 * ae1 + e2 * ae2, f0 * af0 + f1 * af1 + f2 * af2, e0 * af0 + e1 * af1 + e2 * af2)
    )
    g = (c * e0 + s * f0, c * e1 + s * f1, c * e2 + s * f2)
    h = (c * f0 - s * e0, c * f1 - s * e1, c * f2 - s * e2)
    w = (w0, w1, w2)
    return (w if largest else g), (g if largest else h), (h if largest else w)


@njit
def _jacobi_rotation(difference: float, twice: float) -> Vector2:
    """Return (c, s) of the smaller rotation that makes [[a, b], [b, d]] diagonal, from a - d and 2 b."""
    r = math.sqrt(difference * difference + twice * twice)
    if r < _TINY:
        return 1.0, 0.0
    near = r + abs(difference)
    scale = 1.0 / math.sqrt(near * near + twice * twice)
    return near * scale, math.copysign(1.0, difference) * twice * scale


@njit
def _dot(a: Vector3, b: Vector3) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit
def _cross(a: Vector3, b: Vector3) -> Vector3:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@njit
def _combine(c: float, a: Vector3, s: float, b: Vector3) -> Vector3:
    return (c * a[0] + s * b[0], c * a[1] + s * b[1], c * a[2] + s * b[2])


@njit
def _apply(A: Matrix3, x: Vector3) -> Vector3:
    return (
        A[0] * x[0] + A[1] * x[1] + A[2] * x[2],
        A[3] * x[0] + A[4] * x[1] + A[5] * x[2],
        A[6] * x[0] + A[7] * x[1] + A[8] * x[2],
    )


@njit
def _matrix(a: Vector3, b: Vector3, c: Vector3) -> Matrix3:
    return (a[0], b[0], c[0], a[1], b[1], c[1], a[2], b[2], c[2])


@njit
def _diagonalise_pair(A: Matrix3, u: Vector3, v: Vector3) -> tuple[Vector3, Vector3]:
    """Rotate u and v in their plane so that u . A v = 0."""
    au, av = _apply(A, u), _apply(A, v)
    c, s = _jacobi_rotation(_dot(u, au) - _dot(v, av), 2.0 * _dot(u, av))
    return _combine(c, u, s, v), _combine(c, v, -s, u)


@njit
def symmetric_eigen_3d(S: Symmetric3) -> tuple[Vector3, Matrix3]:
    """Return eigenvalues (descending, up to rounding) and the rotation whose columns are the eigenvectors.

    `symmetric_frame_3d`, then cyclic Jacobi rotations as long as something is left off the diagonal.
    """
    A = (S[0], S[5], S[4], S[5], S[1], S[3], S[4], S[3], S[2])
    u, v, w = symmetric_frame_3d(S)
    negligible = 1.0e-30 * squared_norm_3d(A)
    for _ in range(_MAX_SWEEPS):
        av, aw = _apply(A, v), _apply(A, w)
        uv, uw, vw = _dot(u, av), _dot(u, aw), _dot(v, aw)
        if not uv * uv + uw * uw + vw * vw > negligible:
            break
        u, v = _diagonalise_pair(A, u, v)
        u, w = _diagonalise_pair(A, u, w)
        v, w = _diagonalise_pair(A, v, w)
    return (_dot(u, _apply(A, u)), _dot(v, _apply(A, v)), _dot(w, _apply(A, w))), _matrix(u, v, w)


@njit
def is_surely_definite_3d(S: Symmetric3) -> bool:
    """Tell whether S is positive definite by a margin that rounding cannot forge.

    The leading minors would do in exact arithmetic; all three minors of size 2 bound the terms of the
    determinant.
    """
    a, b, c, aa, bb, cc = S[0], S[1], S[2], S[3] * S[3], S[4] * S[4], S[5] * S[5]
    if not (a > 0.0 and b > 0.0 and c > 0.0 and b * c > aa and c * a > bb and a * b > cc):
        return False
    product = a * b * c
    return product + 2.0 * S[3] * S[4] * S[5] - (a * aa + b * bb + c * cc) > _DEFINITE * product


@njit
def clamp_symmetric_3d(S: Symmetric3) -> Symmetric3:
    """Return the closest positive semi-definite symmetric matrix: negative eigenvalues become 0."""
    if is_surely_definite_3d(S):
        return S
    w, V = symmetric_eigen_3d(S)
    a = 0.0 if w[0] < 0.0 else w[0]
    b = 0.0 if w[1] < 0.0 else w[1]
    c = 0.0 if w[2] < 0.0 else w[2]
    return (
        a * V[0] * V[0] + b * V[1] * V[1] + c * V[2] * V[2],
        a * V[3] * V[3] + b * V[4] * V[4] + c * V[5] * V[5],
        a * V[6] * V[6] + b * V[7] * V[7] + c * V[8] * V[8],
        a * V[3] * V[6] + b * V[4] * V[7] + c * V[5] * V[8],
        a * V[0] * V[6] + b * V[1] * V[7] + c * V[2] * V[8],
        a * V[0] * V[3] + b * V[1] * V[4] + c * V[2] * V[5],
    )


@njit
def _orthogonalise_pair(p: Vector3, q: Vector3, u: Vector3, v: Vector3) -> tuple[Vector3, Vector3, Vector3, Vector3]:
    """Rotate the columns p, q (and with them u, v) in their plane so that p . q = 0 (Hestenes 1958)."""
    c, s = _jacobi_rotation(_dot(p, p) - _dot(q, q), 2.0 * _dot(p, q))
    return _combine(c, p, s, q), _combine(c, q, -s, p), _combine(c, u, s, v), _combine(c, v, -s, u)


@njit
def _orthogonal_columns(F: Matrix3) -> tuple[Columns3, Columns3]:
    """Return the columns of B = F V, mutually orthogonal and longest first, and those of the rotation V."""
    x, y, z = (F[0], F[3], F[6]), (F[1], F[4], F[7]), (F[2], F[5], F[8])
    u, v, w = symmetric_frame_3d((_dot(x, x), _dot(y, y), _dot(z, z), _dot(y, z), _dot(x, z), _dot(x, y)))
    a, b, c = _apply(F, u), _apply(F, v), _apply(F, w)
    # F^T F has lost the small singular values of an ill-conditioned F; one-sided rotations of B recover them.
    for _ in range(_MAX_SWEEPS):
        ab, ac, bc = _dot(a, b), _dot(a, c), _dot(b, c)
        aa, bb, cc = _dot(a, a), _dot(b, b), _dot(c, c)
        if not (ab * ab > _ORTHOGONAL * aa * bb or ac * ac > _ORTHOGONAL * aa * cc or bc * bc > _ORTHOGONAL * bb * cc):
            break
        a, b, u, v = _orthogonalise_pair(a, b, u, v)
        a, c, u, w = _orthogonalise_pair(a, c, u, w)
        b, c, v, w = _orthogonalise_pair(b, c, v, w)
    if aa < bb:
        a, b, u, v, aa, bb = b, _combine(-1.0, a, 0.0, a), v, _combine(-1.0, u, 0.0, u), bb, aa
    if bb < cc:
        b, c, v, w, bb, cc = c, _combine(-1.0, b, 0.0, b), w, _combine(-1.0, v, 0.0, v), cc, bb
    if aa < bb:
        a, b, u, v = b, _combine(-1.0, a, 0.0, a), v, _combine(-1.0, u, 0.0, u)
    return (a, b, c), (u, v, w)


@njit
def _perpendicular(p: Vector3) -> Vector3:
    """Return some unit vector across the unit vector p."""
    if abs(p[0]) > 0.6:
        scale = 1.0 / math.sqrt(p[0] * p[0] + p[1] * p[1])
        return (-p[1] * scale, p[0] * scale, 0.0)
    scale = 1.0 / math.sqrt(p[1] * p[1] + p[2] * p[2])
    return (0.0, -p[2] * scale, p[1] * scale)


@njit
def _left_frame(a: Vector3, b: Vector3) -> Columns3:
    """Return a right-handed orthonormal frame along the orthogonal vectors a and b; both may be zero."""
    length = math.sqrt(_dot(a, a))
    if length < _TINY:
        return (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
    scale = 1.0 / length
    p = _combine(scale, a, 0.0, a)
    b = _combine(1.0, b, -_dot(p, b), p)
    length = math.sqrt(_dot(b, b))
    if length < _TINY:
        q = _perpendicular(p)
    else:
        scale = 1.0 / length
        q = _combine(scale, b, 0.0, b)
    return p, q, _cross(p, q)


@njit
def signed_svd_3d(F: Matrix3) -> tuple[Matrix3, Vector3, Matrix3]:
    """Return (U, s, V): F = U diag(s) V^T, U and V rotations, s0 >= s1 >= |s2|, s2 with the sign of det F.

    Accurate to a few roundings of |F| for every F, singular, inverted and with repeated singular values.
    """
    (a, b, c), (u, v, w) = _orthogonal_columns(F)
    p, q, r = _left_frame(a, b)
    return _matrix(p, q, r), (_dot(p, a), _dot(q, b), _dot(r, c)), _matrix(u, v, w)


@njit(fastmath=ORDERED)
def rotation_and_trace_3d(F: Matrix3) -> tuple[Matrix3, float]:
    """Return R and tr S - 3 of F = R S with det R = 1, also for det F < 0."""
    (a, b, c), (u, v, w) = _orthogonal_columns(F)
    p, q, r = _left_frame(a, b)
    R = multiply_3d(_matrix(p, q, r), (u[0], u[1], u[2], v[0], v[1], v[2], w[0], w[1], w[2]))
    return R, (_dot(p, a) - 1.0) + (_dot(q, b) - 1.0) + (_dot(r, c) - 1.0)


@njit
def polar_rotation_3d(F: Matrix3) -> Matrix3:
    """Return the rotation closest to F, with determinant 1 also for det F < 0."""
    R, _ = rotation_and_trace_3d(F)
    return R
