"""Measured quantities against what the states say directly, and expectations on them."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scenario import block, body, build, material, quasistatic, run, scene, step, write

from femdeform.errors import InputError
from femdeform.run.expectations import check_expectations, describe_verdict, time_to_reach
from femdeform.run.quantities import Meter, standard_quantities
from femdeform.run.result import Result
from femdeform.run.runner import run_scene
from femdeform.scene.quantity_schema import ExpectedTime

G = 9.81
HELD = {"kind": "fixed", "on": "b.left"}
ALL_SCALARS = (
    "volume_ratio",
    "elastic_energy",
    "min_jacobian",
    "max_von_mises",
    "inverted_cells",
    "kinetic_energy",
    "load_potential",
    "total_energy",
    "max_displacement",
)


def measured(data: dict[str, Any]) -> dict[str, float]:
    simulation = run(data)
    return Meter(simulation).evaluate(simulation.state)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("dim", [2, 3])
def test_supports_carry_the_weight(dim: int, order: int) -> None:
    """A heavy bar at rest: reaction, its moment about the clamp and the loads balance, on the deformed shape."""
    size, cells = [1.0, 0.2, 0.3][:dim], [6, 2, 1][:dim]
    weight = 1000.0 * float(np.prod(size)) * G
    moment: dict[str, Any] = {"kind": "moment", "on": "b.left", "center": [0.0] * dim}
    if dim == 3:
        moment["axis"] = [0, 0, 2.0]
    data = scene(
        {"b": body(block(size, cells), material(E=1e6), element_order=order)},
        HELD,
        gravity=[0.0, -G, 0.0][:dim],
        time=quasistatic(),
        solver={"tolerance": 1e-11},
        measure={
            "up": {"kind": "reaction", "on": "b.left", "component": "y"},
            "size": {"kind": "reaction", "on": "b", "component": "norm"},
            "free": {"kind": "reaction", "on": "b.right", "component": "norm"},
            "moment": moment,
        },
    )
    simulation = run(data)
    values = Meter(simulation).evaluate(simulation.state)
    assert values["up"] == pytest.approx(weight, rel=1e-8)
    assert values["size"] == pytest.approx(weight, rel=1e-8)
    assert values["free"] == 0.0
    # The weight pulls at the centre of mass of the deformed bar; the support holds against it.
    mass = simulation.discretization.row_mass
    arm = float(mass @ simulation.state.x[:, 0] / mass.sum())
    assert values["moment"] == pytest.approx(weight * arm, rel=1e-6)


def test_a_support_also_carries_inertia() -> None:
    """A body that is thrown upwards by its support: force = mass times acceleration, plus the weight."""
    data = scene(
        {"b": body(block([1.0, 1.0], [2, 2]))},
        {"kind": "path", "on": "b", "times": [0.0, 0.01, 0.02], "displacements": [[0, 0], [0, 0.01], [0, 0.03]]},
        gravity=[0.0, -G],
        time={"scheme": "backward_euler", "dt": 0.01, "end": 0.02},
        measure={"push": {"kind": "reaction", "on": "b", "component": "y"}},
    )
    simulation = run(data)
    # Velocities 1 and 2 m/s, 0.01 s apart: 100 m/s^2.
    assert Meter(simulation).evaluate(simulation.state)["push"] == pytest.approx(1000.0 * (100.0 + G), rel=1e-9)


@pytest.mark.parametrize("order", [1, 2])
def test_a_point_is_interpolated_in_its_cell(order: int) -> None:
    """A quadratic field is met exactly by P2 anywhere, by P1 at nodes only."""
    place = [0.37, 0.61, 0.23]
    data = scene(
        {"b": body(block([1.0, 1.0, 1.0], [3, 3, 3]), element_order=order)},
        measure={
            "inside": {"kind": "displacement", "at": place, "component": "x"},
            "node": {"kind": "displacement", "at": [1.0, 1.0, 1.0], "component": "z"},
            "speed": {"kind": "velocity", "at": place, "component": "norm"},
        },
    )
    simulation = build(data)
    X = simulation.discretization.points
    field = np.stack([X[:, 0] ** 2 + X[:, 1] * X[:, 2], X[:, 2] ** 2, X.sum(axis=1)], axis=1)
    simulation.state.x += field
    simulation.state.v[:] = [3.0, 0.0, 4.0]
    values = Meter(simulation).evaluate(simulation.state)
    exact = place[0] ** 2 + place[1] * place[2]
    if order == 2:
        assert values["inside"] == pytest.approx(exact, rel=1e-12)
    else:
        assert 1e-4 < abs(values["inside"] - exact) < 0.1
    assert values["node"] == pytest.approx(3.0, rel=1e-12)
    assert values["speed"] == pytest.approx(5.0, rel=1e-12)


def test_scalars_of_the_scene_and_of_one_body() -> None:
    """Two blocks, one stretched: each quantity of a body is that of the body alone."""
    bodies = {
        "b": body(block([1.0, 1.0], [2, 2])),
        "c": body(block([1.0, 1.0], [2, 2], translate=[3.0, 0.0])),
    }
    measure = {kind: {"kind": kind} for kind in ALL_SCALARS}
    of_cells = ALL_SCALARS[:5]
    measure |= {f"{kind}_{name}": {"kind": kind, "body": name} for kind in of_cells for name in "bc"}
    measure["momentum"] = {"kind": "linear_momentum", "component": "y"}
    measure["spin"] = {"kind": "angular_momentum", "component": "z"}
    simulation = build(scene(bodies, measure=measure))
    simulation.problem.begin_step(simulation.state, 0.01)
    state, X = simulation.state, simulation.discretization.points
    stretched = X[:, 0] > 2.0
    state.x[stretched, 0] += 0.5 * (X[stretched, 0] - 3.0)
    state.v[:] = [0.0, 2.0]
    values = Meter(simulation).evaluate(state)
    assert values["volume_ratio"] == pytest.approx(1.25)
    assert (values["volume_ratio_b"], values["volume_ratio_c"]) == pytest.approx((1.0, 1.5))
    assert (values["min_jacobian"], values["min_jacobian_c"]) == pytest.approx((1.0, 1.5))
    assert values["elastic_energy_b"] == pytest.approx(0.0, abs=1e-9)
    assert values["elastic_energy"] == pytest.approx(values["elastic_energy_c"])
    assert values["max_von_mises_b"] == pytest.approx(0.0, abs=1e-6)
    assert values["max_von_mises"] == values["max_von_mises_c"] > 1e4
    assert values["max_displacement"] == pytest.approx(0.5)
    assert values["kinetic_energy"] == pytest.approx(0.5 * 2000.0 * 4.0)
    assert values["total_energy"] == pytest.approx(values["kinetic_energy"] + values["elastic_energy"])
    assert values["momentum"] == pytest.approx(4000.0)
    assert values["spin"] == pytest.approx(2.0 * float(simulation.discretization.lumped_mass @ state.x[:, 0]))
    assert values["inverted_cells"] == 0.0
    state.x[stretched, 1] *= -1.0
    values = Meter(simulation).evaluate(state)
    assert (values["inverted_cells"], values["inverted_cells_b"], values["inverted_cells_c"]) == (8.0, 0.0, 8.0)
    assert set(standard_quantities(simulation, state)) < set(ALL_SCALARS)


# ---------------------------------------------------------------------------------------------- expectations


def history(values: list[float]) -> dict[str, np.ndarray[Any, Any]]:
    return {"time": 0.1 * np.arange(1, len(values) + 1), "measure.tip": np.array(values)}


@pytest.mark.parametrize(
    ("level", "values", "time"),
    [
        (-1.0, [-0.5, -1.5], 0.15),
        (-1.0, [-2.0, -1.0], 0.05),  # within the first step, from the value at the start
        (0.5, [0.2, 0.5, 0.4], 0.2),
        (0.5, [0.2, 0.4, 0.3], np.inf),
        (0.0, [0.2, 0.4], 0.0),
    ],
)
def test_time_to_reach(level: float, values: list[float], time: float) -> None:
    wanted = ExpectedTime.model_validate({"quantity": "tip", "level": level, "at_most": 1.0})
    assert time_to_reach(history(values), wanted, 0.0) == pytest.approx(time)


def test_verdicts() -> None:
    """One that holds and one that does not, of each kind."""
    data = scene(
        {"b": body(block([1.0, 0.2], [4, 1]))},
        HELD,
        {"kind": "translate", "on": "b.right", "velocity": [0.1, 0.0]},
        time=quasistatic(),
        measure={"pull": {"kind": "reaction", "on": "b.right", "component": "x"}},
        expect={
            "volume_ratio": {"at_least": 1.0, "at_most": 1.1},
            "total_energy": {"at_least": 0.0},
            "residual": {"at_most": 1e-3},
            "displacement": [
                {"on": "b.right", "component": "x", "value": 0.1, "atol": 1e-12},
                {"at": [0.5, 0.1], "component": "x", "value": 0.06, "atol": 1e-3},
            ],
            "reaction": [{"on": "b.left", "component": "x", "at_least": 0.0}],
            "measured": {"pull": {"at_least": 0.0}},
            "time_to_reach": [{"quantity": "pull", "level": 1e9, "value": 0.5, "rtol": 1.0}],
        },
    )
    simulation = run(data)
    columns = {"relative_residual": np.array([1e-9, 1e-4]), "time": np.array([1.0]), "measure.pull": np.array([1e3])}
    verdicts = check_expectations(simulation, simulation.state, columns)
    passed = {verdict["quantity"]: verdict["passed"] for verdict in verdicts}
    assert passed == {
        "volume_ratio": True,
        "total_energy": True,
        "residual": True,
        "displacement.x on b.right": True,
        "displacement.x on point [0.5, 0.1]": False,
        "reaction.x on b.left": False,
        "measure.pull": True,
        "time at which pull reaches 1e+09": False,
    }
    texts = [describe_verdict(verdict) for verdict in verdicts]
    assert texts[0].endswith("expected at least 1 and at most 1.1")
    assert texts[2] == "residual is 0.0001, expected at most 0.001"
    assert texts[3] == "displacement.x on b.right is 0.1, expected 0.1"
    with pytest.raises(ValueError, match="history"):
        check_expectations(simulation, simulation.state)


def falling(**expect: Any) -> dict[str, Any]:
    return scene(
        {"b": body(block([1.0, 0.2], [4, 1]))},
        HELD,
        gravity=[0.0, -G],
        time={"scheme": "backward_euler", "dt": 0.01, "end": 0.05},
        measure={
            "tip": {"kind": "displacement", "at": [1.0, 0.1], "component": "y"},
            "force": {"kind": "reaction", "on": "b.left", "component": "y"},
        },
        expect=expect,
        output={"checkpoint_every": 1},
    )


def test_a_run_writes_what_it_measures_and_keeps_it_when_resumed(tmp_path: Path) -> None:
    expect = {
        "reaction": [{"on": "b.left", "component": "y", "at_least": 0.0}],
        "time_to_reach": [{"quantity": "tip", "level": -1e-3, "value": 0.02, "rtol": 0.9}],
        "residual": {"at_most": 1e-5},
    }
    path, out = write(falling(**expect), tmp_path / "scene.yaml"), tmp_path / "out"
    assert run_scene(path, out=out, quiet=True) == 0
    with (out / "history.csv").open() as file:
        rows = list(csv.DictReader(file))
    facts = json.loads((out / "result.json").read_text())
    assert len(rows) == 5
    assert facts["quantities"]["measure.tip"] == float(rows[-1]["measure.tip"])
    assert facts["quantities"]["measure.force"] == facts["expect"][1]["computed"]
    assert set(facts["quantities"]) >= {"volume_ratio", "elastic_energy", "max_displacement"}
    # A finished run has nothing left to do, and says so; its result stays as it is.
    assert run_scene(path, out=out, quiet=True, resume=True) == 0
    again = json.loads((out / "result.json").read_text())
    assert (again["expect"], again["quantities"]) == (facts["expect"], facts["quantities"])


def test_a_failed_expectation_says_what_was_wanted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(falling(residual={"at_most": 1e-30}), tmp_path / "scene.yaml")
    assert run_scene(path, out=tmp_path / "out", quiet=True) == 1
    facts = json.loads((tmp_path / "out" / "result.json").read_text())
    assert facts["status"] == "expectation_failed"
    assert "residual is" in facts["reason"]
    assert "expected at most 1e-30" in capsys.readouterr().err


def test_point_outside_is_refused() -> None:
    data = falling() | {"measure": {"tip": {"kind": "displacement", "at": [5.0, 0.1], "component": "y"}}}
    with pytest.raises(InputError, match=r"measure\.tip\.at: the point lies in no cell"):
        build(data)


def test_measuring_changes_nothing() -> None:
    """The forces that are measured must not disturb the steps that follow."""
    quiet = falling()
    del quiet["measure"]
    loud, plain = build(falling()), build(quiet)
    meter = Meter(loud)
    for _ in range(3):
        step(loud)
        meter.evaluate(loud.state)
        step(plain)
    np.testing.assert_array_equal(loud.state.x, plain.state.x)


def test_reactions_can_be_drawn(tmp_path: Path) -> None:
    """The nodal forces of the last frame add up to what the history measured; the first frame has none."""
    data = falling() | {"output": {"fields": ["displacement", "reaction"]}}
    assert run_scene(write(data, tmp_path / "scene.yaml"), out=tmp_path / "out", quiet=True) == 0
    result = Result.open(tmp_path / "out")
    for frame in (result.read_frame(-1), result.read_final()):
        reaction = frame.point_data["reaction"]
        held = frame.points[:, 0] == 0.0
        assert not reaction[~held].any()
        assert reaction[:, 1].sum() == pytest.approx(result.history["measure.force"][-1], rel=1e-6)
    assert not result.read_frame(0).point_data["reaction"].any()
