"""Lengths of steps."""

from __future__ import annotations

import numpy as np
import pytest

from femdeform.materials.neo_hookean import NeoHookean
from femdeform.mpm.explicit_laws import Liquid
from femdeform.mpm.time_step import CAPILLARY, SOUND, VISCOUS, explicit_limit


def test_limits_of_explicit_steps() -> None:
    dx, water, rubber = 0.1, (Liquid(400.0, 0.0), 10.0), (NeoHookean.from_lame(50.0, 300.0, 2), 4.0)
    assert explicit_limit(dx, [water]) == pytest.approx(SOUND * dx * np.sqrt(10.0 / 400.0))
    assert explicit_limit(dx, [water, rubber]) == pytest.approx(SOUND * dx * np.sqrt(4.0 / 400.0))
    thick = (Liquid(400.0, 100.0), 10.0)
    assert explicit_limit(dx, [thick]) == pytest.approx(VISCOUS * 10.0 * dx**2 / 100.0)
    wave = CAPILLARY * np.sqrt(4.0 * dx**3 / (2.0 * np.pi * 1e4))
    assert explicit_limit(dx, [water, rubber], 1e4) == pytest.approx(wave)
    assert explicit_limit(dx, []) == np.inf
