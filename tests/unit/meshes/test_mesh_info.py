"""The text of `femdeform mesh`, and the settings it takes."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from femdeform.errors import InputError, MeshError
from femdeform.scene.mesh_schema import BlockMesh
from meshes import build_mesh
from meshes.info import describe, mesh_command, parse_recipe_arguments


def test_description_of_a_block() -> None:
    mesh = build_mesh(BlockMesh(recipe="block", size=(2.0, 1.0, 0.5), cells=(4, 2, 1)), Path())
    lines = describe(mesh, "beam").splitlines()
    text = "\n".join(lines)
    assert lines[0] == "beam"
    assert "40 tetrahedra in 3D" in text
    assert "points    30" in text
    assert "(0, 0, 0) to (2, 1, 0.5) m" in text
    assert "volume    1 m^3" in text
    assert "boundary  56 facets, area 7 m^2" in text
    assert any(line.split() == ["left", "facets", "4", "area", "0.5", "m^2"] for line in lines)
    assert any(line.split() == ["left_top_front", "nodes", "1"] for line in lines)
    bars = [line for line in lines if "#" in line]
    assert sum(int(line.split()[1]) for line in bars) == 40
    assert max(line.count("#") for line in bars) == 40


def test_description_of_lines_and_triangles(tmp_path: Path) -> None:
    text = mesh_command("rod", {"cells": 4, "end": [2.0, 0.0, 0.0]}, None, None)
    assert "4 lines in 3D" in text
    assert "length    2 m" in text
    assert "quality" not in text
    text = mesh_command("cook", {"cells": [4, 4]}, None, None)
    assert "32 triangles in 2D" in text
    assert "area      1440 m^2" in text
    assert any(line.split() == ["right", "facets", "4", "length", "16", "m"] for line in text.splitlines())
    text = mesh_command("sphere_surface", {}, None, None)
    assert "boundary  0 facets, length 0 m" in text


def test_make_write_and_read_back(tmp_path: Path) -> None:
    path = tmp_path / "new" / "ball.msh"
    made = mesh_command("sphere", {"radius": 0.1, "element_size": 0.05}, path, None)
    assert made.endswith(f"written to {path}")
    read = mesh_command(None, {}, None, path)
    assert read.splitlines()[1:] == made.splitlines()[1:-1]
    settings: dict[str, object] = {"scale": 10.0, "translate": [0, 0, 1]}
    scaled = mesh_command(None, settings, tmp_path / "ball.stl", path)
    (box,) = [line for line in scaled.splitlines() if line.startswith("  box")]
    corners = [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?", box)]
    assert corners[:6] == pytest.approx([-1.0, -1.0, 0.0, 1.0, 1.0, 2.0], abs=0.05)
    assert "note: only the surface of the solid written" in scaled


def test_settings_are_judged_like_a_scene() -> None:
    with pytest.raises(InputError) as caught:
        mesh_command("sphere", {"radius": -1.0, "radios": 2, "rotate.angle": "x"}, None, None)
    faults = {fault.key: fault.message for fault in caught.value.faults}
    assert set(faults) == {"radius", "radios", "rotate.angle"}
    assert all(fault.file == "--set" for fault in caught.value.faults)
    assert "greater than 0" in faults["radius"]
    with pytest.raises(InputError, match=r"size has 2 entries but cells has 3"):
        mesh_command("block", {"size": [1.0, 1.0]}, None, None)
    with pytest.raises(InputError, match="`radius` has no keys of its own"):
        mesh_command("sphere", {"radius": 1.0, "radius.x": 2.0}, None, None)


def test_wrong_calls() -> None:
    with pytest.raises(InputError, match=r"`sfere` is not a recipe; did you mean `sphere`\?"):
        mesh_command("sfere", {}, None, None)
    with pytest.raises(InputError, match="`42` is not a recipe; known: block, "):
        mesh_command("42", {}, None, None)
    for recipe, info in ((None, None), ("sphere", Path("a.msh"))):
        with pytest.raises(InputError, match="either the name of a recipe or --info FILE"):
            mesh_command(recipe, {}, None, info)
    with pytest.raises(MeshError, match=r"cannot be written as `\.doc`"):
        mesh_command("rubber_mount", {}, Path("a.doc"), None)


def test_arguments() -> None:
    words = ["size=[1, 2.5, 1e-3]", "split=6", "rotate.angle = 0.5", "plane=xz", "quarter=true"]
    assert parse_recipe_arguments(words) == {
        "size": [1, 2.5, 1e-3],
        "split": 6,
        "rotate.angle": 0.5,
        "plane": "xz",
        "quarter": True,
    }
    with pytest.raises(InputError, match="`size` is not of the form key=value"):
        parse_recipe_arguments(["size"])
    with pytest.raises(InputError, match="--set: size: not a value"):
        parse_recipe_arguments(["size=[1, 2"])


def test_importing_meshes_loads_nothing_heavy() -> None:
    code = (
        "import sys, meshes, meshes.info, meshes.recipes, meshes.import_export\n"
        "heavy = {'gmsh', 'meshio', 'scipy', 'pyvista', 'skfem', 'numba'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    folder = Path(__file__).resolve().parents[3]
    run = [sys.executable, "-c", code]
    result = subprocess.run(run, cwd=folder, check=True, capture_output=True, text=True)
    assert result.stdout.strip() == "[]"
