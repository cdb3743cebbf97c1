"""Ellipsoids and closed surfaces by their signed distance, beside the shapes of `contact.obstacles`."""

from __future__ import annotations

import numpy as np

from femdeform.contact.closest import closest_points
from femdeform.contact.inside import InsideTest
from femdeform.types import BoolArray, FloatArray, IntArray

# Steps for the parameter of the closest point, of which it takes a few, and how little it then changes by: rounding.
_STEPS, _NEAR = 100, 1e-15
# Coordinates smaller than this part of their semi-axis are taken as this: at zero the closest point is not unique.
_OFF_AXIS = 1e-13
# Closer than this part of its size, the normal at a surface is that of its facet.
_ON_SURFACE = 1e-12


class Ellipsoid:
    """An ellipsoid (an ellipse in 2D) with axes along the coordinates; free outside, or inside for a bowl.

    Parameters
    ----------
    center, semi_axes : (dim,) float64
        [m].
    inside : bool

    References
    ----------
    D. Eberly, Distance from a point to an ellipse, an ellipsoid, or a hyperellipsoid (2013).
    """

    def __init__(self, center: FloatArray, semi_axes: FloatArray, inside: bool = False) -> None:
        self.center, self.semi_axes = np.array(center, dtype=float), np.array(semi_axes, dtype=float)
        if not np.all(self.semi_axes > 0.0):
            raise ValueError("the semi-axes of an ellipsoid have to be positive")
        self.sign = -1.0 if inside else 1.0

    def distance(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Signed distance and normal.

        The closest point is ``a_c^2 y_c / (t + a_c^2)`` with the root t of ``sum (a_c y_c / (t + a_c^2))^2 = 1``. It is
        found as ``s = t + min a^2 > 0``, in which nothing cancels.
        """
        a = self.semi_axes
        offset = x - self.center
        side = np.where(offset < 0.0, -1.0, 1.0)
        y = np.maximum(np.abs(offset), _OFF_AXIS * a)
        least = int(np.argmin(a))
        more = (a - a[least]) * (a + a[least])
        s = _root(a * y, more)
        closest = a * a * y / (s[:, None] + more)
        normal = closest / (a * a)
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        distance = np.einsum("pc,pc->p", y - closest, normal)
        return self.sign * distance, self.sign * side * normal

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest coordinates [m]."""
        return self.center - self.semi_axes, self.center + self.semi_axes


def _root(b: FloatArray, more: FloatArray) -> FloatArray:
    """Roots s > 0 (n,) of ``sum_c (b_c / (s + more_c))^2 = 1``; b (n, dim) > 0, the least of ``more`` (dim,) is zero.

    Newton's method on ``1/|b/(s + more)| = 1``, whose left side is all but a straight line, kept between bounds: where
    a step leaves them, their middle is taken. Each root is found by itself, whatever the others.
    """
    low: FloatArray = (b - more).max(axis=1)
    high, s = np.linalg.norm(b, axis=1), low.copy()
    left = np.arange(len(b))
    for _ in range(_STEPS):
        now, mine = s[left], b[left]
        terms = (mine / (now[:, None] + more)) ** 2
        length2 = terms.sum(axis=1)
        length = np.sqrt(length2)
        low[left] = np.where(length >= 1.0, now, low[left])
        high[left] = np.where(length <= 1.0, now, high[left])
        new = now + length2 * (length - 1.0) / (terms / (now[:, None] + more)).sum(axis=1)
        new = np.where((new >= low[left]) & (new <= high[left]), new, 0.5 * (low[left] + high[left]))
        s[left] = new
        left = left[np.abs(new - now) > _NEAR * new]
        if not left.size:
            break
    return s


class ClosedSurface:
    """A closed surface of triangles (3D) or segments (2D); free outside, or inside for a container.

    Parameters
    ----------
    points : (n, dim) float64
        [m].
    facets : (m, dim) int64
        In any orientation.
    inside : bool
    """

    def __init__(self, points: FloatArray, facets: IntArray, inside: bool = False) -> None:
        self._corners = np.asarray(points, dtype=float)[facets]
        self._test = InsideTest(points, facets)
        self._size = float(np.ptp(points, axis=0).max())
        self.sign = -1.0 if inside else 1.0

    def contains(self, x: FloatArray) -> BoolArray:
        """Whether positions (n, dim) are inside of the surface."""
        return self._test.contains(x)

    def distance(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Signed distance and normal; at an edge or corner the direction to the closest point."""
        facet, weights, length = closest_points(x, self._corners)
        closest = np.einsum("pk,pkc->pc", weights, self._corners[facet])
        outward = np.where(self.contains(x), -1.0, 1.0)
        normal = outward[:, None] * (x - closest) / np.where(length > 0.0, length, 1.0)[:, None]
        on = np.flatnonzero(length <= _ON_SURFACE * self._size)
        if on.size:
            normal[on] = self._facet_normals(facet[on])
        return self.sign * outward * length, self.sign * normal

    def _facet_normals(self, facet: IntArray) -> FloatArray:
        """Outward normals of some facets: the side is that of a point off the middle."""
        corners = self._corners[facet]
        if corners.shape[2] == 2:
            edge = corners[:, 1] - corners[:, 0]
            normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
        else:
            normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal /= np.linalg.norm(normal, axis=1)[:, None]
        middle = corners.mean(axis=1)
        return np.where(self.contains(middle + 1e-9 * self._size * normal)[:, None], -normal, normal)

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lowest and highest coordinates [m]."""
        return self._corners.min(axis=(0, 1)), self._corners.max(axis=(0, 1))
