"""Exact solutions to compare with: uniaxial stretch, beams, torsion, a rigid body in discrete time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femdeform.materials import lame_parameters

# -------------------------------------------------------------------------------------------- uniaxial stretch


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


def uniaxial_stretch(
    law: str, youngs_modulus: float, poisson_ratio: float, stretch: float, dim: int
) -> UniaxialState:
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


# ----------------------------------------------------------------------------------------------------- beams


@dataclass(frozen=True)
class RectangularBeam:
    """A straight beam with a rectangular cross-section, clamped at one end.

    Attributes
    ----------
    length, height, width : float
        Height is in the direction of the load [m]. Width 1 in plane strain.
    youngs_modulus : float
        [Pa]
    poisson_ratio : float
        [-]
    plane_strain : bool
        No strain across the width: E / (1 - nu^2) in place of E.

    References
    ----------
    S. P. Timoshenko, On the correction for shear of the differential equation for transverse vibrations of prismatic
    bars, Philosophical Magazine 41 (1921). G. R. Cowper, The shear coefficient in Timoshenko's beam theory, Journal
    of Applied Mechanics 33 (1966).

    Limitations
    -----------
    Small deflections. A clamp that also holds the cross-section in its plane is stiffer than the theory's by a part
    of order nu^2 height / length.
    """

    length: float
    height: float
    width: float
    youngs_modulus: float
    poisson_ratio: float
    plane_strain: bool = False

    @property
    def bending_stiffness(self) -> float:
        """E I [N m^2]."""
        modulus = self.youngs_modulus
        if self.plane_strain:
            modulus /= 1.0 - self.poisson_ratio**2
        return modulus * self.width * self.height**3 / 12.0

    @property
    def shear_stiffness(self) -> float:
        """Shear coefficient times G A [N], the coefficient of Cowper; in plane strain for nu / (1 - nu)."""
        nu = self.poisson_ratio
        shear_modulus = self.youngs_modulus / (2.0 * (1.0 + nu))
        if self.plane_strain:
            nu = nu / (1.0 - nu)
        coefficient = 10.0 * (1.0 + nu) / (12.0 + 11.0 * nu)
        return coefficient * shear_modulus * self.width * self.height

    def bending_deflection(self, line_load: float) -> float:
        """Deflection of the tip by Euler and Bernoulli under a uniform load [N/m], without shear [m]."""
        return line_load * self.length**4 / (8.0 * self.bending_stiffness)

    def tip_deflection(self, line_load: float = 0.0, tip_force: float = 0.0) -> float:
        """Deflection of the tip by Timoshenko under a uniform load [N/m] and a force at the tip [N], in [m]."""
        L, EI, kGA = self.length, self.bending_stiffness, self.shear_stiffness
        uniform = line_load * (L**4 / (8.0 * EI) + L**2 / (2.0 * kGA))
        return uniform + tip_force * (L**3 / (3.0 * EI) + L / kGA)


def square_bar_torque(shear_modulus: float, side: float, twist: float) -> float:
    """Torque [N m] of Saint-Venant's torsion of a bar of square section, ``twist`` in [rad/m].

    The series of the square, summed far enough that all digits of a double are right.
    """
    n = np.arange(1, 400, 2, dtype=np.float64)
    constant = (1.0 - 192.0 / np.pi**5 * np.sum(np.tanh(n * np.pi / 2.0) / n**5)) / 3.0
    return float(constant * shear_modulus * side**4 * twist)


# --------------------------------------------------------------------------------------------------- rigid spin


def rigid_spin_angle(turn_per_step: float, n_steps: int) -> float:
    """Angle that a rigid body turns by in steps of backward Euler, free of loads.

    Backward Euler projects 2 R_n - R_(n-1) onto the rotations: each increment is arctan(sin d / (2 - cos d)) of the
    one before, the first arctan(w h). The continuous body turns by ``turn_per_step n_steps``.

    Parameters
    ----------
    turn_per_step : float
        Initial angular velocity times time step, w h [rad].
    n_steps : int
        Number of steps.

    Returns
    -------
    float
        [rad]
    """
    increment = float(np.arctan(turn_per_step))
    total = 0.0
    for _ in range(n_steps):
        total += increment
        increment = float(np.arctan2(np.sin(increment), 2.0 - np.cos(increment)))
    return total
