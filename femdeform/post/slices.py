"""Pictures of fields in voxels in space: upright slices through the middle, solids, the edges of the grid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from femdeform.post.camera import vertical_axis
from femdeform.post.canvas import Canvas
from femdeform.post.fields import Field, select_field
from femdeform.post.plane import SOLID, colour_options
from femdeform.post.setting import resolved_or_empty
from femdeform.post.voxels import Sheet, solid_surface
from femdeform.run.frames import GridFrame, of_kind

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
        self._slices: list[Sheet] = []

    def show(self, index: int) -> GridFrame:
        """Show a frame."""
        canvas = self._canvas
        frame = of_kind(canvas.result.read_frame(index), GridFrame, canvas.result.frames[index].path)
        field = select_field(frame, self._name, canvas.result.folder)
        if not self._slices:
            upright = vertical_axis(resolved_or_empty(canvas.result))
            self._slices = [Sheet(canvas.pyvista, frame, axis, field) for axis in range(3) if axis != upright]
            self._build(frame, field)
        for sheet in self._slices:
            sheet.put(frame, field)
        if not field.categorical:
            show_solids(canvas, frame)
        return frame

    def finish(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """All is drawn."""
        return picture

    def _build(self, frame: GridFrame, field: Field) -> None:
        canvas = self._canvas
        options = colour_options(canvas, field, self._name, self._colours)
        for sheet in self._slices:
            canvas.plotter.add_mesh(sheet.mesh, scalars="field", lighting=False, **options)
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
