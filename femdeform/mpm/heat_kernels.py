"""Compiled loops of heat: transfers of temperature, and the conduction matrix in rows of a fixed stencil.

Two quadratic splines overlap where their nodes are at most two apart along each axis, so a row of the matrix has a
place for each of 5^dim offsets between nodes, and no list of neighbours needs to be found.
"""

from __future__ import annotations

from typing import Any

from femdeform.jit import njit, prange


@njit(parallel=True)
def temperature_to_nodes(
    points: Any,
    capacity: Any,
    temperature: Any,
    gradient: Any,
    weights: Any,
    offsets: Any,
    entries: Any,
    positions: Any,
    out_capacity: Any,
    out_temperature: Any,
) -> None:
    """``C_i = sum w C_p``, ``C_i T_i = sum w C_p (T_p + grad T_p . (x_i - x_p))``; T_i = 0 where C_i = 0.

    Parameters
    ----------
    points, gradient : (n_points, dim)
        [m], [K/m].
    capacity, temperature : (n_points,)
        Heat capacities C_p [J/K] and temperatures [K].
    weights : (n_points, n_stencil)
        Weights.
    offsets, entries
        Points of each node, see `femdeform.mpm.grid.Stencils`.
    positions : (n_nodes, dim)
        Positions of the nodes [m].
    out_capacity, out_temperature : (n_nodes,)
        Results [J/K], [K].
    """
    size, dim = weights.shape[1], points.shape[1]
    for i in prange(out_capacity.shape[0]):
        total, heat = 0.0, 0.0
        for t in range(offsets[i], offsets[i + 1]):
            p = entries[t] // size
            c = weights[p, entries[t] - p * size] * capacity[p]
            T = temperature[p]
            for a in range(dim):
                T += gradient[p, a] * (positions[i, a] - points[p, a])
            total += c
            heat += c * T
        out_capacity[i] = total
        out_temperature[i] = heat / total if total > 0.0 else 0.0


@njit(parallel=True)
def temperature_to_points(
    field: Any, nodes: Any, weights: Any, gradients: Any, out_temperature: Any, out_gradient: Any
) -> None:
    """``T_p = sum w T_i`` and ``grad T_p = sum T_i grad w`` (n_points,), (n_points, dim)."""
    for p in prange(out_temperature.shape[0]):
        value = 0.0
        for a in range(out_gradient.shape[1]):
            out_gradient[p, a] = 0.0
        for k in range(weights.shape[1]):
            # A node of no weight may be any; its gradient vanishes as well.
            if weights[p, k] > 0.0:
                T = field[nodes[p, k]]
                value += weights[p, k] * T
                for a in range(out_gradient.shape[1]):
                    out_gradient[p, a] += T * gradients[p, k, a]
        out_temperature[p] = value


@njit(parallel=True)
def conduction_rows(
    nodes: Any,
    weights: Any,
    gradients: Any,
    offsets: Any,
    entries: Any,
    conductance: Any,
    exchange: Any,
    places: Any,
    neighbours: Any,
    values: Any,
) -> None:
    """Rows of ``sum_p conductance_p G_i . G_j + sum_p exchange_p w_i w_j``.

    Parameters
    ----------
    nodes, weights, gradients, offsets, entries
        Quadratic stencils of the quadrature points, see `femdeform.mpm.grid.Stencils`.
    conductance, exchange : (n_points,)
        K V [W m/K], h |dA| [W/K].
    places : (n_stencil, n_stencil) int64
        Place in a row for the offset from one node of a stencil to another.
    neighbours : (n_nodes, 5^dim) int32
        Receives the node of each place in a row, the row's own where there is none.
    values : (n_nodes, 5^dim)
        Receives the matrix [W/K].
    """
    size, dim = weights.shape[1], gradients.shape[2]
    for i in prange(values.shape[0]):
        for s in range(values.shape[1]):
            neighbours[i, s] = i
            values[i, s] = 0.0
        for t in range(offsets[i], offsets[i + 1]):
            p = entries[t] // size
            k = entries[t] - p * size
            for m in range(size):
                if weights[p, m] > 0.0:
                    slot = places[k, m]
                    product = 0.0
                    for c in range(dim):
                        product += gradients[p, k, c] * gradients[p, m, c]
                    neighbours[i, slot] = nodes[p, m]
                    values[i, slot] += conductance[p] * product + exchange[p] * weights[p, k] * weights[p, m]


@njit(parallel=True)
def rows_times(neighbours: Any, values: Any, diagonal: Any, x: Any, out: Any) -> None:
    """out = (rows + diagonal) x."""
    for i in prange(out.shape[0]):
        s = diagonal[i] * x[i]
        for j in range(values.shape[1]):
            s += values[i, j] * x[neighbours[i, j]]
        out[i] = s
