"""What enters bodies of a scene of material points, through their surfaces and in their volumes, and where."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from femdeform.mpm.heat import Field, HeatBoundary
from femdeform.mpm.particles import Particles
from femdeform.mpm.surface_samples import SurfaceSamples
from femdeform.scene import point_body_schema as schema
from femdeform.scene.point_schema import PointScene
from femdeform.types import BoolArray, FloatArray

# Points along a wick to a cell, and how far a point of a body may be from a wick inside of it, in cells: half a
# diagonal of a cell in 3D.
_FINENESS, _REACH = 8, 0.87


def heat_boundary(
    scene: PointScene, points: Particles, samples: SurfaceSamples, covered: BoolArray | None = None
) -> HeatBoundary:
    """What enters through samples of the surface.

    Parameters
    ----------
    scene : PointScene
        Of which all bodies conduct heat.
    points : Particles
        Material points as they are.
    samples : SurfaceSamples
        Of their surface.
    covered : (n_samples,) bool, optional
        Samples on walls: no air and no flame is there.
    """
    heats = _heats(scene)
    of_sample = points.body[samples.owner]
    transfer = np.array([heat.transfer for heat in heats])[of_sample]
    ambient = np.array([heat.ambient for heat in heats])[of_sample]
    bare = np.ones(samples.n, dtype=bool) if covered is None else ~covered
    transfer = np.where(bare, transfer, 0.0)

    def flux(positions: FloatArray, time: float) -> FloatArray:
        values = np.zeros(len(positions))
        for number, heat in enumerate(heats):
            if heat.flux != 0.0 and _acts(time, heat.flux_start, heat.flux_end):
                mine = bare & (of_sample == number)
                values[mine & _is_heated(heat.flux_within, positions, time, points.x, scene.grid.cell_size)] = heat.flux
        return values

    return HeatBoundary(transfer, ambient, flux)


def heat_source(scene: PointScene, points: Particles) -> Field:
    """Heating of the volume at material points [W/m^3]; see `HeatConduction.step`.

    Parameters
    ----------
    scene : PointScene
        Of which all bodies conduct heat.
    points : Particles
        Material points as they are.
    """
    heats = _heats(scene)

    def source(positions: FloatArray, time: float) -> FloatArray:
        values = np.zeros(len(positions))
        for number, heat in enumerate(heats):
            if heat.source != 0.0 and _acts(time, heat.source_start, heat.source_end):
                mine = points.body == number
                here = mine & _is_heated(heat.source_within, positions, time, points.x, scene.grid.cell_size)
                values[here] = heat.source
        return values

    return source


def _heats(scene: PointScene) -> list[schema.HeatBlock]:
    blocks = [body.heat for body in scene.bodies.values()]
    assert all(block is not None for block in blocks)
    return [block for block in blocks if block is not None]


def _acts(time: float, start: float, end: float | None) -> bool:
    """Whether a heating acts in the step that ends at a time."""
    return time > start and (end is None or time <= end)


def _is_heated(
    place: schema.HeatedPlace | None, positions: FloatArray, time: float, bodies: FloatArray, spacing: float
) -> BoolArray:
    if place is None:
        return np.ones(len(positions), dtype=bool)
    if isinstance(place, schema.MovingArc):
        offset = positions[:, :2] - np.array(place.center)[:2]
        turn = np.arctan2(offset[:, 1], offset[:, 0]) - place.start - place.rate * time
        return np.asarray(np.abs(np.angle(np.exp(1j * turn))) <= place.half_angle)
    if isinstance(place, schema.HeatedBox | schema.HeatedBall):
        resting = positions if place.velocity is None else positions - time * np.array(place.velocity)
        if isinstance(place, schema.HeatedBox):
            return np.asarray(((resting >= place.min) & (resting <= place.max)).all(axis=1))
        return np.asarray(((resting - place.center) ** 2).sum(axis=1) <= place.radius**2)
    flame = wick_end(place, bodies, spacing)
    if flame is None:
        return np.zeros(len(positions), dtype=bool)
    return np.asarray(((positions - flame) ** 2).sum(axis=1) <= place.radius**2)


def wick_end(wick: schema.Wick, bodies: FloatArray, spacing: float) -> FloatArray | None:
    """Where a wick comes out of bodies: the last place along its spline that has a material point close to it.

    Parameters
    ----------
    wick : Wick
        With the points of its spline.
    bodies : (n, dim) float64
        Positions of material points [m].
    spacing : float
        Distance of grid nodes [m].

    Returns
    -------
    (dim,) float64, optional
        [m]; None where the wick has left the bodies and there is nothing to burn.
    """
    knots = np.array(wick.path)
    lengths = np.linalg.norm(np.diff(knots, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    count = max(2, int(np.ceil(_FINENESS * along[-1] / spacing)))
    places = CubicSpline(along, knots)(np.linspace(0.0, along[-1], count + 1))
    covered = np.flatnonzero(cKDTree(bodies).query(places, distance_upper_bound=_REACH * spacing)[0] < np.inf)
    return None if covered.size == 0 else np.asarray(places[covered[-1]])
