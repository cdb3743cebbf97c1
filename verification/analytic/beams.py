"""Beams and bars: Timoshenko's cantilever, its first frequency, Saint-Venant's torsion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from femdeform.errors import InputError
from femdeform.scene import schema
from femdeform.types import FloatArray
from verification.analytic.facts import block_size, elapsed, only_condition, only_material


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

    def line_mass(self, density: float) -> float:
        """Mass per length [kg/m] for a density [kg/m^3]."""
        return density * self.width * self.height

    def first_frequency(self, density: float) -> float:
        """First bending frequency by Timoshenko, with shear and rotary inertia [Hz].

        With deflection w, turn p of the section, moment M = E I p' and shear force Q = k G A (w' - p), a vibration of
        circular frequency o obeys Q' = -o^2 rho A w and M' = -Q - o^2 rho I p. The clamp has w = p = 0; o is the
        first value for which M = Q = 0 at the other end can be had.
        """
        from scipy.linalg import expm
        from scipy.optimize import brentq

        L, EI, kGA = self.length, self.bending_stiffness, self.shear_stiffness
        mass = self.line_mass(density)
        rotary = mass * self.height**2 / 12.0
        slender = 1.8751040687119611**2 * np.sqrt(EI / (mass * L**4))  # by Euler and Bernoulli [rad/s]

        def end_loads(omega: float) -> float:
            rates = np.zeros((4, 4))  # of (w / L, p, M L / (E I), Q L^2 / (E I)) by x / L
            rates[0, 1], rates[0, 3] = 1.0, EI / (L**2 * kGA)
            rates[1, 2] = 1.0
            rates[2, 1], rates[2, 3] = -(omega**2) * rotary * L**2 / EI, -1.0
            rates[3, 0] = -(omega**2) * mass * L**4 / EI
            transfer: FloatArray = expm(rates)
            return float(np.linalg.det(transfer[2:, 2:]))

        return float(brentq(end_loads, 0.3 * slender, 1.05 * slender, rtol=1e-13)) / (2.0 * np.pi)


def square_bar_torque(shear_modulus: float, side: float, twist: float) -> float:
    """Torque [N m] of Saint-Venant's torsion of a bar of square section, ``twist`` in [rad/m].

    The series of the square, summed far enough that all digits of a double are right.
    """
    n = np.arange(1, 400, 2, dtype=np.float64)
    constant = (1.0 - 192.0 / np.pi**5 * np.sum(np.tanh(n * np.pi / 2.0) / n**5)) / 3.0
    return float(constant * shear_modulus * side**4 * twist)


# ------------------------------------------------------------------------------------------------------ of scenes


def beam_of(scene: schema.DeformableScene) -> RectangularBeam:
    """Return the beam that a block along x with gravity along y is; in two dimensions in plane strain, of width 1."""
    size, material = block_size(scene), only_material(scene)
    if len(size) == 3:
        return RectangularBeam(size[0], size[1], size[2], material.youngs_modulus, material.poisson_ratio)
    return RectangularBeam(size[0], size[1], 1.0, material.youngs_modulus, material.poisson_ratio, plane_strain=True)


def _own_weight(scene: schema.DeformableScene) -> float:
    """Load of gravity per length, along y [N/m]."""
    if scene.gravity is None:
        raise InputError("gravity: this formula needs it")
    return beam_of(scene).line_mass(only_material(scene).density) * scene.gravity[1]


def timoshenko_tip(scene: schema.DeformableScene) -> float:
    """Displacement along y of the tip under its own weight, by Timoshenko [m]."""
    return beam_of(scene).tip_deflection(_own_weight(scene))


def euler_bernoulli_tip(scene: schema.DeformableScene, factor: float = 1.0) -> float:
    """Displacement along y of the tip under its own weight, by Euler and Bernoulli, times a factor [m]."""
    return factor * beam_of(scene).bending_deflection(_own_weight(scene))


def saint_venant_torque(scene: schema.DeformableScene) -> float:
    """Torque of a bar of square section whose end is turned by a `rotate` about x [N m]."""
    size, material = block_size(scene), only_material(scene)
    if len(size) != 3 or size[1] != size[2]:
        raise InputError("bodies: this formula needs a bar of square section along x")
    turn = only_condition(scene, "rotate")
    shear_modulus = material.youngs_modulus / (2.0 * (1.0 + material.poisson_ratio))
    return square_bar_torque(shear_modulus, size[1], turn.rate * elapsed(scene, turn) / size[0])
