"""From a study file to runs: expansion, overrides, hashes, faults of keys and values."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenario import block, body, quasistatic, scene, write

from femdeform.errors import InputError
from femdeform.run.batch_plan import Choice, Plan, expand, in_range, latin_hypercube, short_keys
from femdeform.run.batch_scenes import check_runs, plan_runs
from femdeform.scene.batch_schema import Range, Study, count_runs, load_study, varied_keys
from femdeform.scene.comparison_schema import is_comparison
from femdeform.scene.overrides import parse_override

SWEEP: dict[str, Any] = {
    "grid": {"time.dt": [0.1, 0.2], "bodies.b.mesh.cells": [[2, 1], [4, 2]]},
    "zip": {"a.x": [1, 2, 3], "a.y": ["p", "q", "r"]},
    "list": [{"c": 1}, {"c": 2, "d": True}],
}


def small(**more: Any) -> dict[str, Any]:
    bodies = {"b": body(block([1.0, 0.2], [2, 1]))}
    pull = {"kind": "point_load", "on": "b.right", "force": [0.0, -1.0]}
    return scene(bodies, {"kind": "fixed", "on": "b.left"}, pull, time=quasistatic(dt=0.5), **more)


def quiet(done: int, total: int) -> None:
    assert done <= total


def plan(folder: Path, study: dict[str, Any], **more: Any) -> Plan:
    write(small(**more), folder / "scene.yaml")
    return plan_runs(load_study(write({"scene": "scene.yaml", **study}, folder / "study.yaml")), quiet)


def faults(folder: Path, study: dict[str, Any], **more: Any) -> list[str]:
    """Faults of a study as `key: message`, after making sure that each names the study or the scene with a line."""

    def judge() -> None:
        made = plan(folder, study, **more)
        check_runs(made, made.runs, quiet)

    with pytest.raises(InputError) as caught:
        judge()
    assert all(Path(fault.file).parent == folder and fault.line > 0 for fault in caught.value.faults)
    return [f"{fault.key}: {fault.message}" for fault in caught.value.faults]


# ------------------------------------------------------------------------------------------------- expansion


def test_parts_combine_as_a_product_and_the_last_varies_fastest() -> None:
    study = Study.model_validate({"scene": "s.yaml", "set": {"title": "t"}, "sweep": SWEEP})
    runs = expand(study)
    values = [{choice.key: choice.value for choice in run.varied} for run in runs]
    assert [run.number for run in runs] == list(range(1, 25))
    assert count_runs(study.sweep) == len(runs) == 2 * 2 * 3 * 2
    assert list(varied_keys(study.sweep)) == ["time.dt", "bodies.b.mesh.cells", "a.x", "a.y", "c", "d"]
    assert values[0] == {"time.dt": 0.1, "bodies.b.mesh.cells": [2, 1], "a.x": 1, "a.y": "p", "c": 1}
    assert values[1] == {**values[0], "c": 2, "d": True}
    assert values[2] == {**values[0], "a.x": 2, "a.y": "q"}
    assert values[6] == {**values[0], "bodies.b.mesh.cells": [4, 2]}
    assert values[12] == {**values[0], "time.dt": 0.2}
    assert {(v["a.x"], v["a.y"]) for v in values} == {(1, "p"), (2, "q"), (3, "r")}
    assert all(run.fixed == (Choice("title", "t", ("set", "title")),) for run in runs)


def test_a_block_is_set_before_the_keys_inside_it(tmp_path: Path) -> None:
    blocks = [{"scheme": "quasistatic", "dt": 0.25, "end": 1.0}, {"scheme": "backward_euler", "dt": 0.1, "end": 2.0}]
    made = plan(tmp_path, {"set": {"time.dt": 0.5}, "sweep": {"grid": {"time": blocks}}})
    assert [text.partition("=")[0] for text in made.runs[0].overrides] == ["time", "time.dt"]
    # The two scenes differ from each other, and `time.dt` holds in both.
    assert made.runs[0].hash != made.runs[1].hash
    assert made.runs[0].hash == plan(tmp_path, {"sweep": {"grid": {"time.end": [1.0]}}}).runs[0].hash


# Text that a YAML file can hold, in quotes at least.
TEXT = st.text(st.characters(exclude_categories=["C"]) | st.sampled_from("\n\t"))
NUMBERS = st.integers(-(10**6), 10**6) | st.floats(allow_nan=False, allow_infinity=False)
PLAIN_DATA = st.recursive(
    st.none() | st.booleans() | NUMBERS | TEXT,
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(TEXT.filter(lambda key: key != "<<"), inner, max_size=3)
    ),
    max_leaves=6,
)


@settings(max_examples=200, derandomize=True, deadline=None, database=None)
@given(PLAIN_DATA)
def test_an_override_says_what_the_study_says(value: Any) -> None:
    override, problems = parse_override(Choice("a.b", value, ()).override)
    assert problems == []
    assert override is not None
    assert override.path == ("a", "b")
    assert override.value == value
    assert type(override.value) is type(value)


def test_short_keys_stay_distinct() -> None:
    keys = ["bodies.a.material.density", "bodies.b.material.density", "conditions[0].rate", "time", "x.time"]
    assert list(short_keys(keys).values()) == ["a.material.density", "b.material.density", "rate", "time", "x.time"]
    assert short_keys(["time.dt"]) == {"time.dt": "dt"}


# ------------------------------------------------------------------------------------------------- samples


def test_a_latin_hypercube_has_one_point_in_every_slice() -> None:
    points = latin_hypercube(3, 40, seed=7)
    for column in points.T:
        np.testing.assert_array_equal(np.sort(np.floor(40 * column)), np.arange(40))
    np.testing.assert_array_equal(points, latin_hypercube(3, 40, seed=7))
    assert not np.array_equal(points, latin_hypercube(3, 40, seed=8))


def test_ranges() -> None:
    u = np.linspace(0.0, 1.0, 1000, endpoint=False)
    linear = [in_range(Range(min=-2.0, max=4.0), x) for x in u]
    np.testing.assert_allclose(linear, -2.0 + 6.0 * u, atol=1e-7)
    log = [in_range(Range(min=1e3, max=1e6, scale="log"), x) for x in u]
    np.testing.assert_allclose(np.log10(log), 3.0 + 3.0 * u, atol=1e-7)
    whole = [in_range(Range(min=2, max=5, integer=True), x) for x in u]
    assert all(type(value) is int for value in whole)
    np.testing.assert_array_equal(np.bincount(np.array(whole)), [0, 0, 250, 250, 250, 250])
    assert {in_range(Range(min=1, max=100, integer=True, scale="log"), x) for x in (0.0, 1.0 - 1e-16)} == {1, 100}
    narrow = Range(min=0.123456789, max=0.12345679)
    assert all(narrow.min <= in_range(narrow, x) <= narrow.max for x in u)


def test_samples_reach_the_scenes(tmp_path: Path) -> None:
    ranges = {
        "bodies.b.material.youngs_modulus": {"min": 1e3, "max": 1e6, "scale": "log"},
        "bodies.b.mesh.cells[0]": {"min": 1, "max": 8, "integer": True},
    }
    sweep = {"latin_hypercube": {"samples": 8, "seed": 1, "ranges": ranges}}
    made = plan(tmp_path, {"sweep": sweep})
    columns = list(zip(*([choice.value for choice in run.varied] for run in made.runs), strict=True))
    assert sorted(columns[1]) == list(range(1, 9))
    assert sorted(math.floor(8 * math.log(v / 1e3, 1e3)) for v in columns[0]) == list(range(8))
    check_runs(made, made.runs, quiet)
    assert [run.hash for run in made.runs] == [run.hash for run in plan(tmp_path, {"sweep": sweep}).runs]


# ------------------------------------------------------------------------------------------------- hashes


def test_the_hash_is_that_of_the_scene_not_of_the_study(tmp_path: Path) -> None:
    first = plan(tmp_path, {"sweep": {"grid": {"time.dt": [0.5, 0.25, 0.125]}}})
    other = plan(
        tmp_path,
        {"title": "other", "set": {"time.end": 1.0}, "sweep": {"list": [{"time.dt": 0.125}, {"time.dt": 0.5}]}},
    )
    assert len({run.name for run in first.runs}) == 3
    assert [run.hash for run in other.runs] == [first.runs[2].hash, first.runs[0].hash]
    assert all(len(run.name) == 12 and run.hash.startswith(run.name) for run in first.runs)
    changed = plan(tmp_path, {"sweep": {"grid": {"time.dt": [0.5]}}}, gravity=[0.0, -1.0])
    assert changed.runs[0].hash != first.runs[0].hash


def test_the_hash_covers_mesh_files(tmp_path: Path) -> None:
    mesh = tmp_path / "m.vtk"
    study = {"set": {"bodies.b.mesh": {"file": "m.vtk"}}, "sweep": {"grid": {"time.dt": [0.5]}}}
    hashes = []
    for content in ("a", "b", "a"):
        mesh.write_text(content)
        hashes.append(plan(tmp_path, study).runs[0].hash)
    assert hashes[0] == hashes[2] != hashes[1]


def test_equal_scenes_are_one_run(tmp_path: Path) -> None:
    made = plan(tmp_path, {"sweep": {"list": [{"time.dt": 0.5}, {"time.dt": 0.25}, {"time.dt": 0.5}]}})
    assert len(made.runs) == 3
    assert [run.number for run in made.distinct.values()] == [1, 2]


# ------------------------------------------------------------------------------------------------- scalars


def test_scalars(tmp_path: Path) -> None:
    tip = {"tip": {"kind": "displacement", "on": "b.right", "component": "y"}}
    sweep = {"grid": {"time.dt": [0.5]}}
    names = ["tip", "quantities.volume_ratio", "steps", "measure.tip", "volum_ratio"]
    found = faults(tmp_path, {"scalars": names, "sweep": sweep}, measure=tip)
    assert found == [
        "scalars[3]: `measure.tip` is listed twice",
        "scalars[4]: `volum_ratio` is not a number of a result; did you mean `volume_ratio`?",
    ]
    assert plan(tmp_path, {"scalars": names[:3], "sweep": sweep}, measure=tip).scalars == (
        "measure.tip",
        "volume_ratio",
        "steps",
    )
    standard = plan(tmp_path, {"sweep": sweep}, measure=tip).scalars
    assert standard[0] == "measure.tip"
    assert {"elastic_energy", "max_displacement", "min_jacobian", "wall_seconds"} < set(standard)


def test_what_is_expected_of_all_runs_is_listed(tmp_path: Path) -> None:
    tip = {"tip": {"kind": "displacement", "on": "b.right", "component": "y"}}
    sweep = {"grid": {"time.dt": [0.5]}}
    wanted = [{"scalar": "tip", "at_most": 0.0}, {"scalar": "steps", "value": 2, "atol": 0.1}]
    made = plan(tmp_path, {"scalars": ["steps", "tip"], "expect": wanted, "sweep": sweep}, measure=tip)
    assert made.expected == ("measure.tip", "steps")
    found = faults(tmp_path, {"scalars": ["tip"], "expect": wanted, "sweep": sweep}, measure=tip)
    assert found == ["expect[1].scalar: `steps` is not one of `scalars`; known: measure.tip"]


# ------------------------------------------------------------------------------------------------- faults


@pytest.mark.parametrize(
    ("study", "expected"),
    [
        ({"sweep": {}}, ["sweep: needs at least one of `grid`, `zip`, `list` and `latin_hypercube`"]),
        ({"swep": {"grid": {"time.dt": [1]}}}, ["swep: unknown key; did you mean `sweep`?"]),
        ({"sweep": {"gird": {}}}, ["sweep.gird: unknown key; did you mean `grid`?"]),
        ({"sweep": {"grid": {"time.dt": 0.1}}}, ['sweep.grid."time.dt": must be a list, not 0.1']),
        ({"sweep": {"grid": {"time.dt": []}}}, ['sweep.grid."time.dt": must not be empty']),
        (
            {"sweep": {"list": [3]}},
            ["sweep.list[0]: must be a mapping (`key: value`), not 3"],
        ),
        (
            {"sweep": {"zip": {"time.dt": [0.1, 0.2], "time.end": [1.0]}}},
            ['sweep.zip."time.end": has 1 values, but time.dt has 2; zip takes one of each at a time'],
        ),
        (
            {"set": {"conditions[1].force": [0, 0]}, "sweep": {"grid": {"conditions.1.force": [[0, 1]]}}},
            ['sweep.grid."conditions.1.force": is given a value already in line 14, at set."conditions[1].force"'],
        ),
        (
            {"scene": "scen.yaml"},
            ["scene: there is no file scen.yaml (relative to the study file); did you mean `scene.yaml`?"],
        ),
        ({"scene": "."}, ["scene: . is a folder, not a scene file"]),
        (
            {"sweep": {"grid": {"time..dt": [1], "a=b": [2]}}},
            [
                'sweep.grid."a=b": the name is not a key of a scene; keys look like time.dt or conditions[0].rate',
                'sweep.grid."time..dt": the name is not a key of a scene; keys look like time.dt or conditions[0].rate',
            ],
        ),
        (
            {"sweep": {"latin_hypercube": {"samples": 3, "ranges": {"time.dt": {"min": 0, "max": 1, "scale": "log"}}}}},
            ['sweep.latin_hypercube.ranges."time.dt".min: a logarithmic scale needs a positive number, not 0'],
        ),
        (
            {"sweep": {"latin_hypercube": {"samples": 3, "ranges": {"time.dt": {"min": 2, "max": 1}}}}},
            ['sweep.latin_hypercube.ranges."time.dt".max: must exceed min, 2, not 1'],
        ),
        (
            {"sweep": {"grid": {"time.dt": [0.1] * 101, "time.end": [1.0] * 100}}},
            ["sweep: makes 10100 runs; a study may have 10000"],
        ),
    ],
)
def test_faults_of_the_study(tmp_path: Path, study: dict[str, Any], expected: list[str]) -> None:
    base = {"title": "t"} if "swep" in study else {"sweep": {"grid": {"time.dt": [0.5]}}}
    assert sorted(faults(tmp_path, {**base, **study})) == sorted(expected)


def test_faults_of_values_are_reported_where_the_study_gives_them(tmp_path: Path) -> None:
    text = """\
scene: scene.yaml
set:
  bodies.b.material.density: -1.0
sweep:
  grid:
    bodies.b.material.poisson_ratio:
      - 0.3
      - 0.6
    conditions[1].force[0]: [0.0, far]
    time.end: [1.0, 0.25]
  latin_hypercube:
    samples: 5
    ranges:
      bodies.b.material.youngs_modulus: {min: -2.0, max: -1.0}
"""
    write(small(), tmp_path / "scene.yaml")
    path = tmp_path / "study.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        plan_runs(load_study(path), quiet)
    in_study = [(fault.line, fault.key) for fault in caught.value.faults if fault.file == str(path)]
    assert in_study == [
        (3, "bodies.b.material.density"),
        (8, "bodies.b.material.poisson_ratio"),
        (9, "conditions[1].force[0]"),
        (14, "bodies.b.material.youngs_modulus"),
    ]
    # What only goes wrong together with the rest of the scene is reported there, with a run that shows it.
    (elsewhere,) = [fault for fault in caught.value.faults if fault.file != str(path)]
    assert elsewhere.file == str(tmp_path / "scene.yaml")
    assert elsewhere.key == "time.dt"
    assert "in run 6 and 19 more" in elsewhere.message
    assert "time.end=0.25" in elsewhere.message


def test_faults_that_only_the_mesh_shows(tmp_path: Path) -> None:
    names = ["b.left", "b.lft"]
    found = faults(tmp_path, {"sweep": {"grid": {"conditions[0].on": names}}})
    (only,) = found
    assert only.startswith("conditions[0].on: body `b` has no group `lft`; did you mean `left`?")


def test_a_scene_with_faults_of_its_own_is_reported_once(tmp_path: Path) -> None:
    found = faults(tmp_path, {"sweep": {"grid": {"bodies.b.mesh.cells[0]": [1, 2, 3]}}}, gravity=[0.0, -9.81, 0.0, 1.0])
    assert len(found) == 1
    assert found[0].startswith("gravity")
    assert "in run" not in found[0]


STUDIES = [
    path
    for path in sorted((Path(__file__).parents[3] / "scenes" / "studies").glob("*.yaml"))
    if not is_comparison(path)
]


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_the_studies_of_the_gallery_are_sound(path: Path) -> None:
    made = plan_runs(load_study(path), quiet)
    check_runs(made, made.runs, quiet)
    assert len(made.distinct) == len(made.runs) > 1


def test_the_gallery_has_a_study() -> None:
    assert STUDIES
