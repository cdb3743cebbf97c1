"""Pictures of fields in voxels in space: upright slices through the middle, solids, the edges of the grid."""

from __future__ import annotations

from collections.abc import Sequence

from femdeform.post.camera import vertical_axis
from femdeform.post.canvas import Canvas
from femdeform.post.fields import Field
from femdeform.post.setting import resolved_or_empty
from femdeform.post.sheets import SOLID, SheetDrawing
from femdeform.post.voxels import solid_surface
from femdeform.run.frames import GridFrame

_EDGE = "#909090"


class SliceDrawing(SheetDrawing):
    """Draws a field on slices; see `SheetDrawing`."""

    def _axes(self) -> Sequence[int]:
        upright = vertical_axis(resolved_or_empty(self._canvas.result))
        return [axis for axis in range(3) if axis != upright]

    def _add_box(self, frame: GridFrame) -> None:
        canvas = self._canvas
        box = canvas.pyvista.Box(bounds=frame.box.T.ravel()).extract_all_edges()
        canvas.plotter.add_mesh(box, color=_EDGE, line_width=1.4 * canvas.scale, lighting=False)

    def _add_rest(self, frame: GridFrame, field: Field) -> None:
        if not field.categorical:
            show_solids(self._canvas, frame)


def show_solids(canvas: Canvas, frame: GridFrame) -> None:
    """Draw the surface of the solids of a frame in place of that of the last one."""
    surface = solid_surface(canvas.pyvista, frame)
    canvas.plotter.remove_actor("solids", render=False)
    if surface.n_points:
        canvas.plotter.add_mesh(
            surface, name="solids", color=SOLID, scalars=None, smooth_shading=True, ambient=0.2, reset_camera=False
        )
