"""Bodies of material points that start in walls or in one another."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from test_point_course import LIQUID, points, run, written

from femdeform.cli import main
from femdeform.errors import InputError
from femdeform.run.inputs import read_together
from femdeform.scene.checks import check_file


def notices(folder: Path, **more: Any) -> list[str]:
    found: list[str] = []
    assert check_file(written(points(**more), folder / "scene.yaml"), notices=found) == []
    return found


SQUARE = {"kind": "box", "min": [0.25, 0.25], "max": [0.5, 0.5]}


def second(shape: dict[str, Any], **more: Any) -> dict[str, Any]:
    """A square of 8 x 8 points, and another body."""
    other = {"shape": shape, "liquid": LIQUID, **more}
    return {"bodies": {"drop": {"shape": SQUARE, "liquid": LIQUID}, "other": other}}


def box(low: tuple[float, float], high: tuple[float, float]) -> dict[str, Any]:
    return {"kind": "box", "min": list(low), "max": list(high)}


def test_points_inside_of_walls_are_counted(tmp_path: Path) -> None:
    """Two columns of points of eight are behind the wall; a floor that the body lies on has none."""
    floor = {"shape": {"kind": "plane", "point": [0.0, 0.25], "normal": [0.0, 1.0]}}
    assert notices(tmp_path, shape=SQUARE, walls=[floor]) == []
    text = "points of the body start inside of a wall, or outside of a container"
    wall = {"shape": box((0.0, 0.0), (0.3125, 1.0))}
    assert notices(tmp_path, shape=SQUARE, walls=[floor, wall]) == [f"bodies.drop.shape: 16 of 64 {text}"]
    container = {"shape": box((0.0, 0.0), (0.4375, 1.0)), "inside": True}
    assert notices(tmp_path, shape=SQUARE, walls=[wall, container]) == [f"bodies.drop.shape: 32 of 64 {text}"]


@pytest.mark.parametrize(
    ("shape", "without", "count"),
    [
        (box((0.5, 0.25), (0.75, 0.5)), None, 0),
        (box((0.4375, 0.25), (0.6875, 0.5)), None, 32),
        (box((0.3125, 0.3125), (0.4375, 0.4375)), None, 32),
        (box((0.125, 0.125), (0.625, 0.625)), [SQUARE], 0),
        (box((0.125, 0.125), (0.625, 0.625)), None, 128),
    ],
    ids=["side by side", "two columns", "inside", "around", "over"],
)
def test_bodies_that_share_room(tmp_path: Path, shape: dict[str, Any], without: Any, count: int) -> None:
    """Points of both count; bodies that touch, or lie in a hole of one another, are apart."""
    more = {} if without is None else {"without": without}
    text = f"bodies.other.shape: {count} points of it and of `drop` start inside of the other body, or on its points"
    assert notices(tmp_path, **second(shape, **more)) == ([text] if count else [])


def test_they_are_said_by_check_and_by_a_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(points(**second(box((0.4375, 0.25), (0.6875, 0.5)))), tmp_path / "scene.yaml")
    assert main(["check", str(path)]) == 0
    first, last = capsys.readouterr().out.splitlines()
    assert first.startswith(f"{path}: note: bodies.other.shape: 32 points")
    assert last == f"{path}: no faults"
    given = read_together(path, tmp_path / "out", (), False, False, None)
    (said,) = given.loaded.notices
    assert said.startswith("bodies.other.shape: 32 points")


def test_a_body_within_a_wall_does_not_run(tmp_path: Path) -> None:
    wall = {"shape": box((0.0, 0.0), (0.6, 0.6))}
    with pytest.raises(InputError, match="all points of the body start inside of a wall"):
        run(tmp_path, shape=SQUARE, walls=[wall])
