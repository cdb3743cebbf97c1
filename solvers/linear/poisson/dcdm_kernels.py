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
def _add_taps(x: Any, y: Any, z: Any, w: Any, sums: Any, n: Any) -> None:
    """Add three rows of one input channel, from a place before, to the sums of four output channels.

    Nine taps are taken at once, as sums are read and written for each call: compilers keep vectors of them in
    registers as long as all arrays but these few are known to be apart.
    """
    for t in range(n):
        x0, x1, x2 = x[t], x[t + 1], x[t + 2]
        y0, y1, y2 = y[t], y[t + 1], y[t + 2]
        z0, z1, z2 = z[t], z[t + 1], z[t + 2]
        sums[t] += (
            w[0] * x0 + w[1] * x1 + w[2] * x2 + w[3] * y0 + w[4] * y1 + w[5] * y2 + w[6] * z0 + w[7] * z1 + w[8] * z2
        )
        sums[_CHUNK + t] += (
            w[9] * x0
            + w[10] * x1
            + w[11] * x2
            + w[12] * y0
            + w[13] * y1
            + w[14] * y2
            + w[15] * z0
            + w[16] * z1
            + w[17] * z2
        )
        sums[2 * _CHUNK + t] += (
            w[18] * x0
            + w[19] * x1
            + w[20] * x2
            + w[21] * y0
            + w[22] * y1
            + w[23] * y2
            + w[24] * z0
            + w[25] * z1
            + w[26] * z2
        )
        sums[3 * _CHUNK + t] += (
            w[27] * x0
            + w[28] * x1
            + w[29] * x2
            + w[30] * y0
            + w[31] * y1
            + w[32] * y2
            + w[33] * z0
            + w[34] * z1
            + w[35] * z2
        )


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
    x: Any, weights: Any, bias: Any, row: Any, inner: Any, is_cut: Any, plus: Any, has_plus: Any, out: Any
) -> None:
    """Convolution with 3^dim taps, ``out = [max(0, W x + bias)] [+ plus]``.

    Parameters
    ----------
    x : (c, planes, plane) float32
        Input.
    weights : (blocks, at least c, 1 or 3, 9 BLOCK) float32
        Output channels in blocks, filled up with zeros; planes; for each channel of a block three rows of three taps.
    bias : (blocks * BLOCK,) float32
        Of the output channels.
    row : int
        Places from one row of a plane to the next.
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
    margin = row + 1
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
                    at = begin - 1
                    _add_taps(
                        line[at - row : at - row + n + 2],
                        line[at : at + n + 2],
                        line[at + row : at + row + n + 2],
                        weights[block, c, dx],
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
