"""Kernels of XPBD and B-PXPBD: one visit to every cell of a colour.

Cells of a colour share no node: each thread writes to its own corners, so the result does not depend on the number of
threads. Positions lie in an array with `stride` numbers a node: x (3), the inverse mass w [1/kg], and where the
method needs it the base point b (3) and one number unused. In 2D the third components are not used.

With s = h^2 V k and the multiplier l [kg m^2], XPBD's step of one constraint is

    dl = -(s C + l) / (s D : D K + 1),    M = D dl,

which is ``-(C + a l) / (sum w |grad C|^2 + a)`` with a = alpha / h^2 = 1 / s, also for k = 0. PBD is the limit of
infinite stiffness, where s and l drop out.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.jit import njit, prange
from solvers.position_based.cell_algebra import combine, dot, load, store, times
from solvers.position_based.cell_corners import deformation, mobility, spread
from solvers.position_based.chunk_rotations import CHUNK, get, make_scratch, put, rotate, rotation_of
from solvers.position_based.constraints import (
    root_constraint,
    rotation,
    shear_constraint,
    stiffnesses,
    volume_constraint,
)


@njit
def _step_length(C: Any, slope: Any, s: Any, multiplier: Any, rigid: Any) -> Any:
    """Change of the multiplier of a constraint with D : D K = slope."""
    if rigid:
        return -C / slope if slope > 0.0 else 0.0 * C
    return -(s * C + multiplier) / (s * slope + 1.0)


@njit(parallel=True)
def project_pairs(
    first: Any,
    last: Any,
    corners: Any,
    gradients: Any,
    volumes: Any,
    masks: Any,
    law: Any,
    dim: Any,
    h2: Any,
    epsilon: Any,
    rigid: Any,
    reverse: Any,
    x: Any,
    multipliers: Any,
) -> None:
    """XPBD on the pair of constraints of each cell from first to last, one after the other.

    Parameters
    ----------
    first, last : int
        Cells of one colour.
    corners : (n_cells, dim + 1) uint32
        Where each corner's numbers begin in x.
    gradients : (n_cells, dim dim)
        Gradients of the shape functions of all corners but the first [1/m].
    volumes : (n_cells,)
        Rest volumes [m^3].
    masks : (n_cells, (dim + 1) dim) or ()
        0 where a component of a corner is prescribed.
    law : NamedTuple
        The law, one of `constraints.PAIRED`.
    dim : tuple
        Its length is the dimension.
    h2 : float
        Square of the time step [s^2].
    epsilon : float
        See `shear_constraint`.
    rigid : bool
        PBD: infinite stiffness, no multipliers.
    reverse : bool
        Volume before shear.
    x : (n_nodes stride,)
        See the module.
    multipliers : (n_cells, 2)
        [kg m^2].
    """
    k1, k2 = stiffnesses(law)
    for c in prange((last - first + CHUNK - 1) // CHUNK):
        begin, n = first + c * CHUNK, min(CHUNK, last - first - c * CHUNK)
        scratch = make_scratch(dim)
        for j in range(n):
            put(j, deformation(begin + j, 0, corners, gradients, dim, x), scratch)
        if not reverse:
            rotate(n, scratch, law, dim)
        for j in range(n):
            e = begin + j
            F = get(j, scratch, dim)
            K = mobility(e, corners, gradients, masks, dim, x)
            scale = h2 * volumes[e]
            M = combine(F, 0.0, F, 0.0)
            for turn in range(2):
                if (turn == 0) != reverse:
                    R = rotation(F) if reverse else rotation_of(j, F, scratch, law)
                    C, D = shear_constraint(F, R, law, epsilon)
                    s, which = scale * k1, 0
                else:
                    C, D = volume_constraint(F, law)
                    s, which = scale * k2, 1
                if s > 0.0:
                    DK = times(D, K)
                    step = _step_length(C, dot(D, DK), s, multipliers[e, which], rigid)
                    F = combine(F, 1.0, DK, step)
                    M = combine(M, 1.0, D, step)
                    multipliers[e, which] += step
            spread(e, 0, 0.0, M, corners, gradients, masks, dim, x)


@njit(parallel=True)
def project_roots(
    first: Any,
    last: Any,
    corners: Any,
    gradients: Any,
    volumes: Any,
    masks: Any,
    law: Any,
    dim: Any,
    h2: Any,
    epsilon: Any,
    x: Any,
    multipliers: Any,
) -> None:
    """XPBD on the one constraint ``sqrt(2 Psi/mu)`` of each cell; see `project_pairs`."""
    for c in prange((last - first + CHUNK - 1) // CHUNK):
        for e in range(first + c * CHUNK, min(first + (c + 1) * CHUNK, last)):
            F = deformation(e, 0, corners, gradients, dim, x)
            K = mobility(e, corners, gradients, masks, dim, x)
            C, D = root_constraint(F, law, epsilon)
            slope = dot(D, times(D, K))
            step = _step_length(C, slope, h2 * volumes[e] * law.mu, multipliers[e, 0], False)
            multipliers[e, 0] += step
            spread(e, 0, 0.0, combine(D, step, D, 0.0), corners, gradients, masks, dim, x)


@njit(parallel=True)
def project_blended(
    first: Any,
    last: Any,
    corners: Any,
    gradients: Any,
    volumes: Any,
    masks: Any,
    law: Any,
    dim: Any,
    h2: Any,
    epsilon: Any,
    zeta: Any,
    keep: Any,
    x: Any,
    multipliers: Any,
    forces: Any,
) -> None:
    """B-PXPBD on the pair of constraints of each cell.

    With the base point ``b = x~ + w S`` of each node, S the sum of multipliers times gradients as they were when their
    cells were last visited, r = b - x vanishes where the primary residual does. A visit first replaces what the cell
    has in S, then takes for each constraint ``x += w D g dl + (1 - zeta) r``, and puts the rest in S.

    Parameters
    ----------
    first, last, corners, gradients, volumes, masks, law, dim, h2, epsilon, x, multipliers
        See `project_pairs`.
    zeta : (n_cells,)
        Part of XPBD.
    keep : bool
        Instead keep the primary residual in the step of the multiplier (eq. 5.11): a comparison, with zeta = 0.
    forces : (n_cells, dim dim)
        ``sum_c l_c D_c`` of each cell as it is in S [kg m^2].
    """
    k1, k2 = stiffnesses(law)
    for c in prange((last - first + CHUNK - 1) // CHUNK):
        begin, n = first + c * CHUNK, min(CHUNK, last - first - c * CHUNK)
        scratch = make_scratch(dim)
        states = np.empty((3 * CHUNK, len(dim) * len(dim)))
        for j in range(n):
            put(j, deformation(begin + j, 0, corners, gradients, dim, x), scratch)
        rotate(n, scratch, law, dim)
        for j in range(n):
            e = begin + j
            F = get(j, scratch, dim)
            base = deformation(e, 4, corners, gradients, dim, x)
            K = mobility(e, corners, gradients, masks, dim, x)
            old = load(e, forces, dim)
            C, D = shear_constraint(F, rotation_of(j, F, scratch, law), law, epsilon)
            _, W = volume_constraint(F, law)
            held = combine(D, multipliers[e, 0], W, multipliers[e, 1])
            # r = b - x as sum r g^T; `left` w g is what is left of the changes of S by this visit.
            left = combine(held, 1.0, old, -1.0)
            R = combine(combine(base, 1.0, F, -1.0), 1.0, times(left, K), 1.0)
            s, which = h2 * volumes[e] * k1, 0
            F, R, held, left = _blend(e, which, s, C, D, F, R, held, left, K, zeta[e], keep, multipliers)
            put(j, F, scratch)
            store(3 * j, R, states)
            store(3 * j + 1, held, states)
            store(3 * j + 2, left, states)
        rotate(n, scratch, law, dim)
        for j in range(n):
            e = begin + j
            F = get(j, scratch, dim)
            K = mobility(e, corners, gradients, masks, dim, x)
            R, held, left = load(3 * j, states, dim), load(3 * j + 1, states, dim), load(3 * j + 2, states, dim)
            _, E = shear_constraint(F, rotation_of(j, F, scratch, law), law, epsilon)
            C, D = volume_constraint(F, law)
            change = combine(combine(E, multipliers[e, 0], D, multipliers[e, 1]), 1.0, held, -1.0)
            held = combine(held, 1.0, change, 1.0)
            left = combine(left, 1.0, change, 1.0)
            R = combine(R, 1.0, times(change, K), 1.0)
            s, which = h2 * volumes[e] * k2, 1
            F, R, held, left = _blend(e, which, s, C, D, F, R, held, left, K, zeta[e], keep, multipliers)
            change = combine(held, 1.0, load(e, forces, dim), -1.0)
            # x becomes b - r: b changes by w `change` g, and zeta^2 of the former r is left beside `left`.
            rest = zeta[e] * zeta[e]
            spread(e, 0, 1.0 - rest, combine(change, 1.0, left, -1.0), corners, gradients, masks, dim, x)
            spread(e, 4, 0.0, change, corners, gradients, masks, dim, x)
            store(e, held, forces)


@njit
def _blend(
    e: Any,
    which: Any,
    s: Any,
    C: Any,
    D: Any,
    F: Any,
    R: Any,
    held: Any,
    left: Any,
    K: Any,
    z: Any,
    keep: Any,
    multipliers: Any,
) -> Any:
    """One blended step of a constraint: what F, r, the forces in S and the part of their change in r become."""
    DK = times(D, K)
    value = C + dot(D, R) if keep else C
    step = _step_length(value, dot(D, DK), s, multipliers[e, which], False)
    multipliers[e, which] += step
    F = combine(combine(F, 1.0, DK, step), 1.0, R, 1.0 - z)
    return F, combine(R, z, R, 0.0), combine(held, 1.0, D, step), combine(left, z, left, 0.0)
