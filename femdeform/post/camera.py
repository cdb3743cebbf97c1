"""Where to look from: one fixed camera that shows a whole box, with room for the legend."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from femdeform.types import FloatArray

VIEW_ANGLE = 25.0  # [deg], the full vertical angle; small angles distort little


@dataclass(frozen=True)
class Camera:
    """A camera in the terms of VTK.

    Attributes
    ----------
    position, focal_point, up : (3,) float64
        As VTK means them [m].
    parallel_scale : float or None
        Half the height seen [m] in parallel projection, None for perspective.
    """

    position: FloatArray
    focal_point: FloatArray
    up: FloatArray
    parallel_scale: float | None


def vertical_axis(resolved: Mapping[str, Any]) -> int:
    """The axis that points up in pictures: against gravity, else along the normal of a plane obstacle, else
    y.

    Parameters
    ----------
    resolved : mapping
        The resolved scene; may be empty.

    Returns
    -------
    int
        0, 1 or 2.
    """
    directions = [resolved.get("gravity")]
    obstacles = resolved.get("obstacles")
    if isinstance(obstacles, list):
        directions += [o.get("normal") for o in obstacles if isinstance(o, dict) and o.get("kind") == "plane"]
    for direction in directions:
        if isinstance(direction, list) and len(direction) == 3 and any(direction):
            return int(np.argmax(np.abs(np.asarray(direction, dtype=np.float64))))
    return 1


def place_camera(box: FloatArray, *, dim: int, vertical: int, aspect: float) -> Camera:
    """A camera that sees a box whole.

    Parameters
    ----------
    box : (2, 3) float64
        Lowest and highest corner [m].
    dim : int
        2: seen from +z, without perspective.
    vertical : int
        Axis that points up (3D).
    aspect : float
        Width over height of the part of the picture the box may fill.

    Returns
    -------
    Camera
        Its focal point is the middle of the box.
    """
    center = box.mean(axis=0)
    extent = box[1] - box[0]
    size = max(float(np.linalg.norm(extent)), 1e-12)
    if dim == 2:
        scale = 0.5 * max(float(extent[1]), float(extent[0]) / aspect, 1e-3 * size)
        return Camera(center + np.array([0.0, 0.0, 2.0 * size]), center, np.array([0.0, 1.0, 0.0]), scale)

    up = np.eye(3)[vertical]
    direction = view_direction(extent, vertical)
    right = np.cross(up, direction)
    right = right / np.linalg.norm(right)
    above = np.cross(direction, right)

    corners = np.array(list(product(*box.T))) - center
    slope = np.tan(np.radians(0.5 * VIEW_ANGLE))
    needed = np.maximum(np.abs(corners @ above) / slope, np.abs(corners @ right) / (slope * aspect))
    distance = max(float(np.max(needed + corners @ direction)), 1e-3 * size)
    return Camera(center + distance * direction, center, up, None)


def view_direction(extent: FloatArray, vertical: int) -> FloatArray:
    """Unit vector from a box towards the eye, slightly from above, with the longer horizontal side across.

    Parameters
    ----------
    extent : (3,) float64
        Sides of the box [m].
    vertical : int
        Axis that points up.
    """
    up = np.eye(3)[vertical]
    # The two horizontal axes make a right-handed frame with the vertical one.
    first, second = (np.eye(3)[(vertical + k) % 3] for k in (1, 2))
    if abs(np.dot(extent, first)) > abs(np.dot(extent, second)):
        across, towards = first, -second
    else:
        across, towards = second, first
    direction = towards + 0.55 * across + 0.45 * up
    return np.asarray(direction / np.linalg.norm(direction), dtype=np.float64)
