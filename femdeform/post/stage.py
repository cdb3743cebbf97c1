"""The picture of a result: its frames, drawn as their kind is, with obstacles, legend, title and time.

A `Stage` is set up once for all the frames it will show, so that neither the camera nor the colours jump.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.post.canvas import Canvas
from femdeform.post.obstacles import obstacle_shapes
from femdeform.post.setting import Setting
from femdeform.run.frames import Frame
from femdeform.run.result import Result

_OBSTACLE = "#8c9aa8"


class Stage:
    """A plotter with everything on it that stays, ready to show frames.

    Parameters
    ----------
    pyvista : module
        PyVista, from `load_pyvista`.
    result : Result
        The result.
    setting : Setting
        From `survey`; it knows what draws the frames.
    field : str, optional
        Field to colour by.
    size : (int, int)
        Width and height [pixels].
    off_screen : bool
        Draw into memory, not into a window.
    bare : bool
        Only what is simulated, and obstacles: for pictures that share a legend with others.
    """

    def __init__(
        self,
        pyvista: Any,
        result: Result,
        setting: Setting,
        field: str | None,
        *,
        size: tuple[int, int],
        off_screen: bool = True,
        bare: bool = False,
    ) -> None:
        self.pyvista = pyvista
        self._canvas = Canvas(pyvista, result, setting, size, off_screen, bare)
        self.plotter = self._canvas.plotter
        self._drawing = setting.drawing(self._canvas, field)

    def show(self, index: int) -> Frame:
        """Show a frame; the first call sets the stage.

        Parameters
        ----------
        index : int
            Position in ``result.frames``.

        Returns
        -------
        Frame
            The frame shown.
        """
        frame = self._drawing.show(index)
        self._show_obstacles(frame.time)
        self._canvas.show_time(frame.time)
        return frame

    def picture(self) -> NDArray[np.uint8]:
        """The picture of the frame shown last, (height, width, 3)."""
        drawn = np.asarray(self.plotter.screenshot(None, return_img=True), dtype=np.uint8)
        return self._drawing.finish(drawn)

    def close(self) -> None:
        """Free the plotter."""
        self.plotter.close()

    def _show_obstacles(self, time: float) -> None:
        setting = self._canvas.setting
        shapes = obstacle_shapes(self.pyvista, self._canvas.obstacles, setting.box, setting.dim, time)
        for number, shape in enumerate(shapes):
            is_line = shape.n_lines > 0
            self.plotter.add_mesh(
                shape,
                name=f"obstacle {number}",
                color=_OBSTACLE,
                opacity=1.0 if is_line else 0.3,
                line_width=3.0 * self._canvas.scale,
                reset_camera=False,
            )
