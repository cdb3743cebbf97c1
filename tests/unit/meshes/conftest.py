"""Fixtures for mesh tests: the shared real meshes, and what every sound mesh fulfils."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from femdeform.types import Mesh
from meshes.boundary import area_vectors, boundary_facets, find_rows, measures, signed_measures

_REPOSITORY = Path(__file__).resolve().parents[3]


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder with the shared meshes; the test is skipped where it is missing."""
    folder = Path(os.environ.get("FEMDEFORM_DATA", _REPOSITORY.parent / "shared" / "data"))
    if not (folder / "meshes").is_dir():
        pytest.skip(f"shared meshes not found in {folder} (set FEMDEFORM_DATA)")
    return folder


@pytest.fixture
def check_solid() -> Callable[[Mesh, bool], None]:
    """Check that a mesh is positive and faces outward, and that named facets cover its boundary once."""

    def check(mesh: Mesh, covered: bool = True) -> None:
        volumes = signed_measures(mesh.points, mesh.cells)
        assert volumes.min() > 0.0
        boundary = mesh.facet_groups["boundary"]
        assert len(boundary) == len(boundary_facets(mesh.cells))
        # Divergence theorem: normals of a closed surface sum to zero, x . n integrates to dim * volume.
        normals = area_vectors(mesh.points, boundary)
        scale = np.linalg.norm(normals, axis=1).sum()
        assert np.abs(normals.sum(axis=0)).max() < 1e-12 * scale
        centers = mesh.points[boundary].mean(axis=1)
        flux = float(np.einsum("ni,ni->", normals, centers)) / mesh.dim
        assert flux == pytest.approx(volumes.sum(), rel=1e-10)
        if covered:
            named = [facets for name, facets in mesh.facet_groups.items() if name != "boundary"]
            rows = find_rows(boundary, np.concatenate(named))
            assert np.array_equal(np.sort(rows), np.arange(len(boundary)))
            total = sum(measures(mesh.points, facets).sum() for facets in named)
            assert total == pytest.approx(measures(mesh.points, boundary).sum(), rel=1e-12)

    return check
