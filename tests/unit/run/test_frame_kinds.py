"""Frames of voxels and of particles: read as they were written, and what is said of damaged ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from femdeform.errors import InputError
from femdeform.run.frames import BodyFrame, GridFrame, ParticleFrame, load_frame, of_kind
from femdeform.run.recorder import Recorder
from femdeform.run.result import Result
from femdeform.run.vti import VTIWriter
from femdeform.run.vtk_reader import read_time
from femdeform.run.vtp import VTPWriter

SHAPE = (3, 4, 5)
RNG = np.random.default_rng(7)
DENSITY = RNG.random(SHAPE)
VELOCITY = RNG.random((*SHAPE, 3))
POSITION = RNG.random((6, 2))


@pytest.fixture
def voxels(tmp_path: Path) -> Path:
    recorder = Recorder(tmp_path / "v", VTIWriter(SHAPE, 0.5, (1.0, 2.0, 3.0)), ("step", "time"))
    recorder.start({}, {"simulation": "incompressible_flow"})
    cells = {"density": [DENSITY], "velocity": [VELOCITY], "solid": [(DENSITY > 0.5).astype(np.uint8)]}
    recorder.frame(0, 0.0, {}, cells)
    recorder.frame(1, 0.25, {}, {**cells, "density": [2.0 * DENSITY]})
    recorder.finish("done", "", {}, {}, cells)
    return tmp_path / "v"


@pytest.fixture
def particles(tmp_path: Path) -> Path:
    recorder = Recorder(tmp_path / "p", VTPWriter(), ("step", "time"))
    recorder.start({}, {"simulation": "material_points"})
    phase = np.array([0, 1, 0, 1, 1, 0], dtype=np.int8)
    recorder.frame(0, 0.0, {"position": POSITION, "velocity": 2.0 * POSITION, "phase": phase})
    recorder.frame(1, 0.25, {"position": POSITION[:2], "velocity": POSITION[:2]})
    recorder.frame(2, 0.5, {"position": POSITION[:0], "velocity": POSITION[:0]})
    recorder.finish("done", "", {}, {"position": POSITION})
    return tmp_path / "p"


def test_voxels_come_back_as_they_were(voxels: Path) -> None:
    result = Result.open(voxels)
    assert result.simulation == "incompressible_flow"
    frame = result.read_frame(1)
    assert isinstance(frame, GridFrame)
    assert (frame.time, frame.shape, frame.dim) == (0.25, SHAPE, 3)
    np.testing.assert_array_equal(frame.box, [[1.0, 2.0, 3.0], [2.5, 4.0, 5.5]])
    np.testing.assert_array_equal(frame.cell_data["density"], 2.0 * DENSITY)
    np.testing.assert_array_equal(frame.cell_data["velocity"], VELOCITY)
    np.testing.assert_array_equal(frame.solid, DENSITY > 0.5)
    final = result.read_final()
    assert isinstance(final, GridFrame)
    np.testing.assert_array_equal(final.cell_data["density"], DENSITY)


def test_voxels_in_the_plane_lie_flat(tmp_path: Path) -> None:
    VTIWriter((2, 3, 1), 0.5, (0.0, 0.0, 0.0)).write(tmp_path / "a.vti", 1.5, {}, {"density": [np.ones((2, 3, 1))]})
    frame = load_frame(tmp_path / "a.vti")
    assert isinstance(frame, GridFrame)
    assert (frame.time, frame.dim) == (1.5, 2)
    np.testing.assert_array_equal(frame.box, [[0.0, 0.0, 0.0], [1.0, 1.5, 0.0]])
    assert not frame.solid.any()


def test_particles_come_back_as_they_were_however_many(particles: Path) -> None:
    result = Result.open(particles)
    first, second, third = (result.read_frame(i) for i in range(3))
    assert isinstance(first, ParticleFrame)
    np.testing.assert_array_equal(first.positions, np.pad(POSITION, ((0, 0), (0, 1))))
    np.testing.assert_array_equal(first.point_data["velocity"], np.pad(2.0 * POSITION, ((0, 0), (0, 1))))
    np.testing.assert_array_equal(first.point_data["phase"], [0, 1, 0, 1, 1, 0])
    assert isinstance(second, ParticleFrame)
    assert isinstance(third, ParticleFrame)
    assert (len(second.positions), third.positions.shape) == (2, (0, 3))
    assert second.time == read_time(result.frames[1].path) == 0.25
    final = result.read_final()
    assert isinstance(final, ParticleFrame)
    assert len(final.positions) == 6


def test_a_frame_of_another_kind_is_an_error(voxels: Path) -> None:
    frame = load_frame(voxels / "final.vti")
    assert of_kind(frame, GridFrame, voxels) is frame
    with pytest.raises(InputError, match="a frame of fields on a grid, not of deformable bodies"):
        of_kind(frame, BodyFrame, voxels)
    with pytest.raises(InputError, match=r"a frame ends in \.vtu, \.vtp, \.vti"):
        load_frame(voxels / "frames.pvd")


def test_a_run_that_has_not_ended_has_no_last_state(voxels: Path) -> None:
    (voxels / "final.vti").unlink()
    with pytest.raises(InputError, match=r"there is no final\.vti: the run's status is done"):
        Result.open(voxels).read_final()


@pytest.mark.parametrize("kind", ["voxels", "particles"])
@pytest.mark.parametrize("keep", [0.0, 0.3, 0.9, 0.999])
def test_a_torn_frame(kind: str, keep: float, request: pytest.FixtureRequest) -> None:
    result = Result.open(request.getfixturevalue(kind))
    path = result.frames[1].path
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data))])
    with pytest.raises(InputError, match=rf"{path.name}: the file is corrupt") as caught:
        result.read_frame(1)
    assert "\n" not in str(caught.value)
    result.read_frame(0)
    path.unlink()
    with pytest.raises(InputError, match="missing"):
        Result.open(result.folder).read_frame(1)


@pytest.mark.parametrize(
    ("kind", "old", "new"),
    [
        ("voxels", 'WholeExtent="0 3 0 4 0 5"', 'WholeExtent="0 3 0 4 0 6"'),
        ("voxels", 'WholeExtent="0 3 0 4 0 5"', 'WholeExtent="0 3 0 4"'),
        ("voxels", 'WholeExtent="0 3 0 4 0 5"', 'WholeExtent="0 3 0 4 0 0"'),
        ("voxels", 'Spacing="0.5 0.5 0.5"', 'Spacing="0.5 0.5 0.0"'),
        ("voxels", 'Origin="1.0 2.0 3.0"', 'Origin="1.0 nan 3.0"'),
        ("voxels", "<CellData>", "<CellDatum>"),
        ("voxels", 'type="Float64" Name="density"', 'type="Float32" Name="density"'),
        ("particles", 'NumberOfPoints="2"', 'NumberOfPoints="3"'),
        ("particles", "Points>", "Point>"),
        ("particles", 'Name="velocity" NumberOfComponents="3"', 'Name="velocity" NumberOfComponents="2"'),
    ],
)
def test_frames_of_all_kinds_that_contradict_themselves(
    kind: str, old: str, new: str, request: pytest.FixtureRequest
) -> None:
    result = Result.open(request.getfixturevalue(kind))
    path = result.frames[1].path
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match="the file is corrupt"):
        result.read_frame(1)
