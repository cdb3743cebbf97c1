"""Muscle fibres: the passive and active tension that a bundle of fibres adds to the law of the matrix around it."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from femdeform.jit import njit, prange

Array = NDArray[Any]

# Passive tension 0.05 (exp(6.6 (q - 1)) - 1) beyond the optimal length, and its integral.
_PASSIVE, _EXPONENT = 0.05, 6.6
# Values of the integral of the active curve where it passes from one piece to the next.
_ACTIVE_OFFSET, _ACTIVE_FULL = 248.0 / 375.0, 254.0 / 375.0


class MuscleFibre(NamedTuple):
    """Psi = sigma (p(q) + activation a(q)), q = |F v| / l_o, along the unit vector v of the reference state.

    The tension dPsi/dl is ``sigma / l_o (p' + activation a')`` with Blemker's force-length curves

    - a' = 9 (q - 0.4)^2 from 0.4, 1 - 4 (q - 1)^2 from 0.6, 9 (q - 1.6)^2 from 1.4 to 1.6, else 0: it is 1 at the
      optimal length q = 1;
    - p' = 0.05 (exp(6.6 (q - 1)) - 1) for q > 1, else 0.

    P = dPsi/dl n (x) v with n = F v / |F v|.

    Parameters
    ----------
    stress : float
        sigma, the largest isometric stress: the true stress along active fibres of optimal length [Pa].
    optimal_stretch : float
        l_o, the stretch at which fibres are of optimal length [-].
    activation : float
        From 0 to 1 [-].

    References
    ----------
    S. S. Blemker, P. M. Pinsky, S. L. Delp, "A 3D model of muscle reveals the causes of nonuniform strains in the
    biceps brachii", Journal of Biomechanics 38(4), 2005, for the curves; Y. Chen et al., "Primal extended position
    based dynamics for hyperelasticity", 2023, appendix C.1.3, eqs. (C.30), (C.31), for their integrals, here with the
    constants that make them continuous, and with the activation on the active part (eq. 5.6 has it on the passive
    one).

    Limitations
    -----------
    Once continuously differentiable: d2Psi/dl2 jumps at q = 0.6, 1 and 1.4. Active fibres longer than l_o soften, so a
    muscle may have several equilibria there. The passive curve has no linear branch: it grows exponentially. No
    tension under compression, no dependence on speed.
    """

    stress: float
    optimal_stretch: float
    activation: float


@njit
def fibre_energy(stretch: float, fibre: MuscleFibre) -> float:
    """Return Psi at a stretch [J/m^3]; without activation 0 up to l_o."""
    q = stretch / fibre.optimal_stretch
    t = q - 1.0
    passive = 0.0
    if t > 0.0:
        passive = _PASSIVE / _EXPONENT * math.expm1(_EXPONENT * t) - _PASSIVE * t
    active = 0.0
    if q > 1.6:
        active = _ACTIVE_FULL
    elif q > 1.4:
        u = q - 1.6
        active = _ACTIVE_FULL + 3.0 * u * u * u
    elif q > 0.6:
        active = q - _ACTIVE_OFFSET - 4.0 / 3.0 * t * t * t
    elif q > 0.4:
        u = q - 0.4
        active = 3.0 * u * u * u
    return fibre.stress * (passive + fibre.activation * active)


@njit
def fibre_derivatives(stretch: float, fibre: MuscleFibre) -> tuple[float, float]:
    """Return (dPsi/dl, d2Psi/dl2) at a stretch [Pa]; at a jump of the second one, that of the shorter side."""
    q = stretch / fibre.optimal_stretch
    t = q - 1.0
    first = second = 0.0
    if t > 0.0:
        first = _PASSIVE * math.expm1(_EXPONENT * t)
        second = _PASSIVE * _EXPONENT * math.exp(_EXPONENT * t)
    a = fibre.activation
    if q > 1.6:
        pass
    elif q > 1.4:
        u = q - 1.6
        first += a * 9.0 * u * u
        second += a * 18.0 * u
    elif q > 0.6:
        first += a * (1.0 - 4.0 * t * t)
        second -= a * 8.0 * t
    elif q > 0.4:
        u = q - 0.4
        first += a * 9.0 * u * u
        second += a * 18.0 * u
    scale = fibre.stress / fibre.optimal_stretch
    return scale * first, scale / fibre.optimal_stretch * second


@njit
def fibre_force(y: tuple[float, float, float], fibre: MuscleFibre) -> tuple[float, float, float]:
    """Return dPsi/dy at y = F v: the tension times the direction of y [Pa]; 0 at y = 0. In 2D y_2 = 0."""
    length = math.sqrt(y[0] * y[0] + y[1] * y[1] + y[2] * y[2])
    tension, _ = fibre_derivatives(length, fibre)
    k = tension / length if tension > 0.0 else 0.0 * tension
    return (k * y[0], k * y[1], k * y[2])


@njit
def fibre_stiffness(y: tuple[float, float, float], fibre: MuscleFibre, project: bool) -> Any:
    """Return d2Psi/dy2 = T' n n^T + T/l (I - n n^T) at y = F v as (00, 11, 22, 12, 02, 01) [Pa].

    The tension T is never negative, so the matrix is positive semi-definite with T' cut off at 0 (`project`). The
    tangent is ``dP_ab/dF_cd = B_ac v_b v_d`` with this matrix B, and has no other eigenvalues but zeros.
    """
    length = math.sqrt(y[0] * y[0] + y[1] * y[1] + y[2] * y[2])
    tension, slope = fibre_derivatives(length, fibre)
    if not tension > 0.0:
        zero = 0.0 * tension
        return (zero, zero, zero, zero, zero, zero)
    if project and slope < 0.0:
        slope = 0.0 * slope
    return axial_matrix(y, slope, tension / length)


@njit
def axial_matrix(y: tuple[float, float, float], along: float, across: float) -> Any:
    """Return along n n^T + across (I - n n^T), n being the direction of y, which is not 0; see `fibre_stiffness`."""
    k = (along - across) / (y[0] * y[0] + y[1] * y[1] + y[2] * y[2])
    a, b, c = k * y[0], k * y[1], k * y[2]
    return (across + a * y[0], across + b * y[1], across + c * y[2], b * y[2], a * y[2], a * y[1])


# ---------------------------------------------------------------------------------------- arrays


@njit(parallel=True)
def _energies(Y: Array, fibre: MuscleFibre, out: Array) -> None:
    for k in prange(Y.shape[0]):
        out[k] = fibre_energy(math.sqrt(Y[k, 0] * Y[k, 0] + Y[k, 1] * Y[k, 1] + Y[k, 2] * Y[k, 2]), fibre)


@njit(parallel=True)
def _forces(Y: Array, fibre: MuscleFibre, out: Array) -> None:
    for k in prange(Y.shape[0]):
        f = fibre_force((Y[k, 0], Y[k, 1], Y[k, 2]), fibre)
        out[k, 0], out[k, 1], out[k, 2] = f[0], f[1], f[2]


@njit(parallel=True)
def _stiffnesses(Y: Array, fibre: MuscleFibre, project: bool, out: Array) -> None:
    for k in prange(Y.shape[0]):
        B = fibre_stiffness((Y[k, 0], Y[k, 1], Y[k, 2]), fibre, project)
        for i in range(6):
            out[k, i] = B[i]


def fibre_forces(Y: Array, fibre: MuscleFibre) -> Array:
    """Return T(l) y / l of stretched directions y = F v (n, 3), l = |y| [Pa], (n, 3)."""
    out = np.empty_like(Y)
    _forces(Y, fibre, out)
    return out


def _stretched(F: ArrayLike, v: ArrayLike) -> tuple[Array, Array]:
    """Unit directions (n, d) and F v with three components (n, 3)."""
    gradients, directions = np.asarray(F, dtype=np.float64), np.asarray(v, dtype=np.float64)
    if gradients.ndim != 3 or gradients.shape[1:] not in ((2, 2), (3, 3)) or directions.shape != gradients.shape[:2]:
        raise ValueError(
            f"F and v must have the shapes (n, d, d) and (n, d), got {gradients.shape}, {directions.shape}"
        )
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    Y = np.zeros((len(gradients), 3))
    Y[:, : gradients.shape[1]] = np.einsum("nij,nj->ni", gradients, directions)
    return directions, Y


def energy_density(F: ArrayLike, v: ArrayLike, fibre: MuscleFibre) -> Array:
    """Return the energy density of fibres.

    Parameters
    ----------
    F : (n, d, d) array_like
        Deformation gradients, d = 2 or 3.
    v : (n, d) array_like
        Fibre directions in the reference state, of any length.
    fibre : MuscleFibre
        Parameters of the fibres, the same for all.

    Returns
    -------
    (n,) ndarray
        [J/m^3].

    Raises
    ------
    ValueError
        If the shapes do not fit.
    """
    _, Y = _stretched(F, v)
    out = np.empty(len(Y))
    _energies(Y, fibre, out)
    return out


def pk1(F: ArrayLike, v: ArrayLike, fibre: MuscleFibre) -> Array:
    """Return the first Piola-Kirchhoff stress of fibres [Pa], (n, d, d); see `energy_density`."""
    directions, Y = _stretched(F, v)
    out = fibre_forces(Y, fibre)
    return np.asarray(out[:, : directions.shape[1], None] * directions[:, None, :])


def tangent(F: ArrayLike, v: ArrayLike, fibre: MuscleFibre, projected: bool = False) -> Array:
    """Return H_abcd = d2Psi/dF_ab dF_cd [Pa], (n, d, d, d, d), made positive semi-definite if `projected`."""
    directions, Y = _stretched(F, v)
    d = directions.shape[1]
    six = np.empty((len(Y), 6))
    _stiffnesses(Y, fibre, projected, six)
    B = six[:, [[0, 5, 4], [5, 1, 3], [4, 3, 2]]][:, :d, :d]
    return np.asarray(np.einsum("nac,nb,nd->nabcd", B, directions, directions))
