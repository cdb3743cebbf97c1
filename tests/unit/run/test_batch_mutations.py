"""Whatever is done to a study, `femdeform batch` answers with well-formed faults or plans its runs."""

from __future__ import annotations

import contextlib
import copy
import io
import json
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest import mock

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scenario import block, body, quasistatic, scene, write

from femdeform.cli import main
from femdeform.run import batch
from femdeform.scene import batch_schema
from femdeform.scene.document import parse_document

TEXT = """\
schema_version: 1
title: A bit of everything
scene: scene.yaml
set: {bodies.b.material.density: 900.0, time: {scheme: quasistatic, dt: 0.5, end: 1.0}}
sweep:
  grid:
    bodies.b.mesh.cells: [[2, 1]]
  zip:
    conditions[1].force[0]: [0.0, 1.0]
    conditions[1].on: [b.right, {nodes: [0, 1]}]
  list:
    - {time.dt: 0.5, gravity: [0.0, -9.81]}
    - {solver.max_iterations: 5}
  latin_hypercube:
    samples: 2
    seed: 1
    ranges:
      bodies.b.material.youngs_modulus: {min: 1.0e+3, max: 1.0e+6, scale: log}
      conditions[1].force[1]: {min: -3, max: 3, integer: true}
scalars: [tip, volume_ratio, quantities.min_jacobian, steps]
out: results
"""
BASE = parse_document(TEXT).data
MOST_RUNS = 20

SETTINGS = settings(
    max_examples=200, derandomize=True, deadline=None, database=None, suppress_health_check=list(HealthCheck)
)


def nothing(*_: Any) -> Iterator[Any]:
    return iter(())


def plan(raw: bytes) -> int:
    """Exit code of `femdeform batch` with no run made, after making sure that its complaints are well-formed."""
    with tempfile.TemporaryDirectory() as folder:
        bar = scene(
            {"b": body(block([1.0, 0.2], [2, 1]))},
            {"kind": "fixed", "on": "b.left"},
            {"kind": "point_load", "on": "b.right", "force": [0.0, -1.0]},
            time=quasistatic(dt=0.5),
            measure={"tip": {"kind": "displacement", "on": "b.right", "component": "y"}},
        )
        write(bar, Path(folder) / "scene.yaml")
        path = Path(folder) / "study.yaml"
        path.write_bytes(raw)
        out, err = io.StringIO(), io.StringIO()
        with (
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
            mock.patch.object(batch, "run_here", nothing),
            mock.patch.object(batch_schema, "MAX_RUNS", MOST_RUNS),
        ):
            code = main(["batch", str(path), "--out", str(Path(folder) / "out")])
        complaints = err.getvalue().split("\n")
        assert complaints.pop() == ""
        if code == 2:
            assert out.getvalue() == ""
            assert complaints
            assert not (Path(folder) / "out").exists()
            n_lines = raw.count(b"\n") + raw.count(b"\r") + 1
            for text in complaints:
                match = re.fullmatch(re.escape(folder) + r"/(study|scene)\.yaml:([1-9]\d*): (\S.*)", text)
                assert match, text
                assert match[3].isprintable()
                assert match[1] == "scene" or int(match[2]) <= n_lines
                assert not re.search(r"pydantic|function-|Input should|NoneType|Traceback|--set", text), text
        else:
            assert code == 3  # all runs wait for ever
            assert (Path(folder) / "out" / "index.csv").exists()
            assert "Traceback" not in err.getvalue()
    return code


def test_the_study_itself_is_sound() -> None:
    assert plan(TEXT.encode()) == 3


KEYS = st.sampled_from(
    ["", "time.dt", "time", "conditions[1].force", "conditions[9].on", "bodies.b", "a..b", "a=b", '"x"', "x[", "title"]
)
SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 3),
    st.sampled_from([10**4, 10**9, -(10**18), 2**63, 10**400]),
    st.floats(width=32),
    st.sampled_from([1e-300, 1e300, float("inf"), float("nan")]),
    st.sampled_from(["", "b", "b.left", "scene.yaml", ".", "\x00", "log", "tip", "steps"]),
    st.text(max_size=12),
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(KEYS | st.text(max_size=6), inner, max_size=3),
    max_leaves=6,
)


def paths_of(node: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Every path of a tree but its root."""
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    return [inner for key, value in items for inner in [(*path, key), *paths_of(value, (*path, key))]]


def parent_of(tree: Any, path: tuple[Any, ...]) -> Any:
    for key in path[:-1]:
        tree = tree[key]
    return tree


@st.composite
def mutated_data(draw: st.DrawFn) -> Any:
    data = copy.deepcopy(BASE)
    for _ in range(draw(st.integers(1, 3))):
        paths = paths_of(data)
        if not paths:
            return data
        path = draw(st.sampled_from(paths))
        parent, key = parent_of(data, path), path[-1]
        action = draw(st.sampled_from(["delete", "rename", "replace", "wrap", "swap", "repeat"]))
        if action == "delete":
            del parent[key]
        elif action == "rename" and isinstance(parent, dict):
            place = draw(st.integers(0, len(key)))
            other = key[:place] + draw(st.text(max_size=2)) + key[place + 1 :]
            parent[draw(KEYS | st.just(other))] = parent.pop(key)
        elif action == "wrap":
            parent[key] = draw(st.sampled_from([[parent[key]], {"time.dt": parent[key]}, str(parent[key])]))
        elif action == "swap":
            other = draw(st.sampled_from(paths))
            parent[key] = copy.deepcopy(parent_of(data, other)[other[-1]])
        elif action == "repeat" and isinstance(parent[key], list):
            parent[key] = parent[key] * draw(st.integers(0, 3))
        else:
            parent[key] = draw(VALUES)
    return data


@SETTINGS
@given(mutated_data())
def test_mutated_data(data: Any) -> None:
    # JSON is YAML but for its words for what is not finite.
    text = re.sub(r"(?<=[ \[])NaN\b", ".nan", json.dumps(data, indent=1))
    plan(re.sub(r"(?<=[ \[-])Infinity\b", ".inf", text).encode())


@st.composite
def mutated_text(draw: st.DrawFn) -> bytes:
    odd = st.text(alphabet=" \t\n:{}[],&*!|'\"%@#?-<=~.0129eEx", min_size=1, max_size=5) | st.text(
        min_size=1, max_size=3
    )
    text = TEXT
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(text)))
        if draw(st.booleans()):
            text = text[:start] + draw(odd) + text[start:]
        else:
            text = text[:start] + text[start + draw(st.integers(1, 8)) :]
    return text.encode("utf-8", errors="surrogatepass")


@SETTINGS
@given(mutated_text())
def test_mutated_text(raw: bytes) -> None:
    plan(raw)
