"""Compiled transfers of the explicit step in 2D, block by block; see `block_kernels` and `block_kernels_3d`."""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.jit import njit, prange
from femdeform.mpm.block_kernels import REACH, SIDE, load_block, spline
from femdeform.mpm.explicit_laws import deform_2d, stress_2d


@njit
def _place(x: Any, p: Any, inverse: Any, corners: Any, a: Any, one: Any, w: Any) -> Any:
    """Weights of a point into `w` (6, 3); the first of its nodes in the block, and its place after it in spacings."""
    T = w.dtype.type
    p0, p1 = x[p, 0] * inverse - 0.5 - corners[a, 0], x[p, 1] * inverse - 0.5 - corners[a, 1]
    i0, i1 = min(int(p0), SIDE - 1), min(int(p1), SIDE - 1)
    f0, f1 = T(p0 - i0 + 0.5), T(p1 - i1 + 0.5)
    spline(f0, one, 0, w)
    spline(f1, one, 3, w)
    return REACH * i0 + i1, f0, f1


@njit(parallel=True)
def scatter_2d(
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
    """Points to blocks: mass, momentum and the impulse of stress; see `scatter_3d`."""
    T = arena.dtype.type
    inverse = 1.0 / spacing
    one, none = T(1.0), T(0.0)
    h, part, dx = T(-dt * inverse), T(carried), T(spacing)
    for a in prange(starts.size - 1):
        w = np.empty((6, 3), arena.dtype)
        if clears:
            for q in range(arena.shape[1]):
                for c in range(3):
                    arena[a, q, c] = none
        for t in range(starts[a], starts[a + 1]):
            p = order[t]
            first, f0, f1 = _place(x, p, inverse, corners, a, one, w)
            m = part * mass[p]
            mdx = m * dx
            x0, x1 = mdx * affine[p, 0, 0], mdx * affine[p, 1, 0]
            y0, y1 = mdx * affine[p, 0, 1], mdx * affine[p, 1, 1]
            txx = tyy = txy = none
            if h != none:
                tau = stress_2d(state, p, gradient, law)
                s = h * volume[p]
                txx, tyy, txy = s * T(tau[0]), s * T(tau[1]), s * T(tau[2])
            c0 = m * v[p, 0] - f0 * x0 - f1 * y0
            c1 = m * v[p, 1] - f0 * x1 - f1 * y1
            for i in range(3):
                a0, a1 = c0 + T(i) * x0, c1 + T(i) * x1
                wi, gi = w[0, i], w[1, i]
                for j in range(3):
                    ww, gw, wg = wi * w[3, j], gi * w[3, j], wi * w[4, j]
                    n = first + REACH * i + j
                    arena[a, n, 0] += ww * (a0 + T(j) * y0) + gw * txx + wg * txy
                    arena[a, n, 1] += ww * (a1 + T(j) * y1) + gw * txy + wg * tyy
                    arena[a, n, 2] += ww * m


@njit
def _interpolate(local: Any, first: Any, w: Any) -> Any:
    """Sums over the nodes of a point: N v (2), dN v (4) and N (x_i - x_p) v (4), row-major, in spacings."""
    z = local[first, 0] * local.dtype.type(0.0)
    v0 = v1 = z
    l00 = l10 = l01 = l11 = z
    b00 = b10 = b01 = b11 = z
    for i in range(3):
        n = first + REACH * i
        u0 = w[3, 0] * local[n, 0] + w[3, 1] * local[n + 1, 0] + w[3, 2] * local[n + 2, 0]
        u1 = w[3, 0] * local[n, 1] + w[3, 1] * local[n + 1, 1] + w[3, 2] * local[n + 2, 1]
        g0 = w[4, 0] * local[n, 0] + w[4, 1] * local[n + 1, 0] + w[4, 2] * local[n + 2, 0]
        g1 = w[4, 0] * local[n, 1] + w[4, 1] * local[n + 1, 1] + w[4, 2] * local[n + 2, 1]
        r0 = w[5, 0] * local[n, 0] + w[5, 1] * local[n + 1, 0] + w[5, 2] * local[n + 2, 0]
        r1 = w[5, 0] * local[n, 1] + w[5, 1] * local[n + 1, 1] + w[5, 2] * local[n + 2, 1]
        wi, gi, ri = w[0, i], w[1, i], w[2, i]
        v0 += wi * u0
        v1 += wi * u1
        l00 += gi * u0
        l10 += gi * u1
        l01 += wi * g0
        l11 += wi * g1
        b00 += ri * u0
        b10 += ri * u1
        b01 += wi * r0
        b11 += wi * r1
    return (v0, v1), (l00, l01, l10, l11), (b00, b01, b10, b11)


@njit(parallel=True)
def look_2d(
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
    """Before the forces: what FLIP keeps and the gradients of velocity; see `look_3d`."""
    T = velocity.dtype.type
    inverse = 1.0 / spacing
    one, slope = T(1.0), T(inverse)
    for a in prange(starts.size - 1):
        w = np.empty((6, 3), velocity.dtype)
        local = np.empty((sources.shape[0], 2), velocity.dtype)
        load_block(velocity, near, a, sources, local)
        for t in range(starts[a], starts[a + 1]):
            p = order[t]
            u, L, _ = _interpolate(local, _place(x, p, inverse, corners, a, one, w)[0], w)
            if excess.shape[0] > 0:
                excess[p, 0], excess[p, 1] = v[p, 0] - u[0], v[p, 1] - u[1]
            if gradient.shape[0] > 0:
                gradient[p, 0, 0], gradient[p, 0, 1] = slope * L[0], slope * L[1]
                gradient[p, 1, 0], gradient[p, 1, 1] = slope * L[2], slope * L[3]


@njit(parallel=True)
def advance_2d(
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
    """Blocks to points: velocities, affine velocities, deformations and positions; see `advance_3d`."""
    T = velocity.dtype.type
    inverse = 1.0 / spacing
    one, four, h, step, keep = T(1.0), T(4.0 * inverse), T(dt * inverse), T(dt), T(flip)
    for a in prange(starts.size - 1):
        w = np.empty((6, 3), velocity.dtype)
        local = np.empty((sources.shape[0], 2), velocity.dtype)
        load_block(velocity, near, a, sources, local)
        bounded = 0
        for t in range(starts[a], starts[a + 1]):
            p = order[t]
            u, L, B = _interpolate(local, _place(x, p, inverse, corners, a, one, w)[0], w)
            x[p, 0] += step * u[0]
            x[p, 1] += step * u[1]
            if flip == 0.0:
                v[p, 0], v[p, 1] = u[0], u[1]
            else:
                v[p, 0] = u[0] + keep * excess[p, 0]
                v[p, 1] = u[1] + keep * excess[p, 1]
            if is_affine:
                affine[p, 0, 0], affine[p, 0, 1] = four * B[0], four * B[1]
                affine[p, 1, 0], affine[p, 1, 1] = four * B[2], four * B[3]
            bounded += deform_2d(state, p, L, h, law)
        n_bounded[a] += bounded
