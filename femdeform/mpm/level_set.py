"""The surface of material points: union of spheres as a level set on the grid, and its zero contour.

References
----------
D. Hyde, S. Gagniere, A. Marquez-Razon, J. Teran, An implicit updated Lagrangian formulation for liquids with large
surface energy (2020), section 5.1.
E. Chernyaev, Marching cubes 33 (1995); T. Lewiner, H. Lopes, A. W. Vieira, G. Tavares, Efficient implementation of
marching cubes' cases with topological guarantees (2003), as in scikit-image.

Limitations
-----------
The contour lies outside the hull of the points by a radius less half the gap between points, 0.56 (2D) or 0.7 (3D)
cells with three points a cell and axis: areas are too large by that offset times the curvature.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from femdeform.counting_sort import sort_by_number
from femdeform.mpm import level_set_kernels as kernels
from femdeform.types import FloatArray, IntArray

# Radii of the spheres over the spacing, by dimension: above sqrt(dim)/2, so that a point alone has a surface.
RADII = {2: 0.73, 3: 0.867}
# Facets smaller than this part of a cell's side have no direction.
_SMALLEST = 1e-12
# Cells an axis of the blocks by which points are told to be apart.
_BLOCK = 8
# Up to this many nodes all points share one box, which is quicker than a box for each set of them.
_SMALL_BOX = 2_000_000


@dataclass(frozen=True)
class Facets:
    """Segments (2D) or triangles (3D) of a closed surface.

    Attributes
    ----------
    corners : (n, dim, dim) float64
        Positions of the corners [m].
    normals : (n, dim) float64
        Unit normals, outward.
    measure : (n,) float64
        Lengths [m] or areas [m^2], all positive.
    """

    corners: FloatArray
    normals: FloatArray
    measure: FloatArray

    @property
    def n(self) -> int:
        """Number of facets."""
        return int(self.measure.size)

    @property
    def volume(self) -> float:
        """Content of the closed surface [m^3], in 2D [m^2], by the divergence theorem."""
        # From a corner nearby, as the origin may be far away.
        middle = (self.corners - self.corners[:1, :1]).mean(axis=1)
        return float(np.einsum("fa,fa,f->", middle, self.normals, self.measure) / middle.shape[1])


class LevelSet:
    """phi(x_i) = min_p |x_i - x_p| - radius at the nodes of a box of the grid, one layer of it outside.

    Parameters
    ----------
    points : (n, dim) float64
        Positions [m].
    members : (n_members,) int64
        The points that count here.
    spacing : float
        Distance of the nodes [m]; node i lies at ``i spacing``.
    radius : float
        Radius of the spheres over the spacing.

    Attributes
    ----------
    low : (dim,) int64
        First node of the box.
    values : (nodes of each axis) float64 (2D) or float32 (3D)
        phi over the spacing. Exact up to two cells from the closest point, a positive number farther out.

    Notes
    -----
    Memory: 8 bytes a node of the box in 3D, 12 in 2D, and 36 bytes a point.
    """

    def __init__(self, points: FloatArray, members: IntArray, spacing: float, radius: float) -> None:
        self.dim = points.shape[1]
        self.spacing, self.radius = spacing, radius
        self._members = members
        places = points[members] / spacing
        cells = np.floor(places).astype(np.int64)
        # Nodes from one below the cell of a point to one above: the outermost are farther than a radius from all.
        self.low = cells.min(axis=0) - 1
        extent = cells.max(axis=0) + 2 - self.low
        self._shape = (1,) * (3 - self.dim) + tuple(int(n) for n in extent)
        self._places = self._wide(places - self.low)
        numbers = np.ravel_multi_index(tuple((cells - self.low).T), tuple(extent))
        self._order, self._starts = sort_by_number(numbers, int(np.prod(extent)))
        nodes = (1,) * (3 - self.dim) + tuple(int(n) + 1 for n in extent)
        levels = np.empty(nodes, dtype=np.float64 if self.dim == 2 else np.float32)
        kernels.node_levels(self._places, self._order, self._starts, self._shape, radius, levels)
        self.values: np.ndarray[Any, np.dtype[np.floating]] = levels[0] if self.dim == 2 else levels

    def _wide(self, places: FloatArray) -> FloatArray:
        """Positions in cells with three components."""
        out = np.zeros((len(places), 3))
        out[:, 3 - self.dim :] = places
        return out

    def facets(self) -> Facets:
        """The zero contour, closed, without facets of no size."""
        corners = marching_squares(self.values) if self.dim == 2 else _marching_cubes(self.values)
        edges = corners[:, 1:] - corners[:, :1]
        if self.dim == 2:
            areas = np.stack([edges[:, 0, 1], -edges[:, 0, 0]], axis=1)
        else:
            areas = 0.5 * np.cross(edges[:, 0], edges[:, 1])
        measure = np.linalg.norm(areas, axis=1)
        kept = measure > _SMALLEST
        normals = areas[kept] / measure[kept, None]
        places = (corners[kept] + self.low) * self.spacing
        return Facets(places, normals, measure[kept] * self.spacing ** (self.dim - 1))

    def closest(self, samples: FloatArray) -> IntArray:
        """Number of the point closest to each position (n, dim) [m], the lowest of those equally far.

        Raises
        ------
        ValueError
            If a position lies farther than two cells from all points.
        """
        out = np.empty(len(samples), dtype=np.int64)
        places = self._wide(samples / self.spacing - self.low)
        kernels.closest_points(places, self._places, self._order, self._starts, self._shape, out)
        if np.any(out < 0):
            raise ValueError("a position is not near any point of the level set")
        return np.asarray(self._members[out])


def union_of_spheres(points: FloatArray, spacing: float, radius: float | None = None) -> list[LevelSet]:
    """Level sets of the points: one, or one for each set of points that lies apart if a common box is much larger.

    Parameters
    ----------
    points : (n, dim) float64
        Positions [m].
    spacing : float
        Distance of the grid's nodes [m].
    radius : float, optional
        Radius of the spheres over the spacing; default `RADII`.

    Raises
    ------
    ValueError
        If there are no points, one is not finite, or the radius is not in (sqrt(dim)/2, 1).
    """
    n, dim = points.shape
    radius = RADII[dim] if radius is None else radius
    if n == 0:
        raise ValueError("there are no points, so there is no surface")
    if not np.isfinite(points).all():
        raise ValueError("a position is not finite")
    if not np.sqrt(dim) / 2.0 < radius < 1.0:
        raise ValueError(f"a radius of {radius} cells is not between {np.sqrt(dim) / 2.0:.3f} and 1")
    everyone = np.arange(n)
    if _box_size(points, spacing) <= _SMALL_BOX:
        return [LevelSet(points, everyone, spacing, radius)]
    parts = _apart(points, spacing)
    if _box_size(points, spacing) <= 2.0 * sum(_box_size(points[part], spacing) for part in parts):
        return [LevelSet(points, everyone, spacing, radius)]
    return [LevelSet(points, part, spacing, radius) for part in parts]


def visible_volume(points: FloatArray, volume: FloatArray, spacing: float, radius: float | None = None) -> float:
    """What points fill as their contour shows it, whatever they say of their own volumes [m^3], in 2D [m^2].

    The content V of the contour, of area A, less a layer as thick as its distance d from where the liquid ends, the
    radius of the spheres less half the distance of points at rest, ``volume^(1/dim)``: ``V - A d + pi d^2`` in 2D,
    ``V - A d + sqrt(4 pi A) d^2 - 4/3 pi d^3`` in 3D (Steiner). Points that come closer together than at rest make it
    smaller than the sum of their volumes.

    Parameters
    ----------
    points : (n, dim) float64
        Positions [m].
    volume : (n,) float64
        Volumes at rest [m^3].
    spacing, radius
        See `union_of_spheres`.

    Limitations
    -----------
    The last terms are those of one body, convex in 2D and a ball in 3D; others, and several of them, show a little
    less than they have. The contour has ripples that are not counted, 3 to 10 percent of the volume of a small drop. To
    be compared with its value at the start.
    """
    dim = points.shape[1]
    content = area = 0.0
    for level_set in union_of_spheres(points, spacing, radius):
        facets = level_set.facets()
        content += facets.volume
        area += float(facets.measure.sum())
    outside = spacing * (RADII[dim] if radius is None else radius) - 0.5 * float(np.mean(volume ** (1.0 / dim)))
    if dim == 2:
        return content - outside * area + np.pi * outside**2
    return content - outside * area + float(np.sqrt(4.0 * np.pi * area)) * outside**2 - 4.0 / 3.0 * np.pi * outside**3


def _box_size(points: FloatArray, spacing: float) -> float:
    """Number of nodes of the box around points."""
    return float(np.prod((points.max(axis=0) - points.min(axis=0)) / spacing + 4.0))


def _apart(points: FloatArray, spacing: float) -> list[IntArray]:
    """Sets of points with at least one empty block of cells between them, in the order of their first points."""
    import scipy.sparse
    import scipy.sparse.csgraph

    dim = points.shape[1]
    blocks = np.floor(points / (_BLOCK * spacing))
    # With a margin, so that a neighbour's number is not that of a block of another row.
    lowest = blocks.min(axis=0) - 1
    extent = blocks.max(axis=0) + 2 - lowest
    if float(np.prod(extent)) > 2.0**53:
        raise ValueError("the points lie too far apart for the cell size")
    strides = np.append(np.cumprod(extent[::-1])[-2::-1], 1.0)
    numbers, of_point = np.unique((blocks - lowest) @ strides, return_inverse=True)
    n = numbers.size
    rows, columns = [], []
    for shift in np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * dim, indexing="ij"), axis=-1).reshape(-1, dim):
        wanted = numbers + shift @ strides
        place = np.minimum(np.searchsorted(numbers, wanted), n - 1)
        found = np.flatnonzero(numbers[place] == wanted)
        rows.append(found)
        columns.append(place[found])
    row, column = np.concatenate(rows), np.concatenate(columns)
    graph = scipy.sparse.csr_matrix((np.ones(row.size), (row, column)), shape=(n, n))
    n_parts, of_block = scipy.sparse.csgraph.connected_components(graph, directed=False)
    entries, offsets = sort_by_number(of_block[of_point.ravel()], n_parts)
    parts = [entries[offsets[i] : offsets[i + 1]].astype(np.int64) for i in range(n_parts)]
    return sorted(parts, key=lambda part: int(part[0]))


# Corners of a square, counter-clockwise, and its sides: side s joins corner s and the next one.
_CORNERS = ((0, 0), (1, 0), (1, 1), (0, 1))


def _segments() -> np.ndarray[Any, np.dtype[np.int64]]:
    """Sides that the segments of a square join, by the corners inside it: (18, 2, 2), -1 for none.

    A segment has the inside on its left. Cases 16 and 17 are the saddles 5 and 10 with the middle of the square inside.
    """
    table = np.full((18, 2, 2), -1, dtype=np.int64)
    for case in range(1, 15):
        inside = [bool(case >> c & 1) for c in range(4)]
        # Along the boundary, counter-clockwise: sides where the inside is entered and left.
        enters = [s for s in range(4) if not inside[s] and inside[(s + 1) % 4]]
        leaves = [s for s in range(4) if inside[s] and not inside[(s + 1) % 4]]
        for k, side in enumerate(leaves):
            # From where it is left, the contour goes to where this piece of it was entered.
            before = max((s for s in enters), key=lambda s: (s - side - 1) % 4)
            table[case, k] = (side, before)
            if len(leaves) == 2:
                after = min((s for s in enters), key=lambda s: (s - side - 1) % 4)
                table[16 if case == 5 else 17, k] = (side, after)
    return table


_TABLE = _segments()


def marching_squares(values: np.ndarray[Any, Any]) -> FloatArray:
    """Zero contour of values at the nodes of a 2D grid of spacing 1 as segments (n, 2, 2), negative on their left.

    Crossings are interpolated linearly on the sides of squares; both squares at a side compute the same bits, so the
    contour is closed. A saddle joins the corners that have the sign of the mean of all four.
    """
    f = np.asarray(values, dtype=np.float64)
    inside = f < 0.0
    corners = [inside[a : a + f.shape[0] - 1, b : b + f.shape[1] - 1] for a, b in _CORNERS]
    case = np.stack(corners, axis=-1).astype(np.int64) @ np.array([1, 2, 4, 8])
    i, j = np.nonzero((case > 0) & (case < 15))
    case = case[i, j]
    four = np.stack([f[i + a, j + b] for a, b in _CORNERS])
    middle = four.sum(axis=0) < 0.0
    case = np.where((case == 5) & middle, 16, np.where((case == 10) & middle, 17, case))
    sides = _TABLE[case]
    square, which = np.nonzero(sides[:, :, 0] >= 0)
    out = np.empty((square.size, 2, 2))
    for end in range(2):
        side = sides[square, which, end]
        # From the lower to the higher node of the grid, whichever square looks.
        first = np.where(side < 2, side, (side + 1) % 4)
        second = np.where(side < 2, side + 1, side)
        a, b = four[first, square], four[second, square]
        t = a / (a - b)
        offsets = np.array(_CORNERS, dtype=np.float64)
        out[:, end] = (
            np.stack([i, j], axis=1)[square] + offsets[first] + t[:, None] * (offsets[second] - offsets[first])
        )
    return out


def _marching_cubes(values: np.ndarray[Any, Any]) -> FloatArray:
    """Zero contour of values at the nodes of a 3D grid of spacing 1 as triangles (n, 3, 3), facing larger values."""
    from skimage.measure import marching_cubes

    # Its words are of the left hand: "descent" makes cross products point to where values are larger.
    points, faces, _, _ = marching_cubes(values, level=0.0, gradient_direction="descent")
    return np.asarray(np.asarray(points, dtype=np.float64)[faces])
