"""By how much the sampled surface of bodies is larger than that of their shapes, at the start."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.special import ellipe

from femdeform.mpm.level_set import union_of_spheres
from femdeform.mpm.particles import Particles
from femdeform.run.closed_surface import closed_surface
from femdeform.scene.point_schema import PointScene
from femdeform.types import FloatArray, Mesh

# Bodies whose contours together differ by more than this part from those of each alone touch one another.
_APART = 1e-6
# Nodes of the quadrature over half of an ellipsoid's axis.
_QUADRATURE = 200


def area_scales(scene: PointScene, meshes: Mapping[str, Mesh], points: Particles) -> FloatArray:
    """Factors (n_bodies,) of the sampled areas with which the heat of each body goes through its surface.

    What the scene gives; otherwise the area of the body's shape over that of the contour around its points at the
    start. Where that is not known, as a part is cut out of the body or it touches another one, the factor is one.

    Parameters
    ----------
    scene : PointScene
        A scene.
    meshes : mapping of str to Mesh
        Of its bodies.
    points : Particles
        All bodies at the start.
    """
    n = len(scene.bodies)
    if scene.heat.area_scale is not None:
        return np.full(n, scene.heat.area_scale)
    contours = np.array([_contour(scene, points.x[points.body == number]) for number in range(n)])
    if abs(_contour(scene, points.x) - contours.sum()) > _APART * contours.sum():
        return np.ones(n)
    hulls = [
        contour if body.without else _hull(body.shape, meshes.get(name))
        for (name, body), contour in zip(scene.bodies.items(), contours, strict=True)
    ]
    return np.asarray(np.array(hulls) / contours)


def _contour(scene: PointScene, x: FloatArray) -> float:
    level_sets = union_of_spheres(x, scene.grid.cell_size, scene.surface.radius)
    return float(sum(each.facets().measure.sum() for each in level_sets))


def _hull(shape: Any, mesh: Mesh | None) -> float:
    """Area of a shape's surface [m^2]; in 2D its length [m]."""
    if shape.kind == "box":
        sides = np.array(shape.max) - np.array(shape.min)
        return float(2.0 * sum(np.prod(np.delete(sides, axis)) for axis in range(sides.size)))
    if shape.kind == "sphere":
        return float((2.0 if len(shape.center) == 2 else 4.0 * shape.radius) * np.pi * shape.radius)
    if shape.kind == "ellipsoid":
        return _ellipsoid(np.sort(np.array(shape.semi_axes))[::-1])
    assert mesh is not None
    points, facets = closed_surface(mesh)
    corners = points[facets]
    edges = corners[:, 1:] - corners[:, :1]
    if edges.shape[2] == 2:
        return float(np.linalg.norm(edges[:, 0], axis=1).sum())
    return float(0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1).sum())


def _ellipsoid(axes: FloatArray) -> float:
    """Length of an ellipse, or area of an ellipsoid, with semi-axes in descending order."""
    if axes.size == 2:
        return float(4.0 * axes[0] * ellipe(1.0 - (axes[1] / axes[0]) ** 2))
    # Over z = cos(theta) and the angle phi of the sphere that becomes it by stretching: smooth, and periodic in phi.
    a, b, c = axes
    z, weights = np.polynomial.legendre.leggauss(_QUADRATURE)
    phi = 2.0 * np.pi * np.arange(_QUADRATURE) / _QUADRATURE
    ring = 1.0 - z[:, None] ** 2
    normal = np.sqrt(ring * ((b * c * np.cos(phi)) ** 2 + (a * c * np.sin(phi)) ** 2) + (a * b * z[:, None]) ** 2)
    return float(2.0 * np.pi * (weights @ normal.mean(axis=1)))
