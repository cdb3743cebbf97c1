"""The result folder: readable by others at every moment, and the same after a kill and a resume."""

from __future__ import annotations

import csv
import json
import math
import os
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest
from ruamel.yaml import YAML

from femdeform.errors import InputError, OutputError
from femdeform.run.deformable import COLUMNS
from femdeform.run.recorder import Recorder
from femdeform.run.vtu import FrameMesh, VTUWriter

TETRA = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]])
TWO_TETS = np.array([[0, 1, 2, 3], [1, 4, 2, 3]])
EDGES = [(0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)]


def tetra_mesh() -> VTUWriter:
    return VTUWriter(FrameMesh(TETRA, [("tetra", TWO_TETS)], {"body": [np.array([0, 1])]}))


def row(step: int, **more: float | str) -> dict[str, Any]:
    numbers = {
        "time": 0.1 * step,
        "dt": 0.1,
        "iterations": 3,
        "linear_iterations": 7,
        "residual_norm": 1.0 / 3.0 * step,
        "relative_residual": 1e-9 / 3.0,
        "kinetic_energy": math.sin(step),
        "elastic_energy": 0.5 * step,
        "potential_energy": -0.1 * step,
        "contact_energy": 0.01 * step,
        "seconds": 0.25,
    }
    return {"step": step, **numbers, **more}


def moved(step: int) -> dict[str, np.ndarray]:
    return {"displacement": 0.01 * step * TETRA**2, "velocity": np.cos(TETRA + step)}


def record(recorder: Recorder, steps: range, *, every: int = 2) -> None:
    for step in steps:
        if step == 0:
            recorder.frame(0, 0.0, moved(0))
            continue
        for iteration in range(3):
            recorder.iteration({"step": step, "iteration": iteration, "residual_norm": 10.0**-iteration})
        recorder.step(row(step))
        if step % every == 0:
            recorder.frame(step // every, 0.1 * step, moved(step))
    recorder.sync()


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


# ------------------------------------------------------------------------------------------------------ frames


def test_frames_are_read_by_meshio_and_vtk(tmp_path: Path) -> None:
    pyvista = pytest.importorskip("pyvista")
    recorder = Recorder(tmp_path / "r", tetra_mesh(), COLUMNS)
    stress = np.arange(18.0).reshape(2, 3, 3)
    path = recorder.frame(7, 0.3, moved(3), {"von_mises": [np.array([1.5, 2.5])], "cauchy_stress": [stress]})
    assert path == tmp_path / "r" / "frames" / "frame_00007.vtu"

    read = meshio.read(path)
    np.testing.assert_array_equal(read.points, TETRA)  # the reference positions, not the deformed ones
    np.testing.assert_array_equal(read.cells_dict["tetra"], TWO_TETS)
    np.testing.assert_array_equal(read.point_data["displacement"], moved(3)["displacement"])
    np.testing.assert_array_equal(read.cell_data["von_mises"][0], [1.5, 2.5])

    grid = pyvista.read(path)
    assert grid.volume == pytest.approx(1.0 / 6.0 + 1.0 / 3.0)
    np.testing.assert_array_equal(grid.point_data["velocity"], moved(3)["velocity"])
    np.testing.assert_array_equal(grid.cell_data["cauchy_stress"], stress.reshape(2, 9))
    np.testing.assert_array_equal(grid.cell_data["body"], [0, 1])
    assert grid.field_data["TimeValue"][0] == 0.3
    assert grid.active_vectors_name == "displacement"


def test_frames_are_well_formed_xml(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "r", tetra_mesh(), COLUMNS)
    path = recorder.frame(0, 0.0, {**moved(1), 'odd "name" <&>': np.zeros(5)})
    root = ElementTree.parse(path).getroot()
    assert root.tag == "VTKFile"
    assert root.attrib["type"] == "UnstructuredGrid"
    names = [array.attrib["Name"] for array in root.iterfind("UnstructuredGrid/Piece/PointData/DataArray")]
    assert names == ["displacement", "velocity", 'odd "name" <&>']


def test_quadratic_cells_have_the_node_order_of_vtk(tmp_path: Path) -> None:
    pyvista = pytest.importorskip("pyvista")
    corners = TETRA[:4]
    points = np.concatenate([corners, [corners[list(edge)].mean(axis=0) for edge in EDGES]])
    flat = np.array([[2.0, 0, 0], [4, 0, 0], [2, 2, 0], [3, 0, 0], [3, 1, 0], [2, 1, 0]])
    mesh = FrameMesh(
        np.concatenate([points, flat]),
        [("tetra10", np.arange(10)[None]), ("triangle6", 10 + np.arange(6)[None])],
        {},
    )
    path = Recorder(tmp_path / "r", VTUWriter(mesh), COLUMNS).frame(0, 0.0, {"displacement": np.zeros((16, 3))})
    grid = pyvista.read(path)
    assert grid.celltypes.tolist() == [24, 22]
    # A wrong order would fold the cells, and their sizes would differ.
    sizes = grid.compute_cell_sizes()
    assert sizes.cell_data["Volume"][0] == pytest.approx(1.0 / 6.0)
    assert sizes.cell_data["Area"][1] == pytest.approx(2.0)
    assert {block.type for block in meshio.read(path).cells} == {"tetra10", "triangle6"}


def test_mixed_blocks_in_2d_are_padded(tmp_path: Path) -> None:
    points = np.array([[0.0, 0], [1, 0], [0, 1], [2, 2]])
    mesh = FrameMesh(
        points,
        [("triangle", np.array([[0, 1, 2]])), ("line", np.array([[0, 3], [3, 1]]))],
        {"region": [np.array([4]), np.array([5, 6])]},
    )
    strain = np.array([[[1.0, 2], [3, 4]]])
    fields = {"pk1": [strain, np.zeros((2, 2, 2))], "flag": [np.array([True]), np.array([False, True])]}
    path = Recorder(tmp_path / "r", VTUWriter(mesh), COLUMNS).frame(
        0, 0.0, {"displacement": points, "heat": points[:, :1]}, fields
    )
    read = meshio.read(path)
    np.testing.assert_array_equal(read.points, np.pad(points, ((0, 0), (0, 1))))
    np.testing.assert_array_equal(read.point_data["displacement"], np.pad(points, ((0, 0), (0, 1))))
    assert read.point_data["heat"].shape == (4,)
    assert [block.type for block in read.cells] == ["triangle", "line"]
    np.testing.assert_array_equal(read.cell_data["region"][1], [5, 6])
    np.testing.assert_array_equal(read.cell_data["flag"][1], [0, 1])
    np.testing.assert_array_equal(read.cell_data["pk1"][0], [[1, 2, 0, 3, 4, 0, 0, 0, 0]])


def test_arrays_larger_than_a_compressed_block_survive(tmp_path: Path) -> None:
    n = 60_001  # 1.44 MB of points: one full block and a part of one
    points = np.random.default_rng(0).standard_normal((n, 3))
    mesh = FrameMesh(points, [("line", np.stack([np.arange(n - 1), np.arange(1, n)], axis=1))], {})
    path = Recorder(tmp_path / "r", VTUWriter(mesh), COLUMNS).frame(0, 0.0, {"displacement": -points})
    read = meshio.read(path)
    np.testing.assert_array_equal(read.points, points)
    np.testing.assert_array_equal(read.point_data["displacement"], -points)
    np.testing.assert_array_equal(read.cells_dict["line"][-1], [n - 2, n - 1])


def test_pvd_lists_the_frames_by_time(tmp_path: Path) -> None:
    pyvista = pytest.importorskip("pyvista")
    recorder = Recorder(tmp_path / "r", tetra_mesh(), COLUMNS)
    recorder.frame(0, 0.0, moved(0))
    recorder.frame(2, 0.2, moved(2))
    recorder.frame(1, 0.1, moved(1))
    recorder.frame(1, 0.1, moved(4))  # the same frame again takes its place
    reader = pyvista.get_reader(tmp_path / "r" / "frames.pvd")
    assert list(reader.time_values) == [0.0, 0.1, 0.2]
    reader.set_active_time_point(1)
    grid = reader.read()[0]
    np.testing.assert_array_equal(grid.point_data["displacement"], moved(4)["displacement"])


@pytest.mark.parametrize(
    ("points", "blocks", "cell_data"),
    [
        (np.zeros((3, 1)), [], {}),
        (TETRA, [("hexahedron", TWO_TETS)], {}),
        (TETRA, [("tetra", TWO_TETS[:, :3])], {}),
        (TETRA, [("tetra", TWO_TETS + 1)], {}),
        (TETRA, [("tetra", TWO_TETS)], {"body": [np.zeros(3)]}),
        (TETRA, [("tetra", TWO_TETS)], {"body": [np.zeros(2), np.zeros(2)]}),
    ],
)
def test_meshes_that_do_not_fit_are_refused(points: Any, blocks: Any, cell_data: Any) -> None:
    with pytest.raises(ValueError, match=r"points|cell|data"):
        FrameMesh(points, blocks, cell_data)


def test_fields_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "r", tetra_mesh(), COLUMNS)
    with pytest.raises(ValueError, match="displacement"):
        recorder.frame(0, 0.0, {"velocity": TETRA})
    with pytest.raises(ValueError, match="'velocity' of length 4, 5 points"):
        recorder.frame(0, 0.0, {"displacement": TETRA, "velocity": TETRA[:4]})
    with pytest.raises(ValueError, match="'von_mises'"):
        recorder.frame(0, 0.0, moved(0), {"von_mises": [np.zeros(3)]})
    assert os.listdir(tmp_path / "r" / "frames") == []


# ------------------------------------------------------------------------------------------------ facts, scene


def test_result_json_tells_the_status_from_the_start(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "r", tetra_mesh(), COLUMNS)
    recorder.start({"title": "x"}, {"n_dofs": np.int64(15), "ranks": 1})
    begun = json.loads((tmp_path / "r" / "result.json").read_text())
    assert begun == {"status": "running", "reason": "", "steps": 0, "n_dofs": 15, "ranks": 1}
    record(recorder, range(3))
    facts = {"wall_seconds": np.float64(1.5), "odd": math.nan, "far": (np.inf, Path("a")), "n_dofs": 16}
    recorder.finish("not_converged", "step 3: too small a dt", facts, moved(2))

    def refuse(constant: str) -> float:
        raise AssertionError(f"{constant} is not JSON")

    text = (tmp_path / "r" / "result.json").read_text()
    ended = json.loads(text, parse_constant=refuse)
    assert ended["status"] == "not_converged"
    assert ended["reason"] == "step 3: too small a dt"
    assert ended["steps"] == 2
    assert ended["n_dofs"] == 16
    assert ended["odd"] is None
    assert ended["far"] == [None, "a"]
    final = meshio.read(tmp_path / "r" / "final.vtu")
    np.testing.assert_array_equal(final.point_data["displacement"], moved(2)["displacement"])
    assert final.field_data["TimeValue"] == pytest.approx(0.2)


def test_resolved_scene_reads_back_the_same(tmp_path: Path) -> None:
    resolved = {
        "schema_version": 1,
        "title": "colons: and 'quotes' # too",
        "gravity": (0.0, -9.81, 0),
        "bodies": {"b": {"material": {"youngs_modulus": 1e6, "poisson_ratio": 0.45, "tiny": 1e-12}}},
        "conditions": [{"kind": "fixed", "on": "b.left"}, {"kind": "path", "times": [0.0, 1.0]}],
        "flag": True,
        "word": "no",
        "none": None,
        "empty": [],
        "number": np.float64(0.1),
    }
    recorder = Recorder(tmp_path / "r", tetra_mesh(), COLUMNS)
    recorder.start(resolved, {})
    text = (tmp_path / "r" / "resolved.yaml").read_text()
    read = YAML(typ="safe", pure=True).load(text)
    assert read == {**resolved, "gravity": [0.0, -9.81, 0], "number": 0.1}
    assert list(read) == list(resolved)
    assert "gravity: [0.0, -9.81, 0]" in text


# ------------------------------------------------------------------------------------------------------ tables


def test_history_has_the_standard_columns_first_and_all_digits(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "r", tetra_mesh(), COLUMNS)
    recorder.step(row(np.int64(1), note="a, b\nc", max_displacement=0.1 + 0.2))
    recorder.step({"step": 2, "time": 0.2})
    # Not closed: a row is on its way as soon as it is given.
    with (tmp_path / "r" / "history.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows[0] == [*COLUMNS, "note", "max_displacement"]
    first = dict(zip(rows[0], rows[1], strict=True))
    assert first["step"] == "1"
    assert float(first["max_displacement"]) == 0.1 + 0.2
    assert float(first["residual_norm"]) == 1.0 / 3.0
    assert first["note"] == "a, b c"
    assert dict(zip(rows[0], rows[2], strict=True))["residual_norm"] == ""
    with pytest.raises(ValueError, match="no column 'new'"):
        recorder.step(row(3, new=1.0))
    with pytest.raises(ValueError, match="step"):
        recorder.step({"time": 1.0})
    assert len((tmp_path / "r" / "history.csv").read_text().splitlines()) == 3


def test_iterations_are_written_with_trace_only(tmp_path: Path) -> None:
    for trace in (False, True):
        recorder = Recorder(tmp_path / str(trace), tetra_mesh(), COLUMNS, trace=trace)
        record(recorder, range(1, 3))
        recorder.close()
        recorder.close()
    assert not (tmp_path / "False" / "iterations.csv").exists()
    lines = (tmp_path / "True" / "iterations.csv").read_text().splitlines()
    assert len(lines) == 1 + 6
    assert lines[0].startswith("step,iteration,residual_norm,relative_residual,objective,step_length,linear_it")


# ------------------------------------------------------------------------------------------------------ resume


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("unbroken") / "r"
    recorder = Recorder(folder, tetra_mesh(), COLUMNS, trace=True)
    recorder.start({"title": "x"}, {"n_dofs": 15})
    record(recorder, range(9))
    recorder.finish("done", "", {"wall_seconds": 1.0}, moved(8))
    return contents(folder)


@pytest.mark.parametrize(("checkpoint", "killed_at"), [(0, 0), (0, 5), (1, 1), (3, 4), (4, 4), (4, 7), (7, 8)])
@pytest.mark.parametrize("damage", ["none", "torn", "orphan", "no pvd", "finished"])
def test_a_resumed_run_leaves_the_files_of_an_unbroken_one(
    tmp_path: Path, unbroken: dict[str, bytes], checkpoint: int, killed_at: int, damage: str
) -> None:
    folder = tmp_path / "r"
    recorder = Recorder(folder, tetra_mesh(), COLUMNS, trace=True)
    recorder.start({"title": "x"}, {"n_dofs": 15})
    record(recorder, range(killed_at + 1))
    if damage == "torn":
        for name in ("history.csv", "iterations.csv"):
            with (folder / name).open("ab") as file:
                file.write(b"9,0.9,0.1,3,7,1.2\xc3")
        (folder / "frames" / ".frame_00004-0a.part.vtu").write_bytes(b"<VTKFi")
    elif damage == "orphan":
        # Killed between a frame and the list of frames.
        recorder._writer.write(folder / "frames" / "frame_00009.vtu", 0.9, moved(9), {})
    elif damage == "no pvd":
        (folder / "frames.pvd").unlink()
    elif damage == "finished":
        recorder.finish("interrupted", "by the user", {}, moved(killed_at))

    recorder = Recorder(folder, tetra_mesh(), COLUMNS, trace=True, resume_from_step=checkpoint)
    recorder.start({"title": "x"}, {"n_dofs": 15})
    assert json.loads((folder / "result.json").read_text())["steps"] == checkpoint
    record(recorder, range(checkpoint + 1, 9))
    recorder.finish("done", "", {"wall_seconds": 1.0}, moved(8))
    assert contents(folder) == unbroken


def test_resume_needs_a_result_and_the_rows_before_the_checkpoint(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"result\.json is missing"):
        Recorder(tmp_path / "none", tetra_mesh(), COLUMNS, resume_from_step=3)
    recorder = Recorder(tmp_path / "r", tetra_mesh(), COLUMNS)
    recorder.start({}, {})
    record(recorder, range(3))
    with pytest.raises(InputError, match="ends at step 2, the checkpoint is of step 5"):
        Recorder(tmp_path / "r", tetra_mesh(), COLUMNS, resume_from_step=5)
    (tmp_path / "r" / "history.csv").write_text("step,time\n1,0.1\ntwo,0.2\n")
    with pytest.raises(InputError, match=r"history\.csv: step: the table is corrupt"):
        Recorder(tmp_path / "r", tetra_mesh(), COLUMNS, resume_from_step=1)


# -------------------------------------------------------------------------------------------- fresh, overwrite


def test_a_fresh_run_does_not_land_on_another_result(tmp_path: Path) -> None:
    folder = tmp_path / "r"
    recorder = Recorder(folder, tetra_mesh(), COLUMNS)
    recorder.start({}, {})
    record(recorder, range(5))
    before = contents(folder)
    with pytest.raises(InputError, match="an unfinished result already: give --resume"):
        Recorder(folder, tetra_mesh(), COLUMNS)
    recorder.finish("done", "", {}, moved(4))
    with pytest.raises(InputError, match=r"a result already.*--out"):
        Recorder(folder, tetra_mesh(), COLUMNS)
    before.pop(".reserve.part")  # room for the last result.json
    assert before.items() <= {**contents(folder), "result.json": before["result.json"]}.items()
    (folder / "result.json").unlink()
    with pytest.raises(InputError, match="a result already"):
        Recorder(folder, tetra_mesh(), COLUMNS)


def test_overwriting_removes_the_files_of_a_result_only(tmp_path: Path) -> None:
    folder = tmp_path / "r"
    recorder = Recorder(folder, tetra_mesh(), COLUMNS, trace=True)
    recorder.start({}, {})
    record(recorder, range(5))
    recorder.finish("done", "", {}, moved(4))
    (folder / "notes.txt").write_text("mine")
    (folder / "frames" / "notes.txt").write_text("mine")
    (folder / "report.html").write_text("of the old run")
    (folder / "plots").mkdir()
    (folder / "plots" / "energy.png").write_text("of the old run")
    Recorder(folder, tetra_mesh(), COLUMNS, overwrite=True)
    assert sorted(contents(folder)) == ["frames/notes.txt", "notes.txt"]


def test_other_files_do_not_keep_a_run_from_starting(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    recorder = Recorder(tmp_path, tetra_mesh(), COLUMNS)
    recorder.start({}, {})
    assert (tmp_path / "notes.txt").read_text() == "mine"


# ---------------------------------------------------------------------------------------------------- failures


def test_a_frame_that_fails_leaves_the_earlier_ones(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorder = Recorder(tmp_path / "r", tetra_mesh(), COLUMNS)
    recorder.frame(0, 0.0, moved(0))
    before = contents(tmp_path / "r")

    def full(handle: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OutputError, match="the disk is full"):
        recorder.frame(1, 0.1, moved(1))
    assert contents(tmp_path / "r") == before
