"""Structured recipes in plain numpy: block, muscle, cloth, panel, flag, ring, rod, net of rods, sphere surface."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from femdeform.scene.mesh_schema import (
    BlockMesh,
    ClothMesh,
    CookMesh,
    Diagonals,
    FlagMesh,
    MuscleMesh,
    RingMesh,
    RodMesh,
    RodNetMesh,
    SphereSurfaceMesh,
)
from femdeform.types import CellType, FloatArray, IntArray, Mesh
from meshes.boundary import all_facets, unique_edges

# Names of the two ends along x, y and z.
SIDES: tuple[tuple[str, str], ...] = (("left", "right"), ("bottom", "top"), ("back", "front"))

# Corner c of a cell lies at (c & 1, c >> 1 & 1, c >> 2) in its unit cube.
_FIVE = np.array([[0, 3, 6, 5], [1, 3, 0, 5], [2, 0, 3, 6], [4, 6, 5, 0], [7, 5, 6, 3]], dtype=np.int64)
# The mirror image in x: corner c becomes c ^ 1, and two nodes are swapped to keep volumes positive.
_FIVE_MIRRORED = (_FIVE ^ 1)[:, [0, 1, 3, 2]]
# Six paths along the axes from corner 0 to corner 7 (Kuhn's split); odd permutations have two nodes swapped.
_SIX = np.array([[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]], dtype=np.int64)
# How far the recipe `muscle` rounds a square cross-section off: 0.5 would be a disc.
_ROUNDNESS = 0.4
_RIGHT = np.array([[0, 1, 3], [0, 3, 2]], dtype=np.int64)
_LEFT = np.array([[0, 1, 2], [1, 3, 2]], dtype=np.int64)


def _grid(counts: Sequence[int]) -> tuple[IntArray, IntArray, IntArray]:
    """Grid index of nodes (n_nodes, d), corners (n_cells, 2^d) and parity of cells; x runs fastest."""
    d = len(counts)
    shape = [n + 1 for n in counts]
    strides = np.cumprod([1, *shape[:-1]])
    nodes, low = _indices(shape), _indices(counts)
    offsets = np.array([sum(strides[a] * (c >> a & 1) for a in range(d)) for c in range(2**d)])
    return nodes, (low @ strides)[:, None] + offsets, low.sum(axis=1) % 2


def _indices(shape: Sequence[int]) -> IntArray:
    """All index tuples of a grid, (n, d), the first index running fastest."""
    axes = np.meshgrid(*[np.arange(n, dtype=np.int64) for n in reversed(shape)], indexing="ij")
    return np.stack(axes[::-1], axis=-1).reshape(-1, len(shape))


def _split_cells(corners: IntArray, parity: IntArray, split: int, diagonals: Diagonals) -> tuple[IntArray, CellType]:
    n, k = corners.shape
    if k == 2:
        return corners, "line"
    if k == 4:
        even = _LEFT if diagonals == "left" else _RIGHT
        odd = _RIGHT if diagonals == "right" else _LEFT
    else:
        even, odd = (_FIVE, _FIVE_MIRRORED) if split == 5 else (_SIX, _SIX)
    local = np.stack([even, odd])[parity]
    cells = np.take_along_axis(corners, local.reshape(n, -1), axis=1).reshape(-1, even.shape[1])
    return cells, "triangle" if k == 4 else "tetra"


def _structured(
    counts: Sequence[int],
    place: Callable[[FloatArray], FloatArray],
    split: int = 5,
    diagonals: Diagonals = "alternating",
    sides: Sequence[tuple[str, str]] = SIDES,
) -> Mesh:
    """Split the grid over the unit cube and map it by `place`; sides and corners are named by grid index."""
    nodes, corners, parity = _grid(counts)
    cells, cell_type = _split_cells(corners, parity, split, diagonals)
    ends = np.array(counts)
    # Facets on the boundary are those whose nodes all have the same first or last index; only the outermost
    # layer of grid cells has any.
    low = nodes[corners[:, 0]]
    outermost = np.any((low == 0) | (low == ends - 1), axis=1)
    facets = all_facets(cells[np.repeat(outermost, len(cells) // len(corners))])
    of_facets = nodes[facets]
    groups: dict[str, IntArray] = {}
    outer = np.zeros(len(facets), dtype=np.bool_)
    for axis, count in enumerate(counts):
        for name, index in zip(sides[axis], (0, count), strict=True):
            here = np.all(of_facets[:, :, axis] == index, axis=1)
            groups[name] = facets[here]
            outer |= here
    groups["boundary"] = facets[outer]
    named_nodes: dict[str, IntArray] = {}
    if len(counts) > 1:
        strides = np.cumprod([1, *(ends[:-1] + 1)])
        for choice in itertools.product((0, 1), repeat=len(counts)):
            name = "_".join(sides[axis][end] for axis, end in enumerate(choice))
            named_nodes[name] = np.array([int(np.sum(strides * ends * np.array(choice)))], dtype=np.int64)
    return Mesh(place(nodes / ends), cells, cell_type, groups, {}, named_nodes)


def block(source: BlockMesh) -> Mesh:
    """Box, rectangle or line; the corners are node groups such as ``left_bottom_back``."""
    d = len(source.size)
    dim = source.dim if source.dim is not None else (2 if d == 2 else 3)

    def place(unit: FloatArray) -> FloatArray:
        points = np.zeros((len(unit), dim))
        points[:, :d] = unit * np.array(source.size)
        return points

    return _structured(source.cells, place, source.split, source.diagonals)


def muscle(source: MuscleMesh) -> Mesh:
    """Spindle between two bones; ``left`` and ``right`` are the far ends of the bones, ``side`` is all around."""
    along, across = source.cells
    bone = max(2, round(source.bone_length * along / source.length))
    total = along + 2 * bone
    inside = np.linspace(0.0, source.length, along + 1)
    outside = np.linspace(0.0, source.bone_length, bone + 1)[1:]
    x = np.concatenate([-outside[::-1], inside, source.length + outside])
    belly = np.clip((inside - source.tendon_length) / (source.length - 2.0 * source.tendon_length), 0.0, 1.0)
    spindle = source.end_radius + (source.radius - source.end_radius) * np.sin(np.pi * belly) ** 2
    flat = np.full(bone, source.bone_radius)
    radius = np.concatenate([flat, spindle, flat])

    def place(unit: FloatArray) -> FloatArray:
        layer = np.rint(unit[:, 0] * total).astype(np.int64)
        u, v = 2.0 * unit[:, 1] - 1.0, 2.0 * unit[:, 2] - 1.0
        # Square to disc; with a little less than all of it the four edges do not flatten.
        y = u * np.sqrt(1.0 - _ROUNDNESS * v * v)
        z = v * np.sqrt(1.0 - _ROUNDNESS * u * u)
        return np.stack([x[layer], radius[layer] * y, radius[layer] * z], axis=1)

    mesh = _structured((total, across, across), place, source.split)
    layer = np.arange(mesh.n_cells) // source.split % total
    middle = 0.5 * (x[:-1] + x[1:])[layer]
    is_muscle = (layer >= bone) & (layer < bone + along)
    in_belly = (middle > source.tendon_length) & (middle < source.length - source.tendon_length)
    parts = {
        "muscle": is_muscle,
        "belly": is_muscle & in_belly,
        "tendons": is_muscle & ~in_belly,
        "origin_tendon": is_muscle & (middle <= source.tendon_length),
        "insertion_tendon": is_muscle & (middle >= source.length - source.tendon_length),
        "origin_bone": layer < bone,
        "insertion_bone": layer >= bone + along,
    }
    groups = {name: np.flatnonzero(mask) for name, mask in parts.items() if mask.any()}
    facets = mesh.facet_groups
    side = np.concatenate([facets[name] for pair in SIDES[1:] for name in pair])
    named = {"left": facets["left"], "right": facets["right"], "side": side, "boundary": facets["boundary"]}
    return Mesh(mesh.points, mesh.cells, "tetra", named, groups)


def cloth(source: ClothMesh) -> Mesh:
    """Flat sheet of triangles in 3D, normals towards +y (lying) or +z (standing)."""
    sides = _sheet_sides(source.plane)
    mesh = _structured(source.cells, _sheet_place(source.size, source.plane), 5, source.diagonals, sides)
    if source.plane == "xy":
        return mesh
    # x cross z is -y: turn every triangle, and with it the edges, over.
    cells = mesh.cells[:, [0, 2, 1]]
    facets = {name: rows[:, ::-1] for name, rows in mesh.facet_groups.items()}
    return Mesh(mesh.points, cells, "triangle", facets, {}, mesh.node_groups)


def _sheet_sides(plane: str) -> tuple[tuple[str, str], ...]:
    return (SIDES[0], SIDES[2]) if plane == "xz" else SIDES[:2]


def _sheet_place(size: tuple[float, float], plane: str) -> Callable[[FloatArray], FloatArray]:
    def place(unit: FloatArray) -> FloatArray:
        points = np.zeros((len(unit), 3))
        points[:, [0, 2] if plane == "xz" else [0, 1]] = (unit - 0.5) * np.array(size)
        return points

    return place


def cook(source: CookMesh) -> Mesh:
    """Cook's panel; node ``right_top`` (2D) is where the deflection is usually quoted."""

    def place(unit: FloatArray) -> FloatArray:
        s, t = unit[:, 0], unit[:, 1]
        low = s * source.rise
        high = source.left_height + s * (source.rise + source.right_height - source.left_height)
        points = np.empty_like(unit)
        points[:, 0] = s * source.length
        points[:, 1] = low + t * (high - low)
        if source.thickness is not None:
            points[:, 2] = unit[:, 2] * source.thickness
        return points

    return _structured(source.cells, place, source.split, source.diagonals)


def flag(source: FlagMesh) -> Mesh:
    """Turek and Hron's elastic bar; node ``tip`` is the middle of its free end, ``left`` the curved end."""

    def place(unit: FloatArray) -> FloatArray:
        y = (unit[:, 1] - 0.5) * source.thickness
        start = np.sqrt(source.radius**2 - y**2)
        x = start + unit[:, 0] * (source.radius + source.length - start)
        return np.stack([source.center[0] + x, source.center[1] + y], axis=1)

    mesh = _structured(source.cells, place, 5, source.diagonals)
    nx, ny = source.cells
    tip = np.array([(ny // 2) * (nx + 1) + nx], dtype=np.int64)
    return Mesh(mesh.points, mesh.cells, "triangle", mesh.facet_groups, {}, {**mesh.node_groups, "tip": tip})


def ring(source: RingMesh) -> Mesh:
    """Sector of a ring or tube; its cuts are the facet groups ``start`` (on the x axis) and ``end``."""

    def place(unit: FloatArray) -> FloatArray:
        r = source.inner_radius + unit[:, 0] * (source.outer_radius - source.inner_radius)
        angle = source.angle * unit[:, 1]
        points = np.empty_like(unit)
        points[:, 0], points[:, 1] = r * np.cos(angle), r * np.sin(angle)
        if source.thickness is not None:
            points[:, 2] = source.thickness * unit[:, 2]
        return points

    sides = (("inner", "outer"), ("start", "end"), SIDES[2])
    return _structured(source.cells, place, source.split, source.diagonals, sides)


def rod(source: RodMesh) -> Mesh:
    """Straight rod; its ends are the facet groups ``start`` and ``end``."""
    start, end = np.array(source.start), np.array(source.end)
    return _structured((source.cells,), lambda unit: start + unit * (end - start), sides=(("start", "end"),))


def rod_net(source: RodNetMesh) -> Mesh:
    """Net of rods: edges, corners and ``crossings`` are node groups (a net has no free ends)."""
    (nx, ny), s = source.meshes, source.segments
    sides = _sheet_sides(source.plane)
    nodes, corners, _ = _grid((nx * s, ny * s))
    # Of the fine grid, only lines along a rod stay: their other index is a multiple of `segments`.
    lines = np.concatenate([corners[:, [0, 1]], corners[:, [2, 3]], corners[:, [0, 2]], corners[:, [1, 3]]])
    lines = unique_edges(lines)
    a, b = nodes[lines[:, 0]], nodes[lines[:, 1]]
    along_x = a[:, 1] == b[:, 1]
    lines = lines[np.where(along_x, a[:, 1] % s == 0, a[:, 0] % s == 0)]
    used = np.unique(lines)
    new = np.full(len(nodes), -1, dtype=np.int64)
    new[used] = np.arange(len(used))
    index = nodes[used]
    groups: dict[str, IntArray] = {"crossings": np.flatnonzero(np.all(index % s == 0, axis=1))}
    ends = (nx * s, ny * s)
    on_side = [[index[:, axis] == end for end in (0, ends[axis])] for axis in range(2)]
    for axis, end in itertools.product(range(2), range(2)):
        groups[sides[axis][end]] = np.flatnonzero(on_side[axis][end])
    for i, j in itertools.product(range(2), range(2)):
        groups[f"{sides[0][i]}_{sides[1][j]}"] = np.flatnonzero(on_side[0][i] & on_side[1][j])
    points = _sheet_place(source.size, source.plane)(index / np.array(ends))
    return Mesh(points, new[lines], "line", {}, {}, groups)


def sphere_surface(source: SphereSurfaceMesh) -> Mesh:
    """Closed sphere: an icosahedron with ``n`` cuts an edge has 10 n^2 + 2 nodes and 20 n^2 triangles."""
    corners, faces = _icosahedron()
    edge = float(np.linalg.norm(corners[faces[0, 0]] - corners[faces[0, 1]]))
    # 1.1: edges grow by 10 % on average when the flat faces are pushed out to the sphere.
    n = max(1, round(1.1 * edge * source.radius / source.element_size))
    i, j = (grid.ravel() for grid in np.meshgrid(np.arange(n + 1), np.arange(n + 1), indexing="ij"))
    i, j = i[i + j <= n], j[i + j <= n]
    number = np.full((n + 2, n + 2), -1, dtype=np.int64)
    number[i, j] = np.arange(len(i))
    up = i + j < n
    ups = np.stack([number[i, j], number[i + 1, j], number[i, j + 1]], axis=1)[up]
    down = i + j < n - 1
    downs = np.stack([number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]], axis=1)[down]
    local = np.concatenate([ups, downs])
    weights = np.stack([n - i - j, i, j], axis=1) / n
    points = np.einsum("ac,fcx->fax", weights, corners[faces])
    cells = (np.arange(len(faces))[:, None, None] * len(i) + local).reshape(-1, 3)
    points, cells = _merged_points(points.reshape(-1, 3), cells, 0.01 * edge / n)
    points *= source.radius / np.linalg.norm(points, axis=1, keepdims=True)
    top, bottom = int(np.argmax(points[:, 1])), int(np.argmin(points[:, 1]))
    poles = {"top": np.array([top], dtype=np.int64), "bottom": np.array([bottom], dtype=np.int64)}
    return Mesh(points, cells, "triangle", {}, {}, poles)


def _icosahedron() -> tuple[FloatArray, IntArray]:
    """Unit icosahedron with two corners on the y axis, triangles outward."""
    height, ring = 1.0 / np.sqrt(5.0), 2.0 / np.sqrt(5.0)
    angles = 2.0 * np.pi * np.arange(5) / 5.0
    upper = np.stack([ring * np.sin(angles), np.full(5, height), ring * np.cos(angles)], axis=1)
    angles = angles + np.pi / 5.0
    lower = np.stack([ring * np.sin(angles), np.full(5, -height), ring * np.cos(angles)], axis=1)
    corners = np.concatenate([[[0.0, 1.0, 0.0]], upper, lower, [[0.0, -1.0, 0.0]]])
    k, nxt = np.arange(5), (np.arange(5) + 1) % 5
    faces = np.concatenate(
        [
            np.stack([np.zeros(5, dtype=np.int64), 1 + k, 1 + nxt], axis=1),
            np.stack([1 + k, 6 + k, 1 + nxt], axis=1),
            np.stack([1 + nxt, 6 + k, 6 + nxt], axis=1),
            np.stack([np.full(5, 11), 6 + nxt, 6 + k], axis=1),
        ]
    )
    return corners, faces


def _merged_points(points: FloatArray, cells: IntArray, tolerance: float) -> tuple[FloatArray, IntArray]:
    """Merge points closer than `tolerance`; all others are much farther apart."""
    from scipy.spatial import cKDTree

    pairs = cKDTree(points).query_pairs(tolerance, output_type="ndarray")
    first = np.arange(len(points))
    np.minimum.at(first, pairs.max(axis=1), pairs.min(axis=1))
    kept, new = np.unique(first, return_inverse=True)
    return points[kept], new[cells].astype(np.int64)
