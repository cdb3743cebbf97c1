"""Scenes of material points whose constants and walls depend on temperature."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_point_course import JELLY, LIQUID, points, run, written

from femdeform.materials.fixed_corotated import FixedCorotated
from femdeform.mpm.explicit_laws import Liquid
from femdeform.mpm.particles import LIQUID as LIQUID_PHASE
from femdeform.mpm.time_step import capillary_limit, explicit_limit
from femdeform.run.inputs import read_together
from femdeform.run.point_course import PointCourse
from femdeform.run.table import read_table
from femdeform.scene.checks import check_file

HEAT = {"capacity": 1.0, "conductivity": 0.5}
RISING = {"kind": "linear", "value": 0.05, "slope": 0.05, "reference": 0.0, "lowest": 0.0}


@pytest.mark.parametrize("scheme", ["explicit", "backward_euler"])
def test_limit_of_a_state_is_that_of_its_temperatures(tmp_path: Path, scheme: str) -> None:
    """Of liquid points, with their gradients up to a cell away; a table may be largest in between."""
    peak = {"kind": "table", "temperatures": [0.0, 50.0, 100.0], "values": [0.1, 9.0, 0.1]}
    body = {"phase": "solid", "solid": JELLY, "surface_tension": {"liquid_gas": peak}}
    path = written(points(**body, time={"scheme": scheme, "dt": 1.0, "end": 2.0}), tmp_path / "s.yaml")
    course = PointCourse(read_together(path, tmp_path / "out", (), False, False, None), None)
    still = course.start.particles
    longest = course.step_limit(course.start)
    assert longest == np.inf if scheme == "backward_euler" else longest > 0.003

    def limit(temperature: float, slope: float = 0.0) -> float:
        melted = replace(still, phase=np.full_like(still.phase, LIQUID_PHASE))
        melted.temperature = np.full(still.n, temperature)
        melted.temperature_gradient = np.tile([slope, 0.0], (still.n, 1))
        return course.step_limit(replace(course.start, particles=melted))

    assert limit(0.0) == pytest.approx(min(longest, capillary_limit(0.0625, 10.0, 0.1)))
    assert limit(25.0) == pytest.approx(min(longest, capillary_limit(0.0625, 10.0, 4.55)))
    assert limit(100.0, 40.0 / 0.0625) == pytest.approx(min(longest, capillary_limit(0.0625, 10.0, 7.22)))
    assert limit(80.0, 40.0 / 0.0625) == pytest.approx(min(longest, capillary_limit(0.0625, 10.0, 9.0)))
    course.destroy()


def test_steps_follow_tensions_that_rise(tmp_path: Path) -> None:
    """A heated drop gets a tension of 40 times that at the start: steps become shorter with it."""
    out = run(
        tmp_path,
        time={"dt": 0.02, "end": 0.2},
        liquid={**LIQUID, "bulk_modulus": 1000.0},
        surface_tension={"liquid_gas": RISING},
        heat={**HEAT, "source": 2000.0},
        measure={"hottest": {"kind": "max_temperature"}},
    )
    history = read_table(out / "history.csv")
    hottest = np.concatenate([[0.0], history["measure.hottest"]])
    allowed = np.array([capillary_limit(0.0625, 10.0, 0.05 + 0.05 * T) for T in hottest[:-1]])
    assert hottest[-1] == pytest.approx(40.0, rel=0.05)
    assert (history["dt"] <= allowed * (1.0 + 1e-9)).all()
    assert history["dt"][0] == 0.02
    assert history["dt"][-2] < 0.4 * history["dt"][0]


def test_a_solid_has_no_limit_until_it_melts(tmp_path: Path) -> None:
    out = run(
        tmp_path,
        time={"dt": 0.02, "end": 0.2},
        phase="solid",
        solid=JELLY,
        surface_tension={"liquid_gas": 0.5},
        temperature=290.0,
        heat={**HEAT, "source": 1000.0},
        melting={"solidus": 299.0, "liquidus": 300.0},
        measure={"liquid": {"kind": "liquid_fraction"}},
    )
    history = read_table(out / "history.csv")
    is_solid = np.concatenate([[True], history["measure.liquid"][:-1] == 0.0])
    assert 3 < is_solid.sum() < is_solid.size
    assert history["dt"][is_solid] == pytest.approx(0.02)
    assert (history["dt"][~is_solid] <= capillary_limit(0.0625, 10.0, 0.5)).all()


@pytest.mark.parametrize("scheme", ["explicit", "backward_euler"])
def test_a_hot_bar_is_softer(tmp_path: Path, scheme: str) -> None:
    """Free oscillation with the period of the modulus at the temperature: ``T ~ E^-1/2``."""
    table = {"kind": "table", "temperatures": [0.0, 100.0], "values": [400.0, 100.0]}
    measure = {"width": {"kind": "extent", "component": "x"}}
    more: dict[str, Any] = {
        "liquid": None,
        "solid": {**JELLY, "poisson_ratio": 0.0},
        "shape": {"kind": "box", "min": [0.3, 0.45], "max": [0.7, 0.55]},
        "velocity_gradient": [[0.02, 0.0], [0.0, 0.0]],
        "time": {"scheme": scheme, "dt": 0.001, "end": 0.15},
        "measure": measure,
        "moduli": {"youngs_modulus": table},
    }
    turning = {}
    for name, temperature in (("cold", 0.0), ("hot", 100.0)):
        history = read_table(run(tmp_path, name, temperature=temperature, **more) / "history.csv")
        turning[name] = history["time"][np.argmax(history["measure.width"])]
    plain = run(tmp_path, "plain", **{**more, "moduli": None, "temperature": 0.0})
    width = read_table(plain / "history.csv")["measure.width"]
    same = read_table(tmp_path / "cold" / "history.csv")["measure.width"]
    np.testing.assert_allclose(same, width, rtol=1e-9)
    assert turning["hot"] / turning["cold"] == pytest.approx(2.0, rel=0.1)


def test_explicit_steps_are_as_short_as_the_stiffest_points_want(tmp_path: Path) -> None:
    """A solid that becomes softer when it melts, to a liquid that becomes stiffer and thicker when it is heated."""
    falling = {"kind": "table", "temperatures": [0.0, 100.0], "values": [4000.0, 100.0]}
    stiff = {"kind": "table", "temperatures": [0.0, 100.0], "values": [50.0, 9000.0]}
    thick = {"kind": "table", "temperatures": [0.0, 100.0], "values": [0.0, 2.0]}
    body = {
        "solid": {**JELLY, "poisson_ratio": 0.0},
        "moduli": {"youngs_modulus": falling},
        "liquid": {**LIQUID, "bulk_modulus": stiff, "viscosity": thick},
    }
    time = {"scheme": "explicit", "dt": 1.0, "end": 2.0}
    path = written(points(**body, phase="solid", time=time), tmp_path / "s.yaml")
    course = PointCourse(read_together(path, tmp_path / "out", (), False, False, None), None)
    start = course.start
    for T in (0.0, 60.0, 100.0):
        E, K = np.interp(T, [0.0, 100.0], [4000.0, 100.0]), np.interp(T, [0.0, 100.0], [50.0, 9000.0])
        laws = [(FixedCorotated.from_lame(0.5 * E, 0.0, 2), 10.0), (Liquid(K, 0.02 * T), 10.0)]
        hot = replace(start.particles, temperature=np.linspace(T, T, start.particles.n))
        assert course.step_limit(replace(start, particles=hot)) == pytest.approx(explicit_limit(0.0625, laws))
    course.destroy()


def test_walls_of_two_temperatures(tmp_path: Path) -> None:
    """The power that enters at the hot wall and leaves at the cold one is that of the profile."""
    walls = [
        {"shape": {"kind": "plane", "point": [0.25, 0.0], "normal": [1.0, 0.0]}, "kind": "stick", "temperature": 20.0},
        {"shape": {"kind": "plane", "point": [0.75, 0.0], "normal": [-1.0, 0.0]}, "kind": "stick", "temperature": 0.0},
    ]
    out = run(
        tmp_path,
        time={"dt": 0.5, "end": 20.0},
        liquid=None,
        solid=JELLY,
        shape={"kind": "box", "min": [0.25, 0.3], "max": [0.75, 0.7]},
        walls=walls,
        heat={"capacity": 1.0, "conductivity": {"kind": "table", "temperatures": [0.0, 20.0], "values": [1.0, 3.0]}},
        measure={
            "left": {"kind": "mean_temperature", "within": {"kind": "box", "min": [0.25, 0.3], "max": [0.5, 0.7]}},
            "right": {"kind": "mean_temperature", "within": {"kind": "box", "min": [0.5, 0.3], "max": [0.75, 0.7]}},
        },
    )
    # K = 1 + T/10: T + T^2/20 is linear across the slab, T = 10 (-1 + sqrt(1 + s/5)), s = 40 (1 - x/d).
    s = 40.0 * (1.0 - (np.arange(1000) + 0.5) / 1000)
    T = 10.0 * (np.sqrt(1.0 + 0.2 * s) - 1.0)
    history = read_table(out / "history.csv")
    assert history["measure.left"][-1] == pytest.approx(T[:500].mean(), abs=0.1)
    assert history["measure.right"][-1] == pytest.approx(T[500:].mean(), abs=0.1)
    assert abs(history["wall_power"][-1]) < 1e-3 * abs(history["wall_power"][0])


BAD: list[tuple[str, dict[str, Any], str]] = [
    (
        "needs bodies that conduct heat",
        {"walls": [{"shape": {"kind": "plane", "point": [0, 0], "normal": [0, 1]}, "temperature": 300.0}]},
        "walls[0].temperature",
    ),
    (
        "youngs_modulus: has to be positive",
        {"liquid": None, "solid": JELLY, "moduli": {"youngs_modulus": RISING}},
        "bodies.drop.moduli",
    ),
    (
        "has to be between -1 and 0.5",
        {
            "liquid": None,
            "solid": JELLY,
            "moduli": {"poisson_ratio": {"kind": "table", "temperatures": [0.0, 1.0], "values": [0.3, 0.5]}},
        },
        "bodies.drop.moduli",
    ),
    ("needs `solid`", {"moduli": {"youngs_modulus": {**RISING, "lowest": 1.0}}}, "bodies.drop"),
    ("needs youngs_modulus or poisson_ratio", {"liquid": None, "solid": JELLY, "moduli": {}}, "bodies.drop.moduli"),
    (
        "conductivity: must not be negative",
        {"heat": {"capacity": 1.0, "conductivity": {**RISING, "lowest": -1.0}}},
        "bodies.drop.heat",
    ),
]


@pytest.mark.parametrize(("message", "more", "key"), BAD, ids=[message for message, _, _ in BAD])
def test_bad_input(tmp_path: Path, message: str, more: dict[str, Any], key: str) -> None:
    faults = [str(fault) for fault in check_file(written(points(**more), tmp_path / "bad.yaml"))]
    assert any(key in fault and message in fault for fault in faults), faults


@pytest.mark.parametrize("exchange", [{"transfer": 10.0, "ambient": 0.0}, {"flux": 50.0}], ids=["transfer", "flux"])
def test_walls_without_a_temperature_insulate(tmp_path: Path, exchange: dict[str, float]) -> None:
    """All round, nothing gets in or out; a body with one side free changes through that side only."""
    shape = {"kind": "box", "min": [0.25, 0.25], "max": [0.75, 0.75]}
    free = {"kind": "box", "min": [0.25, 0.25], "max": [0.75, 2.0]}
    changes = []
    for name, container in (("shut", shape), ("open", free)):
        out = run(
            tmp_path,
            name,
            time={"dt": 0.02, "end": 0.1},
            shape=shape,
            liquid=None,
            solid=JELLY,
            temperature=100.0,
            heat={**HEAT, **exchange},
            walls=[{"shape": container, "inside": True, "kind": "slip"}],
            measure={"T": {"kind": "mean_temperature"}},
        )
        changes.append(read_table(out / "history.csv")["measure.T"][-1] - 100.0)
    assert abs(changes[0]) < 1e-9
    # Through 0.5 m of surface to 2.5 kg for 0.1 s: 50 W/m^2, or up to 1000 that fall with the temperature there.
    if "flux" in exchange:
        assert changes[1] == pytest.approx(50.0 * 0.5 * 0.1 / (10.0 * 0.25), rel=0.15)
    else:
        assert -20.0 < changes[1] < -10.0
