"""The data of the interactive view in a report: some frames of the surface, small enough for a web page."""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from femdeform.errors import InputError
from femdeform.post.camera import vertical_axis, view_direction
from femdeform.post.fields import select_field
from femdeform.post.setting import resolved_or_empty
from femdeform.post.skin import DrawnFrames
from femdeform.post.surface import Part, coarsen, extract_surface
from femdeform.run.frames import BodyFrame
from femdeform.run.result import Result
from femdeform.types import FloatArray, IntArray

MAX_TRIANGLES = 60_000
MAX_LINES = 30_000
MAX_FRAMES = 41
BUDGET = 6_000_000  # bytes of text

# Positions and values are stored in 16 bits of their range: 8 bytes a node and frame, far below a pixel.
_STEPS = 65535


def interactive_data(result: Result) -> str:
    """What ``viewer.js`` draws, as JSON that may stand inside a script element.

    Parameters
    ----------
    result : Result
        A result with frames.

    Returns
    -------
    str
        JSON with the surface (thinned out above `MAX_TRIANGLES`), as many frames as fit into `BUDGET` (the
        last is among them), the outline of the reference shape, the box, and the direction to look from.

    Raises
    ------
    InputError
        If there are no frames, or one cannot be read.
    """
    drawn = DrawnFrames(result)
    last = drawn.read(-1)
    surface = extract_surface(last.points, last.blocks)
    if not len(surface.nodes):
        raise InputError(f"{result.folder}: there is nothing to show, the frames have no cells")
    faces = surface.faces
    if len(faces.cells) > MAX_TRIANGLES:
        faces, _ = coarsen(last.points, faces, MAX_TRIANGLES)
    lines, outline = _thinned(surface.lines), _thinned(surface.outline)
    nodes = np.concatenate([faces.nodes, lines.nodes])
    fixed = 4 * (3 * len(faces.cells) + 2 * len(lines.cells) + 6 * len(outline.cells))
    n_frames = _frame_count(len(result.frames), len(nodes), fixed)
    chosen = np.unique(np.linspace(0, len(result.frames) - 1, n_frames).round().astype(int))
    if n_frames == 1:
        chosen = np.array([len(result.frames) - 1])

    known = {len(result.frames) - 1: last}
    shown = [_frame_part(known.get(i) or drawn.read(i), nodes) for i in chosen.tolist()]
    positions = [part[1] for part in shown] + [last.points[nodes]]
    low = np.min([p.min(axis=0) for p in positions], axis=0)
    high = np.max([p.max(axis=0) for p in positions], axis=0)
    if not np.all(np.isfinite([low, high])):
        raise InputError(f"{result.folder}: the displacements of the frames are not finite")
    largest = max(float(values.max()) for _, _, values in shown)
    resolved = resolved_or_empty(result)
    flat = low[2] == high[2]
    vertical = vertical_axis(resolved)
    data: dict[str, Any] = {
        "dim": 2 if flat else 3,
        "up": np.eye(3)[1 if flat else vertical].tolist(),
        "eye": [0.0, 0.0, 1.0] if flat else view_direction(high - low, vertical).tolist(),
        "low": low.tolist(),
        "high": high.tolist(),
        "largest": largest,
        "label": select_field(last, None, result.folder).label,
        "n_nodes": len(nodes),
        "triangles": _pack(faces.cells.astype("<u4")),
        "lines": _pack((lines.cells + len(faces.nodes)).astype("<u4")),
        "outline": _pack(last.points[outline.nodes[outline.cells]].astype("<f4")),
        "frames": [
            {
                "time": time,
                "positions": _pack(_quantised(points, low, high)),
                "values": _pack(_quantised(values, 0.0, largest)),
            }
            for time, points, values in shown
        ],
        "thinned": len(faces.cells) < surface.n_faces,
    }
    # "<" could end the script element the data stand in.
    return json.dumps(data, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c")


def _frame_part(frame: BodyFrame, nodes: IntArray) -> tuple[float, FloatArray, FloatArray]:
    return frame.time, frame.positions[nodes], np.linalg.norm(frame.displacement[nodes], axis=1)


def _frame_count(available: int, n_nodes: int, fixed_bytes: int) -> int:
    per_frame = 8 * n_nodes * 4 / 3
    affordable = int((BUDGET - fixed_bytes * 4 / 3) / per_frame)
    return max(1, min(available, MAX_FRAMES, affordable))


def _thinned(lines: Part) -> Part:
    # A rough surface is all sharp edges, a net of rods all lines; every second or third shows the shape too.
    stride = max(1, -(-len(lines.cells) // MAX_LINES))
    return lines if stride == 1 else Part.of(lines.nodes[lines.cells[::stride]])


def _quantised(values: FloatArray, low: FloatArray | float, high: FloatArray | float) -> NDArray[Any]:
    extent = np.asarray(high, dtype=np.float64) - np.asarray(low, dtype=np.float64)
    scaled = (values - low) / np.where(extent > 0.0, extent, 1.0)
    return np.rint(np.clip(scaled, 0.0, 1.0) * _STEPS).astype("<u2")


def _pack(array: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode("ascii")
