"""Compiled loops over blocks of grid nodes: sorting points by their block, and bringing blocks together.

A block owns `SIDE`^dim nodes. Its points reach `SIDE` + 2 nodes an axis; what they bring is summed in an array of the
block's own, which nobody else writes to, and each node then adds up the arrays it is in, in a fixed order. So there is
no race, and no sum depends on the number of threads.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.jit import njit, prange

# Nodes an axis that a block owns, and that its points reach.
SIDE = 4
REACH = SIDE + 2
# Points that one thread takes at a time.
CHUNK = 4096


@njit(parallel=True)
def blocks_of(x: Any, spacing: Any, first: Any, shape: Any, low: Any, high: Any, out: Any, is_bad: Any) -> None:
    """Number of the block of each point, in a table of blocks; row-major.

    Parameters
    ----------
    x : (n, dim)
        [m].
    spacing : float
        [m].
    first : (dim,) float64
        Index of the first node of block 0.
    shape : (dim,) int64
        Blocks of the table.
    low, high : (dim,) float64
        The domain [m].
    out : (n,) int32
        Receives the numbers.
    is_bad : (n_chunks,) uint8
        Receives 1 where a point of a chunk is outside of the domain, or not a number.
    """
    inverse = 1.0 / spacing
    for chunk in prange(is_bad.size):
        bad = 0
        for p in range(chunk * CHUNK, min((chunk + 1) * CHUNK, x.shape[0])):
            number = 0
            for a in range(x.shape[1]):
                if not (x[p, a] >= low[a] and x[p, a] <= high[a]):
                    bad = 1
                    number = 0
                    break
                number = number * shape[a] + int(x[p, a] * inverse - 0.5 - first[a]) // SIDE
            out[p] = number
        is_bad[chunk] = bad


@njit
def sort_by_block(numbers: Any, counts: Any, touched: Any, starts: Any, order: Any) -> int:
    """Stable order of points by block.

    Parameters
    ----------
    numbers : (n,) int32
        Block of each point.
    counts : (n_table,) int32
        All zero before and after.
    touched : (n,) int32
        Receives the blocks with points, ascending.
    starts : (n + 1,) int64
        Receives where the points of each of them begin.
    order : (n,) int32
        Receives the points, block after block.

    Returns
    -------
    int
        Number of blocks with points.
    """
    n_blocks = 0
    for p in range(numbers.size):
        k = numbers[p]
        if counts[k] == 0:
            touched[n_blocks] = k
            n_blocks += 1
        counts[k] += 1
    touched[:n_blocks].sort()
    position = 0
    for b in range(n_blocks):
        k = touched[b]
        starts[b] = position
        position += counts[k]
        counts[k] = starts[b]
    starts[n_blocks] = position
    for p in range(numbers.size):
        k = numbers[p]
        order[counts[k]] = p
        counts[k] += 1
    for b in range(n_blocks):
        counts[touched[b]] = 0
    return n_blocks


@njit(parallel=True)
def order_in_blocks(numbers: Any, starts: Any, order: Any) -> None:
    """Sort the points of each block by their numbers: how they lie in memory then has no part in any sum.

    They nearly are in order as they come, so each is inserted among those before it.
    """
    for b in prange(starts.size - 1):
        for t in range(starts[b] + 1, starts[b + 1]):
            p = order[t]
            number = numbers[p]
            k = t
            while k > starts[b] and numbers[order[k - 1]] > number:
                order[k] = order[k - 1]
                k -= 1
            order[k] = p


@njit(parallel=True)
def collect(arena: Any, parts: Any, places: Any, floor: Any, push: Any, adds: Any, mass: Any, velocity: Any) -> None:
    """Add up what the blocks hold at each node, and divide momenta by masses.

    Parameters
    ----------
    arena : (n_blocks, REACH^dim, dim + 1)
        Momenta [kg m/s] and, last, masses [kg].
    parts : (n_node_blocks, 2^dim) int32
        Blocks that reach into a block of nodes, -1 for none.
    places : (SIDE^dim, 2^dim) int32
        Place of a node in each of those, -1 where they do not reach it.
    floor : float
        Nodes with less mass have no velocity [kg].
    push : (dim,)
        Added to the velocity of every node [m/s].
    adds : bool
        The arena holds impulses, which change the velocities; masses stay.
    mass, velocity : (n_node_blocks, SIDE^dim), (n_node_blocks, SIDE^dim, dim)
        Results [kg], [m/s].
    """
    T = arena.dtype.type
    dim = velocity.shape[2]
    for n in prange(parts.shape[0]):
        total = np.empty(dim + 1, arena.dtype)
        for i in range(places.shape[0]):
            for c in range(dim + 1):
                total[c] = T(0.0)
            for o in range(places.shape[1]):
                a, q = parts[n, o], places[i, o]
                if a >= 0 and q >= 0:
                    for c in range(dim + 1):
                        total[c] += arena[a, q, c]
            if not adds:
                mass[n, i] = total[dim]
            m = mass[n, i]
            for c in range(dim):
                if m > floor:
                    before = velocity[n, i, c] if adds else T(0.0)
                    velocity[n, i, c] = before + total[c] / m + push[c]
                else:
                    velocity[n, i, c] = T(0.0)


@njit
def load_block(velocity: Any, near: Any, a: Any, sources: Any, local: Any) -> None:
    """Copy the velocities of the nodes that the points of block `a` reach into `local` (REACH^dim, dim).

    `near` (n_blocks, 2^dim) are the blocks of nodes, `sources` (REACH^dim, 2) which of them and which node there.
    """
    for q in range(local.shape[0]):
        n, i = near[a, sources[q, 0]], sources[q, 1]
        for c in range(local.shape[1]):
            local[q, c] = velocity[n, i, c]


@njit
def spline(f: Any, one: Any, row: Any, table: Any) -> None:
    """Write weights, slopes times the spacing and weighted offsets of one axis to rows `row`, row + 1, row + 2.

    ``f`` in [1/2, 3/2) is the place after the first of the three nodes, in spacings; `one` is 1 of the type to use.
    """
    half = one / (one + one)
    a, b, c = one + half - f, f - one, f - half
    table[row, 0], table[row, 1], table[row, 2] = half * a * a, half + half * half - b * b, half * c * c
    table[row + 1, 0], table[row + 1, 1], table[row + 1, 2] = -a, -(b + b), c
    table[row + 2, 0] = -f * table[row, 0]
    table[row + 2, 1] = -b * table[row, 1]
    table[row + 2, 2] = (one + one - f) * table[row, 2]
