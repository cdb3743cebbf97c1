"""Exact solutions to compare with.

`ANALYTIC` names those that a study file may call: functions f(scene, **arguments) -> float that read what they need
from the scene. The formulas themselves are in the modules of this package.
"""

from __future__ import annotations

from collections.abc import Callable

from verification.analytic import beams, discrete_time, rings, uniaxial

ANALYTIC: dict[str, Callable[..., float]] = {
    function.__name__: function
    for function in (
        uniaxial.uniaxial_reaction,
        uniaxial.uniaxial_elongation,
        uniaxial.uniaxial_contraction,
        uniaxial.uniaxial_volume_ratio,
        beams.timoshenko_tip,
        beams.euler_bernoulli_tip,
        beams.saint_venant_torque,
        discrete_time.axial_frequency,
        discrete_time.axial_frequency_in_steps,
        discrete_time.rod_frequency_in_steps,
        discrete_time.timoshenko_frequency_in_steps,
        discrete_time.axial_tip,
        discrete_time.axial_energy_ratio,
        discrete_time.rigid_spin_displacement,
        discrete_time.rigid_spin_momentum_ratio,
        rings.lame_displacement,
        rings.lame_hoop_moment,
        rings.ring_displacement,
    )
}
