"""Obstacles in a picture, from what ``result.json`` says of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from femdeform.types import FloatArray


def obstacle_shapes(
    pyvista: Any, obstacles: Sequence[Mapping[str, Any]], box: FloatArray, dim: int, time: float
) -> list[Any]:
    """Meshes that show the obstacles.

    Parameters
    ----------
    pyvista : module
        PyVista.
    obstacles : sequence of mappings
        As in a scene: `kind` and, at time 0, `point` and `normal` (``plane``), `center` and `radius`
        (``sphere``), or `min` and `max` (``box``) [m]; `velocity` [m/s] for one that moves. Others are left
        out.
    box : (2, 3) float64
        Corners of the box around the bodies [m]: how far a plane is drawn.
    dim : int
        Dimension of the scene.
    time : float
        Time of the frame [s].
    """
    shapes = []
    for obstacle in obstacles:
        shift = time * _vector(obstacle.get("velocity") or [0.0])
        try:
            if obstacle.get("kind") == "plane":
                shapes.append(_plane(pyvista, obstacle, box, dim, shift))
            elif obstacle.get("kind") == "sphere":
                shapes.append(_sphere(pyvista, obstacle, dim, shift))
            elif obstacle.get("kind") == "box":
                low, high = _vector(obstacle["min"]) + shift, _vector(obstacle["max"]) + shift
                corners = np.stack([low, high], axis=1).ravel()
                shape = pyvista.Box(bounds=corners)
                shapes.append(shape if dim == 3 else pyvista.Rectangle(_rectangle(low, high)))
        except (KeyError, TypeError, ValueError):
            continue  # a picture without an obstacle is better than none
    return shapes


def solid_bounds(obstacles: Sequence[Mapping[str, Any]], size: float) -> list[FloatArray]:
    """Boxes (2, 3) of the spheres and boxes no larger than `size` [m]: those a picture should show whole."""
    bounds = []
    for obstacle in obstacles:
        try:
            if obstacle.get("kind") == "sphere":
                center, radius = _vector(obstacle["center"]), float(obstacle["radius"])
                bounds.append(np.stack([center - radius, center + radius]))
            elif obstacle.get("kind") == "box":
                bounds.append(np.stack([_vector(obstacle["min"]), _vector(obstacle["max"])]))
        except (KeyError, TypeError, ValueError):
            continue
    return [bound for bound in bounds if np.linalg.norm(bound[1] - bound[0]) <= size]


def _vector(value: Any) -> FloatArray:
    vector = np.zeros(3)
    given = np.asarray(value, dtype=np.float64).ravel()
    vector[: len(given)] = given
    return vector


def _plane(pyvista: Any, obstacle: Mapping[str, Any], box: FloatArray, dim: int, shift: FloatArray) -> Any:
    normal = _vector(obstacle["normal"])
    normal = normal / np.linalg.norm(normal)
    center = box.mean(axis=0)
    center = center - np.dot(center - _vector(obstacle["point"]) - shift, normal) * normal
    size = 1.3 * float(np.linalg.norm(box[1] - box[0]))
    if dim == 2:
        along = 0.5 * size * np.array([-normal[1], normal[0], 0.0])
        return pyvista.Line(center - along, center + along)
    return pyvista.Plane(center=center, direction=normal, i_size=size, j_size=size)


def _sphere(pyvista: Any, obstacle: Mapping[str, Any], dim: int, shift: FloatArray) -> Any:
    center, radius = _vector(obstacle["center"]) + shift, float(obstacle["radius"])
    if dim == 2:
        return pyvista.Disc(center=center, inner=0.0, outer=radius, c_res=96)
    return pyvista.Sphere(radius=radius, center=center, theta_resolution=64, phi_resolution=64)


def _rectangle(low: FloatArray, high: FloatArray) -> list[list[float]]:
    return [[low[0], low[1], 0.0], [high[0], low[1], 0.0], [high[0], high[1], 0.0]]
