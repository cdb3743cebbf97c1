"""Inlets: faces of the grid's sides through which fluid is driven at a given velocity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.types import FloatArray


@dataclass(frozen=True)
class Inlet:
    """Part of a side of the grid with a given velocity.

    Attributes
    ----------
    axis : int
        Axis that crosses the side.
    end : int
        0 for the side of lowest coordinate, -1 for the other one.
    faces : 2D bool
        Faces of that side that belong to it, over the two other axes of (nx, ny, nz).
    velocity : tuple of float
        Of what comes in, `dim` numbers [m/s]. Where it points outwards, fluid is drawn out.
    density : float
        Of smoke in what comes in [-].
    """

    axis: int
    end: int
    faces: NDArray[np.bool_]
    velocity: tuple[float, ...]
    density: float = 0.0

    @property
    def inward(self) -> float:
        """Velocity across the side into the domain [m/s]."""
        return self.velocity[self.axis] * (1.0 if self.end == 0 else -1.0)

    def beside(self, solid: NDArray[np.bool_]) -> Inlet:
        """The part of it that no solid (nx, ny, nz) covers."""
        return replace(self, faces=self.faces & ~np.moveaxis(solid, self.axis, 0)[self.end])

    def hold(self, velocity: Sequence[FloatArray]) -> None:
        """Give its faces their velocity, in place."""
        np.moveaxis(velocity[self.axis], self.axis, 0)[self.end][self.faces] = self.velocity[self.axis]


def surrounded(values: NDArray[Any], dim: int, component: int | None = None, inlets: Sequence[Inlet] = ()) -> Any:
    """Values with a layer around them that says what lies beyond the sides of the grid.

    Beyond walls and open sides the values are those next to them. Beyond an inlet that drives fluid in they are such
    that linear interpolation meets the inlet's value on its faces, half a voxel inside of the layer.

    Parameters
    ----------
    values : (nx, ny, nz) array, or a velocity component
        At the centres of the voxels, or on faces [m/s].
    dim : int
        2 or 3; in two dimensions there is no layer along z.
    component : int, optional
        Axis of the velocity component; None for smoke at the centres.
    inlets : sequence of Inlet
        Those parts of them that no solid covers.

    Returns
    -------
    array, two values longer along each of the `dim` axes
    """
    layers = [(1, 1) if axis < dim else (0, 0) for axis in range(3)]
    out = np.pad(values, layers, mode="edge")
    for inlet in inlets:
        # Along its own axis a component has values on the very faces of the inlet.
        if inlet.inward <= 0.0 or component == inlet.axis:
            continue
        faces, given = inlet.faces, inlet.density
        if component is not None:
            along = component - (component > inlet.axis)
            wider = np.pad(faces, [(1, 1) if axis == along else (0, 0) for axis in range(2)])
            faces = np.delete(wider, -1, along) | np.delete(wider, 0, along)
            given = inlet.velocity[component]
        beside = layers[: inlet.axis] + layers[inlet.axis + 1 :]
        inner = tuple(slice(before, -before or None) for before, _ in beside)
        layer = np.moveaxis(out, inlet.axis, 0)[inlet.end]
        first = np.moveaxis(values, inlet.axis, 0)[inlet.end]
        layer[inner] = np.where(faces, 2.0 * given - first, layer[inner])
        layer[...] = np.pad(layer[inner], beside, mode="edge")
    return out
