"""Material points on a lattice inside of a shape."""

from __future__ import annotations

import numpy as np

from femdeform.contact.obstacles import Box, Sphere
from femdeform.errors import InputError
from femdeform.mpm.particles import Particles
from femdeform.mpm.shapes import ClosedSurface, Ellipsoid
from femdeform.types import FloatArray

Body = Box | Sphere | Ellipsoid | ClosedSurface


def sample_particles(
    body: Body, spacing: float, per_axis: int, density: float, jitter: float = 0.0, seed: int = 0
) -> Particles:
    """Solid points at rest inside of a body, on a lattice with `per_axis` points a grid cell and axis.

    The lattice of a box fits it: each side has the number of points closest to `per_axis` a cell, at least one, and the
    volumes add up to the box exactly. Other bodies have the points of the lattice ``(k + 1/2) spacing / per_axis`` that
    are inside, with the volume of a lattice cell each.

    Parameters
    ----------
    body : Box, Sphere, Ellipsoid or ClosedSurface
        Its inside, whichever side its own `inside` calls free.
    spacing : float
        Distance of the grid nodes [m].
    per_axis : int
        Points a cell and axis.
    density : float
        [kg/m^3], in 2D [kg/m^2].
    jitter : float
        Points are moved at random by up to this part of half their distance along each axis, in [0, 1]; masses and
        volumes stay. Those that would leave the body stay in place.
    seed : int
        Of the random numbers.

    Returns
    -------
    Particles

    Raises
    ------
    InputError
        If a number is out of range, or no point is inside.
    """
    if per_axis < 1 or not density > 0.0 or not 0.0 <= jitter <= 1.0:
        raise InputError(
            "particles: expected per_axis >= 1, density > 0 and jitter in [0, 1], got "
            f"{per_axis}, {density:g}, {jitter:g}"
        )
    low, high = _bounds(body)
    if isinstance(body, Box):
        counts = np.maximum(1, np.rint((high - low) / spacing * per_axis)).astype(np.int64)
        step = (high - low) / counts
        axes = [low[a] + (np.arange(counts[a]) + 0.5) * step[a] for a in range(low.size)]
    else:
        step = np.full(low.size, spacing / per_axis)
        axes = [
            (np.arange(np.floor(low[a] / step[a]), np.ceil(high[a] / step[a])) + 0.5) * step[a] for a in range(low.size)
        ]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, low.size)
    if not isinstance(body, Box):
        x = x[_contains(body, x)]
    if len(x) == 0:
        raise InputError("no point of the lattice is inside of the body: take smaller cells")
    if jitter > 0.0:
        moved = x + 0.5 * jitter * step * np.random.default_rng(seed).uniform(-1.0, 1.0, x.shape)
        x = np.where(_contains(body, moved)[:, None], moved, x)
    volume = np.full(len(x), float(np.prod(step)))
    return Particles.at(x, density * volume, volume)


def _bounds(body: Body) -> tuple[FloatArray, FloatArray]:
    if isinstance(body, Box):
        return body.center - body.half, body.center + body.half
    if isinstance(body, Sphere):
        return body.center - body.radius, body.center + body.radius
    return body.bounds()


def _contains(body: Body, x: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    if isinstance(body, ClosedSurface):
        return body.contains(x)
    return np.asarray(body.sign * body.distance(x)[0] < 0.0)
