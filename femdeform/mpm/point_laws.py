"""Energies of single points of a liquid, a solid and a surface, with their stresses and tangents, in compiled loops.

All of them are functions of ``D = F - B`` (see `mpm.point_kernels`); results are times the volume or area of the
point. The surface energy is ``k |dA| a(F)`` with ``a(F) = |cof(F) n|``, ``a = |F t|`` in 2D and ``|F t1 x F t2|`` in 3D
for unit tangents at n; optionally of the symmetric part of F, whose stress is symmetric: such forces have no torque
about the positions before the step, and backward Euler keeps the angular momentum.

References
----------
D. Hyde, S. Gagniere, A. Marquez-Razon, J. Teran, An implicit updated Lagrangian formulation for liquids with large
surface energy (2020).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from femdeform.jit import extending, njit, prange
from femdeform.materials.dispatch import combined, energy_density, pk1, tangent

# ------------------------------------------------------------------------------------------------ liquids


@njit(parallel=True)
def liquid_energies(D: Any, rows: Any, bulk: Any, J: Any, volume: Any, beta: Any, dim: Any, out: Any) -> None:
    """``bulk/2 (J (1 + tr D) - 1)^2 V0 + beta/2 |sym D|^2`` [J].

    Parameters
    ----------
    D : (n_points, dim^2)
        [-].
    rows : (n,) int64
        Points of the liquid.
    bulk : (n_points,)
        Bulk modulus [Pa].
    J, volume : (n_points,)
        Volume ratio before the step [-], volume at rest [m^3].
    beta : (n_points,)
        ``2 viscosity J volume / h`` [J].
    dim : tuple
        Its length is the dimension.
    out : (n_points,)
        Receives the energies of these points.
    """
    d = len(dim)
    for t in prange(rows.shape[0]):
        q = rows[t]
        trace, square = 0.0, 0.0
        for a in range(d):
            trace += D[q, (d + 1) * a]
            for b in range(d):
                square += (0.5 * (D[q, d * a + b] + D[q, d * b + a])) ** 2
        change = (J[q] - 1.0) + J[q] * trace
        out[q] = 0.5 * bulk[q] * volume[q] * change * change + 0.5 * beta[q] * square


@njit(parallel=True)
def liquid_stresses(D: Any, rows: Any, bulk: Any, J: Any, volume: Any, beta: Any, dim: Any, out: Any) -> None:
    """``bulk (J (1 + tr D) - 1) J V0 I + beta sym D`` [J]; see `liquid_energies`."""
    d = len(dim)
    for t in prange(rows.shape[0]):
        q = rows[t]
        trace = 0.0
        for a in range(d):
            trace += D[q, (d + 1) * a]
        pressure = bulk[q] * ((J[q] - 1.0) + J[q] * trace) * J[q] * volume[q]
        for a in range(d):
            for b in range(d):
                value = 0.5 * beta[q] * (D[q, d * a + b] + D[q, d * b + a])
                out[q, d * a + b] = value + pressure if a == b else value


# ------------------------------------------------------------------------------------------------- solids


def _total(D: Any, base: Any, q: Any, dim: Any) -> Any:
    """``base + D`` of a point, as a flat row-major tuple."""
    raise NotImplementedError("compiled code only")


@extending.overload(_total)
def _total_compiled(D: Any, base: Any, q: Any, dim: Any) -> Any:
    def planar(D: Any, base: Any, q: Any, dim: Any) -> Any:
        return (base[q, 0] + D[q, 0], base[q, 1] + D[q, 1], base[q, 2] + D[q, 2], base[q, 3] + D[q, 3])

    def spatial(D: Any, base: Any, q: Any, dim: Any) -> Any:
        return (
            base[q, 0] + D[q, 0],
            base[q, 1] + D[q, 1],
            base[q, 2] + D[q, 2],
            base[q, 3] + D[q, 3],
            base[q, 4] + D[q, 4],
            base[q, 5] + D[q, 5],
            base[q, 6] + D[q, 6],
            base[q, 7] + D[q, 7],
            base[q, 8] + D[q, 8],
        )

    return planar if len(dim) == 2 else spatial


@njit(parallel=True)
def solid_energies(
    D: Any, base: Any, rows: Any, volume: Any, shear: Any, dilation: Any, moduli: Any, dim: Any, out: Any
) -> None:
    """``volume Psi(base + D)`` [J] of the points `rows`, by any law of `femdeform.materials`.

    Parameters
    ----------
    D, base : (n_points, dim^2)
        [-].
    rows : (n,) int64
        Points of the solid.
    volume : (n_points,)
        At rest [m^3].
    shear, dilation : NamedTuple
        The law with the Lame parameters 1, 0 and with 0, 1.
    moduli : (n_points, 2)
        mu and lmbda [Pa].
    dim : tuple
        Its length is the dimension.
    out : (n_points,)
        Receives the energies of these points.
    """
    for t in prange(rows.shape[0]):
        q = rows[t]
        law = combined(shear, dilation, moduli[q, 0], moduli[q, 1])
        out[q] = volume[q] * energy_density(_total(D, base, q, dim), law)


@njit(parallel=True)
def solid_stresses(
    D: Any, base: Any, rows: Any, volume: Any, shear: Any, dilation: Any, moduli: Any, dim: Any, out: Any
) -> None:
    """``volume dPsi/dF`` [J] into rows of `out` (n_points, dim^2); see `solid_energies`."""
    for t in prange(rows.shape[0]):
        q = rows[t]
        law = combined(shear, dilation, moduli[q, 0], moduli[q, 1])
        P = pk1(_total(D, base, q, dim), law)
        for c in range(len(P)):
            out[q, c] = volume[q] * P[c]


@njit(parallel=True)
def solid_tangents(
    D: Any,
    base: Any,
    rows: Any,
    volume: Any,
    shear: Any,
    dilation: Any,
    moduli: Any,
    dim: Any,
    project: Any,
    place: Any,
    out: Any,
) -> None:
    """``volume d2Psi/dF2`` [J] into `out[place[q]]`, (dim^2, dim^2) each; see `solid_energies`.

    The closest semi-definite one if `project`.
    """
    n = len(dim) * len(dim)
    for t in prange(rows.shape[0]):
        q = rows[t]
        H = out[place[q]]
        law = combined(shear, dilation, moduli[q, 0], moduli[q, 1])
        tangent(_total(D, base, q, dim), law, project, H)
        for i in range(n):
            for j in range(n):
                H[i, j] *= volume[q]


# ----------------------------------------------------------------------------------------------- surfaces


@njit
def _line(D: Any, q: Any, t: Any, r: Any, symmetric: Any) -> Any:
    """F t of a point in the plane."""
    shear, turn = D[q, 1], D[q, 2]
    if symmetric:
        shear = turn = 0.5 * (shear + turn)
    x, y = t[r, 0, 0], t[r, 0, 1]
    return x + (D[q, 0] * x + shear * y), y + (turn * x + D[q, 3] * y)


@njit
def _column(D: Any, q: Any, t: Any, r: Any, k: Any, symmetric: Any) -> Any:
    """F t_k of a point in space."""
    x, y, z = t[r, k, 0], t[r, k, 1], t[r, k, 2]
    xy, xz, yz = D[q, 1], D[q, 2], D[q, 5]
    yx, zx, zy = D[q, 3], D[q, 6], D[q, 7]
    if symmetric:
        xy = yx = 0.5 * (xy + yx)
        xz = zx = 0.5 * (xz + zx)
        yz = zy = 0.5 * (yz + zy)
    return (
        x + (D[q, 0] * x + xy * y + xz * z),
        y + (yx * x + D[q, 4] * y + yz * z),
        z + (zx * x + zy * y + D[q, 8] * z),
    )


@njit
def _cross(a: Any, b: Any) -> Any:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@njit
def _dot(a: Any, b: Any) -> Any:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit
def _make_symmetric(P: Any, q: Any, d: Any) -> None:
    for a in range(d):
        for b in range(a):
            value = 0.5 * (P[q, d * a + b] + P[q, d * b + a])
            P[q, d * a + b] = P[q, d * b + a] = value


@njit
def _make_both_symmetric(C: Any, d: Any) -> None:
    """S C S with S the projection on symmetric matrices."""
    for a in range(d):
        for b in range(a):
            i, j = d * a + b, d * b + a
            for k in range(d * d):
                C[i, k] = C[j, k] = 0.5 * (C[i, k] + C[j, k])
    for a in range(d):
        for b in range(a):
            i, j = d * a + b, d * b + a
            for k in range(d * d):
                C[k, i] = C[k, j] = 0.5 * (C[k, i] + C[k, j])


@njit(parallel=True)
def surface_energies(D: Any, first: Any, tangents: Any, weight: Any, symmetric: Any, out: Any) -> None:
    """``weight a(I + D)`` [J] of the samples, points from `first` on.

    Parameters
    ----------
    D : (n_points, dim^2)
        [-].
    first : int
        Number of the first sample's point.
    tangents : (n_samples, dim - 1, dim)
        Unit tangents, right-handed with the normal in 3D.
    weight : (n_samples,)
        k |dA| [J].
    symmetric : bool
        Take the symmetric part of D.
    out : (n_points,)
        Receives their energies.
    """
    for r in prange(weight.shape[0]):
        q = first + r
        if tangents.shape[2] == 2:
            x, y = _line(D, q, tangents, r, symmetric)
            out[q] = weight[r] * np.sqrt(x * x + y * y)
        else:
            c = _cross(_column(D, q, tangents, r, 0, symmetric), _column(D, q, tangents, r, 1, symmetric))
            out[q] = weight[r] * np.sqrt(_dot(c, c))


@njit(parallel=True)
def surface_stresses(D: Any, first: Any, tangents: Any, weight: Any, symmetric: Any, out: Any) -> None:
    """Derivatives of the energies by D [J] into rows of `out` (n_points, dim^2); see `surface_energies`.

    ``(m/a) t^T`` with m = F t in 2D; ``(m2 x n) t1^T + (n x m1) t2^T`` in 3D.
    """
    for r in prange(weight.shape[0]):
        q = first + r
        if tangents.shape[2] == 2:
            x, y = _line(D, q, tangents, r, symmetric)
            w = weight[r] / np.sqrt(x * x + y * y)
            for b in range(2):
                out[q, b] = w * x * tangents[r, 0, b]
                out[q, 2 + b] = w * y * tangents[r, 0, b]
            if symmetric:
                _make_symmetric(out, q, 2)
        else:
            m1, m2 = _column(D, q, tangents, r, 0, symmetric), _column(D, q, tangents, r, 1, symmetric)
            c = _cross(m1, m2)
            w = weight[r] / np.sqrt(_dot(c, c))
            p1, p2 = _cross(m2, c), _cross(c, m1)
            for a in range(3):
                for b in range(3):
                    out[q, 3 * a + b] = w * (p1[a] * tangents[r, 0, b] + p2[a] * tangents[r, 1, b])
            if symmetric:
                _make_symmetric(out, q, 3)


@njit(parallel=True)
def surface_tangents(
    D: Any, first: Any, tangents: Any, weight: Any, symmetric: Any, project: Any, place: Any, out: Any
) -> None:
    """Second derivatives of the energies by D [J] into `out[place[q]]`, (dim^2, dim^2) each.

    In 2D ``(I - m m^T / a^2)/a`` between the tangent's components, positive semi-definite. In 3D, between the changes
    d1, d2 of m1, m2, ``w_jl n n^T`` with ``w = a ([m1 m2]^T [m1 m2])^-1`` and the form ``d1 x d2 . n``, twice, in the
    plane: its eigenvalues are 1 and -1, twice each. Without the latter it is the closest semi-definite matrix, half of
    the form and half of the identity in the plane; of a negative energy those two are all that is left. With
    `symmetric`, semi-definite if `project` but not the closest.
    """
    for r in prange(weight.shape[0]):
        q = first + r
        C = out[place[q]]
        if tangents.shape[2] == 2:
            x, y = _line(D, q, tangents, r, symmetric)
            size = np.sqrt(x * x + y * y)
            # Of a negative energy nothing is positive.
            x, y, w = x / size, y / size, (0.0 if project and weight[r] < 0.0 else weight[r] / size)
            h00, h01, h11 = w * y * y, -w * x * y, w * x * x
            for b in range(2):
                for e in range(2):
                    t = tangents[r, 0, b] * tangents[r, 0, e]
                    C[b, e], C[b, 2 + e], C[2 + b, e], C[2 + b, 2 + e] = h00 * t, h01 * t, h01 * t, h11 * t
            if symmetric:
                _make_both_symmetric(C, 2)
        else:
            m1, m2 = _column(D, q, tangents, r, 0, symmetric), _column(D, q, tangents, r, 1, symmetric)
            c = _cross(m1, m2)
            area = np.sqrt(_dot(c, c))
            n = (c[0] / area, c[1] / area, c[2] / area)
            w11, w12, w22 = _dot(m2, m2) / area, -_dot(m1, m2) / area, _dot(m1, m1) / area
            form, plane, w = 1.0, 0.0, weight[r]
            if project:
                form, plane = 0.5, 0.5
                if weight[r] < 0.0:
                    form, w = -0.5, -weight[r]
                    w11, w12, w22 = 0.0, 0.0, 0.0
            for a in range(3):
                for k in range(3):
                    across = n[a] * n[k]
                    # -[n]x, the form's block between d1 and d2.
                    spin = 0.0
                    if k == (a + 1) % 3:
                        spin = form * n[(a + 2) % 3]
                    elif a == (k + 1) % 3:
                        spin = -form * n[(k + 2) % 3]
                    flat = plane * ((1.0 if a == k else 0.0) - across)
                    k11, k22 = w11 * across + flat, w22 * across + flat
                    k12, k21 = w12 * across + spin, w12 * across - spin
                    for b in range(3):
                        t1, t2 = w * tangents[r, 0, b], w * tangents[r, 1, b]
                        for e in range(3):
                            s1, s2 = tangents[r, 0, e], tangents[r, 1, e]
                            C[3 * a + b, 3 * k + e] = t1 * (k11 * s1 + k12 * s2) + t2 * (k21 * s1 + k22 * s2)
            if symmetric:
                _make_both_symmetric(C, 3)
