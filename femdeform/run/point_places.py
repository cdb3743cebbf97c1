"""Whether bodies of material points start where there is room: outside of walls, and apart from one another."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from femdeform.errors import InputError
from femdeform.mpm.surface_coefficient import wall_distance
from femdeform.run.point_setup import inside_body, make_points, make_walls
from femdeform.scene.point_schema import PointScene
from femdeform.scene.validation import PlaceFinding
from femdeform.types import FloatArray, Mesh

# Of the cell size: what rounding may put below a wall that a body lies on.
_ROUNDING = 1e-9
# Of the distance of a body's points: another body's points that are closer share their room.
_CLOSE = 0.25


def place_findings(scene: PointScene, meshes: Mapping[str, Mesh]) -> list[PlaceFinding]:
    """Bodies that start inside of walls or outside of containers, and such that share their room.

    Parameters
    ----------
    scene : PointScene
        With nothing else wrong.
    meshes : mapping of str to Mesh
        Of all bodies and walls.

    Returns
    -------
    list of PlaceFinding
        Notices, except for bodies without a point outside of walls. Nothing if points cannot be made, which a run says.
    """
    try:
        points = make_points(scene, meshes)
        walls = make_walls(scene, meshes)
    except InputError:
        return []
    x = [points.x[points.body == number] for number in range(len(scene.bodies))]
    found = []
    for name, mine in zip(scene.bodies, x, strict=True):
        hidden = int(np.count_nonzero(wall_distance(walls, mine, 0.0) < -_ROUNDING * scene.grid.cell_size))
        if hidden:
            how_many = "all" if hidden == len(mine) else f"{hidden} of {len(mine)}"
            message = f"{how_many} points of the body start inside of a wall, or outside of a container"
            found.append(PlaceFinding(("bodies", name, "shape"), message, hidden < len(mine)))
    return [*found, *_shared(scene, meshes, x)]


def _shared(scene: PointScene, meshes: Mapping[str, Mesh], x: list[FloatArray]) -> Iterator[PlaceFinding]:
    """Pairs of bodies with points of one inside the other's shape, or next to its points."""
    bodies = list(scene.bodies.items())
    for i, j in combinations(range(len(bodies)), 2):
        count = 0
        for (name, body), mine, theirs in ((bodies[i], x[i], x[j]), (bodies[j], x[j], x[i])):
            spacing = scene.grid.cell_size / body.points_per_axis
            near = ((theirs >= mine.min(axis=0) - spacing) & (theirs <= mine.max(axis=0) + spacing)).all(axis=1)
            if not near.any():
                continue
            candidates = theirs[near]
            inside = inside_body(body, name, meshes, candidates)
            inside |= cKDTree(mine).query(candidates)[0] < _CLOSE * spacing
            count += int(np.count_nonzero(inside))
        if count:
            message = f"{count} points of it and of `{bodies[i][0]}` start inside of the other body, or on its points"
            yield PlaceFinding(("bodies", bodies[j][0], "shape"), message, True)
