"""Pictures of fields in voxels in the plane: an image, solids, the sides of the grid, arrows for velocities."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.post.fields import Field
from femdeform.post.setting import resolved_or_empty
from femdeform.post.sheets import SOLID, SheetDrawing
from femdeform.post.voxels import as_vtk_order, point_grid, solid_indicator, to_the_sides
from femdeform.run.frames import GridFrame
from femdeform.types import FloatArray

_SOLID_EDGE = "#4b4e54"
_WALL, _OPEN = "#303030", "#c8c8c8"
# Arrows along the longer side of the picture, and the length of the longest one over their distance.
_ARROWS = 26
_ARROW_LENGTH = 1.5
# The sides of the grid: name, and the corners at its ends, each as (low or high x, low or high y).
_SIDES = {
    "left": ((0, 0), (0, 1)),
    "right": ((1, 0), (1, 1)),
    "bottom": ((0, 0), (1, 0)),
    "top": ((0, 1), (1, 1)),
}


class PlaneDrawing(SheetDrawing):
    """Draws a field in the plane; see `SheetDrawing`."""

    def _axes(self) -> Sequence[int]:
        return (2,)

    def _add_box(self, frame: GridFrame) -> None:
        canvas = self._canvas
        boundaries = resolved_or_empty(canvas.result).get("boundaries")
        kinds = boundaries if isinstance(boundaries, dict) else {}
        low, high = frame.box
        for side, ends in _SIDES.items():
            start, end = (np.array([(low, high)[i][0], (low, high)[j][1], low[2]]) for i, j in ends)
            is_open = kinds.get(side) == "open"
            canvas.plotter.add_mesh(
                canvas.pyvista.Line(start, end),
                color=_OPEN if is_open else _WALL,
                line_width=(1.0 if is_open else 3.0) * canvas.scale,
                lighting=False,
            )

    def _add_rest(self, frame: GridFrame, field: Field) -> None:
        self._show_solids(frame)
        if self._name == "velocity":
            self._show_arrows(frame)

    def _show_solids(self, frame: GridFrame) -> None:
        canvas = self._canvas
        canvas.plotter.remove_actor(["solids", "edges of solids"], render=False)
        if not frame.solid.any() or self._name == "solid":
            return
        grid = point_grid(canvas.pyvista, frame)
        grid.point_data["inside"] = as_vtk_order(to_the_sides(solid_indicator(frame.solid)))
        surface = grid.extract_surface(algorithm=None)
        for name, mesh, colour in (
            ("solids", surface.clip_scalar(scalars="inside", value=0.5, invert=False), SOLID),
            ("edges of solids", surface.contour([0.5], scalars="inside"), _SOLID_EDGE),
        ):
            if mesh.n_points:
                canvas.plotter.add_mesh(
                    _raised(mesh, 1e-4),
                    name=name,
                    color=colour,
                    scalars=None,
                    lighting=False,
                    line_width=2.0 * canvas.scale,
                    reset_camera=False,
                )

    def _show_arrows(self, frame: GridFrame) -> None:
        canvas = self._canvas
        stride = max(1, -(-max(frame.shape) // _ARROWS))
        i, j = np.meshgrid(*(np.arange(stride // 2, n, stride) for n in frame.shape[:2]), indexing="ij")
        shown = ~frame.solid[i, j, 0]
        i, j = i[shown], j[shown]
        starts = frame.origin + frame.spacing * np.stack([i + 0.5, j + 0.5, 0.0 * i], axis=1)
        largest = max(self._colours[1], 1e-300)
        vectors = frame.cell_data["velocity"][i, j, 0] * (_ARROW_LENGTH * stride * float(frame.spacing[0]) / largest)
        points, lines = _arrows(starts, vectors)
        arrows = canvas.pyvista.PolyData(points, lines=lines)
        canvas.plotter.add_mesh(
            _raised(arrows, 2e-4),
            name="arrows",
            color="#ffffff",
            lighting=False,
            line_width=1.6 * canvas.scale,
            reset_camera=False,
        )


def _raised(mesh: Any, by: float) -> Any:
    """A flat mesh, lifted a little towards the eye, so that it hides what lies below."""
    size = float(np.ptp(np.asarray(mesh.points), axis=0).max())
    mesh.points = np.asarray(mesh.points) + np.array([0.0, 0.0, by * max(size, 1e-12)])
    return mesh


def _arrows(starts: FloatArray, vectors: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
    """Points and lines of flat arrows (n, 3)."""
    ends = starts + vectors
    across = np.stack([-vectors[:, 1], vectors[:, 0], 0.0 * vectors[:, 0]], axis=1)
    barbs = [ends - 0.35 * vectors + sign * 0.2 * across for sign in (-1.0, 1.0)]
    points = np.stack([starts, ends, *barbs], axis=1).reshape(-1, 3)
    first = 4 * np.arange(len(starts))
    shafts = np.stack([np.full_like(first, 2), first, first + 1], axis=1)
    heads = np.stack([np.full_like(first, 3), first + 2, first + 1, first + 3], axis=1)
    return points, np.concatenate([shafts.ravel(), heads.ravel()])
