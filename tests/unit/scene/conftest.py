"""A small sound scene that the tests change."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

SCENE = """\
schema_version: 1
title: Twisted beam
simulation: deformable
bodies:
  beam:
    mesh: {recipe: block, size: [1.0, 0.2, 0.2], cells: [5, 1, 1]}
    material:
      law: neo_hookean
      density: 1000.0
      youngs_modulus: 1.0e6
      poisson_ratio: 0.45
conditions:
  - {kind: fixed, on: beam.left}
  - kind: rotate
    on: beam.right
    axis: [1, 0, 0]
    rate: 0.5
gravity: [0, -9.81, 0]
time: {scheme: backward_euler, dt: 0.01, end: 1.0}
"""


@pytest.fixture
def scene_text() -> str:
    """Text of the sound scene."""
    return SCENE


@pytest.fixture
def scene_file(tmp_path: Path) -> Callable[..., Path]:
    """Write a scene (by default `SCENE`), after replacing parts of its text."""

    def write(text: str | bytes = SCENE, *replacements: tuple[str, str]) -> Path:
        path = tmp_path / "scene.yaml"
        if isinstance(text, bytes):
            path.write_bytes(text)
            return path
        for old, new in replacements:
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        path.write_text(text, encoding="utf-8")
        return path

    return write
