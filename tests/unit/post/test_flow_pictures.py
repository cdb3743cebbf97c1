"""Pictures of flows: smoke where it is, solids, fields with their ranges."""

from __future__ import annotations

import shutil
from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
from drawn_pictures import draw, needs_opengl
from made_results import record_flow

from femdeform.errors import InputError
from femdeform.post import backend
from femdeform.post.batch_page import BatchPage
from femdeform.post.fields import select_field
from femdeform.post.render import GIF_SIZE, view
from femdeform.post.stage import Stage
from femdeform.post.survey import survey
from femdeform.post.voxels import filled, solid_indicator
from femdeform.run.result import Result
from femdeform.run.vti import VTIWriter


def middle(mask: np.ndarray) -> np.ndarray:
    """Mean row and column of the pixels chosen."""
    assert mask.sum() > 50
    return np.argwhere(mask).mean(axis=0)


# ----------------------------------------------------------------------------------------------- what is drawn


def test_fields_of_voxels_and_those_that_follow_from_them(flow_2d: Path, flow_3d: Path) -> None:
    frame = Result.open(flow_2d).read_frame(-1)
    assert select_field(frame, None, flow_2d).label == "density [-]"
    np.testing.assert_array_equal(
        select_field(frame, "density", flow_2d).values.reshape(frame.shape), frame.cell_data["density"]
    )
    speed, velocity = (select_field(frame, name, flow_2d) for name in ("speed", "velocity"))
    np.testing.assert_array_equal(speed.values, velocity.values)
    assert speed.label == "speed [m/s]"
    turning = select_field(frame, "vorticity", flow_2d)
    np.testing.assert_allclose(turning.values, 2.0)
    assert turning.is_signed
    in_space = Result.open(flow_3d).read_frame(-1)
    np.testing.assert_allclose(select_field(in_space, "vorticity.z", flow_3d).values, 2.0)
    np.testing.assert_allclose(select_field(in_space, "vorticity.x", flow_3d).values, 0.0, atol=1e-12)
    assert not select_field(in_space, "vorticity", flow_3d).is_signed
    with pytest.raises(InputError, match="no field 'pressure' in this result; it has density, solid, speed"):
        select_field(frame, "pressure", flow_2d)


def test_ranges_leave_solids_out_and_keep_zero_in_the_middle(flow_2d: Path) -> None:
    result = Result.open(flow_2d)
    assert survey(result, range(3), None).colours == (0.0, 1.0)
    setting = survey(result, [0], "velocity.x")
    frame = result.read_frame(0)
    largest = np.abs(frame.cell_data["velocity"][..., 0][~frame.solid]).max()
    assert setting.colours == (-largest, largest)
    np.testing.assert_allclose(setting.box, [[0, 0, 0], [1, 4 / 3, 0]])
    assert setting.dim == 2


def test_inside_of_solids_the_nearest_value_outside(flow_2d: Path) -> None:
    frame = Result.open(flow_2d).read_frame(0)
    marked = np.where(frame.solid, -1.0, 1.0)
    np.testing.assert_array_equal(filled(marked, frame.solid), np.ones(frame.shape))
    np.testing.assert_array_equal(solid_indicator(frame.solid) > 0.5, frame.solid)
    assert not solid_indicator(np.zeros((3, 3, 1), dtype=bool)).max() > 0.5


# --------------------------------------------------------------------------------------------------- the plane


@needs_opengl
def test_smoke_in_the_plane_is_dark_where_it_is_dense_and_rises(flow_2d: Path) -> None:
    first, last = draw(flow_2d, [0, 2])
    dark = [picture.max(axis=2) < 90 for picture in (first, last)]
    # The lines around the grid stay, the smoke moves up, and not sideways.
    moved = [middle(mask & ~(dark[0] & dark[1])) for mask in dark]
    assert moved[1][0] < moved[0][0] - 40
    assert abs(moved[1][1] - moved[0][1]) < 3
    grey = (np.ptp(last, axis=2) < 12) & (abs(last.mean(axis=2) - 158) < 12)
    assert middle(grey)[1] > moved[1][1] + 60  # the solid, on the right


@needs_opengl
def test_vorticity_of_one_sign_has_one_colour_and_solids_stay_grey(flow_2d: Path) -> None:
    (picture,) = draw(flow_2d, [0], "vorticity")
    red = (picture[..., 0] - picture[..., 2]) > 60
    assert red.mean() > 0.2
    assert not ((picture[..., 2] - picture[..., 0]) > 60).any()
    (velocity,) = draw(flow_2d, [0], "velocity")
    (speed,) = draw(flow_2d, [0], "speed")
    assert (velocity.min(axis=2) > 240).sum() > (speed.min(axis=2) > 240).sum() + 300  # arrows


@needs_opengl
@pytest.mark.parametrize("field", ["solid", "velocity.y"])
def test_other_fields_in_the_plane_and_in_space(flow_2d: Path, flow_3d: Path, field: str) -> None:
    for folder in (flow_2d, flow_3d):
        (picture,) = draw(folder, [0], field)
        assert (np.ptp(picture, axis=2) > 40).mean() > 0.02


@needs_opengl
def test_frames_without_solids_or_density(tmp_path: Path) -> None:
    for shape in ((12, 12, 1), (8, 8, 8)):
        bare = record_flow(tmp_path / str(shape), shape, without=("solid", "density"))
        assert survey(Result.open(bare), [0], None).field == "velocity"
        (picture,) = draw(bare, [0])
        assert (np.ptp(picture, axis=2) > 40).mean() > 0.1
    with pytest.raises(InputError, match="no field 'density'"):
        view(bare, png=tmp_path / "a.png", field="density")


@needs_opengl
def test_the_voxels_of_solids_one_by_one(flow_2d: Path) -> None:
    (picture,) = draw(flow_2d, [0], "solid")
    rose = (picture[..., 0] > 220) & (abs(picture[..., 1] - 0x66) < 20)
    rows, columns = np.nonzero(rose)
    # A box of so many voxels, and its sides are sharp.
    frame = Result.open(flow_2d).read_frame(0)
    n_across, n_up = (len(np.unique(index)) for index in np.nonzero(frame.solid)[:2])
    assert np.ptp(columns) / np.ptp(rows) == pytest.approx(n_across / n_up, rel=0.08)
    assert len(rows) > 0.95 * (np.ptp(rows) + 1) * (np.ptp(columns) + 1)


# ------------------------------------------------------------------------------------------------------- space


@needs_opengl
def test_smoke_in_space_is_bright_before_a_dark_ground_and_rises(flow_3d: Path) -> None:
    first, last = draw(flow_3d, [0, 2])
    assert np.median(first) < 70
    smoke = [(np.ptp(p, axis=2) < 40) & (p.min(axis=2) > 120) for p in (first, last)]
    moved = [middle(mask & ~(smoke[0] & smoke[1])) for mask in smoke]
    assert moved[1][0] < moved[0][0] - 25
    solid = (last[..., 0] - last[..., 2]) > 30
    assert middle(solid)[1] > moved[1][1] + 40


@needs_opengl
def test_no_smoke_is_an_empty_room(tmp_path: Path) -> None:
    empty = record_flow(tmp_path / "r", (8, 8, 8), without=("solid",))
    path = Result.open(empty).frames[0].path
    VTIWriter((8, 8, 8), 0.125, (0.0, 0.0, 0.0)).write(path, 0.0, {}, {"density": [np.zeros((8, 8, 8))]})
    (picture,) = draw(empty, [0])
    assert picture.max() < 170
    assert (np.abs(np.diff(picture.sum(axis=2), axis=1)) > 60).sum() > 100  # the edges of the room


@needs_opengl
def test_in_a_window_smoke_is_a_volume_that_follows_the_frames(flow_3d: Path) -> None:
    result = Result.open(flow_3d)
    stage = Stage(backend.load_pyvista(), result, survey(result, [0, 2], None), None, size=(160, 100))
    stage._canvas.is_window = True
    stage.show(0)
    first = stage.picture().astype(int)
    stage.show(2)
    last = stage.picture().astype(int)
    stage.close()
    assert (first.min(axis=2) > 100).sum() > 20
    assert np.abs(first - last).max() > 60


@needs_opengl
def test_a_movie_of_smoke_keeps_its_camera(flow_3d: Path, tmp_path: Path) -> None:
    assert view(flow_3d, movie=tmp_path / "a.gif") == [tmp_path / "a.gif"]
    frames = iio.imread(tmp_path / "a.gif", index=None).astype(int)
    assert frames.shape[:3] == (3, GIF_SIZE[1], GIF_SIZE[0])
    assert np.abs(frames[0] - frames[2]).max() > 60
    solid = [(f[..., 0] - f[..., 2]) > 30 for f in frames]
    np.testing.assert_allclose(middle(solid[0]), middle(solid[2]), atol=6)


@needs_opengl
def test_small_pictures_for_studies(flow_2d: Path, flow_3d: Path, drops_2d: Path, tmp_path: Path) -> None:
    for folder in (flow_2d, flow_3d, drops_2d):
        target = tmp_path / f"{folder.name}.png"
        BatchPage().draw(folder, target)
        picture = iio.imread(target)
        assert picture.shape == (200, 320, 3)
        assert np.ptp(picture.astype(int), axis=(0, 1)).max() > 100


def test_a_grid_that_changes_and_a_kind_that_nobody_knows(flow_2d: Path, tmp_path: Path) -> None:
    other = record_flow(tmp_path / "other", (12, 12, 1))
    shutil.copy(flow_2d / "frames" / "frame_00001.vti", other / "frames" / "frame_00001.vti")
    with pytest.raises(InputError, match=r"frame_00001\.vti: the grid is not that of the other frames"):
        survey(Result.open(other), range(3), None)
    facts = (other / "result.json").read_text()
    (other / "result.json").write_text(facts.replace("incompressible_flow", "something_new"))
    with pytest.raises(InputError, match="nothing is known of pictures of a simulation 'something_new'"):
        survey(Result.open(other), [0], None)
