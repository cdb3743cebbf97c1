"""Fields in voxels as points that can be drawn: filled inside of solids, carried on to the sides of the grid."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter

from femdeform.post.fields import Field
from femdeform.run.frames import GridFrame
from femdeform.types import FloatArray

# A solid is smoothed over this part of a voxel, so that its surface is not all stairs; whether the centre of a voxel
# lies inside never changes.
_SMOOTHING = 0.8
_MARGIN = 0.02


def solid_indicator(solid: NDArray[np.bool_]) -> FloatArray:
    """A smooth function (nx, ny, nz) above 1/2 at the centres of solid voxels, below at others.

    Parameters
    ----------
    solid : (nx, ny, nz) bool
        Voxels inside solids.
    """
    width = [_SMOOTHING if n > 1 else 0.0 for n in solid.shape]
    smooth = gaussian_filter(solid.astype(np.float64), width, mode="nearest")
    inside, outside = np.maximum(smooth, 0.5 + _MARGIN), np.minimum(smooth, 0.5 - _MARGIN)
    return np.asarray(np.where(solid, inside, outside))


def filled(values: FloatArray, solid: NDArray[np.bool_]) -> FloatArray:
    """Values (nx, ny, nz) with those of the nearest fluid voxel inside of solids, where there is no flow."""
    if not solid.any() or solid.all():
        return values
    nearest = distance_transform_edt(solid, return_distances=False, return_indices=True)
    return np.asarray(values[tuple(nearest)])


def to_the_sides(values: FloatArray) -> FloatArray:
    """Values at the points of `point_axes`: those at the centres, the outer ones once more on the sides."""
    return np.pad(values, [(1, 1) if n > 1 else (0, 0) for n in values.shape], mode="edge")


def point_axes(frame: GridFrame) -> list[FloatArray]:
    """Coordinates along each axis of the centres of voxels and of the sides of the grid [m]; z = 0 in the plane."""
    axes = []
    for n, side, low in zip(frame.shape, frame.spacing, frame.origin, strict=True):
        centres = low + side * (np.arange(n) + 0.5)
        axes.append(np.concatenate([[low], centres, [low + n * side]]) if n > 1 else np.array([low]))
    return axes


def point_grid(pyvista: Any, frame: GridFrame) -> Any:
    """The grid of `point_axes` without data."""
    return pyvista.RectilinearGrid(*point_axes(frame))


def as_vtk_order(values: FloatArray) -> FloatArray:
    """Values as VTK orders them, the first index fastest, (n,)."""
    return np.ravel(values, order="F")


class Sheet:
    """A field on a flat mesh: on the plane of a 2D scene, or half way along an axis of a 3D one.

    Parameters
    ----------
    pyvista : module
        PyVista.
    frame : GridFrame
        A frame.
    across : int
        The axis across the sheet; 2 for a 2D scene.
    field : Field
        The field. What has names has a colour for each voxel; else values are interpolated between centres, and inside
        of solids they are those of the nearest fluid.
    """

    def __init__(self, pyvista: Any, frame: GridFrame, across: int, field: Field) -> None:
        self._across = across
        axes = point_axes(frame)
        if field.categorical:
            axes = [
                low + side * np.arange(n + 1)
                for n, side, low in zip(frame.shape, frame.spacing, frame.origin, strict=True)
            ]
        axes[across] = np.array([frame.box[:, across].mean()])
        self.mesh = pyvista.RectilinearGrid(*axes)
        self.put(frame, field)

    def put(self, frame: GridFrame, field: Field) -> None:
        """Show the field of a frame."""
        values = field.values.reshape(frame.shape)
        if field.categorical:
            n = frame.shape[self._across]
            self.mesh.cell_data["field"] = as_vtk_order(values.take([n // 2], axis=self._across))
            return
        values = to_the_sides(filled(values, frame.solid))
        n = values.shape[self._across]
        middle = values.take([(n - 1) // 2, n // 2], axis=self._across).mean(axis=self._across)
        self.mesh.point_data["field"] = as_vtk_order(middle)


def solid_surface(pyvista: Any, frame: GridFrame) -> Any:
    """The closed surface of the solids of a frame in space; an empty mesh where there are none."""
    indicator = to_the_sides(solid_indicator(frame.solid))
    for axis in range(3):
        np.moveaxis(indicator, axis, 0)[[0, -1]] = 0.0
    grid = point_grid(pyvista, frame)
    grid.point_data["inside"] = as_vtk_order(indicator)
    return grid.contour([0.5], scalars="inside") if frame.solid.any() else pyvista.PolyData()
