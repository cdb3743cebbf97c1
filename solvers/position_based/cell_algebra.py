"""What updates of one cell need: its deformation gradient, the mobility of its corners, and small products.

A cell moves its corners by ``x_i += w_i M g_i`` with one matrix M, the inverse masses w_i and the gradients g_i of the
shape functions. F then changes by ``M K`` with the mobility ``K = sum_i w_i g_i g_i^T``, so an update of any number of
constraints is found from F and K alone, and corners are read and written once. K is symmetric: (00, 11, 22, 12, 02,
01), in 2D (00, 11, 01). Where single components are prescribed each row of F has a mobility of its own: K is then a
tuple of those. Fully prescribed corners have w = 0.

Every function is compiled for its dimension; matrices are row-major tuples of 9 or 4. Where `corners` are
`GatheredCorners`, a cell has any number of them: see `gathered_corners`.
"""

from __future__ import annotations

from typing import Any

from numba.extending import overload

from femdeform.jit import njit, types
from femdeform.materials.determinant_form import combination_2d, combination_3d
from femdeform.materials.small_matrix import cofactor_2d, cofactor_3d, det_2d, det_3d
from solvers.position_based.gathered_corners import (
    gathered_deformation,
    gathered_misfit,
    gathered_mobility,
    gathered_spread,
    is_gathered,
)

_COMPILED_ONLY = "compiled code only"


# ---------------------------------------------------------------------------------------- products


@njit
def _dot_3d(A: Any, B: Any) -> Any:
    return (
        (A[0] * B[0] + A[1] * B[1] + A[2] * B[2])
        + (A[3] * B[3] + A[4] * B[4] + A[5] * B[5])
        + (A[6] * B[6] + A[7] * B[7] + A[8] * B[8])
    )


@njit
def _dot_2d(A: Any, B: Any) -> Any:
    return A[0] * B[0] + A[1] * B[1] + A[2] * B[2] + A[3] * B[3]


def dot(A: Any, B: Any) -> Any:
    """A : B."""
    raise NotImplementedError(_COMPILED_ONLY)


@overload(dot)
def _dot(A: Any, B: Any) -> Any:
    kernel = _dot_2d if len(A) == 4 else _dot_3d

    def implementation(A: Any, B: Any) -> Any:
        return kernel(A, B)

    return implementation


def combine(A: Any, a: Any, B: Any, b: Any) -> Any:
    """a A + b B."""
    raise NotImplementedError(_COMPILED_ONLY)


@overload(combine)
def _combine(A: Any, a: Any, B: Any, b: Any) -> Any:
    kernel = combination_2d if len(A) == 4 else combination_3d

    def implementation(A: Any, a: Any, B: Any, b: Any) -> Any:
        return kernel(a, A, b, B)

    return implementation


def cofactor(F: Any) -> Any:
    """Derivative of det F."""
    raise NotImplementedError(_COMPILED_ONLY)


@overload(cofactor)
def _cofactor(F: Any) -> Any:
    kernel = cofactor_2d if len(F) == 4 else cofactor_3d

    def implementation(F: Any) -> Any:
        return kernel(F)

    return implementation


def determinant(F: Any) -> Any:
    """Det F."""
    raise NotImplementedError(_COMPILED_ONLY)


@overload(determinant)
def _determinant(F: Any) -> Any:
    kernel = det_2d if len(F) == 4 else det_3d

    def implementation(F: Any) -> Any:
        return kernel(F)

    return implementation


@njit
def _row_times_3d(a: Any, b: Any, c: Any, K: Any) -> Any:
    return (
        a * K[0] + b * K[5] + c * K[4],
        a * K[5] + b * K[1] + c * K[3],
        a * K[4] + b * K[3] + c * K[2],
    )


@njit
def _times_3d(A: Any, K: Any) -> Any:
    r, s, t = (
        _row_times_3d(A[0], A[1], A[2], K),
        _row_times_3d(A[3], A[4], A[5], K),
        _row_times_3d(A[6], A[7], A[8], K),
    )
    return (r[0], r[1], r[2], s[0], s[1], s[2], t[0], t[1], t[2])


@njit
def _times_rows_3d(A: Any, K: Any) -> Any:
    r, s, t = (
        _row_times_3d(A[0], A[1], A[2], K[0]),
        _row_times_3d(A[3], A[4], A[5], K[1]),
        _row_times_3d(A[6], A[7], A[8], K[2]),
    )
    return (r[0], r[1], r[2], s[0], s[1], s[2], t[0], t[1], t[2])


@njit
def _times_2d(A: Any, K: Any) -> Any:
    return (
        A[0] * K[0] + A[1] * K[2],
        A[0] * K[2] + A[1] * K[1],
        A[2] * K[0] + A[3] * K[2],
        A[2] * K[2] + A[3] * K[1],
    )


@njit
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


@overload(times)
def _times(A: Any, K: Any) -> Any:
    rows = isinstance(K[0], types.BaseTuple)
    if len(A) == 4:
        kernel = _times_rows_2d if rows else _times_2d
    else:
        kernel = _times_rows_3d if rows else _times_3d

    def implementation(A: Any, K: Any) -> Any:
        return kernel(A, K)

    return implementation


@njit
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


@njit
def _resolvent_rows_3d(K: Any, c: Any) -> Any:
    return (_resolvent_3d(K[0], c), _resolvent_3d(K[1], c), _resolvent_3d(K[2], c))


@njit
def _resolvent_2d(K: Any, c: Any) -> Any:
    a0, a1, a2 = 1.0 + c * K[0], 1.0 + c * K[1], c * K[2]
    inverse = 1.0 / (a0 * a1 - a2 * a2)
    return (inverse * a1, inverse * a0, -inverse * a2)


@njit
def _resolvent_rows_2d(K: Any, c: Any) -> Any:
    return (_resolvent_2d(K[0], c), _resolvent_2d(K[1], c))


def resolvent(K: Any, c: Any) -> Any:
    """(I + c K)^-1 for symmetric positive semi-definite K and c >= 0."""
    raise NotImplementedError(_COMPILED_ONLY)


@overload(resolvent)
def _resolvent(K: Any, c: Any) -> Any:
    if isinstance(K[0], types.BaseTuple):
        kernel = _resolvent_rows_2d if len(K) == 2 else _resolvent_rows_3d
    else:
        kernel = _resolvent_2d if len(K) == 3 else _resolvent_3d

    def implementation(K: Any, c: Any) -> Any:
        return kernel(K, c)

    return implementation


# ---------------------------------------------------------------------------------------- corners of a cell


def deformation(e: Any, shift: Any, corners: Any, gradients: Any, dim: Any, x: Any) -> Any:
    """``sum_i x_i g_i^T`` over the corners of cell e, of the vectors that begin `shift` after each corner's place."""
    raise NotImplementedError(_COMPILED_ONLY)


@overload(deformation)
def _deformation(e: Any, shift: Any, corners: Any, gradients: Any, dim: Any, x: Any) -> Any:
    def spatial(e: Any, shift: Any, corners: Any, gradients: Any, dim: Any, x: Any) -> Any:
        o, i, j, k = corners[e, 0] + shift, corners[e, 1] + shift, corners[e, 2] + shift, corners[e, 3] + shift
        o0, o1, o2 = x[o], x[o + 1], x[o + 2]
        d0, d1, d2 = x[i] - o0, x[i + 1] - o1, x[i + 2] - o2
        e0, e1, e2 = x[j] - o0, x[j + 1] - o1, x[j + 2] - o2
        f0, f1, f2 = x[k] - o0, x[k + 1] - o1, x[k + 2] - o2
        p0, p1, p2 = gradients[e, 0], gradients[e, 1], gradients[e, 2]
        q0, q1, q2 = gradients[e, 3], gradients[e, 4], gradients[e, 5]
        r0, r1, r2 = gradients[e, 6], gradients[e, 7], gradients[e, 8]
        return (
            d0 * p0 + e0 * q0 + f0 * r0,
            d0 * p1 + e0 * q1 + f0 * r1,
            d0 * p2 + e0 * q2 + f0 * r2,
            d1 * p0 + e1 * q0 + f1 * r0,
            d1 * p1 + e1 * q1 + f1 * r1,
            d1 * p2 + e1 * q2 + f1 * r2,
            d2 * p0 + e2 * q0 + f2 * r0,
            d2 * p1 + e2 * q1 + f2 * r1,
            d2 * p2 + e2 * q2 + f2 * r2,
        )

    def planar(e: Any, shift: Any, corners: Any, gradients: Any, dim: Any, x: Any) -> Any:
        o, i, j = corners[e, 0] + shift, corners[e, 1] + shift, corners[e, 2] + shift
        d0, d1 = x[i] - x[o], x[i + 1] - x[o + 1]
        e0, e1 = x[j] - x[o], x[j + 1] - x[o + 1]
        p0, p1, q0, q1 = gradients[e, 0], gradients[e, 1], gradients[e, 2], gradients[e, 3]
        return (d0 * p0 + e0 * q0, d0 * p1 + e0 * q1, d1 * p0 + e1 * q0, d1 * p1 + e1 * q1)

    if is_gathered(corners):
        return gathered_deformation(len(dim))
    return spatial if len(dim) == 3 else planar


def mobility(e: Any, corners: Any, gradients: Any, masks: Any, dim: Any, x: Any) -> Any:
    """``K = sum_i w_i g_i g_i^T``; the inverse masses follow three numbers after each corner's place.

    With masks (n_cells, (dim + 1) dim), which are 0 where a component of a corner is prescribed, one matrix for each
    component.
    """
    raise NotImplementedError(_COMPILED_ONLY)


@njit
def _corner_gradients_3d(e: Any, gradients: Any) -> Any:
    p0, p1, p2 = gradients[e, 0], gradients[e, 1], gradients[e, 2]
    q0, q1, q2 = gradients[e, 3], gradients[e, 4], gradients[e, 5]
    r0, r1, r2 = gradients[e, 6], gradients[e, 7], gradients[e, 8]
    return (-(p0 + q0 + r0), -(p1 + q1 + r1), -(p2 + q2 + r2)), (p0, p1, p2), (q0, q1, q2), (r0, r1, r2)


@njit
def _corner_gradients_2d(e: Any, gradients: Any) -> Any:
    p0, p1, q0, q1 = gradients[e, 0], gradients[e, 1], gradients[e, 2], gradients[e, 3]
    return (-(p0 + q0), -(p1 + q1)), (p0, p1), (q0, q1)


@njit
def _mobility_3d(g: Any, w: Any) -> Any:
    (a0, a1, a2), (b0, b1, b2), (c0, c1, c2), (d0, d1, d2) = g
    a, b, c, d = w
    return (
        a * a0 * a0 + b * b0 * b0 + c * c0 * c0 + d * d0 * d0,
        a * a1 * a1 + b * b1 * b1 + c * c1 * c1 + d * d1 * d1,
        a * a2 * a2 + b * b2 * b2 + c * c2 * c2 + d * d2 * d2,
        a * a1 * a2 + b * b1 * b2 + c * c1 * c2 + d * d1 * d2,
        a * a0 * a2 + b * b0 * b2 + c * c0 * c2 + d * d0 * d2,
        a * a0 * a1 + b * b0 * b1 + c * c0 * c1 + d * d0 * d1,
    )


@njit
def _mobility_2d(g: Any, w: Any) -> Any:
    (a0, a1), (b0, b1), (c0, c1) = g
    a, b, c = w
    return (
        a * a0 * a0 + b * b0 * b0 + c * c0 * c0,
        a * a1 * a1 + b * b1 * b1 + c * c1 * c1,
        a * a0 * a1 + b * b0 * b1 + c * c0 * c1,
    )


@njit
def _inverse_masses_3d(e: Any, corners: Any, x: Any) -> Any:
    return x[corners[e, 0] + 3], x[corners[e, 1] + 3], x[corners[e, 2] + 3], x[corners[e, 3] + 3]


@njit
def _inverse_masses_2d(e: Any, corners: Any, x: Any) -> Any:
    return x[corners[e, 0] + 3], x[corners[e, 1] + 3], x[corners[e, 2] + 3]


@overload(mobility)
def _mobility(e: Any, corners: Any, gradients: Any, masks: Any, dim: Any, x: Any) -> Any:
    masked = not isinstance(masks, types.BaseTuple)

    def spatial(e: Any, corners: Any, gradients: Any, masks: Any, dim: Any, x: Any) -> Any:
        return _mobility_3d(_corner_gradients_3d(e, gradients), _inverse_masses_3d(e, corners, x))

    def planar(e: Any, corners: Any, gradients: Any, masks: Any, dim: Any, x: Any) -> Any:
        return _mobility_2d(_corner_gradients_2d(e, gradients), _inverse_masses_2d(e, corners, x))

    def spatial_masked(e: Any, corners: Any, gradients: Any, masks: Any, dim: Any, x: Any) -> Any:
        g = _corner_gradients_3d(e, gradients)
        a, b, c, d = _inverse_masses_3d(e, corners, x)
        return (
            _mobility_3d(g, (a * masks[e, 0], b * masks[e, 3], c * masks[e, 6], d * masks[e, 9])),
            _mobility_3d(g, (a * masks[e, 1], b * masks[e, 4], c * masks[e, 7], d * masks[e, 10])),
            _mobility_3d(g, (a * masks[e, 2], b * masks[e, 5], c * masks[e, 8], d * masks[e, 11])),
        )

    def planar_masked(e: Any, corners: Any, gradients: Any, masks: Any, dim: Any, x: Any) -> Any:
        g = _corner_gradients_2d(e, gradients)
        a, b, c = _inverse_masses_2d(e, corners, x)
        return (
            _mobility_2d(g, (a * masks[e, 0], b * masks[e, 2], c * masks[e, 4])),
            _mobility_2d(g, (a * masks[e, 1], b * masks[e, 3], c * masks[e, 5])),
        )

    if is_gathered(corners):
        return gathered_mobility(len(dim), masked)
    if len(dim) == 3:
        return spatial_masked if masked else spatial
    return planar_masked if masked else planar


@njit
def _push_3d(p: Any, shift: Any, w: Any, keep: Any, M: Any, g: Any, x: Any) -> None:
    g0, g1, g2 = g
    s0 = w[0] * (M[0] * g0 + M[1] * g1 + M[2] * g2)
    s1 = w[1] * (M[3] * g0 + M[4] * g1 + M[5] * g2)
    s2 = w[2] * (M[6] * g0 + M[7] * g1 + M[8] * g2)
    if keep != 0.0:
        s0 += keep * (x[p + 4] - x[p])
        s1 += keep * (x[p + 5] - x[p + 1])
        s2 += keep * (x[p + 6] - x[p + 2])
    q = p + shift
    x[q] += s0
    x[q + 1] += s1
    x[q + 2] += s2


@njit
def _push_2d(p: Any, shift: Any, w: Any, keep: Any, M: Any, g: Any, x: Any) -> None:
    s0 = w[0] * (M[0] * g[0] + M[1] * g[1])
    s1 = w[1] * (M[2] * g[0] + M[3] * g[1])
    if keep != 0.0:
        s0 += keep * (x[p + 4] - x[p])
        s1 += keep * (x[p + 5] - x[p + 1])
    q = p + shift
    x[q] += s0
    x[q + 1] += s1


def spread(e: Any, shift: Any, keep: Any, M: Any, corners: Any, gradients: Any, masks: Any, dim: Any, x: Any) -> None:
    """``v_i += keep r_i + w_i M g_i`` at the corners of cell e.

    v are the vectors that begin `shift` after each corner's place; r is the vector four numbers after the place less
    that at the place, as it is before the call.
    """
    raise NotImplementedError(_COMPILED_ONLY)


@overload(spread)
def _spread(e: Any, shift: Any, keep: Any, M: Any, corners: Any, gradients: Any, masks: Any, dim: Any, x: Any) -> Any:
    def spatial(
        e: Any, shift: Any, keep: Any, M: Any, corners: Any, gradients: Any, masks: Any, dim: Any, x: Any
    ) -> None:
        g = _corner_gradients_3d(e, gradients)
        a, b, c, d = _inverse_masses_3d(e, corners, x)
        _push_3d(corners[e, 0], shift, (a, a, a), keep, M, g[0], x)
        _push_3d(corners[e, 1], shift, (b, b, b), keep, M, g[1], x)
        _push_3d(corners[e, 2], shift, (c, c, c), keep, M, g[2], x)
        _push_3d(corners[e, 3], shift, (d, d, d), keep, M, g[3], x)

    def planar(
        e: Any, shift: Any, keep: Any, M: Any, corners: Any, gradients: Any, masks: Any, dim: Any, x: Any
    ) -> None:
        g = _corner_gradients_2d(e, gradients)
        a, b, c = _inverse_masses_2d(e, corners, x)
        _push_2d(corners[e, 0], shift, (a, a), keep, M, g[0], x)
        _push_2d(corners[e, 1], shift, (b, b), keep, M, g[1], x)
        _push_2d(corners[e, 2], shift, (c, c), keep, M, g[2], x)

    def spatial_masked(
        e: Any, shift: Any, keep: Any, M: Any, corners: Any, gradients: Any, masks: Any, dim: Any, x: Any
    ) -> None:
        g = _corner_gradients_3d(e, gradients)
        a, b, c, d = _inverse_masses_3d(e, corners, x)
        m = masks[e]
        _push_3d(corners[e, 0], shift, (a * m[0], a * m[1], a * m[2]), keep, M, g[0], x)
        _push_3d(corners[e, 1], shift, (b * m[3], b * m[4], b * m[5]), keep, M, g[1], x)
        _push_3d(corners[e, 2], shift, (c * m[6], c * m[7], c * m[8]), keep, M, g[2], x)
        _push_3d(corners[e, 3], shift, (d * m[9], d * m[10], d * m[11]), keep, M, g[3], x)

    def planar_masked(
        e: Any, shift: Any, keep: Any, M: Any, corners: Any, gradients: Any, masks: Any, dim: Any, x: Any
    ) -> None:
        g = _corner_gradients_2d(e, gradients)
        a, b, c = _inverse_masses_2d(e, corners, x)
        m = masks[e]
        _push_2d(corners[e, 0], shift, (a * m[0], a * m[1]), keep, M, g[0], x)
        _push_2d(corners[e, 1], shift, (b * m[2], b * m[3]), keep, M, g[1], x)
        _push_2d(corners[e, 2], shift, (c * m[4], c * m[5]), keep, M, g[2], x)

    if is_gathered(corners):
        return gathered_spread(len(dim), not isinstance(masks, types.BaseTuple))
    if isinstance(masks, types.BaseTuple):
        return spatial if len(dim) == 3 else planar
    return spatial_masked if len(dim) == 3 else planar_masked


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


def misfit(e: Any, s: Any, P: Any, corners: Any, gradients: Any, masks: Any, dim: Any, x: Any) -> Any:
    """``sum_i |x_i - (b_i + s w_i P g_i)|^2 / w_i`` over what can move, b four numbers after x."""
    raise NotImplementedError(_COMPILED_ONLY)


@overload(misfit)
def _misfit(e: Any, s: Any, P: Any, corners: Any, gradients: Any, masks: Any, dim: Any, x: Any) -> Any:
    d = len(dim)
    masked = not isinstance(masks, types.BaseTuple)

    def implementation(e: Any, s: Any, P: Any, corners: Any, gradients: Any, masks: Any, dim: Any, x: Any) -> Any:
        total = 0.0
        for i in range(d + 1):
            p = corners[e, i]
            w = x[p + 3]
            if w > 0.0:
                for a in range(d):
                    push = 0.0
                    for b in range(d):
                        if i > 0:
                            push += P[d * a + b] * gradients[e, d * (i - 1) + b]
                        else:
                            for k in range(d):
                                push -= P[d * a + b] * gradients[e, d * k + b]
                    if masked:
                        push *= masks[e, d * i + a]
                    away = x[p + a] - x[p + 4 + a] - s * w * push
                    total += away * away / w
        return total

    if is_gathered(corners):
        return gathered_misfit(d, masked)
    return implementation
