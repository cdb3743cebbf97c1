"""The scenes of scenes/xpbd: ropes, wires, cloth, a balloon, bodies in a grid; muscles have a module of their own."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from running import assert_meets_expectations

from femdeform.cli import main
from femdeform.run.compare import Comparison, Variant, compare
from femdeform.scene.comparison_schema import load_comparison
from femdeform.scene.load import load_scene

SCENES = Path(__file__).resolve().parents[2] / "scenes" / "xpbd"
STUDIES = SCENES.parent / "studies"
NAMES = sorted({path.stem for path in SCENES.glob("*.yaml")} - {"muscle-box"})
# Scenes of a few seconds.
QUICK = {
    "rope",
    "hanging-cloth",
    "balloon",
    "bending-wires",
    "residual-block",
    "stretched-squeezed-block",
    "squeezed-neo-hookean-block",
}


@pytest.mark.parametrize("name", NAMES)
def test_a_scene_has_no_faults_and_expects_something(name: str) -> None:
    assert main(["check", str(SCENES / f"{name}.yaml")]) == 0
    assert load_scene(SCENES / f"{name}.yaml").scene.expect is not None


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.gallery) for name in NAMES]
)
def test_scene(name: str, cli: Callable[..., subprocess.CompletedProcess[str]], tmp_path: Path) -> None:
    assert assert_meets_expectations(cli, SCENES / f"{name}.yaml", tmp_path / "result")


def small(study: str, only: set[str] | None = None, **plan: int) -> Comparison:
    """A comparison file on 6 nodes a side instead of 16, a third as fine: nine times as stiff, kappa is the same."""
    loaded = load_comparison(STUDIES / f"{study}.yaml")
    overrides = dict(override.split("=", 1) for override in loaded.overrides)
    key = "bodies.block.material.youngs_modulus"
    overrides.pop("linear_solver")
    scene = load_scene(loaded.scene_path, [f"{name}={value}" for name, value in overrides.items()]).scene
    overrides[key] = repr(9.0 * scene.bodies["block"].material.youngs_modulus)
    overrides["bodies.block.mesh.cells"] = "[5, 5, 5]"
    file = loaded.file
    return compare(
        loaded.scene_path,
        [Variant(label, options) for label, options in loaded.variants() if only is None or label in only],
        **({"iterations": file.iterations, "steps": file.steps, "start_step": file.start_step} | plan),
        overrides=[f"{name}={value}" for name, value in overrides.items()],
    )


@pytest.mark.parametrize(("study", "kappa"), [("xpbd-kappa-0.16", 0.16), ("xpbd-residual", 1.6)])
def test_convergent_forms_reach_the_solution_where_xpbd_stalls(study: str, kappa: float) -> None:
    found = small(study)
    assert found.stiffness_number == pytest.approx(kappa, rel=1e-3)
    for label in ("B-PXPBD", "FP-PXPBD"):
        (row,) = found.of(label)
        assert row["status"] == "converged"
        assert row["relative_residual"] <= 1e-8
    for label in ("XPBD", "XPBD, residual kept"):
        (row,) = found.of(label)
        rows = [r for r in found.iterations if r["variant"] == label]
        assert row["relative_residual"] > 1e-3
        # The second half of the sweeps changes nothing.
        middle = rows[len(rows) // 2]["relative_residual"]
        assert row["relative_residual"] == pytest.approx(middle, rel=0.05)
    (last,) = [r for r in found.iterations if r["variant"] == "XPBD" and r["iteration"] == 200]
    assert last["secondary_residual"] < 1e-10 * last["primary_residual"]


@pytest.mark.parametrize("kappa", [16, 160])
def test_no_divergence_passes_unnoticed(kappa: int) -> None:
    """What ends far above where its first sweeps left it is said to have failed."""
    found = small(f"xpbd-kappa-{kappa}")
    assert found.stiffness_number == pytest.approx(kappa, rel=1e-3)
    failed = {row["variant"] for row in found.steps if row["status"] in ("diverged", "stopped")}
    assert "XPBD, residual kept" in failed
    for row in found.steps:
        if row["variant"] not in failed:
            begin = [r["relative_residual"] for r in found.iterations if r["variant"] == row["variant"]][:2]
            assert row["relative_residual"] < 3.0 * max(begin), row["variant"]
    assert found.of("PBNG")[0]["status"] == "converged"


def test_substeps_are_the_way_out() -> None:
    found = small("xpbd-substeps-16", steps=2, start_step=4)
    assert found.stiffness_number == pytest.approx(1.0, rel=1e-3)
    for label in ("B-PXPBD", "FP-PXPBD, 1 local", "FP-PXPBD, 3 local"):
        assert all(row["status"] == "converged" and row["relative_residual"] <= 1e-8 for row in found.of(label))


def test_the_root_of_the_energy_inverts_cells_that_two_constraints_do_not() -> None:
    found = small("xpbd-hyperelastic", steps=33)
    assert found.stiffness_number == pytest.approx(14.4, rel=1e-2)
    worst = {label: min(row["min_jacobian"] for row in found.of(label)) for label in found.labels}
    assert worst["XPBD, root"] < worst["XPBD, two constraints"] - 0.2
    assert worst["XPBD, two constraints"] < worst["FP-PXPBD"] - 0.1


def test_xpbd_loses_volume_of_the_neo_hookean_law() -> None:
    found = small("xpbd-neo-hookean")
    assert found.stiffness_number == pytest.approx(1.44, rel=1e-2)
    newton, xpbd, fp = (found.of(label)[-1]["volume_ratio"] for label in ("reference", *found.labels))
    assert fp == pytest.approx(newton, rel=0.01)
    assert xpbd < newton - 0.1
