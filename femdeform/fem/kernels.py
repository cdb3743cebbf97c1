"""Compiled loops over cells and nodes: energy, forces, Hessian blocks, and their sums at the nodes.

Sizes known from the element (nodes a cell, dimension) enter as tuples whose length is the size, so that the compiler
sees constants and unrolls; the material enters as its NamedTuple and selects the law the same way. Each cell writes to
a slot of its own and the sums at the nodes run over a fixed list, so results do not depend on the number of threads.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba.extending import overload

from femdeform.jit import njit, prange
from femdeform.materials.dispatch import energy_density, pk1, tangent

# Cells that one thread takes at a time: long enough to hide the loop's cost, short enough to balance threads.
CHUNK = 256


def deformation_gradient(x: Any, cells: Any, gradients: Any, e: Any, q: Any, dim: Any, nodes: Any) -> Any:
    """F = sum_a x_a (x) grad N_a of one cell at one quadrature point, as a flat row-major tuple."""
    raise NotImplementedError("compiled code only")


@overload(deformation_gradient, inline="never")
def _deformation_gradient(x: Any, cells: Any, gradients: Any, e: Any, q: Any, dim: Any, nodes: Any) -> Any:
    def planar(x: Any, cells: Any, gradients: Any, e: Any, q: Any, dim: Any, nodes: Any) -> Any:
        f00 = f01 = f10 = f11 = 0.0
        for a in range(len(nodes)):
            i = cells[e, a]
            g0, g1 = gradients[e, q, a, 0], gradients[e, q, a, 1]
            x0, x1 = x[i, 0], x[i, 1]
            f00 += x0 * g0
            f01 += x0 * g1
            f10 += x1 * g0
            f11 += x1 * g1
        return (f00, f01, f10, f11)

    def spatial(x: Any, cells: Any, gradients: Any, e: Any, q: Any, dim: Any, nodes: Any) -> Any:
        f00 = f01 = f02 = f10 = f11 = f12 = f20 = f21 = f22 = 0.0
        for a in range(len(nodes)):
            i = cells[e, a]
            g0, g1, g2 = gradients[e, q, a, 0], gradients[e, q, a, 1], gradients[e, q, a, 2]
            x0, x1, x2 = x[i, 0], x[i, 1], x[i, 2]
            f00 += x0 * g0
            f01 += x0 * g1
            f02 += x0 * g2
            f10 += x1 * g0
            f11 += x1 * g1
            f12 += x1 * g2
            f20 += x2 * g0
            f21 += x2 * g1
            f22 += x2 * g2
        return (f00, f01, f02, f10, f11, f12, f20, f21, f22)

    return planar if len(dim) == 2 else spatial


def add_forces(P: Any, weight: Any, gradients: Any, e: Any, q: Any, nodes: Any, out: Any, slot: Any) -> None:
    """Add weight * P grad N_a to row slot + a of `out` for every node a of a cell."""
    raise NotImplementedError("compiled code only")


@overload(add_forces)
def _add_forces(P: Any, weight: Any, gradients: Any, e: Any, q: Any, nodes: Any, out: Any, slot: Any) -> Any:
    def planar(P: Any, weight: Any, gradients: Any, e: Any, q: Any, nodes: Any, out: Any, slot: Any) -> None:
        for a in range(len(nodes)):
            g0, g1 = weight * gradients[e, q, a, 0], weight * gradients[e, q, a, 1]
            out[slot + a, 0] += P[0] * g0 + P[1] * g1
            out[slot + a, 1] += P[2] * g0 + P[3] * g1

    def spatial(P: Any, weight: Any, gradients: Any, e: Any, q: Any, nodes: Any, out: Any, slot: Any) -> None:
        for a in range(len(nodes)):
            g0 = weight * gradients[e, q, a, 0]
            g1 = weight * gradients[e, q, a, 1]
            g2 = weight * gradients[e, q, a, 2]
            out[slot + a, 0] += P[0] * g0 + P[1] * g1 + P[2] * g2
            out[slot + a, 1] += P[3] * g0 + P[4] * g1 + P[5] * g2
            out[slot + a, 2] += P[6] * g0 + P[7] * g1 + P[8] * g2

    return planar if len(P) == 4 else spatial


@njit(parallel=True)
def cell_energies(x: Any, cells: Any, gradients: Any, weights: Any, law: Any, dim: Any, nodes: Any, out: Any) -> None:
    """Elastic energy of each cell [J] into `out` (n_cells,)."""
    for e in prange(cells.shape[0]):
        energy = 0.0
        for q in range(weights.shape[1]):
            F = deformation_gradient(x, cells, gradients, e, q, dim, nodes)
            energy += weights[e, q] * energy_density(F, law)
        out[e] = energy


@njit(parallel=True)
def cell_forces(
    x: Any, cells: Any, gradients: Any, weights: Any, law: Any, dim: Any, nodes: Any, out: Any, first: Any
) -> None:
    """Energy gradient of each cell at its nodes [N] into rows first + e n_nodes + a of `out`."""
    for e in prange(cells.shape[0]):
        slot = first + e * len(nodes)
        for a in range(len(nodes)):
            for c in range(len(dim)):
                out[slot + a, c] = 0.0
        for q in range(weights.shape[1]):
            F = deformation_gradient(x, cells, gradients, e, q, dim, nodes)
            add_forces(pk1(F, law), weights[e, q], gradients, e, q, nodes, out, slot)


@njit
def add_blocks(
    H: Any, weight: Any, gradients: Any, e: Any, q: Any, dim: Any, nodes: Any, M: Any, out: Any, slot: Any
) -> None:
    """Add weight * grad N_a . H . grad N_b of the pairs a <= b of a cell to rows of `out` from `slot` on.

    M is scratch of shape (d*d, d).
    """
    d = len(dim)
    for b in range(len(nodes)):
        for i in range(d * d):
            for m in range(d):
                s = 0.0
                for k in range(d):
                    s += H[i, d * m + k] * gradients[e, q, b, k]
                M[i, m] = weight * s
        for a in range(b + 1):
            # Pairs are stored row by row of the upper triangle: (0,0) (0,1) ... (1,1) (1,2) ...
            row = slot + a * len(nodes) - (a * (a - 1)) // 2 + b - a
            for c in range(d):
                for m in range(d):
                    s = 0.0
                    for k in range(d):
                        s += gradients[e, q, a, k] * M[d * c + k, m]
                    out[row, d * c + m] += s


@njit(parallel=True)
def cell_hessians(
    x: Any,
    cells: Any,
    gradients: Any,
    weights: Any,
    law: Any,
    project: Any,
    dim: Any,
    nodes: Any,
    out: Any,
    first: Any,
) -> None:
    """Upper block triangle of each cell's Hessian [N/m] into rows of `out` (n_slots, d*d)."""
    d = len(dim)
    n_pairs = (len(nodes) * (len(nodes) + 1)) // 2
    n_chunks = (cells.shape[0] + CHUNK - 1) // CHUNK
    for chunk in prange(n_chunks):
        H = np.empty((d * d, d * d))
        M = np.empty((d * d, d))
        for e in range(chunk * CHUNK, min((chunk + 1) * CHUNK, cells.shape[0])):
            slot = first + e * n_pairs
            for row in range(slot, slot + n_pairs):
                for i in range(d * d):
                    out[row, i] = 0.0
            for q in range(weights.shape[1]):
                F = deformation_gradient(x, cells, gradients, e, q, dim, nodes)
                tangent(F, law, project, H)
                add_blocks(H, weights[e, q], gradients, e, q, dim, nodes, M, out, slot)


@njit(parallel=True)
def sum_slots(slots: Any, offsets: Any, entries: Any, out: Any) -> None:
    """Sum rows of `slots` (n_slots, d) at the nodes: out[i] = sum of slots[entries[offsets[i]:offsets[i+1]]]."""
    for i in prange(out.shape[0]):
        for c in range(out.shape[1]):
            s = 0.0
            for k in range(offsets[i], offsets[i + 1]):
                s += slots[entries[k], c]
            out[i, c] = s


def _gather(blocks: Any, entries: Any, first: Any, last: Any, dim: Any) -> Any:
    """Sum of the blocks that a range of `entries` names, transposed where it says so, as a tuple."""
    raise NotImplementedError("compiled code only")


@overload(_gather)
def _gather_compiled(blocks: Any, entries: Any, first: Any, last: Any, dim: Any) -> Any:
    def planar(blocks: Any, entries: Any, first: Any, last: Any, dim: Any) -> Any:
        a = b = c = d = 0.0
        for t in range(first, last):
            slot, turned = entries[t] >> 1, entries[t] & 1
            a += blocks[slot, 0]
            b += blocks[slot, 2] if turned else blocks[slot, 1]
            c += blocks[slot, 1] if turned else blocks[slot, 2]
            d += blocks[slot, 3]
        return (a, b, c, d)

    def spatial(blocks: Any, entries: Any, first: Any, last: Any, dim: Any) -> Any:
        a = b = c = d = e = f = g = h = i = 0.0
        for t in range(first, last):
            slot = entries[t] >> 1
            a += blocks[slot, 0]
            e += blocks[slot, 4]
            i += blocks[slot, 8]
            if entries[t] & 1:
                b += blocks[slot, 3]
                c += blocks[slot, 6]
                d += blocks[slot, 1]
                f += blocks[slot, 7]
                g += blocks[slot, 2]
                h += blocks[slot, 5]
            else:
                b += blocks[slot, 1]
                c += blocks[slot, 2]
                d += blocks[slot, 3]
                f += blocks[slot, 5]
                g += blocks[slot, 6]
                h += blocks[slot, 7]
        return (a, b, c, d, e, f, g, h, i)

    return planar if len(dim) == 2 else spatial


@njit(parallel=True)
def sum_blocks(
    blocks: Any,
    row_offsets: Any,
    columns: Any,
    mirrors: Any,
    offsets: Any,
    entries: Any,
    diagonal: Any,
    scalars: Any,
    free: Any,
    n_owned: Any,
    dim: Any,
    values: Any,
) -> None:
    """Sum Hessian blocks into the values of a CSR matrix over degrees of freedom.

    Each pair of nodes is summed once, by one of its two rows, and written to both places.

    Parameters
    ----------
    blocks : (n_slots, d*d)
        Blocks of all cells.
    row_offsets : (n_nodes + 1,)
        Row offsets of the CSR pattern over nodes.
    columns : (n_blocks,)
        Its columns.
    mirrors : (n_blocks,)
        For block (i, j) the number of block (j, i).
    offsets, entries
        For each block of the pattern the slots that add to it, as 2 * slot, plus 1 where the transpose is meant.
    diagonal : (n_nodes, d*d)
        Symmetric blocks that belong to one node, added at owned nodes.
    scalars : (n_blocks,) or (0,)
        Multiples of the identity to add to each block (consistent mass), or empty.
    free : (n_nodes, d) uint8
        0 where a degree of freedom is prescribed: its row and column become those of a diagonal matrix.
    n_owned : int
        Nodes whose diagonal this rank contributes.
    dim : tuple
        Its length is the dimension.
    values : (n_values,)
        Result, in CSR order of the degrees of freedom.
    """
    d = len(dim)
    for i in prange(row_offsets.shape[0] - 1):
        n_row = row_offsets[i + 1] - row_offsets[i]
        for k in range(row_offsets[i], row_offsets[i + 1]):
            j = columns[k]
            # Whichever row a pair falls to, both threads get as many.
            if i != j and (j > i) == (((i + j) & 1) == 1):
                continue
            B = _gather(blocks, entries, offsets[k], offsets[k + 1], dim)
            n_column = row_offsets[j + 1] - row_offsets[j]
            place = d * d * row_offsets[i] + d * (k - row_offsets[i])
            mirror = d * d * row_offsets[j] + d * (mirrors[k] - row_offsets[j])
            for c in range(d):
                for m in range(d):
                    value = B[d * c + m]
                    if c == m and scalars.shape[0] > 0:
                        value += scalars[k]
                    if i == j and i < n_owned:
                        value += diagonal[i, d * c + m]
                    if free[i, c] == 0 or free[j, m] == 0:
                        if i == j and c == m and i < n_owned:
                            # The diagonal keeps its own size, so that scaling and preconditioners see nothing odd; but
                            # across rods and membranes it may be zero, and exact Hessians may make it negative.
                            own = abs(value)
                            value = own if own > 0.0 else 1.0
                        else:
                            value = 0.0
                    values[place + c * d * n_row + m] = value
                    values[mirror + m * d * n_column + c] = value
