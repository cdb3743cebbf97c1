"""Every scene of the gallery runs and meets its own `expect:` block; every comparison of scenes/studies can be made."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from running import assert_meets_expectations

from femdeform.run.compare_variants import Variant, prepare
from femdeform.scene.comparison_schema import is_comparison, load_comparison
from femdeform.scene.load import load_scene

SCENES = Path(__file__).resolve().parents[2] / "scenes"
# Folders whose scenes have a module of their own, here and there; the scenes of all others are run below.
ELSEWHERE = {
    "mixed": "test_mixed_scenes.py",
    "pbng": "test_pbng_scenes.py",
    "xpbd": "test_xpbd_scenes.py",
    "flow": "test_flow_scenes.py",
    "mpm": "test_point_scenes.py",
}
# Batches are checked with the plans of runs.
COMPARISONS = [path for path in sorted(SCENES.glob("studies/*.yaml")) if is_comparison(path)]
NAMES = sorted(
    str(path.relative_to(SCENES).with_suffix(""))
    for path in SCENES.rglob("*.yaml")
    if path.relative_to(SCENES).parts[0] not in {*ELSEWHERE, "studies"}
)
# The demo takes a minute on its own: its first steps show that it runs, `make demo` shows the rest.
SHORTENED = {"rubber-mount": ["--set", "time.dt=0.1", "--set", "time.end=0.2", "--set", "expect={}"]}


def test_the_gallery_is_there() -> None:
    assert len(NAMES) >= 9
    for folder, module in ELSEWHERE.items():
        assert list((SCENES / folder).glob("*.yaml"))
        assert f'"scenes" / "{folder}"' in (Path(__file__).parent / module).read_text(encoding="utf-8")


@pytest.mark.parametrize("path", COMPARISONS, ids=lambda path: path.stem)
def test_a_comparison_has_no_faults(path: Path) -> None:
    """The file, the scene with all its values, every variant."""
    loaded = load_comparison(path)
    scene = load_scene(loaded.scene_path).deformable
    # Large meshes say no more about the variants than small ones.
    small = [f"bodies.{name}.mesh.cells={[2] * len(body.mesh.cells)}" for name, body in scene.bodies.items()]
    variants = [Variant(label, options) for label, options in loaded.variants()]
    prepared = prepare(loaded.scene_path, variants, [*loaded.overrides, *small])
    assert set(prepared.scenes) == set(loaded.file.variants)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_scene(name: str, cli: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path) -> None:
    shortened = SHORTENED.get(name, [])
    verdicts = assert_meets_expectations(cli, SCENES / f"{name}.yaml", tmp_path / "result", *shortened)
    assert shortened or verdicts, "a scene of the gallery says what to expect"
