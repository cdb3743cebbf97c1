"""What pictures of a field on flat sheets through voxels share, in the plane and in space."""

from __future__ import annotations

import importlib
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.post.canvas import Canvas
from femdeform.post.fields import Field, select_field
from femdeform.post.voxels import Sheet
from femdeform.run.frames import GridFrame, of_kind

SOLID = "#9c9ea3"
# What voxels are in, by the number in the field `solid`.
_KINDS = ("fluid", "solid")
_INK = ("#ffffff", "#cfd6dc", "#8494a3", "#465768", "#16212c")


class SheetDrawing(ABC):
    """Draws a field on sheets; see `femdeform.post.setting.Drawing`.

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
        self._sheets: list[Sheet] = []

    def show(self, index: int) -> GridFrame:
        """Show a frame."""
        canvas = self._canvas
        frame = of_kind(canvas.result.read_frame(index), GridFrame, canvas.result.frames[index].path)
        field = select_field(frame, self._name, canvas.result.folder)
        if not self._sheets:
            self._sheets = [Sheet(canvas.pyvista, frame, axis, field) for axis in self._axes()]
            self._add_sheets(field)
            self._add_box(frame)
            canvas.annotate()
            canvas.aim()
        for sheet in self._sheets:
            sheet.put(frame, field)
        self._add_rest(frame, field)
        return frame

    def finish(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """All is drawn."""
        return picture

    def _add_sheets(self, field: Field) -> None:
        options = self._colour_options(field)
        for sheet in self._sheets:
            self._canvas.plotter.add_mesh(sheet.mesh, scalars="field", lighting=False, **options)
            options = {**options, "show_scalar_bar": False}

    def _colour_options(self, field: Field) -> dict[str, Any]:
        """Options of ``add_mesh``: of ink for a density, with white in the middle for signed values."""
        if field.categorical:
            self._canvas.add_legend(range(len(_KINDS)), field.label, _KINDS)
            return self._canvas.category_options(len(_KINDS))
        cmap: Any = "RdBu_r" if field.is_signed else "viridis"
        if self._name == "density":
            cmap = importlib.import_module("matplotlib.colors").LinearSegmentedColormap.from_list("ink", _INK)
        return self._canvas.scale_options(field.label, self._colours, cmap)

    @abstractmethod
    def _axes(self) -> Sequence[int]:
        """The axis across each sheet."""

    @abstractmethod
    def _add_box(self, frame: GridFrame) -> None:
        """Draw the outline of the grid."""

    @abstractmethod
    def _add_rest(self, frame: GridFrame, field: Field) -> None:
        """Draw in each frame what lies on the sheets or beside them."""
