"""What the pictures of several frames have to share: the box around them, the range of colours, light or dark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from femdeform.errors import InputError
from femdeform.run.frames import Frame
from femdeform.run.result import Result
from femdeform.types import FloatArray

if TYPE_CHECKING:
    from femdeform.post.canvas import Canvas


@dataclass(frozen=True)
class Theme:
    """Colours of everything but the result.

    Attributes
    ----------
    ground, ground_top : str
        Colours of the background at the bottom and at the top.
    text : str
        Of title, time and legend.
    """

    ground: str
    ground_top: str
    text: str


LIGHT = Theme("#ffffff", "#ffffff", "#202020")
DARK = Theme("#0e1217", "#313f50", "#e6e9ec")


class Drawing(Protocol):
    """What is drawn of the frames of one kind, on a canvas that it shares with title, time and obstacles."""

    def show(self, index: int) -> Frame:
        """Show a frame (a position in ``result.frames``); the first call puts on the canvas what stays."""

    def finish(self, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Complete the picture (height, width, 3) of what VTK has drawn of the frame shown last."""


@dataclass(frozen=True)
class Setting:
    """What all frames of a picture or movie share; each kind of frame has its own kind of setting.

    Attributes
    ----------
    box : (2, 3) float64
        Corners of the box around what is shown in every frame [m].
    colours : (float, float)
        Range of the field over every frame.
    dim : int
        Dimension of the scene.
    """

    box: FloatArray
    colours: tuple[float, float]
    dim: int

    @property
    def theme(self) -> Theme:
        """Light or dark."""
        return LIGHT

    def drawing(self, canvas: Canvas, field: str | None) -> Drawing:
        """What draws the frames of this kind.

        Parameters
        ----------
        canvas : Canvas
            Where to.
        field : str, optional
            Field to colour by.
        """
        raise NotImplementedError


def resolved_or_empty(result: Result) -> dict[str, Any]:
    """The resolved scene; empty where it cannot be read: a picture does not fail for want of its title."""
    try:
        return result.resolved
    except InputError:
        return {}


def bounds(points: FloatArray) -> FloatArray:
    """Lowest and highest corner of points (n, 3), as (2, 3)."""
    return np.stack([points.min(axis=0), points.max(axis=0)])


def around(boxes: Sequence[FloatArray]) -> FloatArray:
    """The box (2, 3) around boxes (2, 3)."""
    stacked = np.stack(boxes)
    return np.stack([stacked[:, 0].min(axis=0), stacked[:, 1].max(axis=0)])


def whole_range(ranges: Sequence[tuple[float, float]]) -> tuple[float, float]:
    """The range around ranges."""
    return min(low for low, _ in ranges), max(high for _, high in ranges)
