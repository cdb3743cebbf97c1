"""Lengths of steps."""

from __future__ import annotations

import numpy as np
import pytest

from femdeform.materials.neo_hookean import NeoHookean
from femdeform.mpm.explicit_laws import Liquid
from femdeform.mpm.time_step import CAPILLARY, SOUND, VISCOUS, StepControl, explicit_limit


def test_steps_follow_the_fastest_node_and_grow_slowly() -> None:
    control = StepControl(1e-4, 1e-2)
    assert control.next(0.1, 0.0) == 1e-2
    assert control.next(0.1, 12.0) == pytest.approx(0.6 * 0.1 / 12.0)
    assert control.next(0.1, 1e9) == 1e-4
    assert control.next(0.1, 0.0, before=1e-3) == pytest.approx(1.2e-3)
    assert control.next(0.1, 600.0, before=1e-2) == 1e-4
    assert control.next(0.1, 0.0, limit=5e-5) == 5e-5


@pytest.mark.parametrize("numbers", [(1.0, 0.1), (0.0, 1.0, 1.0), (0.0, 1.0, 0.5, 0.9)])
def test_a_control_without_sense_is_refused(numbers: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="step control"):
        StepControl(*numbers)


def test_limits_of_explicit_steps() -> None:
    dx, water, rubber = 0.1, (Liquid(400.0, 0.0), 10.0), (NeoHookean.from_lame(50.0, 300.0, 2), 4.0)
    assert explicit_limit(dx, [water]) == pytest.approx(SOUND * dx * np.sqrt(10.0 / 400.0))
    assert explicit_limit(dx, [water, rubber]) == pytest.approx(SOUND * dx * np.sqrt(4.0 / 400.0))
    thick = (Liquid(400.0, 100.0), 10.0)
    assert explicit_limit(dx, [thick]) == pytest.approx(VISCOUS * 10.0 * dx**2 / 100.0)
    wave = CAPILLARY * np.sqrt(4.0 * dx**3 / (2.0 * np.pi * 1e4))
    assert explicit_limit(dx, [water, rubber], 1e4) == pytest.approx(wave)
    assert explicit_limit(dx, []) == np.inf
