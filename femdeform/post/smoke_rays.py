"""Light in smoke: how much of the sun reaches each voxel, and what a ray from the eye picks up on its way.

Smoke absorbs and scatters once: along a ray ``C = int T(t) sigma rho(t) (S L(t) + A) dt``, ``T(t) = exp(-int_0^t sigma
rho)``, with the part L of the sun S that reaches a place, and light A from everywhere.

References
----------
Kajiya, Von Herzen: Ray tracing volume densities, SIGGRAPH 1984 (single scattering, light found per voxel first).

Limitations
-----------
Light is scattered once and in all directions alike.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from femdeform.jit import njit, prange
from femdeform.types import BoolArray, FloatArray

Voxels = NDArray[np.float32]

# What the channels of the voxels hold.
DENSITY, INSIDE, LIGHT = 0, 1, 2
# Steps along a ray from the eye, in voxels.
_STEP = 0.5
# Part of the light that is left after a voxel of a solid.
_THROUGH_SOLID = 0.25
_OPAQUE = 0.004


@njit(inline="always")
def _sample(voxels: Voxels, x: float, y: float, z: float, values: FloatArray) -> None:
    """Fields at a place in units of voxels, centres at whole numbers; beyond the outer centres as there."""
    nx, ny, nz, _ = voxels.shape
    x, y, z = min(max(x, 0.0), nx - 1.0), min(max(y, 0.0), ny - 1.0), min(max(z, 0.0), nz - 1.0)
    i, j, k = min(int(x), max(nx - 2, 0)), min(int(y), max(ny - 2, 0)), min(int(z), max(nz - 2, 0))
    fx, fy, fz = x - i, y - j, z - k
    i1, j1, k1 = min(i + 1, nx - 1), min(j + 1, ny - 1), min(k + 1, nz - 1)
    for c in range(3):
        front = (voxels[i, j, k, c] * (1.0 - fz) + voxels[i, j, k1, c] * fz) * (1.0 - fy)
        front += (voxels[i, j1, k, c] * (1.0 - fz) + voxels[i, j1, k1, c] * fz) * fy
        back = (voxels[i1, j, k, c] * (1.0 - fz) + voxels[i1, j, k1, c] * fz) * (1.0 - fy)
        back += (voxels[i1, j1, k, c] * (1.0 - fz) + voxels[i1, j1, k1, c] * fz) * fy
        values[c] = front * (1.0 - fx) + back * fx


@njit(parallel=True)
def light_voxels(voxels: Voxels, sun: FloatArray, thickness: float) -> None:
    """Find how much of the sun reaches the voxels.

    Parameters
    ----------
    voxels : (nx, ny, nz, 3) float32
        Density, indicator of solids; `LIGHT` is written.
    sun : (3,) float64
        Unit vector towards the sun, in voxels.
    thickness : float
        Optical thickness of a voxel of density 1 [-].
    """
    nx, ny, nz, _ = voxels.shape
    for i in prange(nx):
        values = np.zeros(3)
        for j in range(ny):
            for k in range(nz):
                depth = 0.0
                through = 1.0
                x, y, z = i + sun[0], j + sun[1], k + sun[2]
                while through > 0.01 and depth < 5.0:
                    if x < -0.5 or y < -0.5 or z < -0.5 or x > nx - 0.5 or y > ny - 0.5 or z > nz - 0.5:
                        break
                    _sample(voxels, x, y, z, values)
                    depth += thickness * values[0]
                    if values[1] > 0.5:
                        through *= _THROUGH_SOLID
                    x += sun[0]
                    y += sun[1]
                    z += sun[2]
                voxels[i, j, k, 2] = through * np.exp(-depth)


@njit
def _normal(voxels: Voxels, x: float, y: float, z: float, values: FloatArray, normal: FloatArray) -> None:
    """Outward unit normal of a solid."""
    length = 0.0
    for axis in range(3):
        dx = 0.7 if axis == 0 else 0.0
        dy = 0.7 if axis == 1 else 0.0
        dz = 0.7 if axis == 2 else 0.0
        _sample(voxels, x - dx, y - dy, z - dz, values)
        before = values[1]
        _sample(voxels, x + dx, y + dy, z + dz, values)
        normal[axis] = before - values[1]
        length += normal[axis] ** 2
    length = max(np.sqrt(length), 1e-12)
    for axis in range(3):
        normal[axis] /= length


@njit(parallel=True)
def trace(
    voxels: Voxels,
    eye: FloatArray,
    rays: FloatArray,
    low: FloatArray,
    high: FloatArray,
    thickness: float,
    sun: FloatArray,
    colours: FloatArray,
    seen: Voxels,
    hit: BoolArray,
) -> None:
    """Follow rays from the eye; all places are in units of voxels, their centres at whole numbers.

    Parameters
    ----------
    voxels : (nx, ny, nz, 3) float32
        Density, indicator of solids, light.
    eye : (3,) float64
        Where the rays begin.
    rays : (n, 3) float64
        Unit vectors.
    low, high : (3,) float64
        Corners of the box outside of which there is nothing to see.
    thickness : float
        Optical thickness of a voxel of density 1 [-].
    sun : (3,) float64
        Unit vector towards the sun.
    colours : (4, 3) float64
        Of the smoke in the sun, of the smoke in the light from everywhere, and those of solids.
    seen : (n, 4) float32
        Output: colour picked up, and the part of what lies behind that can be seen.
    hit : (n,) bool
        Output: whether the ray ends in a solid.
    """
    for r in prange(len(rays)):
        start, end = 0.0, 1e30
        for axis in range(3):
            slope = rays[r, axis]
            if abs(slope) < 1e-12:
                slope = 1e-12
            first, second = (low[axis] - eye[axis]) / slope, (high[axis] - eye[axis]) / slope
            start, end = max(start, min(first, second)), min(end, max(first, second))
        left = 1.0
        values, normal = np.zeros(3), np.zeros(3)
        red, green, blue = 0.0, 0.0, 0.0
        hit[r] = False
        t = start + 0.5 * _STEP
        while t < end and left > _OPAQUE:
            x, y, z = eye[0] + t * rays[r, 0], eye[1] + t * rays[r, 1], eye[2] + t * rays[r, 2]
            _sample(voxels, x, y, z, values)
            if values[1] > 0.5:
                before, after = t - _STEP, t
                for _ in range(8):
                    middle = 0.5 * (before + after)
                    x, y, z = eye[0] + middle * rays[r, 0], eye[1] + middle * rays[r, 1], eye[2] + middle * rays[r, 2]
                    _sample(voxels, x, y, z, values)
                    if values[1] > 0.5:
                        after = middle
                    else:
                        before = middle
                _normal(voxels, x, y, z, values, normal)
                # The voxels inside are dark: the light is that a little outside.
                _sample(voxels, x + 1.5 * normal[0], y + 1.5 * normal[1], z + 1.5 * normal[2], values)
                lit = max(0.0, normal[0] * sun[0] + normal[1] * sun[1] + normal[2] * sun[2]) * values[2]
                red += left * (colours[2, 0] * lit + colours[3, 0])
                green += left * (colours[2, 1] * lit + colours[3, 1])
                blue += left * (colours[2, 2] * lit + colours[3, 2])
                left = 0.0
                hit[r] = True
                break
            part = left * (1.0 - np.exp(-thickness * _STEP * values[0]))
            red += part * (colours[0, 0] * values[2] + colours[1, 0])
            green += part * (colours[0, 1] * values[2] + colours[1, 1])
            blue += part * (colours[0, 2] * values[2] + colours[1, 2])
            left -= part
            t += _STEP
        seen[r, 0], seen[r, 1], seen[r, 2], seen[r, 3] = red, green, blue, left
