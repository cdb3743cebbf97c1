"""Whatever is done to a scene, `check` and `run` answer with well-formed faults or with none, never otherwise."""

from __future__ import annotations

import contextlib
import copy
import io
import json
import re
import tempfile
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, example, given, settings
from hypothesis import strategies as st

from femdeform.cli import main
from femdeform.errors import InputError
from femdeform.run import deformable
from femdeform.scene.document import parse_document
from femdeform.scene.key_path import format_key

# Small ones, each with other blocks, so that thousands of changed ones are read in little time.
BODIES = """\
schema_version: 1
title: All kinds of bodies
simulation: deformable
bodies:
  beam:
    mesh: {recipe: block, size: [1.0, 0.2, 0.2], cells: [4, 1, 1], translate: [0, 0, 1]}
    element_order: 2
    material: &rubber {law: neo_hookean, density: 1000.0, youngs_modulus: 1.0e6, poisson_ratio: 0.45}
  cloth:
    mesh: {recipe: cloth, cells: [2, 2], rotate: {axis: [0, 1, 0], angle: 0.5}}
    kind: membrane
    thickness: 1.0e-3
    material: *rubber
  rope:
    kind: rod
    cross_section: 1.0e-4
    mesh: {recipe: rod, start: [0, 0, 0], end: [1, 0, 0], cells: 3}
    material: {law: corotated, density: 900, youngs_modulus: 1.0e5, poisson_ratio: 0}
conditions:
  - {kind: fixed, on: beam.left, components: [x, y]}
  - {kind: path, on: {sphere: {center: [0, 0, 1], radius: 0.3}}, times: [0, 1], displacements: [[0, 0, 0], [1, 0, 0]]}
  - {kind: point_load, on: {nodes: [0, 1], body: rope}, force: [0, 0, -1]}
time: {scheme: backward_euler, dt: 0.01, end: 1.0}
"""
CONDITIONS = """\
simulation: deformable
bodies:
  beam: &beam
    mesh: {recipe: block, size: [1.0, 0.2, 0.2], cells: [4, 1, 1]}
    material: {law: neo_hookean, density: 1000.0, youngs_modulus: 1.0e6, poisson_ratio: 0.45}
conditions:
  - {kind: rotate, on: beam.right, axis: [1, 0, 0], rate: 0.5, start: 0.1, stop: 0.4}
  - {kind: traction, on: beam.top, value: [0, -1.0e3, 0], amplitude: {times: [0, 0.5], values: [0, 1]}}
  - {kind: pressure, on: {box: [[-1, -1, -1], [2, 2, 2]], body: beam}, value: 100.0}
  - {kind: initial_velocity, on: beam, velocity: [0, 0, 1], angular_velocity: [0, 1, 0]}
obstacles:
  - {kind: plane, point: [0, -1, 0], normal: [0, 1, 0], friction: 0.3}
  - {kind: sphere, center: [0, -3, 0], radius: 0.5, inside: false}
gravity: [0, -9.81, 0]
time: {scheme: backward_euler, dt: 0.01, end: 1.0}
solver: {method: projected_newton, max_iterations: 50, line_search: {armijo: 1.0e-4}}
linear_solver: {method: ksp, preset: newton-mumps, options: {ksp_rtol: 1.0e-8}}
on_failure: {action: halve_dt, min_dt: 1.0e-4}
output: {fields: [displacement, velocity, reaction], every: 5, checkpoint_every: 3}
"""
MEASURES = """\
simulation: deformable
bodies:
  plate:
    mesh: {recipe: block, size: [1.0, 0.2, 0.2], cells: [4, 1, 1]}
    material: {law: neo_hookean, density: 1000.0, youngs_modulus: 1.0e6, poisson_ratio: 0.45}
conditions:
  - {kind: fixed, on: plate.left}
time: {scheme: quasistatic, dt: 0.5, end: 1.0}
measure:
  tip: {kind: displacement, at: [1.0, 0.1, 0.1], component: y}
  mean: {kind: velocity, on: plate.right, component: norm}
  pull: {kind: reaction, on: plate.left, component: x}
  torque: {kind: moment, on: plate.left, axis: [1, 0, 0], center: [0, 0.1, 0.1]}
  ratio: {kind: volume_ratio, body: plate}
  energy: &energy {kind: total_energy}
  spin: {kind: angular_momentum, component: z}
expect:
  volume_ratio: {value: 1.0, rtol: 0.02}
  residual: {at_most: 1.0e-6}
  max_displacement: {at_least: 0.0, at_most: 1.0}
  displacement:
    - {on: {plane: {point: [1, 0, 0], normal: [1, 0, 0]}, body: plate}, component: y, value: 0.1, atol: 0.05}
    - {at: [1.0, 0.1, 0.1], component: x, value: 0.0, atol: 1.0}
  reaction:
    - {on: plate.left, component: x, value: 0.0, atol: 1.0}
  measured: {tip: {value: -0.1, rtol: 0.1}, pull: {at_least: -1.0}}
  time_to_reach: [{quantity: tip, level: -0.1, value: 0.3, rtol: 0.01}]
"""
TEXTS = (BODIES, CONDITIONS, MEASURES)
SCENES = tuple(parse_document(text).data for text in TEXTS)


def examples(count: int) -> settings:
    """So many examples, the same ones in every run."""
    return settings(
        max_examples=count,
        derandomize=True,
        deadline=None,
        database=None,
        phases=[Phase.explicit, Phase.generate, Phase.shrink],
        suppress_health_check=list(HealthCheck),
    )


def check(raw: bytes) -> tuple[int, list[str]]:
    """Exit code and complaints of `femdeform check`, after making sure that they are well-formed."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.yaml"
        path.write_bytes(raw)
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = main(["check", str(path)])
    complaints = err.getvalue().split("\n")
    assert complaints.pop() == ""
    if code == 0:
        assert complaints == []
        assert out.getvalue() == f"{path}: no faults\n"
    else:
        assert code == 2
        assert out.getvalue() == ""
        assert complaints
    n_lines = raw.count(b"\n") + raw.count(b"\r") + 1
    previous = 0
    for text in complaints:
        match = re.fullmatch(re.escape(str(path)) + r":([1-9]\d*): (\S.*)", text)
        assert match, text
        assert match[2].isprintable()
        assert_readable(text)
        assert previous <= int(match[1]) <= n_lines
        previous = int(match[1])
    return code, complaints


def assert_readable(text: str) -> None:
    """A complaint is one line of reasonable length that does not speak of our insides."""
    assert text.isprintable()
    assert len(text) < 1500
    assert not re.search(r"pydantic|tagged-union|function-|Input should|NoneType|Traceback", text), text


@pytest.mark.parametrize("text", TEXTS)
def test_the_scenes_themselves_are_sound(text: str) -> None:
    assert check(text.encode()) == (0, [])


# ------------------------------------------------------------------------------------------ mutations of the data

WORDS = st.sampled_from(
    ["", "beam", "beam.left", "tip", "at", "cloth.nowhere", "solid", "rod", "block", "linear", "x", "1e3", "<<"]
)
SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 3),
    st.sampled_from([10**6, 10**9, -(10**18), 2**63, 10**30, 10**400]),
    st.floats(width=32),
    st.sampled_from([1e-300, 1e300, -1e300, float("inf"), float("nan")]),
    WORDS,
    st.text(max_size=12),
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.dictionaries(st.one_of(WORDS, st.text(max_size=6)), inner, max_size=3),
    ),
    max_leaves=8,
)


def paths_of(node: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Every path of a tree but its root."""
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    return [inner for key, value in items for inner in [(*path, key), *paths_of(value, (*path, key))]]


def parent_of(tree: Any, path: tuple[Any, ...]) -> Any:
    for key in path[:-1]:
        tree = tree[key]
    return tree


def deep(levels: int) -> Any:
    value: Any = 1
    for level in range(levels):
        value = [value] if level % 2 else {"a": value}
    return value


@st.composite
def mutated_data(draw: st.DrawFn) -> Any:
    data = copy.deepcopy(draw(st.sampled_from(SCENES)))
    for _ in range(draw(st.integers(1, 3))):
        paths = paths_of(data)
        if not paths:
            return data
        path = draw(st.sampled_from(paths))
        parent, key = parent_of(data, path), path[-1]
        action = draw(st.sampled_from(["delete", "rename", "replace", "wrap", "swap", "deepen", "repeat"]))
        if action == "delete":
            del parent[key]
        elif action == "rename" and isinstance(parent, dict):
            place = draw(st.integers(0, len(key)))
            parent[key[:place] + draw(st.text(max_size=2)) + key[place + 1 :]] = parent.pop(key)
        elif action == "wrap":
            parent[key] = draw(st.sampled_from([[parent[key]], {"value": parent[key]}, str(parent[key])]))
        elif action == "swap":
            other = draw(st.sampled_from(paths))
            parent[key] = copy.deepcopy(parent_of(data, other)[other[-1]])
        elif action == "deepen":
            parent[key] = deep(draw(st.sampled_from([3, 20, 31, 33, 200])))
        elif action == "repeat" and isinstance(parent[key], list):
            parent[key] = parent[key] * draw(st.integers(0, 5))
        else:
            parent[key] = draw(VALUES)
    return data


@examples(900)
@given(mutated_data())
def test_mutated_data(data: Any) -> None:
    # JSON is YAML but for its words for what is not finite.
    text = re.sub(r"(?<=[ \[])NaN\b", ".nan", json.dumps(data, indent=1))
    check(re.sub(r"(?<=[ \[-])Infinity\b", ".inf", text).encode())


# ------------------------------------------------------------------------------------------ mutations of the text

ODD = st.one_of(
    st.text(alphabet=" \t\n\r:{}[],&*!|>'\"%@`#?-<=~.0123456789eExyz", min_size=1, max_size=6),
    st.text(min_size=1, max_size=4),
    st.sampled_from(
        ["&a ", "*a", "*rubber", "!!int ", "!x ", "<<: *rubber", "---\n", "...\n", "%YAML 1.1\n", "\ufeff"]
    ),
    st.sampled_from(["\x00", "\x85", "\u2028", "\U0001f9ea", "\x1b[2J", '"\\ud800"', '"\\x', "1e999", "9" * 500]),
)


@st.composite
def mutated_text(draw: st.DrawFn) -> bytes:
    text = draw(st.sampled_from(TEXTS))
    for _ in range(draw(st.integers(1, 5))):
        start = draw(st.integers(0, len(text)))
        action = draw(st.sampled_from(["insert", "cut", "lines", "indent", "truncate"]))
        lines = text.split("\n")
        row = draw(st.integers(0, len(lines) - 1))
        if action == "insert":
            text = text[:start] + draw(ODD) + text[start:]
        elif action == "cut":
            text = text[:start] + text[start + draw(st.integers(1, 8)) :]
        elif action == "truncate":
            text = text[:start] if start > 40 else text
        elif action == "lines":
            other = draw(st.integers(0, len(lines) - 1))
            lines[row], lines[other] = lines[other], draw(st.sampled_from([lines[row], lines[other]]))
            text = "\n".join(lines)
        else:
            lines[row] = draw(st.sampled_from([" ", "    ", "\t", "- "])) + lines[row]
            text = "\n".join(lines)
    raw = text.encode("utf-8", errors="surrogatepass")
    if draw(st.integers(0, 9)) == 0:
        place = draw(st.integers(0, len(raw)))
        raw = raw[:place] + draw(st.binary(min_size=1, max_size=3)) + raw[place:]
    return raw


@examples(800)
@given(mutated_text())
def test_mutated_text(raw: bytes) -> None:
    check(raw)


# ------------------------------------------------------------------------------------- mutations on the command line

SOUND = "sound: here the simulation would be set up"
KEYS = tuple(format_key(path) for data in SCENES for path in paths_of(data))
# Numbers of cells that make sense at all are built before they are judged.
HARMLESS = VALUES.filter(lambda value: not re.search(r"\d{4}", repr(value)))


@st.composite
def mutated_overrides(draw: st.DrawFn) -> tuple[str, list[str]]:
    text = draw(st.sampled_from(TEXTS))
    overrides = []
    for _ in range(draw(st.integers(1, 3))):
        key = draw(st.sampled_from(KEYS))
        if draw(st.integers(0, 2)) == 0:
            place = draw(st.integers(0, len(key)))
            key = key[:place] + draw(ODD) + key[place + draw(st.integers(0, 2)) :]
        value = draw(st.one_of(HARMLESS.map(json.dumps), st.text(max_size=8), ODD, WORDS))
        overrides.append(draw(st.sampled_from([f"{key}={value}", f"{key} = {value}", f"{key}={value}", key])))
    return text, overrides


@examples(400)
@given(mutated_overrides())
@example((BODIES, ["conditions[1].on=\ufefd"]))
@example((MEASURES, ['measure.tip.on="\\e[2Jx.left"', "measure.tip.at=null"]))
@example((MEASURES, ['expect.time_to_reach[0].quantity="\\n"']))
def test_mutated_overrides(changed: tuple[str, list[str]]) -> None:
    text, overrides = changed

    def set_up(*_: Any) -> None:
        raise InputError(SOUND)

    with tempfile.TemporaryDirectory() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setattr(deformable, "build_simulation", set_up)
        path = Path(folder) / "scene.yaml"
        path.write_text(text, encoding="utf-8")
        sets = [f"--set={override}" for override in overrides]
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = main(["run", str(path), "--out", str(Path(folder) / "out"), "--quiet", *sets])
        complaints = err.getvalue().split("\n")
        assert complaints.pop() == ""
        assert (code, out.getvalue()) == (2, "")
        if complaints != [f"femdeform: {SOUND}"]:
            assert complaints
            assert not (Path(folder) / "out").exists()
            for text in complaints:
                match = re.fullmatch(rf"(?:{re.escape(str(path))}:[1-9]\d*|--set .*?): (\S.*)", text)
                assert match, text
                assert_readable(text)
