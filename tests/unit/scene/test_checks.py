"""Checks that need meshes: which mesh a check builds, and what it makes of broken ones."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from femdeform import registry
from femdeform.errors import InputError
from femdeform.scene.checks import check_file, check_scene
from femdeform.scene.load import LoadedScene, load_scene
from femdeform.scene.meshing import load_meshes, survey_meshes
from femdeform.types import Mesh

Write = Callable[..., Path]
BLOCK = "{recipe: block, size: [1.0, 0.2, 0.2], cells: [5, 1, 1]}"


def test_a_sound_scene_has_no_faults(scene_file: Write) -> None:
    path = scene_file()
    assert check_file(path) == []
    loaded = load_scene(path)
    assert check_scene(loaded, load_meshes(loaded)) == []


def test_meshes_are_built_once(scene_file: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    loaded = load_scene(scene_file())
    meshes = load_meshes(loaded)
    assert meshes["beam"].n_cells == 25
    monkeypatch.setitem(registry.MESH, "build", "nowhere:nothing")
    assert load_meshes(loaded)["beam"] is meshes["beam"]
    assert survey_meshes(loaded).meshes["beam"] is meshes["beam"]


def test_a_check_of_a_large_block_uses_a_small_one(scene_file: Write) -> None:
    loaded = load_scene(scene_file(), ["bodies.beam.mesh.cells=[100, 200, 200]"])
    survey = survey_meshes(loaded)
    assert survey.coarse == {"beam"}
    assert survey.meshes["beam"].n_points == 125
    assert loaded.meshes == {}
    assert check_scene(loaded, survey.meshes, survey.coarse) == []


def test_a_check_builds_the_mesh_that_a_place_is_sought_in(scene_file: Write) -> None:
    overrides = [
        "bodies.beam.mesh.cells=[400, 15, 15]",
        "conditions[0].on={sphere: {center: [0, 0, 0], radius: 0.004}}",
    ]
    loaded = load_scene(scene_file(), overrides)
    survey = survey_meshes(loaded)
    assert survey.coarse == frozenset()
    assert check_scene(loaded, survey.meshes, survey.coarse) == []


@pytest.mark.parametrize(
    "source",
    [
        "{recipe: block, size: [1, 1], cells: [600, 600]}",
        "{recipe: cloth, cells: [1000, 300]}",
        "{recipe: rod, cells: 100000}",
        "{recipe: rod_net, meshes: [40, 50], segments: 6}",
        "{recipe: cook, cells: [400, 400]}",
        "{recipe: flag, cells: [3000, 20]}",
        "{recipe: cylinder, element_size: 0.039, hole_radius: 0.2}",
        "{recipe: spherical_shell, element_size: 0.015, part: eighth}",
        "{recipe: plate_with_hole, element_size: 0.05, quarter: true}",
        "{recipe: rubber_mount, element_size: 0.0035}",
    ],
)
def test_a_coarse_mesh_has_the_names_and_the_dimension_of_the_fine_one(source: str, scene_file: Write) -> None:
    loaded = load_scene(scene_file(), [f"bodies.beam.mesh={source}", "conditions=[]"])
    survey = survey_meshes(loaded)
    assert survey.coarse == {"beam"}
    coarse = survey.meshes["beam"]
    fine: Mesh = registry.resolve(registry.MESH["build"])(loaded.scene.bodies["beam"].mesh, Path())
    assert coarse.n_cells < fine.n_cells
    assert (coarse.dim, coarse.cell_type) == (fine.dim, fine.cell_type)
    for groups in ("facet_groups", "cell_groups", "node_groups"):
        assert set(getattr(coarse, groups)) == set(getattr(fine, groups))
    assert all(coarse.group_nodes(name).size for name in coarse.group_names())


def test_faults_of_placement_do_not_hide_others(scene_file: Write) -> None:
    path = scene_file()
    found = check_file(path, ["bodies.beam.mesh.translate=[1, 0]", "conditions[0].on=beam.lft"])
    assert [fault.key for fault in found] == ["bodies.beam.mesh.translate", "conditions[0].on"]


def write_mesh_file(path: Path, cells: list[list[int]]) -> None:
    """A mesh of six points in the .mesh format; cells count from 0 here, from 1 in the file."""
    points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 1, 1]]
    lines = ["MeshVersionFormatted 2", "Dimension 3", "Vertices", str(len(points))]
    lines += [f"{x} {y} {z} 0" for x, y, z in points]
    lines += ["Tetrahedra", str(len(cells)), *(" ".join(str(n + 1) for n in cell) + " 0" for cell in cells), "End"]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def test_a_mesh_from_a_file(scene_file: Write, tmp_path: Path) -> None:
    path = scene_file()
    write_mesh_file(tmp_path / "part.mesh", [[0, 1, 2, 3], [1, 4, 2, 5], [1, 2, 3, 5]])
    overrides = ["bodies.beam.mesh={file: part.mesh}", "conditions=[]"]
    assert check_file(path, overrides) == []
    loaded = load_scene(path, overrides)
    assert load_meshes(loaded)["beam"].n_cells == 3


def test_notices_of_a_mesh_are_kept(scene_file: Write, tmp_path: Path) -> None:
    write_mesh_file(tmp_path / "part.mesh", [[0, 1, 2, 3], [1, 4, 2, 5], [2, 1, 3, 5]])
    loaded = load_scene(scene_file(), ["bodies.beam.mesh={file: part.mesh}", "conditions=[]"])
    mesh = load_meshes(loaded)["beam"]
    corners = mesh.points[mesh.cells]
    assert (np.linalg.det(corners[:, 1:] - corners[:, :1]) > 0.0).all()
    assert any(notice.startswith("body beam: ") for notice in loaded.notices)


@pytest.mark.parametrize(
    "cells",
    [
        [[0, 1, 2, 3], [1, 4, 2, 5], [0, 1, 2, 4], [1, 2, 3, 5]],
        [[0, 1, 2, 3], [1, 4, 2, 5], [0, 1, 2, 3], [1, 2, 3, 5]],
        [[0, 1, 2, 3]],
    ],
    ids=["flat", "duplicate", "unreferenced points"],
)
def test_a_broken_mesh_is_a_fault_at_its_line(cells: list[list[int]], scene_file: Write, tmp_path: Path) -> None:
    path = scene_file()
    text = path.read_text(encoding="utf-8").replace(BLOCK, "\n      file: part.mesh\n      scale: 0.1")
    path = scene_file(text)
    write_mesh_file(tmp_path / "part.mesh", cells)
    faults = check_file(path, ["conditions=[]"])
    assert faults
    assert {(fault.file, fault.line, fault.key) for fault in faults} == {(str(path), 7, "bodies.beam.mesh.file")}
    with pytest.raises(InputError) as caught:
        load_meshes(load_scene(path, ["conditions=[]"]))
    assert list(caught.value.faults) == faults


def test_a_file_that_is_no_mesh(scene_file: Write, tmp_path: Path) -> None:
    (tmp_path / "part.mesh").write_text("this is no mesh\n", encoding="utf-8")
    (fault,) = check_file(scene_file(), ["bodies.beam.mesh={file: part.mesh}", "conditions=[]"])
    assert fault.key == "bodies.beam.mesh.file"


def with_regions(mesh: Mesh, **groups: list[int]) -> Mesh:
    cells = {name: np.array(found, dtype=np.int64) for name, found in groups.items()}
    return Mesh(mesh.points, mesh.cells, mesh.cell_type, mesh.facet_groups, cells, mesh.node_groups)


@pytest.mark.parametrize(
    ("groups", "expected"),
    [
        ({"soft": list(range(25))}, []),
        (
            {"soft": list(range(20)), "hard": list(range(20, 25))},
            ["leave cells without a material; add `material` for the rest (further groups of cells: hard)"],
        ),
        ({"hard": [0]}, ["there is no group of cells `soft`; known: hard"]),
        ({}, ["there is no group of cells `soft`; the mesh names no groups of cells"]),
    ],
)
def test_regions(groups: dict[str, list[int]], expected: list[str], scene_file: Write) -> None:
    loaded, mesh = with_soft_region(scene_file())
    faults = check_scene(loaded, {"beam": with_regions(mesh, **groups)})
    assert [fault.message for fault in faults] == expected


def test_regions_that_overlap(scene_file: Write) -> None:
    loaded, mesh = with_soft_region(scene_file(), "bodies.beam.regions.hard={law: arap, density: 1, youngs_modulus: 1}")
    faults = check_scene(loaded, {"beam": with_regions(mesh, soft=list(range(20)), hard=[3, *range(20, 25)])})
    assert [fault.message for fault in faults] == ["share cells, whose material is then not clear: `soft`, `hard`"]


def with_soft_region(path: Path, *overrides: str) -> tuple[LoadedScene, Mesh]:
    """The scene with its material given to the cells `soft` only, and its mesh."""
    material = load_scene(path).data["bodies"]["beam"]["material"]
    given = ", ".join(f"{key}: {value}" for key, value in material.items())
    loaded = load_scene(path, ["bodies.beam.material=null", f"bodies.beam.regions.soft={{{given}}}", *overrides])
    return loaded, load_meshes(loaded)["beam"]
