"""Planes, spheres and boxes as rigid obstacles: signed distance, its gradient and its curvature."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from femdeform.scene import schema
from femdeform.types import FloatArray


class Shape(Protocol):
    """A rigid shape; positive distances are free space."""

    concave: bool  # whether the distance is concave along lines (a bowl) rather than convex

    def distance(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Signed distance (n,) [m] of positions (n, dim) and its unit gradient (n, dim)."""

    def curvature(self, x: FloatArray) -> FloatArray:
        """Second derivative of the distance, (n, dim, dim) [1/m]; semi-definite, as every shape is convex."""


class Plane:
    """Half space; free on the side of the normal."""

    concave = False

    def __init__(self, point: FloatArray, normal: FloatArray) -> None:
        self.point = point
        self.normal = normal / np.linalg.norm(normal)

    def distance(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Signed distance and normal."""
        return np.asarray((x - self.point) @ self.normal), np.broadcast_to(self.normal, x.shape)

    def curvature(self, x: FloatArray) -> FloatArray:
        """Zero: the plane is flat."""
        return np.zeros((*x.shape, x.shape[1]))


class Sphere:
    """Ball (a circle in 2D); free outside, or inside for a bowl."""

    def __init__(self, center: FloatArray, radius: float, inside: bool) -> None:
        self.center = center
        self.radius = radius
        self.sign = -1.0 if inside else 1.0
        self.concave = inside

    def distance(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Signed distance and normal; at the very centre the normal is the last axis."""
        offset = x - self.center
        r = np.linalg.norm(offset, axis=1)
        normal = np.zeros_like(offset)
        normal[:, -1] = 1.0
        np.divide(offset, r[:, None], out=normal, where=r[:, None] > 0.0)
        return self.sign * (r - self.radius), self.sign * normal

    def curvature(self, x: FloatArray) -> FloatArray:
        """(I - n n^T) over the distance from the centre, with the sign of the free side."""
        _, normal = self.distance(x)
        r = np.maximum(np.linalg.norm(x - self.center, axis=1), 1e-12 * self.radius)
        across = np.eye(x.shape[1]) - normal[:, :, None] * normal[:, None, :]
        return np.asarray(self.sign * across / r[:, None, None])


class Box:
    """Axis-parallel box; free outside, or inside for a container."""

    def __init__(self, lowest: FloatArray, highest: FloatArray, inside: bool) -> None:
        self.center = 0.5 * (lowest + highest)
        self.half = 0.5 * (highest - lowest)
        self.sign = -1.0 if inside else 1.0
        self.concave = inside

    def distance(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Signed distance and normal of the nearest face, edge or corner."""
        offset = x - self.center
        side = np.where(offset < 0.0, -1.0, 1.0)
        excess = np.abs(offset) - self.half
        outside = np.maximum(excess, 0.0)
        length = np.linalg.norm(outside, axis=1)
        face = np.argmax(excess, axis=1)
        normal = np.zeros_like(x)
        rows = np.arange(len(x))
        normal[rows, face] = side[rows, face]
        is_outside = length > 0.0
        normal[is_outside] = (side * outside)[is_outside] / length[is_outside, None]
        distance = np.where(is_outside, length, excess[rows, face])
        return self.sign * distance, self.sign * normal

    def curvature(self, x: FloatArray) -> FloatArray:
        """Zero at faces; beyond an edge or corner, where the distance is that of a line or point, it is round."""
        distance, normal = self.distance(x)
        beyond = (np.abs(x - self.center) > self.half)[:, :, None] * np.eye(x.shape[1])
        bend = beyond - normal[:, :, None] * normal[:, None, :]
        length = self.sign * distance
        is_outside = length > 0.0
        bend[is_outside] *= self.sign / length[is_outside, None, None]
        bend[~is_outside] = 0.0
        return np.asarray(bend)


def make_shape(obstacle: schema.Obstacle) -> Shape:
    """Shape of an obstacle of a scene, at its initial place."""
    if isinstance(obstacle, schema.PlaneObstacle):
        return Plane(np.array(obstacle.point), np.array(obstacle.normal))
    if isinstance(obstacle, schema.SphereObstacle):
        return Sphere(np.array(obstacle.center), obstacle.radius, obstacle.inside)
    return Box(np.array(obstacle.min), np.array(obstacle.max), obstacle.inside)


def smooth_parts(obstacle: schema.Obstacle) -> list[Shape]:
    """Shapes with smooth distances whose free spaces together are that of an obstacle: a container is its walls."""
    if not isinstance(obstacle, schema.BoxObstacle) or not obstacle.inside:
        return [make_shape(obstacle)]
    inward = np.eye(len(obstacle.min))
    lower = [Plane(np.array(obstacle.min), normal) for normal in inward]
    return [*lower, *(Plane(np.array(obstacle.max), -normal) for normal in inward)]
