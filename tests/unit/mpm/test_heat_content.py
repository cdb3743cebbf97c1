"""Enthalpy over temperature: specific heats that follow it, latent heat, and the way back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from femdeform.mpm.heat_content import HeatContent
from femdeform.mpm.phase_change import Melting
from femdeform.mpm.temperature_functions import Constant, Linear, Table

T = np.linspace(290.0, 315.0, 501)
ICE = Table((295.0, 303.0, 310.0), (2.0, 1.5, 2.5))
CONTENTS = {
    "constant": HeatContent(Constant(3.0)),
    "table": HeatContent(ICE),
    "linear": HeatContent(Linear(2.0, 0.1, 300.0, 1.0)),
    "falling": HeatContent(Linear(2.0, -0.1, 300.0, 1.0)),
    "two limits": HeatContent(Linear(2.0, 0.3, 300.0, 1.0, 4.0)),
    "melting": HeatContent(Constant(2.0), Constant(3.0), Melting(300.0, 304.0, 50.0)),
    "narrow band": HeatContent(Constant(2.0), Constant(3.0), Melting(300.0, 300.1, 1e5)),
    "no latent heat": HeatContent(Constant(2.0), None, Melting(300.0, 304.0)),
    "one melting point": HeatContent(Constant(1.0), Constant(4.0), Melting(302.0, 302.0)),
    "all of it": HeatContent(ICE, Linear(4.0, 0.05, 300.0, 3.0), Melting(300.0, 304.0, 50.0)),
}
ALL = pytest.mark.parametrize("name", CONTENTS)


@ALL
def test_temperature_is_the_inverse_of_enthalpy(name: str) -> None:
    content = CONTENTS[name]
    enthalpy = content.enthalpy(T)
    assert np.all(np.diff(enthalpy) > 0.0)
    np.testing.assert_allclose(content.temperature(enthalpy), T, rtol=1e-13)


@ALL
def test_slope_of_enthalpy_is_the_capacity_and_latent_heat(name: str) -> None:
    content, step = CONTENTS[name], 1e-4
    corners = np.array([290.0, 295.0, 300.0, 300.1, 302.0, 303.0, 304.0, 306.0 + 2 / 3, 310.0])
    smooth = T[np.abs(T[:, None] - corners).min(axis=1) > 2 * step]
    slope = (content.enthalpy(smooth + step) - content.enthalpy(smooth - step)) / (2 * step)
    latent = np.zeros(smooth.size)
    if name in ("melting", "all of it"):
        latent[(smooth > 300.0) & (smooth < 304.0)] = 50.0 / 4.0
    if name == "narrow band":
        latent[(smooth > 300.0) & (smooth < 300.1)] = 1e6
    np.testing.assert_allclose(slope, content.capacity(smooth) + latent, rtol=1e-6)


@ALL
def test_enthalpy_starts_at_zero_kelvin_without_a_jump(name: str) -> None:
    content = CONTENTS[name]
    assert content.enthalpy(np.zeros(1))[0] == pytest.approx(0.0, abs=1e-12 * content.enthalpy(T).max())
    fine = np.linspace(299.0, 305.0, 60001)
    assert np.diff(content.enthalpy(fine)).max() < 1e-4 * 1.01 * (1e6 if name == "narrow band" else 20.0)


def test_capacities_are_those_of_the_phases() -> None:
    at = np.array([290.0, 299.0, 302.0, 305.0, 320.0])
    np.testing.assert_allclose(CONTENTS["melting"].capacity(at), [2.0, 2.0, 2.5, 3.0, 3.0])
    liquid = 4.0 + 0.05 * (at - 300.0)
    expected = [2.0, 1.75, 0.5 * (ICE(at[2:3])[0] + liquid[2]), liquid[3], liquid[4]]
    np.testing.assert_allclose(CONTENTS["all of it"].capacity(at), expected)


def test_heat_of_a_linear_capacity_is_its_integral() -> None:
    content = HeatContent(Table((300.0, 400.0), (1.0, 3.0)))
    u = np.array([0.0, 10.0, 54.0, 100.0])
    np.testing.assert_allclose(content.enthalpy(300.0 + u), 300.0 + u + u * u / 100.0, rtol=1e-14)
    assert not content.is_proportional
    # Beyond its ends the table is constant.
    np.testing.assert_allclose(content.enthalpy(np.array([100.0, 500.0])), [100.0, 500.0 + 300.0], rtol=1e-14)


def test_what_is_proportional_is_so_exactly() -> None:
    content = CONTENTS["constant"]
    assert content.is_proportional
    np.testing.assert_array_equal(content.enthalpy(T), 3.0 * T)
    assert CONTENTS["no latent heat"].is_proportional
    assert not any(CONTENTS[name].is_proportional for name in ("table", "melting", "one melting point", "falling"))


@ALL
def test_recovered_temperatures_hold_the_heat_that_came(name: str) -> None:
    content, rng = CONTENTS[name], np.random.default_rng(0)
    before = rng.uniform(295.0, 306.0, 400)
    capacity = content.capacity(before)
    after = before + rng.uniform(-20.0, 20.0, 400)
    recovered = content.recovered(before, after, capacity)
    brought = content.enthalpy(recovered) - content.enthalpy(before)
    np.testing.assert_allclose(brought, capacity * (after - before), atol=1e-9)
    if content.is_proportional:
        np.testing.assert_allclose(recovered, after, rtol=1e-13)


@given(
    st.lists(st.integers(0, 400), min_size=1, max_size=6, unique=True),
    st.data(),
    st.floats(0.0, 1e4),
)
def test_any_table_has_an_inverse(temperatures: list[int], data: st.DataObject, latent: float) -> None:
    values = data.draw(st.lists(st.floats(0.1, 10.0), min_size=len(temperatures), max_size=len(temperatures)))
    solid = Table(tuple(map(float, sorted(temperatures))), tuple(values))
    content = HeatContent(solid, Constant(2.0), Melting(150.0, 160.0, latent))
    at = np.linspace(-50.0, 450.0, 301)
    np.testing.assert_allclose(content.temperature(content.enthalpy(at)), at, rtol=1e-11, atol=1e-9)


@pytest.mark.parametrize(
    "capacity",
    [
        Constant(0.0),
        Constant(-1.0),
        Linear(1.0, 0.1, 300.0),
        Linear(1.0, -0.1, 300.0),
        Linear(1.0, 0.1, 300.0, 0.0),
        Table((300.0, 310.0), (1.0, -1.0)),
    ],
)
def test_capacities_that_are_not_positive_are_refused(capacity: Constant | Linear | Table) -> None:
    with pytest.raises(ValueError, match="specific heat"):
        HeatContent(capacity)
