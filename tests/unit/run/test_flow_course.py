"""Scenes of smoke from file to result folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista
from ruamel.yaml import YAML

from femdeform.run.checkpoint import read_checkpoint
from femdeform.run.runner import run_scene
from femdeform.run.table import read_table
from femdeform.scene.checks import check_file
from femdeform.scene.load import load_scene

BALL = {"region": {"sphere": {"center": [0.5, 0.2], "radius": 0.15}}}
SQUARE = {"recipe": "block", "size": [0.3, 0.3], "cells": [1, 1], "translate": [0.35, 0.5]}


def plume(**more: Any) -> dict[str, Any]:
    data = {
        "simulation": "incompressible_flow",
        "grid": {"cells": [16, 20], "cell_size": 0.0625},
        "sources": {"disc": BALL},
        "time": {"dt": 0.05, "end": 0.5},
        "measure": {"height": {"kind": "smoke_centroid", "component": "y"}},
    }
    return {**data, **more}


def written(data: dict[str, Any], path: Path) -> Path:
    with path.open("w") as file:
        YAML().dump(data, file)
    return path


def run(folder: Path, name: str = "out", **more: Any) -> Path:
    out = folder / name
    assert run_scene(written(plume(**more), folder / f"{name}.yaml"), out=out, threads=1, quiet=True) == 0
    return out


def facts(out: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((out / "result.json").read_text())
    return found


def test_a_result_folder(tmp_path: Path) -> None:
    fields = ["density", "velocity", "speed", "pressure", "vorticity", "divergence", "solid"]
    expect = {
        "residual": {"at_most": 1e-6},
        "divergence": {"at_most": 1e-4},
        "measured": {"height": {"at_least": 0.2}},
        "time_to_reach": [{"quantity": "height", "level": 0.21, "at_least": 0.05}],
    }
    out = run(tmp_path, output={"fields": fields, "every": 5}, expect=expect)
    result = facts(out)
    assert (result["status"], result["steps"], result["linear_solver"]) == ("done", 10, "mg_pcg")
    assert [verdict["passed"] for verdict in result["expect"]] == [True] * 4
    assert result["quantities"]["smoke"] > 0.0
    history = read_table(out / "history.csv")
    assert (history["divergence"] < 1e-4).all()
    assert (history["divergence_before"] > 100.0 * history["divergence"]).all()
    assert (np.diff(history["measure.height"]) > 0.0).all()
    assert [path.name for path in sorted((out / "frames").iterdir())] == [f"frame_0000{i}.vti" for i in range(3)]
    last = pyvista.read(out / "final.vti")
    assert last.dimensions == (17, 21, 2)
    assert set(last.cell_data) == set(fields)
    # VTK's first index runs fastest; the plume is symmetric about x = 0.5 and stands above its source.
    density = last.cell_data["density"].reshape(20, 16)
    np.testing.assert_allclose(density, density[:, ::-1], atol=1e-6)
    assert density[3].max() > density[-3].max()
    speed = np.linalg.norm(last.cell_data["velocity"], axis=1)
    np.testing.assert_allclose(last.cell_data["speed"], speed, rtol=1e-12)
    assert result["quantities"]["smoke"] == pytest.approx(density.sum() * 0.0625**2, rel=1e-12)


def test_resumed_as_if_unbroken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also with a solid that moves, whose voxels are made anew from the time, and an inlet."""
    inlets = {"wind": {"side": "left", "region": {"box": [[0, 0.5], [0, 1]]}, "velocity": [0.3, 0.1], "density": 0.5}}
    solids = {"box": {"mesh": SQUARE, "motion": {"rate": 3.0, "velocity": [0.0, 0.2]}}}
    more = {"solids": solids, "inlets": inlets, "boundaries": {"top": "open"}, "output": {"checkpoint_every": 4}}
    whole = run(tmp_path, "whole", **more)

    class StopError(Exception):
        pass

    from femdeform.run.flow_course import FlowCourse

    row, count = FlowCourse.row, [0]

    def stop(self: FlowCourse, state: Any, report: Any) -> dict[str, Any]:
        count[0] += 1
        if count[0] == 7:
            raise StopError
        return row(self, state, report)

    with monkeypatch.context() as patch:
        patch.setattr(FlowCourse, "row", stop)
        with pytest.raises(StopError):
            run_scene(tmp_path / "whole.yaml", out=tmp_path / "broken", threads=1, quiet=True)
    assert read_checkpoint(tmp_path / "broken").step == 4
    assert run_scene(tmp_path / "whole.yaml", out=tmp_path / "broken", resume=True, threads=1, quiet=True) == 0
    ours, theirs = read_checkpoint(whole), read_checkpoint(tmp_path / "broken")
    for name, values in ours.fields.items():
        np.testing.assert_array_equal(theirs.fields[name], values)
    for frame in sorted((whole / "frames").iterdir()):
        assert (tmp_path / "broken" / "frames" / frame.name).read_bytes() == frame.read_bytes()


def test_smoke_leaves_through_an_open_top(tmp_path: Path) -> None:
    more: dict[str, Any] = {"time": {"dt": 0.1, "end": 8.0}, "buoyancy": 4.0}
    more["sources"] = {"disc": {**BALL, "end": 0.3}}
    closed = facts(run(tmp_path, "closed", **more))["quantities"]["smoke"]
    opened = facts(run(tmp_path, "open", boundaries={"top": "open"}, **more))["quantities"]["smoke"]
    assert opened < 0.8 * closed


def test_an_inlet_drives_fluid_through_the_box(tmp_path: Path) -> None:
    inlets = {"wind": {"side": "left", "velocity": 0.5, "density": 0.25}}
    more: dict[str, Any] = {
        "sources": {},
        "measure": {"speed": {"kind": "velocity", "at": [0.5, 0.5], "component": "x"}},
    }
    out = run(tmp_path, inlets=inlets, boundaries={"right": "open"}, time={"dt": 0.1, "end": 1.0}, buoyancy=0.0, **more)
    quantities = facts(out)["quantities"]
    assert quantities["measure.speed"] == pytest.approx(0.5, rel=1e-6)
    assert quantities["smoke"] == pytest.approx(0.25 * 0.5 * 0.9 * 1.25, rel=0.03)


def test_a_source_at_a_wall_is_told_from_an_inlet(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = {"region": {"box": [[0, 0.4], [0.1, 0.6]]}, "velocity": [0.5, 0.0]}
    path = written(plume(sources={"jet": source}, time={"dt": 0.05, "end": 0.05}), tmp_path / "s.yaml")
    assert run_scene(path, out=tmp_path / "out", threads=1) == 0
    assert "sources.jet: blows from the wall on the left, which lets nothing in" in capsys.readouterr().err


def test_notices_of_solves_are_told_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from solvers.linear.poisson.guard import SlowNotice

    take = SlowNotice.take
    monkeypatch.setattr(SlowNotice, "take", lambda self, name, learned, classical: take(self, name, 2.0, 1.0))
    path = written(plume(linear_solver={"method": "spd_lmg"}), tmp_path / "s.yaml")
    assert run_scene(path, out=tmp_path / "out", threads=1) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "linear_solver" in line]
    assert len(lines) == 1
    assert "note: linear_solver: spd_lmg took 2 s for a pressure, multigrid 1 s" in lines[0]


def test_a_speed_that_no_step_can_follow_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = {**BALL, "velocity": [1e7, 0.0]}
    path = written(plume(sources={"jet": source}), tmp_path / "s.yaml")
    assert run_scene(path, out=tmp_path / "out", threads=1) == 3
    assert facts(tmp_path / "out")["status"] == "not_converged"
    assert "a source moves with 1e+07 m/s" in capsys.readouterr().err


def test_a_solid_keeps_smoke_out_and_drives_the_air(tmp_path: Path) -> None:
    solids = {"box": {"mesh": SQUARE, "motion": {"rate": 2.0}}}
    out = run(tmp_path, solids=solids, sources={}, measure={"side": {"kind": "velocity", "at": [0.8, 0.65]}})
    last = pyvista.read(out / "final.vti")
    solid = last.cell_data["solid"].astype(bool)
    assert 20 <= solid.sum() <= 30
    assert (last.cell_data["density"][solid] == 0.0).all()
    # Air beside a corner moves with it, counterclockwise: upwards on the right.
    centres = last.cell_centers().points
    right = (centres[:, 0] > 0.7) & (abs(centres[:, 1] - 0.65) < 0.2) & ~solid
    assert last.cell_data["velocity"][right, 1].max() > 0.1
    assert facts(out)["quantities"]["measure.side"] > 0.0


@pytest.mark.parametrize(
    "options",
    [
        {"method": "cg"},
        {"method": "icc"},
        {"method": "icc", "modification": 0.0},
        {"method": "deflated_cg", "n_vectors": 4},
        {"sweeps": 1, "precision": "float64"},
        {"method": "spd_lmg"},
    ],
    ids=str,
)
def test_every_solver_gives_the_same_flow(tmp_path: Path, options: dict[str, Any]) -> None:
    reference = read_checkpoint(run(tmp_path, "a", linear_solver={"tolerance": 1e-10})).fields
    other = read_checkpoint(run(tmp_path, "b", linear_solver={**options, "tolerance": 1e-10})).fields
    for name in ("u", "v", "density"):
        np.testing.assert_allclose(other[name], reference[name], atol=1e-7)


@pytest.mark.parametrize("method", ["icc", "hypre", "gamg"])
def test_petsc_gives_the_same_flow(tmp_path: Path, method: str) -> None:
    pytest.importorskip("petsc4py")
    options = {"method": method, "tolerance": 1e-10}
    if method == "icc":
        options["backend"] = "petsc"
    reference = read_checkpoint(run(tmp_path, "a", linear_solver={"tolerance": 1e-10})).fields
    other = read_checkpoint(run(tmp_path, "b", linear_solver=options)).fields
    np.testing.assert_allclose(other["v"], reference["v"], atol=1e-7)


def test_a_pressure_that_is_not_found_ends_the_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(plume(linear_solver={"method": "cg", "max_iterations": 2}), tmp_path / "s.yaml")
    assert run_scene(path, out=tmp_path / "out", threads=1) == 3
    assert facts(tmp_path / "out")["status"] == "not_converged"
    error = capsys.readouterr().err
    assert "step 1 with dt = 0.05 s" in error
    assert "dt cannot be halved below" in error


def test_a_step_too_long_is_taken_in_parts(tmp_path: Path) -> None:
    source = {**BALL, "velocity": [0.0, 1.0]}
    out = run(tmp_path, sources={"jet": source}, boundaries={"top": "open"}, time={"dt": 0.5, "end": 1.0})
    assert read_table(out / "history.csv")["substeps"].max() >= 3


def test_in_three_dimensions(tmp_path: Path) -> None:
    ball = {"region": {"box": [[0.3, 0.0, 0.3], [0.7, 0.2, 0.7]]}, "density": 0.5}
    grid = {"cells": [12, 12, 12], "cell_size": 1 / 12, "origin": [0, 0, 0]}
    out = run(tmp_path, grid=grid, sources={"box": ball}, output={"fields": ["density", "vorticity"]})
    last = pyvista.read(out / "final.vti")
    density = last.cell_data["density"].reshape(12, 12, 12)  # z, y, x
    np.testing.assert_allclose(density, density.transpose(2, 1, 0), atol=1e-6)
    assert last.cell_data["vorticity"].shape == (12**3, 3)


def test_the_resolved_scene_runs_from_anywhere(tmp_path: Path) -> None:
    from femdeform.cli import main

    (tmp_path / "here").mkdir()
    mesh = tmp_path / "here" / "square.msh"
    assert main(["mesh", "block", "--out", str(mesh), "--set", "size=[0.3,0.3]", "--set", "cells=[1,1]"]) == 0
    solids = {"box": {"mesh": {"file": "square.msh", "dim": 2, "translate": [0.35, 0.5]}}}
    out = run(tmp_path / "here", solids=solids)
    assert run_scene(out / "resolved.yaml", out=tmp_path / "again", threads=1, quiet=True) == 0
    ours, theirs = read_checkpoint(out).fields, read_checkpoint(tmp_path / "again").fields
    np.testing.assert_array_equal(ours["density"], theirs["density"])


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"grid": {"cells": [16, 20, 8], "cell_size": 0.1}}, "sources.disc.region.sphere.center: needs 3 numbers"),
        ({"boundaries": {"front": "open"}}, "boundaries.front: a flow in the plane has no such side"),
        ({"expect": {"measured": {"heigt": {"at_least": 0}}}}, "`heigt` is not measured; did you mean `height`?"),
        ({"measure": {"a": {"kind": "velocity", "at": [2, 0.5]}}}, "measure.a.at: lies outside of the grid"),
        (
            {"solids": {"line": {"mesh": {"recipe": "block", "size": [1, 1, 1], "cells": [1, 1, 1]}}}},
            "solids.line.mesh: is 3D, the grid is 2D",
        ),
        ({"solids": {"a": {"mesh": SQUARE, "motion": {"axis": [0, 0, 1]}}}}, "in the plane solids turn about z"),
        ({"bodies": {}}, "bodies: not a key of simulation `incompressible_flow`; it belongs to `deformable`"),
        ({"linear_solver": {"method": "mg_pgc"}}, "did you mean `mg_pcg`?"),
        ({"linear_solver": {"method": "dcdm", "weights": "nope.npz"}}, "linear_solver.weights: cannot read"),
        ({"linear_solver": {"method": "dcdm", "weights": "nope"}}, "weights: there are no weights named nope; shipped"),
        ({"linear_solver": {"method": "dcdm", "weights": "spd-lmg-2d"}}, "weights: spd-lmg-2d holds weights of method"),
    ],
)
def test_faults_have_their_key(tmp_path: Path, more: dict[str, Any], message: str) -> None:
    faults = [str(fault) for fault in check_file(written(plume(**more), tmp_path / "s.yaml"))]
    assert any(message in fault for fault in faults), faults


def test_what_is_for_deformable_bodies_says_so(tmp_path: Path) -> None:
    from femdeform.cli import main

    path = written(plume(), tmp_path / "s.yaml")
    assert main(["compare", str(path), "--methods", "pbng", "--iterations", "2"]) == 2
    assert load_scene(path).scene.simulation == "incompressible_flow"
