"""What the multipliers or stresses of cells hold, and what they lack: the two residuals of XPBD, cell by cell."""

from __future__ import annotations

from typing import Any

from femdeform.jit import njit, prange
from solvers.position_based.cell_algebra import combine, load, store
from solvers.position_based.cell_corners import deformation
from solvers.position_based.chunk_numbers import CHUNK
from solvers.position_based.constraints import (
    root_constraint,
    rotation,
    shear_constraint,
    stiffnesses,
    stress,
    volume_constraint,
)


@njit(parallel=True)
def measure_pairs(
    corners: Any,
    gradients: Any,
    volumes: Any,
    law: Any,
    dim: Any,
    h2: Any,
    epsilon: Any,
    x: Any,
    multipliers: Any,
    held: Any,
    missing: Any,
) -> None:
    """``sum_c l_c D_c`` and ``sum_c (s_c C_c + l_c) D_c`` of each cell (n_cells, dim dim) [kg m^2].

    See `constraint_kernels.project_pairs`; D are derivatives at the present F.
    """
    k1, k2 = stiffnesses(law)
    n = volumes.shape[0]
    for c in prange((n + CHUNK - 1) // CHUNK):
        for e in range(c * CHUNK, min((c + 1) * CHUNK, n)):
            F = deformation(e, 0, corners, gradients, dim, x)
            C, D = shear_constraint(F, rotation(F), law, epsilon)
            B, W = volume_constraint(F, law)
            s = h2 * volumes[e]
            l1, l2 = multipliers[e, 0], multipliers[e, 1]
            store(e, combine(D, l1, W, l2), held)
            store(e, combine(D, s * k1 * C + l1, W, s * k2 * B + l2), missing)


@njit(parallel=True)
def measure_roots(
    corners: Any,
    gradients: Any,
    volumes: Any,
    law: Any,
    dim: Any,
    h2: Any,
    epsilon: Any,
    x: Any,
    multipliers: Any,
    held: Any,
    missing: Any,
) -> None:
    """As `measure_pairs`, of the one constraint of `constraint_kernels.project_roots`."""
    n = volumes.shape[0]
    for c in prange((n + CHUNK - 1) // CHUNK):
        for e in range(c * CHUNK, min((c + 1) * CHUNK, n)):
            C, D = root_constraint(deformation(e, 0, corners, gradients, dim, x), law, epsilon)
            store(e, combine(D, multipliers[e, 0], D, 0.0), held)
            store(e, combine(D, h2 * volumes[e] * law.mu * C + multipliers[e, 0], D, 0.0), missing)


@njit(parallel=True)
def measure_stresses(
    corners: Any,
    gradients: Any,
    volumes: Any,
    law: Any,
    dim: Any,
    h2: Any,
    x: Any,
    stresses: Any,
    held: Any,
    missing: Any,
) -> None:
    """``-h^2 V P`` of each cell's stress P, and ``h^2 V (P(F) - P)`` (n_cells, dim dim) [kg m^2]."""
    n = volumes.shape[0]
    for c in prange((n + CHUNK - 1) // CHUNK):
        for e in range(c * CHUNK, min((c + 1) * CHUNK, n)):
            F = deformation(e, 0, corners, gradients, dim, x)
            P, known = stress(F, rotation(F), law), load(e, stresses, dim)
            s = h2 * volumes[e]
            store(e, combine(known, -s, known, 0.0), held)
            store(e, combine(P, s, known, -s), missing)
