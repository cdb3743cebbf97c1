"""Pictures of particles: as large as they are apart, coloured by what they carry."""

from __future__ import annotations

from pathlib import Path

import imageio.v3 as iio
import numpy as np
import pytest
from drawn_pictures import draw, needs_opengl
from made_results import record_particles

from femdeform.errors import InputError
from femdeform.post.fields import default_field, select_field
from femdeform.post.particles import outward, spacing
from femdeform.post.render import view
from femdeform.post.survey import survey
from femdeform.run.result import Result
from femdeform.run.vtp import VTPWriter

# Red, green and blue of the first two bodies.
BLUE, ROSE = np.array([0x44, 0x77, 0xAA]), np.array([0xEE, 0x66, 0x77])


def like(picture: np.ndarray, colour: np.ndarray) -> np.ndarray:
    """Pixels of a colour, however bright."""
    length = np.linalg.norm(picture, axis=2)
    cosine = (picture @ colour) / np.maximum(length, 1.0) / np.linalg.norm(colour)
    return (cosine > 0.997) & (length > 60)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_distance_of_a_lattice_is_its_side(dim: int) -> None:
    lattice = np.stack(np.meshgrid(*[0.3 * np.arange(9)] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    flat = np.pad(lattice, ((0, 0), (0, 3 - dim)))
    assert spacing(flat, dim) == pytest.approx(0.3)
    assert spacing(flat[:1], dim) == 0.0
    assert spacing(flat[:2], dim) == pytest.approx(0.3)


def test_the_outside_of_a_cloud() -> None:
    lattice = np.stack(np.meshgrid(*[np.arange(-12.0, 13.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    ball = lattice[np.linalg.norm(lattice, axis=1) < 12.0]
    distance = np.linalg.norm(ball, axis=1)
    normals = outward(ball, 1.0)
    assert np.linalg.norm(normals, axis=1).max() <= 1.0 + 1e-12
    rim = distance > 11.0
    cosine = np.einsum("ij,ij->i", normals[rim], ball[rim]) / distance[rim]
    assert cosine.mean() > 0.9
    assert np.linalg.norm(normals[distance < 4.0], axis=1).max() < 0.2


def test_what_particles_show_by_themselves(drops_2d: Path, tmp_path: Path) -> None:
    assert default_field(Result.open(drops_2d).read_frame(-1)) == "temperature"
    even = record_particles(tmp_path / "r", 2, n=4, temperature=np.full(32, 300.0))
    assert survey(Result.open(even), [0], None).field == "velocity"
    frame = Result.open(even).read_frame(1)
    np.testing.assert_array_equal(
        select_field(frame, "speed", even).values, np.linalg.norm(frame.point_data["velocity"], axis=1)
    )
    assert select_field(frame, "temperature", even).label == "temperature [K]"
    with pytest.raises(InputError, match="no field 'heat'"):
        select_field(frame, "heat", even)


def test_camera_and_colours_are_those_of_all_frames(drops_2d: Path, drops_3d: Path) -> None:
    setting = survey(Result.open(drops_2d), range(3), None)
    assert setting.colours == (300.0, 420.0)
    assert (setting.dim, survey(Result.open(drops_3d), [0], None).dim) == (2, 3)
    low, high = setting.box
    reach = setting.radius
    np.testing.assert_allclose(low, [0.025 - reach, -0.275 - reach, 0.0])
    np.testing.assert_allclose(high, [0.575 + reach, 1.875 + reach, 0.0])
    assert 0.5 * 0.05 < reach < 0.05


@needs_opengl
@pytest.mark.parametrize("dim", [2, 3])
def test_blocks_are_where_they_are_and_have_no_gaps(dim: int, request: pytest.FixtureRequest) -> None:
    (picture,) = draw(request.getfixturevalue(f"drops_{dim}d"), [1], "body")
    low, high = like(picture, BLUE), like(picture, ROSE)
    for mask in (low, high):
        rows, columns = np.nonzero(mask)
        assert len(rows) > 1500
        if dim == 2:
            assert np.ptp(rows) == pytest.approx(np.ptp(columns), abs=4)
            assert len(rows) > 0.93 * (np.ptp(rows) + 1) * (np.ptp(columns) + 1)
    assert np.nonzero(high)[0].max() < np.nonzero(low)[0].min() + 10


@needs_opengl
def test_phases_have_their_colours(drops_2d: Path) -> None:
    first, last = draw(drops_2d, [0, 2], "phase")
    assert not like(first, ROSE).any()
    assert like(last, ROSE).sum() > 1500
    assert like(last, BLUE).sum() > 1500
    # All solid: the colour is that of solids, and not another one for want of a range.
    (alone,) = draw(drops_2d, [0], "phase")
    assert like(alone, BLUE).sum() > 3000


@needs_opengl
def test_particles_in_space_are_lit_from_above(drops_3d: Path) -> None:
    (picture,) = draw(drops_3d, [0], "body")
    rows, columns = np.nonzero(like(picture, ROSE))
    brightness = picture[rows, columns].sum(axis=1)
    top = rows < np.quantile(rows, 0.15)
    bottom = rows > np.quantile(rows, 0.85)
    assert brightness[top].mean() > 1.15 * brightness[bottom].mean()


@needs_opengl
def test_particles_in_front_hide_those_behind(tmp_path: Path) -> None:
    n = 10
    along = np.arange(n)
    in_core = (along >= 2) & (along < n - 2)
    core = in_core[:, None, None] & in_core[None, :, None] & in_core[None, None, :]
    folder = record_particles(tmp_path / "r", 3, n=n, body=np.tile(core.ravel(), 2).astype(np.int32))
    (picture,) = draw(folder, [0], "body")
    assert like(picture, BLUE).sum() > 3000
    assert not like(picture, ROSE).any()


@needs_opengl
def test_walls_are_drawn(drops_2d: Path) -> None:
    picture, _ = draw(drops_2d, [0, 2])  # the second one reaches below the wall
    grey = (np.ptp(picture, axis=2) < 40) & (picture.max(axis=2) < 200) & (picture.min(axis=2) > 90)
    assert (grey.sum(axis=1) > 0.3 * picture.shape[1]).any()  # the line of the plane


@needs_opengl
def test_a_movie_of_particles_whose_number_changes(drops_2d: Path, tmp_path: Path) -> None:
    folder = record_particles(tmp_path / "r", 2, n=5)
    path = Result.open(folder).frames[1].path
    none = np.zeros((0, 2))
    VTPWriter().write(path, 0.1, {"position": none, "temperature": none[:, 0]}, {})
    view(folder, movie=tmp_path / "a.gif", field="temperature")
    frames = iio.imread(tmp_path / "a.gif", index=None).astype(int)
    coloured = [(np.ptp(f[:, :600], axis=2) > 60).sum() for f in frames]
    assert coloured[1] == 0
    assert min(coloured[0], coloured[2]) > 1000


def test_nothing_to_show(tmp_path: Path) -> None:
    folder = record_particles(tmp_path / "r", 2, n=2)
    path = Result.open(folder).frames[0].path
    VTPWriter().write(path, 0.0, {"position": np.zeros((0, 2)), "temperature": np.zeros(0)}, {})
    with pytest.raises(InputError, match="the frames have no particles"):
        survey(Result.open(folder), [0], None)
    VTPWriter().write(path, 0.0, {"position": np.full((1, 2), np.nan), "temperature": np.zeros(1)}, {})
    with pytest.raises(InputError, match=r"frame_00000\.vtp: the positions are not finite"):
        survey(Result.open(folder), [0], None)
