"""Scenes of material points from file to result folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista
from ruamel.yaml import YAML

from femdeform.run.checkpoint import read_checkpoint
from femdeform.run.point_course import PointCourse
from femdeform.run.runner import run_scene
from femdeform.run.table import read_table
from femdeform.scene.checks import check_file

LIQUID = {"density": 10.0, "bulk_modulus": 100.0, "viscosity": 0.01}
JELLY = {"law": "fixed_corotated", "density": 10.0, "youngs_modulus": 400.0, "poisson_ratio": 0.3}
DISC = {"kind": "sphere", "center": [0.5, 0.5], "radius": 0.15}


def points(*, time: dict[str, Any] | None = None, **more: Any) -> dict[str, Any]:
    """A drop in space; keys of the body go to it."""
    body = {"shape": DISC, "liquid": LIQUID}
    own = ("shape", "liquid", "solid", "phase", "velocity", "angular_velocity", "temperature", "surface_tension")
    body |= {key: more.pop(key) for key in (*own, "heat", "melting", "moduli", "velocity_gradient") if key in more}
    body = {key: value for key, value in body.items() if value is not None}
    data = {
        "simulation": "material_points",
        "grid": {"cell_size": 0.0625, "low": [0.0, 0.0], "high": [1.0, 1.0]},
        "bodies": {"drop": body},
        "time": {"dt": 0.01, "end": 0.1, **(time or {})},
    }
    return {**data, **more}


def written(data: dict[str, Any], path: Path) -> Path:
    with path.open("w") as file:
        YAML().dump(data, file)
    return path


def run(folder: Path, name: str = "out", code: int = 0, **more: Any) -> Path:
    out = folder / name
    assert run_scene(written(points(**more), folder / f"{name}.yaml"), out=out, threads=1, quiet=True) == code
    return out


def facts(out: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((out / "result.json").read_text())
    return found


SCHEMES = [{"scheme": "explicit"}, {"scheme": "backward_euler"}]


@pytest.mark.parametrize("time", SCHEMES, ids=lambda time: time["scheme"])
@pytest.mark.parametrize("phase", ["solid", "liquid"])
def test_free_fall(tmp_path: Path, time: dict[str, Any], phase: str) -> None:
    """All points fall by g dt^2 n (n + 1) / 2, whatever they are made of."""
    material = {"liquid": LIQUID} if phase == "liquid" else {"liquid": None, "solid": JELLY}
    measure = {"y": {"kind": "centroid", "component": "y"}, "spin": {"kind": "angular_momentum", "component": "z"}}
    more: dict[str, Any] = {"gravity": [0.0, -2.0], "velocity": [0.3, 0.1], "measure": measure, **material}
    out = run(tmp_path, time=time, output={"every": 5}, **more)
    history = read_table(out / "history.csv")
    steps = history["dt"]
    fallen = 0.5 + np.cumsum(steps * (0.1 - 2.0 * np.cumsum(steps)))
    np.testing.assert_allclose(history["measure.y"], fallen, atol=1e-11)
    last = pyvista.read(out / "final.vtp")
    assert set(last.point_data) == {"velocity", "J", "phase", "body"}
    np.testing.assert_allclose(last.point_data["J"], 1.0, atol=1e-9)
    assert (last.point_data["phase"] == (phase == "liquid")).all()


@pytest.mark.parametrize("time", SCHEMES, ids=lambda time: time["scheme"])
def test_a_drop_with_tension_keeps_its_momentum(tmp_path: Path, time: dict[str, Any]) -> None:
    names = {"px": ("linear_momentum", "x"), "spin": ("angular_momentum", "z"), "cy": ("centroid", "y")}
    measure: dict[str, Any] = {name: {"kind": kind, "component": c} for name, (kind, c) in names.items()}
    measure |= {"Q": {"kind": "second_moment"}, "area": {"kind": "surface_area"}}
    more: dict[str, Any] = {"surface": {"symmetric": time["scheme"] == "backward_euler"}, "measure": measure}
    more["shape"] = {"kind": "ellipsoid", "center": [0.5, 0.5], "semi_axes": [0.25, 0.12]}
    more["surface_tension"] = {"liquid_gas": 0.2}
    more["linear_solver"] = {"method": "scipy_direct"}
    out = run(tmp_path, time=time, velocity=[0.2, 0.0], angular_velocity=1.0, **more)
    history = read_table(out / "history.csv")
    scale = abs(history["measure.px"][0])
    np.testing.assert_allclose(history["measure.px"], history["measure.px"][0], atol=1e-12 * scale)
    np.testing.assert_allclose(history["measure.spin"], history["measure.spin"][0], rtol=1e-11)
    np.testing.assert_allclose(history["measure.cy"], history["measure.cy"][0], atol=1e-12)
    # Round a little more than before, and sampled in every step.
    assert history["measure.Q"][-1] < 0.99 * history["measure.Q"][0]
    assert (history["samples"] > 20).all()
    assert facts(out)["quantities"]["measure.area"] == pytest.approx(history["measure.area"][-1])


@pytest.mark.parametrize(
    "more",
    [
        {"time": {"scheme": "explicit"}, "gravity": [0.0, -5.0]},
        {"time": {"scheme": "explicit"}, "surface_tension": {"liquid_gas": 0.2}},
        {"time": {"scheme": "backward_euler"}, "surface_tension": {"liquid_gas": 0.2}},
        {"time": {"dt": 0.1, "end": 0.3, "cfl": 0.2}, "gravity": [-2.5, 2.5]},
    ],
    ids=["fast", "explicit", "implicit", "growing steps"],
)
def test_resumed_as_if_unbroken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, more: dict[str, Any]) -> None:
    walls = [{"shape": {"kind": "box", "min": [0.2, 0.3], "max": [0.8, 0.8]}, "inside": True, "friction": 0.2}]
    more = {"velocity": [0.5, -0.5], "walls": walls, "output": {"checkpoint_every": 3}, **more}
    whole = run(tmp_path, "whole", **more)

    class StopError(Exception):
        pass

    row, count = PointCourse.row, [0]

    def stop(self: PointCourse, state: Any, report: Any) -> dict[str, Any]:
        count[0] += 1
        if count[0] == 5:
            raise StopError
        return row(self, state, report)

    with monkeypatch.context() as patch:
        patch.setattr(PointCourse, "row", stop)
        with pytest.raises(StopError):
            run_scene(tmp_path / "whole.yaml", out=tmp_path / "broken", threads=1, quiet=True)
    assert read_checkpoint(tmp_path / "broken").step == 3
    assert run_scene(tmp_path / "whole.yaml", out=tmp_path / "broken", resume=True, threads=1, quiet=True) == 0
    ours, theirs = read_checkpoint(whole).fields, read_checkpoint(tmp_path / "broken").fields
    for name, values in ours.items():
        np.testing.assert_array_equal(theirs[name], values, err_msg=name)


@pytest.mark.parametrize("growth", [1.2, 2.0])
def test_steps_are_as_long_as_speeds_allow_and_grow_slowly(tmp_path: Path, growth: float) -> None:
    """A drop that is thrown up: at its highest point steps could be of any length."""
    time = {"dt": 0.1, "end": 0.4, "cfl": 0.2, "growth": growth}
    measure = {"v": {"kind": "max_speed"}}
    history = read_table(
        run(tmp_path, time=time, velocity=[0.0, 1.0], gravity=[0.0, -5.0], measure=measure) / "history.csv"
    )
    dt, speed = history["dt"], np.concatenate(([1.0], history["measure.v"]))[:-1]
    assert dt[0] == pytest.approx(0.2 * 0.0625)
    courant, ratios = dt * speed / 0.0625, dt[1:] / dt[:-1]
    assert courant.max() <= 0.2 * (1.0 + 1e-12)
    assert ratios.max() == pytest.approx(growth)
    # Each step but the last is as long as one of the two rules allows.
    bound = np.minimum(0.2 * 0.0625 / speed[1:-1], growth * dt[:-2])
    np.testing.assert_allclose(dt[1:-1], np.minimum(bound, 0.1), rtol=1e-9)


def history_of_what_melts(
    tmp_path: Path, heat: dict[str, Any], melting: dict[str, Any], names: tuple[str, ...]
) -> dict[str, Any]:
    out = run(
        tmp_path,
        solid=JELLY,
        phase="solid",
        temperature=300.0,
        heat=heat,
        melting=melting,
        time={"dt": 0.02, "end": 0.4},
        linear_solver={"method": "scipy_direct"},
        measure={name: {"kind": name} for name in names},
    )
    return read_table(out / "history.csv")


def test_heat_comes_in_and_melts(tmp_path: Path) -> None:
    heat = {"capacity": 2.0, "conductivity": 0.05, "transfer": 0.6, "ambient": 400.0}
    melting = {"solidus": 305.0, "liquidus": 315.0, "latent_heat": 5.0}
    names = ("heat", "liquid_fraction", "max_temperature", "min_temperature")
    history = history_of_what_melts(tmp_path, heat, melting, names)
    assert history["melted"].sum() > 10
    assert 0.05 < history["measure.liquid_fraction"][-1] < 1.0
    assert history["measure.max_temperature"][-1] < 400.0
    assert history["measure.min_temperature"][0] == pytest.approx(300.0, abs=0.1)
    assert (history["boundary_power"] > 0.0).all()


@pytest.mark.parametrize("latent_heat", [0.0, 5.0])
def test_heat_of_what_melts_with_two_capacities_is_what_comes_in(tmp_path: Path, latent_heat: float) -> None:
    heat = {"capacity": 2.0, "conductivity": 0.05, "source": 2000.0, "source_end": 0.3}
    heat["source_within"] = {"kind": "box", "min": [0.0, 0.0], "max": [0.5, 1.0], "velocity": [0.2, 0.0]}
    melting = {"solidus": 305.0, "liquidus": 315.0, "latent_heat": latent_heat, "liquid_capacity": 6.0}
    names = ("heat", "liquid_fraction")
    history = history_of_what_melts(tmp_path, heat, melting, names)
    assert 0.05 < history["measure.liquid_fraction"][-1] < 1.0
    assert (history["source_power"][:15] > 0.0).all()
    np.testing.assert_array_equal(history["source_power"][15:], 0.0)
    gained = np.diff(history["measure.heat"])
    brought = (history["dt"] * history["source_power"])[1:]
    np.testing.assert_allclose(gained, brought, rtol=0.0, atol=1e-11 * history["measure.heat"][-1])


def test_a_wall_holds_a_column(tmp_path: Path) -> None:
    """At rest the floor bears the weight: the pressure grows downwards."""
    shape = {"kind": "box", "min": [0.25, 0.125], "max": [0.75, 0.5]}
    walls = [{"shape": {"kind": "box", "min": [0.25, 0.125], "max": [0.75, 1.0]}, "inside": True, "kind": "slip"}]
    out = run(
        tmp_path,
        shape=shape,
        walls=walls,
        gravity=[0.0, -1.0],
        liquid={"density": 10.0, "bulk_modulus": 500.0, "viscosity": 1.0},
        time={"dt": 0.05, "end": 3.0},
        linear_solver={"method": "scipy_direct"},
        output={"fields": ["pressure", "speed"], "every": 60},
        measure={"p": {"kind": "mean_pressure"}},
    )
    last = pyvista.read(out / "final.vtp")
    assert last.point_data["speed"].max() < 0.02
    assert facts(out)["quantities"]["measure.p"] == pytest.approx(10.0 * 0.375 / 2, rel=0.1)
    low = last.points[:, 1] < 0.2
    assert last.point_data["pressure"][low].mean() > 2.0 * last.point_data["pressure"][~low].mean() > 0.0


@pytest.mark.parametrize("method", ["ksp", "block_cg"])
def test_linear_solvers_give_the_same_step(tmp_path: Path, method: str) -> None:
    if method == "ksp":
        pytest.importorskip("petsc4py")
    more: dict[str, Any] = {"surface_tension": {"liquid_gas": 0.2}, "solver": {"tolerance": 1e-10}}
    options = {"method": method, "tolerance": 1e-10} if method == "block_cg" else {"method": method}
    one = read_checkpoint(run(tmp_path, "a", linear_solver={"method": "scipy_direct"}, **more)).fields
    two = read_checkpoint(run(tmp_path, "b", linear_solver=options, **more)).fields
    np.testing.assert_allclose(two["x"], one["x"], atol=1e-9)


def test_in_three_dimensions(tmp_path: Path) -> None:
    out = run(
        tmp_path,
        grid={"cell_size": 0.125, "low": [0, 0, 0], "high": [1, 1, 1]},
        shape={"kind": "sphere", "center": [0.5, 0.5, 0.5], "radius": 0.25},
        surface_tension={"liquid_gas": 0.2},
        angular_velocity=[0.0, 1.0, 0.0],
        time={"dt": 0.02, "end": 0.04},
        linear_solver={"method": "scipy_direct"},
        measure={"spin": {"kind": "angular_momentum", "component": "y"}, "p": {"kind": "mean_pressure"}},
    )
    history = read_table(out / "history.csv")
    assert history["measure.spin"][-1] > 0.0
    assert history["samples"].min() > 100


def test_points_that_leave_the_domain_end_the_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, time in (("a", SCHEMES[0]), ("b", SCHEMES[1])):
        out = run(
            tmp_path, name, 3, velocity=[5.0, 0.0], time={**time, "end": 1.0}, linear_solver={"method": "scipy_direct"}
        )
        assert facts(out)["status"] == "not_converged"
        assert "domain" in facts(out)["reason"]
        assert facts(out)["steps"] > 0


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"gravity": [0, 0, 1]}, "gravity: needs 2 numbers in a domain of 2 dimensions, not 3"),
        ({"angular_velocity": [0, 0, 1.0]}, "bodies.drop.angular_velocity: is a number in 2D"),
        ({"liquid": None}, "bodies.drop: needs `solid` or `liquid`, a material"),
        ({"solid": JELLY}, "phase: needed where there are both, solid and liquid"),
        ({"surface_tension": {"liquid_gas": 1.0, "solid_liquid": 0.0, "contact_angle": 90.0}}, "cannot be combined"),
        ({"measure": {"a": {"kind": "centroid", "component": "z"}}}, "there is no z in the plane"),
        ({"measure": {"a": {"kind": "mass", "body": "dorp"}}}, "did you mean `drop`?"),
        ({"expect": {"measured": {"a": {"at_least": 0}}}}, "`a` is not measured"),
        ({"time": {"scheme": "explicit"}, "surface": {"symmetric": True}}, "is for implicit steps"),
        ({"melting": {"solidus": 1.0, "liquidus": 2.0}}, "melting: needs heat, solid and liquid"),
        (
            {"shape": {"kind": "mesh", "mesh": {"recipe": "sphere", "radius": 0.1, "element_size": 0.05}}},
            "bodies.drop.shape.mesh: is 3D, the domain is 2D",
        ),
    ],
)
def test_faults_have_their_key(tmp_path: Path, more: dict[str, Any], message: str) -> None:
    faults = [str(fault) for fault in check_file(written(points(**more), tmp_path / "s.yaml"))]
    assert any(message in fault for fault in faults), faults


def test_points_that_resist_no_more_are_told_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A drop of almost nothing that flows together: its points end at the lower bound of J."""
    soft = {"density": 10.0, "bulk_modulus": 1e-6}
    scene = points(liquid=soft, velocity_gradient=[[-4.0, 0.0], [0.0, -4.0]], time={"scheme": "explicit", "end": 0.4})
    assert run_scene(written(scene, tmp_path / "soft.yaml"), out=tmp_path / "out", threads=1) == 0
    told = [line for line in capsys.readouterr().err.splitlines() if "resist no more" in line]
    assert len(told) == 1
    history = read_table(tmp_path / "out" / "history.csv")
    first = int(history["step"][np.flatnonzero(history["bounded"] > 0.02 * facts(tmp_path / "out")["n_cells"])[0]])
    assert f"step {first}: " in told[0]
