"""Constraints of membranes and rods in place of an elastic law: edges, tethers, hinges, bends, an enclosed volume.

Each has the energy ``C^2 / (2 alpha)`` with the compliance alpha. Rest values are those of the reference state.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph

from femdeform.counting_sort import sort_by_number
from femdeform.errors import InputError
from femdeform.fem import thin_kernels
from femdeform.fem.discretization import ElementGroup
from femdeform.fem.energies import ElasticEnergy
from femdeform.fem.thin_kernels import BENDING, BOW, DISTANCE, FLEX_X, FLEX_Y, FLEX_Z, TETHER
from femdeform.scene.thin_schema import MembraneConstraints, RodConstraints, Tether
from femdeform.types import FloatArray, IntArray

# Angle between two edges of a rod up to which it is straight there [rad]; and up to which, at a node of more than two
# edges, one edge goes on in another.
_STRAIGHT, _ONWARD = 1e-6, 0.5


@dataclass(frozen=True)
class ThinConstraints:
    """Constraints of one body.

    Attributes
    ----------
    kinds : (n,) int64
        `thin_kernels.DISTANCE`, `TETHER`, `BENDING`, or `FLEX_X`, `FLEX_Y`, `FLEX_Z` or `BOW`.
    nodes : (n, 4) int64
        Nodes of each; two, for hinges the edge and the two corners beside it, for bends of rods a node between its
        neighbours; the rest 0.
    rests : (n,) float64
        Length [m] or angle [rad] without force.
    shares : (n,) float64
        Of bends of rods, the weight of the third node [-]; see `thin_kernels.bow`.
    stiffness : (n,) float64
        1 / compliance [N/m] or [N m/rad].
    surface : (n_triangles, 3) int64
        Triangles around the volume that is kept, their normals outward; none if there is none.
    volume, bulk : float
        Volume without force [m^3], and 1 / compliance [Pa/m^3].
    """

    kinds: IntArray
    nodes: IntArray
    rests: FloatArray
    shares: FloatArray
    stiffness: FloatArray
    surface: IntArray
    volume: float
    bulk: float


def make_constraints(
    name: str,
    options: MembraneConstraints | RodConstraints,
    points: FloatArray,
    cells: IntArray,
    measure: float,
    youngs_modulus: float,
    anchors: IntArray | None,
) -> ThinConstraints:
    """Constraints of a body.

    Parameters
    ----------
    name : str
        Of the body, for messages.
    options : MembraneConstraints or RodConstraints
        The scene's block.
    points : (n_nodes, 3) float64
        Reference positions of all nodes [m].
    cells : (n_cells, 2 or 3) int64
        Edges or triangles of the body, by rows of `points`.
    measure : float
        Thickness [m] or cross-section [m^2].
    youngs_modulus : float
        Of the material [Pa].
    anchors : (n,) int64, optional
        Nodes of `options.tether`.

    Raises
    ------
    InputError
        If a volume is to be kept by a membrane that is not closed, or a node is not connected to an anchor.

    References
    ----------
    A. Van Gelder, Approximate simulation of elastic membranes by triangulated spring meshes (1998), for edges from
    Young's modulus. M. Bergou, M. Wardetzky, S. Robinson, B. Audoly, E. Grinspun, Discrete elastic rods (2008), for the
    curvature at a node of a rod. T.-Y. Kim, N. Chentanez, M. Mueller, Long range attachments (2012), for tethers.
    """
    cells = cells.astype(np.int64)
    edges, hinges, area = _edges(points, cells)
    lengths = np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
    if options.edges is not None:
        stiffness = np.full(len(edges), 1.0 / options.edges)
    elif cells.shape[1] == 2:
        stiffness = youngs_modulus * measure / lengths
    else:
        stiffness = youngs_modulus * measure * area / lengths**2
    parts = [_Part(DISTANCE, _padded(edges), lengths, stiffness)]
    if options.tether is not None and anchors is not None:
        pairs, reach = _tethers(name, options.tether, edges, lengths, anchors, cells)
        parts.append(_Part(TETHER, _padded(pairs), reach, np.full(len(pairs), 1.0 / options.tether.compliance)))
    surface, volume, bulk = np.empty((0, 3), dtype=np.int64), 0.0, 0.0
    if isinstance(options, MembraneConstraints):
        if options.bending is not None:
            angles = hinge_angles(points, hinges)
            parts.append(_Part(BENDING, hinges, angles, np.full(len(hinges), 1.0 / options.bending)))
        if options.volume is not None:
            if 2 * len(hinges) != 3 * len(cells):
                raise InputError(f"bodies.{name}.constraints.volume: the membrane is not closed")
            inside = enclosed_volume(points, cells)
            surface = cells if inside > 0.0 else cells[:, ::-1].copy()
            volume, bulk = options.volume.ratio * abs(inside), 1.0 / options.volume.compliance
    elif options.bending_stiffness is not None:
        parts += _bends(points, cells, options.bending_stiffness)
    return ThinConstraints(
        np.concatenate([np.full(len(part.nodes), part.kind) for part in parts]),
        np.ascontiguousarray(np.concatenate([part.nodes for part in parts])),
        np.concatenate([part.rests for part in parts]),
        np.concatenate([np.zeros(len(part.nodes)) if part.shares is None else part.shares for part in parts]),
        np.concatenate([part.stiffness for part in parts]),
        surface,
        volume,
        bulk,
    )


class _Part(NamedTuple):
    """Constraints of one kind; see `ThinConstraints`."""

    kind: int
    nodes: IntArray
    rests: FloatArray
    stiffness: FloatArray
    shares: FloatArray | None = None


def _padded(pairs: IntArray) -> IntArray:
    return np.concatenate([pairs, np.zeros_like(pairs)], axis=1)


def _bends(points: FloatArray, edges: IntArray, stiffness: float) -> list[_Part]:
    """Resistance of rods to bending, with the bending stiffness B [N m^2].

    With the edges t1 and t2 over their lengths at rest, B |t2 - t1|^2 / (2 l) is the energy at a node, l being half the
    length of both; t2 - t1 is (1/L1 + 1/L2) times the way from the node to the line between its neighbours.
    """
    triples = _consecutive(points, edges)
    a, b, c = (points[triples[:, k]] for k in range(3))
    one, two = (np.linalg.norm(d, axis=1) for d in (b - a, c - b))
    shares = one / (one + two)
    bows = np.linalg.norm((1.0 - shares)[:, None] * a + shares[:, None] * c - b, axis=1)
    over = 1.0 / one + 1.0 / two
    k = stiffness * over**2 / (0.5 * (one + two))
    nodes = np.concatenate([triples, np.zeros((len(triples), 1), dtype=np.int64)], axis=1)
    straight = bows * over <= _STRAIGHT
    curved = ~straight
    none = np.zeros(np.count_nonzero(straight))
    parts = [_Part(kind, nodes[straight], none, k[straight], shares[straight]) for kind in (FLEX_X, FLEX_Y, FLEX_Z)]
    return [*parts, _Part(BOW, nodes[curved], bows[curved], k[curved], shares[curved])]


def _consecutive(points: FloatArray, edges: IntArray) -> IntArray:
    """Nodes (n, 3) of two edges that go on in one another, the common one in the middle.

    So do any two edges at a node that has no more; at other nodes two of which each is what continues the other best,
    and nearly straight.
    """
    entries, offsets = sort_by_number(edges.ravel(), len(points))
    counts = np.diff(offsets)
    own = edges.ravel()[entries]
    other = edges[entries // 2, 1 - entries % 2]
    way = points[other] - points[own]
    way /= np.linalg.norm(way, axis=1)[:, None]
    # Every ordered pair of entries of a node.
    sizes = counts[own]
    first = np.repeat(np.arange(own.size), sizes)
    begin = np.concatenate([[0], np.cumsum(sizes)])[:-1]
    second = np.repeat(offsets[own] - begin, sizes) + np.arange(first.size)
    kept = first != second
    first, second = first[kept], second[kept]
    cosine = np.einsum("na,na->n", way[first], way[second])
    order = np.lexsort((second, cosine, first))
    leading, starts = np.unique(first[order], return_index=True)
    best = np.full(own.size, -1, dtype=np.int64)
    best[leading] = second[order[starts]]
    turn = np.ones(own.size)
    turn[leading] = cosine[order[starts]]
    here = np.arange(own.size)
    mutual = (best > here) & (best[best] == here) & ((counts[own] == 2) | (turn < -np.cos(_ONWARD)))
    found = np.flatnonzero(mutual)
    return np.column_stack([other[found], own[found], other[best[found]]]).astype(np.int64)


def _edges(points: FloatArray, cells: IntArray) -> tuple[IntArray, IntArray, FloatArray]:
    """Edges (n, 2), hinges (n, 4) at edges of two triangles, and the area of the triangles at each edge [m^2]."""
    if cells.shape[1] == 2:
        return cells, np.empty((0, 4), dtype=np.int64), np.zeros(len(cells))
    corners = points[cells]
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    sides = cells[:, [[0, 1, 2], [1, 2, 0], [2, 0, 1]]].reshape(-1, 3)
    keys = np.sort(sides[:, :2], axis=1)
    edges, which, counts = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    which = which.ravel()
    area = np.bincount(which, np.repeat(areas, 3), minlength=len(edges))
    order = np.argsort(which, kind="stable")
    starts = np.concatenate([[0], np.cumsum(counts)])[:-1][counts == 2]
    first, second = order[starts], order[starts + 1]
    hinges: IntArray = np.column_stack([sides[first, :2], sides[first, 2], sides[second, 2]])
    return edges, hinges, np.asarray(area, dtype=np.float64)


def _tethers(
    name: str, options: Tether, edges: IntArray, lengths: FloatArray, anchors: IntArray, cells: IntArray
) -> tuple[IntArray, FloatArray]:
    """Pairs of a node and its nearest anchor along the edges, and the distance allowed [m]."""
    n = int(max(edges.max(), anchors.max())) + 1
    graph = scipy.sparse.coo_array((lengths, (edges[:, 0], edges[:, 1])), shape=(n, n)).tocsr()
    far, _, source = scipy.sparse.csgraph.dijkstra(
        graph, directed=False, indices=anchors, min_only=True, return_predecessors=True
    )
    nodes = np.setdiff1d(np.unique(cells), anchors)
    if not np.isfinite(far[nodes]).all():
        raise InputError(f"bodies.{name}.constraints.tether.to: not every node is connected to an anchor")
    return np.column_stack([nodes, source[nodes]]).astype(np.int64), options.slack * far[nodes]


def hinge_angles(x: FloatArray, hinges: IntArray) -> FloatArray:
    """Angle of each hinge (n, 4) [rad]; see `thin_kernels.hinge`."""
    a, b, c, d = (x[hinges[:, k]] for k in range(4))
    e = b - a
    n, m = np.cross(e, c - a), np.cross(d - a, e)
    sine = np.einsum("na,na->n", np.cross(m, n), e) / np.linalg.norm(e, axis=1)
    return np.asarray(np.arctan2(sine, np.einsum("na,na->n", n, m)))


def enclosed_volume(x: FloatArray, surface: IntArray) -> float:
    """Volume inside a closed surface of triangles with outward normals [m^3]."""
    a, b, c = (x[surface[:, k]] for k in range(3))
    return float(np.einsum("na,na->", a, np.cross(b, c))) / 6.0


def volume_gradient(x: FloatArray, surface: IntArray) -> FloatArray:
    """Derivative of the enclosed volume by all positions (n_nodes, 3) [m^2]."""
    a, b, c = (x[surface[:, k]] for k in range(3))
    out = np.zeros_like(x)
    for k, part in enumerate((np.cross(b, c), np.cross(c, a), np.cross(a, b))):
        for axis in range(3):
            out[:, axis] += np.bincount(surface[:, k], part[:, axis], minlength=len(x))
    return out / 6.0


class ThinConstraintEnergy(ElasticEnergy):
    """The constraints of a body in place of the energy of its cells.

    Parameters
    ----------
    group : ElementGroup
        All cells of the body.
    constraints : ThinConstraints

    Limitations
    -----------
    There is no Hessian: sweeps over constraints solve for them, Newton's method does not. No energy density by cell.
    """

    def __init__(self, group: ElementGroup, constraints: ThinConstraints) -> None:
        super().__init__(group)
        self.constraints = constraints
        self._zero = np.zeros(constraints.kinds.size)
        # Forces at the nodes are handed over in the first slot of each.
        self._holders, self._firsts = np.unique(group.cells.ravel(), return_index=True)

    def cell_energies(self, x: FloatArray) -> FloatArray:
        """Not known by cell: NaN (n_cells,)."""
        return np.full(self.group.n_cells, np.nan)

    def _evaluate(self, x: FloatArray) -> tuple[float, FloatArray]:
        c = self.constraints
        out = np.zeros_like(x)
        energy = float(thin_kernels.add_weighted(c.kinds, c.nodes, c.rests, c.shares, c.stiffness, self._zero, x, out))
        if c.surface.size:
            excess = enclosed_volume(x, c.surface) - c.volume
            energy += 0.5 * c.bulk * excess * excess
            out += c.bulk * excess * volume_gradient(x, c.surface)
        return energy, out

    def value(self, x: FloatArray) -> float:
        """Energy of all constraints [J]."""
        return self._evaluate(x)[0]

    def gradient(self, x: FloatArray, slots: FloatArray, first: int) -> None:
        """Write the forces of the constraints [N] to rows of `slots` from `first` on; see `CellTerm`."""
        _, forces = self._evaluate(x)
        slots[first : first + self.cells.size] = 0.0
        slots[first + self._firsts] = forces[self._holders]

    def hessian(self, x: FloatArray, project: bool, blocks: FloatArray, first: int) -> None:
        """There is none.

        Raises
        ------
        InputError
        """
        raise InputError(f"bodies.{self.group.body}.constraints: are for the methods xpbd and pbd")
