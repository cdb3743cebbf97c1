"""Statistics of quantities over time, and the contact angle of a fitted circle."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_point_course import facts, points, run, written

from femdeform.run.checkpoint import read_checkpoint
from femdeform.run.expectations import verdict
from femdeform.run.over_time import over_time_verdicts, statistic
from femdeform.run.point_quantities import apparent_angle
from femdeform.run.table import read_table
from femdeform.scene.checks import check_file
from femdeform.scene.point_quantity_schema import ExpectedOverTime

TIMES = np.linspace(0.0, 3.0, 301) + 1e-3 * np.sin(np.arange(301))


def of(kind: str, values: Any, **more: Any) -> float:
    wanted = ExpectedOverTime(quantity="q", statistic=kind, at_least=0.0, **more)
    return statistic(TIMES, values, wanted)


def test_a_mean_is_one_over_time() -> None:
    assert of("mean", 3.0 * TIMES + 1.0, after=1.0, before=2.0) == pytest.approx(5.5, abs=0.02)
    uneven = np.array([0.0, 1.0, 10.0])
    wanted = ExpectedOverTime(quantity="q", statistic="mean", at_least=0.0)
    assert statistic(uneven, np.array([0.0, 2.0, 2.0]), wanted) == pytest.approx(1.9)


def test_a_peak_lies_between_steps() -> None:
    values = np.cos(2.0 * np.pi * (TIMES - 0.3127))
    assert of("peak_time", values, after=1.0, before=1.6) == pytest.approx(1.3127, abs=1e-4)
    assert of("peak_time", -TIMES, after=1.0) == pytest.approx(1.0, abs=0.02)


def test_a_decay_goes_somewhere() -> None:
    assert of("decay_rate", 4.0 - np.exp(-1.7 * TIMES), toward=4.0, after=0.5) == pytest.approx(1.7)
    assert np.isnan(of("decay_rate", np.cos(5.0 * TIMES)))


def test_the_largest_change_is_from_the_start() -> None:
    values = 2.0 + TIMES * (3.0 - TIMES)
    assert of("largest_change", values, after=2.0) == pytest.approx(values[TIMES >= 2.0].max() - values[0])


def test_time_below_a_level() -> None:
    values = np.abs(TIMES - 1.23)
    assert of("time_below", values, level=0.5) == pytest.approx(1.0, abs=1e-4)
    assert of("time_below", values, level=-1.0) == 0.0


def test_too_little_is_no_number_and_fails() -> None:
    wanted = ExpectedOverTime(quantity="q", statistic="mean", after=2.9999, before=3.0, value=1.0, rtol=1.0)
    assert np.isnan(statistic(TIMES[:200], TIMES[:200], wanted))
    assert verdict("q", float("nan"), wanted)["passed"] is False
    with pytest.raises(ValueError, match="history"):
        over_time_verdicts([wanted], None, {"q": 0.0})


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("angle", [30.0, 90.0, 150.0])
def test_the_angle_of_a_cap(dim: int, angle: float) -> None:
    """Samples of a cap half a cell outside of it, above a tilted wall; those on the wall do not count."""
    rng, spacing, radius = np.random.default_rng(1), 0.01, 0.2
    sphere = rng.standard_normal((4000, dim))
    sphere /= np.linalg.norm(sphere, axis=1)[:, None]
    normal = np.array([0.6, 0.8, 0.0])[:dim]
    center = np.array([0.3, -0.2, 0.1])[:dim]
    wall = -radius * np.cos(np.deg2rad(angle))  # height of the centre over the wall
    samples = center + (radius + 0.5 * spacing) * sphere
    height = (samples - center) @ normal + wall
    below = height < 0.0
    samples[below] -= height[below, None] * normal
    height[below] = 0.0
    assert apparent_angle(height, samples, normal, spacing) == pytest.approx(angle, abs=1e-6)
    assert np.isnan(apparent_angle(height[:3], samples[:3], normal, spacing))


def test_the_new_quantities_of_a_run(tmp_path: Path) -> None:
    """A disc that is stretched and turns, warmer on one side; what a region holds; what a floor sees."""
    rate = [[0.3, -0.5], [0.5, -0.3]]
    half = {"kind": "box", "min": [0.5, 0.0], "max": [1.0, 1.0]}
    ball = {"kind": "sphere", "center": [0.5, 0.5], "radius": 0.08}
    nothing = {"kind": "sphere", "center": [0.1, 0.1], "radius": 0.02}
    measure = {
        "right": {"kind": "mean_velocity", "component": "x", "within": half},
        "up": {"kind": "mean_velocity", "component": "y", "within": half},
        "place": {"kind": "centroid", "component": "x", "within": half},
        "height": {"kind": "centroid", "component": "y", "within": half},
        "core": {"kind": "mass", "within": ball},
        "nobody": {"kind": "mean_pressure", "within": nothing},
        "nowhere": {"kind": "centroid", "component": "x", "within": nothing},
        "spin": {"kind": "angular_momentum", "component": "z"},
        "warm": {"kind": "thermal_moment", "component": "x"},
        "angle": {"kind": "contact_angle", "wall": 0},
    }
    out = run(
        tmp_path,
        measure=measure,
        temperature={"value": 300.0, "gradient": [8.0, 0.0], "at": [0.5, 0.5]},
        liquid={"density": 10.0, "bulk_modulus": 0.0, "viscosity": 0.0},
        walls=[{"shape": {"kind": "plane", "point": [0.0, 0.1], "normal": [0.0, 2.0]}}],
        velocity_gradient=rate,
        time={"scheme": "explicit", "dt": 1e-6, "end": 2e-6},
        expect={"over_time": [{"quantity": "warm", "statistic": "mean", "value": 0.045, "rtol": 0.05}]},
    )
    row = {name: values[-1] for name, values in read_table(out / "history.csv").items()}
    assert row["measure.right"] == pytest.approx(0.3 * (row["measure.place"] - 0.5), rel=1e-4)
    assert row["measure.up"] == pytest.approx(0.5 * (row["measure.place"] - 0.5), rel=1e-4)
    assert row["measure.core"] == pytest.approx(10.0 * np.pi * 0.08**2, rel=0.2)
    assert np.isnan(row["measure.nobody"])
    assert np.isnan(row["measure.nowhere"])
    mass = 10.0 * np.pi * 0.15**2  # few points: their moment of inertia is 9 % off
    assert row["measure.spin"] == pytest.approx(0.5 * mass * (0.5 * 0.15**2 + 0.5 * 0.0625**2), rel=0.12)
    # G R^2 / 4; the circle does not touch the floor.
    assert row["measure.warm"] == pytest.approx(8.0 * 0.15**2 / 4.0, rel=0.05)
    assert row["measure.angle"] == 180.0


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (
            {"measure": {"a": {"kind": "surface_area", "within": {"kind": "box", "min": [0, 0], "max": [1, 1]}}}},
            "that of the whole surface",
        ),
        (
            {"measure": {"a": {"kind": "mass", "within": {"kind": "box", "min": [0, 0, 0], "max": [1, 1, 1]}}}},
            "needs 2 numbers",
        ),
        ({"measure": {"a": {"kind": "contact_angle"}}}, "measure.a.wall: wall 0 is not one of `walls`"),
        ({"velocity_gradient": [[1, 2], [3, 4], [5, 6]]}, "bodies.drop.velocity_gradient: needs 2 numbers"),
        ({"velocity_gradient": [[1, 2, 3], [3, 4, 5]]}, "bodies.drop.velocity_gradient[0]: needs 2 numbers"),
        (
            {"expect": {"over_time": [{"quantity": "a", "statistic": "mean", "at_least": 0}]}},
            "`a` is not measured",
        ),
        (
            {"expect": {"over_time": [{"quantity": "a", "statistic": "time_below", "at_least": 0}]}},
            "level: belongs to time_below",
        ),
        (
            {"expect": {"over_time": [{"quantity": "a", "statistic": "mean", "after": 2, "before": 1, "at_least": 0}]}},
            "before: must be later than after",
        ),
        (
            {"expect": {"over_time": [{"quantity": "a", "statistic": "mean", "after": 9, "at_least": 0}]}},
            "after: must be before the end of the run",
        ),
    ],
)
def test_faults(tmp_path: Path, more: dict[str, Any], message: str) -> None:
    faults = [str(fault) for fault in check_file(written(points(**more), tmp_path / "s.yaml"))]
    assert any(message in fault for fault in faults), faults


@pytest.mark.parametrize("scheme", ["pic", "flip"])
def test_transfers_without_affine_velocities_start_without(tmp_path: Path, scheme: str) -> None:
    """The first step of PIC loses dx^2/R^2 of sum m r^2 rate, and no affine part that the points never had."""
    more: dict[str, Any] = {"transfer": {"scheme": scheme, "flip": 0.0}, "angular_velocity": 2.0}
    out = run(
        tmp_path,
        liquid={"density": 10.0, "bulk_modulus": 0.0, "viscosity": 0.0},
        time={"scheme": "explicit", "dt": 1e-6, "end": 1e-6},
        measure={"spin": {"kind": "angular_momentum", "component": "z"}},
        expect={"over_time": [{"quantity": "spin", "statistic": "largest_change", "at_least": 0}]},
        **more,
    )
    start = 2.0 * read_checkpoint(out).fields["mass"] @ ((read_checkpoint(out).fields["x"] - 0.5) ** 2).sum(axis=1)
    lost = facts(out)["expect"][0]["computed"]
    assert 0.6 < lost / (start * 0.0625**2 / 0.15**2) < 1.0
    assert facts(out)["quantities"]["measure.spin"] == pytest.approx(start - lost, rel=1e-6)


def test_the_virial_is_that_of_pressure_and_surface(tmp_path: Path) -> None:
    kinds = {"p": "mean_pressure", "V": "volume", "E": "surface_energy", "virial": "virial"}
    out = run(
        tmp_path,
        time={"scheme": "explicit", "dt": 0.005, "end": 0.2},
        surface_tension={"liquid_gas": 0.2},
        measure={name: {"kind": kind} for name, kind in kinds.items()},
    )
    p, V, E, virial = (read_table(out / "history.csv")[f"measure.{name}"] for name in kinds)
    np.testing.assert_allclose(virial, 2.0 * p * V / E - 1.0, rtol=1e-9, atol=1e-12)
    dry = run(tmp_path, "dry", time={"scheme": "explicit"}, measure={"v": {"kind": "virial"}})
    assert np.isnan(read_table(dry / "history.csv")["measure.v"]).all()
