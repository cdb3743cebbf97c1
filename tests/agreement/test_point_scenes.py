"""The scenes of scenes/mpm: material points against exact values, and what they show."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from femdeform.cli import main
from femdeform.run.checkpoint import read_checkpoint
from femdeform.scene.load import load_scene

SCENES = Path(__file__).resolve().parents[2] / "scenes" / "mpm"
NAMES = sorted(path.stem for path in SCENES.glob("verify-*.yaml"))
QUICK = ("verify-bar", "verify-falling-block", "verify-spin-apic", "verify-spin-pic", "verify-rotating-flux-insulated")
Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.mark.parametrize("name", NAMES)
def test_a_scene_has_no_faults(name: str) -> None:
    assert main(["check", str(SCENES / f"{name}.yaml")]) == 0


def facts_of(cli: Run, name: str, out: Path, *options: str, code: int = 0) -> list[dict[str, object]]:
    """Verdicts of a scene that runs to its end."""
    finished = cli("run", SCENES / f"{name}.yaml", "--out", out, *options)
    assert finished.returncode == code, finished.stderr
    facts = json.loads((out / "result.json").read_text(encoding="utf-8"))
    verdicts: list[dict[str, object]] = facts["expect"]
    return verdicts


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.gallery) for name in NAMES]
)
def test_scene(name: str, cli: Run, tmp_path: Path) -> None:
    verdicts = facts_of(cli, name, tmp_path / "out")
    expect = load_scene(SCENES / f"{name}.yaml").scene.expect
    assert len(verdicts) >= len(expect.measured) + len(expect.over_time) > 0
    assert all(verdict["passed"] for verdict in verdicts)


@pytest.mark.slow
def test_pic_does_not_pass_for_apic(cli: Run, tmp_path: Path) -> None:
    """What the scenes expect tells the two transfers apart."""
    for name, scheme in (("verify-spin-apic", "pic"), ("verify-spin-pic", "apic")):
        out = tmp_path / name
        verdicts = facts_of(cli, name, out, "--set", f"transfer.scheme={scheme}", code=1)
        assert not any(verdict["passed"] for verdict in verdicts)
        assert read_checkpoint(out).step == 30


@pytest.mark.slow
@pytest.mark.gallery
@pytest.mark.parametrize("name", ["verify-robin-disc", "verify-rotating-flux-insulated", "verify-two-discs-exchange"])
def test_heat_as_published_misses_the_exact_value(name: str, cli: Run, tmp_path: Path) -> None:
    verdicts = facts_of(cli, name, tmp_path / "out", "--set", "heat.quadrature=literal", code=1)
    assert not verdicts[0]["passed"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["verify-falling-block", pytest.param("verify-translation", marks=pytest.mark.gallery)]
)
def test_backward_euler_moves_freely_too(name: str, cli: Run, tmp_path: Path) -> None:
    implicit = ["time.scheme=backward_euler", "surface.symmetric=true", "solver.tolerance=1e-12"]
    options = [word for setting in implicit for word in ("--set", setting)]
    verdicts = facts_of(cli, name, tmp_path / "out", *options)
    assert verdicts
    assert all(verdict["passed"] for verdict in verdicts)


@pytest.mark.slow
def test_backward_euler_with_the_plain_surface_loses_angular_momentum(cli: Run, tmp_path: Path) -> None:
    """The negative control of the symmetric surface energy; linear momentum is kept by both."""
    limits = {"px": 2.1e-13, "py": 2.1e-13, "spin": 3.7e-14}
    expect = [f"{{quantity: {name}, statistic: largest_change, at_most: {most}}}" for name, most in limits.items()]
    settings = ["surface.symmetric=false", "time.end=0.1", f"expect.over_time=[{', '.join(expect)}]"]
    options = [word for setting in settings for word in ("--set", setting)]
    verdicts = facts_of(cli, "verify-ellipse-implicit", tmp_path / "out", *options, code=1)
    assert [verdict["passed"] for verdict in verdicts] == [True, True, False]


@pytest.mark.slow
def test_samples_without_mass_lose_momentum(cli: Run, tmp_path: Path) -> None:
    """The negative control of conservation, cut short: what the ellipse expects, samples without mass miss."""
    options = ("--set", "surface.comparison=massless_samples", "--set", "time.dt=1e-4", "--set", "time.end=0.02")
    expect = "expect.over_time=[{quantity: py, statistic: largest_change, at_most: 2.1e-13}]"
    assert not facts_of(cli, "verify-ellipse", tmp_path / "lost", *options, "--set", expect, code=1)[0]["passed"]
    kept = (*options[2:], "--set", expect)
    assert facts_of(cli, "verify-ellipse", tmp_path / "kept", *kept)[0]["passed"]
