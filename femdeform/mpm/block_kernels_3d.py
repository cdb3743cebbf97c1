"""Compiled transfers of the explicit step in 3D, block by block; see `block_kernels`.

Weights are made on the fly, and products of them along an axis are shared: a row of three nodes has one base, one slope
and one stress term for each component. The four components of a node, momentum and mass, are written alike, so that the
compiler makes vectors of them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.jit import njit, prange
from femdeform.mpm.block_kernels import REACH, SIDE, load_block, spline
from femdeform.mpm.explicit_laws import deform_3d, stress_3d

_ROW, _PLANE = REACH, REACH * REACH


@njit(parallel=True)
def scatter_3d(
    x: Any,
    v: Any,
    affine: Any,
    state: Any,
    mass: Any,
    volume: Any,
    gradient: Any,
    law: Any,
    carried: Any,
    dt: Any,
    spacing: Any,
    order: Any,
    starts: Any,
    corners: Any,
    clears: Any,
    arena: Any,
) -> None:
    """Points to blocks: mass, momentum and the impulse of stress, ``-dt V0 P F^T grad N``.

    Parameters
    ----------
    x, v, affine, mass, volume
        See `Particles`.
    state : (n, 3, 3) or (n,)
        F or J, as the law has it.
    gradient : (n, 3, 3)
        Gradients of the velocity, for viscosity; of no length where there is none [1/s].
    law : NamedTuple
        A law of `femdeform.materials`, or `Liquid`.
    carried : float
        1: mass and momentum are brought; 0: the impulse alone.
    dt : float
        Step [s]; 0: no impulse.
    spacing : float
        [m].
    order, starts
        Points of each block.
    corners : (n_blocks, 3) float64
        Index of the first node of each block.
    clears : bool
        Begin at zero.
    arena : (n_blocks, REACH^3, 4)
        Added to [kg m/s], [kg].
    """
    T = arena.dtype.type
    inverse = 1.0 / spacing
    one = T(1.0)
    # Zero, but the compiler does not know: mass takes the same way as the momenta.
    z = T(spacing) * T(0.0)
    h, part, dx = T(-dt * inverse), T(carried), T(spacing)
    for a in prange(starts.size - 1):
        w = np.empty((9, 3), arena.dtype)
        o0, o1, o2 = corners[a, 0], corners[a, 1], corners[a, 2]
        if clears:
            for q in range(arena.shape[1]):
                for c in range(4):
                    arena[a, q, c] = z
        for t in range(starts[a], starts[a + 1]):
            p = order[t]
            p0, p1, p2 = x[p, 0] * inverse - 0.5 - o0, x[p, 1] * inverse - 0.5 - o1, x[p, 2] * inverse - 0.5 - o2
            # A point on the far side of its block by rounding alone stays in it.
            i0, i1, i2 = min(int(p0), SIDE - 1), min(int(p1), SIDE - 1), min(int(p2), SIDE - 1)
            f0, f1, f2 = T(p0 - i0 + 0.5), T(p1 - i1 + 0.5), T(p2 - i2 + 0.5)
            spline(f0, one, 0, w)
            spline(f1, one, 3, w)
            spline(f2, one, 6, w)
            m = part * mass[p]
            mdx = m * dx
            x0, x1, x2 = mdx * affine[p, 0, 0], mdx * affine[p, 1, 0], mdx * affine[p, 2, 0]
            y0, y1, y2 = mdx * affine[p, 0, 1], mdx * affine[p, 1, 1], mdx * affine[p, 2, 1]
            z0, z1, z2 = mdx * affine[p, 0, 2], mdx * affine[p, 1, 2], mdx * affine[p, 2, 2]
            txx = tyy = tzz = tyz = txz = txy = z
            if h != z:
                tau = stress_3d(state, p, gradient, law)
                s = h * volume[p]
                txx, tyy, tzz = s * T(tau[0]), s * T(tau[1]), s * T(tau[2])
                tyz, txz, txy = s * T(tau[3]), s * T(tau[4]), s * T(tau[5])
            c0 = m * v[p, 0] - f0 * x0 - f1 * y0 - f2 * z0
            c1 = m * v[p, 1] - f0 * x1 - f1 * y1 - f2 * z1
            c2 = m * v[p, 2] - f0 * x2 - f1 * y2 - f2 * z2
            w0, w1, w2 = w[6, 0], w[6, 1], w[6, 2]
            g0, g1, g2 = w[7, 0], w[7, 1], w[7, 2]
            first = _PLANE * i0 + _ROW * i1 + i2
            for i in range(3):
                e = T(i)
                a0, a1, a2, a3 = c0 + e * x0, c1 + e * x1, c2 + e * x2, m + e * z
                wi, gi = w[0, i], w[1, i]
                for j in range(3):
                    e = T(j)
                    ww, gw, wg = wi * w[3, j], gi * w[3, j], wi * w[4, j]
                    q0 = ww * (a0 + e * y0) + gw * txx + wg * txy
                    q1 = ww * (a1 + e * y1) + gw * txy + wg * tyy
                    q2 = ww * (a2 + e * y2) + gw * txz + wg * tyz
                    q3 = ww * (a3 + e * z) + gw * z + wg * z
                    b0, b1, b2, b3 = ww * z0, ww * z1, ww * z2, ww * z
                    s0, s1, s2, s3 = ww * txz, ww * tyz, ww * tzz, ww * z
                    n = first + _PLANE * i + _ROW * j
                    arena[a, n, 0] += w0 * q0 + g0 * s0
                    arena[a, n, 1] += w0 * q1 + g0 * s1
                    arena[a, n, 2] += w0 * q2 + g0 * s2
                    arena[a, n, 3] += w0 * q3 + g0 * s3
                    q0 += b0
                    q1 += b1
                    q2 += b2
                    q3 += b3
                    arena[a, n + 1, 0] += w1 * q0 + g1 * s0
                    arena[a, n + 1, 1] += w1 * q1 + g1 * s1
                    arena[a, n + 1, 2] += w1 * q2 + g1 * s2
                    arena[a, n + 1, 3] += w1 * q3 + g1 * s3
                    q0 += b0
                    q1 += b1
                    q2 += b2
                    q3 += b3
                    arena[a, n + 2, 0] += w2 * q0 + g2 * s0
                    arena[a, n + 2, 1] += w2 * q1 + g2 * s1
                    arena[a, n + 2, 2] += w2 * q2 + g2 * s2
                    arena[a, n + 2, 3] += w2 * q3 + g2 * s3


@njit
def _interpolate(local: Any, first: Any, w: Any) -> Any:
    """Sums over the nodes of a point: N v (3), dN v (9) and N (x_i - x_p) v (9), row-major, in spacings."""
    z = local[first, 0] * local.dtype.type(0.0)
    v0 = v1 = v2 = z
    l00 = l10 = l20 = l01 = l11 = l21 = l02 = l12 = l22 = z
    b00 = b10 = b20 = b01 = b11 = b21 = b02 = b12 = b22 = z
    w0, w1, w2 = w[6, 0], w[6, 1], w[6, 2]
    g0, g1, g2 = w[7, 0], w[7, 1], w[7, 2]
    r0, r1, r2 = w[8, 0], w[8, 1], w[8, 2]
    for i in range(3):
        u0 = u1 = u2 = z
        ly0 = ly1 = ly2 = lz0 = lz1 = lz2 = z
        by0 = by1 = by2 = bz0 = bz1 = bz2 = z
        for j in range(3):
            n = first + _PLANE * i + _ROW * j
            wj, gj, rj = w[3, j], w[4, j], w[5, j]
            a0, a1, a2 = local[n, 0], local[n, 1], local[n, 2]
            c0, c1, c2 = local[n + 1, 0], local[n + 1, 1], local[n + 1, 2]
            d0, d1, d2 = local[n + 2, 0], local[n + 2, 1], local[n + 2, 2]
            s0 = w0 * a0 + w1 * c0 + w2 * d0
            s1 = w0 * a1 + w1 * c1 + w2 * d1
            s2 = w0 * a2 + w1 * c2 + w2 * d2
            u0 += wj * s0
            u1 += wj * s1
            u2 += wj * s2
            ly0 += gj * s0
            ly1 += gj * s1
            ly2 += gj * s2
            by0 += rj * s0
            by1 += rj * s1
            by2 += rj * s2
            lz0 += wj * (g0 * a0 + g1 * c0 + g2 * d0)
            lz1 += wj * (g0 * a1 + g1 * c1 + g2 * d1)
            lz2 += wj * (g0 * a2 + g1 * c2 + g2 * d2)
            bz0 += wj * (r0 * a0 + r1 * c0 + r2 * d0)
            bz1 += wj * (r0 * a1 + r1 * c1 + r2 * d1)
            bz2 += wj * (r0 * a2 + r1 * c2 + r2 * d2)
        wi, gi, ri = w[0, i], w[1, i], w[2, i]
        v0 += wi * u0
        v1 += wi * u1
        v2 += wi * u2
        l00 += gi * u0
        l10 += gi * u1
        l20 += gi * u2
        l01 += wi * ly0
        l11 += wi * ly1
        l21 += wi * ly2
        l02 += wi * lz0
        l12 += wi * lz1
        l22 += wi * lz2
        b00 += ri * u0
        b10 += ri * u1
        b20 += ri * u2
        b01 += wi * by0
        b11 += wi * by1
        b21 += wi * by2
        b02 += wi * bz0
        b12 += wi * bz1
        b22 += wi * bz2
    return (
        (v0, v1, v2),
        (l00, l01, l02, l10, l11, l12, l20, l21, l22),
        (b00, b01, b02, b10, b11, b12, b20, b21, b22),
    )


@njit
def _place(x: Any, p: Any, inverse: Any, corners: Any, a: Any, one: Any, w: Any) -> int:
    """Weights of a point into `w` (9, 3); the first of its nodes in the block."""
    T = w.dtype.type
    first = 0
    for c in range(3):
        place = x[p, c] * inverse - 0.5 - corners[a, c]
        i = min(int(place), SIDE - 1)
        spline(T(place - i + 0.5), one, 3 * c, w)
        first = first * REACH + i
    return first


@njit(parallel=True)
def look_3d(
    x: Any,
    v: Any,
    spacing: Any,
    order: Any,
    starts: Any,
    corners: Any,
    near: Any,
    sources: Any,
    velocity: Any,
    excess: Any,
    gradient: Any,
) -> None:
    """Before the forces: what FLIP keeps, ``v_p - sum N v_i``, and the gradients ``sum v_i grad N^T`` at the points.

    `excess` (n, 3) [m/s] and `gradient` (n, 3, 3) [1/s] are results, where they have any length; the rest is as in
    `advance_3d`.
    """
    T = velocity.dtype.type
    inverse = 1.0 / spacing
    one, slope = T(1.0), T(inverse)
    for a in prange(starts.size - 1):
        w = np.empty((9, 3), velocity.dtype)
        local = np.empty((sources.shape[0], 3), velocity.dtype)
        load_block(velocity, near, a, sources, local)
        for t in range(starts[a], starts[a + 1]):
            p = order[t]
            u, L, _ = _interpolate(local, _place(x, p, inverse, corners, a, one, w), w)
            if excess.shape[0] > 0:
                excess[p, 0], excess[p, 1], excess[p, 2] = v[p, 0] - u[0], v[p, 1] - u[1], v[p, 2] - u[2]
            if gradient.shape[0] > 0:
                gradient[p, 0, 0], gradient[p, 0, 1], gradient[p, 0, 2] = slope * L[0], slope * L[1], slope * L[2]
                gradient[p, 1, 0], gradient[p, 1, 1], gradient[p, 1, 2] = slope * L[3], slope * L[4], slope * L[5]
                gradient[p, 2, 0], gradient[p, 2, 1], gradient[p, 2, 2] = slope * L[6], slope * L[7], slope * L[8]


@njit(parallel=True)
def advance_3d(
    x: Any,
    v: Any,
    affine: Any,
    state: Any,
    excess: Any,
    flip: Any,
    is_affine: Any,
    law: Any,
    dt: Any,
    spacing: Any,
    order: Any,
    starts: Any,
    corners: Any,
    near: Any,
    sources: Any,
    velocity: Any,
    n_bounded: Any,
) -> None:
    """Blocks to points: velocities, affine velocities, deformations and positions of the points.

    Parameters
    ----------
    x, v, affine, state
        Changed; see `scatter_3d`.
    excess : (n, 3)
        From `look_3d`, where `flip` is not zero [m/s].
    flip : float
        Part of the excess that is kept: 0 PIC and APIC, 1 FLIP.
    is_affine : bool
        APIC: ``affine = 4/dx^2 sum N v_i (x_i - x_p)^T``; else zero is left.
    law, dt, spacing, order, starts, corners
        See `scatter_3d`.
    near, sources
        See `load_block`.
    velocity : (n_node_blocks, SIDE^3, 3)
        Of the nodes after the step [m/s].
    n_bounded : (n_blocks,) int64
        Adds the number of liquid points whose J was kept in its bounds.
    """
    T = velocity.dtype.type
    inverse = 1.0 / spacing
    one, four, h, step, keep = T(1.0), T(4.0 * inverse), T(dt * inverse), T(dt), T(flip)
    for a in prange(starts.size - 1):
        w = np.empty((9, 3), velocity.dtype)
        local = np.empty((sources.shape[0], 3), velocity.dtype)
        load_block(velocity, near, a, sources, local)
        bounded = 0
        for t in range(starts[a], starts[a + 1]):
            p = order[t]
            u, L, B = _interpolate(local, _place(x, p, inverse, corners, a, one, w), w)
            x[p, 0] += step * u[0]
            x[p, 1] += step * u[1]
            x[p, 2] += step * u[2]
            if flip == 0.0:
                v[p, 0], v[p, 1], v[p, 2] = u[0], u[1], u[2]
            else:
                v[p, 0] = u[0] + keep * excess[p, 0]
                v[p, 1] = u[1] + keep * excess[p, 1]
                v[p, 2] = u[2] + keep * excess[p, 2]
            if is_affine:
                affine[p, 0, 0], affine[p, 0, 1], affine[p, 0, 2] = four * B[0], four * B[1], four * B[2]
                affine[p, 1, 0], affine[p, 1, 1], affine[p, 1, 2] = four * B[3], four * B[4], four * B[5]
                affine[p, 2, 0], affine[p, 2, 1], affine[p, 2, 2] = four * B[6], four * B[7], four * B[8]
            bounded += deform_3d(state, p, L, h, law)
        n_bounded[a] += bounded
