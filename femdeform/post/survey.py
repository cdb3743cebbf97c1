"""What the pictures of several frames have to share: the surface, the box around it, the range of colours."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.errors import InputError
from femdeform.post.fields import Field, select_field, value_range
from femdeform.post.skin import DrawnFrames
from femdeform.post.surface import Surface, extract_surface
from femdeform.run.result import Result
from femdeform.types import FloatArray


@dataclass(frozen=True)
class Setting:
    """What all frames of a picture or movie share.

    Attributes
    ----------
    surface : Surface
        Visible part of the mesh.
    box : (2, 3) float64
        Corners of the box around every frame and the reference shape [m].
    colours : (float, float)
        Range of the field over every frame.
    dim : int
        Dimension of the scene.
    """

    surface: Surface
    box: FloatArray
    colours: tuple[float, float]
    dim: int


def survey(
    result: Result, frames: Iterable[int], field: str | None, progress: Callable[[], None] | None = None
) -> Setting:
    """Go through frames for what they share.

    Parameters
    ----------
    result : Result
        The result.
    frames : iterable of int
        Positions in ``result.frames``.
    field : str, optional
        Field to colour by, see `select_field`.
    progress : callable, optional
        Called after each frame.

    Raises
    ------
    InputError
        If a frame cannot be read, has no such field, or has nothing to show.
    """
    surface: Surface | None = None
    corners: list[FloatArray] = []
    ranges: list[tuple[float, float]] = []
    drawn = DrawnFrames(result)
    for index in frames:
        frame = drawn.read(index)
        if surface is None:
            surface = extract_surface(frame.points, frame.blocks)
            if not len(surface.nodes):
                raise InputError(f"{result.folder}: there is nothing to show, the frames have no cells")
            corners.append(_bounds(frame.points[surface.nodes]))
        corners.append(_bounds(frame.positions[surface.nodes]))
        if not np.all(np.isfinite(corners[-1])):
            raise InputError(f"{result.frames[index].path}: the displacements are not finite")
        selected = select_field(frame, field, result.folder)
        ranges.append(value_range(_visible_values(selected, surface)))
        if selected.is_norm:
            ranges.append((0.0, 0.0))
        if progress is not None:
            progress()
    if surface is None:
        raise InputError(f"{result.folder}: there are no frames in this result")
    stacked = np.stack(corners)
    box = np.stack([stacked[:, 0].min(axis=0), stacked[:, 1].max(axis=0)])
    lowest, highest = min(low for low, _ in ranges), max(high for _, high in ranges)
    gravity = resolved_or_empty(result).get("gravity")
    flat = box[1, 2] == box[0, 2] and not (isinstance(gravity, list) and len(gravity) == 3)
    return Setting(surface, box, (lowest, highest), 2 if flat else 3)


def resolved_or_empty(result: Result) -> dict[str, Any]:
    """The resolved scene; empty where it cannot be read: a picture does not fail for want of its title."""
    try:
        return result.resolved
    except InputError:
        return {}


def _visible_values(field: Field, surface: Surface) -> FloatArray:
    if field.on_cells:
        return field.values.take(np.concatenate([surface.face_cells, surface.line_cells]))
    return field.values.take(surface.nodes)


def _bounds(points: FloatArray) -> FloatArray:
    return np.stack([points.min(axis=0), points.max(axis=0)])
