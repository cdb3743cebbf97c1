"""What the network of deep conjugate directions is made of, on float32 arrays with a frame of zeros."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from solvers.linear.poisson import dcdm_kernels
from solvers.linear.poisson.dcdm_kernels import BLOCK

Field = NDArray[np.float32]


def framed(values: NDArray[Any]) -> Field:
    """Fields (c, nx, ny[, nz]) with a frame of zeros around the grid, (c, nx + 2, ny + 2[, nz + 2])."""
    return np.pad(values.astype(np.float32), [(0, 0)] + [(1, 1)] * (values.ndim - 1))


def prepare(parameters: Mapping[str, NDArray[Any]]) -> dict[str, Field]:
    """Parameters in the order that `CompiledOperations` reads.

    Channels are filled up to whole blocks. Kernels (3, .., in, out) become what `dcdm_kernels.convolve` wants, those of
    one voxel matrices (out, in) whose rows stay as many as they are.
    """
    found = {}
    for name, values in parameters.items():
        if not name.endswith(".kernel"):
            found[name] = _filled(values, -1)
        elif values.shape[0] == 1:
            found[name] = np.ascontiguousarray(_filled(values, -2).reshape(-1, values.shape[-1]).T)
        else:
            filled = _filled(_filled(values, -1), -2)
            n_in, n_out = filled.shape[-2:]
            taps = filled.reshape(-1, 9, n_in, n_out // BLOCK, BLOCK)
            found[name] = np.transpose(taps, (3, 2, 0, 4, 1)).reshape(n_out // BLOCK, n_in, -1, 9 * BLOCK)
    return found


def _filled(values: NDArray[Any], axis: int) -> Field:
    """Values with zeros at the end of an axis, as many as a whole block lacks."""
    widths = [(0, 0)] * values.ndim
    widths[axis] = (0, -values.shape[axis] % BLOCK)
    return np.pad(values.astype(np.float32), widths)


@lru_cache(maxsize=16)
def _inner(shape: tuple[int, ...]) -> Field:
    """One where a plane of this shape is not its frame, in one row."""
    inner = np.zeros(shape, dtype=np.float32)
    inner[1:-1, 1:-1] = 1.0
    return inner.reshape(-1)


def _planes(x: Field) -> Field:
    """Fields as `dcdm_kernels.convolve` wants them."""
    return x.reshape(x.shape[0], *((1, -1) if x.ndim == 3 else (x.shape[1], -1)))


def _layers(x: Field) -> Field:
    """Fields of two dimensions as ones of a single layer."""
    return x[..., None] if x.ndim == 3 else x


class CompiledOperations:
    """Operations on fields (c, nx + 2, ny + 2[, nz + 2]) with zeros in the frame, of even sizes.

    Kernels and biases are those of `prepare`; see `dcdm_network.Operations`. Answers may have more channels than were
    asked for, of zeros.

    Limitations
    -----------
    Single precision.
    """

    def convolve(self, x: Field, kernel: Field, bias: Field | None, is_cut: bool, plus: Field | None) -> Field:
        """Convolution with zeros outside of the grid, its positive part if `is_cut`, and then the sum with `plus`."""
        if kernel.ndim == 2:
            return self._dense(x, kernel, bias, is_cut, plus)
        n_out = kernel.shape[0] * BLOCK
        out = np.zeros((n_out, *x.shape[1:]), dtype=np.float32)
        dcdm_kernels.convolve(
            _planes(x),
            kernel,
            np.zeros(n_out, dtype=np.float32) if bias is None else bias,
            x.shape[-1],
            _inner(x.shape[-2:]),
            is_cut,
            _planes(out if plus is None else plus),
            plus is not None,
            _planes(out),
        )
        return out

    def _dense(self, x: Field, matrix: Field, bias: Field | None, is_cut: bool, plus: Field | None) -> Field:
        out = np.asarray(np.tensordot(matrix, x, axes=1))
        if bias is not None:
            out += bias[: len(out)].reshape(-1, *(1,) * (x.ndim - 1))
        if is_cut:
            np.maximum(out, np.float32(0.0), out=out)
        return out if plus is None else out + plus

    def halve(self, x: Field) -> Field:
        """Means of 2^dim voxels."""
        out = np.zeros((x.shape[0], *(n // 2 + 1 for n in x.shape[1:])), dtype=np.float32)
        dcdm_kernels.halve(_layers(x), _layers(out))
        return out

    def double(self, x: Field, plus: Field | None) -> Field:
        """The nearest value on the finer grid, and the sum with `plus`."""
        out = np.zeros((x.shape[0], *(2 * n - 2 for n in x.shape[1:])), dtype=np.float32)
        dcdm_kernels.double(_layers(x), _layers(out if plus is None else plus), plus is not None, _layers(out))
        return out
