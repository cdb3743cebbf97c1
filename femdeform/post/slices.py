"""Pictures of fields in voxels in space: upright slices through the middle, solids, the edges of the grid."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.post.camera import vertical_axis
from femdeform.post.canvas import Canvas
from femdeform.post.fields import Field, select_field
from femdeform.post.plane import SOLID, colour_map
from femdeform.post.setting import resolved_or_empty
from femdeform.post.voxels import as_point_data, filled, point_axes, solid_surface, to_the_sides
from femdeform.run.frames import GridFrame, of_kind
from femdeform.types import FloatArray

_EDGE = "#909090"


class SliceDrawing:
    """Draws a field on slices; see `femdeform.post.setting.Drawing`.

    Parameters
    ----------
    canvas : Canvas
        Where to.
    field : str
        Field to show.
    colours : (float, float)
        Its range.
    """

    def __init__(self, canvas: Canvas, field: str, colours: tuple[float, float]) -> None:
        self._canvas = canvas
        self._name = field
        self._colours = colours
        self._slices: dict[int, Any] = {}

    def show(self, index: int) -> GridFrame:
        """Show a frame."""
        canvas = self._canvas
        frame = of_kind(canvas.result.read_frame(index), GridFrame, canvas.result.frames[index].path)
        field = select_field(frame, self._name, canvas.result.folder)
        values = field.values.reshape(frame.shape)
        values = to_the_sides(values if field.categorical else filled(values, frame.solid))
        is_first = not self._slices
        if is_first:
            upright = vertical_axis(resolved_or_empty(canvas.result))
            self._slices = {axis: _slice_mesh(canvas.pyvista, frame, axis) for axis in range(3) if axis != upright}
        for axis, mesh in self._slices.items():
            mesh.point_data["field"] = as_point_data(_middle(values, axis))
        if is_first:
            self._build(frame, field)
        show_solids(canvas, frame)
        return frame

    def finish(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """All is drawn."""
        return picture

    def _build(self, frame: GridFrame, field: Field) -> None:
        canvas = self._canvas
        options = canvas.scale_options(field.label, self._colours, colour_map(field, self._name))
        for mesh in self._slices.values():
            canvas.plotter.add_mesh(mesh, scalars="field", lighting=False, **options)
            options = {**options, "show_scalar_bar": False}
        box = canvas.pyvista.Box(bounds=frame.box.T.ravel()).extract_all_edges()
        canvas.plotter.add_mesh(box, color=_EDGE, line_width=1.4 * canvas.scale, lighting=False)
        canvas.annotate()
        canvas.aim()


def show_solids(canvas: Canvas, frame: GridFrame) -> None:
    """Draw the surface of the solids of a frame in place of that of the last one."""
    surface = solid_surface(canvas.pyvista, frame)
    canvas.plotter.remove_actor("solids", render=False)
    if surface.n_points:
        canvas.plotter.add_mesh(
            surface, name="solids", color=SOLID, scalars=None, smooth_shading=True, ambient=0.2, reset_camera=False
        )


def _slice_mesh(pyvista: Any, frame: GridFrame, axis: int) -> Any:
    axes = point_axes(frame)
    axes[axis] = np.array([frame.box[:, axis].mean()])
    return pyvista.RectilinearGrid(*axes)


def _middle(values: FloatArray, axis: int) -> FloatArray:
    """Values of `to_the_sides` half way along an axis, which is left with one entry."""
    n = values.shape[axis]
    return np.asarray(values.take([(n - 1) // 2, n // 2], axis=axis).mean(axis=axis, keepdims=True))
