"""Solid points that a step has crushed: their volume falls to a tenth or less, or they are turned inside out."""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.jit import njit, prange
from femdeform.materials.small_matrix import det_2d, det_3d
from femdeform.mpm.particles import SOLID, Particles
from femdeform.mpm.point_potential import SMALLEST_J


def count_crushed(before: Particles, after: Particles) -> int:
    """Solid points with det F after a step that is not positive, or at most a tenth of that before it.

    Parameters
    ----------
    before, after : Particles
        The same points, in the same order. Of those that are solid after the step F is looked at; one that is not
        finite counts.
    """
    found = np.zeros(after.n, dtype=np.bool_)
    solid = after.phase == SOLID
    if not solid.any():
        return 0
    size = after.dim**2
    kernel = _crushed_2d if after.dim == 2 else _crushed_3d
    kernel(
        np.ascontiguousarray(before.F).reshape(-1, size),
        np.ascontiguousarray(after.F).reshape(-1, size),
        solid,
        SMALLEST_J,
        found,
    )
    return int(np.count_nonzero(found))


@njit(parallel=True)
def _crushed_2d(before: Any, after: Any, solid: Any, least: float, found: Any) -> None:
    for p in prange(solid.size):
        if solid[p]:
            J0 = det_2d((before[p, 0], before[p, 1], before[p, 2], before[p, 3]))
            J1 = det_2d((after[p, 0], after[p, 1], after[p, 2], after[p, 3]))
            found[p] = not (J1 > 0.0 and least * J0 < J1)


@njit(parallel=True)
def _crushed_3d(before: Any, after: Any, solid: Any, least: float, found: Any) -> None:
    for p in prange(solid.size):
        if solid[p]:
            F, G = before[p], after[p]
            J0 = det_3d((F[0], F[1], F[2], F[3], F[4], F[5], F[6], F[7], F[8]))
            J1 = det_3d((G[0], G[1], G[2], G[3], G[4], G[5], G[6], G[7], G[8]))
            found[p] = not (J1 > 0.0 and least * J0 < J1)
