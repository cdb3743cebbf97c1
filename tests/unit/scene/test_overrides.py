"""Changes from the command line go through the same validation as the file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from femdeform.errors import InputError
from femdeform.scene.load import load_scene
from femdeform.scene.overrides import apply_overrides, parse_override


def faults_of(path: Path, *overrides: str) -> list[str]:
    with pytest.raises(InputError) as caught:
        load_scene(path, overrides)
    return [str(fault) for fault in caught.value.faults]


@pytest.mark.parametrize(
    ("text", "path", "value"),
    [
        ("time.dt=0.5", ("time", "dt"), 0.5),
        (" time.dt = 0.5", ("time", "dt"), 0.5),
        ("conditions[1].rate=2", ("conditions", 1, "rate"), 2),
        ("conditions.1.rate=2", ("conditions", "1", "rate"), 2),
        ("a[0][2]=x", ("a", 0, 2), "x"),
        ('bodies."a.b".kind=rod', ("bodies", "a.b", "kind"), "rod"),
        ("title=a=b", ("title",), "a=b"),
        ("title=", ("title",), None),
        ("gravity=[0, 0, -9.81]", ("gravity",), [0, 0, -9.81]),
        ("time={dt: 1}", ("time",), {"dt": 1}),
    ],
)
def test_key_and_value(text: str, path: tuple[str | int, ...], value: object) -> None:
    override, faults = parse_override(text)
    assert faults == []
    assert override is not None
    assert (override.path, override.value) == (path, value)


@pytest.mark.parametrize("text", ["", "time.dt", "=1", ".a=1", "a..b=1", "a.=1", "a[x]=1", "a[1=1", "a]b=1", "[0]a=1"])
def test_what_is_not_an_override(text: str) -> None:
    override, faults = parse_override(text)
    assert override is None
    assert len(faults) == 1
    assert faults[0].file == f"--set {text}"


def test_later_overrides_win_and_the_input_stays() -> None:
    data = {"a": {"b": 1}, "c": [1, 2]}
    changed, origins, faults = apply_overrides(data, ["a.b=2", "c[1]=5", "a.b=3", "new.block.key=x"])
    assert faults == []
    assert changed == {"a": {"b": 3}, "c": [1, 5], "new": {"block": {"key": "x"}}}
    assert data == {"a": {"b": 1}, "c": [1, 2]}
    assert origins[("a", "b")].text == "a.b=3"


def test_an_override_of_a_whole_block_forgets_those_inside() -> None:
    changed, origins, _ = apply_overrides({"a": {"b": 1}}, ["a.b=2", "a={c: 3}"])
    assert changed == {"a": {"c": 3}}
    assert list(origins) == [("a",)]


def test_a_sound_override(scene_file: Callable[..., Path]) -> None:
    loaded = load_scene(
        scene_file(), ["bodies.beam.material.density=900", "conditions[1].rate=2", "on_failure.action=stop"]
    )
    assert loaded.scene.bodies["beam"].material.density == 900.0
    assert loaded.scene.conditions[1].rate == 2.0
    assert loaded.scene.on_failure.action == "stop"
    assert loaded.data["bodies"]["beam"]["material"]["density"] == 900


def test_faults_of_overrides_name_the_override(scene_file: Callable[..., Path]) -> None:
    path = scene_file()
    assert faults_of(path, "bodies.beam.material.densty=900") == [
        "--set bodies.beam.material.densty=900: bodies.beam.material.densty: unknown key; did you mean `density`?"
    ]
    assert faults_of(path, "time.dt=soon") == ['--set time.dt=soon: time.dt: must be a number, not the text "soon"']
    assert faults_of(path, "time.dt=2") == ["--set time.dt=2: time.dt: must not exceed end, 1 [s], not 2"]
    assert faults_of(path, "gravity=[0, .inf, 0]") == [
        "--set gravity=[0, .inf, 0]: gravity[1]: must be a finite number, not .inf"
    ]
    assert faults_of(path, "title=[1") == [
        "--set title=[1: title: is not valid YAML: expected ',' or ']', but got '<stream end>'"
    ]


def test_blocks_that_the_file_leaves_out_keep_their_default_words(scene_file: Callable[..., Path]) -> None:
    loaded = load_scene(scene_file(), ["solver.tolerance=1e-6", "linear_solver.preset=newton-gamg"])
    assert (loaded.scene.solver.method, loaded.scene.solver.tolerance) == ("projected_newton", 1e-6)
    assert (loaded.scene.linear_solver.method, loaded.scene.linear_solver.preset) == ("ksp", "newton-gamg")


def test_keys_that_lead_nowhere(scene_file: Callable[..., Path]) -> None:
    path = scene_file()
    assert faults_of(path, "conditions[7].rate=1") == [
        "--set conditions[7].rate=1: conditions[7].rate: `conditions` has 2 entries; the first is [0]"
    ]
    assert faults_of(path, "conditions.first.rate=1") == [
        "--set conditions.first.rate=1: conditions.first.rate: "
        "`conditions` is a list; give an index, as in conditions[0]"
    ]
    assert faults_of(path, "title.x=1") == ["--set title.x=1: title.x: `title` is a single value, it has no key x"]
    assert faults_of(path, "time[0]=1") == ["--set time[0]=1: time[0]: `time` is a mapping, not a list"]


def test_a_fault_of_the_file_keeps_its_line_beside_overrides(scene_file: Callable[..., Path]) -> None:
    path = scene_file()
    faults = faults_of(path, "bodies.beam.material.law=lineer", "solver.tolerance=-1", "conditions[1].kind=fixed")
    assert faults == [
        f"{path}:16: conditions[1].axis: not a key of kind `fixed`; it belongs to `rotate`, `twist`",
        f"{path}:17: conditions[1].rate: not a key of kind `fixed`; it belongs to `rotate`, `twist`",
        '--set bodies.beam.material.law=lineer: bodies.beam.material.law: "lineer" is not a known law; '
        "did you mean `linear`?",
        "--set solver.tolerance=-1: solver.tolerance: must be greater than 0, not -1",
    ]


def test_a_long_override_is_shortened_in_messages(scene_file: Callable[..., Path]) -> None:
    (fault,) = faults_of(scene_file(), "title=[" + "1, " * 100 + "1]")
    assert len(fault) < 160
    assert fault.startswith("--set title=[1, 1,")
