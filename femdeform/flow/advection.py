"""Semi-Lagrangian advection on a staggered grid.

Positions are in voxels: voxel (i, j, k) is the cube from (i, j, k) to (i + 1, j + 1, k + 1). Velocity components live
on the faces that they cross, scalars at the centres. In two dimensions there is one layer of voxels, and the third
component is zero.
"""

from __future__ import annotations

import math
from typing import Any

from femdeform.jit import njit, prange


@njit
def _held(x: Any, n: Any) -> Any:
    """A coordinate in voxels that stays in the grid."""
    return min(max(x, 0.0), n)


@njit
def _corner(x: Any, n: Any) -> Any:
    """First of the two values around a coordinate, and the part of the second; clamped to the values there are."""
    if n == 1:
        return 0, 0.0
    x = min(max(x, 0.0), n - 1.0)
    i = min(math.floor(x), n - 2)
    return i, x - i


@njit
def sample(f: Any, x: Any, y: Any, z: Any) -> Any:
    """Trilinear interpolation at a position in units of the values' own spacing."""
    i, a = _corner(x, f.shape[0])
    j, b = _corner(y, f.shape[1])
    k, c = _corner(z, f.shape[2])
    total = 0.0
    for di in range(2 if f.shape[0] > 1 else 1):
        wx = a if di == 1 else 1.0 - a
        for dj in range(2 if f.shape[1] > 1 else 1):
            wy = b if dj == 1 else 1.0 - b
            for dk in range(2 if f.shape[2] > 1 else 1):
                wz = c if dk == 1 else 1.0 - c
                total += wx * wy * wz * f[i + di, j + dj, k + dk]
    return total


@njit
def velocity_at(u: Any, v: Any, w: Any, x: Any, y: Any, z: Any) -> Any:
    """Velocity at a position in voxels."""
    return (
        sample(u, x, y - 0.5, z - 0.5),
        sample(v, x - 0.5, y, z - 0.5),
        sample(w, x - 0.5, y - 0.5, z),
    )


@njit
def departure(u: Any, v: Any, w: Any, step: Any, x: Any, y: Any, z: Any) -> Any:
    """Where what is at a position now was a step ago: one midpoint step backwards; `step` is dt / h [s/m]."""
    a, b, c = velocity_at(u, v, w, x, y, z)
    a, b, c = velocity_at(u, v, w, x - 0.5 * step * a, y - 0.5 * step * b, z - 0.5 * step * c)
    return x - step * a, y - step * b, z - step * c


@njit(parallel=True)
def advect_component(u: Any, v: Any, w: Any, around: Any, axis: Any, step: Any, out: Any) -> None:
    """Write one component, carried along by the velocity, to `out`.

    What comes from outside of the grid is what `around` has on the side next to it.

    Parameters
    ----------
    u, v, w : (nx + 1, ny, nz), (nx, ny + 1, nz), (nx, ny, nz + 1) float64
        Velocity on faces [m/s].
    around : u, v or w
        What is carried, the component along `axis`, with a layer around it; see `femdeform.flow.inlets.surrounded`.
    axis : int
        0, 1 or 2.
    step : float
        dt / h [s/m].
    out : like u, v or w
        Values a step later.
    """
    ox, oy, oz = 0.5 * (axis != 0), 0.5 * (axis != 1), 0.5 * (axis != 2)
    nx, ny, nz = u.shape[0] - 1.0, v.shape[1] - 1.0, w.shape[2] - 1.0
    for i in prange(out.shape[0]):
        for j in range(out.shape[1]):
            for k in range(out.shape[2]):
                x, y, z = departure(u, v, w, step, i + ox, j + oy, k + oz)
                x, y, z = _held(x, nx), _held(y, ny), _held(z, nz)
                out[i, j, k] = sample(around, x - ox + 1.0, y - oy + 1.0, z - oz + 1.0)


@njit
def _sample_outside_of_solids(f: Any, solid: Any, x: Any, y: Any, z: Any) -> Any:
    i, a = _corner(x, f.shape[0])
    j, b = _corner(y, f.shape[1])
    k, c = _corner(z, f.shape[2])
    total, weight = 0.0, 0.0
    for di in range(2 if f.shape[0] > 1 else 1):
        wx = a if di == 1 else 1.0 - a
        for dj in range(2 if f.shape[1] > 1 else 1):
            wy = b if dj == 1 else 1.0 - b
            for dk in range(2 if f.shape[2] > 1 else 1):
                wz = c if dk == 1 else 1.0 - c
                if not solid[i + di, j + dj, k + dk]:
                    total += wx * wy * wz * f[i + di, j + dj, k + dk]
                    weight += wx * wy * wz
    return total / weight if weight > 0.0 else 0.0


@njit(parallel=True)
def advect_scalar(u: Any, v: Any, w: Any, around: Any, solid: Any, step: Any, out: Any) -> None:
    """Write a scalar at the centres, carried along by the velocity, to `out`; solids hold none and lend none.

    Parameters
    ----------
    u, v, w : (nx + 1, ny, nz), (nx, ny + 1, nz), (nx, ny, nz + 1) float64
        Velocity on faces [m/s].
    around : (nx + 2, ny + 2, nz + 2) float64
        What is carried, with a layer around it; in two dimensions (nx + 2, ny + 2, 1).
    solid : like `around`, bool
        Voxels that are solid, with their layer.
    step : float
        dt / h [s/m].
    out : (nx, ny, nz) float64
        Values a step later, zero in solids.
    """
    nx, ny, nz = out.shape
    layer = (solid.shape[2] - nz) // 2
    for i in prange(nx):
        for j in range(ny):
            for k in range(nz):
                if solid[i + 1, j + 1, k + layer]:
                    out[i, j, k] = 0.0
                else:
                    x, y, z = departure(u, v, w, step, i + 0.5, j + 0.5, k + 0.5)
                    x, y, z = _held(x, nx), _held(y, ny), _held(z, nz)
                    out[i, j, k] = _sample_outside_of_solids(around, solid, x + 0.5, y + 0.5, z + 0.5)
