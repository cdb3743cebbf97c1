"""Products of the small matrices that updates of one cell need.

Every function is compiled for its dimension; matrices are row-major tuples of 9 or 4. Symmetric ones are (00, 11, 22,
12, 02, 01), in 2D (00, 11, 01), or a tuple of those, one for each row of the matrix they are multiplied to.
"""

from __future__ import annotations

from typing import Any

from numba.extending import overload

from femdeform.jit import types
from femdeform.materials.determinant_form import combination_2d, combination_3d
from femdeform.materials.small_matrix import cofactor_2d, cofactor_3d, det_2d, det_3d
from solvers.position_based.inlining import inlined, inlined_overload

_COMPILED_ONLY = "compiled code only"


# ---------------------------------------------------------------------------------------- products


@inlined
def _dot_3d(A: Any, B: Any) -> Any:
    return (
        (A[0] * B[0] + A[1] * B[1] + A[2] * B[2])
        + (A[3] * B[3] + A[4] * B[4] + A[5] * B[5])
        + (A[6] * B[6] + A[7] * B[7] + A[8] * B[8])
    )


@inlined
def _dot_2d(A: Any, B: Any) -> Any:
    return A[0] * B[0] + A[1] * B[1] + A[2] * B[2] + A[3] * B[3]


def dot(A: Any, B: Any) -> Any:
    """A : B."""
    raise NotImplementedError(_COMPILED_ONLY)


@inlined_overload(dot)
def _dot(A: Any, B: Any) -> Any:
    kernel = _dot_2d if len(A) == 4 else _dot_3d

    def implementation(A: Any, B: Any) -> Any:
        return kernel(A, B)

    return implementation


def combine(A: Any, a: Any, B: Any, b: Any) -> Any:
    """a A + b B."""
    raise NotImplementedError(_COMPILED_ONLY)


@inlined_overload(combine)
def _combine(A: Any, a: Any, B: Any, b: Any) -> Any:
    kernel = combination_2d if len(A) == 4 else combination_3d

    def implementation(A: Any, a: Any, B: Any, b: Any) -> Any:
        return kernel(a, A, b, B)

    return implementation


def cofactor(F: Any) -> Any:
    """Derivative of det F."""
    raise NotImplementedError(_COMPILED_ONLY)


@inlined_overload(cofactor)
def _cofactor(F: Any) -> Any:
    kernel = cofactor_2d if len(F) == 4 else cofactor_3d

    def implementation(F: Any) -> Any:
        return kernel(F)

    return implementation


def determinant(F: Any) -> Any:
    """Det F."""
    raise NotImplementedError(_COMPILED_ONLY)


@inlined_overload(determinant)
def _determinant(F: Any) -> Any:
    kernel = det_2d if len(F) == 4 else det_3d

    def implementation(F: Any) -> Any:
        return kernel(F)

    return implementation


@inlined
def _row_times_3d(a: Any, b: Any, c: Any, K: Any) -> Any:
    return (
        a * K[0] + b * K[5] + c * K[4],
        a * K[5] + b * K[1] + c * K[3],
        a * K[4] + b * K[3] + c * K[2],
    )


@inlined
def _times_3d(A: Any, K: Any) -> Any:
    r, s, t = (
        _row_times_3d(A[0], A[1], A[2], K),
        _row_times_3d(A[3], A[4], A[5], K),
        _row_times_3d(A[6], A[7], A[8], K),
    )
    return (r[0], r[1], r[2], s[0], s[1], s[2], t[0], t[1], t[2])


@inlined
def _times_rows_3d(A: Any, K: Any) -> Any:
    r, s, t = (
        _row_times_3d(A[0], A[1], A[2], K[0]),
        _row_times_3d(A[3], A[4], A[5], K[1]),
        _row_times_3d(A[6], A[7], A[8], K[2]),
    )
    return (r[0], r[1], r[2], s[0], s[1], s[2], t[0], t[1], t[2])


@inlined
def _times_2d(A: Any, K: Any) -> Any:
    return (
        A[0] * K[0] + A[1] * K[2],
        A[0] * K[2] + A[1] * K[1],
        A[2] * K[0] + A[3] * K[2],
        A[2] * K[2] + A[3] * K[1],
    )


@inlined
def _times_rows_2d(A: Any, K: Any) -> Any:
    k, m = K
    return (
        A[0] * k[0] + A[1] * k[2],
        A[0] * k[2] + A[1] * k[1],
        A[2] * m[0] + A[3] * m[2],
        A[2] * m[2] + A[3] * m[1],
    )


def times(A: Any, K: Any) -> Any:
    """A K for symmetric K, row by row where K has one matrix for each row."""
    raise NotImplementedError(_COMPILED_ONLY)


@inlined_overload(times)
def _times(A: Any, K: Any) -> Any:
    rows = isinstance(K[0], types.BaseTuple)
    if len(A) == 4:
        kernel = _times_rows_2d if rows else _times_2d
    else:
        kernel = _times_rows_3d if rows else _times_3d

    def implementation(A: Any, K: Any) -> Any:
        return kernel(A, K)

    return implementation


@inlined
def _resolvent_3d(K: Any, c: Any) -> Any:
    a0, a1, a2, a3, a4, a5 = 1.0 + c * K[0], 1.0 + c * K[1], 1.0 + c * K[2], c * K[3], c * K[4], c * K[5]
    c0, c1, c2 = a1 * a2 - a3 * a3, a4 * a3 - a5 * a2, a5 * a3 - a4 * a1
    inverse = 1.0 / (a0 * c0 + a5 * c1 + a4 * c2)
    return (
        inverse * c0,
        inverse * (a0 * a2 - a4 * a4),
        inverse * (a0 * a1 - a5 * a5),
        inverse * (a4 * a5 - a0 * a3),
        inverse * c2,
        inverse * c1,
    )


@inlined
def _resolvent_rows_3d(K: Any, c: Any) -> Any:
    return (_resolvent_3d(K[0], c), _resolvent_3d(K[1], c), _resolvent_3d(K[2], c))


@inlined
def _resolvent_2d(K: Any, c: Any) -> Any:
    a0, a1, a2 = 1.0 + c * K[0], 1.0 + c * K[1], c * K[2]
    inverse = 1.0 / (a0 * a1 - a2 * a2)
    return (inverse * a1, inverse * a0, -inverse * a2)


@inlined
def _resolvent_rows_2d(K: Any, c: Any) -> Any:
    return (_resolvent_2d(K[0], c), _resolvent_2d(K[1], c))


def resolvent(K: Any, c: Any) -> Any:
    """(I + c K)^-1 for symmetric positive semi-definite K and c >= 0."""
    raise NotImplementedError(_COMPILED_ONLY)


@inlined_overload(resolvent)
def _resolvent(K: Any, c: Any) -> Any:
    if isinstance(K[0], types.BaseTuple):
        kernel = _resolvent_rows_2d if len(K) == 2 else _resolvent_rows_3d
    else:
        kernel = _resolvent_2d if len(K) == 3 else _resolvent_3d

    def implementation(K: Any, c: Any) -> Any:
        return kernel(K, c)

    return implementation


# ---------------------------------------------------------------------------------------- arrays of matrices


def load(e: Any, rows: Any, dim: Any) -> Any:
    """Row e of an array (n, dim dim) as a matrix."""
    raise NotImplementedError(_COMPILED_ONLY)


@overload(load)
def _load(e: Any, rows: Any, dim: Any) -> Any:
    def spatial(e: Any, rows: Any, dim: Any) -> Any:
        return (
            rows[e, 0],
            rows[e, 1],
            rows[e, 2],
            rows[e, 3],
            rows[e, 4],
            rows[e, 5],
            rows[e, 6],
            rows[e, 7],
            rows[e, 8],
        )

    def planar(e: Any, rows: Any, dim: Any) -> Any:
        return (rows[e, 0], rows[e, 1], rows[e, 2], rows[e, 3])

    return spatial if len(dim) == 3 else planar


def store(e: Any, A: Any, rows: Any) -> None:
    """Write a matrix to row e."""
    raise NotImplementedError(_COMPILED_ONLY)


@overload(store)
def _store(e: Any, A: Any, rows: Any) -> Any:
    def spatial(e: Any, A: Any, rows: Any) -> None:
        rows[e, 0] = A[0]
        rows[e, 1] = A[1]
        rows[e, 2] = A[2]
        rows[e, 3] = A[3]
        rows[e, 4] = A[4]
        rows[e, 5] = A[5]
        rows[e, 6] = A[6]
        rows[e, 7] = A[7]
        rows[e, 8] = A[8]

    def planar(e: Any, A: Any, rows: Any) -> None:
        rows[e, 0] = A[0]
        rows[e, 1] = A[1]
        rows[e, 2] = A[2]
        rows[e, 3] = A[3]

    return planar if len(A) == 4 else spatial
