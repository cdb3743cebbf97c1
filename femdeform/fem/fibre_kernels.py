"""Compiled loops over cells with muscle fibres: what fibres add to energies, forces and Hessian blocks.

Each cell adds to a slot of its own, after the law of the matrix has written there.
"""

from __future__ import annotations

from typing import Any

from femdeform.jit import njit, prange
from femdeform.materials.muscle_fibre import fibre_energy, fibre_force, fibre_stiffness


@njit
def fibre_vector(x: Any, cells: Any, weights: Any, e: Any, k: Any, q: Any) -> Any:
    """y = F v of cell e, row k of the fibres, at quadrature point q; three components also in 2D."""
    # Differences of positions: the weights of a cell add up to 0.
    o = cells[e, 0]
    y0 = y1 = y2 = 0.0
    for a in range(1, cells.shape[1]):
        i, w = cells[e, a], weights[k, q, a]
        y0 += w * (x[i, 0] - x[o, 0])
        y1 += w * (x[i, 1] - x[o, 1])
        if x.shape[1] == 3:
            y2 += w * (x[i, 2] - x[o, 2])
    return (y0, y1, y2)


@njit(parallel=True)
def add_energies(x: Any, cells: Any, volumes: Any, rows: Any, weights: Any, fibre: Any, out: Any) -> None:
    """Add the energy of the fibres of each cell [J] to `out` (n_cells,).

    Parameters
    ----------
    x : (n_nodes, dim)
        Positions [m].
    cells : (n_cells, n_nodes)
        All cells.
    volumes : (n_cells, n_q)
        Quadrature weights times volume [m^3].
    rows, weights
        See `FibreCells`.
    fibre : MuscleFibre
        Parameters.
    out : (n_cells,)
        Added to.
    """
    for k in prange(rows.shape[0]):
        e = rows[k]
        for q in range(volumes.shape[1]):
            y = fibre_vector(x, cells, weights, e, k, q)
            stretch = (y[0] * y[0] + y[1] * y[1] + y[2] * y[2]) ** 0.5
            out[e] += volumes[e, q] * fibre_energy(stretch, fibre)


@njit(parallel=True)
def add_forces(x: Any, cells: Any, volumes: Any, rows: Any, weights: Any, fibre: Any, out: Any, first: Any) -> None:
    """Add the energy gradient of the fibres of each cell [N] to rows first + e n_nodes + a of `out`."""
    for k in prange(rows.shape[0]):
        e = rows[k]
        slot = first + e * cells.shape[1]
        for q in range(volumes.shape[1]):
            t = fibre_force(fibre_vector(x, cells, weights, e, k, q), fibre)
            for a in range(cells.shape[1]):
                w = volumes[e, q] * weights[k, q, a]
                out[slot + a, 0] += w * t[0]
                out[slot + a, 1] += w * t[1]
                if out.shape[1] == 3:
                    out[slot + a, 2] += w * t[2]


@njit(parallel=True)
def add_hessians(
    x: Any, cells: Any, volumes: Any, rows: Any, weights: Any, fibre: Any, project: Any, out: Any, first: Any
) -> None:
    """Add the upper block triangle of the fibres' Hessian [N/m] of each cell to rows of `out` (n_slots, dim^2)."""
    n = cells.shape[1]
    n_pairs = (n * (n + 1)) // 2
    for k in prange(rows.shape[0]):
        e = rows[k]
        for q in range(volumes.shape[1]):
            B = fibre_stiffness(fibre_vector(x, cells, weights, e, k, q), fibre, project)
            row = first + e * n_pairs
            for a in range(n):
                for b in range(a, n):
                    w = volumes[e, q] * weights[k, q, a] * weights[k, q, b]
                    if out.shape[1] == 4:
                        out[row, 0] += w * B[0]
                        out[row, 1] += w * B[5]
                        out[row, 2] += w * B[5]
                        out[row, 3] += w * B[1]
                    else:
                        out[row, 0] += w * B[0]
                        out[row, 1] += w * B[5]
                        out[row, 2] += w * B[4]
                        out[row, 3] += w * B[5]
                        out[row, 4] += w * B[1]
                        out[row, 5] += w * B[3]
                        out[row, 6] += w * B[4]
                        out[row, 7] += w * B[3]
                        out[row, 8] += w * B[2]
                    row += 1


@njit(parallel=True)
def stresses(x: Any, cells: Any, rows: Any, weights: Any, fibre: Any, out: Any) -> None:
    """Tension times direction of the fibres at each quadrature point [Pa] into `out` (n_rows, n_q, 3): P = t (x) v."""
    for k in prange(rows.shape[0]):
        for q in range(weights.shape[1]):
            t = fibre_force(fibre_vector(x, cells, weights, rows[k], k, q), fibre)
            out[k, q, 0], out[k, q, 1], out[k, q, 2] = t[0], t[1], t[2]
