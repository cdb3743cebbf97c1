"""What a time integration makes of motions whose exact course is known: a bar along its axis, a rigid spin."""

from __future__ import annotations

from typing import Literal

import numpy as np

from femdeform.errors import InputError
from femdeform.scene import schema
from femdeform.scene.mesh_schema import RodMesh
from verification.analytic.beams import beam_of
from verification.analytic.facts import block_size, only_body, only_condition, only_material, step_count

# ------------------------------------------------------------------------------------------- a bar along its axis
#
# A fixed-free bar with nu = 0 (nothing moves across) swings like sin(pi x / (2 L)), with w = pi c / (2 L) and
# c = sqrt(E / rho). Of the complex amplitude z = v + i w u, which turns and keeps its length, z' = i w z, backward
# Euler makes z_(n+1) = z_n / (1 - i w h) and the trapezoidal rule z_(n+1) = z_n (1 + i w h/2) / (1 - i w h/2).


def axial_frequency(scene: schema.DeformableScene) -> float:
    """First frequency of a fixed-free bar along its axis, c / (4 L) [Hz]."""
    return _wave_speed(scene) / (4.0 * _length(scene))


def _wave_speed(scene: schema.DeformableScene) -> float:
    material = only_material(scene)
    if material.poisson_ratio != 0.0:
        raise InputError("bodies: this formula needs poisson_ratio 0")
    return float(np.sqrt(material.youngs_modulus / material.density))


def _length(scene: schema.DeformableScene) -> float:
    mesh = only_body(scene).mesh
    if isinstance(mesh, RodMesh):
        return float(np.linalg.norm(np.subtract(mesh.end, mesh.start)))
    return block_size(scene)[0]


def _turn_per_step(scene: schema.DeformableScene) -> float:
    """Circular frequency times step, w h [-]."""
    return 2.0 * np.pi * axial_frequency(scene) * scene.time.dt


def _frequency_in_steps(turn_per_step: float, dt: float, scheme: str) -> float:
    angle = np.arctan(turn_per_step) if scheme == "backward_euler" else 2.0 * np.arctan(0.5 * turn_per_step)
    return float(angle / (2.0 * np.pi * dt))


def axial_frequency_in_steps(
    scene: schema.DeformableScene, scheme: Literal["backward_euler", "trapezoidal"] = "backward_euler"
) -> float:
    """Frequency with the time step of the scene: arctan(w h) / (2 pi h), or arctan(w h / 2) / (pi h) [Hz]."""
    return _frequency_in_steps(_turn_per_step(scene), scene.time.dt, scheme)


def rod_frequency_in_steps(
    scene: schema.DeformableScene, scheme: Literal["backward_euler", "trapezoidal"] = "backward_euler"
) -> float:
    """Frequency of a rod of equal linear cells, fixed at its start, with the time step of the scene [Hz].

    sin(k x) with k = pi / (2 L) is a mode of the difference equations too. Its frequency is w = 2 c / d sin(k d / 2)
    with lumped masses, d the length of a cell; with consistent ones w^2 = 6 c^2 / d^2 (1 - cos k d) / (2 + cos k d).
    """
    body = only_body(scene)
    if not isinstance(body.mesh, RodMesh):
        raise InputError("bodies: this formula needs the recipe `rod`")
    d = _length(scene) / body.mesh.cells
    phase = 0.5 * np.pi / body.mesh.cells
    omega = 2.0 * np.sin(0.5 * phase)
    if body.mass == "consistent":
        omega /= np.sqrt((2.0 + np.cos(phase)) / 3.0)
    return _frequency_in_steps(omega * _wave_speed(scene) / d * scene.time.dt, scene.time.dt, scheme)


def timoshenko_frequency_in_steps(
    scene: schema.DeformableScene, scheme: Literal["backward_euler", "trapezoidal"] = "backward_euler"
) -> float:
    """First bending frequency of a cantilever by Timoshenko, with the time step of the scene [Hz]."""
    frequency = beam_of(scene).first_frequency(only_material(scene).density)
    return _frequency_in_steps(2.0 * np.pi * frequency * scene.time.dt, scene.time.dt, scheme)


def axial_tip(scene: schema.DeformableScene, speed: float) -> float:
    """Displacement of the free end at the end of a run by backward Euler [m], its speed at time 0 being given [m/s]."""
    turn, n = _turn_per_step(scene), step_count(scene)
    omega = turn / scene.time.dt
    return float(speed / omega * (1.0 + turn**2) ** (-0.5 * n) * np.sin(n * np.arctan(turn)))


def axial_energy_ratio(scene: schema.DeformableScene) -> float:
    """Energy at the end of a run by backward Euler over that at its beginning, (1 + w^2 h^2)^-n [-]."""
    return float((1.0 + _turn_per_step(scene) ** 2) ** -step_count(scene))


# ----------------------------------------------------------------------------------------------------- rigid spin


def rigid_spin_increments(turn_per_step: float, n_steps: int) -> list[float]:
    """Angles that a rigid body turns by in each step of backward Euler, free of loads [rad].

    Backward Euler projects 2 R_n - R_(n-1) onto the rotations: each increment is arctan(sin d / (2 - cos d)) of the
    one before, the first arctan(w h).

    Parameters
    ----------
    turn_per_step : float
        Initial angular velocity times time step, w h [rad].
    n_steps : int
        Number of steps.
    """
    increments = [float(np.arctan(turn_per_step))]
    while len(increments) < n_steps:
        d = increments[-1]
        increments.append(float(np.arctan2(np.sin(d), 2.0 - np.cos(d))))
    return increments


def rigid_spin_angle(turn_per_step: float, n_steps: int) -> float:
    """Sum of `rigid_spin_increments` [rad]; the continuous body turns by ``turn_per_step n_steps``."""
    return sum(rigid_spin_increments(turn_per_step, n_steps))


def _increments_of(scene: schema.DeformableScene) -> list[float]:
    rate = only_condition(scene, "initial_velocity").angular_velocity
    if rate is None or (isinstance(rate, tuple) and any(rate[:2])):
        raise InputError("conditions: this formula needs an angular_velocity about z")
    rate = rate[2] if isinstance(rate, tuple) else rate
    return rigid_spin_increments(rate * scene.time.dt, step_count(scene))


def rigid_spin_displacement(scene: schema.DeformableScene, at: list[float], component: Literal["x", "y"]) -> float:
    """Displacement of a point of a block that spins freely about the z axis through its centre [m]."""
    turned = sum(_increments_of(scene))
    x, y = (place - 0.5 * size for place, size in zip(at[:2], block_size(scene)[:2], strict=True))
    if component == "x":
        return float(x * np.cos(turned) - y * np.sin(turned) - x)
    return float(x * np.sin(turned) + y * np.cos(turned) - y)


def rigid_spin_momentum_ratio(scene: schema.DeformableScene) -> float:
    """Angular momentum at the end over that at the beginning: sin d_n / (w h), d_n the last increment [-].

    With v_n = (x_n - x_(n-1)) / h the momentum is minus the sum of m x_n x x_(n-1) / h, that is, I sin d_n / h.
    """
    increments = _increments_of(scene)
    return float(np.sin(increments[-1]) / np.tan(increments[0]))
