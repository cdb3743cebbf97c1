"""Loops of the convolutional network over padded grids, channel by channel.

A field of c channels is (c, planes, plane): in three dimensions planes along the first axis and one of zeros on either
side, in two a single plane. A plane lies in one row with its frame of zeros, so that a neighbour in it is a fixed
number of places away, and loops run along the plane without a look at its shape; what they leave in the frame is
cleared.

Each sum is taken in one order: results do not depend on the number of threads, which take pieces of planes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.jit import njit, prange

# Channels that are computed together: weights and sums of one tap stay in registers.
BLOCK = 4
# Voxels of a plane at a time, so that their sums stay in the first cache.
_CHUNK = 1024


@njit
def _add_taps(before: Any, at: Any, after: Any, w: Any, sums: Any, n: Any) -> None:
    """Add three neighbouring voxels of one input channel to the sums of four output channels."""
    a0, a1, a2 = sums[0:n], sums[_CHUNK : _CHUNK + n], sums[2 * _CHUNK : 2 * _CHUNK + n]
    a3 = sums[3 * _CHUNK : 3 * _CHUNK + n]
    w00, w01, w02, w03 = w[0, 0], w[0, 1], w[0, 2], w[0, 3]
    w10, w11, w12, w13 = w[1, 0], w[1, 1], w[1, 2], w[1, 3]
    w20, w21, w22, w23 = w[2, 0], w[2, 1], w[2, 2], w[2, 3]
    for t in range(n):
        x0, x1, x2 = before[t], at[t], after[t]
        a0[t] += w00 * x0 + w10 * x1 + w20 * x2
        a1[t] += w01 * x0 + w11 * x1 + w21 * x2
        a2[t] += w02 * x0 + w12 * x1 + w22 * x2
        a3[t] += w03 * x0 + w13 * x1 + w23 * x2


@njit
def _finish(sums: Any, inner: Any, plus: Any, is_cut: Any, out: Any) -> None:
    """Cut off what is negative, add, clear the frame."""
    zero = np.float32(0.0)
    for t in range(out.shape[0]):
        value = sums[t]
        if is_cut:
            value = max(value, zero)
        out[t] = (value + plus[t]) * inner[t]


@njit
def _finish_alone(sums: Any, inner: Any, is_cut: Any, out: Any) -> None:
    """As `_finish` with nothing to add."""
    zero = np.float32(0.0)
    for t in range(out.shape[0]):
        value = sums[t]
        if is_cut:
            value = max(value, zero)
        out[t] = value * inner[t]


@njit(parallel=True)
def convolve(
    x: Any, weights: Any, bias: Any, rows: Any, inner: Any, is_cut: Any, plus: Any, has_plus: Any, out: Any
) -> None:
    """Convolution with 3^dim taps, ``out = [max(0, W x + bias)] [+ plus]``.

    Parameters
    ----------
    x : (c, planes, plane) float32
        Input.
    weights : (blocks, at least c, 1 or 3, 3, 3, BLOCK) float32
        Output channels in blocks, filled up with zeros; planes, rows and places of a tap.
    bias : (blocks * BLOCK,) float32
        Of the output channels.
    rows : (3,) int
        How far away the rows of neighbours are in a plane, ascending.
    inner : (plane,) float32
        One, and zero in the frame.
    is_cut : bool
        Whether the positive part is taken.
    plus : like `out`
        Added at the end, if `has_plus`.
    has_plus : bool
        Whether `plus` is read.
    out : (blocks * BLOCK, planes, plane) float32
        Planes of zeros are left alone.
    """
    reach = weights.shape[2] // 2
    margin = rows[-1] + 1
    chunks = (x.shape[2] - 2 * margin + _CHUNK - 1) // _CHUNK
    for task in prange((x.shape[1] - 2 * reach) * chunks):
        i = reach + task // chunks
        begin = margin + (task % chunks) * _CHUNK
        n = min(_CHUNK, x.shape[2] - margin - begin)
        sums = np.empty(BLOCK * _CHUNK, np.float32)
        for block in range(weights.shape[0]):
            for o in range(BLOCK):
                sums[o * _CHUNK : o * _CHUNK + n] = bias[block * BLOCK + o]
            for c in range(x.shape[0]):
                for dx in range(weights.shape[2]):
                    line = x[c, i + dx - reach]
                    for row in range(rows.shape[0]):
                        at = begin + rows[row]
                        _add_taps(
                            line[at - 1 : at - 1 + n],
                            line[at : at + n],
                            line[at + 1 : at + 1 + n],
                            weights[block, c, dx, row],
                            sums,
                            n,
                        )
            for o in range(BLOCK):
                channel = block * BLOCK + o
                found = sums[o * _CHUNK : o * _CHUNK + n]
                within = inner[begin : begin + n]
                to = out[channel, i, begin : begin + n]
                if has_plus:
                    _finish(found, within, plus[channel, i, begin : begin + n], is_cut, to)
                else:
                    _finish_alone(found, within, is_cut, to)


@njit(parallel=True)
def halve(x: Any, out: Any) -> None:
    """Means of 2 x 2 x 2 voxels, or of 2 x 2 where there is one layer; fields (c, nx + 2, ny + 2, nz + 2 or 1)."""
    flat = x.shape[3] == 1
    part = np.float32(0.25 if flat else 0.125)
    for plane in prange(out.shape[1] - 2):
        i = plane + 1
        for c in range(x.shape[0]):
            for j in range(1, out.shape[2] - 1):
                for k in range(0 if flat else 1, 1 if flat else out.shape[3] - 1):
                    total = np.float32(0.0)
                    for a in range(2 * i - 1, 2 * i + 1):
                        for b in range(2 * j - 1, 2 * j + 1):
                            if flat:
                                total += x[c, a, b, 0]
                            else:
                                total += x[c, a, b, 2 * k - 1] + x[c, a, b, 2 * k]
                    out[c, i, j, k] = part * total


@njit(parallel=True)
def double(x: Any, plus: Any, has_plus: Any, out: Any) -> None:
    """The nearest value on the finer grid, plus a field there; fields as in `halve`."""
    flat = x.shape[3] == 1
    for plane in prange(out.shape[1] - 2):
        i = plane + 1
        for c in range(x.shape[0]):
            for j in range(1, out.shape[2] - 1):
                for k in range(0 if flat else 1, 1 if flat else out.shape[3] - 1):
                    value = x[c, (i + 1) // 2, (j + 1) // 2, 0 if flat else (k + 1) // 2]
                    out[c, i, j, k] = value + plus[c, i, j, k] if has_plus else value
