"""Kernels that move the nodes of one colour by the forces and matrices that have been summed for them."""

from __future__ import annotations

from typing import Any

from femdeform.jit import njit, prange
from solvers.position_based.obstacle_kernels import solve_masked, step_in_contact

# Nodes that one thread takes at a time.
CHUNK = 256


@njit(parallel=True)
def find_steps(
    first: Any,
    last: Any,
    weights: Any,
    centers: Any,
    loads: Any,
    free: Any,
    relaxation: Any,
    at_once: Any,
    x: Any,
    acc: Any,
    steps: Any,
) -> None:
    """Solve A s = f at the nodes from first to last and empty their accumulator.

    Parameters
    ----------
    first, last : int
        Places of the nodes of one colour.
    weights, centers, loads : (n_nodes,), (3 n_nodes,), (3 n_nodes,)
        See `NodalTerms`.
    free : (3 n_nodes,) uint8
        0 where a component is prescribed.
    relaxation : float
        Factor of every step.
    at_once : bool
        Move the nodes; else only leave the steps.
    x, acc, steps : (3 n_nodes,), (9 n_nodes,), (3 n_nodes,)
        Positions [m], forces and matrices, steps [m].
    """
    for c in prange((last - first + CHUNK - 1) // CHUNK):
        for i in range(first + c * CHUNK, min(first + (c + 1) * CHUNK, last)):
            p, o, w = 3 * i, 9 * i, weights[i]
            s = solve_masked(
                (
                    acc[o] + loads[p] + w * (centers[p] - x[p]),
                    acc[o + 1] + loads[p + 1] + w * (centers[p + 1] - x[p + 1]),
                    acc[o + 2] + loads[p + 2] + w * (centers[p + 2] - x[p + 2]),
                    acc[o + 3] + w,
                    acc[o + 4] + w,
                    acc[o + 5] + w,
                    acc[o + 6],
                    acc[o + 7],
                    acc[o + 8],
                ),
                free[p] != 0,
                free[p + 1] != 0,
                free[p + 2] != 0,
            )
            for k in range(9):
                acc[o + k] = 0.0
            for k in range(3):
                steps[p + k] = relaxation * s[k]
                if at_once:
                    x[p + k] += steps[p + k]


@njit(parallel=True)
def find_steps_in_contact(
    first: Any,
    last: Any,
    weights: Any,
    centers: Any,
    loads: Any,
    free: Any,
    relaxation: Any,
    rows: Any,
    kinds: Any,
    shapes: Any,
    shifts: Any,
    slips: Any,
    stiffness: Any,
    limits: Any,
    starts: Any,
    normals: Any,
    x: Any,
    acc: Any,
    steps: Any,
) -> None:
    """As `find_steps` without moving, for scenes with obstacles; their arrays are those of `ObstacleData`."""
    for c in prange((last - first + CHUNK - 1) // CHUNK):
        for i in range(first + c * CHUNK, min(first + (c + 1) * CHUNK, last)):
            p, o, w = 3 * i, 9 * i, weights[i]
            y = (x[p], x[p + 1], x[p + 2])
            terms = (
                acc[o] + loads[p] + w * (centers[p] - y[0]),
                acc[o + 1] + loads[p + 1] + w * (centers[p + 1] - y[1]),
                acc[o + 2] + loads[p + 2] + w * (centers[p + 2] - y[2]),
                acc[o + 3] + w,
                acc[o + 4] + w,
                acc[o + 5] + w,
                acc[o + 6],
                acc[o + 7],
                acc[o + 8],
            )
            f0, f1, f2 = free[p] != 0, free[p + 1] != 0, free[p + 2] != 0
            for k in range(9):
                acc[o + k] = 0.0
            if rows[i] < 0:
                s = solve_masked(terms, f0, f1, f2)
                for k in range(3):
                    steps[p + k] = relaxation * s[k]
            else:
                # An extrapolated step would end inside the obstacle.
                s = step_in_contact(
                    terms,
                    y,
                    f0,
                    f1,
                    f2,
                    rows[i],
                    kinds,
                    shapes,
                    shifts,
                    slips,
                    stiffness,
                    limits,
                    starts,
                    normals,
                )
                for k in range(3):
                    steps[p + k] = s[k]


@njit(parallel=True)
def take_steps(first: Any, last: Any, parts: Any, steps: Any, x: Any) -> None:
    """Move the nodes from first to last by a part of their steps; the parts become one again."""
    for c in prange((last - first + CHUNK - 1) // CHUNK):
        for i in range(first + c * CHUNK, min(first + (c + 1) * CHUNK, last)):
            for k in range(3):
                x[3 * i + k] += parts[i] * steps[3 * i + k]
            parts[i] = 1.0
