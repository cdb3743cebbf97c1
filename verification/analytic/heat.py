"""Heat in slabs, discs and balls: cooling through the surface by series, slowest modes."""

from __future__ import annotations

from functools import cache

import numpy as np

from femdeform.types import FloatArray

# Roots of the series, by bisection between those of neighbouring functions.
_N_ROOTS = 60


@cache
def slab_roots(biot: float) -> FloatArray:
    """Roots z of ``z tan z = Bi``, ascending."""
    from scipy.optimize import brentq

    return np.array(
        [
            brentq(lambda z: z * np.sin(z) - biot * np.cos(z), n * np.pi, (n + 0.5) * np.pi, xtol=1e-14)
            for n in range(_N_ROOTS)
        ]
    )


@cache
def disc_roots(biot: float) -> FloatArray:
    """Roots z of ``z J1(z) = Bi J0(z)``, ascending."""
    from scipy.optimize import brentq
    from scipy.special import j0, j1, jn_zeros

    # The function has one root between a zero of J1 (or 0) and the next zero of J0.
    lower = np.concatenate([[0.0], jn_zeros(1, _N_ROOTS - 1)])
    upper = jn_zeros(0, _N_ROOTS)
    return np.array(
        [brentq(lambda z: z * j1(z) - biot * j0(z), a, b, xtol=1e-14) for a, b in zip(lower, upper, strict=True)]
    )


def _decay(roots: FloatArray, fourier: float, steps: int | None) -> FloatArray:
    """Factors of the modes: exponentials, or those of so many steps of backward Euler."""
    if steps is None:
        return np.asarray(np.exp(-(roots**2) * fourier))
    return np.asarray((1.0 + roots**2 * fourier / steps) ** -steps)


def cooling_slab(biot: float, fourier: float, place: FloatArray | None = None, steps: int | None = None) -> FloatArray:
    """(T - Tbar) / (T0 - Tbar) of a slab that loses heat on both faces.

    Parameters
    ----------
    biot : float
        h L / K with half the thickness L [-].
    fourier : float
        alpha t / L^2 [-].
    place : (n,) float64, optional
        Distances from the middle over L; the mean over the slab if not given.
    steps : int, optional
        For what backward Euler gives in so many steps; the exact solution if not given.
    """
    z = slab_roots(biot)
    weight = 4.0 * np.sin(z) / (2.0 * z + np.sin(2.0 * z)) * _decay(z, fourier, steps)
    shape = np.sin(z) / z if place is None else np.cos(np.multiply.outer(place, z))
    return np.asarray(shape @ weight)


def cooling_disc(biot: float, fourier: float, place: FloatArray | None = None, steps: int | None = None) -> FloatArray:
    """(T - Tbar) / (T0 - Tbar) of a disc that loses heat at its rim; see `cooling_slab`, L is the radius."""
    from scipy.special import j0, j1

    z = disc_roots(biot)
    weight = 2.0 / z * j1(z) / (j0(z) ** 2 + j1(z) ** 2) * _decay(z, fourier, steps)
    shape = 2.0 * j1(z) / z if place is None else j0(np.multiply.outer(place, z))
    return np.asarray(shape @ weight)


@cache
def ball_roots(biot: float) -> FloatArray:
    """Roots z of ``1 - z cot z = Bi``, ascending."""
    from scipy.optimize import brentq

    def mismatch(z: float) -> float:
        return float((1.0 - biot) * np.sin(z) - z * np.cos(z))

    return np.array([brentq(mismatch, n * np.pi + 1e-6, (n + 1) * np.pi, xtol=1e-14) for n in range(_N_ROOTS)])


def cooling_ball(biot: float, fourier: float, steps: int | None = None) -> float:
    """Mean of (T - Tbar) / (T0 - Tbar) over a ball that loses heat at its surface; see `cooling_slab`."""
    z = ball_roots(biot)
    moment = np.sin(z) - z * np.cos(z)
    weight = 4.0 * moment / (2.0 * z - np.sin(2.0 * z)) * _decay(z, fourier, steps)
    return float(weight @ (3.0 * moment / z**3))


def slowest_odd_disc_root(biot: float) -> float:
    """Smallest z of a disc's modes J1(z r/R) cos(angle), ``z J1'(z) + Bi J1(z) = 0``; they decay as alpha z^2/R^2."""
    from scipy.optimize import brentq
    from scipy.special import jn_zeros, jvp

    def mismatch(z: float) -> float:
        return float(z * jvp(1, z) + biot * jvp(1, z, 0))

    return float(brentq(mismatch, 1e-6, jn_zeros(1, 1)[0], xtol=1e-14))


def stefan_front(stefan: float) -> float:
    """Factor q of the front 2 q sqrt(alpha t) of a solid at its melting point that melts from a hot face.

    ``sqrt(pi) q exp(q^2) erf(q) = St``, St = c (T_face - T_melt) / latent heat.
    """
    from scipy.optimize import brentq
    from scipy.special import erf

    def mismatch(q: float) -> float:
        return float(np.sqrt(np.pi) * q * np.exp(q * q) * erf(q) - stefan)

    return float(brentq(mismatch, 1e-8, 5.0, xtol=1e-14))
