"""Cell blocks of an isotropic tangent, straight from its modes, without the tangent itself.

In the frames U and V of the modes (`femdeform.materials.isotropic`) the tangent couples a variation's component (i, i)
to (j, j) by A_ij, (i, j) to itself by (flip + twist) / 2 and to (j, i) by (flip - twist) / 2. The block of two nodes
with gradients g_a, g_b is then U B U^T with, for h = V^T g,

    B_ii = A_ii h_a,i h_b,i + sum of own_ij h_a,j h_b,j over j != i,    B_ij = A_ij h_a,i h_b,j + other_ij h_a,j h_b,i.

For cells of few nodes that is half the work of the full tangent between the gradients.
"""

from __future__ import annotations

from typing import Any

from numba.extending import overload

from femdeform.fem.kernels import add_blocks
from femdeform.jit import njit
from femdeform.materials.isotropic import assemble_modes_2d, assemble_modes_3d
from femdeform.materials.small_matrix import multiply_2d, multiply_3d, transpose_2d, transpose_3d

# Up to so many nodes a cell the modes are the shorter way.
_FEW_NODES = 4


def _halves(flip: Any, twist: Any) -> Any:
    """(flip + twist) / 2 and (flip - twist) / 2."""
    raise NotImplementedError("compiled code only")


@overload(_halves)
def _halves_compiled(flip: Any, twist: Any) -> Any:
    def planar(flip: Any, twist: Any) -> Any:
        return 0.5 * (flip + twist), 0.5 * (flip - twist)

    def spatial(flip: Any, twist: Any) -> Any:
        own = (0.5 * (flip[0] + twist[0]), 0.5 * (flip[1] + twist[1]), 0.5 * (flip[2] + twist[2]))
        other = (0.5 * (flip[0] - twist[0]), 0.5 * (flip[1] - twist[1]), 0.5 * (flip[2] - twist[2]))
        return own, other

    return spatial if hasattr(flip, "count") else planar


def _gradient(gradients: Any, e: Any, q: Any, a: Any, V: Any) -> Any:
    """V^T grad N_a."""
    raise NotImplementedError("compiled code only")


@overload(_gradient)
def _gradient_compiled(gradients: Any, e: Any, q: Any, a: Any, V: Any) -> Any:
    def planar(gradients: Any, e: Any, q: Any, a: Any, V: Any) -> Any:
        g0, g1 = gradients[e, q, a, 0], gradients[e, q, a, 1]
        return (V[0] * g0 + V[2] * g1, V[1] * g0 + V[3] * g1)

    def spatial(gradients: Any, e: Any, q: Any, a: Any, V: Any) -> Any:
        g0, g1, g2 = gradients[e, q, a, 0], gradients[e, q, a, 1], gradients[e, q, a, 2]
        return (
            V[0] * g0 + V[3] * g1 + V[6] * g2,
            V[1] * g0 + V[4] * g1 + V[7] * g2,
            V[2] * g0 + V[5] * g1 + V[8] * g2,
        )

    return planar if len(V) == 4 else spatial


def _add_block(weight: Any, U: Any, A: Any, own: Any, other: Any, a: Any, b: Any, out: Any, row: Any) -> None:
    """Add the block of two nodes, whose gradients in the frame V are `a` and `b`, to a row of `out`."""
    raise NotImplementedError("compiled code only")


@overload(_add_block)
def _add_block_compiled(weight: Any, U: Any, A: Any, own: Any, other: Any, a: Any, b: Any, out: Any, row: Any) -> Any:
    def planar(weight: Any, U: Any, A: Any, own: Any, other: Any, a: Any, b: Any, out: Any, row: Any) -> None:
        p, q = a[0] * b[0], a[1] * b[1]
        inner = (
            A[0] * p + own * q,
            A[2] * a[0] * b[1] + other * a[1] * b[0],
            A[2] * a[1] * b[0] + other * a[0] * b[1],
            own * p + A[1] * q,
        )
        K = multiply_2d(U, multiply_2d(inner, transpose_2d(U)))
        for i in range(4):
            out[row, i] += weight * K[i]

    def spatial(weight: Any, U: Any, A: Any, own: Any, other: Any, a: Any, b: Any, out: Any, row: Any) -> None:
        p, q, r = a[0] * b[0], a[1] * b[1], a[2] * b[2]
        inner = (
            A[0] * p + own[2] * q + own[1] * r,
            A[5] * a[0] * b[1] + other[2] * a[1] * b[0],
            A[4] * a[0] * b[2] + other[1] * a[2] * b[0],
            A[5] * a[1] * b[0] + other[2] * a[0] * b[1],
            own[2] * p + A[1] * q + own[0] * r,
            A[3] * a[1] * b[2] + other[0] * a[2] * b[1],
            A[4] * a[2] * b[0] + other[1] * a[0] * b[2],
            A[3] * a[2] * b[1] + other[0] * a[1] * b[2],
            own[1] * p + own[0] * q + A[2] * r,
        )
        K = multiply_3d(U, multiply_3d(inner, transpose_3d(U)))
        for i in range(9):
            out[row, i] += weight * K[i]

    return planar if len(U) == 4 else spatial


def _write_tangent(U: Any, V: Any, A: Any, twist: Any, flip: Any, H: Any) -> None:
    """Write the whole tangent into H (d*d, d*d)."""
    raise NotImplementedError("compiled code only")


@overload(_write_tangent)
def _write_tangent_compiled(U: Any, V: Any, A: Any, twist: Any, flip: Any, H: Any) -> Any:
    def planar(U: Any, V: Any, A: Any, twist: Any, flip: Any, H: Any) -> None:
        assemble_modes_2d(U, V, A, twist, flip, H)

    def spatial(U: Any, V: Any, A: Any, twist: Any, flip: Any, H: Any) -> None:
        assemble_modes_3d(U, V, A, twist, flip, H)

    return planar if len(U) == 4 else spatial


@njit
def add_mode_blocks(
    U: Any,
    V: Any,
    A: Any,
    twist: Any,
    flip: Any,
    weight: Any,
    gradients: Any,
    e: Any,
    q: Any,
    dim: Any,
    nodes: Any,
    H: Any,
    M: Any,
    out: Any,
    slot: Any,
) -> None:
    """Add weight * grad N_a . T . grad N_b to the rows of a cell's pairs from `slot` on, T the tangent of the modes.

    `A`, `twist` and `flip` as in `dispatch.stretch_derivatives`, in 2D the last two as numbers. H (d*d, d*d) and M
    (d*d, d) are scratch. Of cells with few nodes only the pairs without node 0 are written: `complete_blocks` has to
    follow, once a cell.
    """
    n = len(nodes)
    if n > _FEW_NODES:
        _write_tangent(U, V, A, twist, flip, H)
        add_blocks(H, weight, gradients, e, q, dim, nodes, M, out, slot)
    else:
        own, other = _halves(flip, twist)
        for b in range(1, n):
            gb = _gradient(gradients, e, q, b, V)
            for a in range(1, b + 1):
                row = slot + a * n - (a * (a - 1)) // 2 + b - a
                _add_block(weight, U, A, own, other, _gradient(gradients, e, q, a, V), gb, out, row)


@njit
def complete_blocks(dim: Any, nodes: Any, out: Any, slot: Any) -> None:
    """Fill in the pairs of node 0 that `add_mode_blocks` leaves at zero: the gradients of a cell add up to zero."""
    d, n = len(dim), len(nodes)
    if n > _FEW_NODES:
        return
    for b in range(1, n):
        for c in range(d):
            for m in range(d):
                s = 0.0
                for a in range(1, n):
                    low, high = min(a, b), max(a, b)
                    row = slot + low * n - (low * (low - 1)) // 2 + high - low
                    s += out[row, d * c + m] if a <= b else out[row, d * m + c]
                out[slot + b, d * c + m] = -s
                out[slot, d * c + m] += s


def through_modes(X: Any, U: Any, V: Any, A: Any, twist: Any, flip: Any) -> Any:
    """Return the tangent of the modes times a variation X of F."""
    raise NotImplementedError("compiled code only")


@overload(through_modes)
def _through_modes(X: Any, U: Any, V: Any, A: Any, twist: Any, flip: Any) -> Any:
    def planar(X: Any, U: Any, V: Any, A: Any, twist: Any, flip: Any) -> Any:
        own, other = _halves(flip, twist)
        Y = multiply_2d(transpose_2d(U), multiply_2d(X, V))
        Y = (
            A[0] * Y[0] + A[2] * Y[3],
            own * Y[1] + other * Y[2],
            own * Y[2] + other * Y[1],
            A[2] * Y[0] + A[1] * Y[3],
        )
        return multiply_2d(U, multiply_2d(Y, transpose_2d(V)))

    def spatial(X: Any, U: Any, V: Any, A: Any, twist: Any, flip: Any) -> Any:
        own, other = _halves(flip, twist)
        Y = multiply_3d(transpose_3d(U), multiply_3d(X, V))
        Y = (
            A[0] * Y[0] + A[5] * Y[4] + A[4] * Y[8],
            own[2] * Y[1] + other[2] * Y[3],
            own[1] * Y[2] + other[1] * Y[6],
            own[2] * Y[3] + other[2] * Y[1],
            A[5] * Y[0] + A[1] * Y[4] + A[3] * Y[8],
            own[0] * Y[5] + other[0] * Y[7],
            own[1] * Y[6] + other[1] * Y[2],
            own[0] * Y[7] + other[0] * Y[5],
            A[4] * Y[0] + A[3] * Y[4] + A[2] * Y[8],
        )
        return multiply_3d(U, multiply_3d(Y, transpose_3d(V)))

    return planar if len(X) == 4 else spatial
