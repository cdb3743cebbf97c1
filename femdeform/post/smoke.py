"""Pictures of smoke in space: lit by a sun, in its own shadow, around solids, before a dark ground.

Rays are followed here and not in VTK, whose volume rendering needs a graphics card to be quick and knows no shadows.
A window, in which one wants to turn things, has VTK's.
"""

from __future__ import annotations

import sys
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.jit import CompilationAnnouncer
from femdeform.post.canvas import Canvas
from femdeform.post.slices import show_solids
from femdeform.post.voxels import as_vtk_order, point_grid, solid_indicator, to_the_sides
from femdeform.run.frames import GridFrame, of_kind
from femdeform.types import BoolArray, FloatArray

# Optical thickness of smoke of the largest density across the whole grid.
_THICKNESS = 26.0
# Smoke in the sun, smoke in the light from everywhere, solids in the sun and in the light from everywhere.
_COLOURS = np.array([[0.72, 0.69, 0.64], [0.21, 0.235, 0.27], [0.66, 0.50, 0.34], [0.17, 0.15, 0.14]])
_ROOM = "#7d8894"
# Shadows in smoke are lighter than light scattered once would make them.
_SHADOW = 0.45
# Rays for each pixel on the rim of a solid: this many along each side.
_FINE = 3


class SmokeDrawing:
    """Draws smoke; see `femdeform.post.setting.Drawing`.

    Parameters
    ----------
    canvas : Canvas
        Where to.
    colours : (float, float)
        Range of the density.
    """

    def __init__(self, canvas: Canvas, colours: tuple[float, float]) -> None:
        self._canvas = canvas
        self._largest = colours[1] if colours[1] > 0.0 else 1.0
        self._frame: GridFrame | None = None

    def show(self, index: int) -> GridFrame:
        """Show a frame."""
        canvas = self._canvas
        frame = of_kind(canvas.result.read_frame(index), GridFrame, canvas.result.frames[index].path)
        if self._frame is None:
            canvas.annotate()
            canvas.aim()
            self._add_room(frame)
        self._frame = frame
        if canvas.is_window:
            self._show_volume(frame)
        return frame

    def finish(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Lay the smoke and the solids over the room."""
        frame = self._frame
        if frame is None or self._canvas.is_window:
            return picture
        height, width = picture.shape[:2]
        view = _View(self._canvas.plotter.camera, width, height, frame)
        with CompilationAnnouncer(partial(print, file=sys.stderr, flush=True)):
            seen = self._look(frame, view)
        shown = seen[..., :3] + seen[..., 3:] * (picture / np.float32(255.0))
        return np.asarray(np.rint(255.0 * np.clip(shown, 0.0, 1.0)), dtype=np.uint8)

    def _look(self, frame: GridFrame, view: _View) -> NDArray[np.float32]:
        """Colour (height, width, 4) picked up on the way from the eye, and what part of the ground is seen."""
        from femdeform.post.smoke_rays import DENSITY, INSIDE, light_voxels, trace

        seen = np.zeros((view.height, view.width, 4), dtype=np.float32)
        seen[..., 3] = 1.0
        voxels = np.zeros((*frame.shape, 3), dtype=np.float32)
        voxels[..., DENSITY] = np.maximum(frame.cell_data["density"], 0.0) / self._largest
        voxels[..., INSIDE] = solid_indicator(frame.solid)
        used = np.argwhere((voxels[..., DENSITY] > 1e-3) | frame.solid)
        if not len(used):
            return seen
        thickness = _THICKNESS / max(frame.shape)
        sun = view.sun()
        light_voxels(voxels, sun, _SHADOW * thickness)
        ends = np.array(frame.shape) - 0.5
        low, high = np.maximum(used.min(axis=0) - 1.0, -0.5), np.minimum(used.max(axis=0) + 1.0, ends)

        def follow(rays: FloatArray) -> tuple[NDArray[np.float32], BoolArray]:
            found, hit = np.zeros((len(rays), 4), dtype=np.float32), np.zeros(len(rays), dtype=np.bool_)
            trace(voxels, view.eye, rays, low, high, thickness, sun, _COLOURS, found, hit)
            return found, hit

        rows, columns = view.window(low, high)
        found, hit = follow(view.rays(rows, columns))
        seen[rows, columns] = found
        is_solid = np.zeros(seen.shape[:2], dtype=np.bool_)
        is_solid[rows, columns] = hit
        rows, columns = np.nonzero(_rim(is_solid))
        if len(rows):
            offsets = (np.arange(_FINE) + 0.5) / _FINE - 0.5
            down, across = (o.ravel() for o in np.meshgrid(offsets, offsets, indexing="ij"))
            found, _ = follow(view.rays((rows[:, None] + down).ravel(), (columns[:, None] + across).ravel()))
            seen[rows, columns] = found.reshape(len(rows), -1, 4).mean(axis=1)
        return seen

    def _add_room(self, frame: GridFrame) -> None:
        """The edges of the grid that lie behind what is in it."""
        canvas = self._canvas
        eye = np.array(canvas.plotter.camera.position)
        low, high = frame.box
        near = np.where(eye > 0.5 * (low + high), high, low)
        far = low + high - near
        for axis in range(3):
            for start in _corners(far, near, axis):
                if np.sum(start == near) > 1:
                    continue
                end = start.copy()
                end[axis] = near[axis]
                canvas.plotter.add_mesh(
                    canvas.pyvista.Line(start, end),
                    color=_ROOM,
                    line_width=1.4 * canvas.scale,
                    lighting=False,
                    reset_camera=False,
                )

    def _show_volume(self, frame: GridFrame) -> None:
        canvas = self._canvas
        volume = point_grid(canvas.pyvista, frame)
        volume.point_data["density"] = as_vtk_order(to_the_sides(np.asarray(frame.cell_data["density"], np.float64)))
        # The opacity is that of a voxel.
        opacity = 1.0 - np.exp(-_THICKNESS / max(frame.shape) * np.linspace(0.0, 1.0, 16))
        canvas.plotter.add_volume(
            volume,
            name="smoke",
            scalars="density",
            clim=(0.0, self._largest),
            cmap=["#d8dade", "#d8dade"],
            opacity=(255.0 * opacity).astype(np.uint8),
            opacity_unit_distance=float(frame.spacing[0]),
            shade=True,
            ambient=0.35,
            show_scalar_bar=False,
            reset_camera=False,
        )
        show_solids(canvas, frame)


class _View:
    """Rays of a camera in perspective, in units of voxels, whose centres are at whole numbers."""

    def __init__(self, camera: Any, width: int, height: int, frame: GridFrame) -> None:
        self.width, self.height = width, height
        position, focal = np.array(camera.position), np.array(camera.focal_point)
        self._forward = _unit(focal - position)
        self._right = _unit(np.cross(self._forward, np.array(camera.up)))
        self._above = np.cross(self._right, self._forward)
        self._slope = float(np.tan(np.radians(0.5 * camera.view_angle)))
        self._center = np.array(camera.GetWindowCenter())
        self.eye: FloatArray = (position - frame.origin) / frame.spacing - 0.5

    def sun(self) -> FloatArray:
        """Unit vector towards the sun: above, on the left, behind the eye."""
        return _unit(1.2 * self._above - 0.75 * self._right - 0.35 * self._forward)

    def rays(self, rows: NDArray[Any], columns: NDArray[Any]) -> FloatArray:
        """Unit vectors (n, 3) through pixels, the middle of each at a whole number."""
        x = (2.0 * (columns + 0.5) / self.width - 1.0 + self._center[0]) * self._slope * self.width / self.height
        y = (1.0 - 2.0 * (rows + 0.5) / self.height + self._center[1]) * self._slope
        rays = self._forward + x[:, None] * self._right + y[:, None] * self._above
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def window(self, low: FloatArray, high: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Rows and columns of the pixels that a box may cover."""
        offsets = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
        offsets = offsets - self.eye
        depth = np.maximum(offsets @ self._forward, 1e-9)
        x = (offsets @ self._right) / depth / self._slope * self.height / self.width - self._center[0]
        y = (offsets @ self._above) / depth / self._slope - self._center[1]
        columns = np.clip((x + 1.0) * 0.5 * self.width + np.array([-2.0, 2.0])[:, None], 0, self.width)
        rows = np.clip((1.0 - y) * 0.5 * self.height + np.array([-2.0, 2.0])[:, None], 0, self.height)
        grid = np.mgrid[int(rows.min()) : int(rows.max()), int(columns.min()) : int(columns.max())]
        return grid[0].ravel().astype(np.int64), grid[1].ravel().astype(np.int64)


def _rim(mask: BoolArray) -> BoolArray:
    """Pixels beside which there are others."""
    rim = np.zeros_like(mask)
    for axis in (0, 1):
        differs = np.diff(mask, axis=axis)
        along = np.moveaxis(rim, axis, 0)
        along[:-1] |= np.moveaxis(differs, axis, 0)
        along[1:] |= np.moveaxis(differs, axis, 0)
    return rim


def _corners(far: FloatArray, near: FloatArray, axis: int) -> list[FloatArray]:
    """The corners of a box from which edges along an axis go out, on the far side of that axis."""
    others = [a for a in range(3) if a != axis]
    corners = []
    for first in (far, near):
        for second in (far, near):
            corner = far.copy()
            corner[others[0]], corner[others[1]] = first[others[0]], second[others[1]]
            corners.append(corner)
    return corners


def _unit(vector: FloatArray) -> FloatArray:
    return np.asarray(vector / np.linalg.norm(vector), dtype=np.float64)
