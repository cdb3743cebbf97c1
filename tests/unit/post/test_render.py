"""Pictures and movies: made without a display, showing what they should."""

from __future__ import annotations

import shutil
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
from drawn_pictures import needs_opengl
from made_results import N_FRAMES, block, record

from femdeform.errors import InputError, MissingDependencyError
from femdeform.post import backend
from femdeform.post.render import GIF_SIZE, PICTURE_SIZE, draw_frames, view
from femdeform.post.stage import Stage
from femdeform.post.survey import survey
from femdeform.run.result import Result
from femdeform.run.vtu import FrameMesh


def coloured(picture: np.ndarray) -> np.ndarray:
    """Pixels of the bodies: coloured ones left of the legend and above the axes."""
    pixels = picture[:, : int(0.8 * picture.shape[1])].astype(int)
    return np.ptp(pixels, axis=2) > 40


@needs_opengl
def test_a_picture_has_its_size_and_something_on_it(beam: Path, tmp_path: Path) -> None:
    target = tmp_path / "new folder" / "a.png"
    assert view(beam, png=target) == [target]
    picture = iio.imread(target)
    assert picture.shape == (PICTURE_SIZE[1], PICTURE_SIZE[0], 3)
    assert 0.05 < coloured(picture).mean() < 0.8
    assert np.all(picture[:3, :3] == 255)  # white ground


@needs_opengl
def test_bodies_lie_where_their_displacement_puts_them(beam: Path) -> None:
    first, last = draw_frames(Result.open(beam), [0, N_FRAMES - 1])
    rows_first, rows_last = (np.flatnonzero(coloured(p).any(axis=1)) for p in (first, last))
    assert rows_last.min() < rows_first.min() - 50  # it is bent upwards
    # The clamped end does not move: one camera for both pictures.
    columns_first, columns_last = (np.flatnonzero(coloured(p).any(axis=0)) for p in (first, last))
    assert abs(columns_first.min() - columns_last.min()) <= 2
    # At rest everything has the lowest colour; bent, the tip has the highest, a yellow.
    assert not (first[..., 0].astype(int) - first[..., 2] > 120)[:, :1000].any()
    assert (last[..., 0].astype(int) - last[..., 2] > 120)[:, :1000].any()


@needs_opengl
def test_frame_and_field_are_chosen(beam: Path, tmp_path: Path) -> None:
    pictures = []
    choices = ({}, {"frame": 0}, {"frame": -1}, {"field": "von_mises"}, {"field": "velocity.x"})
    for number, options in enumerate(choices):
        path = tmp_path / f"{number}.png"
        view(beam, png=path, **options)
        pictures.append(iio.imread(path).astype(int))
    assert np.array_equal(pictures[0], pictures[2])
    for other in (1, 3, 4):
        assert np.abs(pictures[0] - pictures[other]).max() > 50


@needs_opengl
def test_rods_membranes_quadratic_bodies_and_obstacles(assembly: Path, tmp_path: Path) -> None:
    with_obstacles = draw_frames(Result.open(assembly), [0])[0]
    bodies = draw_frames(Result.open(assembly), [0], field="body")[0].astype(int)
    # The three colours of the bodies, each lit from somewhere: by which channel leads.
    red, green, blue = (bodies[:, :1000, c] for c in range(3))
    assert ((blue > red + 40) & (blue > green + 15)).sum() > 2000  # block
    assert ((red > blue + 40) & (red > green + 60)).sum() > 2000  # cloth
    assert ((green > red + 40) & (green > blue + 40)).sum() > 150  # rod
    copy = shutil.copytree(assembly, tmp_path / "copy")
    text = (copy / "result.json").read_text()
    (copy / "result.json").write_text(text.replace('"obstacles"', '"others"'))
    without = draw_frames(Result.open(copy), [0])[0]
    grey = [(np.ptp(p.astype(int), axis=2) < 25) & (p.max(axis=2) < 235) for p in (with_obstacles, without)]
    assert grey[0].mean() > grey[1].mean() + 0.05


@needs_opengl
def test_2d_bodies_are_seen_from_above(plane: Path) -> None:
    picture = draw_frames(Result.open(plane), [0])[0]
    rows, columns = np.nonzero(coloured(picture))
    # The unit square is a square in the picture: filled, as wide as it is high.
    assert np.ptp(rows) == pytest.approx(np.ptp(columns), abs=4)
    assert len(rows) == pytest.approx((np.ptp(rows) + 1) * (np.ptp(columns) + 1), rel=0.05)


@needs_opengl
def test_a_gif_of_all_frames(beam: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    movie = tmp_path / "a.gif"
    assert view(beam, movie=movie) == [movie]
    frames = iio.imread(movie, index=None)
    assert frames.shape[:3] == (N_FRAMES, GIF_SIZE[1], GIF_SIZE[0])
    assert np.abs(frames[0].astype(int) - frames[-1]).max() > 50
    captured = capsys.readouterr()
    assert captured.out == captured.err == ""  # quiet where there is no terminal


@needs_opengl
def test_an_mp4_of_all_frames_and_a_picture(beam: Path, tmp_path: Path) -> None:
    movie, png = tmp_path / "a.mp4", tmp_path / "a.png"
    assert view(beam, movie=movie, png=png, field="von_mises") == [png, movie]
    frames = iio.imread(movie)
    assert frames.shape == (N_FRAMES, PICTURE_SIZE[1], PICTURE_SIZE[0], 3)
    assert 0.03 < coloured(frames[-1]).mean() < 0.8
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.mp4", "a.png"]


@needs_opengl
def test_camera_and_colours_stay_the_same_over_a_movie(beam: Path) -> None:
    result = Result.open(beam)
    setting = survey(result, range(N_FRAMES), None)
    assert setting.colours == (0.0, pytest.approx(0.4))
    np.testing.assert_allclose(setting.box, [[0, 0, 0], [1.0, 0.6, 0.2]], atol=1e-12)
    stage = Stage(backend.load_pyvista(), result, setting, None, size=(320, 208))
    cameras, ranges = [], []
    for index in range(N_FRAMES):
        stage.show(index)
        stage.picture()
        cameras.append([*stage.plotter.camera.position, *stage.plotter.camera.focal_point])
        (bar,) = stage.plotter.scalar_bars.values()
        ranges.append(tuple(bar.GetLookupTable().GetRange()))
    stage.close()
    assert np.ptp(cameras, axis=0).max() == 0.0
    assert set(ranges) == {setting.colours}


@needs_opengl
def test_a_narrow_range_is_labelled_with_enough_digits(tmp_path: Path) -> None:
    points, cells = block((1, 1, 1), (1.0, 1.0, 1.0))
    mesh = FrameMesh(points, [("tetra", cells)], {})
    heat = {"jacobian": [np.linspace(1.0, 1.0001, len(cells))]}
    result = Result.open(record(tmp_path / "r", mesh, lambda time: 0.0 * points + 0.5, cell_data=lambda time: heat))
    labels = []
    for field in ("jacobian", "displacement", "velocity.x"):
        stage = Stage(backend.load_pyvista(), result, survey(result, [0], field), field, size=(320, 208))
        stage.show(0)
        (bar,) = stage.plotter.scalar_bars.values()
        labels.append((bar.GetLabelFormat(), *bar.GetLookupTable().GetRange()))
        stage.close()
    assert labels[0][1:] == (1.0, 1.0001)
    assert "7g" in labels[0][0]
    # Lengths start at zero, so that a body that moves as a whole has one colour; what is constant gets some range.
    assert labels[1][1:] == pytest.approx((0.0, 0.5 * np.sqrt(3.0)))
    assert "3g" in labels[1][0]
    assert labels[2][1:] == pytest.approx((0.5, 1.5))


@needs_opengl
def test_without_a_display_the_picture_goes_to_the_result(
    beam: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = shutil.copytree(beam, tmp_path / "copy")
    assert view(copy) == [copy / "view.png"]
    assert "no display" in capsys.readouterr().err
    assert iio.imread(copy / "view.png").shape[2] == 3


def test_wrong_requests_are_refused_before_anything_is_drawn(
    beam: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unexpected() -> None:
        raise AssertionError("drawn")

    monkeypatch.setattr("femdeform.post.render.load_pyvista", unexpected)
    with pytest.raises(InputError, match=r"a picture has to end in \.png"):
        view(beam, png=tmp_path / "a.bmp")
    with pytest.raises(InputError, match=r"a movie has to end in \.mp4 or \.gif"):
        view(beam, movie=tmp_path / "a.avi")
    with pytest.raises(InputError, match="no frame 99"):
        view(beam, png=tmp_path / "a.png", frame=99)
    with pytest.raises(InputError, match="no such result folder"):
        view(tmp_path / "missing", png=tmp_path / "a.png")
    empty = shutil.copytree(beam, tmp_path / "copy")
    (empty / "frames.pvd").unlink()
    with pytest.raises(InputError, match="no frames"):
        view(empty, png=tmp_path / "a.png")
    assert not (tmp_path / "a.png").exists()


@needs_opengl
def test_an_unknown_field_and_displacements_that_are_not_finite(beam: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no field 'strain'"):
        view(beam, png=tmp_path / "a.png", field="strain")
    with pytest.raises(InputError, match="no field 'strain'"):
        view(beam, movie=tmp_path / "a.gif", field="strain")
    assert list(tmp_path.iterdir()) == []
    mesh = FrameMesh(np.eye(3), [("triangle", np.array([[0, 1, 2]]))], {})
    broken = record(tmp_path / "r", mesh, lambda time: np.where(np.eye(3) * time > 0.6, np.nan, 0.0))
    with pytest.raises(InputError, match=r"frame_00003\.vtu: the displacements are not finite"):
        view(broken, movie=tmp_path / "a.gif")
    assert not (tmp_path / "a.gif").exists()


def test_a_machine_without_opengl_is_one_line(beam: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # What VTK does where it finds no OpenGL.
    monkeypatch.setattr(backend, "_PROBE", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    backend._can_draw.cache_clear()
    try:
        with pytest.raises(MissingDependencyError, match="libegl1") as caught:
            view(beam, png=tmp_path / "a.png")
    finally:
        backend._can_draw.cache_clear()
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 4
    assert list(tmp_path.iterdir()) == []
