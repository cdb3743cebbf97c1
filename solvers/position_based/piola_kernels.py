"""Kernels of FP-PXPBD: a cell and its stress at a time, and a node at an obstacle.

The unknowns are the stress P of each cell and the positions. What a cell can do to its corners is ``x_i = b_i - w_i h^2
V P g_i``, b_i being the base point ``x~ - w h^2 q`` of the corner without the cell's own part, q the sum of V P g over
the cells. Its problem is therefore one in F:

    F + s P(F) K = B,    s = h^2 V,  B = sum_i b_i g_i^T,

Newton's method on it, with the tangent C, is ``dF + s C:dF K = B - F - s P K`` and the stress ``P + C:dF``. That is the
same step as the published one in the affine basis (b, dF) of the cell's four corners, and it stays right where corners
are prescribed. With ``C = a I + c W (x) W`` it has the closed form (Sherman, Morrison)

    dF = (R - s c t W K) N,    N = (I + s a K)^-1,    t = W : R N / (1 + s c W : W K N).

Positions and base points lie as in `constraint_kernels`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.jit import njit, prange
from femdeform.materials.dispatch import energy_density, tangent
from solvers.position_based.cell_algebra import combine, dot, load, resolvent, store, times
from solvers.position_based.cell_corners import deformation, misfit, mobility, spread
from solvers.position_based.chunk_numbers import CHUNK, MATRIX, MOBILITY, get_matrix, get_mobility, make_scratch, put
from solvers.position_based.chunk_rotations import FURTHER, rotate, rotation_of
from solvers.position_based.constraints import stress, stress_model
from solvers.position_based.inlining import inlined
from solvers.position_based.obstacle_kernels import step_in_contact

# Halvings of a cell's step after which it waits for its neighbours.
_HALVINGS = 20
# Part of the energies of a cell that is rounding.
_ROUNDING = 1e-15
# Rows of a chunk's scratch behind those of `chunk_rotations`: K, s, B, the stress reached, the share that the former
# positions have; with a line search how far those are from the base points, and the same as a matrix.
_F = 0
_K = FURTHER
_S = _K + MOBILITY
_B = _S + 1
_REACHED = _B + MATRIX
_PART = _REACHED + MATRIX
_FAR = _PART + 1
_Q = _FAR + 1
_ROWS = _Q + MATRIX


@inlined
def model_step(F: Any, P: Any, R: Any, K: Any, s: Any, law: Any) -> Any:
    """dF and the stress at its end, with the definite model of the tangent."""
    a, c, W = stress_model(F, law)
    N = resolvent(K, s * a)
    RN = times(R, N)
    WK = times(W, K)
    WKN = times(WK, N)
    t = dot(W, RN) / (1.0 + s * c * dot(W, WKN))
    dF = combine(RN, 1.0, WKN, -s * c * t)
    return dF, combine(combine(P, 1.0, dF, a), 1.0, W, c * t)


@njit
def exact_step(F: Any, P: Any, R: Any, K: Any, s: Any, law: Any, dim: Any, H: Any, A: Any, r: Any) -> Any:
    """dF and the stress at its end, with the tangent made positive semi-definite.

    H and A are scratch, (n, n) with n = dim dim; so is r, (2, n).
    """
    tangent(F, law, True, H)
    n = H.shape[0]
    for j in range(n):
        column = times(load(j, H, dim), K)
        for i in range(n):
            A[i, j] = s * column[i]
        A[j, j] += 1.0
    store(0, R, r)
    solve_dense(A, r[0])
    for i in range(n):
        r[1, i] = P[i]
        for j in range(n):
            r[1, i] += H[i, j] * r[0, j]
    return load(0, r, dim), load(1, r, dim)


@njit
def solve_dense(A: Any, b: Any) -> None:
    """Solve A y = b by elimination with row exchanges; A is overwritten, b becomes y."""
    n = b.size
    for k in range(n):
        p = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[p, k]):
                p = i
        if p != k:
            for j in range(k, n):
                A[k, j], A[p, j] = A[p, j], A[k, j]
            b[k], b[p] = b[p], b[k]
        for i in range(k + 1, n):
            f = A[i, k] / A[k, k]
            for j in range(k + 1, n):
                A[i, j] -= f * A[k, j]
            b[i] -= f * b[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            b[k] -= A[k, j] * b[j]
        b[k] /= A[k, k]


@njit
def _local_energy(part: Any, P: Any, F: Any, far: Any, Q: Any, K: Any, s: Any, law: Any) -> Any:
    """h^2 times the energy of a cell and of its corners' inertia, and the size of its terms; see `relax_cells`."""
    inertia = 0.5 * (part * part * far + s * s * dot(P, times(P, K))) - part * s * dot(P, Q)
    elastic = s * energy_density(F, law)
    return inertia + elastic, abs(inertia) + abs(elastic)


@njit(parallel=True)
def relax_cells(
    first: Any,
    last: Any,
    corners: Any,
    gradients: Any,
    volumes: Any,
    masks: Any,
    law: Any,
    dim: Any,
    h2: Any,
    local: Any,
    exact: Any,
    search: Any,
    x: Any,
    stresses: Any,
) -> None:
    """Steps of Newton's method on the cells from first to last, each by itself with its corners.

    After a step the corners are at ``x_i = part x_i + (1 - part) b_i - w_i s P g_i``, x_i on the right being where they
    were before the visit: one number and one matrix hold where they are, and their inertia follows from sums over
    the corners made once.

    Parameters
    ----------
    first, last, corners, gradients, volumes, masks, law, dim, h2
        See `constraint_kernels.project_pairs`.
    local : int
        Steps.
    exact : bool
        Use the projected tangent instead of its model.
    search : bool
        Halve a step until the energy of the cell and of its corners' inertia does not rise.
    x : (n_nodes 8,)
        See `constraint_kernels`.
    stresses : (n_cells, dim dim)
        P of each cell as it is in the base points [Pa].
    """
    size = len(dim) * len(dim) if exact else 0
    for c in prange((last - first + CHUNK - 1) // CHUNK):
        begin, n = first + c * CHUNK, min(CHUNK, last - first - c * CHUNK)
        H, A, r = np.empty((size, size)), np.empty((size, size)), np.empty((2, size))
        scratch = make_scratch(_ROWS)
        for j in range(n):
            e = begin + j
            s = h2 * volumes[e]
            F = deformation(e, 0, corners, gradients, dim, x)
            base = deformation(e, 4, corners, gradients, dim, x)
            K = mobility(e, corners, gradients, masks, dim, x)
            held = load(e, stresses, dim)
            B = combine(base, 1.0, times(held, K), s)
            put(_F, j, F, scratch)
            put(_K, j, K, scratch)
            put(_B, j, B, scratch)
            scratch[_S * CHUNK + j], scratch[_PART * CHUNK + j] = s, 1.0
            if search:
                put(_Q, j, combine(F, 1.0, B, -1.0), scratch)
                scratch[_FAR * CHUNK + j] = misfit(e, s, held, corners, gradients, masks, dim, x)
        for _ in range(local):
            rotate(n, scratch, law, dim)
            if exact or search:
                _careful_steps(n, exact, search, law, masks, dim, scratch, H, A, r)
            else:
                _model_steps(n, law, masks, dim, scratch)
        rotate(n, scratch, law, dim)
        _take_stresses(n, law, dim, scratch)
        for j in range(n):
            e = begin + j
            s, part = scratch[_S * CHUNK + j], scratch[_PART * CHUNK + j]
            held, reached = load(e, stresses, dim), get_matrix(_REACHED, j, scratch, dim)
            P = get_matrix(_B, j, scratch, dim)
            move = combine(held, s * (1.0 - part), reached, -s)
            spread(e, 0, 1.0 - part, move, corners, gradients, masks, dim, x)
            spread(e, 4, 0.0, combine(held, s, P, -s), corners, gradients, masks, dim, x)
            store(e, P, stresses)


@inlined
def _residual(j: Any, F: Any, P: Any, K: Any, s: Any, dim: Any, scratch: Any) -> Any:
    """``B - F - s P K`` of a cell."""
    return combine(combine(get_matrix(_B, j, scratch, dim), 1.0, F, -1.0), 1.0, times(P, K), -s)


@njit
def _model_steps(n: Any, law: Any, masks: Any, dim: Any, scratch: Any) -> None:
    """A whole step with the model of the tangent for all cells of a chunk."""
    for j in range(n):
        F, K, s = get_matrix(_F, j, scratch, dim), get_mobility(_K, j, scratch, masks, dim), scratch[_S * CHUNK + j]
        P = stress(F, rotation_of(j, F, scratch, law), law)
        dF, ahead = model_step(F, P, _residual(j, F, P, K, s, dim, scratch), K, s, law)
        scratch[_PART * CHUNK + j] = 0.0
        put(_REACHED, j, ahead, scratch)
        put(_F, j, combine(F, 1.0, dF, 1.0), scratch)


@njit
def _careful_steps(
    n: Any, exact: Any, search: Any, law: Any, masks: Any, dim: Any, scratch: Any, H: Any, A: Any, r: Any
) -> None:
    """A step for all cells of a chunk, with the exact tangent, or halved where the energy rises, or both."""
    for j in range(n):
        F, K, s = get_matrix(_F, j, scratch, dim), get_mobility(_K, j, scratch, masks, dim), scratch[_S * CHUNK + j]
        P = stress(F, rotation_of(j, F, scratch, law), law)
        R = _residual(j, F, P, K, s, dim, scratch)
        if exact:
            dF, ahead = exact_step(F, P, R, K, s, law, dim, H, A, r)
        else:
            dF, ahead = model_step(F, P, R, K, s, law)
        part, reached, t = scratch[_PART * CHUNK + j], get_matrix(_REACHED, j, scratch, dim), 1.0
        if search:
            far, Q = scratch[_FAR * CHUNK + j], get_matrix(_Q, j, scratch, dim)
            t = _admissible(part, reached, ahead, F, dF, far, Q, K, s, law)
        scratch[_PART * CHUNK + j] = part * (1.0 - t)
        put(_REACHED, j, combine(reached, 1.0 - t, ahead, t), scratch)
        put(_F, j, combine(F, 1.0, dF, t), scratch)


@njit
def _take_stresses(n: Any, law: Any, dim: Any, scratch: Any) -> None:
    """P(F) of all cells of a chunk, in place of B."""
    for j in range(n):
        F = get_matrix(_F, j, scratch, dim)
        put(_B, j, stress(F, rotation_of(j, F, scratch, law), law), scratch)


@njit
def _admissible(
    part: Any, reached: Any, ahead: Any, F: Any, dF: Any, far: Any, Q: Any, K: Any, s: Any, law: Any
) -> Any:
    """Largest of 1, 1/2, 1/4, ... of a step that does not raise the cell's energy; see `relax_cells`."""
    before, scale = _local_energy(part, reached, F, far, Q, K, s, law)
    t = 1.0
    for _ in range(_HALVINGS):
        tried = combine(reached, 1.0 - t, ahead, t)
        after, _ = _local_energy((1.0 - t) * part, tried, combine(F, 1.0, dF, t), far, Q, K, s, law)
        if after <= before + _ROUNDING * scale:
            return t
        t *= 0.5
    return 0.0


# ---------------------------------------------------------------------------------------- nodes


@njit(parallel=True)
def touch_obstacles(
    nodes: Any,
    rows: Any,
    blend: Any,
    has_base: Any,
    h2: Any,
    free: Any,
    stride: Any,
    kinds: Any,
    shapes: Any,
    shifts: Any,
    slips: Any,
    stiffness: Any,
    limits: Any,
    starts: Any,
    normals: Any,
    x: Any,
    forces: Any,
) -> None:
    """Let nodes at obstacles find where inertia and the exact penalty and friction balance.

    The force of contact is the multiplier of the node: without it the node would be at ``x - w h^2 f``, and with the
    base point, which f is part of, at ``b - w h^2 f``; the two are blended.

    Parameters
    ----------
    nodes : (n,) int64
        Places of the nodes that may touch something.
    rows : (n,) int64
        Their rows in the arrays of `ObstacleData`.
    blend : float
        Part of x; the rest is the base point's.
    has_base : bool
        Whether base points are kept.
    h2 : float
        [s^2].
    free : (n, 3) uint8
        0 where a component is prescribed.
    stride : int
        Numbers a node.
    kinds, shapes, shifts, slips, stiffness, limits, starts, normals
        See `ObstacleData`.
    x : (n_nodes stride,)
        See `constraint_kernels`.
    forces : (n, 3)
        Force of contact on each node [N].
    """
    for i in prange(nodes.size):
        p = stride * nodes[i]
        w = x[p + 3]
        if w == 0.0:
            continue
        m = 1.0 / (w * h2)
        y0, y1, y2 = x[p] - forces[i, 0] / m, x[p + 1] - forces[i, 1] / m, x[p + 2] - forces[i, 2] / m
        if has_base:
            y0 = blend * y0 + (1.0 - blend) * (x[p + 4] - forces[i, 0] / m)
            y1 = blend * y1 + (1.0 - blend) * (x[p + 5] - forces[i, 1] / m)
            y2 = blend * y2 + (1.0 - blend) * (x[p + 6] - forces[i, 2] / m)
        # From where the node is: near convergence the energies do not cancel.
        y = (x[p], x[p + 1], x[p + 2])
        zero = 0.0 * m
        s = step_in_contact(
            (m * (y0 - y[0]), m * (y1 - y[1]), m * (y2 - y[2]), m, m, m, zero, zero, zero),
            y,
            free[i, 0] != 0,
            free[i, 1] != 0,
            free[i, 2] != 0,
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
        away = (y[0] + s[0] - y0, y[1] + s[1] - y1, y[2] + s[2] - y2)
        for k in range(3):
            if free[i, k] != 0:
                force = m * away[k]
                x[p + k] = y[k] + s[k]
                if has_base:
                    x[p + 4 + k] += (force - forces[i, k]) / m
                forces[i, k] = force
