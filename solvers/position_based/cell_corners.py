"""The corners of a cell: its deformation gradient, their mobility, and how an update moves them.

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
from solvers.position_based.gathered_corners import (
    gathered_deformation,
    gathered_misfit,
    gathered_mobility,
    gathered_spread,
    is_gathered,
)

_COMPILED_ONLY = "compiled code only"


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
