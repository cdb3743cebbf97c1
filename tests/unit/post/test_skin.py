"""Skins: bound at the start of a run, put on when frames are drawn."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenario import body, material, quasistatic, scene, write

from femdeform.errors import InputError
from femdeform.post.render import view
from femdeform.post.skin import DrawnFrames
from femdeform.run.result import Result
from femdeform.run.runner import run_scene
from femdeform.scene.checks import check_file

SPHERE = {"recipe": "sphere", "radius": 1.0, "element_size": 0.8}
SURFACE = {"recipe": "sphere_surface", "radius": 1.0, "element_size": 0.15}


def dressed(order: int = 1) -> dict[str, object]:
    """A ball with a fine skin that is pulled apart, beside another one without a skin."""
    other = body({**SPHERE, "translate": [3.0, 0.0, 0.0]}, material("stable_neo_hookean"))
    return scene(
        {"a": body(SPHERE, material("linear"), element_order=order, skin=SURFACE), "b": other},
        {"kind": "path", "on": "a", "times": [0.0, 1.0], "displacements": [[0, 0, 0], [0.25, 0.5, 0.0]]},
        {"kind": "fixed", "on": "b"},
        time=quasistatic(),
        output={"fields": ["displacement", "von_mises"]},
    )


@pytest.mark.parametrize("order", [1, 2])
def test_the_surface_follows_its_body(order: int, tmp_path: Path) -> None:
    path, out = write(dressed(order), tmp_path / "scene.yaml"), tmp_path / "out"
    assert run_scene(path, out=out, quiet=True) == 0
    result = Result.open(out)
    bare, frame = result.read_frame(-1), DrawnFrames(result).read(-1)
    n = len(bare.points)
    skin = frame.points[n:]
    np.testing.assert_allclose(np.linalg.norm(skin, axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(frame.displacement[n:], np.broadcast_to([0.25, 0.5, 0.0], skin.shape), atol=1e-6)
    assert len(frame.point_data["displacement"]) == len(frame.points)
    names = [name for name, _ in frame.blocks]
    assert names[-1] == "triangle"
    assert set(np.concatenate([np.unique(values) for values in frame.cell_data["body"][:-1]])) == {1}
    assert set(frame.cell_data["body"][-1]) == {0}
    assert all(len(cells) == len(frame.cell_data["von_mises"][k]) for k, (_, cells) in enumerate(frame.blocks))
    picture = tmp_path / "view.png"
    view(out, png=picture)
    assert picture.stat().st_size > 10_000


def test_a_skin_that_cannot_be_is_a_fault_at_its_line(tmp_path: Path) -> None:
    data = dressed()
    data["bodies"]["a"]["skin"] = {"recipe": "block", "size": [1.0, 1.0, 1.0], "cells": [2, 2, 2]}  # type: ignore[index]
    (fault,) = check_file(write(data, tmp_path / "scene.yaml"))
    assert fault.key == "bodies.a.skin"
    assert fault.message == "a skin is made of triangles in 3D, not of tetrahedra in 3D"
    data["bodies"]["a"]["skin"] = {"file": "nowhere.obj"}  # type: ignore[index]
    (fault,) = check_file(write(data, tmp_path / "scene.yaml"))
    assert fault.key == "bodies.a.skin.file"


def test_a_damaged_skin_is_told(tmp_path: Path) -> None:
    path, out = write(dressed(), tmp_path / "scene.yaml"), tmp_path / "out"
    assert run_scene(path, out=out, quiet=True) == 0
    (out / "skins.npz").write_bytes(b"nothing of use")
    with pytest.raises(InputError, match=r"skins\.npz: the file is corrupt"):
        DrawnFrames(Result.open(out))
