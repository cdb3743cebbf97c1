"""The scenes of the PBNG paper: each meets what it expects, small ones against projected Newton."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from femdeform.cli import main
from femdeform.scene.load import load_scene

REPOSITORY = Path(__file__).resolve().parents[2]
SCENES = REPOSITORY / "scenes" / "pbng"
# Scenes of muscles have a module of their own.
MUSCLES = {"muscle", "biceps", "bound-muscles"}
NAMES = sorted({path.stem for path in SCENES.glob("*.yaml")} - MUSCLES)
_BLOCK = ["bodies.block.mesh.cells=[6, 6, 6]"]
# What makes each scene small enough for a few seconds; the others run as they are.
SMALLER = {
    **{name: _BLOCK for name in NAMES if name.startswith("stretch-twist")},
    "clamped-block": _BLOCK,
    "propagation-3d": _BLOCK,
    "propagation-2d": [],
    "hanging-blocks": ["bodies.upper.mesh.cells=[4, 4, 4]", "bodies.lower.mesh.cells=[4, 4, 4]"],
    "bar-under-gravity": ["bodies.bar.mesh.cells=[9, 3, 3]"],
}
NEWTON = "solver={method: projected_newton, tolerance: 1.0e-9}"


def run(name: str, out: Path, *overrides: str) -> int:
    sets = [word for override in overrides for word in ("--set", override)]
    return main(["run", str(SCENES / f"{name}.yaml"), "--out", str(out), "--quiet", *sets])


def result(out: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((out / "result.json").read_text(encoding="utf-8"))
    return found


def test_every_example_has_its_scene() -> None:
    assert set(SMALLER) <= set(NAMES)
    laws = {load_scene(SCENES / f"{name}.yaml").scene.bodies["block"].material.law for name in SMALLER if "32" in name}
    assert laws == {"fixed_corotated", "neo_hookean", "stable_neo_hookean"}


@pytest.mark.parametrize("name", NAMES)
def test_a_scene_has_no_faults_and_expects_something(name: str) -> None:
    assert main(["check", str(SCENES / f"{name}.yaml")]) == 0
    assert load_scene(SCENES / f"{name}.yaml").scene.expect is not None


@pytest.mark.parametrize("name", sorted(SMALLER))
def test_a_small_one_agrees_with_projected_newton(name: str, tmp_path: Path) -> None:
    """With its own tolerances, around the values that projected Newton finds on the small mesh."""
    assert run(name, tmp_path / "newton", *SMALLER[name], NEWTON, "expect={}") == 0
    newton = result(tmp_path / "newton")["quantities"]
    expect = load_scene(SCENES / f"{name}.yaml").scene.expect
    assert expect is not None
    there = [
        f"expect.measured.{key}.value={newton[f'measure.{key}']!r}"
        for key, wanted in expect.measured.items()
        if wanted.value is not None
    ]
    assert there
    if expect.elastic_energy is not None:
        there.append(f"expect.elastic_energy.value={newton['elastic_energy']!r}")
    assert run(name, tmp_path / "pbng", *SMALLER[name], *there) == 0
    assert len(result(tmp_path / "pbng")["expect"]) >= len(there)


@pytest.mark.gallery
@pytest.mark.parametrize("name", NAMES)
def test_a_scene_meets_what_it_expects(name: str, tmp_path: Path) -> None:
    assert run(name, tmp_path / "result") == 0
