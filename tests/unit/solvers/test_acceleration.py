"""Accelerators on a linear iteration of which everything is known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from solvers.acceleration import SOR, Accelerator, Anderson, Chebyshev

RATES = np.linspace(0.0, 0.95, 40)


def errors(accelerator: Accelerator | None, steps: int, rates: NDArray[np.float64] = RATES) -> list[float]:
    """Distance to the fixed point of ``S(x) = rates * (x - 1) + 1`` after each step from zero."""
    x = np.zeros(rates.size)
    found = []
    for _ in range(steps):
        swept = rates * (x - 1.0) + 1.0
        if accelerator is not None:
            accelerator.mix(x.copy(), swept)
        x = swept
        found.append(float(np.linalg.norm(x - 1.0)))
    return found


def test_chebyshev_follows_its_recurrence() -> None:
    """Against the polynomial: with gamma = 1 the error is w-recurrence applied to the rates."""
    rho, gamma = 0.95, 1.7
    accelerator = Chebyshev(rho, gamma)
    old, x = np.ones(RATES.size), RATES.copy()  # errors after the start and after the plain first step
    accelerator.mix(1.0 - old, 1.0 - x.copy())
    weight = 1.0
    for step in range(2, 8):
        weight = 2.0 / (2.0 - rho**2) if step == 2 else 4.0 / (4.0 - rho**2 * weight)
        expected = weight * (gamma * (RATES * x - x) + x - old) + old
        swept = 1.0 - RATES * x
        accelerator.mix(1.0 - x, swept)
        np.testing.assert_allclose(1.0 - swept, expected, atol=1e-14)
        old, x = x, expected


def test_sor_extrapolates_from_the_iterate_before_the_last() -> None:
    accelerator = SOR(1.7)
    a, b, c = np.array([1.0, 2.0]), np.array([1.5, 1.0]), np.array([3.0, 5.0])
    swept = b.copy()
    accelerator.mix(a, swept)
    np.testing.assert_array_equal(swept, b)
    swept = c.copy()
    accelerator.mix(b, swept)
    np.testing.assert_allclose(swept, 1.7 * (c - a) + a)


@pytest.mark.parametrize(
    ("accelerator", "gain"),
    [(Chebyshev(0.95, 1.7), 1e2), (Chebyshev(0.95, 2.0 / 1.05), 1e3), (SOR(1.52), 1e2), (Anderson(6), 1e3)],
)
def test_all_beat_plain_sweeps_in_the_end(accelerator: Accelerator, gain: float) -> None:
    assert errors(accelerator, 60)[-1] < errors(None, 60)[-1] / gain


def test_the_rate_of_second_order_sor() -> None:
    """sqrt(omega - 1), for rates up to 2 sqrt(omega - 1) / omega."""
    found = errors(SOR(1.7), 200)
    assert (found[-1] / found[99]) ** 0.01 == pytest.approx(np.sqrt(0.7), abs=0.01)


def test_anderson_solves_a_small_problem_exactly() -> None:
    """Five rates and a window of five: the fixed point after six sweeps, up to rounding."""
    found = errors(Anderson(6), 9, np.array([0.1, 0.3, 0.5, 0.7, 0.99]))
    assert found[7] < 1e-9
    assert errors(None, 9, np.array([0.1, 0.3, 0.5, 0.7, 0.99]))[7] > 0.9


def test_anderson_stands_equal_directions_and_a_fixed_point() -> None:
    accelerator = Anderson(4)
    assert errors(accelerator, 12, np.full(7, 0.5))[-1] < 1e-12
    x = np.ones(3)
    accelerator.restart()
    for _ in range(4):
        swept = x.copy()
        accelerator.mix(x, swept)
        np.testing.assert_array_equal(swept, x)


def test_a_restart_forgets() -> None:
    for accelerator in (Chebyshev(0.9, 1.0), SOR(1.5), Anderson(3)):
        first = errors(accelerator, 10)
        accelerator.restart()
        assert errors(accelerator, 10) == first


def test_single_precision_stays_single() -> None:
    for accelerator in (Chebyshev(0.9, 1.7), SOR(1.5), Anderson(3)):
        x = np.zeros(10, dtype=np.float32)
        for _ in range(4):
            swept = np.float32(0.5) * x + np.float32(1.0)
            accelerator.mix(x.copy(), swept)
            x = swept
        assert x.dtype == np.float32
