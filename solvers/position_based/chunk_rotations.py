"""Rotations of the cells of a chunk at once, written so that compilers turn the loop over cells into vectors.

The first rows of a chunk's scratch (see `chunk_numbers`) hold F, then R, then how far R is to be doubted. Laws that
know no rotation, and the plane, leave R alone.
"""

from __future__ import annotations

import math
from typing import Any

from femdeform.jit import njit
from solvers.position_based.chunk_numbers import CHUNK, get_matrix
from solvers.position_based.constraints import CORRECTION, JUMP, ROTATED, rotation
from solvers.position_based.inlining import inlined_overload

# Rows of F, which `rotate` reads, of R, and of its doubt; further numbers begin at `FURTHER`.
_F, _R, _DOUBT, FURTHER = 0, 9, 18, 19


def rotation_of(j: Any, F: Any, scratch: Any, law: Any) -> Any:
    """R of cell j, as `rotate` left it; anything for laws without."""
    raise NotImplementedError("compiled code only")


@inlined_overload(rotation_of)
def _rotation_of(j: Any, F: Any, scratch: Any, law: Any) -> Any:
    def spatial(j: Any, F: Any, scratch: Any, law: Any) -> Any:
        return get_matrix(_R, j, scratch, (0, 0, 0))

    def planar(j: Any, F: Any, scratch: Any, law: Any) -> Any:
        return rotation(F)

    def none(j: Any, F: Any, scratch: Any, law: Any) -> Any:
        return F

    if law.instance_class not in ROTATED:
        return none
    return planar if len(F) == 4 else spatial


def rotate(n: Any, scratch: Any, law: Any, dim: Any) -> None:
    """Find the rotations of the first n cells."""
    raise NotImplementedError("compiled code only")


@inlined_overload(rotate)
def _rotate(n: Any, scratch: Any, law: Any, dim: Any) -> Any:
    def spatial(n: Any, scratch: Any, law: Any, dim: Any) -> None:
        _rotate_3d(n, scratch)

    def nothing(n: Any, scratch: Any, law: Any, dim: Any) -> None:
        pass

    return spatial if law.instance_class in ROTATED and len(dim) == 3 else nothing


@njit
def _rotate_3d(n: Any, scratch: Any) -> None:
    """Three steps of Halley's rule for all, see `fast_kernels.add_rotated`; what they leave in doubt one by one."""
    for j in range(n):
        F0, F1, F2 = scratch[j], scratch[CHUNK + j], scratch[2 * CHUNK + j]
        F3, F4, F5 = scratch[3 * CHUNK + j], scratch[4 * CHUNK + j], scratch[5 * CHUNK + j]
        F6, F7, F8 = scratch[6 * CHUNK + j], scratch[7 * CHUNK + j], scratch[8 * CHUNK + j]
        W0, W1, W2 = F4 * F8 - F5 * F7, F5 * F6 - F3 * F8, F3 * F7 - F4 * F6
        W3, W4, W5 = F2 * F7 - F1 * F8, F0 * F8 - F2 * F6, F1 * F6 - F0 * F7
        W6, W7, W8 = F1 * F5 - F2 * F4, F2 * F3 - F0 * F5, F0 * F4 - F1 * F3
        J = F0 * W0 + F1 * W1 + F2 * W2
        C0 = F0 * F0 + F3 * F3 + F6 * F6
        C1 = F1 * F1 + F4 * F4 + F7 * F7
        C2 = F2 * F2 + F5 * F5 + F8 * F8
        C3 = F1 * F2 + F4 * F5 + F7 * F8
        C4 = F0 * F2 + F3 * F5 + F6 * F8
        C5 = F0 * F1 + F3 * F4 + F6 * F7
        square = C0 + C1 + C2
        constant = 2.0 * (C0 * C0 + C1 * C1 + C2 * C2) + 4.0 * (C3 * C3 + C4 * C4 + C5 * C5) - square * square
        t = math.sqrt(3.0 * square)
        correction = t
        for _ in range(3):
            tt = t * t
            value = (tt - 2.0 * square) * tt - 8.0 * J * t + constant
            slope = 4.0 * (tt - square) * t - 8.0 * J
            bend = 12.0 * tt - 4.0 * square
            correction = 2.0 * value * slope / (2.0 * slope * slope - value * bend)
            t -= correction
        inverse = 1.0 / ((t * t - square) * t - 2.0 * J)
        a, b, c = (t * t + square) * inverse, 2.0 * t * inverse, -2.0 * inverse
        doubt, jump = correction / (CORRECTION * t), t * t * t * inverse / JUMP
        scratch[18 * CHUNK + j] = doubt * doubt + jump * jump
        scratch[9 * CHUNK + j] = a * F0 + b * W0 + c * (F0 * C0 + F1 * C5 + F2 * C4)
        scratch[10 * CHUNK + j] = a * F1 + b * W1 + c * (F0 * C5 + F1 * C1 + F2 * C3)
        scratch[11 * CHUNK + j] = a * F2 + b * W2 + c * (F0 * C4 + F1 * C3 + F2 * C2)
        scratch[12 * CHUNK + j] = a * F3 + b * W3 + c * (F3 * C0 + F4 * C5 + F5 * C4)
        scratch[13 * CHUNK + j] = a * F4 + b * W4 + c * (F3 * C5 + F4 * C1 + F5 * C3)
        scratch[14 * CHUNK + j] = a * F5 + b * W5 + c * (F3 * C4 + F4 * C3 + F5 * C2)
        scratch[15 * CHUNK + j] = a * F6 + b * W6 + c * (F6 * C0 + F7 * C5 + F8 * C4)
        scratch[16 * CHUNK + j] = a * F7 + b * W7 + c * (F6 * C5 + F7 * C1 + F8 * C3)
        scratch[17 * CHUNK + j] = a * F8 + b * W8 + c * (F6 * C4 + F7 * C3 + F8 * C2)
    for j in range(n):
        if not scratch[_DOUBT * CHUNK + j] <= 1.0:
            R = rotation(get_matrix(_F, j, scratch, (0, 0, 0)))
            for k in range(9):
                scratch[(_R + k) * CHUNK + j] = R[k]
