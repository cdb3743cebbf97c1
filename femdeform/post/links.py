"""Springs and pairs in a picture: the lines between their ends, from what ``result.json`` says of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from femdeform.types import FloatArray

# From positions of all nodes (n, 3) and a time to the two ends of a line (2, 3).
Segment = Callable[[FloatArray, float], FloatArray]


def link_segments(lines: Any) -> list[Segment]:
    """Functions that place the lines of a result; what cannot be understood is left out.

    Parameters
    ----------
    lines : list of [end, end], or anything else
        An end has `nodes` and `weights`, or `place` at time 0 [m] and `velocity` [m/s].
    """
    segments = []
    for line in lines if isinstance(lines, list) else []:
        try:
            first, second = (_end(end) for end in line)
        except (KeyError, TypeError, ValueError):
            continue  # a picture without a line is better than none
        segments.append(_joined(first, second))
    return segments


def places_in_space(lines: Any) -> list[FloatArray]:
    """Ends (3,) that belong to no body, at time 0 [m]: a picture has room for them."""
    ends = [end for line in lines if isinstance(line, list) for end in line] if isinstance(lines, list) else []
    return [_vector(end["place"]) for end in ends if isinstance(end, dict) and "place" in end]


def _joined(first: Segment, second: Segment) -> Segment:
    return lambda positions, time: np.stack([first(positions, time), second(positions, time)])


def _end(end: Any) -> Segment:
    if "place" in end:
        place, velocity = _vector(end["place"]), _vector(end["velocity"])
        return lambda positions, time: np.asarray(place + time * velocity)
    nodes, weights = np.array(end["nodes"], dtype=np.int64), np.array(end["weights"], dtype=np.float64)
    return lambda positions, time: np.asarray(weights @ positions[nodes])


def _vector(values: Any) -> FloatArray:
    vector = np.zeros(3)
    vector[: len(values)] = values
    return vector
