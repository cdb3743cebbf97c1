"""Backward Euler in time: first order, and the spin of a rigid body in discrete time."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from verification.analytic import rigid_spin_angle
from verification.norms import observed_rates
from verification.trapezoidal import TrapezoidalPotential


def falling_beam(scene_of: Callable[..., Any], n_steps: int) -> Any:
    """A soft bar, held at one end, that drops by more than its height: `n_steps` up to 0.3 s."""
    return scene_of(
        {"law": "neo_hookean", "density": 1000.0, "youngs_modulus": 2.0e5, "poisson_ratio": 0.3},
        1,
        2,
        conditions=[{"kind": "fixed", "on": "body.left"}],
        gravity=[0.0, -9.81],
        time={"scheme": "backward_euler", "dt": 0.3 / n_steps, "end": 0.3},
        solver={"tolerance": 1e-10},
    )


def test_backward_euler_is_of_first_order(
    block: Callable[..., Any], scene_of: Callable[..., Any], run: Callable[..., Any]
) -> None:
    meshes = {"body": block([10, 2], [1.0, 0.2])}
    simulation, states = run(falling_beam(scene_of, 600), meshes, TrapezoidalPotential)
    exact, mass = states[-1].x, simulation.discretization.lumped_mass
    drop = simulation.discretization.points[:, 1] - exact[:, 1]
    assert drop.max() > 0.5, "too small a motion to see anything nonlinear"
    counts = (40, 80, 160, 320)
    errors = []
    for n in counts:
        difference = run(falling_beam(scene_of, n), meshes)[1][-1].x - exact
        errors.append(float(np.sqrt(mass @ np.sum(difference**2, axis=1) / mass.sum())))
    rates = observed_rates([1.0 / n for n in counts], errors)
    print(f"errors {errors} m, rates {rates}")
    assert rates[0] > 0.8
    assert rates[-1] == pytest.approx(1.0, abs=0.1)


def test_trapezoidal_rule_is_of_second_order(
    block: Callable[..., Any], scene_of: Callable[..., Any], run: Callable[..., Any]
) -> None:
    """The reference of the test above, against itself: its own error does not count there."""
    meshes = {"body": block([10, 2], [1.0, 0.2])}
    ends = [run(falling_beam(scene_of, n), meshes, TrapezoidalPotential)[1][-1].x for n in (150, 300, 600)]
    first, second = (float(np.abs(b - a).max()) for a, b in pairwise(ends))
    print(f"differences {first}, {second} m: rate {np.log2(first / second)}")
    assert np.log2(first / second) == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("law", ["neo_hookean", "saint_venant_kirchhoff", "arap"])
def test_stiff_cube_spins_like_a_rigid_body(
    law: str, block: Callable[..., Any], scene_of: Callable[..., Any], run: Callable[..., Any]
) -> None:
    """methods.md, section 6, row 8: 1 GPa, w h = 0.1, 30 steps; the continuous body turns by 3 rad."""
    rate, dt, n = 10.0, 0.01, 30
    scene = scene_of(
        {"law": law, "density": 1000.0, "youngs_modulus": 1.0e9, "poisson_ratio": 0.3},
        1,
        3,
        conditions=[{"kind": "initial_velocity", "on": "body", "angular_velocity": [0.0, 0.0, rate]}],
        time={"scheme": "backward_euler", "dt": dt, "end": n * dt},
        solver={"tolerance": 1e-10},
    )
    simulation, states = run(scene, {"body": block([2, 2, 2])})
    assert len(states) == n + 1
    mass, X = simulation.discretization.lumped_mass, simulation.discretization.points - 0.5
    angles = []
    for state in states:
        moment = np.einsum("i,ia,ib->ab", mass, state.x - 0.5, X)  # the rotation closest to it is the body's
        angles.append(np.arctan2(moment[1, 0] - moment[0, 1], moment[0, 0] + moment[1, 1]))
    turned = float(np.unwrap(angles)[-1])
    exact = rigid_spin_angle(rate * dt, n)
    assert exact == pytest.approx(2.65202, abs=5e-6)
    assert turned == pytest.approx(exact, abs=1e-4)

    def angular_momentum(x: Any, v: Any) -> float:
        return float(mass @ np.cross(x - 0.5, v)[:, 2])

    ratio = angular_momentum(states[-1].x, states[-1].v) / angular_momentum(X + 0.5, states[0].v)
    print(f"{law}: {turned:.6f} rad, angular momentum {ratio:.5f} of the first")
    assert ratio == pytest.approx(0.793, abs=5e-4)
