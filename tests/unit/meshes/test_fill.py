"""Filling closed surfaces: volumes, cavities, several bodies, and surfaces that cannot be filled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from femdeform.errors import MeshError
from femdeform.scene.mesh_schema import BlockMesh, FileMesh, SphereSurfaceMesh
from femdeform.types import FloatArray, IntArray, Mesh
from meshes import build_mesh, check_mesh
from meshes.boundary import area_vectors, connected_parts, measures
from meshes.fill import fill_surface
from meshes.parts import MeshParts, NamedPart, assemble
from meshes.quality import cell_quality


def sphere(radius: float, size: float, center: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Mesh:
    source = SphereSurfaceMesh(recipe="sphere_surface", radius=radius, element_size=size, translate=center)
    return build_mesh(source, Path())


def joined(*surfaces: Mesh) -> MeshParts:
    offsets = np.cumsum([0, *[surface.n_points for surface in surfaces]])
    cells = [surface.cells + offset for surface, offset in zip(surfaces, offsets, strict=False)]
    points = np.concatenate([surface.points for surface in surfaces])
    return MeshParts(points, {"triangle": np.concatenate(cells)})


def inside(points: FloatArray, triangles: IntArray) -> float:
    """Volume inside a closed surface."""
    return float(np.einsum("ni,ni->", area_vectors(points, triangles), points[triangles[:, 0]])) / 3.0


def test_own_triangles_stay_with_their_names(check_solid: Callable[..., None]) -> None:
    surface = sphere(1.0, 0.3)
    upper = np.flatnonzero(surface.points[surface.cells].mean(axis=1)[:, 1] > 0.0)
    named = [
        NamedPart("upper", "triangle", upper),
        NamedPart("lower", "triangle", np.setdiff1d(np.arange(surface.n_cells), upper)),
    ]
    parts = fill_surface(MeshParts(surface.points, {"triangle": surface.cells}, named), "ball")
    mesh = assemble(parts, "ball")
    check_solid(mesh)
    assert np.array_equal(mesh.points[: surface.n_points], surface.points)
    assert len(mesh.facet_groups["boundary"]) == surface.n_cells
    assert len(mesh.facet_groups["upper"]) == len(upper)
    volume = inside(surface.points, surface.cells)
    assert measures(mesh.points, mesh.cells).sum() == pytest.approx(volume, rel=1e-12)
    assert check_mesh(mesh, "ball")[1] == []
    assert cell_quality(mesh.points, mesh.cells).min() > 0.1


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e4])
def test_shells_inside_are_cavities_and_islands(scale: float, check_solid: Callable[..., None]) -> None:
    ball, cavity, island = sphere(1.0, 0.25), sphere(0.6, 0.2), sphere(0.3, 0.15)
    # The orientation of a shell must not matter: turn one over.
    island = replace(island, cells=island.cells[:, ::-1])
    apart = sphere(0.5, 0.2, (3.0, 0.0, 0.0))
    parts = joined(cavity, ball, apart, island)
    mesh = assemble(fill_surface(replace(parts, points=parts.points * scale), "shells"), "shells")
    check_solid(mesh, covered=False)
    volumes = [abs(inside(shell.points, shell.cells)) for shell in (ball, cavity, island, apart)]
    expected = (volumes[0] - volumes[1] + volumes[2] + volumes[3]) * scale**3
    assert measures(mesh.points, mesh.cells).sum() == pytest.approx(expected, rel=1e-10)
    assert connected_parts(mesh.cells, mesh.n_points)[0] == 3


def test_element_size_meshes_the_surface_anew(check_solid: Callable[..., None]) -> None:
    parts = joined(sphere(1.0, 0.1))
    coarse = assemble(fill_surface(parts, "ball", element_size=0.3), "ball")
    check_solid(coarse, covered=False)
    assert len(coarse.facet_groups["boundary"]) < 0.3 * len(parts.cells["triangle"])
    assert measures(coarse.points, coarse.cells).sum() == pytest.approx(4 / 3 * np.pi, rel=0.05)


def test_sharp_edges_survive_a_new_surface(tmp_path: Path, check_solid: Callable[..., None]) -> None:
    cube = build_mesh(BlockMesh(recipe="block", cells=(2, 2, 2)), Path())
    parts = MeshParts(cube.points, {"triangle": cube.facet_groups["boundary"]})
    mesh = assemble(fill_surface(parts, "cube", element_size=0.2), "cube")
    check_solid(mesh, covered=False)
    assert measures(mesh.points, mesh.cells).sum() == pytest.approx(1.0, rel=1e-6)
    assert mesh.n_cells > 500


def test_surface_that_cannot_be_meshed_anew_is_kept_with_a_notice(data_dir: Path) -> None:
    source = FileMesh(file="armadillo_low.obj", fill=True, element_size=0.1)
    notices: list[str] = []
    mesh = build_mesh(source, data_dir / "meshes", notices)
    assert notices == ["fill: the surface is kept, meshing it with element_size 0.1 fails"]
    assert len(mesh.facet_groups["boundary"]) == 1346
    assert measures(mesh.points, mesh.cells).sum() == pytest.approx(0.0537291, rel=1e-4)


def test_armadillo(data_dir: Path, check_solid: Callable[..., None]) -> None:
    source = FileMesh(file="armadillo_low.obj", fill=True, scale=2.0, translate=(0.0, 1.0, 0.0))
    mesh, notices = check_mesh(build_mesh(source, data_dir / "meshes"), "armadillo")
    assert notices == []
    check_solid(mesh, covered=False)
    assert len(mesh.facet_groups["boundary"]) == 1346
    assert measures(mesh.points, mesh.cells).sum() == pytest.approx(8.0 * 0.0537291, rel=1e-4)


def test_open_surface(data_dir: Path) -> None:
    source = FileMesh(file="square_cloth3.obj", fill=True)
    with pytest.raises(MeshError) as caught:
        build_mesh(source, data_dir / "meshes")
    message = str(caught.value)
    assert message.startswith("square_cloth3.obj: fill: the surface is not closed: 304 open edges, between")
    assert message.count("-") == 5
    assert message.endswith(", ...")


def test_surface_with_a_fin() -> None:
    ball = sphere(1.0, 0.5)
    fin = np.concatenate([ball.cells[0, :2], [ball.n_points]])
    points = np.concatenate([ball.points, [[0.0, 3.0, 0.0]]])
    parts = MeshParts(points, {"triangle": np.concatenate([ball.cells, fin[None]])})
    with pytest.raises(MeshError, match="the surface is not closed: 2 open edges"):
        fill_surface(parts, "fin")


def test_surfaces_that_cross() -> None:
    with pytest.raises(MeshError, match="crossing: fill: parts of the surface cross each other"):
        fill_surface(joined(sphere(1.0, 0.4), sphere(1.0, 0.4, (1.0, 0.1, 0.05))), "crossing")


def test_surface_that_crosses_itself() -> None:
    ball = sphere(1.0, 0.4)
    points = ball.points.copy()
    points[ball.node_groups["top"]] = [0.1, -2.0, 0.05]
    with pytest.raises(MeshError, match="pierced: "):
        fill_surface(MeshParts(points, {"triangle": ball.cells}), "pierced")


def test_too_fine_is_refused() -> None:
    with pytest.raises(MeshError, match=r"element_size 0\.001 m would give about"):
        fill_surface(joined(sphere(1.0, 0.4)), "ball", element_size=0.001)


def test_points_that_are_not_finite() -> None:
    ball = sphere(1.0, 0.5)
    points = ball.points.copy()
    points[3, 1] = np.nan
    with pytest.raises(MeshError, match="not finite"):
        fill_surface(MeshParts(points, {"triangle": ball.cells}), "ball")
