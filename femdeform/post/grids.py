"""What pictures of fields in voxels share, and which drawing is theirs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from femdeform.errors import InputError
from femdeform.post.canvas import Canvas
from femdeform.post.fields import default_field, select_field, value_range
from femdeform.post.plane import PlaneDrawing
from femdeform.post.setting import DARK, LIGHT, Drawing, Setting, Theme, whole_range
from femdeform.post.slices import SliceDrawing
from femdeform.post.smoke import SmokeDrawing
from femdeform.run.frames import GridFrame, of_kind
from femdeform.run.result import Result


@dataclass(frozen=True)
class GridSetting(Setting):
    """What the pictures of fields in voxels share; `box` is that of the grid.

    Attributes
    ----------
    field : str
        Field to show.
    """

    field: str

    @property
    def is_smoke(self) -> bool:
        """Whether what is shown is smoke in a room, not numbers on surfaces."""
        return self.dim == 3 and self.field == "density"

    @property
    def theme(self) -> Theme:
        """Smoke is seen before a dark ground."""
        return DARK if self.is_smoke else LIGHT

    def drawing(self, canvas: Canvas, field: str | None) -> Drawing:
        """An image in the plane; in space smoke, and slices through other fields."""
        if self.dim == 2:
            return PlaneDrawing(canvas, self.field, self.colours)
        return SmokeDrawing(canvas, self.colours) if self.is_smoke else SliceDrawing(canvas, self.field, self.colours)


def survey_grid(result: Result, frames: Iterable[int], field: str | None, progress: Callable[[], None]) -> GridSetting:
    """Go through frames of voxels for what they share; see `femdeform.post.survey.survey`.

    Values inside of solids do not count.
    """
    first: GridFrame | None = None
    name = field
    ranges = []
    for index in frames:
        place = result.frames[index].path
        frame = of_kind(result.read_frame(index), GridFrame, place)
        if first is None:
            first, name = frame, field or default_field(frame)
        if frame.shape != first.shape or np.any(frame.origin != first.origin):
            raise InputError(f"{place}: the grid is not that of the other frames")
        selected = select_field(frame, name, result.folder)
        fluid = ~frame.solid.ravel()
        ranges.append(value_range(selected.values[fluid if fluid.any() and not selected.categorical else ...]))
        if selected.is_norm:
            ranges.append((0.0, 0.0))
        if selected.is_signed:
            ranges.append((-ranges[-1][1], -ranges[-1][0]))
        progress()
    assert first is not None
    assert name is not None
    return GridSetting(first.box, whole_range(ranges), first.dim, name)
