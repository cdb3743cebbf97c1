"""Cases made for one test: a study of a small scene that takes a fraction of a second."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

# A square of which every side is held; `measure` gives something to judge beside the norms.
SQUARE = """\
simulation: deformable
bodies:
  body:
    mesh: {recipe: block, size: [1.0, 1.0], cells: [4, 4]}
    material: {law: neo_hookean, density: 1.0, youngs_modulus: 2.0, poisson_ratio: 0.3}
conditions:
  - {kind: fixed, on: body.boundary}
time: {scheme: quasistatic, dt: 1.0}
solver: {tolerance: 1.0e-10}
measure:
  middle: {kind: displacement, at: [0.4, 0.6], component: x}
  energy: {kind: elastic_energy}
"""
# A bar that swings, held at its left end.
BAR = """\
simulation: deformable
bodies:
  bar:
    mesh: {recipe: block, size: [1.0, 0.2], cells: [5, 1]}
    material: {law: neo_hookean, density: 1000.0, youngs_modulus: 2.0e+5, poisson_ratio: 0.3}
conditions:
  - {kind: fixed, on: bar.left}
gravity: [0.0, -9.81]
time: {scheme: backward_euler, dt: 0.02, end: 0.1}
measure:
  tip: {kind: displacement, on: bar.right, component: y}
"""


@pytest.fixture
def case(tmp_path: Path) -> Callable[..., Path]:
    """Write a case folder: text of its study, of its scene, and its README."""

    def write(study: str, scene: str = SQUARE, name: str = "trial", readme: str = "") -> Path:
        folder = tmp_path / name
        folder.mkdir(exist_ok=True)
        (folder / "study.yaml").write_text(study, encoding="utf-8")
        (folder / "scene.yaml").write_text(scene, encoding="utf-8")
        if readme:
            (folder / "README.md").write_text(readme, encoding="utf-8")
        return folder

    return write


@pytest.fixture
def bar() -> str:
    """Text of a scene of a bar that swings."""
    return BAR


@pytest.fixture
def refinement() -> Callable[..., str]:
    """Text of a refinement study of the square with a manufactured solution."""

    def text(quantities: str, exact: str = "a*sin(pi*x)*cos(pi*y)", more: str = "") -> str:
        return f"""\
title: A trial
studies:
  p1:
    kind: mesh_refinement
    constants: {{a: 0.05}}
    fields: {{displacement: ["{exact}", "a*x*sin(pi*y)"], body_force: manufactured}}
    levels:
      - {{set: {{bodies.body.mesh.cells: [4, 4]}}, size: "1/4"}}
      - {{set: {{bodies.body.mesh.cells: [8, 8]}}, size: "1/8"}}
      - {{set: {{bodies.body.mesh.cells: [16, 16]}}, size: "1/16"}}
    quantities: {quantities}
{more}"""

    return text
