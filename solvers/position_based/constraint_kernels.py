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

from femdeform.jit import njit, prange
from solvers.position_based.cell_algebra import combine, dot, load, store, times
from solvers.position_based.cell_corners import deformation, mobility, spread
from solvers.position_based.chunk_numbers import CHUNK, MATRIX, MOBILITY, get_matrix, get_mobility, make_scratch, put
from solvers.position_based.chunk_rotations import FURTHER, rotate, rotation_of
from solvers.position_based.constraints import (
    root_constraint,
    shear_constraint,
    stiffnesses,
    volume_constraint,
)
from solvers.position_based.inlining import inlined

# Rows of a chunk's scratch behind those of `chunk_rotations`: K, h^2 V, both multipliers, then M for XPBD; for B-PXPBD
# zeta and the matrices r, `held` and `left`, see `project_blended`.
_F = 0
_K = FURTHER
_SCALE = _K + MOBILITY
_L = _SCALE + 1
_M = _L + 2
_XPBD_ROWS = _M + MATRIX
_ZETA = _L + 2
_RES, _HELD, _LEFT = _ZETA + 1, _ZETA + 1 + MATRIX, _ZETA + 1 + 2 * MATRIX
_BLENDED_ROWS = _LEFT + MATRIX


@inlined
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
        scratch = make_scratch(_XPBD_ROWS)
        for j in range(n):
            e = begin + j
            put(_K, j, mobility(e, corners, gradients, masks, dim, x), scratch)
            put(_F, j, deformation(e, 0, corners, gradients, dim, x), scratch)
            scratch[_SCALE * CHUNK + j] = h2 * volumes[e]
            scratch[_L * CHUNK + j], scratch[(_L + 1) * CHUNK + j] = multipliers[e, 0], multipliers[e, 1]
        for turn in range(2):
            if (turn == 0) != reverse:
                rotate(n, scratch, law, dim)
                if k1 > 0.0:
                    _meet_shear(n, k1, law, epsilon, rigid, masks, dim, scratch)
            elif k2 > 0.0:
                _meet_volume(n, k2, law, rigid, masks, dim, scratch)
        for j in range(n):
            e = begin + j
            multipliers[e, 0], multipliers[e, 1] = scratch[_L * CHUNK + j], scratch[(_L + 1) * CHUNK + j]
            spread(e, 0, 0.0, get_matrix(_M, j, scratch, dim), corners, gradients, masks, dim, x)


@njit
def _meet_shear(n: Any, k: Any, law: Any, epsilon: Any, rigid: Any, masks: Any, dim: Any, scratch: Any) -> None:
    """XPBD's step of the first constraint of all cells of a chunk."""
    for j in range(n):
        F = get_matrix(_F, j, scratch, dim)
        C, D = shear_constraint(F, rotation_of(j, F, scratch, law), law, epsilon)
        _meet(j, _L, k, C, D, F, rigid, masks, dim, scratch)


@njit
def _meet_volume(n: Any, k: Any, law: Any, rigid: Any, masks: Any, dim: Any, scratch: Any) -> None:
    """XPBD's step of the second constraint of all cells of a chunk."""
    for j in range(n):
        F = get_matrix(_F, j, scratch, dim)
        C, D = volume_constraint(F, law)
        _meet(j, _L + 1, k, C, D, F, rigid, masks, dim, scratch)


@inlined
def _meet(j: Any, row: Any, k: Any, C: Any, D: Any, F: Any, rigid: Any, masks: Any, dim: Any, scratch: Any) -> None:
    """One step of XPBD on a constraint of a cell: F, M and the multiplier in that row change."""
    DK = times(D, get_mobility(_K, j, scratch, masks, dim))
    multiplier = scratch[row * CHUNK + j]
    step = _step_length(C, dot(D, DK), scratch[_SCALE * CHUNK + j] * k, multiplier, rigid)
    scratch[row * CHUNK + j] = multiplier + step
    put(_F, j, combine(F, 1.0, DK, step), scratch)
    put(_M, j, combine(get_matrix(_M, j, scratch, dim), 1.0, D, step), scratch)


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
        scratch = make_scratch(_BLENDED_ROWS)
        for j in range(n):
            e = begin + j
            F = deformation(e, 0, corners, gradients, dim, x)
            base = deformation(e, 4, corners, gradients, dim, x)
            put(_K, j, mobility(e, corners, gradients, masks, dim, x), scratch)
            put(_F, j, F, scratch)
            # r = b - x as sum r g^T; `left` w g is what is left of the changes of S by this visit.
            put(_RES, j, combine(base, 1.0, F, -1.0), scratch)
            put(_LEFT, j, load(e, forces, dim), scratch)
            scratch[_SCALE * CHUNK + j], scratch[_ZETA * CHUNK + j] = h2 * volumes[e], zeta[e]
            scratch[_L * CHUNK + j], scratch[(_L + 1) * CHUNK + j] = multipliers[e, 0], multipliers[e, 1]
        rotate(n, scratch, law, dim)
        _blend_shear(n, k1, law, epsilon, keep, masks, dim, scratch)
        rotate(n, scratch, law, dim)
        _blend_volume(n, k2, law, epsilon, keep, masks, dim, scratch)
        for j in range(n):
            e = begin + j
            multipliers[e, 0], multipliers[e, 1] = scratch[_L * CHUNK + j], scratch[(_L + 1) * CHUNK + j]
            held, left = get_matrix(_HELD, j, scratch, dim), get_matrix(_LEFT, j, scratch, dim)
            change = combine(held, 1.0, load(e, forces, dim), -1.0)
            store(e, held, forces)
            # x becomes b - r: b changes by w `change` g, and zeta^2 of the former r is left beside `left`.
            rest = zeta[e] * zeta[e]
            spread(e, 0, 1.0 - rest, combine(change, 1.0, left, -1.0), corners, gradients, masks, dim, x)
            spread(e, 4, 0.0, change, corners, gradients, masks, dim, x)


@njit
def _blend_shear(n: Any, k: Any, law: Any, epsilon: Any, keep: Any, masks: Any, dim: Any, scratch: Any) -> None:
    """Replace what each cell of a chunk has in S, then the blended step of its first constraint."""
    for j in range(n):
        F, old = get_matrix(_F, j, scratch, dim), get_matrix(_LEFT, j, scratch, dim)
        C, D = shear_constraint(F, rotation_of(j, F, scratch, law), law, epsilon)
        _, W = volume_constraint(F, law)
        held = combine(D, scratch[_L * CHUNK + j], W, scratch[(_L + 1) * CHUNK + j])
        _blend(j, _L, k, C, D, F, held, combine(held, 1.0, old, -1.0), old, keep, masks, dim, scratch)


@njit
def _blend_volume(n: Any, k: Any, law: Any, epsilon: Any, keep: Any, masks: Any, dim: Any, scratch: Any) -> None:
    """Replace what each cell has in S now that F has changed, then the blended step of its second constraint."""
    for j in range(n):
        F, old = get_matrix(_F, j, scratch, dim), get_matrix(_HELD, j, scratch, dim)
        _, E = shear_constraint(F, rotation_of(j, F, scratch, law), law, epsilon)
        C, D = volume_constraint(F, law)
        held = combine(E, scratch[_L * CHUNK + j], D, scratch[(_L + 1) * CHUNK + j])
        left = combine(combine(get_matrix(_LEFT, j, scratch, dim), 1.0, held, 1.0), 1.0, old, -1.0)
        _blend(j, _L + 1, k, C, D, F, held, left, old, keep, masks, dim, scratch)


@inlined
def _blend(
    j: Any,
    row: Any,
    k: Any,
    C: Any,
    D: Any,
    F: Any,
    held: Any,
    left: Any,
    old: Any,
    keep: Any,
    masks: Any,
    dim: Any,
    scratch: Any,
) -> None:
    """One blended step of a constraint: F, r, what the cell has in S, and the part of its change that is in r.

    r first follows the replacement of `old` by `held`.
    """
    K, z = get_mobility(_K, j, scratch, masks, dim), scratch[_ZETA * CHUNK + j]
    R = combine(get_matrix(_RES, j, scratch, dim), 1.0, times(combine(held, 1.0, old, -1.0), K), 1.0)
    DK = times(D, K)
    value = C + dot(D, R) if keep else C
    multiplier = scratch[row * CHUNK + j]
    step = _step_length(value, dot(D, DK), scratch[_SCALE * CHUNK + j] * k, multiplier, False)
    scratch[row * CHUNK + j] = multiplier + step
    put(_F, j, combine(combine(F, 1.0, DK, step), 1.0, R, 1.0 - z), scratch)
    put(_RES, j, combine(R, z, R, 0.0), scratch)
    put(_HELD, j, combine(held, 1.0, D, step), scratch)
    put(_LEFT, j, combine(left, z, left, 0.0), scratch)
