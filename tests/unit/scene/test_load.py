"""A loaded scene: values, lines, hash; and everything wrong with it at once."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path

import pytest

from femdeform.errors import InputError
from femdeform.scene.load import load_scene, scene_hash


def test_a_sound_scene(scene_file: Callable[..., Path], tmp_path: Path) -> None:
    path = scene_file()
    loaded = load_scene(path)
    assert loaded.path == path
    assert loaded.base_dir == tmp_path
    assert loaded.scene.title == "Twisted beam"
    assert loaded.scene.bodies["beam"].kind == "solid"
    assert loaded.scene.conditions[1].axis == (1.0, 0.0, 0.0)
    assert loaded.scene.solver.method == "projected_newton"
    assert loaded.data["gravity"] == [0, -9.81, 0]
    assert "solver" not in loaded.data


def test_lines(scene_file: Callable[..., Path]) -> None:
    loaded = load_scene(scene_file())
    assert loaded.line(("bodies", "beam", "material", "density")) == 9
    assert loaded.line(("conditions", 1)) == 14
    assert loaded.line(("conditions", 1, "axis", 2)) == 16
    # What the file leaves out stands where its block does.
    assert loaded.line(("bodies", "beam", "material", "missing")) == 7
    assert loaded.line(("solver", "method")) == 1


def test_the_hash_is_that_of_the_content(scene_file: Callable[..., Path], scene_text: str) -> None:
    first = load_scene(scene_file()).hash
    assert len(first) == 64
    assert load_scene(scene_file()).hash == first
    assert load_scene(scene_file(), ["time.dt=0.01"]).hash == first
    assert load_scene(scene_file(), ["time.dt=0.02"]).hash != first
    commented = scene_file(scene_text + "# a comment\n")
    assert load_scene(commented).hash == first
    assert scene_hash({"b": [1.5, None], "a": "é"}) == scene_hash({"a": "é", "b": [1.5, None]})


def test_every_fault_is_there_sorted_by_line(scene_file: Callable[..., Path], scene_text: str) -> None:
    path = scene_file(
        scene_text,
        ("title: Twisted beam", "titel: Twisted beam"),
        ("density: 1000.0", "density: -1"),
        ("axis: [1, 0, 0]", "axis: [0, 0, 0]"),
        ("dt: 0.01", "dt: .nan"),
        ("gravity: [0, -9.81, 0]", "gravity: 9.81"),
    )
    with pytest.raises(InputError) as caught:
        load_scene(path)
    assert [(fault.line, fault.key) for fault in caught.value.faults] == [
        (2, "titel"),
        (9, "bodies.beam.material.density"),
        (16, "conditions[1].axis"),
        (18, "gravity"),
        (19, "time.dt"),
    ]
    assert all(fault.file == str(path) for fault in caught.value.faults)


def test_shared_materials_by_alias(scene_file: Callable[..., Path], scene_text: str) -> None:
    path = scene_file(
        scene_text,
        ("material:\n", "material: &rubber\n"),
        (
            "conditions:\n",
            "  other:\n    mesh: {recipe: block, cells: [1, 1, 1]}\n    material: *rubber\nconditions:\n",
        ),
    )
    scene = load_scene(path).scene
    assert scene.bodies["other"].material == scene.bodies["beam"].material


def test_a_loaded_scene_can_travel_between_processes(scene_file: Callable[..., Path]) -> None:
    loaded = load_scene(scene_file(), ["time.dt=0.02"])
    copy = pickle.loads(pickle.dumps(loaded))
    assert copy == loaded
    assert str(copy.fault(("time", "dt"), "x")) == "--set time.dt=0.02: time.dt: x"
