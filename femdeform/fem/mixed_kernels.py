"""Compiled loops over cells of solids for the mixed method: tangents whose twist part can be switched off, and the rows
that tie the principal stretches to the positions.

At F = U diag(s) V^T the tangent of an isotropic law is the sum of scaling, twist and flip modes (femdeform.materials.
isotropic). Scaling and flips act on symmetric variations of the stretch, R^T dF; they are the Hessian H of psi(S) and
are clamped here above a floor, so that H has an inverse. The twists act on the rotation. Leaving them out gives the
matrix of the mixed method with the stretch eliminated, C^+; a factor per cell puts them back.

The local basis of the symmetric variations is that of the modes themselves, u_i v_i^T and (u_i v_j^T + u_j v_i^T) /
sqrt 2: orthonormal, and H is block diagonal in it, the scaling block first, then the flips (1, 2), (2, 0), (0, 1).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import overload

from femdeform.fem.kernels import CHUNK, deformation_gradient
from femdeform.fem.mode_blocks import add_mode_blocks, complete_blocks
from femdeform.jit import njit, prange
from femdeform.materials.dispatch import stretch_derivatives
from femdeform.materials.isotropic import clamp, guarded_sum
from femdeform.materials.small_matrix import (
    clamp_symmetric_2d,
    clamp_symmetric_3d,
    multiply_2d,
    multiply_3d,
    signed_svd_2d,
    signed_svd_3d,
    transpose_2d,
    transpose_3d,
)

_ROOT = np.sqrt(0.5)


@njit
def above(value: float, bound: float) -> float:
    """Return the value, or the bound if it is smaller; nan stays nan."""
    return bound if value < bound else value


@njit
def above_2d(A: Any, bound: float) -> Any:
    """Symmetric 2x2 matrix with eigenvalues raised to at least the bound."""
    B = clamp_symmetric_2d((A[0] - bound, A[1] - bound, A[2]))
    return (B[0] + bound, B[1] + bound, B[2])


@njit
def above_3d(A: Any, bound: float) -> Any:
    """Symmetric 3x3 matrix with eigenvalues raised to at least the bound."""
    B = clamp_symmetric_3d((A[0] - bound, A[1] - bound, A[2] - bound, A[3], A[4], A[5]))
    return (B[0] + bound, B[1] + bound, B[2] + bound, B[3], B[4], B[5])


@njit
def inverse_symmetric_2d(A: Any) -> Any:
    """Inverse of a symmetric 2x2 matrix (A00, A11, A01)."""
    d = 1.0 / (A[0] * A[1] - A[2] * A[2])
    return (d * A[1], d * A[0], -d * A[2])


@njit
def inverse_symmetric_3d(A: Any) -> Any:
    """Inverse of a symmetric 3x3 matrix (A00, A11, A22, A12, A02, A01)."""
    c00, c11, c22 = A[1] * A[2] - A[3] * A[3], A[0] * A[2] - A[4] * A[4], A[0] * A[1] - A[5] * A[5]
    c12, c02, c01 = A[4] * A[5] - A[0] * A[3], A[5] * A[3] - A[1] * A[4], A[4] * A[3] - A[5] * A[2]
    d = 1.0 / (A[0] * c00 + A[5] * c01 + A[4] * c02)
    return (d * c00, d * c11, d * c22, d * c12, d * c02, d * c01)


# ------------------------------------------------------------------------------------------- one point


def twist_values(F: Any, law: Any, stress: Any, given: Any) -> Any:
    """Twist values at F, of the law's stress or of a given symmetric one; as `stretch_derivatives` gives them."""
    raise NotImplementedError("compiled code only")


@overload(twist_values)
def _twist_values(F: Any, law: Any, stress: Any, given: Any) -> Any:
    def planar(F: Any, law: Any, stress: Any, given: Any) -> Any:
        _, s, _V = signed_svd_2d(F)
        _, _, twist, _ = stretch_derivatives(s, law)
        if not given:
            return twist
        # The sum of both principal values is the trace, whatever the directions are.
        return ((stress[0] + stress[3]) / guarded_sum(s[0], s[1]),)

    def spatial(F: Any, law: Any, stress: Any, given: Any) -> Any:
        _, s, V = signed_svd_3d(F)
        _, _, twist, _ = stretch_derivatives(s, law)
        if not given:
            return twist
        y0, y1, y2 = _along(stress, V, 0), _along(stress, V, 1), _along(stress, V, 2)
        return (
            (y1 + y2) / guarded_sum(s[1], s[2]),
            (y2 + y0) / guarded_sum(s[2], s[0]),
            (y0 + y1) / guarded_sum(s[0], s[1]),
        )

    return planar if len(F) == 4 else spatial


@njit
def _along(Y: Any, V: Any, i: int) -> Any:
    """v_i . Y v_i for column i of V; Y is an array of the 9 entries of a symmetric matrix."""
    a, b, c = V[i], V[3 + i], V[6 + i]
    first, second = a * Y[0] + b * Y[1] + c * Y[2], a * Y[3] + b * Y[4] + c * Y[5]
    return a * first + b * second + c * (a * Y[6] + b * Y[7] + c * Y[8])


def write_stress(F: Any, change: Any, law: Any, floor: Any, out: Any) -> None:
    """Write V (psi' + H eta) V^T into `out` (d*d,): the stress that the linear model predicts at F + change."""
    raise NotImplementedError("compiled code only")


@overload(write_stress)
def _write_stress(F: Any, change: Any, law: Any, floor: Any, out: Any) -> Any:
    def planar(F: Any, change: Any, law: Any, floor: Any, out: Any) -> None:
        U, s, V = signed_svd_2d(F)
        psi, A, _, f = stretch_derivatives(s, law)
        bound = floor * law.mu
        B, g = above_2d(A, bound), above(f[0], bound)
        D = multiply_2d(transpose_2d(U), multiply_2d(change, V))
        shear = 0.5 * g * (D[1] + D[2])
        Y = (psi[0] + B[0] * D[0] + B[2] * D[3], shear, shear, psi[1] + B[2] * D[0] + B[1] * D[3])
        Y = multiply_2d(V, multiply_2d(Y, transpose_2d(V)))
        for i in range(4):
            out[i] = Y[i]

    def spatial(F: Any, change: Any, law: Any, floor: Any, out: Any) -> None:
        U, s, V = signed_svd_3d(F)
        psi, A, _, f = stretch_derivatives(s, law)
        bound = floor * law.mu
        B = above_3d(A, bound)
        D = multiply_3d(transpose_3d(U), multiply_3d(change, V))
        y12 = 0.5 * above(f[0], bound) * (D[5] + D[7])
        y02 = 0.5 * above(f[1], bound) * (D[2] + D[6])
        y01 = 0.5 * above(f[2], bound) * (D[1] + D[3])
        Y = (
            psi[0] + B[0] * D[0] + B[5] * D[4] + B[4] * D[8],
            y01,
            y02,
            y01,
            psi[1] + B[5] * D[0] + B[1] * D[4] + B[3] * D[8],
            y12,
            y02,
            y12,
            psi[2] + B[4] * D[0] + B[3] * D[4] + B[2] * D[8],
        )
        Y = multiply_3d(V, multiply_3d(Y, transpose_3d(V)))
        for i in range(9):
            out[i] = Y[i]

    return planar if len(F) == 4 else spatial


def tangent_modes(F: Any, law: Any, twist: Any, floor: Any, exact: Any, split: Any) -> Any:
    """Frames U, V, scaling block, twist and flip of the tangent at F; see `cell_hessians`."""
    raise NotImplementedError("compiled code only")


@overload(tangent_modes)
def _tangent_modes(F: Any, law: Any, twist: Any, floor: Any, exact: Any, split: Any) -> Any:
    def planar(F: Any, law: Any, twist: Any, floor: Any, exact: Any, split: Any) -> Any:
        U, s, V = signed_svd_2d(F)
        _, A, _, f = stretch_derivatives(s, law)
        bound = floor * law.mu
        B, g = above_2d(A, bound), above(f[0], bound)
        t, flip = twist[0], f[0]
        if not exact:
            A, t, flip = B, clamp(t), g
        if split:
            A, flip = (A[0] - B[0], A[1] - B[1], A[2] - B[2]), flip - g
        return U, V, A, t, flip

    def spatial(F: Any, law: Any, twist: Any, floor: Any, exact: Any, split: Any) -> Any:
        U, s, V = signed_svd_3d(F)
        _, A, _, f = stretch_derivatives(s, law)
        bound = floor * law.mu
        B, g = above_3d(A, bound), (above(f[0], bound), above(f[1], bound), above(f[2], bound))
        t = (twist[0], twist[1], twist[2])
        if not exact:
            A, f = B, g
            t = (clamp(t[0]), clamp(t[1]), clamp(t[2]))
        if split:
            A = (A[0] - B[0], A[1] - B[1], A[2] - B[2], A[3] - B[3], A[4] - B[4], A[5] - B[5])
            f = (f[0] - g[0], f[1] - g[1], f[2] - g[2])
        return U, V, A, t, f

    return planar if len(F) == 4 else spatial


def write_rows(U: Any, V: Any, weight: Any, gradients: Any, e: Any, q: Any, nodes: Any, B: Any) -> None:
    """Write weight times the derivative of the symmetric modes by the nodes into B (n_modes, n_nodes d)."""
    raise NotImplementedError("compiled code only")


@overload(write_rows)
def _write_rows(U: Any, V: Any, weight: Any, gradients: Any, e: Any, q: Any, nodes: Any, B: Any) -> Any:
    d = 2 if len(U) == 4 else 3

    def rows(U: Any, V: Any, weight: Any, gradients: Any, e: Any, q: Any, nodes: Any, B: Any) -> None:
        for a in range(len(nodes)):
            for i in range(d):
                gi = 0.0
                for k in range(d):
                    gi += V[d * k + i] * gradients[e, q, a, k]
                for c in range(d):
                    B[i, d * a + c] = weight * gi * U[d * c + i]
            # Pairs in the order of the flips: (1, 2), (2, 0), (0, 1); in 2D only the last.
            for p in range(3 if d == 3 else 1):
                i, j = ((p + 1) % 3, (p + 2) % 3) if d == 3 else (0, 1)
                gi, gj = 0.0, 0.0
                for k in range(d):
                    gi += V[d * k + i] * gradients[e, q, a, k]
                    gj += V[d * k + j] * gradients[e, q, a, k]
                for c in range(d):
                    B[d + p, d * a + c] = weight * _ROOT * (gj * U[d * c + i] + gi * U[d * c + j])

    return rows


def write_compliance(A: Any, flip: Any, weight: Any, dim: Any, C: Any) -> None:
    """Write weight times the compliance with inverse scaling block A and inverse flips into C (n_modes, n_modes)."""
    raise NotImplementedError("compiled code only")


@overload(write_compliance)
def _write_compliance(A: Any, flip: Any, weight: Any, dim: Any, C: Any) -> Any:
    def planar(A: Any, flip: Any, weight: Any, dim: Any, C: Any) -> None:
        C[:, :] = 0.0
        C[0, 0], C[1, 1], C[2, 2] = weight * A[0], weight * A[1], weight * flip[0]
        C[0, 1] = C[1, 0] = weight * A[2]

    def spatial(A: Any, flip: Any, weight: Any, dim: Any, C: Any) -> None:
        C[:, :] = 0.0
        for i in range(3):
            C[i, i], C[3 + i, 3 + i] = weight * A[i], weight * flip[i]
        C[1, 2] = C[2, 1] = weight * A[3]
        C[0, 2] = C[2, 0] = weight * A[4]
        C[0, 1] = C[1, 0] = weight * A[5]

    return planar if len(dim) == 2 else spatial


def write_saddle(
    F: Any, law: Any, floor: Any, weight: Any, gradients: Any, e: Any, q: Any, nodes: Any, B: Any, C: Any
) -> None:
    """Write rows and compliance at F; see `cell_rows`."""
    raise NotImplementedError("compiled code only")


@overload(write_saddle)
def _write_saddle(
    F: Any, law: Any, floor: Any, weight: Any, gradients: Any, e: Any, q: Any, nodes: Any, B: Any, C: Any
) -> Any:
    def planar(
        F: Any, law: Any, floor: Any, weight: Any, gradients: Any, e: Any, q: Any, nodes: Any, B: Any, C: Any
    ) -> None:
        U, s, V = signed_svd_2d(F)
        _, A, _, f = stretch_derivatives(s, law)
        bound = floor * law.mu
        write_rows(U, V, weight, gradients, e, q, nodes, B)
        write_compliance(inverse_symmetric_2d(above_2d(A, bound)), (1.0 / above(f[0], bound),), weight, (0, 0), C)

    def spatial(
        F: Any, law: Any, floor: Any, weight: Any, gradients: Any, e: Any, q: Any, nodes: Any, B: Any, C: Any
    ) -> None:
        U, s, V = signed_svd_3d(F)
        _, A, _, f = stretch_derivatives(s, law)
        bound = floor * law.mu
        flip = (1.0 / above(f[0], bound), 1.0 / above(f[1], bound), 1.0 / above(f[2], bound))
        write_rows(U, V, weight, gradients, e, q, nodes, B)
        write_compliance(inverse_symmetric_3d(above_3d(A, bound)), flip, weight, (0, 0, 0), C)

    return planar if len(F) == 4 else spatial


# ------------------------------------------------------------------------------------------- loops


@njit(parallel=True)
def cell_twists(
    x: Any,
    cells: Any,
    gradients: Any,
    weights: Any,
    law: Any,
    stress: Any,
    given: Any,
    dim: Any,
    nodes: Any,
    out: Any,
) -> None:
    """Twist values of every point into `out` (n_cells, n_q, 3 or 1) [Pa].

    With `given` they are those of `stress` (n_cells, n_q, d*d), symmetric stresses in the reference frame, conjugate to
    the stretch [Pa]; otherwise those of the law's own stress at x, which are the values of its tangent.
    """
    for e in prange(cells.shape[0]):
        for q in range(weights.shape[1]):
            F = deformation_gradient(x, cells, gradients, e, q, dim, nodes)
            twist = twist_values(F, law, stress[e, q], given)
            for i in range(len(twist)):
                out[e, q, i] = twist[i]


@njit(parallel=True)
def cell_stresses(
    x: Any,
    step: Any,
    cells: Any,
    gradients: Any,
    weights: Any,
    law: Any,
    floor: Any,
    dim: Any,
    nodes: Any,
    out: Any,
) -> None:
    """Stress at x + step by the model that is linear at x, into `out` (n_cells, n_q, d*d) [Pa]: the multipliers."""
    for e in prange(cells.shape[0]):
        for q in range(weights.shape[1]):
            F = deformation_gradient(x, cells, gradients, e, q, dim, nodes)
            change = deformation_gradient(step, cells, gradients, e, q, dim, nodes)
            write_stress(F, change, law, floor, out[e, q])


@njit(parallel=True)
def cell_hessians(
    x: Any,
    cells: Any,
    gradients: Any,
    weights: Any,
    law: Any,
    twists: Any,
    floor: Any,
    exact: Any,
    split: Any,
    dim: Any,
    nodes: Any,
    out: Any,
    first: Any,
) -> None:
    """Upper block triangle of each cell's mixed Hessian [N/m] into rows of `out` (n_slots, d*d).

    `twists` (n_cells, n_q, 3 or 1) holds the twist values of every point [Pa]. Scaling and flip values are raised to
    `floor` times mu and twist values to 0, unless `exact`, which takes all as they are. `split` leaves the raised
    scaling and flips out: what remains stands beside the rows and compliances of `cell_rows`.
    """
    d = len(dim)
    n_pairs = (len(nodes) * (len(nodes) + 1)) // 2
    n_chunks = (cells.shape[0] + CHUNK - 1) // CHUNK
    for chunk in prange(n_chunks):
        H = np.empty((d * d, d * d))
        M = np.empty((d * d, d))
        for e in range(chunk * CHUNK, min((chunk + 1) * CHUNK, cells.shape[0])):
            slot = first + e * n_pairs
            for row in range(slot, slot + n_pairs):
                for i in range(d * d):
                    out[row, i] = 0.0
            for q in range(weights.shape[1]):
                F = deformation_gradient(x, cells, gradients, e, q, dim, nodes)
                U, V, A, twist, flip = tangent_modes(F, law, twists[e, q], floor, exact, split)
                add_mode_blocks(U, V, A, twist, flip, weights[e, q], gradients, e, q, dim, nodes, H, M, out, slot)
            complete_blocks(dim, nodes, out, slot)


@njit(parallel=True)
def cell_rows(
    x: Any,
    cells: Any,
    gradients: Any,
    weights: Any,
    law: Any,
    floor: Any,
    dim: Any,
    nodes: Any,
    B: Any,
    C: Any,
) -> None:
    """Constraint rows and compliances of the symmetric modes, times the volume of each quadrature point.

    Overwrites B (n_cells, n_q, n_modes, n_nodes d) by V d(modes)/dx [m^2] and C (n_cells, n_q, n_modes, n_modes) by
    V H^-1 with H raised above the floor [m^3/Pa].
    """
    for e in prange(cells.shape[0]):
        for q in range(weights.shape[1]):
            F = deformation_gradient(x, cells, gradients, e, q, dim, nodes)
            write_saddle(F, law, floor, weights[e, q], gradients, e, q, nodes, B[e, q], C[e, q])
