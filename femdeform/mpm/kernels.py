"""Compiled loops between points and grid nodes: weights, sums at the nodes, interpolation, APIC transfers.

Points read their nodes, nodes read their points through a fixed list, so that no two threads write to one place and
results do not depend on their number.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from femdeform.jit import njit, prange

# Rows that one thread takes at a time where it needs scratch of its own.
CHUNK = 128
# Weights below are rounding; without them there are no nodes of almost no mass.
_SMALLEST = 1e-15


@njit(parallel=True)
def splines(points: Any, spacing: Any, degree: Any, base: Any, weights: Any, gradients: Any) -> None:
    """B-spline weights of the nodes around each point, and their gradients.

    Parameters
    ----------
    points : (n_points, dim)
        [m].
    spacing : float
        Distance of the nodes [m]; node i lies at ``i spacing``.
    degree : int
        1: linear, 2 nodes an axis; 2: quadratic, 3 nodes an axis.
    base : (n_points, dim) int64
        Receives the lowest node of each point.
    weights : (n_points, (degree + 1)^dim)
        Receives the weights, the last axis fastest.
    gradients : (n_points, (degree + 1)^dim, dim)
        Receives the gradients [1/m].
    """
    dim = points.shape[1]
    size = degree + 1
    for chunk in prange((points.shape[0] + CHUNK - 1) // CHUNK):
        w = np.empty((dim, size))
        g = np.empty((dim, size))
        for p in range(chunk * CHUNK, min((chunk + 1) * CHUNK, points.shape[0])):
            for a in range(dim):
                place = points[p, a] / spacing
                if degree == 1:
                    lowest = math.floor(place)
                    f = place - lowest
                    w[a, 0], w[a, 1] = 1.0 - f, f
                    g[a, 0], g[a, 1] = -1.0 / spacing, 1.0 / spacing
                else:
                    lowest = math.floor(place - 0.5)
                    f = place - lowest
                    w[a, 0], w[a, 1], w[a, 2] = 0.5 * (1.5 - f) ** 2, 0.75 - (f - 1.0) ** 2, 0.5 * (f - 0.5) ** 2
                    g[a, 0], g[a, 1], g[a, 2] = (f - 1.5) / spacing, -2.0 * (f - 1.0) / spacing, (f - 0.5) / spacing
                base[p, a] = lowest
            for k in range(weights.shape[1]):
                rest, value = k, 1.0
                for a in range(dim - 1, -1, -1):
                    value *= w[a, rest % size]
                    rest //= size
                weights[p, k] = value if value >= _SMALLEST else 0.0
                for c in range(dim):
                    rest, slope = k, 1.0
                    for a in range(dim - 1, -1, -1):
                        slope *= g[a, rest % size] if a == c else w[a, rest % size]
                        rest //= size
                    gradients[p, k, c] = slope


@njit(parallel=True)
def interpolate(field: Any, nodes: Any, weights: Any, out: Any) -> None:
    """Values at the points: out[p] = sum_k weights[p, k] field[nodes[p, k]]."""
    for p in prange(out.shape[0]):
        for c in range(out.shape[1]):
            s = 0.0
            for k in range(weights.shape[1]):
                s += weights[p, k] * field[nodes[p, k], c]
            out[p, c] = s


@njit(parallel=True)
def sum_at_nodes(values: Any, weights: Any, offsets: Any, entries: Any, out: Any) -> None:
    """The transpose of `interpolate`: out[I] = sum over its entries (p, k) of weights[p, k] values[p]."""
    size = weights.shape[1]
    for i in prange(out.shape[0]):
        for c in range(out.shape[1]):
            s = 0.0
            for t in range(offsets[i], offsets[i + 1]):
                p = entries[t] // size
                s += weights[p, entries[t] - p * size] * values[p, c]
            out[i, c] = s


@njit(parallel=True)
def momentum_to_nodes(
    points: Any,
    mass: Any,
    velocity: Any,
    affine: Any,
    weights: Any,
    offsets: Any,
    entries: Any,
    positions: Any,
    out_mass: Any,
    out_velocity: Any,
) -> None:
    """APIC, points to grid: ``m_I = sum w m_p``, ``m_I v_I = sum w m_p (v_p + C_p (x_I - x_p))``.

    Parameters
    ----------
    points, velocity : (n_points, dim)
        [m], [m/s].
    mass : (n_points,)
        [kg].
    affine : (n_points, dim, dim)
        C_p, the gradient of the velocity around each point [1/s].
    weights : (n_points, n_stencil)
        Weights.
    offsets, entries
        Points of each node, see `Stencils`.
    positions : (n_nodes, dim)
        Positions of the nodes [m].
    out_mass, out_velocity : (n_nodes,), (n_nodes, dim)
        Results [kg], [m/s].
    """
    size, dim = weights.shape[1], points.shape[1]
    for i in prange(out_mass.shape[0]):
        total = 0.0
        for c in range(dim):
            out_velocity[i, c] = 0.0
        for t in range(offsets[i], offsets[i + 1]):
            p = entries[t] // size
            m = weights[p, entries[t] - p * size] * mass[p]
            total += m
            for c in range(dim):
                v = velocity[p, c]
                for b in range(dim):
                    v += affine[p, c, b] * (positions[i, b] - points[p, b])
                out_velocity[i, c] += m * v
        out_mass[i] = total
        for c in range(dim):
            out_velocity[i, c] /= total


@njit(parallel=True)
def velocity_to_points(
    points: Any,
    nodes: Any,
    weights: Any,
    gradients: Any,
    positions: Any,
    velocity: Any,
    spacing: Any,
    degree: Any,
    out_velocity: Any,
    out_affine: Any,
) -> None:
    """APIC, grid to points: ``v_p = sum w v_I`` and C_p.

    Quadratic: ``C = 4/dx^2 sum w v_I (x_I - x_p)^T``, the inertia of the stencil being dx^2/4 wherever the point lies.
    Linear: ``C = sum v_I grad(w)^T``, the same thing with the inertia of the place.
    """
    dim = points.shape[1]
    for p in prange(points.shape[0]):
        for c in range(dim):
            v = 0.0
            for k in range(weights.shape[1]):
                v += weights[p, k] * velocity[nodes[p, k], c]
            out_velocity[p, c] = v
            for b in range(dim):
                s = 0.0
                for k in range(weights.shape[1]):
                    i = nodes[p, k]
                    if degree == 2:
                        s += weights[p, k] * velocity[i, c] * (positions[i, b] - points[p, b])
                    elif weights[p, k] > 0.0:
                        s += velocity[i, c] * gradients[p, k, b]
                out_affine[p, c, b] = 4.0 / (spacing * spacing) * s if degree == 2 else s


@njit(parallel=True)
def cell_gradients(
    cells: Any, slopes: Any, nodes: Any, weights: Any, offsets: Any, cell_nodes: Any, n_nodes: Any, out: Any
) -> None:
    """Gradients of cells with respect to grid nodes: ``Gt_I = sum_a w_{cells[e, a], I} slopes[e, a]``.

    Parameters
    ----------
    cells : (n_cells, n_corners)
        Points that are the corners of each cell.
    slopes : (n_cells, n_corners, dim)
        Gradients of the shape functions [1/m].
    nodes, weights : (n_points, n_stencil)
        Nodes and weights of the points.
    offsets, cell_nodes : (n_cells + 1,), (n_entries,)
        Grid nodes of each cell.
    n_nodes : int
        Number of grid nodes.
    out : (n_entries, dim)
        Result [1/m].
    """
    n_cells = cells.shape[0]
    for chunk in prange((n_cells + CHUNK - 1) // CHUNK):
        place = np.empty(n_nodes, dtype=np.int64)
        for e in range(chunk * CHUNK, min((chunk + 1) * CHUNK, n_cells)):
            for t in range(offsets[e], offsets[e + 1]):
                place[cell_nodes[t]] = t
                for c in range(out.shape[1]):
                    out[t, c] = 0.0
            for a in range(cells.shape[1]):
                p = cells[e, a]
                for k in range(weights.shape[1]):
                    w = weights[p, k]
                    if w > 0.0:
                        for c in range(out.shape[1]):
                            out[place[nodes[p, k]], c] += w * slopes[e, a, c]


@njit(parallel=True)
def spread_columns(
    row_offsets: Any,
    columns: Any,
    values: Any,
    nodes: Any,
    weights: Any,
    half_offsets: Any,
    half_columns: Any,
    n_nodes: Any,
    dim: Any,
    out: Any,
) -> None:
    """K W: the blocks of a matrix over points with its columns taken to grid nodes.

    Parameters
    ----------
    row_offsets, columns : (n_points + 1,), (n_blocks,)
        Pattern of the matrix over points.
    values : (dim^2 n_blocks,)
        Its values in CSR order of the degrees of freedom.
    nodes, weights : (n_points, n_stencil)
        Nodes and weights of the points.
    half_offsets, half_columns
        Pattern of the result, points times grid nodes.
    n_nodes : int
        Number of grid nodes.
    dim : tuple
        Its length is the dimension.
    out : (n_half_blocks, dim^2)
        Result.
    """
    d = len(dim)
    n_points = row_offsets.shape[0] - 1
    for chunk in prange((n_points + CHUNK - 1) // CHUNK):
        place = np.empty(n_nodes, dtype=np.int64)
        for p in range(chunk * CHUNK, min((chunk + 1) * CHUNK, n_points)):
            for t in range(half_offsets[p], half_offsets[p + 1]):
                place[half_columns[t]] = t
                for c in range(d * d):
                    out[t, c] = 0.0
            n_row = row_offsets[p + 1] - row_offsets[p]
            first = d * d * row_offsets[p]
            for b in range(n_row):
                q = columns[row_offsets[p] + b]
                for k in range(weights.shape[1]):
                    w = weights[q, k]
                    if w == 0.0:
                        continue
                    t = place[nodes[q, k]]
                    for c in range(d):
                        for m in range(d):
                            out[t, d * c + m] += w * values[first + c * d * n_row + d * b + m]


@njit(parallel=True)
def sum_rows(
    half_offsets: Any,
    half_columns: Any,
    half: Any,
    weights: Any,
    offsets: Any,
    entries: Any,
    row_offsets: Any,
    columns: Any,
    diagonal: Any,
    free: Any,
    dim: Any,
    values: Any,
) -> None:
    """W^T (K W) plus blocks of single nodes, as the values of a CSR matrix over the grid's degrees of freedom.

    Parameters
    ----------
    half_offsets, half_columns, half
        K W, see `spread_columns`.
    weights, offsets, entries
        Weights, and the points of each node.
    row_offsets, columns : (n_nodes + 1,), (n_blocks,)
        Pattern over grid nodes.
    diagonal : (n_nodes, dim^2)
        Blocks of single nodes.
    free : (n_nodes, dim) uint8
        0 where a degree of freedom is prescribed: its row and column become those of a diagonal matrix.
    dim : tuple
        Its length is the dimension.
    values : (dim^2 n_blocks,)
        Result.
    """
    d = len(dim)
    size = weights.shape[1]
    n_nodes = row_offsets.shape[0] - 1
    for chunk in prange((n_nodes + CHUNK - 1) // CHUNK):
        place = np.empty(n_nodes, dtype=np.int64)
        for i in range(chunk * CHUNK, min((chunk + 1) * CHUNK, n_nodes)):
            n_row = row_offsets[i + 1] - row_offsets[i]
            first = d * d * row_offsets[i]
            for b in range(n_row):
                place[columns[row_offsets[i] + b]] = first + d * b
            for t in range(first, first + d * d * n_row):
                values[t] = 0.0
            for t in range(offsets[i], offsets[i + 1]):
                p = entries[t] // size
                w = weights[p, entries[t] - p * size]
                for h in range(half_offsets[p], half_offsets[p + 1]):
                    at = place[half_columns[h]]
                    for c in range(d):
                        for m in range(d):
                            values[at + c * d * n_row + m] += w * half[h, d * c + m]
            for b in range(n_row):
                j = columns[row_offsets[i] + b]
                at = first + d * b
                for c in range(d):
                    for m in range(d):
                        t = at + c * d * n_row + m
                        if i == j:
                            values[t] += diagonal[i, d * c + m]
                        if free[i, c] == 0 or free[j, m] == 0:
                            # A prescribed degree of freedom keeps the size of its own entry.
                            values[t] = abs(values[t]) if i == j and c == m else 0.0
