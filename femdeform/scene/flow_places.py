"""Which places of a flow's grid lie in a region of a scene."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from femdeform.scene.flow_schema import BoxRegion, FlowScene, Inlet, Region
from femdeform.types import FloatArray

# Sides of the grid: the axis that crosses them, and which end of it they are.
SIDES = {"left": (0, 0), "right": (0, -1), "bottom": (1, 0), "top": (1, -1), "back": (2, 0), "front": (2, -1)}


def inside(region: Region, points: FloatArray) -> NDArray[np.bool_]:
    """Which points (..., dim) [m] lie in a region."""
    if isinstance(region, BoxRegion):
        low, high = (np.array(corner) for corner in region.box)
        return np.asarray(((points >= low) & (points <= high)).all(axis=-1))
    offset = points - np.array(region.sphere.center)
    return np.asarray((offset**2).sum(axis=-1) <= region.sphere.radius**2)


def inlet_faces(scene: FlowScene, inlet: Inlet) -> NDArray[np.bool_]:
    """Faces of its side that an inlet has, over the two other axes of (nx, ny, nz).

    A box may end up to half a voxel before the side: rounding does not decide about a box that lies in it.
    """
    axis, end = SIDES[inlet.side]
    cells, h = scene.grid.cells, scene.grid.cell_size
    low = np.array(scene.grid.origin or (0.0,) * scene.dim)
    counts = [*cells, 1][:3]
    lines = [(np.arange(n) + 0.5) * h for n in cells]
    plane = low[axis] + (0.0 if end == 0 else cells[axis] * h)
    lines[axis] = np.zeros(1)
    points = low + np.stack(np.meshgrid(*lines, indexing="ij"), axis=-1)
    points[..., axis] = plane
    if inlet.region is None:
        found = np.ones(points.shape[:-1], dtype=bool)
    else:
        if isinstance(inlet.region, BoxRegion):
            first, last = (corner[axis] for corner in inlet.region.box)
            if first - h / 2 <= plane <= last + h / 2:
                points[..., axis] = min(max(plane, first), last)
        found = inside(inlet.region, points)
    del counts[axis]
    return found.reshape(counts)


def inlet_velocity(scene: FlowScene, inlet: Inlet) -> tuple[float, ...]:
    """Velocity of an inlet as a vector [m/s]."""
    if isinstance(inlet.velocity, tuple):
        return inlet.velocity
    axis, end = SIDES[inlet.side]
    into = inlet.velocity if end == 0 else -inlet.velocity
    return tuple(into if d == axis else 0.0 for d in range(scene.dim))
