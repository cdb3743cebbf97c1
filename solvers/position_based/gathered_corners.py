"""Cells with any number of corners, as those of bodies embedded in a grid: what `cell_corners` does at their corners.

The corners of cell e are the entries ``offsets[e]`` to ``offsets[e + 1]`` of `places`, `gradients` (n_entries, dim)
and, where single components are prescribed, `masks` (n_entries, dim). Each function here gives the implementation of
one of `cell_corners`, for a dimension.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from femdeform.jit import njit, types
from femdeform.types import IntArray


class GatheredCorners(NamedTuple):
    """Where the numbers of the corners of each cell begin.

    Attributes
    ----------
    offsets : (n_cells + 1,) int64
        First corner of each cell.
    places : (n_entries,) uint32
        Where the numbers of each corner begin.
    """

    offsets: IntArray
    places: np.ndarray[Any, np.dtype[np.uint32]]


def is_gathered(corners: Any) -> bool:
    """Whether numba's type of `corners` is that of `GatheredCorners`."""
    return isinstance(corners, types.BaseNamedTuple) and corners.instance_class is GatheredCorners


class StoredVisits(NamedTuple):
    """Visits of nodes to cells whose deformation is kept, since too many nodes decide it to make it anew each time.

    Attributes
    ----------
    cells : (n_visits,) uint32
        Cell of each visit.
    deformations : (n_cells, dim dim)
        F of each cell at the present positions.
    """

    cells: np.ndarray[Any, np.dtype[np.uint32]]
    deformations: np.ndarray[Any, np.dtype[np.float64]]


def is_stored(others: Any) -> bool:
    """Whether numba's type of `others` is that of `StoredVisits`."""
    return isinstance(others, types.BaseNamedTuple) and others.instance_class is StoredVisits


def gathered_visit(dim: int) -> Any:
    """See `node_kernels.visit_deformation`."""

    def spatial(x: Any, i: Any, others: Any, gradients: Any, v: Any, dim: Any) -> Any:
        F, e = others.deformations, others.cells[v]
        n = (gradients[0, v], gradients[1, v], gradients[2, v])
        return (F[e, 0], F[e, 1], F[e, 2], F[e, 3], F[e, 4], F[e, 5], F[e, 6], F[e, 7], F[e, 8]), n

    def planar(x: Any, i: Any, others: Any, gradients: Any, v: Any, dim: Any) -> Any:
        F, e = others.deformations, others.cells[v]
        return (F[e, 0], F[e, 1], F[e, 2], F[e, 3]), (gradients[0, v], gradients[1, v])

    return spatial if dim == 3 else planar


# ---------------------------------------------------------------------------------------- deformation


def gathered_deformation(dim: int) -> Any:
    """See `cell_corners.deformation`; positions are taken from the first corner, gradients add up to zero."""

    def spatial(e: Any, shift: Any, corners: Any, gradients: Any, dim: Any, x: Any) -> Any:
        a = b = c = d = f = g = h = i = j = 0.0
        first, last = corners.offsets[e], corners.offsets[e + 1]
        o = corners.places[first] + shift
        o0, o1, o2 = x[o], x[o + 1], x[o + 2]
        for t in range(first + 1, last):
            p = corners.places[t] + shift
            d0, d1, d2 = x[p] - o0, x[p + 1] - o1, x[p + 2] - o2
            g0, g1, g2 = gradients[t, 0], gradients[t, 1], gradients[t, 2]
            a += d0 * g0
            b += d0 * g1
            c += d0 * g2
            d += d1 * g0
            f += d1 * g1
            g += d1 * g2
            h += d2 * g0
            i += d2 * g1
            j += d2 * g2
        return (a, b, c, d, f, g, h, i, j)

    def planar(e: Any, shift: Any, corners: Any, gradients: Any, dim: Any, x: Any) -> Any:
        a = b = c = d = 0.0
        first, last = corners.offsets[e], corners.offsets[e + 1]
        o = corners.places[first] + shift
        o0, o1 = x[o], x[o + 1]
        for t in range(first + 1, last):
            p = corners.places[t] + shift
            d0, d1 = x[p] - o0, x[p + 1] - o1
            g0, g1 = gradients[t, 0], gradients[t, 1]
            a += d0 * g0
            b += d0 * g1
            c += d1 * g0
            d += d1 * g1
        return (a, b, c, d)

    return spatial if dim == 3 else planar


# ---------------------------------------------------------------------------------------- mobility


@njit
def _sum_3d(first: Any, last: Any, places: Any, gradients: Any, x: Any) -> Any:
    a = b = c = d = e = f = 0.0
    for t in range(first, last):
        w = x[places[t] + 3]
        g0, g1, g2 = gradients[t, 0], gradients[t, 1], gradients[t, 2]
        a += w * g0 * g0
        b += w * g1 * g1
        c += w * g2 * g2
        d += w * g1 * g2
        e += w * g0 * g2
        f += w * g0 * g1
    return (a, b, c, d, e, f)


@njit
def _sum_masked_3d(row: Any, first: Any, last: Any, places: Any, gradients: Any, masks: Any, x: Any) -> Any:
    a = b = c = d = e = f = 0.0
    for t in range(first, last):
        w = x[places[t] + 3] * masks[t, row]
        g0, g1, g2 = gradients[t, 0], gradients[t, 1], gradients[t, 2]
        a += w * g0 * g0
        b += w * g1 * g1
        c += w * g2 * g2
        d += w * g1 * g2
        e += w * g0 * g2
        f += w * g0 * g1
    return (a, b, c, d, e, f)


@njit
def _sum_2d(first: Any, last: Any, places: Any, gradients: Any, x: Any) -> Any:
    a = b = c = 0.0
    for t in range(first, last):
        w = x[places[t] + 3]
        g0, g1 = gradients[t, 0], gradients[t, 1]
        a += w * g0 * g0
        b += w * g1 * g1
        c += w * g0 * g1
    return (a, b, c)


@njit
def _sum_masked_2d(row: Any, first: Any, last: Any, places: Any, gradients: Any, masks: Any, x: Any) -> Any:
    a = b = c = 0.0
    for t in range(first, last):
        w = x[places[t] + 3] * masks[t, row]
        g0, g1 = gradients[t, 0], gradients[t, 1]
        a += w * g0 * g0
        b += w * g1 * g1
        c += w * g0 * g1
    return (a, b, c)


def gathered_mobility(dim: int, masked: bool) -> Any:
    """See `cell_corners.mobility`."""

    def spatial(e: Any, corners: Any, gradients: Any, masks: Any, dim: Any, x: Any) -> Any:
        return _sum_3d(corners.offsets[e], corners.offsets[e + 1], corners.places, gradients, x)

    def planar(e: Any, corners: Any, gradients: Any, masks: Any, dim: Any, x: Any) -> Any:
        return _sum_2d(corners.offsets[e], corners.offsets[e + 1], corners.places, gradients, x)

    def spatial_masked(e: Any, corners: Any, gradients: Any, masks: Any, dim: Any, x: Any) -> Any:
        first, last = corners.offsets[e], corners.offsets[e + 1]
        return (
            _sum_masked_3d(0, first, last, corners.places, gradients, masks, x),
            _sum_masked_3d(1, first, last, corners.places, gradients, masks, x),
            _sum_masked_3d(2, first, last, corners.places, gradients, masks, x),
        )

    def planar_masked(e: Any, corners: Any, gradients: Any, masks: Any, dim: Any, x: Any) -> Any:
        first, last = corners.offsets[e], corners.offsets[e + 1]
        return (
            _sum_masked_2d(0, first, last, corners.places, gradients, masks, x),
            _sum_masked_2d(1, first, last, corners.places, gradients, masks, x),
        )

    if dim == 3:
        return spatial_masked if masked else spatial
    return planar_masked if masked else planar


# ---------------------------------------------------------------------------------------- spread and misfit


def gathered_spread(dim: int, masked: bool) -> Any:
    """See `cell_corners.spread`."""

    def implementation(
        e: Any, shift: Any, keep: Any, M: Any, corners: Any, gradients: Any, masks: Any, dim: Any, x: Any
    ) -> None:
        d = len(dim)
        for t in range(corners.offsets[e], corners.offsets[e + 1]):
            p = corners.places[t]
            w = x[p + 3]
            if w == 0.0:
                continue
            for a in range(d):
                push = 0.0
                for b in range(d):
                    push += M[d * a + b] * gradients[t, b]
                if masked:
                    push *= masks[t, a]
                push *= w
                if keep != 0.0:
                    push += keep * (x[p + 4 + a] - x[p + a])
                x[p + shift + a] += push

    return implementation


def gathered_misfit(dim: int, masked: bool) -> Any:
    """See `cell_corners.misfit`."""

    def implementation(e: Any, s: Any, P: Any, corners: Any, gradients: Any, masks: Any, dim: Any, x: Any) -> Any:
        d = len(dim)
        total = 0.0
        for t in range(corners.offsets[e], corners.offsets[e + 1]):
            p = corners.places[t]
            w = x[p + 3]
            if w > 0.0:
                for a in range(d):
                    push = 0.0
                    for b in range(d):
                        push += P[d * a + b] * gradients[t, b]
                    if masked:
                        push *= masks[t, a]
                    away = x[p + a] - x[p + 4 + a] - s * w * push
                    total += away * away / w
        return total

    return implementation
