"""Turek and Hron's structural tests CSM1, CSM2 and CSM3 against the published displacements of point A."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from femdeform.fem.incremental_potential import IncrementalPotential
from femdeform.run.expectations import check_expectations
from femdeform.types import FloatArray
from verification.norms import observed_rates
from verification.trapezoidal import TrapezoidalPotential

PUBLISHED = {"csm1": (-7.187e-3, -66.10e-3), "csm2": (-0.4690e-3, -16.97e-3)}  # [m]
FREQUENCY = 1.0995  # [Hz]
# CSM3: mean and amplitude over the last period, x and y [m].
MEAN = (-14.305e-3, -63.607e-3)
AMPLITUDE = (14.305e-3, 65.160e-3)


@pytest.mark.parametrize("name", sorted(PUBLISHED))
def test_bar_at_rest(name: str, case: Callable[..., Any], run: Callable[..., Any]) -> None:
    simulation, states = run(*case(f"turek_hron/{name}"))
    verdicts = check_expectations(simulation, states[-1])
    computed = [v["computed"] for v in verdicts]
    print(f"{name}: {computed[0] * 1e3:.4f} mm, {computed[1] * 1e3:.4f} mm")
    assert computed == pytest.approx(PUBLISHED[name], rel=1e-3)
    assert all(v["passed"] for v in verdicts)


@pytest.fixture
def swing(case: Callable[..., Any], run: Callable[..., Any]) -> Callable[..., FloatArray]:
    """Times and displacements of point A, (n_steps + 1, 3), of CSM3."""

    def go(dt: float, end: float, problem_class: type[IncrementalPotential] | None = None) -> FloatArray:
        simulation, states = run(
            *case("turek_hron/csm3", f"time.dt={dt}", f"time.end={end}", "solver.tolerance=1.0e-6"), problem_class
        )
        (tip,) = simulation.conditions.nodes("flag.tip")
        np.testing.assert_allclose(simulation.discretization.points[tip], [0.6, 0.2], atol=1e-15)
        shift = [state.x[tip] - simulation.discretization.points[tip] for state in states]
        return np.column_stack([[state.time for state in states], shift])

    return go


def lowest_points(path: FloatArray) -> FloatArray:
    """Times of the lowest points of all swings [s], by a parabola through three steps."""
    t, y = path[:, 0], path[:, 2]
    inner = np.arange(1, len(y) - 1)
    low = inner[(y[inner] < y[inner - 1]) & (y[inner] <= y[inner + 1]) & (y[inner] < MEAN[1])]
    before, here, after = y[low - 1], y[low], y[low + 1]
    offset = 0.5 * (before - after) / (before - 2.0 * here + after)
    return np.asarray(t[low] + offset * (t[1] - t[0]))


@pytest.mark.slow
def test_published_swing_by_the_published_scheme(swing: Callable[..., FloatArray]) -> None:
    """Trapezoidal rule, the finest of the steps the benchmark was run with, last period of ten seconds."""
    path = swing(0.005, 10.0, TrapezoidalPotential)
    last = path[path[:, 0] >= path[-1, 0] - 1.0 / FREQUENCY, 1:]
    mean = 0.5 * (last.max(axis=0) + last.min(axis=0))
    amplitude = 0.5 * (last.max(axis=0) - last.min(axis=0))
    troughs = lowest_points(path)
    frequency = (len(troughs) - 1) / (troughs[-1] - troughs[0])
    print(f"mean {mean * 1e3} mm, amplitude {amplitude * 1e3} mm, {frequency:.4f} Hz")
    assert len(troughs) == 11
    np.testing.assert_allclose(mean, MEAN, rtol=0.01)
    np.testing.assert_allclose(amplitude, AMPLITUDE, rtol=0.01)
    assert frequency == pytest.approx(FREQUENCY, rel=0.01)


@pytest.mark.slow
def test_first_swing_by_backward_euler(swing: Callable[..., FloatArray]) -> None:
    """The scene's own scheme: the lowest point within 1 % of the published mean minus amplitude, the period likewise.

    The highest point is not compared: backward Euler loses w^2 h T / 2 = 1.1 % of the amplitude in a period.
    """
    path = swing(5.0e-4, 0.95)
    lowest = path[:, 1:].min(axis=0)
    turn = path[np.argmin(path[:, 2]) :, :]
    back = turn[np.argmax(turn[:, 2]), 0]
    print(f"lowest {lowest * 1e3} mm at {lowest_points(path)} s, back up at {back:.4f} s")
    np.testing.assert_allclose(lowest, np.subtract(MEAN, AMPLITUDE), rtol=0.01)
    assert 1.0 / back == pytest.approx(FREQUENCY, rel=0.01)
    assert 0.5 / lowest_points(path)[0] == pytest.approx(FREQUENCY, rel=0.01)


def test_expectations_of_the_scene(case: Callable[..., Any], run: Callable[..., Any]) -> None:
    simulation, states = run(*case("turek_hron/csm3"))
    verdicts = check_expectations(simulation, states[-1])
    assert len(verdicts) == 2
    assert all(v["passed"] for v in verdicts)


def test_backward_euler_tends_to_the_trapezoidal_rule(swing: Callable[..., FloatArray]) -> None:
    """Tip towards the end of the first swing: halving the step halves the difference, or better."""
    end, steps = 0.4, (8.0e-3, 4.0e-3, 2.0e-3)
    exact = swing(1.0e-3, end, TrapezoidalPotential)[-1, 1:]
    errors = [float(np.linalg.norm(swing(dt, end)[-1, 1:] - exact)) for dt in steps]
    rates = observed_rates(steps, errors)
    print(f"errors {errors} m, rates {rates}")
    assert min(rates) > 0.8
    assert errors[-1] < 0.01 * np.linalg.norm(exact)
