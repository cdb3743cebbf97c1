"""Uniaxial stretch between rollers: the closed form of every law, and what a scene makes of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femdeform.errors import InputError
from femdeform.materials import lame_parameters
from femdeform.scene import schema
from verification.analytic.facts import block_size, elapsed, only_condition, only_material


@dataclass(frozen=True)
class UniaxialState:
    """Homogeneous stretch along x with stress-free sides.

    Attributes
    ----------
    stretch : float
        Along x, prescribed [-].
    lateral : float
        Along y, and in three dimensions along z too [-].
    stress : float
        First Piola-Kirchhoff stress along x: force per reference area [Pa].
    """

    stretch: float
    lateral: float
    stress: float


def uniaxial_stretch(law: str, youngs_modulus: float, poisson_ratio: float, stretch: float, dim: int) -> UniaxialState:
    """State of a bar between rollers, pulled to a stretch.

    Parameters
    ----------
    law : str
        Word of the law in a scene.
    youngs_modulus : float
        [Pa]
    poisson_ratio : float
        [-]
    stretch : float
        Deformed over reference length [-].
    dim : int
        3, or 2 for plane strain.

    Returns
    -------
    UniaxialState

    Raises
    ------
    ValueError
        For an unknown law, or where the sides would vanish (St. Venant-Kirchhoff at large stretch).
    """
    mu, lmbda = lame_parameters(youngs_modulus, poisson_ratio)
    a = float(stretch)
    # Small strain: sigma = modulus e, lateral strain -contraction e. In plane strain nothing moves along z.
    contraction = lmbda / (2.0 * (lmbda + mu)) if dim == 3 else lmbda / (lmbda + 2.0 * mu)
    modulus = 2.0 * mu + lmbda * (1.0 - (dim - 1) * contraction)

    if law == "linear" or law == "corotated":  # no rotation, and tr S linear in the stretches: one law
        return UniaxialState(a, 1.0 - contraction * (a - 1.0), modulus * (a - 1.0))
    if law == "arap":
        return UniaxialState(a, 1.0, 2.0 * mu * (a - 1.0))
    if law == "saint_venant_kirchhoff":
        strain = 0.5 * (a * a - 1.0)
        square = 1.0 - 2.0 * contraction * strain
        if square <= 0.0:
            raise ValueError(f"a stretch of {a:g} leaves no cross-section")
        return UniaxialState(a, float(np.sqrt(square)), a * modulus * strain)
    if law == "fixed_corotated":
        b = _fixed_corotated_lateral(mu, lmbda, a, dim)
        J = a * b ** (dim - 1)
        return UniaxialState(a, b, 2.0 * mu * (a - 1.0) + lmbda * (J - 1.0) * J / a)
    if law == "neo_hookean":
        stiff = lmbda + mu
        if dim == 3:
            b = float(np.sqrt((1.0 + mu / stiff * (1.0 - 1.0 / a)) / a))
        else:
            b = (stiff + mu) / (stiff * a + mu / a)
        return UniaxialState(a, b, mu * (a - b * b / a))
    if law == "logarithmic_neo_hookean":
        b = float(np.sqrt(_logarithmic_square(mu, lmbda, a, dim)))
        return UniaxialState(a, b, mu * (a - b * b / a))
    if law == "stable_neo_hookean":
        return _stable_neo_hookean(mu, lmbda, a, dim)
    raise ValueError(f"no uniaxial solution for {law}")


def _positive_root(coefficients: list[float], near: float) -> float:
    """Positive real root of a polynomial (highest power first) closest to a value."""
    roots = np.roots(coefficients)
    real = roots[np.abs(roots.imag) < 1e-9 * (1.0 + np.abs(roots))].real
    positive = real[real > 0.0]
    root = float(positive[np.argmin(np.abs(positive - near))])
    polynomial = np.poly1d(coefficients)
    for _ in range(3):  # eigenvalues of the companion matrix, polished
        root -= float(polynomial(root) / polynomial.deriv()(root))
    return root


def _fixed_corotated_lateral(mu: float, lmbda: float, a: float, dim: int) -> float:
    # P_22 = 2 mu (b - 1) + lambda (J - 1) J / b = 0.
    if dim == 2:
        return (2.0 * mu + lmbda * a) / (2.0 * mu + lmbda * a * a)
    return _positive_root([lmbda * a * a, 0.0, 2.0 * mu - lmbda * a, -2.0 * mu], a**-0.5)


def _logarithmic_square(mu: float, lmbda: float, a: float, dim: int) -> float:
    # P_22 = 0: mu b^2 + lambda ln J = mu, with ln J = ln a + (dim - 1) ln b. Solved by Lambert's W for b^2.
    from scipy.special import lambertw

    scale = 2.0 * mu / (lmbda * (dim - 1))
    return float(lambertw(scale * np.exp(scale) * a ** (-2.0 / (dim - 1))).real / scale)


def _stable_neo_hookean(mu: float, lmbda: float, a: float, dim: int) -> UniaxialState:
    # P_22 / b = m + g J / b^2 = 0 with m = mu' I / (I + 1), I = |F|^2, g = lambda' (J - alpha).
    shear = mu * (dim + 1) / dim
    volume = lmbda + (5.0 / 6.0 if dim == 3 else 2.0 / 3.0) * mu
    alpha = 1.0 + mu / volume
    if dim == 3:  # quadratic in y = b^2: mu' (a^2 + 2 y) + lambda' a (a y - alpha)(a^2 + 2 y + 1) = 0
        first = np.polymul([volume * a * a, -volume * a * alpha], [2.0, a * a + 1.0])
        b = float(np.sqrt(_positive_root(list(np.polyadd(first, [2.0 * shear, shear * a * a])), 1.0 / a)))
    else:  # mu' b (a^2 + b^2) + lambda' a (a b - alpha)(a^2 + b^2 + 1) = 0
        first = np.polymul([volume * a * a, -volume * a * alpha], [1.0, 0.0, a * a + 1.0])
        b = _positive_root(list(np.polyadd(first, [shear, 0.0, shear * a * a, 0.0])), 1.0 / a)
    square = a * a + (dim - 1) * b * b
    m = shear * square / (square + 1.0)
    J = a * b ** (dim - 1)
    return UniaxialState(a, b, m * a + volume * (J - alpha) * J / a)


# ------------------------------------------------------------------------------------------------------ of scenes


def state_of(scene: schema.DeformableScene) -> UniaxialState:
    """State of a block between rollers at the end of a run, pulled along x by a `translate` or by a `traction`.

    Raises
    ------
    InputError
        If the scene is none of these, or no stretch belongs to the traction.
    """
    material, size = only_material(scene), block_size(scene)
    law, E, nu, dim = material.law, material.youngs_modulus, material.poisson_ratio, len(size)
    if any(condition.kind == "translate" for condition in scene.conditions):
        motion = only_condition(scene, "translate")
        return uniaxial_stretch(law, E, nu, 1.0 + motion.velocity[0] * elapsed(scene, motion) / size[0], dim)
    return _state_under(law, E, nu, dim, only_condition(scene, "traction").value[0])


def _state_under(law: str, youngs_modulus: float, poisson_ratio: float, dim: int, stress: float) -> UniaxialState:
    """State under a stress: the first stretch, on the way from rest, at which the closed form reaches it."""
    from scipy.optimize import brentq

    def excess(stretch: float) -> float:
        return uniaxial_stretch(law, youngs_modulus, poisson_ratio, stretch, dim).stress - stress

    near, step = 1.0, 0.01 if stress > 0.0 else -0.01
    while 0.1 < near < 10.0:
        try:
            passed = excess(near + step) * step >= 0.0
        except ValueError:  # the sides vanish before the stress is reached
            break
        if passed:
            stretch = brentq(excess, near, near + step, xtol=1e-15, rtol=1e-14)
            return uniaxial_stretch(law, youngs_modulus, poisson_ratio, float(stretch), dim)
        near += step
    raise InputError(f"conditions: no stretch of {law} belongs to a stress of {stress:g} Pa")


def uniaxial_reaction(scene: schema.DeformableScene) -> float:
    """Force along x of the roller at the left end, opposite to the pull [N]."""
    return -state_of(scene).stress * float(np.prod(block_size(scene)[1:]))


def uniaxial_elongation(scene: schema.DeformableScene) -> float:
    """Displacement of the pulled end along x [m]."""
    return (state_of(scene).stretch - 1.0) * block_size(scene)[0]


def uniaxial_contraction(scene: schema.DeformableScene) -> float:
    """Displacement along y of the side opposite the roller [m]."""
    return (state_of(scene).lateral - 1.0) * block_size(scene)[1]


def uniaxial_volume_ratio(scene: schema.DeformableScene) -> float:
    """Deformed over reference volume [-]."""
    state = state_of(scene)
    return float(state.stretch * state.lateral ** (len(block_size(scene)) - 1))
