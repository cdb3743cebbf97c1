"""Reading result folders: whole ones, unfinished ones, and what is said of damaged ones."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from femdeform.errors import InputError
from femdeform.run.deformable import COLUMNS
from femdeform.run.recorder import Recorder
from femdeform.run.result import Result
from femdeform.run.vtu import FrameMesh, VTUWriter

POINTS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [2, 2, 2]])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    mesh = FrameMesh(
        POINTS,
        [("tetra", np.array([[0, 1, 2, 3]])), ("line", np.array([[3, 4], [1, 4]]))],
        {"body": [np.array([0]), np.array([1, 1])]},
    )
    recorder = Recorder(tmp_path / "r", VTUWriter(mesh), COLUMNS, trace=True)
    recorder.start({"title": "a title", "gravity": [0, -9.81, 0]}, {"n_dofs": 15})
    for step in range(3):
        if step:
            recorder.iteration({"step": step, "iteration": 0, "residual_norm": 1.0})
            recorder.step({"step": step, "time": 0.5 * step, "residual_norm": 1e-9, "note": f"step {step}"})
        fields = {"von_mises": [np.array([1.0 + step]), np.array([2.0, 3.0])]}
        recorder.frame(10 * step, 0.5 * step, {"displacement": step * POINTS, "heat": POINTS[:, 0]}, fields)
    recorder.finish("done", "", {"wall_seconds": 2.5}, {"displacement": 3.0 * POINTS})
    return tmp_path / "r"


def test_facts_history_and_scene(folder: Path) -> None:
    result = Result.open(folder)
    assert result.facts["status"] == "done"
    assert result.facts["wall_seconds"] == 2.5
    assert result.history["step"].dtype == np.int64
    np.testing.assert_array_equal(result.history["step"], [1, 2])
    np.testing.assert_array_equal(result.history["time"], [0.5, 1.0])
    assert np.all(np.isnan(result.history["elastic_energy"]))
    assert result.history["note"].tolist() == ["step 1", "step 2"]
    assert result.iterations is not None
    np.testing.assert_array_equal(result.iterations["step"], [1, 2])
    assert result.resolved == {"title": "a title", "gravity": [0, -9.81, 0]}
    assert Result.open(folder / "result.json").folder == folder


def test_frames(folder: Path) -> None:
    result = Result.open(folder)
    assert [(entry.number, entry.time) for entry in result.frames] == [(0, 0.0), (10, 0.5), (20, 1.0)]
    assert result.frames[1].path == folder / "frames" / "frame_00010.vtu"
    frame = result.read_frame(-1)
    assert frame.time == 1.0
    np.testing.assert_array_equal(frame.points, POINTS)
    np.testing.assert_array_equal(frame.displacement, 2.0 * POINTS)
    np.testing.assert_array_equal(frame.positions, 3.0 * POINTS)
    np.testing.assert_array_equal(frame.point_data["heat"], POINTS[:, 0])
    assert [name for name, _ in frame.blocks] == ["tetra", "line"]
    np.testing.assert_array_equal(frame.blocks[1][1], [[3, 4], [1, 4]])
    assert [array.tolist() for array in frame.cell_data["von_mises"]] == [[3.0], [2.0, 3.0]]
    assert [array.tolist() for array in frame.cell_data["body"]] == [[0], [1, 1]]
    np.testing.assert_array_equal(result.read_final().displacement, 3.0 * POINTS)


@pytest.mark.parametrize("index", [3, -4])
def test_a_frame_that_is_not_there(folder: Path, index: int) -> None:
    with pytest.raises(InputError, match=f"no frame {index} in this result: it has frames 0 to 2"):
        Result.open(folder).read_frame(index)


def test_a_run_that_has_just_begun(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "r", VTUWriter(FrameMesh(POINTS, [], {})), COLUMNS)
    recorder.start({}, {})
    result = Result.open(tmp_path / "r")
    assert result.facts["status"] == "running"
    assert result.frames == []
    assert result.iterations is None
    with pytest.raises(InputError, match="no such file"):
        _ = result.history
    with pytest.raises(InputError, match="it has no frames"):
        result.read_frame(0)
    with pytest.raises(InputError, match=r"no final\.vtu.*running"):
        result.read_final()


def test_a_mesh_without_cells_is_read(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "r", VTUWriter(FrameMesh(POINTS, [], {"body": []})), COLUMNS)
    recorder.start({}, {})
    recorder.frame(0, 0.0, {"displacement": POINTS})
    frame = Result.open(tmp_path / "r").read_frame(0)
    assert frame.blocks == []
    assert frame.cell_data == {"body": []}


def test_neighbouring_blocks_of_one_type_come_back_as_one(tmp_path: Path) -> None:
    edges = np.array([[0, 1], [1, 2]])
    mesh = FrameMesh(POINTS, [("line", edges), ("line", edges + 1)], {"body": [np.zeros(2), np.ones(2)]})
    recorder = Recorder(tmp_path / "r", VTUWriter(mesh), COLUMNS)
    recorder.start({}, {})
    recorder.frame(0, 0.0, {"displacement": POINTS})
    frame = Result.open(tmp_path / "r").read_frame(0)
    assert len(frame.blocks) == 1
    np.testing.assert_array_equal(frame.blocks[0][1], np.concatenate([edges, edges + 1]))
    np.testing.assert_array_equal(frame.cell_data["body"][0], [0, 0, 1, 1])


# ---------------------------------------------------------------------------------------------------- damage


def test_folders_that_are_no_results(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such result folder"):
        Result.open(tmp_path / "missing")
    with pytest.raises(InputError, match=r"not a result folder: result\.json is missing"):
        Result.open(tmp_path)


@pytest.mark.parametrize("text", ["", '{"status": "done"', "[1, 2]", '{"steps": 3}', '{"status": 3}', "\x00"])
def test_corrupt_result_json(folder: Path, text: str) -> None:
    (folder / "result.json").write_text(text)
    with pytest.raises(InputError, match=r"result\.json: the file is corrupt") as caught:
        Result.open(folder)
    assert "\n" not in str(caught.value)


def test_a_torn_last_line_is_left_out(folder: Path) -> None:
    with (folder / "history.csv").open("ab") as file:
        file.write(b"3,1.5,0.1,12,\xc3")
    np.testing.assert_array_equal(Result.open(folder).history["step"], [1, 2])


def test_a_torn_line_in_the_middle_is_named(folder: Path) -> None:
    path = folder / "history.csv"
    lines = path.read_text().splitlines(keepends=True)
    path.write_text(lines[0] + "1,0.5\n" + lines[2])
    with pytest.raises(InputError, match=r"history\.csv:2: 2 cells, the header has 13"):
        _ = Result.open(folder).history


def test_integers_too_large_for_64_bits_are_read_as_numbers(folder: Path) -> None:
    path = folder / "history.csv"
    path.write_text("step,count\n1,99999999999999999999\n")
    assert Result.open(folder).history["count"][0] == 1e20


@pytest.mark.parametrize("keep", [0.0, 0.3, 0.9, 0.999])
def test_a_torn_frame(folder: Path, keep: float) -> None:
    path = folder / "frames" / "frame_00010.vtu"
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data))])
    with pytest.raises(InputError, match=r"frame_00010\.vtu: the file is corrupt") as caught:
        Result.open(folder).read_frame(1)
    assert "\n" not in str(caught.value)
    Result.open(folder).read_frame(0)


def _replaced(text: str, name: str, change: str) -> str:
    head, tail = text.split(f'Name="{name}"', 1)
    begin, rest = tail.split(">", 1)
    body, end = rest.split("</DataArray>", 1)
    changes = {
        "flipped": body[:-12] + "AAAA" + body[-8:],
        "shorter": body[:-8],
        "not base64": "!" + body[1:],
        "empty": "",
        "huge": "/////w" + body[6:],
    }
    return f'{head}Name="{name}"{begin}>{changes[change]}</DataArray>{end}'


@pytest.mark.parametrize("name", ["Points", "connectivity", "displacement"])
@pytest.mark.parametrize("change", ["flipped", "shorter", "not base64", "empty", "huge"])
def test_a_damaged_array(folder: Path, name: str, change: str) -> None:
    path = folder / "frames" / "frame_00010.vtu"
    path.write_text(_replaced(path.read_text(), name, change))
    with pytest.raises(InputError, match="the file is corrupt"):
        Result.open(folder).read_frame(1)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('NumberOfPoints="5"', 'NumberOfPoints="6"'),
        ('NumberOfCells="3"', 'NumberOfCells="2"'),
        ('Name="displacement"', 'Name="displacements"'),
        ('Name="types"', 'Name="kinds"'),
        ('type="Int64" Name="connectivity"', 'type="Int99" Name="connectivity"'),
        ('format="binary"', 'format="ascii"'),
    ],
)
def test_frames_that_contradict_themselves(folder: Path, old: str, new: str) -> None:
    path = folder / "frames" / "frame_00010.vtu"
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match="the file is corrupt"):
        Result.open(folder).read_frame(1)


def test_the_list_of_frames(folder: Path) -> None:
    (folder / "frames" / "frame_00010.vtu").unlink()
    with pytest.raises(InputError, match=r"incomplete: frames/frame_00010\.vtu is missing"):
        _ = Result.open(folder).frames
    (folder / "frames.pvd").write_text("<VTKFile>")
    with pytest.raises(InputError, match="list of frames is corrupt"):
        _ = Result.open(folder).frames


@pytest.mark.parametrize("text", ["a: [1", "- 1\n- 2\n", "a: 1\na: 2\n"])
def test_a_corrupt_scene(folder: Path, text: str) -> None:
    (folder / "resolved.yaml").write_text(text)
    with pytest.raises(InputError, match=r"resolved\.yaml: the file is corrupt") as caught:
        _ = Result.open(folder).resolved
    assert "\n" not in str(caught.value)
    assert Result.open(folder).resolved_text == text


def test_facts_of_newer_versions_are_kept(folder: Path) -> None:
    facts = json.loads((folder / "result.json").read_text())
    (folder / "result.json").write_text(json.dumps({**facts, "new": {"a": 1}}))
    assert Result.open(folder).facts["new"] == {"a": 1}
