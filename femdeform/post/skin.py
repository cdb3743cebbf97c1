"""Frames as they are drawn: with fine surfaces in place of the bodies that have a skin."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.run.frames import BodyFrame, of_kind
from femdeform.run.result import Result
from femdeform.run.skin import Skin, read_skins
from femdeform.types import IntArray


class DrawnFrames:
    """Reads the frames of a result and dresses them.

    Parameters
    ----------
    result : Result
        The result.

    Raises
    ------
    InputError
        If the skins of the result cannot be read.
    """

    def __init__(self, result: Result) -> None:
        self._result = result
        self._skins = read_skins(result.folder)

    def read(self, i: int) -> BodyFrame:
        """Read a frame as `Result.read_frame` does, and put the skins on.

        Raises
        ------
        InputError
            If the frame cannot be read.
        """
        frame = of_kind(self._result.read_frame(i), BodyFrame, self._result.folder)
        for skin in self._skins:
            frame = dress(frame, skin)
        return frame


def dress(frame: BodyFrame, skin: Skin) -> BodyFrame:
    """A frame in which a surface stands in place of its body.

    Fields at points are interpolated as displacements are; fields of cells are those of the cell that the first corner
    of a triangle is bound to.
    """
    first = len(frame.points)
    point_data = {name: np.concatenate([values, _follow(values, skin)]) for name, values in frame.point_data.items()}
    blocks: list[tuple[str, IntArray]] = []
    cell_data: dict[str, list[NDArray[Any]]] = {name: [] for name in frame.cell_data}
    skin_data: dict[str, NDArray[Any]] = {}
    for k, (name, cells) in enumerate(frame.blocks):
        of_body = np.asarray(frame.cell_data["body"][k]) == skin.body
        chosen = np.flatnonzero(of_body)
        if chosen.size:
            bound = chosen[skin.cells[skin.triangles[:, 0]]]
            skin_data = {key: values[k][bound] for key, values in frame.cell_data.items()}
        rest = np.flatnonzero(~of_body)
        if rest.size:
            blocks.append((name, cells[rest]))
            for key, blocks_of in frame.cell_data.items():
                cell_data[key].append(blocks_of[k][rest])
    if not skin_data:
        return frame
    blocks.append(("triangle", first + skin.triangles))
    for key, of_triangles in skin_data.items():
        cell_data[key].append(of_triangles)
    return replace(
        frame,
        points=np.concatenate([frame.points, skin.points]),
        displacement=np.concatenate([frame.displacement, _follow(frame.displacement, skin)]),
        blocks=blocks,
        point_data=point_data,
        cell_data=cell_data,
    )


def _follow(values: NDArray[Any], skin: Skin) -> NDArray[Any]:
    """Point values (n_points, ...) at the points of a skin, (n, ...)."""
    result = np.einsum("nk,nk...->n...", skin.weights, values[skin.nodes])
    return np.asarray(result, dtype=values.dtype)
