"""The alternating mixed scheme at one quadrature point, in two and three dimensions, for compiled loops.

Matrices are flat tuples of d*d numbers, row-major. The quadratic model of psi at a stretch is kept in the eigenframe V
of the stretch: the inverse of the scaling block of its Hessian, (.., 6) or (.., 3), the inverse flip values, (.., 3) or
(.., 1), and the gradient psi_i.
"""

from __future__ import annotations

import math
from typing import Any

from numba.extending import overload

from femdeform.fem.mixed_kernels import above, above_2d, above_3d, inverse_symmetric_2d, inverse_symmetric_3d
from femdeform.jit import njit
from femdeform.materials.dispatch import energy_density, stretch_derivatives
from femdeform.materials.isotropic import assemble_modes_2d, assemble_modes_3d
from femdeform.materials.small_matrix import (
    multiply_2d,
    multiply_3d,
    polar_rotation_2d,
    polar_rotation_3d,
    symmetric_eigen_2d,
    symmetric_eigen_3d,
    transpose_2d,
    transpose_3d,
)


def entries(A: Any, dim: Any) -> Any:
    """Row of d*d numbers as a tuple."""
    raise NotImplementedError("compiled code only")


@overload(entries)
def _entries_compiled(A: Any, dim: Any) -> Any:
    def planar(A: Any, dim: Any) -> Any:
        return (A[0], A[1], A[2], A[3])

    def spatial(A: Any, dim: Any) -> Any:
        return (A[0], A[1], A[2], A[3], A[4], A[5], A[6], A[7], A[8])

    return planar if len(dim) == 2 else spatial


def store(A: Any, out: Any) -> None:
    """Write a tuple to a row."""
    raise NotImplementedError("compiled code only")


@overload(store)
def _store_compiled(A: Any, out: Any) -> Any:
    def store(A: Any, out: Any) -> None:
        for i in range(len(A)):
            out[i] = A[i]

    return store


def freeze_point(S: Any, law: Any, floor: Any, V: Any, inverse: Any, flips: Any, psi: Any) -> None:
    """Write the model of psi at a stretch: its frame, the inverse Hessian in it, its gradient."""
    raise NotImplementedError("compiled code only")


@overload(freeze_point)
def _freeze_compiled(S: Any, law: Any, floor: Any, V: Any, inverse: Any, flips: Any, psi: Any) -> Any:
    def planar(S: Any, law: Any, floor: Any, V: Any, inverse: Any, flips: Any, psi: Any) -> None:
        s, frame = symmetric_eigen_2d((S[0], S[3], 0.5 * (S[1] + S[2])))
        gradient, A, _, f = stretch_derivatives(s, law)
        bound = floor * law.mu
        store(frame, V)
        store(inverse_symmetric_2d(above_2d(A, bound)), inverse)
        store(gradient, psi)
        flips[0] = 1.0 / above(f[0], bound)

    def spatial(S: Any, law: Any, floor: Any, V: Any, inverse: Any, flips: Any, psi: Any) -> None:
        s, frame = symmetric_eigen_3d((S[0], S[4], S[8], 0.5 * (S[5] + S[7]), 0.5 * (S[2] + S[6]), 0.5 * (S[1] + S[3])))
        gradient, A, _, f = stretch_derivatives(s, law)
        bound = floor * law.mu
        store(frame, V)
        store(inverse_symmetric_3d(above_3d(A, bound)), inverse)
        store(gradient, psi)
        for i in range(3):
            flips[i] = 1.0 / above(f[i], bound)

    return planar if len(S) == 4 else spatial


def compliant(Y: Any, V: Any, inverse: Any, flips: Any) -> Any:
    """H^-1 Y for a symmetric Y, as a full matrix."""
    raise NotImplementedError("compiled code only")


@overload(compliant)
def _compliant_compiled(Y: Any, V: Any, inverse: Any, flips: Any) -> Any:
    def planar(Y: Any, V: Any, inverse: Any, flips: Any) -> Any:
        X = multiply_2d(transpose_2d(V), multiply_2d(Y, V))
        a, b = inverse[0] * X[0] + inverse[2] * X[3], inverse[2] * X[0] + inverse[1] * X[3]
        c = 0.5 * flips[0] * (X[1] + X[2])
        return multiply_2d(V, multiply_2d((a, c, c, b), transpose_2d(V)))

    def spatial(Y: Any, V: Any, inverse: Any, flips: Any) -> Any:
        X = multiply_3d(transpose_3d(V), multiply_3d(Y, V))
        a = inverse[0] * X[0] + inverse[5] * X[4] + inverse[4] * X[8]
        b = inverse[5] * X[0] + inverse[1] * X[4] + inverse[3] * X[8]
        c = inverse[4] * X[0] + inverse[3] * X[4] + inverse[2] * X[8]
        p = 0.5 * flips[0] * (X[5] + X[7])
        q = 0.5 * flips[1] * (X[2] + X[6])
        r = 0.5 * flips[2] * (X[1] + X[3])
        return multiply_3d(V, multiply_3d((a, r, q, r, b, p, q, p, c), transpose_3d(V)))

    return planar if len(Y) == 4 else spatial


def principal(V: Any, psi: Any) -> Any:
    """V diag(psi) V^T: the gradient of psi as a matrix."""
    raise NotImplementedError("compiled code only")


@overload(principal)
def _principal_compiled(V: Any, psi: Any) -> Any:
    def planar(V: Any, psi: Any) -> Any:
        return multiply_2d(V, multiply_2d((psi[0], 0.0, 0.0, psi[1]), transpose_2d(V)))

    def spatial(V: Any, psi: Any) -> Any:
        D = (psi[0], 0.0, 0.0, 0.0, psi[1], 0.0, 0.0, 0.0, psi[2])
        return multiply_3d(V, multiply_3d(D, transpose_3d(V)))

    return planar if len(V) == 4 else spatial


def product(A: Any, B: Any) -> Any:
    """A B."""
    raise NotImplementedError("compiled code only")


@overload(product)
def _product_compiled(A: Any, B: Any) -> Any:
    def planar(A: Any, B: Any) -> Any:
        return multiply_2d(A, B)

    def spatial(A: Any, B: Any) -> Any:
        return multiply_3d(A, B)

    return planar if len(A) == 4 else spatial


def transposed(A: Any) -> Any:
    """A^T."""
    raise NotImplementedError("compiled code only")


@overload(transposed)
def _transposed_compiled(A: Any) -> Any:
    def planar(A: Any) -> Any:
        return transpose_2d(A)

    def spatial(A: Any) -> Any:
        return transpose_3d(A)

    return planar if len(A) == 4 else spatial


def nearest_rotation(M: Any, k: Any) -> Any:
    """Rotation R with the largest <R, M>; for a rod (k = 1), where it is not unique, the smallest such rotation."""
    raise NotImplementedError("compiled code only")


@overload(nearest_rotation)
def _nearest_rotation_compiled(M: Any, k: Any) -> Any:
    def planar(M: Any, k: Any) -> Any:
        return polar_rotation_2d(M)

    def spatial(M: Any, k: Any) -> Any:
        return _rod_rotation(M) if k == 1 else polar_rotation_3d(M)

    return planar if len(M) == 4 else spatial


@njit
def _rod_rotation(M: Any) -> Any:
    """Smallest rotation that takes b to a, for M close to a b^T."""
    best, row = -1.0, 0
    for i in range(3):
        size = M[3 * i] ** 2 + M[3 * i + 1] ** 2 + M[3 * i + 2] ** 2
        if size > best:
            best, row = size, i
    if not best > 0.0:
        return (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    scale = 1.0 / math.sqrt(best)
    if row == 0:
        b = (scale * M[0], scale * M[1], scale * M[2])
    elif row == 1:
        b = (scale * M[3], scale * M[4], scale * M[5])
    else:
        b = (scale * M[6], scale * M[7], scale * M[8])
    a0 = M[0] * b[0] + M[1] * b[1] + M[2] * b[2]
    a1 = M[3] * b[0] + M[4] * b[1] + M[5] * b[2]
    a2 = M[6] * b[0] + M[7] * b[1] + M[8] * b[2]
    scale = 1.0 / math.sqrt(a0 * a0 + a1 * a1 + a2 * a2)
    a0, a1, a2 = scale * a0, scale * a1, scale * a2
    c = a0 * b[0] + a1 * b[1] + a2 * b[2]
    if c < -1.0 + 1e-12:
        # Half a turn about any axis across b.
        i = 0 if abs(b[0]) < 0.8 else 1
        e0, e1 = (1.0, 0.0) if i == 0 else (0.0, 1.0)
        p0, p1, p2 = -b[2] * e1, b[2] * e0, b[0] * e1 - b[1] * e0
        size = 1.0 / math.sqrt(p0 * p0 + p1 * p1 + p2 * p2)
        p0, p1, p2 = size * p0, size * p1, size * p2
        return (
            2.0 * p0 * p0 - 1.0,
            2.0 * p0 * p1,
            2.0 * p0 * p2,
            2.0 * p1 * p0,
            2.0 * p1 * p1 - 1.0,
            2.0 * p1 * p2,
            2.0 * p2 * p0,
            2.0 * p2 * p1,
            2.0 * p2 * p2 - 1.0,
        )
    v0, v1, v2 = b[1] * a2 - b[2] * a1, b[2] * a0 - b[0] * a2, b[0] * a1 - b[1] * a0
    f = 1.0 / (1.0 + c)
    return (
        c + f * v0 * v0,
        f * v0 * v1 - v2,
        f * v0 * v2 + v1,
        f * v1 * v0 + v2,
        c + f * v1 * v1,
        f * v1 * v2 - v0,
        f * v2 * v0 - v1,
        f * v2 * v1 + v0,
        c + f * v2 * v2,
    )


def stiffness_modes(inverse: Any, flips: Any, eps: Any, dim: Any) -> Any:
    """Scaling block, twist and flip of (W H^-1 W^T + eps)^-1; without eps no stiffness against skew variations."""
    raise NotImplementedError("compiled code only")


@overload(stiffness_modes)
def _stiffness_modes_compiled(inverse: Any, flips: Any, eps: Any, dim: Any) -> Any:
    def planar(inverse: Any, flips: Any, eps: Any, dim: Any) -> Any:
        twist = 1.0 / eps if eps > 0.0 else 0.0
        A = inverse_symmetric_2d((inverse[0] + eps, inverse[1] + eps, inverse[2]))
        return A, twist, 1.0 / (flips[0] + eps)

    def spatial(inverse: Any, flips: Any, eps: Any, dim: Any) -> Any:
        twist = 1.0 / eps if eps > 0.0 else 0.0
        A = inverse_symmetric_3d(
            (inverse[0] + eps, inverse[1] + eps, inverse[2] + eps, inverse[3], inverse[4], inverse[5])
        )
        f = (1.0 / (flips[0] + eps), 1.0 / (flips[1] + eps), 1.0 / (flips[2] + eps))
        return A, (twist, twist, twist), f

    return planar if len(dim) == 2 else spatial


def write_full_compliance(U: Any, V: Any, inverse: Any, flips: Any, H: Any) -> None:
    """Write W H^-1 W^T into H."""
    raise NotImplementedError("compiled code only")


@overload(write_full_compliance)
def _write_compliance_matrix_compiled(U: Any, V: Any, inverse: Any, flips: Any, H: Any) -> Any:
    def planar(U: Any, V: Any, inverse: Any, flips: Any, H: Any) -> None:
        assemble_modes_2d(U, V, (inverse[0], inverse[1], inverse[2]), 0.0, flips[0], H)

    def spatial(U: Any, V: Any, inverse: Any, flips: Any, H: Any) -> None:
        A = (inverse[0], inverse[1], inverse[2], inverse[3], inverse[4], inverse[5])
        assemble_modes_3d(U, V, A, (0.0, 0.0, 0.0), (flips[0], flips[1], flips[2]), H)

    return planar if len(U) == 4 else spatial


def has_energy(S: Any, law: Any) -> Any:
    """Whether psi(S) is finite."""
    raise NotImplementedError("compiled code only")


@overload(has_energy)
def _finite_energy_compiled(S: Any, law: Any) -> Any:
    # A symmetric stretch is a deformation gradient as good as any.
    def finite(S: Any, law: Any) -> Any:
        return math.isfinite(energy_density(S, law))

    return finite


def completed_root(C: Any, across: Any) -> Any:
    """Square root of C plus the projector across the cell."""
    raise NotImplementedError("compiled code only")


@overload(completed_root)
def _root_compiled(C: Any, across: Any) -> Any:
    def planar(C: Any, across: Any) -> Any:
        return C

    def spatial(C: Any, across: Any) -> Any:
        w, V = symmetric_eigen_3d(
            (C[0] + across[0], C[4] + across[4], C[8] + across[8], C[5] + across[5], C[2] + across[2], C[1] + across[1])
        )
        return principal(V, (math.sqrt(max(w[0], 0.0)), math.sqrt(max(w[1], 0.0)), math.sqrt(max(w[2], 0.0))))

    return planar if len(C) == 4 else spatial
